"""Times of a sweep, against motions and cycles worked out by hand."""

import math

import pytest

from panodepth_ros.analysis.capture_time import (
    Motor,
    continuous,
    safe_speed,
    stop_and_go,
    widest_stripe,
)
from panodepth_ros.arm.motion import chain

STEP = math.radians(0.2)
MOTOR = Motor(speed=math.radians(30), acceleration=math.radians(3600))


@pytest.mark.parametrize('degrees', [0.2, 0.24, 0.25, 0.26, 1.0, 360.0])
def test_moving_time_is_that_of_the_simulated_arm(degrees):
    way = math.radians(degrees)
    pieces, _ = chain(0.0, 0.0, 0.0, [(way, MOTOR.speed)], MOTOR.acceleration)
    assert MOTOR.moving_time(way) == pytest.approx(pieces[-1].begin, rel=1e-12)


def test_stop_and_go_takes_whole_frames():
    # 2·√(0.2/3600) s = 14.9 ms of motion fit between two frames of 60 Hz: every second frame.
    assert stop_and_go(1800, STEP, MOTOR, 60.0).duration == pytest.approx(1800 * 2 / 60)
    # With 2 ms to settle they do not: every third.
    shaky = Motor(speed=MOTOR.speed, acceleration=MOTOR.acceleration, settle_time=0.002)
    assert stop_and_go(1800, STEP, shaky, 60.0).duration == pytest.approx(1800 * 3 / 60)


def test_stripes_need_fewer_stops():
    # 1° takes 1/30 + 30/3600 s = 41.7 ms: three frames of 60 Hz, and the one that is exposed.
    took = stop_and_go(1801, STEP, MOTOR, 60.0, stripe=5)
    assert took.frames == 361
    assert took.duration == pytest.approx(361 * 4 / 60)
    assert (took.arm_speed, took.longest_exposure) == (0.0, math.inf)


def test_continuous_turns_as_fast_as_the_camera_sees():
    took = continuous(1800, STEP, MOTOR, 60.0)
    assert math.degrees(took.arm_speed) == pytest.approx(12.0)
    assert took.duration == pytest.approx(30.0 + 2 * 12 / 3600)
    assert took.longest_exposure == pytest.approx(0.1 / 12)


def test_safe_speed_turns_half_a_column_within_the_exposure():
    assert math.degrees(safe_speed(0.005, STEP)) == pytest.approx(0.1 / 0.005)
    took = continuous(1800, STEP, MOTOR, 60.0)
    assert safe_speed(took.longest_exposure, STEP) == pytest.approx(took.arm_speed)
    for exposure in (0.0, -0.001, math.nan, math.inf):
        with pytest.raises(ValueError, match=r'exposure is .* ms; allowed: finite and above 0'):
            safe_speed(exposure, STEP)


def test_continuous_is_limited_by_the_motor():
    took = continuous(1800, STEP, MOTOR, 60.0, stripe=5)
    assert math.degrees(took.arm_speed) == pytest.approx(30.0)
    assert took.duration == pytest.approx(12.0 + 2 * 30 / 3600)


def test_widest_stripe_reaches_the_edge_or_the_middle_of_the_image():
    view = math.radians(34)
    assert widest_stripe(math.radians(15.0), view, STEP) == 20
    assert widest_stripe(math.radians(0.5), view, STEP) == 5
    assert widest_stripe(math.radians(17.0), view, STEP) == 1


@pytest.mark.parametrize(
    ('arguments', 'named'),
    [
        ({'speed': 0.0, 'acceleration': 1.0}, 'speed'),
        ({'speed': 1.0, 'acceleration': math.inf}, 'acceleration'),
        ({'speed': 1.0, 'acceleration': 1.0, 'settle_time': -0.1}, 'settle_time'),
    ],
)
def test_impossible_motor_is_refused_by_name(arguments, named):
    with pytest.raises(ValueError, match=f'motor {named} is .* allowed'):
        Motor(**arguments)


@pytest.mark.parametrize('mode', [stop_and_go, continuous])
@pytest.mark.parametrize(
    ('rate', 'stripe', 'named'), [(0.0, 1, 'frame_rate'), (30.0, 0, 'stripe')]
)
def test_impossible_capture_is_refused_by_name(mode, rate, stripe, named):
    with pytest.raises(ValueError, match=f'{named} is .* allowed'):
        mode(1800, STEP, MOTOR, rate, stripe=stripe)
