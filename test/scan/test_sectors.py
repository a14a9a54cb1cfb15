"""Which beams are decided by which columns, and the newest measurement of each."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import PanoramaGeometry, Points, triangulate
from panodepth_ros.scan.beams import ScanSettings, laser_ranges
from panodepth_ros.scan.sectors import SectorScan, columns_of_beams, oldest_of_columns

COLUMNS, ROWS, PHI = 360, 12, math.radians(15.0)
STEP = 2 * math.pi / COLUMNS


def geometry(sign, stripe=1):
    fan = (np.arange(COLUMNS) % stripe - (stripe - 1) / 2) * STEP
    return PanoramaGeometry(
        columns=COLUMNS,
        rows=ROWS,
        azimuth_column=171.3 + sign * PHI / STEP,
        focal_length_px=100.0,
        principal_row=5.5,
        arm_radius=0.3,
        principal_angle=sign * PHI,
        sweep_duration=1.0,
        ray_angle=sign * PHI + fan,
        stripe_distance=math.inf if stripe == 1 else 2.0,
    )


def points(stripe=1):
    """Things nearby or far away at random, in blocks of three columns."""
    rng = np.random.default_rng(2)
    blocks = rng.choice([4.0, 28.0], (1, COLUMNS // 3)) + rng.uniform(-1, 1, (1, COLUMNS // 3))
    disparity = np.tile(np.repeat(blocks, 3, axis=1), (ROWS, 1)).astype(np.float32)
    return triangulate(disparity, geometry(-1, stripe), geometry(1, stripe))


@pytest.mark.parametrize('stripe', [1, 5])
@pytest.mark.parametrize('beams', [90, 720])
def test_beams_name_every_column_that_may_have_a_part_in_them(stripe, beams):
    settings = ScanSettings(beams=beams)
    columns = columns_of_beams(geometry(-1, stripe), settings)
    found = points(stripe)
    known = np.isfinite(found.radial_distance)
    azimuth = np.where(known, found.azimuth, 0.0)
    beam = np.rint((azimuth + np.pi) / settings.angle_increment).astype(int) % beams
    assert known.mean() > 0.9
    for y, x in zip(*np.nonzero(known), strict=True):
        assert x in columns[beam[y, x]]
    assert columns.shape[1] < 40, 'not just any column'


def test_decided_beams_are_those_of_the_whole_scan():
    settings = ScanSettings(beams=180, min_support=1.0)
    found, confidence = points(), np.full((ROWS, COLUMNS), 0.9, np.float32)
    whole = laser_ranges(found, confidence, settings)
    ready = np.zeros(COLUMNS, bool)
    ready[40:150] = True
    partial = np.where(ready, confidence, np.nan).astype(np.float32)
    distance = np.where(ready, found.radial_distance, np.nan)
    ranges = laser_ranges(Points(distance, found.azimuth, found.height), partial, settings)
    decided = ready[columns_of_beams(geometry(-1), settings)].all(axis=1)
    assert 25 < decided.sum() < 55
    assert np.array_equal(ranges[decided], whole[decided], equal_nan=True)
    others = np.isfinite(ranges) & ~decided
    assert (ranges[others] != whole[others]).any(), 'those at the end are wrong'


def test_oldest_of_columns_that_wrap_around():
    time = np.random.default_rng(3).permutation(20).astype(np.int64)
    for first, last in ((1, 4), (-2, 3)):
        expected = [min(time[(x + k) % 20] for k in range(first, last + 1)) for x in range(20)]
        assert oldest_of_columns(time, first, last).tolist() == expected


def test_newest_measurement_wins_and_the_old_is_forgotten_on_demand():
    scan = SectorScan(4)
    assert np.isnan(scan.ranges).all()
    first = np.array([1, 2, 3, 4], np.float32)
    scan.take(np.array([1, 1, 1, 0], bool), first, np.full(4, 10**9))
    second = np.array([5, np.nan, 7, 8], np.float32)
    scan.take(np.array([1, 1, 0, 0], bool), second, np.full(4, 3 * 10**9))
    assert np.array_equal(scan.ranges, np.array([5, np.nan, 3, np.nan]), equal_nan=True)
    assert np.array_equal(scan.age(4 * 10**9), np.array([1, np.nan, 3, np.nan]), equal_nan=True)
    scan.forget_before(2 * 10**9)
    assert np.array_equal(scan.ranges, np.array([5] + 3 * [np.nan]), equal_nan=True)
