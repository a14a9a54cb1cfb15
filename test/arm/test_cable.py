"""How far the arm may turn, and where it turns back to."""

import math

import pytest

from panodepth_ros.arm.cable import Cable
from panodepth_ros.arm.errors import ArmLimitError
from panodepth_ros.arm.grid import StepGrid

DEG = math.pi / 180.0
FARTHEST = 80000.0
STEP = 0.04


def cable(limit):
    return Cable(limit * DEG, FARTHEST * DEG, STEP * DEG)


def test_turn_beyond_the_limit_is_refused_with_what_to_do():
    with pytest.raises(
        ArmLimitError, match=r'from 359\.900° to 360\.100° is beyond cable_limit_deg'
    ):
        cable(360.0).require(359.9 * DEG, 360.1 * DEG)
    with pytest.raises(ArmLimitError, match='±360°; call ~/unwind or ~/home'):
        cable(360.0).require(0.0, -361 * DEG)


@pytest.mark.parametrize(('here', 'target'), [(0.0, 360.0), (0.0, -360.0), (500.0, 499.0)])
def test_turn_to_the_limit_or_back_to_it_is_allowed(here, target):
    cable(360.0).require(here * DEG, target * DEG)


def test_endless_axis_ends_where_the_controller_counts_no_more():
    cable(0.0).require(0.0, 79999 * DEG)
    with pytest.raises(ArmLimitError, match='beyond what the controller counts exactly'):
        cable(0.0).require(0.0, 80001 * DEG)


@pytest.mark.parametrize(
    ('limit', 'here', 'direction', 'unwound'),
    [
        (360.0, 0.0, 1, -360.0),
        (360.0, -0.2, 1, -0.2),
        (360.0, 0.2, 1, -359.8),
        (360.0, 360.0, 1, -360.0),
        (360.0, 0.2, -1, 0.2),
        (360.0, -360.0, 1, -360.0),
        (180.0, 180.0, 1, -180.0),
        (180.0, 0.0, 1, -180.0),
        (200.0, 10.0, 1, -200.0),
        (0.0, 5000.0, 1, 5000.0),
        (0.0, 79999.0, 1, 79639.0),
    ],
)
def test_unwinding_makes_room_for_a_whole_turn_and_a_step(limit, here, direction, unwound):
    step = direction * 0.2
    assert cable(limit).unwound(here * DEG, step * DEG) / DEG == pytest.approx(unwound)
    turn = direction * 360 + (step if limit != 180 else 0)
    assert direction * (unwound + turn) <= (limit or FARTHEST) + STEP


@pytest.mark.parametrize('step', [0.2, -0.2])
def test_grid_counts_whole_steps_from_its_origin(step):
    grid = StepGrid(step)
    grid.begin(1.0)
    index, target = grid.next(1.0)
    assert (index, target) == (1, pytest.approx(1.0 + step))
    grid.reached(index)
    assert grid.next(123.0) == (2, pytest.approx(1.0 + 2 * step))  # where it was sent counts
    grid.lose()
    assert grid.next(1.0 + 10.3 * step) == (11, pytest.approx(1.0 + 11 * step))
