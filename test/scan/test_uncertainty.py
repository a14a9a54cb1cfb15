"""Standard deviations against finite differences of the triangulation, and what they withhold."""

import dataclasses
import math

import numpy as np
import pytest

from panodepth_ros.geometry import PanoramaGeometry, triangulate
from panodepth_ros.scan.uncertainty import Uncertainty, range_stddev, scan_with_stddev

COLUMNS, R, FX, OFFSET = 1800, 0.3, 261.67, 70.5
STEP = 2 * math.pi / COLUMNS
NONE = Uncertainty(certain_disparity=0.0, doubtful_disparity=0.0, focal_length=0.0, arm_radius=0.0)
SURE = np.ones(720)


def eye(sign, *, fx=FX, r=R, turned=0.0):
    """An eye; ``turned`` shifts every ray, as uneven steps do [rad]."""
    angle = sign * math.atan(OFFSET / fx)
    return PanoramaGeometry(
        columns=COLUMNS,
        rows=1,
        # The arm's azimuths are measured: a column looks where its arm and its ray point.
        azimuth_column=COLUMNS / 2 + (angle + turned) / STEP,
        focal_length_px=100.0,
        principal_row=0.0,
        arm_radius=r,
        principal_angle=angle,
        sweep_duration=0.0,
        ray_angle=np.full(COLUMNS, angle + turned),
    )


def pair(**change):
    return eye(-1, **change), eye(1, **change)


def distance(dx, eyes):
    return np.nanmedian(triangulate(np.full((1, COLUMNS), dx), *eyes).radial_distance)


def stddev(at, eyes, **of):
    values = range_stddev(np.full(720, at), SURE, *eyes, dataclasses.replace(NONE, **of))
    assert np.ptp(values) < 1e-3 * values[0]
    return values[0]


@pytest.mark.parametrize('turned', [0.0, 0.001])
@pytest.mark.parametrize('dx', [60.0, 110.0, 130.0])
def test_first_order_equals_finite_differences(dx, turned):
    eyes = pair(turned=turned)
    at = distance(dx, eyes)
    small = 1e-5

    def difference(one, other):
        return abs(distance(dx, one) - distance(dx, other)) / (2 * small)

    by_columns = abs(distance(dx + small, eyes) - distance(dx - small, eyes)) / (2 * small)
    assert stddev(at, eyes, certain_disparity=1.0) == pytest.approx(by_columns, rel=1e-3)
    by_fx = difference(*(pair(turned=turned, fx=FX * (1 + s * small)) for s in (1, -1)))
    assert stddev(at, eyes, focal_length=1.0) == pytest.approx(by_fx, rel=1e-3)
    by_radius = difference(*(pair(turned=turned, r=R + s * small) for s in (1, -1)))
    assert stddev(at, eyes, arm_radius=1.0) == pytest.approx(by_radius, rel=1e-3)


def test_figures_of_the_paper_s_rig():
    # One column is l²/(2·r0)·θ0 = 20 cm at 3 m, 0.1 % of fx is 1 % there.
    eyes = pair()
    assert stddev(3.0, eyes, certain_disparity=1.0) == pytest.approx(0.20, rel=0.02)
    assert stddev(3.0, eyes, focal_length=0.001) == pytest.approx(0.03, rel=0.15)
    assert stddev(3.0, eyes, arm_radius=0.003) == pytest.approx(0.03, rel=1e-6)


def test_contributions_add_in_squares():
    eyes = pair()
    of = {'certain_disparity': 0.3, 'focal_length': 0.001, 'arm_radius': 0.002}
    parts = [stddev(2.0, eyes, **{name: value}) for name, value in of.items()]
    assert stddev(2.0, eyes, **of) == pytest.approx(math.hypot(*parts))


def test_doubt_makes_uncertain():
    of = dataclasses.replace(NONE, certain_disparity=0.1, doubtful_disparity=1.1)
    confidence = np.linspace(0, 1, 3)
    values = range_stddev(np.full(3, 2.0), confidence, *pair(), of)
    assert values / values[2] == pytest.approx([11, 6, 1], rel=1e-6)


def test_a_beam_uses_the_rays_of_its_own_columns():
    left, right = pair()
    turned = left.ray_angle.copy()
    turned[: COLUMNS // 2] *= 0.5  # a shorter baseline on the left, positive azimuths
    turned[:10] = np.nan  # and unseen behind
    left = dataclasses.replace(left, ray_angle=turned)
    of = dataclasses.replace(NONE, certain_disparity=1.0)
    values = range_stddev(np.full(720, 2.0), SURE, left, right, of)
    assert np.isfinite(values).all()
    assert values[540] > 1.2 * values[180]
    assert values[0] == pytest.approx(values[180], rel=0.01)


def scan(ranges, allowed=0.0):
    of = dataclasses.replace(NONE, certain_disparity=1.0)
    return scan_with_stddev(
        np.array(ranges, np.float32),
        np.where(np.isfinite(ranges), 1.0, np.nan),  # as beam_confidence has it
        pair(),
        of,
        range_max=8.0,
        allowed=allowed,
    )


def test_only_finite_ranges_have_a_stddev():
    ranges, values = scan([2.0, np.nan, np.inf, -np.inf, 0.2])
    assert list(np.isfinite(values)) == [True, False, False, False, False]
    assert np.array_equal(ranges, np.float32([2, np.nan, np.inf, -np.inf, 0.2]), equal_nan=True)
    assert values.dtype == np.float32


def test_too_uncertain_beams_become_unknown():
    # 9 cm at 2 m, 20 cm at 3 m; a +inf is as uncertain as 8 m.
    ranges, values = scan([2.0, 3.0, np.inf, -np.inf], allowed=0.1)
    assert np.array_equal(ranges, np.float32([2, np.nan, np.nan, -np.inf]), equal_nan=True)
    assert list(np.isfinite(values)) == [True, False, False, False]
    assert np.isposinf(scan([np.inf], allowed=10.0)[0]).all()


@pytest.mark.parametrize(
    'name', ['certain_disparity', 'doubtful_disparity', 'focal_length', 'arm_radius']
)
@pytest.mark.parametrize('value', [-0.1, math.nan, math.inf])
def test_bad_uncertainties_are_refused(name, value):
    with pytest.raises(ValueError, match=f'{name} is '):
        dataclasses.replace(NONE, **{name: value})
