"""Triangulation against rays traced from known points."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import (
    PanoramaGeometry,
    distance_stddev,
    locate,
    pair_search_range,
    triangulate,
)
from panodepth_ros.geometry.equations import radial_distance

COLUMNS, ROWS = 1800, 5
STEP = 2 * math.pi / COLUMNS
R = 0.30
PHI = math.radians(15.0789)


def geometry(angle, *, columns=COLUMNS, ray_angle=None, shift=0.0, **change):
    values = {
        'columns': columns,
        'rows': ROWS,
        'azimuth_column': columns / 2 + angle / (2 * math.pi / columns) + shift,
        'focal_length_px': 271.0,
        'principal_row': 2.0,
        'arm_radius': R,
        'principal_angle': angle,
        'sweep_duration': 0.0,
        'ray_angle': np.full(columns, angle) if ray_angle is None else ray_angle,
    }
    return PanoramaGeometry(**{**values, **change})


def arm_azimuth_seeing(azimuth, distance, psi):
    """Arm azimuth at which the ray at psi passes through the point, by the sine rule at O."""
    return azimuth - psi + math.asin(R * math.sin(psi) / distance)


def column_of(pano, gamma, psi):
    return pano.azimuth_column - (gamma + psi) / pano.column_step


@pytest.mark.parametrize('azimuth', [0.0, 1.234, -3.1])
@pytest.mark.parametrize('distance', [0.5, 2.0, 6.0])
def test_point_is_recovered_from_the_columns_that_see_it(azimuth, distance):
    left, right = geometry(-PHI), geometry(PHI)
    x_left = column_of(left, arm_azimuth_seeing(azimuth, distance, -PHI), -PHI)
    x_right = column_of(right, arm_azimuth_seeing(azimuth, distance, PHI), PHI)
    # Put the point's left column on the pixel grid by shifting both panoramas alike.
    shift = math.floor(x_left) - x_left
    left, right = geometry(-PHI, shift=shift), geometry(PHI, shift=shift)
    column = round(x_left + shift) % COLUMNS
    dx = np.full((ROWS, COLUMNS), np.nan)
    dx[:, column] = x_right - x_left
    points = triangulate(dx, left, right)
    assert points.radial_distance[0, column] == pytest.approx(distance, rel=1e-9)
    wrapped = (points.azimuth[0, column] - azimuth + math.pi) % (2 * math.pi) - math.pi
    assert wrapped == pytest.approx(0.0, abs=1e-9)
    d = math.sqrt(distance**2 - (R * math.sin(PHI)) ** 2) - R * math.cos(PHI)
    assert points.height[:, column] == pytest.approx(d * (2.0 - np.arange(ROWS)) / 271.0)
    assert np.isfinite(points.radial_distance).sum() == ROWS


@pytest.mark.parametrize(('azimuth', 'distance', 'z'), [(0.3, 0.5, 0.1), (-2.0, 4.0, -0.7)])
def test_both_eyes_see_a_point_on_one_row(azimuth, distance, z):
    # Sec. 4: epipolar lines are rows. A pinhole of fy = 250 at both places that see the point.
    point, rows = distance * np.array([math.cos(azimuth), math.sin(azimuth)]), []
    for psi in (-PHI, PHI):
        gamma = arm_azimuth_seeing(azimuth, distance, psi)
        forward = np.array([math.cos(gamma), math.sin(gamma)])
        ray = point - R * forward
        depth = float(ray @ forward)
        lateral = float(ray @ np.array([-forward[1], forward[0]]))
        assert math.atan2(lateral, depth) == pytest.approx(psi, abs=1e-12)
        rows.append(2.0 - 250 * z / depth)
        slope = geometry(psi, focal_length_px=250 / math.cos(psi)).slope(rows[-1])
        assert float(slope) == pytest.approx(z / math.hypot(*ray), rel=1e-12)
    assert rows[0] == pytest.approx(rows[1], abs=1e-9)


def test_columns_with_rays_of_their_own_triangulate_exactly():
    # A quantised arm: every column's ray differs a little from the principal angle.
    rng = np.random.default_rng(5)
    psi_left = -PHI + rng.uniform(-4e-4, 4e-4, COLUMNS)
    psi_right = np.full(COLUMNS, PHI + 3e-4)
    left = geometry(-PHI, ray_angle=psi_left)
    right = geometry(PHI, ray_angle=psi_right)
    column, distance = 700, 1.7
    beta = float(left.ray_azimuth(column))
    azimuth = beta + math.asin(R * math.sin(-psi_left[column]) / distance)
    gamma = arm_azimuth_seeing(azimuth, distance, psi_right[0])
    dx = np.full((ROWS, COLUMNS), np.nan)
    dx[:, column] = (column_of(right, gamma, psi_right[0]) - column) % COLUMNS
    points = triangulate(dx, left, right)
    assert points.radial_distance[0, column] == pytest.approx(distance, rel=1e-9)
    assert points.azimuth[0, column] == pytest.approx(azimuth, abs=1e-9)


def test_unseen_columns_and_parallel_rays_stay_unknown():
    unseen = np.full(COLUMNS, -PHI)
    unseen[10] = np.nan
    left, right = geometry(-PHI, ray_angle=unseen), geometry(PHI)
    dx = np.full((ROWS, COLUMNS), 100.0)
    dx[:, 20] = 2 * PHI / STEP
    dx[:, 30] = 2 * PHI / STEP + 1
    distance = triangulate(dx, left, right).radial_distance
    assert np.isnan(distance[:, 10]).all()
    assert not np.isfinite(distance[:, 20]).any() or (distance[:, 20] > 1e6).all()
    assert np.isnan(distance[:, 30]).all()
    assert np.isfinite(distance[:, 40]).all()


def test_search_range_of_a_pair():
    assert pair_search_range(geometry(-PHI), geometry(PHI)) == 150


@pytest.mark.parametrize(
    ('left', 'right', 'named'),
    [
        (geometry(-PHI), geometry(-PHI), 'principal_angle'),
        (geometry(PHI), geometry(-PHI), 'principal_angle'),
        (geometry(-PHI), geometry(PHI, columns=900), 'columns'),
        (geometry(-PHI), geometry(PHI, arm_radius=0.31), 'arm_radius'),
    ],
)
def test_what_is_no_pair_is_refused_by_name(left, right, named):
    with pytest.raises(ValueError, match=named):
        pair_search_range(left, right)


def test_distances_alone_give_the_triangulated_points_again():
    left, right = geometry(-PHI), geometry(PHI)
    dx = np.random.default_rng(3).uniform(5, 140, (ROWS, COLUMNS))
    dx[2, 50:60] = np.nan
    points = triangulate(dx, left, right)
    again = locate(points.radial_distance, left)
    assert np.array_equal(again.azimuth, points.azimuth, equal_nan=True)
    assert np.array_equal(again.height, points.height, equal_nan=True)
    x, y, z = np.moveaxis(points.xyz(), -1, 0)
    assert np.hypot(x, y) == pytest.approx(points.radial_distance, nan_ok=True)
    assert np.arctan2(y, x) == pytest.approx(points.azimuth, nan_ok=True)
    assert np.array_equal(z, points.height, equal_nan=True)


def test_right_eye_locates_the_same_point():
    left, right = geometry(-PHI), geometry(PHI)
    distance = np.full((ROWS, COLUMNS), 2.0)
    half_turn = math.asin(R * math.sin(PHI) / 2.0)
    azimuths = [locate(distance, eye).azimuth[0, 900] for eye in (left, right)]
    betas = [float(eye.ray_azimuth(900)) for eye in (left, right)]
    assert azimuths[0] == pytest.approx(betas[0] + half_turn)
    assert azimuths[1] == pytest.approx(betas[1] - half_turn)


def test_distances_of_another_size_and_within_the_arm_are_no_points():
    with pytest.raises(ValueError, match=r'radial_distance has shape \(5, 7\)'):
        locate(np.ones((ROWS, 7)), geometry(-PHI))
    assert np.isnan(locate(np.full((ROWS, COLUMNS), 0.29), geometry(-PHI)).azimuth).all()


@pytest.mark.parametrize('dx', [10.0, 90.0, 140.0])
def test_standard_deviation_is_the_derivative_of_the_distance(dx):
    def distance(columns):
        return float(radial_distance(columns * STEP / 2, arm_radius=R, principal_angle=PHI))

    at = np.full((ROWS, COLUMNS), distance(dx))
    small = 1e-3
    expected = 0.25 * (distance(dx + small) - distance(dx - small)) / (2 * small)
    assert distance_stddev(at, geometry(-PHI), 0.25) == pytest.approx(expected, rel=1e-5)
