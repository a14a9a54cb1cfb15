"""The simulated camera sees the arm where its truth file says it is."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from panodepth_ros.arm.truth import Piece, TruthWriter
from panodepth_ros.camera.simulated import Room, RoomCamera, furnished_room
from panodepth_ros.camera.simulated import source as simulated
from panodepth_ros.camera.simulated.source import SimulatedSource
from panodepth_ros.camera.source import SourceClosedError, SourceError, SourceLostError
from panodepth_ros.geometry import PinholeCamera

CAMERA = RoomCamera.from_field_of_view(40, 30, math.radians(34.0))
LENS = PinholeCamera(width=40, height=30, fx=CAMERA.fx, fy=CAMERA.fy, cx=19.5, cy=14.5)


@pytest.fixture(scope='module')
def room() -> Room:
    return furnished_room(0)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return tmp_path / 'arm.truth'


def opened(room: Room, truth: Path, **changes: object) -> SimulatedSource:
    arguments = {
        'arm_radius': 0.3,
        'arm_truth': str(truth),
        'framerate': 100.0,
        'exposure': 0.0,
        'noise_stddev': 0.0,
        'seed': 0,
        'grey': False,
        'stop': threading.Event(),
    }
    return SimulatedSource(room, LENS, **(arguments | changes))


def test_frames_show_the_arm_where_it_is_while_it_moves(room: Room, truth: Path) -> None:
    arm = TruthWriter(truth, 0.5)
    source = opened(room, truth)
    assert source.size == (40, 30)
    np.testing.assert_array_equal(source.read().image, room.render(0.5, CAMERA, 0.3))
    begin = time.monotonic()
    arm.write([Piece(-math.inf, 0.5), Piece(begin, 0.5, 2.0)])
    for _ in range(5):
        frame = source.read()
        azimuth = 0.5 + 2.0 * max(frame.stamp - begin, 0.0)
        np.testing.assert_array_equal(frame.image, room.render(azimuth, CAMERA, 0.3))
        assert frame.stamp <= time.monotonic()
    source.close()
    arm.close()


def test_an_exposure_sees_all_that_the_arm_turns_past(room: Room, truth: Path) -> None:
    arm = TruthWriter(truth, 0.5)
    source = opened(room, truth, exposure=0.02)
    standing = source.read()
    np.testing.assert_array_equal(standing.image, room.render(0.5, CAMERA, 0.3))
    begin = time.monotonic()
    arm.write([Piece(-math.inf, 0.5), Piece(begin, 0.5, 2.0)])
    for _ in range(5):
        frame = source.read()
    moments = frame.stamp + np.linspace(-0.01, 0.01, 101) - begin
    seen = [room.render(0.5 + 2.0 * t, CAMERA, 0.3).astype(float) for t in moments]
    blurred = np.mean(seen, axis=0)
    off = np.abs(frame.image - blurred)
    assert off.mean() < 1.0
    assert off.mean() < 0.2 * np.abs(seen[50] - blurred).mean(), 'no sharp frame is'
    source.close()
    arm.close()


def test_exposures_keep_their_rate_and_are_skipped_when_late(room: Room, truth: Path) -> None:
    arm = TruthWriter(truth)
    source = opened(room, truth, framerate=1000.0)
    stamps = [source.read().stamp]
    threading.Event().wait(0.03)
    stamps += [source.read().stamp for _ in range(10)]
    periods = np.diff(stamps) * 1000.0
    np.testing.assert_allclose(periods, np.round(periods), atol=1e-6)
    assert source.skipped == round(periods.sum()) - 10
    assert source.skipped >= 25
    arm.close()


def test_noise_is_seeded_and_as_strong_as_asked_for(room: Room, truth: Path) -> None:
    arm = TruthWriter(truth, 0.5)
    clean = room.render(0.5, CAMERA, 0.3).astype(float)
    first, again, other = (
        opened(room, truth, noise_stddev=3.0, seed=seed).read().image for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    within = (clean > 15) & (clean < 240)
    noise = (first - clean)[within]
    assert noise.mean() == pytest.approx(0.0, abs=0.2)
    assert noise.std() == pytest.approx(math.hypot(3.0, 1 / math.sqrt(12)), rel=0.05)
    grey = opened(room, truth, grey=True).read().image
    assert grey.shape == (30, 40)
    arm.close()


def test_a_missing_arm_is_waited_for(
    room: Room, truth: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated, '_ARM_START_TIMEOUT', 0.2)
    with pytest.raises(SourceLostError, match='is simulated_arm running'):
        opened(room, truth).read()
    stop = threading.Event()
    stop.set()
    with pytest.raises(SourceClosedError):
        opened(room, truth, stop=stop).read()
    monkeypatch.setattr(simulated, '_ARM_START_TIMEOUT', 20.0)
    arms: list[TruthWriter] = []
    starter = threading.Timer(0.2, lambda: arms.append(TruthWriter(truth)))
    starter.start()
    assert opened(room, truth).read().image.shape == (30, 40, 3)
    starter.join()
    arms[0].close()


def test_what_is_no_truth_file_is_refused(room: Room, truth: Path) -> None:
    truth.write_bytes(b'something else')
    with pytest.raises(SourceError, match='is not a truth file') as refused:
        opened(room, truth).read()
    assert not isinstance(refused.value, SourceLostError)
