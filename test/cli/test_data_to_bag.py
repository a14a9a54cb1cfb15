"""Bags made of frames and angles, against docs/conventions.md and the frames themselves."""

import json
import sys
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('rosbags', reason='bags need rosbags')


sys.path.insert(0, str(Path(__file__).parents[2] / 'tools'))

import data_to_bag as tool

from panodepth_ros.bag import STORAGES, read
from panodepth_ros.ros.images import to_array

STUDY = Path(__file__).parents[3] / 'shared' / 'data' / 'study'

META = {'W': 16, 'H': 12, 'fx': 20.0, 'fy': 21.0, 'cx': 7.5, 'cy': 5.5, 'k1': -0.1, 'k2': 0.01}


def write_folder(folder: Path, angles: np.ndarray, frame_count: int | None = None) -> np.ndarray:
    """Frames of noise, their angles and the calibration."""
    count = angles.size if frame_count is None else frame_count
    frames = np.random.default_rng(3).integers(0, 256, (count, 12, 16, 3), np.uint8)
    folder.mkdir()
    np.save(folder / 'angles.npy', angles)
    (folder / 'meta.json').write_text(json.dumps(META))
    code = cv2.VideoWriter_fourcc(*'FFV1')
    video = cv2.VideoWriter(str(folder / 'frames.mkv'), code, 10.0, (16, 12))
    assert video.isOpened()
    for frame in frames:
        video.write(frame)
    video.release()
    return frames


