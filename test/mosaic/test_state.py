"""A sweep kept in a file: it comes back as it was, or not at all."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest

from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic import state as states
from panodepth_ros.mosaic.state import SweepJournal, load_state

RIG = Rig(
    arm_radius=0.3,
    column_offset=18.0,
    columns=60,
    sweep_columns=60,
    further_offsets=(9.0,),
    closes=True,
    mends_light=True,
)
CAMERA = PinholeCamera(width=41, height=9, fx=40.0, fy=40.0, cx=20.0, cy=4.0)


def frames(count):
    """Frames and arm azimuths of a sweep that comes twice by the same columns."""
    rng = np.random.default_rng(1)
    for frame in range(count):
        image = rng.integers(0, 255, (9, 41, 3), dtype=np.uint8)
        yield 1000 + frame, image, (frame + 0.1 * (frame % 3)) * RIG.column_step
    yield 1000 + count, rng.integers(0, 255, (9, 41, 3), dtype=np.uint8), RIG.column_step


@pytest.fixture
def sweep():
    sweep = Sweep(RIG, CAMERA, 0.0)
    for frame in frames(7):
        sweep.add(*frame)
    return sweep


def save_state(path, sweep, azimuth, sources=()):
    SweepJournal(path).write(sweep, azimuth, sources)


def followed(path, count=12):
    """Write a sweep down as the mosaicer does: before each step and after each frame."""
    journal, sweep = SweepJournal(path), Sweep(RIG, CAMERA, 0.0)
    journal.write(None, 0.0)
    kept = []
    for stamp, image, azimuth in frames(count):
        sweep.add(stamp, image, azimuth)
        journal.write(sweep, azimuth, ('a',))
        journal.write(sweep, azimuth, ('a', 'b'))
        kept.append((path.stat().st_size, sweep.panoramas()))
    return journal, sweep, kept


def assert_equal(again, sweep):
    ours, other = again.arrays(), sweep.arrays()
    assert ours.keys() == other.keys()
    assert all(np.array_equal(ours[name], other[name], equal_nan=True) for name in ours)


@pytest.mark.parametrize('slack', [0, states._SLACK])
def test_what_is_written_frame_by_frame_comes_back_as_it_is(tmp_path, monkeypatch, slack):
    monkeypatch.setattr(states, '_SLACK', slack)
    path = tmp_path / 'state'
    journal, sweep = SweepJournal(path), Sweep(RIG, CAMERA, 0.0)
    journal.write(None, 0.0)
    for stamp, image, azimuth in frames(40):
        sweep.add(stamp, image, azimuth)
        journal.write(sweep, azimuth, ('a',))
        assert_equal(load_state(path, RIG, CAMERA).sweep(RIG, CAMERA), sweep)
        journal.write(sweep, azimuth + 0.5, ('a', 'b'))
        state = load_state(path, RIG, CAMERA)
        assert (state.azimuth, state.sources) == (azimuth + 0.5, ('a', 'b'))
    assert_equal(state.sweep(RIG, CAMERA), sweep)


def test_light_that_changed_comes_back(tmp_path):
    rig = replace(RIG, columns=180, sweep_columns=180, column_offset=30.0)
    camera = PinholeCamera(width=96, height=64, fx=100.0, fy=100.0, cx=47.5, cy=31.5)
    v, u = np.mgrid[0:64, 0:96]
    journal, sweep = SweepJournal(tmp_path / 'state'), Sweep(rig, camera, 0.0)
    for k in range(12):
        azimuth = k * rig.column_step
        frame = 100 + 40 * np.cos(20 * (azimuth - np.arctan((u - 47.5) / 100))) * np.cos(v / 9)
        frame[10:50, 30:70] += 60 * (4 <= k < 8)
        sweep.add(1000 + k, frame.astype(np.uint8), azimuth)
        journal.write(sweep, azimuth)
    assert len(sweep.light_steps()[1]) == 2
    assert_equal(load_state(tmp_path / 'state', rig, camera).sweep(rig, camera), sweep)


def test_a_frame_adds_what_it_changed(tmp_path):
    _, sweep, kept = followed(tmp_path / 'state')
    whole = sum(array.nbytes for array in sweep.arrays().values())
    added = np.diff([size for size, _ in kept])
    light = sweep.arrays()['light.last'].nbytes
    assert (added[2:] < light + 0.1 * whole + 2000).all()


def test_file_does_not_grow_without_end(tmp_path, monkeypatch):
    monkeypatch.setattr(states, '_SLACK', 0)
    path = tmp_path / 'state'
    followed(path, 50)
    _, sweep, _ = followed(tmp_path / 'other', 1)
    whole = path.with_name('whole')
    save_state(whole, sweep, 0.0)
    assert path.stat().st_size < 2.5 * whole.stat().st_size


def test_cut_file_is_an_earlier_state(tmp_path):
    path = tmp_path / 'state'
    _, _, kept = followed(path)
    content = path.read_bytes()
    first = kept[0][0]
    for size in np.random.default_rng(3).integers(first, len(content), 60):
        path.write_bytes(content[:size])
        found = load_state(path, RIG, CAMERA).sweep(RIG, CAMERA).panoramas()
        whole = [panoramas for end, panoramas in kept if end <= size][-1]
        later = [panoramas for end, panoramas in kept if end > size][:1]
        assert any(
            all(np.array_equal(found[n].image, eyes[n].image) for n in found)
            for eyes in (whole, *later)
        )


def test_write_that_fails_is_no_state_and_the_next_one_begins_anew(tmp_path, monkeypatch):
    path = tmp_path / 'state'
    journal, sweep, _ = followed(path)
    write = os.write
    monkeypatch.setattr(os, 'write', lambda file, data: write(file, data[: len(data) // 2]))
    with pytest.raises(OSError, match='to its end'):
        journal.write(sweep, 0.9)
    assert load_state(path, RIG, CAMERA).azimuth == RIG.column_step
    monkeypatch.undo()
    journal.write(sweep, 0.9)
    journal.write(sweep, 1.0)
    state = load_state(path, RIG, CAMERA)
    assert state.azimuth == 1.0
    assert_equal(state.sweep(RIG, CAMERA), sweep)


def test_file_that_somebody_removed_is_begun_anew(tmp_path):
    path = tmp_path / 'state'
    journal, sweep, _ = followed(path)
    path.unlink()
    journal.write(sweep, 0.9)
    assert_equal(load_state(path, RIG, CAMERA).sweep(RIG, CAMERA), sweep)
    journal.remove()
    assert not path.exists()
    journal.remove()


def test_sweep_comes_back_and_goes_on_as_if_nothing_had_happened(tmp_path):
    _, sweep, _ = followed(tmp_path / 'state')
    again = load_state(tmp_path / 'state', RIG, CAMERA).sweep(RIG, CAMERA)
    for one in (sweep, again):
        one.add(2000, np.full((9, 41, 3), 77, np.uint8), 7 * RIG.column_step)
    assert {'seam.first.image', 'seam.reference.image', 'light.last'} <= again.arrays().keys()
    assert again.direction == sweep.direction == 1
    assert (again.start, again.end, again.last_azimuth) == (
        sweep.start,
        sweep.end,
        sweep.last_azimuth,
    )
    assert_equal(again, sweep)
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


def test_damaged_state_is_refused(tmp_path):
    path = tmp_path / 'state'
    followed(path)
    content = path.read_bytes()
    rng = np.random.default_rng(2)
    lengths = [len(states.MAGIC) + k for k in range(states.HEADER.size)]
    for place in (*lengths, *rng.integers(len(content), size=300)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r'damaged|no state of a sweep'):
            load_state(path, RIG, CAMERA)


@pytest.mark.parametrize(
    ('content', 'said'),
    [
        (b'', 'no state of a sweep, or of another version'),
        (b'PK\x03\x04 the archive of an earlier version', 'no state of a sweep, or of another'),
        (b'PANOSWP3', 'ends before it begins'),
    ],
)
def test_what_is_no_journal_is_refused(tmp_path, content, said):
    (tmp_path / 'state').write_bytes(content)
    with pytest.raises(ValueError, match=said):
        load_state(tmp_path / 'state', RIG, CAMERA)


def file_of(text, data=b''):
    """A file of one record whose checksums are right."""
    return states.MAGIC + states.sealed(text.encode() + data, len(text))


@pytest.mark.parametrize(
    ('arrays', 'said'),
    [
        ('[["moments", "|O", [1]]]', r'moments of the state is of \|O'),
        ('[["moments", "<i8", [100000000]]]', 'no state of a sweep|buffer'),
        ('[["moments", "<i8", [-1]]]', 'no state of a sweep|buffer'),
        ('[["moments"]]', 'no state of a sweep|values to unpack'),
        ('7', 'no state of a sweep'),
    ],
)
def test_arrays_that_are_none_are_refused(tmp_path, arrays, said):
    (tmp_path / 'state').write_bytes(
        file_of(f'{{"time": 0, "azimuth": 0, "sources": [], "arrays": {arrays}}}', bytes(64))
    )
    with pytest.raises(ValueError, match=said):
        load_state(tmp_path / 'state', RIG, CAMERA)


def test_state_larger_than_it_can_be_is_not_read(tmp_path, sweep):
    path = tmp_path / 'state'
    save_state(path, sweep, 0.7)
    with path.open('ab') as file:
        file.truncate(100_000_000)
    with pytest.raises(ValueError, match='has 100000000 bytes; allowed: up to'):
        load_state(path, RIG, CAMERA)


def test_state_is_replaced_as_a_whole_and_by_no_link(tmp_path, sweep):
    path = tmp_path / 'state'
    save_state(path, sweep, 0.7)
    (tmp_path / 'precious').write_text('mine')
    (tmp_path / 'state.new').symlink_to(tmp_path / 'precious')
    with pytest.raises(OSError, match=r'state\.new'):
        save_state(path, sweep, 0.8)
    assert (tmp_path / 'precious').read_text() == 'mine'
    assert load_state(path, RIG, CAMERA).azimuth == 0.7
