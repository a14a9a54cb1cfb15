"""Standing still is proven by odometry without gaps, or not at all."""

import dataclasses
import math

import pytest

from panodepth_ros.motion.standstill import Odometry, Standstill, StillLimits

LIMITS = StillLimits(distance=0.01, turn=math.radians(0.3), speed=0.01, turn_rate=0.02)
HERE = Odometry(time=0.0, frame='odom', x=3.0, y=4.0, yaw=math.pi, speed=0.0, turn_rate=0.0)


def watched(*changes, since=10.0, first=9.5, step=0.5):
    """Odometry every half second; the sweep ends at 10 s, the third is the first change."""
    standstill = Standstill(LIMITS)
    rest = [{}, {}, *changes]
    for k, change in enumerate(rest):
        standstill.add(dataclasses.replace(HERE, **({'time': first + step * k} | change)))
        if k == 1:
            standstill.since(since)
    return standstill, first + step * (len(rest) - 1)


def test_standing_is_proven():
    standstill, now = watched(*[{'x': 3.005, 'yaw': -math.pi + 0.001, 'speed': 0.005}] * 10)
    assert standstill.doubt(now) == ''


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        ({'x': 3.02}, 'moved by 0.020 m; allowed: 0.01 m'),
        ({'y': 3.9}, 'moved by 0.100 m'),
        ({'yaw': math.pi - 0.01}, 'turned by 0.573°; allowed: 0.3°'),
        ({'speed': 0.02}, 'went at 0.020 m/s'),
        ({'turn_rate': 0.03}, 'turned at 1.719 °/s'),
        ({'frame': 'odom2'}, 'from frame odom to odom2'),
        ({'time': 12.0}, 'odometry jumped by 2.0 s'),
        ({'time': 9.0}, 'odometry jumped by -1.0 s'),
        ({'x': math.nan}, 'moved by nan m'),
        ({'speed': math.nan}, 'went at nan m/s'),
    ],
)
def test_any_motion_is_a_doubt_that_stays(change, words):
    standstill, now = watched(change, {}, {}, {})
    assert words in standstill.doubt(now)


def test_a_drift_in_small_steps_is_motion():
    standstill, now = watched(*({'x': 3.0 + 0.002 * k} for k in range(8)))
    assert 'moved by 0.0' in standstill.doubt(now)


def test_motion_between_the_end_of_the_sweep_and_its_scan_counts():
    standstill = Standstill(LIMITS)
    for k in range(8):
        standstill.add(dataclasses.replace(HERE, time=9.5 + 0.5 * k, speed=0.1 * (k == 3)))
    standstill.since(10.0)
    assert 'went at' in standstill.doubt(13.0)
    standstill.since(12.0)
    assert standstill.doubt(13.0) == ''


def test_silence_is_a_doubt_that_stays():
    standstill, now = watched()
    assert standstill.doubt(now + 0.9) == ''
    assert 'silent for 1.5 s' in standstill.doubt(now + 1.5)
    standstill.add(dataclasses.replace(HERE, time=now + 1.6))
    assert 'silent' in standstill.doubt(now + 1.6)


@pytest.mark.parametrize('since', [9.0, 20.0])
def test_no_odometry_at_the_end_of_the_sweep(since):
    standstill, now = watched(since=since)
    assert 'no odometry at the end of the sweep' in standstill.doubt(now)


def test_never_any_odometry():
    standstill = Standstill(LIMITS)
    standstill.since(1.0)
    assert not standstill.heard
    assert standstill.doubt(1.0) == 'there is no odometry'


def test_odometry_from_the_future_proves_nothing():
    standstill, now = watched()
    assert standstill.doubt(now - 0.9) == ''
    assert 'stamped 5.0 s ahead of the clock' in standstill.doubt(now - 5.0)
    standstill.add(dataclasses.replace(HERE, time=now + 0.5))
    assert 'ahead' in standstill.doubt(now + 0.5), 'the doubt stays'


def heeding(*changes, since=10.0):
    standstill = Standstill(LIMITS, proof=False)
    standstill.since(since)
    for change in changes:
        standstill.add(dataclasses.replace(HERE, **change))
    return standstill.told


@pytest.mark.parametrize(
    'changes',
    [
        (),
        ({'time': 10.0}, {'time': 100.0}),
        ({'time': 10.0}, {'time': 11.0, 'x': 9.0, 'frame': 'odom2'}),
        ({'time': 10.0}, {'time': 1.0, 'x': 9.0}),
    ],
    ids=['none', 'silence', 'another frame', 'back in time'],
)
def test_without_need_of_proof_only_motion_is_a_doubt(changes):
    assert heeding(*changes) == ''


@pytest.mark.parametrize(
    'changes',
    [
        ({'time': 10.0, 'speed': 0.5},),
        ({'time': 10.0}, {'time': 100.0, 'x': 3.1}),
        (
            {'time': 10.0},
            {'time': 11.0, 'x': 9.0, 'frame': 'b'},
            {'time': 12.0, 'x': 9.1, 'frame': 'b'},
        ),
    ],
    ids=['velocity of the first', 'after silence', 'in another frame'],
)
def test_without_need_of_proof_motion_is_a_doubt_still(changes):
    assert 'the robot' in heeding(*changes)


@pytest.mark.parametrize(('heard', 'doubt'), [(9.5, True), (5.0, False)])
def test_without_need_of_proof_the_last_odometry_before_counts_if_it_is_near(heard, doubt):
    standstill = Standstill(LIMITS, proof=False)
    standstill.add(dataclasses.replace(HERE, time=heard))
    standstill.add(dataclasses.replace(HERE, time=10.1, x=3.1))
    standstill.since(10.0)
    assert bool(standstill.told) == doubt