def stamp_of(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def contents(bag: Path) -> dict[str, list]:
    """Messages by topic; the bag's order of time is that of the stamps."""
    topics: dict[str, list] = {'/image_raw': [], '/camera_info': [], '/joint_states': []}
    previous = 0
    for topic, received, message in read(bag):
        assert received == stamp_of(message)
        assert received >= previous
        previous = received
        topics[topic].append(message)
    return topics


def assert_placed(topics: dict[str, list], azimuths: np.ndarray) -> None:
    """Each frame has, by the rule of docs/conventions.md, the arm azimuth it was taken at."""
    states = topics['/joint_states']
    stamps = np.array([stamp_of(state) for state in states])
    positions = np.array([state.position[0] for state in states])
    velocities = np.array([state.velocity[0] for state in states])
    assert len(topics['/image_raw']) == azimuths.size
    for frame, azimuth in zip(topics['/image_raw'], azimuths, strict=True):
        after = int(np.searchsorted(stamps, stamp_of(frame)))
        assert stamps[after - 1] < stamp_of(frame) < stamps[after]
        assert positions[after - 1] == positions[after] == azimuth
        assert velocities[after - 1] == velocities[after] == 0.0
        # It was seen to arrive: between this standstill and the one before, it moved.
        assert velocities[after - 2] != 0.0
        assert np.sign(velocities[after - 2]) == np.sign(azimuth - positions[after - 2])
    # The velocity on the way is what leads from there to the next standing position.
    for k in np.flatnonzero(velocities):
        way = velocities[k] * (stamps[k + 1] - stamps[k]) * 1e-9
        assert positions[k] + way == pytest.approx(positions[k + 1])
    assert velocities[0] != 0.0
    assert velocities[-1] == 0.0


@pytest.mark.parametrize('storage', STORAGES)
def test_bag_obeys_the_conventions(tmp_path: Path, storage: str) -> None:
    angles = (np.array([6.1, 6.2, 6.28, 0.05, 0.2]) + np.pi) % (2 * np.pi) - np.pi  # wraps
    frames = write_folder(tmp_path / 'data', angles)
    assert tool.main([str(tmp_path / 'data'), str(tmp_path / 'bag'), '-s', storage]) == 0
    topics = contents(tmp_path / 'bag')
    unwrapped = np.unwrap(angles)
    assert np.ptp(unwrapped) < 0.5  # continuous, not once around
    assert_placed(topics, unwrapped)
    assert {tuple(state.name) for state in topics['/joint_states']} == {('panodepth_arm_joint',)}
    for message, frame in zip(topics['/image_raw'], frames, strict=True):
        assert message.encoding == 'bgr8'
        np.testing.assert_array_equal(to_array(message), frame)
    for image, info in zip(topics['/image_raw'], topics['/camera_info'], strict=True):
        assert image.header == info.header
        assert info.header.frame_id == 'panodepth_camera_optical_frame'
        assert (info.width, info.height) == (16, 12)
        assert info.distortion_model == 'plumb_bob'
        np.testing.assert_array_equal(info.k, [20, 0, 7.5, 0, 21, 5.5, 0, 0, 1])
        np.testing.assert_array_equal(info.d, [-0.1, 0.01, 0, 0, 0])
        np.testing.assert_array_equal(info.p, [20, 0, 7.5, 0, 0, 21, 5.5, 0, 0, 0, 1, 0])


def test_clockwise_sweep_is_a_clockwise_motion(tmp_path: Path) -> None:
    angles = np.array([0.3, 0.2, 0.1])
    write_folder(tmp_path / 'data', angles)
    assert tool.main([str(tmp_path / 'data'), str(tmp_path / 'bag')]) == 0
    assert_placed(contents(tmp_path / 'bag'), angles)


def test_period_sets_the_time_per_frame(tmp_path: Path) -> None:
    write_folder(tmp_path / 'data', np.linspace(0.0, 0.3, 4))
    arguments = [str(tmp_path / 'data'), str(tmp_path / 'bag'), '--period', '0.5']
    assert tool.main(arguments) == 0
    stamps = [stamp_of(message) for message in contents(tmp_path / 'bag')['/image_raw']]
    assert [later - earlier for earlier, later in pairwise(stamps)] == [500_000_000] * 3


@pytest.mark.parametrize(
    ('frame_count', 'sentence'),
    [(3, 'has 3 frames for 4 angles'), (5, 'has more frames than 4 angles')],
)
def test_frames_that_do_not_fit_the_angles_leave_no_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], frame_count: int, sentence: str
) -> None:
    write_folder(tmp_path / 'data', np.linspace(0.0, 0.3, 4), frame_count)
    assert tool.main([str(tmp_path / 'data'), str(tmp_path / 'bag')]) == 1
    assert f'{tmp_path / "data" / "frames.mkv"} {sentence}' in capsys.readouterr().err
    assert not (tmp_path / 'bag').exists()


def test_existing_bag_and_missing_folder_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tmp_path / 'data', np.linspace(0.0, 0.3, 4))
    (tmp_path / 'bag').write_text('mine')
    assert tool.main([str(tmp_path / 'data'), str(tmp_path / 'bag')]) == 1
    assert 'exists already' in capsys.readouterr().err
    assert (tmp_path / 'bag').read_text() == 'mine'
    assert tool.main([str(tmp_path / 'none'), str(tmp_path / 'new')]) == 1
    assert str(tmp_path / 'none') in capsys.readouterr().err


@pytest.mark.skipif(not STUDY.is_dir(), reason='needs the rendered room beside the repository')
def test_rendered_room_becomes_a_bag_pixel_by_pixel(tmp_path: Path) -> None:
    assert tool.main([str(STUDY), str(tmp_path / 'study')]) == 0
    topics = contents(tmp_path / 'study')
    assert_placed(topics, np.load(STUDY / 'angles.npy'))
    with np.load(STUDY / 'mosaics.npz') as mosaics:  # rgb, column k of frame k
        left, right = mosaics['left'][..., ::-1], mosaics['right'][..., ::-1]
    for k, message in enumerate(topics['/image_raw']):
        frame = to_array(message)
        np.testing.assert_array_equal(frame[:, 150], left[:, k])
        np.testing.assert_array_equal(frame[:, 9], right[:, k])
