"""Motion through targets and braking as pieces of constant acceleration."""

import itertools
import math

import numpy as np
import pytest

from panodepth_ros.arm.motion import brake, chain, state_at


def check_continuous(pieces):
    for piece, following in itertools.pairwise(pieces):
        azimuth, velocity = piece.at(following.begin)
        assert azimuth == pytest.approx(following.azimuth, abs=1e-9)
        assert velocity == pytest.approx(following.velocity, abs=1e-9)
    assert pieces[-1].velocity == pieces[-1].acceleration == 0.0


@pytest.mark.parametrize('sign', [1, -1])
def test_long_motion_has_three_phases(sign):
    # 2 rad/s at 4 rad/s²: 0.5 s and 0.5 rad each to speed up and brake; 9 rad in 4.5 s between.
    pieces, ends = chain(10.0, 1.0, 0.0, [(1.0 + sign * 10.0, 2.0)], 4.0)
    assert ends == [pieces[-1].begin]
    check_continuous(pieces)
    assert [piece.begin for piece in pieces] == pytest.approx([10.0, 10.5, 15.0, 15.5])
    assert pieces[-1].azimuth == 1.0 + sign * 10.0
    assert state_at(pieces, 12.5) == pytest.approx((1.0 + sign * 4.5, sign * 2.0))


def test_short_motion_does_not_reach_its_speed():
    # Half of 0.2° at 3600 °/s² takes sqrt(2 · 0.1 / 3600) s = 7.45 ms.
    pieces, _ = chain(0.0, 0.0, 0.0, [(math.radians(0.2), math.radians(60.0))], math.radians(3600))
    check_continuous(pieces)
    assert pieces[-1].begin == pytest.approx(14.907e-3, abs=1e-6)
    times = np.linspace(0.0, 0.015, 100)
    speeds = [state_at(pieces, t)[1] for t in times]
    assert math.degrees(max(speeds)) == pytest.approx(26.8, abs=0.4)


def test_no_way_is_no_motion():
    assert chain(3.0, 1.0, 0.0, [], 4.0) == ([(3.0, 1.0, 0.0, 0.0)], [])


@pytest.mark.parametrize('sign', [1, -1])
def test_moves_of_one_direction_blend_into_each_other(sign):
    moves = [(sign * 3.0, 2.0), (sign * 6.0, 2.0), (sign * 9.0, 1.0)]
    pieces, ends = chain(0.0, 0.0, 0.0, moves, 4.0)
    check_continuous(pieces)
    speeds = [sign * state_at(pieces, end)[1] for end in ends]
    assert speeds == pytest.approx([2.0, 1.0, 0.0])
    assert [state_at(pieces, end)[0] for end in ends] == pytest.approx([t for t, _ in moves])


def test_moves_slow_down_early_enough_for_short_ones_and_stop_to_turn_back():
    moves = [(3.0, 2.0), (3.1, 2.0), (0.0, 2.0)]
    pieces, ends = chain(0.0, 0.0, 0.0, moves, 4.0)
    check_continuous(pieces)
    assert state_at(pieces, ends[0])[1] == pytest.approx(math.sqrt(2 * 4.0 * 0.1))
    assert state_at(pieces, ends[1]) == pytest.approx((3.1, 0.0))


def test_motion_goes_on_from_a_velocity():
    pieces, ends = chain(1.0, 5.0, 2.0, [(9.0, 2.0)], 4.0)
    check_continuous(pieces)
    assert state_at(pieces, 1.0) == pytest.approx((5.0, 2.0))
    assert ends == pytest.approx([1.0 + 3.5 / 2.0 + 0.5])


@pytest.mark.parametrize('velocity', [1.5, -1.5, 0.2, -0.01, 0.0])
def test_braking_ends_on_a_motor_step_near_where_it_would(velocity):
    grid, origin = 0.01, 0.003
    pieces = brake(5.0, 0.7, velocity, 4.0, grid, origin)
    end = pieces[-1].azimuth
    assert (end - origin) / grid == pytest.approx(round((end - origin) / grid), abs=1e-9)
    assert end == pytest.approx(0.7 + velocity * abs(velocity) / 8.0, abs=grid / 2 + 1e-12)
    if len(pieces) > 1:
        check_continuous(pieces)
