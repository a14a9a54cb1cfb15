"""Frames of a steadily turning arm to sweeps, and the delay of their clock."""

import dataclasses
import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import ArmMotion, ContinuousAssembler, Rig
from panodepth_ros.mosaic.clock import DelayCheck, estimate_delay

COLUMNS = 360
STEP = 2 * math.pi / COLUMNS
CAMERA = PinholeCamera(width=61, height=9, fx=1 / STEP, fy=1 / STEP, cx=30.0, cy=4.0)
RIG = Rig(arm_radius=0.3, column_offset=20.0, columns=COLUMNS, sweep_columns=COLUMNS)
MS = 1_000_000
SPEED = 24.0 * STEP  # rad/s: with 30 Hz, 0.8 columns a frame


def scene(bearing):
    """Grey levels of far away things, shape (9, …)."""
    rng = np.random.default_rng(4)
    row = np.arange(9)[:, np.newaxis, np.newaxis]
    value = np.zeros((9, *np.shape(bearing)))
    for k in range(1, 40):
        phase = rng.uniform(0, 2 * math.pi) + row[..., 0] * rng.uniform(0, 0.5)
        value += np.cos(k * bearing + phase) / math.sqrt(k)
    return 128 + 18 * value


def frame(azimuth):
    u = np.arange(61)
    bearing = azimuth - np.arctan((u - 30.0) * STEP)
    return np.clip(np.rint(scene(bearing)), 0, 255).astype(np.uint8)


def arm(seconds, direction=1.0):
    """Azimuth of an arm that stands for a second and then turns."""
    return direction * SPEED * max(0.0, seconds - 1.0)


def record(built, duration, *, direction=1.0, late=0.0, begin=0.0, lost=()):
    """Let an arm turn: 50 joint states and 30 frames a second, whose stamps are too early."""
    events = [(k * 0.02, 'joint') for k in range(int(duration * 50) + 60)]
    events += [(0.001 + k / 30, 'frame') for k in range(int(duration * 30)) if k not in lost]
    sweeps = []
    for seconds, kind in sorted(events):
        stamp = round((begin + seconds) * 1e9)
        if kind == 'joint':
            sweeps += built.add_joint_state(stamp, arm(seconds, direction), None)
        else:
            sweeps += built.add_frame(stamp, frame(arm(seconds + late, direction)))
    return sweeps


def assembler(delay=0.0, rig=RIG):
    built = ContinuousAssembler(rig, ArmMotion(100 * MS), round(delay * 1e9))
    built.set_camera(CAMERA)
    return built


def test_a_turn_becomes_a_panorama_of_exact_rays():
    (sweep,) = record(assembler(), 17.0)
    assert sweep.complete
    assert sweep.velocity == pytest.approx(SPEED, rel=1e-6)
    for panorama in sweep.panoramas().values():
        geometry = panorama.geometry
        bearing = geometry.ray_azimuth(np.arange(COLUMNS))
        error = panorama.image - scene(bearing)
        assert np.abs(error).max() < 3.0  # rounding and linear interpolation
        # A frame reaches 0.75 columns, less than to the next one: the rays tell what remains.
        assert 0.01 * STEP < np.ptp(geometry.ray_angle) < 0.1 * STEP


@pytest.mark.parametrize('direction', [1.0, -1.0])
def test_a_turn_closes_with_the_frame_after_its_last_one(direction):
    rig = dataclasses.replace(RIG, stripe_columns=10)
    lost = [k for k in range(17 * 30) if k % 4]  # 3.2 columns a frame
    (sweep,) = record(assembler(rig=rig), 17.0, direction=direction, lost=lost)
    assert sweep.complete
    for panorama in sweep.panoramas().values():
        geometry = panorama.geometry
        assert np.ptp(geometry.ray_angle) < 1e-6
        assert np.abs(panorama.image - scene(geometry.ray_azimuth(np.arange(COLUMNS)))).max() < 3.0


def test_the_next_turn_begins_where_the_last_one_ended():
    sweeps = record(assembler(), 1.0 + 2.2 * COLUMNS * STEP / SPEED)
    assert len(sweeps) == 2
    assert all(sweep.complete for sweep in sweeps)
    assert sweeps[1].start > sweeps[0].end


def test_lost_frames_leave_unknown_columns():
    lost = range(200, 210)  # 8 columns of the turn
    (sweep,) = record(assembler(), 17.0, lost=lost)
    assert 5 <= COLUMNS - sweep.seen.sum() <= 9
    ((first, last),) = sweep.missing_sectors()
    middle = (205 / 30 + 0.001 - 1.0) * SPEED
    assert (first + last) / 2 == pytest.approx(middle, abs=1.5 * STEP)


def test_a_standing_arm_begins_no_sweep():
    built = assembler()
    assert record(built, 1.0) == []
    assert built.sweep is None


def test_an_arm_that_turns_back_late_ends_the_sweep_early_and_early_drops_it():
    for share, kept in ((0.7, 1), (0.3, 0)):
        built = assembler()
        turned = 1.0 + share * COLUMNS * STEP / SPEED
        sweeps = []
        for k in range(int(2 * turned * 50)):
            seconds = k * 0.02
            azimuth = arm(seconds) if seconds < turned else arm(2 * turned - seconds)
            sweeps += built.add_joint_state(round(seconds * 1e9), azimuth, None)
            sweeps += built.add_frame(round((seconds + 0.01) * 1e9), frame(azimuth))
        assert len(sweeps) == kept
        assert built.drops['sweep: arm turned back before 50% of it'] == 1 - kept
        if kept:
            assert sweeps[0].progress == pytest.approx(share, abs=0.02)


