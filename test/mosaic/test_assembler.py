"""Frames and joint states to sweeps, in whatever order they come."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import ArmTrack, Assembler, Rig

COLUMNS = 60
STEP = 2 * math.pi / COLUMNS
CAMERA = PinholeCamera(width=21, height=7, fx=30.0, fy=30.0, cx=10.0, cy=3.0)
RIG = Rig(arm_radius=0.3, column_offset=8.0, columns=COLUMNS, sweep_columns=COLUMNS)
MS = 1_000_000
PERIOD = 100 * MS


def assembler(rig=RIG, settle_ms=0):
    built = Assembler(rig, ArmTrack(1e-6, 1000 * MS), settle_ms * MS)
    built.set_camera(CAMERA)
    return built


def image(k, height=7):
    return np.full((height, 21), k, np.uint8)


def recording(columns=COLUMNS, first=1, frames_per_stop=2):
    """Events of a stop-and-go turn, by stamp: the arm stands in the second half of a period."""
    events = [(0, 'joint', 0.0, 0.0)]
    for k in range(first, first + columns):
        start = (k - first + 1) * PERIOD
        events += [
            (start, 'joint', (k - 1) * STEP, 0.0),
            (start + 5 * MS, 'frame', 255, None),  # exposed while the arm moves
            (start + 10 * MS, 'joint', (k - 0.5) * STEP, 1.0),
            (start + 50 * MS, 'joint', k * STEP, 0.0),
        ]
        events += [
            (start + (60 + 10 * n) * MS, 'frame', k + 100 * n, None)
            for n in range(frames_per_stop)
        ]
    events.append(((columns + 1) * PERIOD, 'joint', (first + columns - 1) * STEP, 0.0))
    return events


def play(built, events):
    sweeps = []
    for stamp, kind, value, velocity in events:
        if kind == 'joint':
            sweeps += built.add_joint_state(stamp, value, velocity)
        else:
            sweeps += built.add_frame(stamp, image(value))
    return sweeps


def test_first_frame_of_every_standstill_becomes_a_column():
    built = assembler()
    (sweep,) = play(built, recording())
    assert sweep.complete
    row = sweep.panoramas()['left'].image[0]
    assert sorted(row.tolist()) == list(range(1, COLUMNS + 1))
    assert built.drops['frame: arm moved'] == COLUMNS
    assert built.sweep is None


def test_frames_that_outrun_the_joint_states_and_late_ones_give_the_same_sweep():
    in_order = play(assembler(), recording())[0].panoramas()
    frames_first = sorted(recording(), key=lambda e: e[0] - (80 * MS if e[1] == 'frame' else 0))
    frames_last = sorted(recording(), key=lambda e: e[0] + (80 * MS if e[1] == 'frame' else 0))
    for events in (frames_first, frames_last):
        panoramas = play(assembler(), events)[0].panoramas()
        for name, panorama in panoramas.items():
            assert np.array_equal(panorama.image, in_order[name].image)


def test_standstill_before_the_first_motion_is_not_part_of_a_sweep():
    events = [(0, 'joint', 0.0, 0.0), (10 * MS, 'frame', 7, None), (20 * MS, 'joint', 0.0, 0.0)]
    built = assembler()
    assert play(built, events) == []
    assert built.sweep is None
    assert built.drops['frame: arm was not seen to arrive'] == 1


def test_standstills_before_the_start_of_a_led_sweep_do_not_count():
    built = assembler()
    play(built, recording(3))
    assert built.sweep.progress == pytest.approx(3 / COLUMNS)
    built.restart(built.track.newest + 1)
    built.add_frame(5 * PERIOD, image(9))
    built.add_joint_state(5 * PERIOD + MS, 3 * STEP, 0.0)
    assert built.sweep is None


def without(lost, columns=COLUMNS):
    """Recording in which no frame of some standstills arrived."""
    gone = {k + 100 * n for k in lost for n in (0, 1)}
    return [e for e in recording(columns) if e[1] == 'joint' or e[2] not in gone]


def test_turn_with_gaps_ends_at_its_last_column():
    (sweep,) = play(assembler(), without({20}))
    assert not sweep.complete
    assert int(sweep.seen.sum()) == COLUMNS - 1


def test_turn_without_its_last_column_ends_when_the_arm_goes_on():
    built = assembler()
    (sweep,) = play(built, without({COLUMNS}, COLUMNS + 1))
    assert int(sweep.seen.sum()) == COLUMNS - 1
    assert int(built.sweep.seen.sum()) == 1, 'the next sweep begins with the frame that came'


def test_second_turn_is_a_second_sweep():
    sweeps = play(assembler(), recording(2 * COLUMNS))
    assert [sweep.complete for sweep in sweeps] == [True, True]


def test_frame_before_settling_gives_way_to_the_next():
    (sweep,) = play(assembler(settle_ms=15), recording())
    row = sweep.panoramas()['left'].image[0]
    assert sorted(row.tolist()) == [k + 100 for k in range(1, COLUMNS + 1)]


def test_frames_before_settling_are_counted_and_do_not_serve():
    built = assembler(settle_ms=15)
    play(built, recording(1)[:-2])  # up to the frame 10 ms after the arrival
    assert not built.has_frame_of(built.track.current)
    play(built, recording(1)[-2:])
    assert built.drops['frame: arm was settling'] == 1


def test_frame_that_comes_just_when_the_arm_has_settled_serves():
    built = assembler(settle_ms=10)
    (sweep,) = play(built, recording())
    assert sorted(sweep.panoramas()['left'].image[0].tolist()) == list(range(1, COLUMNS + 1))


def test_frames_before_any_calibration_wait_for_it():
    built = Assembler(RIG, ArmTrack(1e-6, 1000 * MS), 0)
    assert play(built, recording()) == []
    (sweep,) = built.set_camera(CAMERA)
    assert sweep.complete


def test_standstill_that_begins_with_the_sweep_counts():
    built = assembler()
    built.restart(50 * MS + PERIOD)  # the stamp of the first arrival
    play(built, recording(1))
    assert built.sweep is not None


@pytest.mark.parametrize('late_by', [0, 1])
def test_frame_twice_or_out_of_order_is_dropped_and_counted(late_by):
    built = assembler()
    built.add_frame(10, image(1))
    built.add_frame(10 - late_by, image(2))
    assert built.drops['frame out of order or twice'] == 1


def test_frame_of_another_size_gives_way_to_the_next():
    built = assembler()
    for stamp, kind, value, velocity in recording():
        if kind == 'joint':
            sweeps = built.add_joint_state(stamp, value, velocity)
        else:
            built.add_frame(stamp, image(value, height=8 if value == 12 else 7))
    (sweep,) = sweeps
    row = sweep.panoramas()['left'].image[0].tolist()
    assert 112 in row
    assert 12 not in row
    assert built.drops['frame is 21 × 8 px; allowed: 21 × 7, as the camera_info says'] == 1


def moved(events, seconds, kinds=('joint', 'frame')):
    """Events whose stamps are later by so much, in the same order."""
    by = round(seconds * 1e9)
    return [(stamp + by * (kind in kinds), kind, *rest) for stamp, kind, *rest in events]


def test_frame_of_a_clock_that_was_far_ahead_does_not_stop_the_camera():
    built = assembler()
    built.add_frame(10**15, image(255))
    (sweep,) = play(built, recording(COLUMNS + 2))
    assert 255 not in sweep.panoramas()['left'].image[0]
    assert sweep.complete


def set_back(back, kinds):
    """Two and a half turns, in whose first one clocks are set back by some seconds."""
    events = moved(recording(5 * COLUMNS // 2, frames_per_stop=1), 4000.0)
    return events[:200], moved(events[200:], -back, kinds)


@pytest.mark.parametrize('back', [2.0, 3600.0])
@pytest.mark.parametrize('kinds', [('joint',), ('frame',), ('joint', 'frame')])
def test_clock_that_is_set_back_ends_the_sweep(kinds, back):
    built, said = assembler(), []
    built.clock_set = lambda *told: said.append(told)
    before, after = set_back(back, kinds)
    assert play(built, before) == []
    assert built.sweep is not None
    play(built, after[:30])
    ((told, under_way),) = said
    assert under_way
    whose = 'arm' if 'joint' in kinds else 'camera'
    assert told.startswith(f'the clock of the {whose} was set back by ')
    assert float(told.split()[-2]) == pytest.approx(back, abs=0.5)
    assert built.sweep is None or built.sweep.start > before[-1][0] - back * 1e9


@pytest.mark.parametrize('back', [2.0, 3600.0])
def test_after_clocks_were_set_back_together_the_next_sweep_is_true(back):
    before, after = set_back(back, ('joint', 'frame'))
    (sweep,) = play(assembler(), before + after)
    row = sweep.panoramas()['left'].image[0].tolist()
    first = min(row)
    assert sorted(row) == list(range(first, first + COLUMNS))


def test_single_late_frames_set_no_clock_back():
    built = assembler()
    for k in range(20):
        built.add_frame(1000 + k, image(0))
        built.add_frame(500 + k, image(1))
    assert built.drops['frame out of order or twice'] == 20


def test_frames_without_joint_states_do_not_pile_up():
    built = assembler()
    for k in range(1000):
        built.add_frame(k, image(0))
    assert len(built._pending) <= 200
    assert built.drops['frame: no joint state or camera_info came'] == 800


def test_bad_joint_state_is_dropped_and_counted():
    built = assembler()
    built.add_joint_state(10, 0.0, 0.0)
    built.add_joint_state(10, 0.0, 0.0)
    built.add_joint_state(11, math.nan, 0.0)
    assert built.drops['joint state out of order or twice'] == 1
    assert built.drops['joint state is not finite'] == 1


def test_changed_calibration_gives_the_sweep_up():
    built = assembler()
    play(built, recording(3))
    built.set_camera(CAMERA)
    assert built.sweep is not None
    built.set_camera(PinholeCamera(width=21, height=7, fx=31.0, fy=31.0, cx=10.0, cy=3.0))
    assert built.sweep is None


def test_calibration_that_does_not_fit_the_columns_is_refused():
    with pytest.raises(ValueError, match='outside the image'):
        assembler().set_camera(PinholeCamera(width=15, height=7, fx=9, fy=9, cx=7, cy=3))


def test_frame_of_a_led_arm_that_stands_on_waits_for_no_joint_state():
    built = assembler()
    events = recording(1)
    play(built, events[:-3])
    standstill = built.track.current
    assert built.stands_on(standstill) == []
    assert not built.has_frame_of(standstill)
    play(built, events[-3:-1])
    assert not built.has_frame_of(standstill)
    assert built.sweep is None
    assert built.stands_on(standstill) == []
    assert built.has_frame_of(standstill)
    assert built.sweep.progress == 1 / COLUMNS
    play(built, events[-1:])
    assert built.drops == {'frame: arm moved': 1}


def test_joint_states_that_come_late_do_not_shorten_a_standstill():
    built = assembler()
    events = recording(1)
    play(built, events[:-1])
    standstill = built.track.current
    built.stands_on(standstill)
    end = standstill.end
    built.add_joint_state(end - 1, STEP, 0.0)
    assert standstill.end == end


def test_frames_that_a_driver_held_back_reach_no_column():
    """A driver's queue of four hands out frames exposed long before the arm came to stand."""
    events, queue = [], []
    for stamp, kind, value, velocity in recording(frames_per_stop=1):
        if kind == 'joint':
            events.append((stamp, kind, value, velocity))
        else:
            queue.append((stamp, kind, value, velocity))
            events += [queue.pop(0)] if len(queue) > 4 else []
    built = assembler()
    assert play(built, events) == [], 'the last columns are still in the queue'
    (sweep,) = play(built, queue)
    assert sweep.complete
    shown = sweep.panoramas()['center'].image
    assert not (shown == 255).any(), 'a frame exposed while the arm moved became a column'
    np.testing.assert_array_equal(np.sort(shown[0]), np.arange(1, COLUMNS + 1))
    assert built.drops == {'frame: arm moved': COLUMNS}
