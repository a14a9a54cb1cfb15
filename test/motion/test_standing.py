"""Since when a robot stands, by its odometry."""

import math

import pytest

from panodepth_ros.motion.standing import Standing
from panodepth_ros.motion.standstill import Odometry, StillLimits

LIMITS = StillLimits(distance=0.01, turn=0.01, speed=0.01, turn_rate=0.01)


def odometry(time, x=0.0, speed=0.0, frame='odom'):
    return Odometry(time=time, frame=frame, x=x, y=0.0, yaw=0.0, speed=speed, turn_rate=0.0)


def heard(*odometries):
    standing = Standing(LIMITS)
    for each in odometries:
        standing.add(each)
    return standing


def test_nothing_is_proven_without_odometry():
    standing = heard()
    assert standing.proven_since(1.0) == math.inf
    assert standing.moved == -math.inf


def test_standing_is_proven_from_the_first_odometry_on():
    standing = heard(*(odometry(0.5 * k) for k in range(2, 9)))
    assert standing.proven_since(4.5) == 1.0
    assert standing.moved == -math.inf
    assert standing.proven_since(5.5) == math.inf, 'silent'


@pytest.mark.parametrize(
    'motion', [{'speed': 0.2}, {'x': 0.02}, {'speed': math.nan}], ids=['speed', 'place', 'nan']
)
def test_motion_ends_at_the_first_odometry_of_a_standing_robot(motion):
    before = [odometry(0.5 * k) for k in range(2, 9)]
    moving = odometry(4.5, **motion)
    standing = heard(*before, moving)
    assert standing.moved == 4.5
    assert standing.proven_since(4.6) == math.inf
    for time in (5.0, 5.5):
        standing.add(odometry(time, x=motion.get('x', 0.0)))
    assert standing.moved == 5.0
    assert standing.proven_since(5.6) == 5.0


def test_slow_creeping_is_a_motion_in_the_end():
    standing = heard(*(odometry(0.5 * k, x=0.002 * k) for k in range(12)))
    assert 2.5 <= standing.moved <= 5.5


@pytest.mark.parametrize(
    'odd', [odometry(9.0), odometry(4.5, frame='map')], ids=['gap', 'another frame']
)
def test_what_cannot_be_compared_proves_nothing_and_tells_of_no_motion(odd):
    standing = heard(*(odometry(0.5 * k) for k in range(2, 9)), odd)
    assert standing.moved == -math.inf
    assert standing.proven_since(odd.time) == odd.time


def test_time_that_begins_anew_forgets_motions():
    standing = heard(odometry(100.0, speed=1.0), odometry(1.0))
    assert standing.moved == 1.0, 'the last thing heard was a motion'
    assert standing.proven_since(1.0) == 1.0