def test_a_sweep_that_lost_most_frames_is_dropped_and_says_so():
    built = assembler()
    lost = [k for k in range(40, 540) if k % 5]
    assert record(built, 18.0, lost=lost) == []
    assert built.drops['sweep: frames reached less than 50% of it'] == 1


def test_silent_joint_states_place_no_frame():
    built = assembler()
    for stamp in (0, 50, 400, 450):
        built.add_joint_state(stamp * MS, stamp / 1e3 * SPEED, None)
    for stamp in (20, 200, 420):
        built.add_frame(stamp * MS, frame(0.0))
    built.add_joint_state(500 * MS, 0.5 * SPEED, None)
    assert built.drops == {'frame: no joint state near its stamp': 1}
    assert built.sweep is not None


def test_delay_is_found_from_turns_to_both_sides():
    late = 0.05
    built = assembler()
    (forward,) = record(built, 17.0, late=late)
    built.restart(0)
    (backward,) = record(built, 17.0, direction=-1.0, late=late, begin=100.0)
    panoramas = [sweep.panoramas()['center'] for sweep in (forward, backward)]
    found = estimate_delay(*panoramas, (forward.velocity, backward.velocity))
    assert found.delay == pytest.approx(late, abs=0.001)
    assert found.stddev < 0.001

    check = DelayCheck()
    took = round(panoramas[0].geometry.sweep_duration * 1e9)
    at = [k * (took + 1000 * MS) for k in range(8)]
    assert check.add(panoramas[0], forward.velocity, at[0]) is None
    assert check.add(panoramas[0], forward.velocity, at[1]) is None, 'the same way twice'
    assert check.add(panoramas[1], backward.velocity, at[2]) == found
    assert check.add(panoramas[0], forward.velocity, at[3]) is None, 'a pair was used twice'
    assert check.add(panoramas[1], backward.velocity, at[6]) is None, (
        'it may be another robot pose'
    )
    assert check.add(panoramas[0], forward.velocity, at[7]) is not None

    # With that delay the turns agree, and lie where the scene is.
    corrected = assembler(delay=found.delay)
    (sweep,) = record(corrected, 17.0, late=late)
    panorama = sweep.panoramas()['left']
    error = panorama.image - scene(panorama.geometry.ray_azimuth(np.arange(COLUMNS)))
    assert np.abs(error).mean() < 1.0
    uncorrected = forward.panoramas()['left']
    error = uncorrected.image - scene(uncorrected.geometry.ray_azimuth(np.arange(COLUMNS)))
    assert np.abs(error).mean() > 3.0


def test_delay_cannot_be_found_from_one_direction_or_a_blank_room():
    (sweep,) = record(assembler(), 17.0)
    panorama = sweep.panoramas()['center']
    with pytest.raises(ValueError, match='allowed: once to either side'):
        estimate_delay(panorama, panorama, (0.4, 0.4))
    blank = type(panorama)(np.full_like(panorama.image, 90), panorama.geometry)
    with pytest.raises(ValueError, match='only 0 of 12 sectors show enough'):
        estimate_delay(blank, blank, (0.4, -0.4))
    left = sweep.panoramas()['left']
    with pytest.raises(ValueError, match=r'principal_angle is -?0\.0 forward'):
        estimate_delay(panorama, left, (0.4, -0.4))


@pytest.mark.parametrize('known', [True, False])
def test_rows_exposed_one_after_the_other_are_put_upright(known):
    row_time = 0.01  # 9 rows: the arm turns by 1.9 columns from the first to the last
    built = assembler()
    built.row_time = row_time if known else 0.0

    def rolling(seconds):
        rows = [frame(arm(seconds + (v - 4) * row_time))[v] for v in range(9)]
        return np.stack(rows)

    sweeps = []
    for k in range(17 * 50):
        sweeps += built.add_joint_state(k * 20 * MS, arm(k * 0.02), None)
        sweeps += built.add_frame(k * 20 * MS + 10 * MS, rolling(k * 0.02 + 0.01))
    (sweep,) = sweeps
    panorama = sweep.panoramas()['right']
    error = np.abs(panorama.image - scene(panorama.geometry.ray_azimuth(np.arange(COLUMNS))))
    error = np.delete(error, COLUMNS // 2, axis=1)  # there the arm starts at once, in mid-frame
    assert (error.max() < 3.0) == known
    assert (error.max() > 10.0) == (not known)


def test_rolling_shutter_that_shears_stripes_out_of_the_image_is_named():
    rig = Rig(
        arm_radius=0.3,
        column_offset=27.0,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        stripe_columns=5,
    )
    built = assembler(rig=rig)
    built.row_time = 0.01
    assert record(built, 17.0) == []
    (reason,) = (reason for reason in built.drops if 'stripe' in reason)
    assert 'of 5 columns around +27 px' in reason
    assert 'within half a frame' in reason
    assert 'allowed: 0 to 60' in reason
    built = assembler(rig=rig)
    built.row_time = 0.001
    assert record(built, 17.0)[0].complete
