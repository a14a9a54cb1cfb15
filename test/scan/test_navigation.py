"""Paths planned on a scan's map, against the true room; what is asked must be able to fail."""

import math

import numpy as np
import pytest

from benchmarks import occupancy
from benchmarks.navigation import MARGIN, RADIUS, navigate, simulated
from benchmarks.occupancy import CELL, FREE, OCCUPIED, UNKNOWN
from panodepth_ros.scan.beams import ScanSettings

SETTINGS = ScanSettings()


def grid_of(ranges, **change):
    limits = {'range_min': SETTINGS.range_min, 'range_max': SETTINGS.range_max}
    return occupancy.occupancy(np.asarray(ranges, float), **(limits | change))


def at(grid, x, y):
    return grid[tuple(occupancy.to_cells(np.array([x, y]), CELL))]


def test_map_of_a_scan():
    ranges = np.full(720, 2.0)
    ranges[170:190] = np.nan  # −90°
    ranges[530:550] = np.inf  # +90°
    grid = grid_of(ranges)
    assert at(grid, 1.0, 0.0) == FREE
    assert at(grid, 2.01, 0.0) == OCCUPIED
    assert at(grid, 2.3, 0.0) == UNKNOWN
    assert at(grid, 0.0, -1.0) == UNKNOWN
    assert at(grid, 0.0, -0.2) == FREE  # the robot stands there
    assert at(grid, 0.0, 4.5) == FREE


def test_a_path_keeps_off_obstacles_and_unknown_cells():
    # A wall 1 m ahead with a door of 0.8 m: through the door, or not at all if that is narrower.
    for width, found in ((0.8, True), (0.5, False)):
        azimuth = -np.pi + np.arange(720) * (2 * np.pi / 720)
        ahead = np.cos(azimuth) > 0.2
        wall = np.where(ahead, 1.0 / np.where(ahead, np.cos(azimuth), 1.0), np.inf)
        through = np.abs(np.tan(azimuth)) < width / 2
        ranges = np.where(through & ahead, 3.0, np.minimum(wall, 3.0))
        (path,) = occupancy.plan(grid_of(ranges), np.array([[2.0, 0.0]]), RADIUS + MARGIN)
        assert (path is not None) == found
        if found:
            assert np.hypot(*np.diff(path, axis=0).T).max() <= math.sqrt(2) * CELL + 1e-9
            assert path[-1] == pytest.approx([2.0, 0.0], abs=CELL)


@pytest.fixture(scope='module')
def scan():
    return simulated(3, SETTINGS)


@pytest.fixture(scope='module')
def outcomes(scan):
    scans = {'truth': scan.truth, 'ours': scan.ranges, 'too far': 1.2 * scan.truth}
    scans['blind'] = np.full(SETTINGS.beams, np.nan)
    return navigate(scan.edges, scans, SETTINGS, np.random.default_rng(1))


def test_true_scan_finds_goals_without_collision(outcomes):
    # A thin thing between two beams is not in the map of the truth either.
    assert outcomes['truth'].free > 0.9
    assert outcomes['truth'].found > 0.5


def test_our_scan_leads_to_the_goals_that_the_truth_leads_to(outcomes):
    assert outcomes['ours'].free > outcomes['truth'].free - 0.05
    assert outcomes['ours'].found > 0.5 * outcomes['truth'].found


def test_a_scan_that_is_too_far_collides(outcomes):
    assert outcomes['too far'].free < outcomes['truth'].free - 0.05


def test_a_blind_scan_finds_next_to_nothing(outcomes):
    assert outcomes['blind'].found < 0.1  # goals beside the robot


def test_errors_of_beams_fit_their_standard_deviations(scan):
    size = np.abs((scan.ranges - scan.perfect) / scan.stddev)
    assert 0.5 < np.nanmean(size <= 1) < 0.95
    assert np.nanmean(size <= 3) > 0.75
