"""A sweep kept in a file: it comes back as it was, or not at all."""

import os
import time
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic import state as states
from panodepth_ros.mosaic.state import load_state, save_state

RIG = Rig(
    arm_radius=0.3,
    column_offset=20.0,
    columns=60,
    sweep_columns=60,
    further_offsets=(9.0,),
    closes=True,
    mends_light=True,
)
CAMERA = PinholeCamera(width=41, height=9, fx=40.0, fy=40.0, cx=20.0, cy=4.0)


@pytest.fixture
def sweep():
    rng = np.random.default_rng(1)
    sweep = Sweep(RIG, CAMERA, 0.0)
    for frame in range(7):
        image = rng.integers(0, 255, (9, 41, 3), dtype=np.uint8)
        sweep.add(1000 + frame, image, (frame + 0.1 * (frame % 3)) * RIG.column_step)
    return sweep


def test_sweep_comes_back_and_goes_on_as_if_nothing_had_happened(tmp_path, sweep):
    save_state(tmp_path / 'state', sweep, 0.7, ('a', 'b'))
    state = load_state(tmp_path / 'state', RIG, CAMERA)
    assert (state.azimuth, state.sources) == (0.7, ('a', 'b'))
    again = state.sweep(RIG, CAMERA)
    for one in (sweep, again):
        one.add(2000, np.full((9, 41, 3), 77, np.uint8), 7 * RIG.column_step)
    assert again.direction == sweep.direction == 1
    assert (again.start, again.end, again.last_azimuth) == (
        sweep.start,
        sweep.end,
        sweep.last_azimuth,
    )
    ours, other = again.arrays(), sweep.arrays()
    assert {'seam.first.image', 'seam.reference.image', 'light.last', 'frame'} <= ours.keys()
    assert all(np.array_equal(ours[name], other[name], equal_nan=True) for name in ours)
    mine, theirs = again.panoramas(), sweep.panoramas()
    assert mine.keys() == theirs.keys()
    for name, panorama in mine.items():
        assert np.array_equal(panorama.image, theirs[name].image)
        ours, other = panorama.geometry, theirs[name].geometry
        assert np.array_equal(ours.ray_angle, other.ray_angle, equal_nan=True)
        assert ours.azimuth_column == other.azimuth_column


def test_state_before_the_first_frame_has_no_sweep(tmp_path):
    save_state(tmp_path / 'state', None, 0.0)
    assert load_state(tmp_path / 'state', RIG, CAMERA).sweep(RIG, CAMERA) is None


def test_sweep_of_one_frame_comes_back(tmp_path):
    one = Sweep(RIG, CAMERA, 0.0)
    one.add(1000, np.full((9, 41, 3), 77, np.uint8), 0.0)
    save_state(tmp_path / 'state', one, 0.0)
    assert load_state(tmp_path / 'state', RIG, CAMERA).sweep(RIG, CAMERA).start == 1000


def test_no_state_is_none(tmp_path):
    assert load_state(tmp_path / 'state', RIG, CAMERA) is None


@pytest.mark.parametrize(
    ('rig', 'camera'),
    [
        (replace(RIG, arm_radius=0.31), CAMERA),
        (replace(RIG, mounting=Mounting(yaw=0.01)), CAMERA),
        (replace(RIG, columns=61), CAMERA),
        (RIG, replace(CAMERA, fx=40.5)),
    ],
)
def test_state_of_another_rig_is_refused(tmp_path, sweep, rig, camera):
    save_state(tmp_path / 'state', sweep, 0.7)
    state = load_state(tmp_path / 'state', rig, camera)
    with pytest.raises(ValueError, match='another rig or camera'):
        state.sweep(rig, camera)


@pytest.mark.parametrize('age', [states.OLDEST + 2, -10])
def test_old_state_is_refused(tmp_path, sweep, monkeypatch, age):
    now = time.time()
    monkeypatch.setattr(states.time, 'time', lambda: now - age)
    save_state(tmp_path / 'state', sweep, 0.7)
    monkeypatch.setattr(states.time, 'time', lambda: now)
    state = load_state(tmp_path / 'state', RIG, CAMERA)
    with pytest.raises(ValueError, match='s old; allowed: up to 120'):
        state.sweep(RIG, CAMERA)


def test_damaged_state_is_refused_or_as_it_was(tmp_path, sweep):
    path = tmp_path / 'state'
    save_state(path, sweep, 0.7)
    content = path.read_bytes()
    whole = sweep.panoramas()
    rng = np.random.default_rng(2)
    refused = 0
    for turn in range(300):
        damaged = bytearray(content)
        if turn % 3:
            damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        else:
            del damaged[rng.integers(len(damaged)) :]
        path.write_bytes(damaged)
        try:
            found = load_state(path, RIG, CAMERA).sweep(RIG, CAMERA).panoramas()
        except ValueError:
            refused += 1
        else:
            assert all(np.array_equal(found[n].image, whole[n].image) for n in whole)
    assert refused > 200


def test_array_without_a_header_is_no_state(tmp_path, sweep):
    save_state(tmp_path / 'good', sweep, 0.7)
    with (
        zipfile.ZipFile(tmp_path / 'good') as good,
        zipfile.ZipFile(tmp_path / 'state', 'w') as bad,
    ):
        for name in good.namelist():
            data = good.read(name)
            bad.writestr(name, data.replace(b',)', b', ') if name == 'moments.npy' else data)
    with pytest.raises(ValueError, match='is no state of a sweep'):
        load_state(tmp_path / 'state', RIG, CAMERA)


def test_state_larger_than_it_can_be_is_not_read(tmp_path, sweep):
    path = tmp_path / 'state'
    save_state(path, sweep, 0.7)
    with path.open('ab') as file:
        file.truncate(100_000_000)
    with pytest.raises(ValueError, match=r'no state|allowed: up to'):
        load_state(path, RIG, CAMERA)
    with path.open('wb') as file:
        np.savez_compressed(file, bomb=np.zeros(100_000_000, np.uint8))
    with pytest.raises(ValueError, match='100000128 bytes; allowed: up to'):
        load_state(path, RIG, CAMERA)


def test_pickles_are_not_executed(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / 'executed'),)

    with (tmp_path / 'state').open('wb') as file:
        np.savez(file, about=np.array([Bomb()], dtype=object))
    with pytest.raises(ValueError, match='pickle'):
        load_state(tmp_path / 'state', RIG, CAMERA)
    assert not (tmp_path / 'executed').exists()


def test_state_is_replaced_as_a_whole_and_by_no_link(tmp_path, sweep):
    path = tmp_path / 'state'
    save_state(path, sweep, 0.7)
    (tmp_path / 'precious').write_text('mine')
    (tmp_path / 'state.new').symlink_to(tmp_path / 'precious')
    with pytest.raises(OSError, match=r'state\.new'):
        save_state(path, sweep, 0.8)
    assert (tmp_path / 'precious').read_text() == 'mine'
    assert load_state(path, RIG, CAMERA).azimuth == 0.7
