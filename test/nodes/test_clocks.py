"""Clocks of arm and camera that are set in the middle of a sweep: refused or true, never wrong."""

import time

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.mosaicer import COLUMNS, Bench, TurningBench

from panodepth_ros.ros.images import to_array

pytestmark = pytest.mark.ros


def future(rig):
    """How far a clock of the rig must be off to be ahead of this computer's [s]."""
    return (time.time_ns() - rig.now) * 1e-9 + 3600.0


def true_panorama(bench):
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    first = min(row)
    return sorted(row) == list(range(first, first + COLUMNS))


@pytest.fixture
def stepping(ros):
    bench = Bench(ros, frame_timeout=0.2).ready()
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 20, 'a third of the sweep')
    return bench


@pytest.fixture
def turning(ros):
    bench = TurningBench(ros)
    bench.start()
    bench.told(True)
    bench.turn(20)
    return bench


def stands_until_given_up(bench):
    bench.ros.spin_until(
        lambda: bench.rig.standing() or not bench.mosaicer._leading, 'the end of the sweep'
    )
    bench.given_up()


def heard_all(bench):
    """Let the mosaicer hear all joint states that are under way, and a last one."""
    bench.rig.standing()
    last = bench.rig.now + round(bench.rig.arm_clock * 1e9)
    bench.ros.spin_until(lambda: bench.mosaicer._assembler.track.newest == last, 'the last one')


@pytest.mark.parametrize('back', [2.0, 500.0])
def test_arm_whose_clock_is_set_back_ends_the_sweep_of_steps(stepping, capfd, back):
    stepping.rig.arm_clock = -back
    stands_until_given_up(stepping)
    said = capfd.readouterr().err
    assert 'given up, nothing is published: the clock of the arm was set back by' in said
    # As long as only one of the clocks was set, no frame is taken; then all is well again.
    diagnosis = Diagnosis(stepping.ros, 'mosaicer: sweep')
    heard_all(stepping)
    stepping.start()
    values = diagnosis.says(DiagnosticStatus.WARN, 'frame 1 of 60: waiting for a frame')
    assert values['columns'] == '0'
    reason = 'dropped, frame: stamped ahead of all joint states, by more than joint_state_gap'
    assert int(values[reason]) > 0
    stepping.rig.camera_clock = -back
    stepping.rig.frame()
    stepping.rig.standing()
    assert true_panorama(stepping)


def test_arm_whose_clock_is_ahead_ends_the_sweep_of_steps(stepping, capfd):
    stepping.rig.arm_clock = future(stepping.rig)
    stepping.given_up()
    assert "0 s ahead of this computer's clock; let all" in capfd.readouterr().err
    stepping.rig.arm_clock = 0.0
    heard_all(stepping)
    stepping.start()
    assert true_panorama(stepping)


@pytest.mark.parametrize('ahead', [2.0, 500.0, None])
def test_frames_of_a_clock_that_is_ahead_are_not_used(stepping, ahead):
    stepping.rig.camera_clock = future(stepping.rig) if ahead is None else ahead
    diagnosis = Diagnosis(stepping.ros, 'mosaicer: sweep')
    diagnosis.says(DiagnosticStatus.WARN, 'waiting for a frame')
    assert stepping.rig.steps == 21
    stepping.rig.camera_clock = 0.0
    stepping.rig.frame()
    stepping.rig.standing()
    assert true_panorama(stepping)


def test_frames_that_overtake_the_joint_states_of_a_bag_are_kept(ros):
    bench = Bench(ros, lead=False).ready()
    bench.rig.later(5000)
    bench.rig.frame()
    ros.spin_until(lambda: bench.mosaicer._assembler._pending, 'the frame')
    assert not bench.mosaicer._assembler.drops


@pytest.mark.parametrize('clock', ['arm_clock', 'camera_clock'])
def test_clock_that_is_set_back_ends_the_sweep_of_a_turning_arm(turning, capfd, clock):
    setattr(turning.rig, clock, -2.0)
    for _ in turning.rig.turn(8):
        turning.ros.executor.spin_once(timeout_sec=0.0)
    turning.given_up()
    turning.told(True, False)
    whose = clock.partition('_')[0]
    assert f'published: the clock of the {whose} was set back by' in capfd.readouterr().err


def test_arm_whose_clock_is_ahead_ends_the_sweep_of_its_turn(turning, capfd):
    turning.rig.arm_clock = future(turning.rig)
    next(turning.rig.turn(1))
    turning.given_up()
    turning.told(True, False)
    assert "ahead of this computer's clock" in capfd.readouterr().err
