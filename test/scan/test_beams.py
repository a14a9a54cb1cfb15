"""Points to beams."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import Points
from panodepth_ros.scan.beams import ScanSettings, beam_confidence, laser_ranges

BEAMS = 360


def scan(points, *, confidence=1.0, **change):
    """Scan of (distance, azimuth, height[, confidence]) tuples, as a panorama of one row."""
    columns = np.array([(*point, confidence)[:4] for point in points], dtype=np.float64)
    distance, azimuth, height, sure = columns.T[:, np.newaxis, :]
    values = {'beams': BEAMS, 'min_support': 0.0, 'range_max': 10.0, 'min_confidence': 0.5}
    return laser_ranges(
        Points(distance, azimuth, height), sure.astype(np.float32), ScanSettings(**values | change)
    )


@pytest.mark.parametrize(
    ('azimuth', 'beam'),
    [
        (0.0, 180),
        (math.radians(1), 181),
        (math.radians(-1.4), 179),
        (-math.pi, 0),
        (math.pi - 1e-9, 0),
        (math.radians(179.4), 359),
    ],
)
def test_beams_run_counter_clockwise_from_minus_pi(azimuth, beam):
    ranges = scan([(2.0, azimuth, 0.0)])
    assert np.flatnonzero(np.isfinite(ranges)).tolist() == [beam]
    assert ranges[beam] == 2.0
    assert ranges.dtype == np.float32


def test_nearest_surface_of_a_beam_counts():
    assert scan([(3.0, 0.0, 0.0), (2.0, 0.0, 0.1), (2.5, 0.0, 0.0)])[180] == 2.0


def test_surface_needs_support_at_its_own_distance():
    speckle = [(1.2, 0.0, 0.0), (1.23, 0.0, 0.0)]
    wall = [(2.0, 0.0, 0.0), (2.02, 0.0, 0.05), (2.04, 0.0, -0.05)] * 3
    assert scan(speckle + wall, min_support=7.0)[180] == pytest.approx(2.02)
    assert np.isnan(scan(speckle, min_support=7.0)[180])


@pytest.mark.parametrize(
    ('pixels', 'distance', 'expected'),
    [(1, 1.5, 2.0), (2, 1.5, math.nan), (2, 1.9, 2.0)],
)
def test_a_third_of_the_support_hides_what_is_clearly_behind(pixels, distance, expected):
    thing = [(distance, 0.0, 0.0)] * pixels
    wall = [(2.0, 0.0, 0.0)] * 6
    assert scan(thing + wall, min_support=6.0)[180] == pytest.approx(expected, nan_ok=True)
    assert scan(thing + [(11.0, 0.0, 0.0)] * 6, min_support=6.0)[180] == pytest.approx(
        math.inf if pixels == 1 else math.nan, nan_ok=True
    )


def test_what_lies_beyond_range_max_hides_nothing():
    far = [(11.0, 0.0, 0.0)] * 2 + [(14.0, 0.0, 0.0)] * 6
    assert scan(far, min_support=6.0)[180] == math.inf


def test_surface_may_begin_with_nearer_pixels_of_another_beam():
    beside = [(2.0, math.radians(1), 0.0)] * 3
    assert scan([*beside, (2.06, 0.0, 0.0)], min_support=3.5)[180] == pytest.approx(2.06)


def test_range_is_taken_from_half_as_much_again_as_a_surface_is_deep():
    # It begins at 2 m, 6 % end at 2.12 m.
    own = [(2.0, 0.0, 0.0), (2.04, 0.0, 0.0), (2.11, 0.0, 0.0), (2.15, 0.0, 0.0)]
    assert scan(own, min_support=2.0)[180] == pytest.approx(2.04)


def test_pixels_support_a_surface_by_their_confidence():
    edge = [(2.0, 0.0, 0.0, 0.6)] * 4
    assert scan(edge, min_support=2.3)[180] == 2.0
    assert np.isnan(scan(edge, min_support=2.5)[180])


@pytest.mark.parametrize(('pixels', 'expected'), [(16, 0.6), (15, math.nan), (5, 2.0)])
def test_near_surface_needs_more_support(pixels, expected):
    near = [(0.6, 0.0, 0.0)] * pixels  # half of 1.2 m: eight times the support
    wall = [(2.0, 0.0, 0.0)] * 2
    elsewhere = [(math.nan, 0.0, 0.0)] * 5000
    ranges = scan(near + wall + elsewhere, min_support=2.0)
    assert ranges[180] == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize(('pixels', 'supported'), [(10, True), (9, False)])
def test_a_quarter_of_a_coarse_view_is_support_enough(pixels, supported):
    # 2880 pixels are 8 a beam, 40 within two degrees; eight times the support would be 16.
    elsewhere = [(math.nan, 0.0, 0.0)] * (2880 - pixels)
    ranges = scan([(0.6, 0.0, 0.0)] * pixels + elsewhere, min_support=2.0)
    assert np.isfinite(ranges[180]) == supported


@pytest.mark.parametrize(('away', 'supported'), [(2.0, True), (3.0, False)])
def test_support_may_come_from_beams_within_two_degrees(away, supported):
    points = [(2.0, 0.0, 0.0)] + [(2.0, math.radians(away), 0.0)] * 2
    ranges = scan(points, min_support=2.5)
    assert np.isfinite(ranges[180]) == supported
    assert np.isnan(ranges[181]), 'a beam without a pixel of its own stays unknown'


def test_support_is_found_across_the_seam():
    points = [(2.0, -math.pi, 0.0)] + [(2.0, math.pi - math.radians(1), 0.0)] * 2
    ranges = scan(points, min_support=2.5)
    assert np.flatnonzero(np.isfinite(ranges)).tolist() == [0, BEAMS - 1]


def test_surfaces_of_different_distance_do_not_support_each_other():
    points = [(2.0, 0.0, 0.0), (2.12, 0.0, 0.0), (2.25, 0.0, 0.0)]
    assert np.isnan(scan(points, min_support=1.5)[180])


def test_range_is_the_median_of_the_beams_own_pixels():
    points = [(2.0, 0.0, 0.0), (2.02, 0.0, 0.0), (2.05, 0.0, 0.0), (2.06, math.radians(1), 0.0)]
    assert scan(points, min_support=3.5)[180] == pytest.approx(2.02)


def test_only_the_height_band_counts():
    points = [(1.0, 0.0, 0.151), (1.1, 0.0, -0.151), (2.0, 0.0, 0.149)]
    assert scan(points)[180] == 2.0


def test_only_confident_pixels_count():
    points = [(1.0, 0.0, 0.0, 0.49), (1.2, 0.0, 0.0, np.nan), (2.0, 0.0, 0.0, 0.5)]
    assert scan(points)[180] == 2.0


def test_unknown_far_and_near_are_told_apart():
    ranges = scan([(11.0, 0.0, 0.0), (0.2, math.radians(1), 0.0), (np.nan, math.radians(2), 0.0)])
    assert ranges[180] == math.inf
    assert ranges[181] == -math.inf
    assert np.isnan(ranges[182])
    assert np.isnan(ranges[0])


def test_limits_of_range_and_height_are_included():
    at = {'range_min': 0.5, 'range_max': 4.0, 'min_height': -0.25, 'max_height': 0.25}
    assert scan([(4.0, 0.0, 0.25)], **at)[180] == 4.0
    assert scan([(0.5, 0.0, -0.25)], **at)[180] == 0.5


@pytest.mark.parametrize('row', [0, 1, 2])
def test_single_row(row):
    distance = np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0], [0.5, 0.5, 0.5]])
    points = Points(distance, np.zeros((4, 3)), np.full((4, 3), 9.0))
    sure = np.full((4, 3), 0.5, np.float32)  # far less than min_support in all
    ranges = laser_ranges(points, sure, ScanSettings(beams=BEAMS, row=row, min_support=50.0))
    assert ranges[180] == row + 1.0
    assert np.isfinite(ranges).sum() == 1


def test_row_outside_the_panorama_is_refused():
    points = Points(np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3)))
    with pytest.raises(ValueError, match='row is 2; allowed: -1 to 1'):
        laser_ranges(points, np.ones((2, 3), np.float32), ScanSettings(row=2))


def test_surface_is_four_per_cent_deep():
    # Counted in steps of half a per cent: 3.9 % is inside, 5 % is not.
    assert scan([(2.0, 0.0, 0.0), (2.078, 0.0, 0.0)], min_support=2.0)[180] == pytest.approx(2.039)
    assert np.isnan(scan([(2.0, 0.0, 0.0), (2.1, 0.0, 0.0)], min_support=2.0)[180])
    far = [(2.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.1, 0.0, 0.0)]
    assert scan(far, min_support=2.0)[180] == 2.0, 'what lies behind is no part of it'


def test_wall_at_the_horizon_is_beyond_range_max_and_costs_nothing():
    ranges = scan([(1e15, 0.0, 0.0), (1e9, 0.0, 0.0)], min_support=2.0)
    assert ranges[180] == math.inf


def test_scan_of_nothing_is_unknown():
    assert np.isnan(scan([(np.nan, np.nan, np.nan)])).all()


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({'beams': 59}, 'beams is 59'),
        ({'range_min': 0.0}, 'range_min is 0'),
        ({'range_min': 8.0, 'range_max': 8.0}, 'range_min is 8'),
        ({'min_height': 0.1, 'max_height': 0.1}, 'min_height is 0.1'),
        ({'range_min': 9.0, 'range_max': 8.0}, 'range_min is 9'),
        ({'range_max': math.inf}, 'range_max inf'),
        ({'min_height': 0.2}, 'min_height is 0'),
    ],
)
def test_contradictory_settings_are_refused(change, named):
    with pytest.raises(ValueError, match=named):
        ScanSettings(**change)


def test_smallest_number_of_beams_is_allowed():
    assert ScanSettings(beams=60).angle_increment == pytest.approx(2 * math.pi / 60)


def test_confidence_of_another_shape_is_refused():
    points = Points(np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3)))
    with pytest.raises(ValueError, match='confidence has shape'):
        laser_ranges(points, np.ones((3, 2), np.float32), ScanSettings())


def test_beam_confidence_is_that_of_the_surface_in_the_band():
    pixels = np.array(
        [  # distance, azimuth, height, confidence; a beam of 1°
            (2.00, 0.0, 0.0, 0.8),
            (2.05, 0.0, 0.0, 0.6),
            (2.60, 0.0, 0.0, 1.0),  # behind it
            (2.00, 0.0, 0.5, 1.0),  # above the band
            (2.00, 0.0, 0.0, 0.4),  # does not count
            (2.00, 0.1, 0.0, 1.0),  # another beam
        ]
    )
    distance, azimuth, height, sure = pixels.T[:, np.newaxis, :]
    settings = ScanSettings(beams=BEAMS, min_confidence=0.5)
    ranges = np.full(BEAMS, np.nan, np.float32)
    ranges[180] = 2.02
    points = Points(distance, azimuth, height)
    found = beam_confidence(points, sure.astype(np.float32), ranges, settings)
    assert found[180] == pytest.approx(0.7)
    assert np.flatnonzero(np.isfinite(found)).tolist() == [180]
