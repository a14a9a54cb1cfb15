"""Bundle adjustment and eq. 1 against tracks of known points and a known camera."""

import math
from dataclasses import replace

import numpy as np
import pytest

from panodepth_ros.calibration.adjustment import (
    UNKNOWNS,
    adjust,
    difference,
    moved,
    residuals,
    triangulated,
)
from panodepth_ros.calibration.tracks import Tracks
from panodepth_ros.calibration.view_angle import by_equation_1
from panodepth_ros.geometry import Mounting, PinholeCamera

F = 261.67
ALIGNED = PinholeCamera(
    width=160, height=120, fx=F, fy=F, cx=79.5, cy=59.5, distortion=(0.0, 0.0, 0.0, 0.0)
)
TRUE = replace(
    ALIGNED,
    distortion=(-0.08, 0.0, 0.0, 0.0),
    mounting=Mounting(yaw=math.radians(1.2), roll=math.radians(0.7), tilt=math.radians(-0.8)),
)
NAMES = tuple(UNKNOWNS)
INF = math.inf
#: As given by a calibration: fx to 0.2 %, the principal point to 1.6 px.
PRIOR = np.array([0.002, INF, INF, INF, 1.6, 1.6, INF])


def seen_by(camera, count, noise, seed=0, nearest=0.6):
    """Tracks of random points at 0.6 to 4 m from an axis at 0.3 m, and the points."""
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(-math.pi, math.pi, count)
    inverse = 0.3 * rng.uniform(1 / 4.0, 1 / nearest, count)
    points = np.stack([alpha, inverse, rng.uniform(-0.2, 0.2, count) * (1 - inverse)], axis=1)
    azimuth = alpha[:, np.newaxis] + np.radians(np.linspace(-17, 17, 30))
    blank = np.zeros(azimuth.shape)
    place = residuals(Tracks(azimuth, blank, blank), camera, points)
    u, v = np.moveaxis(place, -1, 0) + noise * rng.normal(size=(2, *azimuth.shape))
    outside = (u < 0) | (u > 159) | (v < 0) | (v > 119)
    return Tracks(azimuth, np.where(outside, np.nan, u), np.where(outside, np.nan, v)), points


def test_points_are_triangulated_exactly():
    tracks, points = seen_by(TRUE, 200, 0.0)
    found = triangulated(tracks, TRUE)
    turned = np.cos(found[:, 0] - points[:, 0])
    np.testing.assert_allclose(turned, 1.0, atol=1e-12)
    np.testing.assert_allclose(found[:, 1:], points[:, 1:], atol=1e-6)


def test_exact_tracks_give_the_camera_back_from_a_wrong_start():
    tracks, _ = seen_by(TRUE, 300, 0.0)
    start = replace(ALIGNED, fx=1.02 * F, fy=1.02 * F)
    names = [name for name in NAMES if name not in ('cx', 'cy')]
    found = adjust(tracks, start, names, np.full(5, INF), origin=start)
    np.testing.assert_allclose(difference(found.camera, TRUE, names), 0.0, atol=2e-5)
    assert found.residual_px.max() < 1e-3


def test_what_is_held_is_that_of_the_origin_wherever_the_fit_begins():
    tracks, points = seen_by(TRUE, 300, 0.0)
    names = ('roll', 'tilt')
    start = replace(TRUE, distortion=(-0.09, 0.0, 0.0, 0.0))
    found = adjust(tracks, start, names, np.full(2, INF), origin=TRUE, points=points)
    assert found.camera.distortion == TRUE.distortion
    assert found.residual_px.max() < 1e-3


def test_estimates_are_as_far_off_as_their_uncertainty_says():
    off = []
    for seed in range(4):
        tracks, _ = seen_by(TRUE, 400, 0.07, seed)
        found = adjust(tracks, ALIGNED, NAMES, PRIOR, origin=ALIGNED)
        deviation = np.sqrt(np.diag(found.covariance))
        off.append(difference(found.camera, TRUE, NAMES) / deviation)
        # Roll is told to a hundredth of a degree, yaw ten times worse; k1 needs fx.
        assert math.degrees(deviation[NAMES.index('roll')]) < 0.01
        assert deviation[NAMES.index('k1')] < 0.01
    # Those that lean on what was given are no further off than it.
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.8


def with_distances(points, inverse, bend, noise, seed):
    """Tracks of points that were moved, with a bend of each path [px at the image's edge]."""
    points = points.copy()
    points[:, 1] = inverse
    azimuth = points[:, :1] + np.radians(np.linspace(-17, 17, 30))
    place = residuals(Tracks(azimuth, 0 * azimuth, 0 * azimuth), TRUE, points)
    u, v = np.moveaxis(place, -1, 0) + noise * np.random.default_rng(seed).normal(
        size=(2, *azimuth.shape)
    )
    outside = (u < 0) | (u > 159) | (v < 0) | (v > 119)
    u = u + bend[:, np.newaxis] * ((u - 79.5) / 80) ** 5
    tracks = Tracks(azimuth, np.where(outside, np.nan, u), np.where(outside, np.nan, v))
    return tracks.chosen((~outside).sum(axis=1) > 10)


#: fx not given at all.
SWEEP_ALONE = np.array([INF, INF, INF, INF, 0.32, 0.32, INF])


def test_fit_of_like_distances_ends_at_the_same_place_from_every_start():
    # As of one wall: the valley along which fx, k1 and distances change is long and curved.
    _, points = seen_by(TRUE, 300, 0.0)
    inverse = 0.3 / np.random.default_rng(0).uniform(0.9, 1.2, 300)
    tracks = with_distances(points, inverse, np.full(300, 0.1), 0.02, 1)
    ends = []
    for scale in (0.97, 1.0, 1.03):
        start = replace(ALIGNED, fx=scale * F, fy=scale * F)
        ends.append(adjust(tracks, start, NAMES, SWEEP_ALONE, origin=start).camera.fx)
    assert max(ends) / min(ends) == pytest.approx(1.0, abs=1e-3)


def test_sectors_that_agree_by_chance_tell_no_more_than_white_noise_lets_them():
    _, points = seen_by(TRUE, 300, 0.0)
    inverse = 0.3 / np.random.default_rng(0).uniform(0.9, 1.2, 300)
    tracks = with_distances(points, inverse, np.zeros(300), 0.02, 1)
    found = adjust(tracks, ALIGNED, NAMES, SWEEP_ALONE, origin=ALIGNED)
    assert math.sqrt(found.covariance[0, 0]) >= 0.999 * found.bound[0]
    assert abs(math.log(found.camera.fx / F)) < 3 * found.bound[0]
    # Without k1 among the unknowns the same sightings tell fx several times as well.
    names = [name for name in NAMES if name != 'k1']
    held = adjust(tracks, TRUE, names, SWEEP_ALONE[:-1], origin=TRUE)
    left = np.linalg.inv(np.linalg.inv(found.covariance)[:-1, :-1])
    assert held.bound[0] < 0.4 * found.bound[0]
    assert held.bound[0] == pytest.approx(math.sqrt(left[0, 0]), rel=0.4)


def walls(seed):
    """Tracks of points of twelve walls, each with a bend of its own."""
    rng = np.random.default_rng(seed)
    _, points = seen_by(TRUE, 600, 0.0, seed)
    wall = np.floor((points[:, 0] + math.pi) / (math.pi / 6)).astype(int)
    inverse = 0.3 / (rng.uniform(0.8, 3.0, 12)[wall] * rng.uniform(0.98, 1.02, 600))
    return with_distances(points, inverse, rng.normal(0, 0.03, 12)[wall], 0.01, seed)


def test_errors_that_points_of_a_wall_share_widen_the_uncertainty():
    off, wider = [], []
    for seed in range(6):
        tracks = walls(seed)
        found = adjust(tracks, TRUE, NAMES, SWEEP_ALONE, origin=TRUE)
        deviation = math.sqrt(found.covariance[0, 0])
        off.append(math.log(found.camera.fx / F) / deviation)
        wider.append(deviation / found.bound[0])
    assert np.sqrt(np.mean(np.square(off))) < 2.0
    assert np.median(wider) > 3.0, 'white noise is not what errs here'


def test_sweep_whose_errors_are_shared_does_not_outweigh_what_was_given():
    # White noise of these residuals would know fx to 0.1 %, as well as what was given.
    given, off = SWEEP_ALONE.copy(), []
    given[NAMES.index('focal_length')] = 0.001
    for seed in range(6):
        tracks = walls(seed)
        found = adjust(tracks, TRUE, NAMES, given, origin=TRUE)
        assert math.sqrt(found.covariance[0, 0]) < 0.001
        off.append(math.log(found.camera.fx / F))
    assert np.sqrt(np.mean(np.square(off))) < 0.0003


def test_errors_that_columns_share_widen_the_uncertainty():
    # A lens that the model does not have: what displaces all sectors alike.
    off, wider = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        _, points = seen_by(TRUE, 600, 0.0, seed)
        inverse = 0.3 / rng.uniform(0.8, 3.0, 600)
        tracks = with_distances(points, inverse, np.zeros(600), 0.03, seed)
        lens = np.interp(tracks.u, np.arange(0, 161, 10), rng.normal(0, 0.01, 17))
        tracks = Tracks(tracks.arm_azimuth, tracks.u + lens, tracks.v)
        found = adjust(tracks, TRUE, NAMES, SWEEP_ALONE, origin=TRUE)
        deviation = math.sqrt(found.covariance[0, 0])
        off.append(math.log(found.camera.fx / F) / deviation)
        wider.append(deviation / found.bound[0])
    assert np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.median(wider) > 1.4, 'white noise is not what errs here'


def test_tilt_and_principal_row_are_told_together_only():
    tracks, _ = seen_by(TRUE, 400, 0.07)
    found = adjust(tracks, ALIGNED, NAMES, PRIOR, origin=ALIGNED)
    tilt, cy = NAMES.index('tilt'), NAMES.index('cy')
    deviation = np.sqrt(np.diag(found.covariance))
    correlation = found.covariance[tilt, cy] / (deviation[tilt] * deviation[cy])
    assert abs(correlation) > 0.95
    row = found.camera.project(0.0, 0.0)[1]
    assert row == pytest.approx(float(TRUE.project(0.0, 0.0)[1]), abs=0.8)


def test_wild_sightings_hardly_matter():
    tracks, _ = seen_by(TRUE, 300, 0.05)
    rng = np.random.default_rng(5)
    wild = rng.random(tracks.u.shape) < 0.03
    spoilt = Tracks(tracks.arm_azimuth, tracks.u + wild * rng.normal(0, 8, wild.shape), tracks.v)
    names, prior = ('roll', 'k1'), np.full(2, INF)
    start = replace(ALIGNED, mounting=replace(TRUE.mounting, roll=0.0))
    found = adjust(spoilt, start, names, prior, origin=start)
    assert math.degrees(found.camera.mounting.roll) == pytest.approx(0.7, abs=0.02)
    assert found.camera.distortion[0] == pytest.approx(-0.08, abs=0.004)


def test_difference_undoes_moved():
    step = np.array([0.01, 0.02, -0.03, 0.01, 1.0, -2.0, 0.05])
    np.testing.assert_allclose(difference(moved(TRUE, NAMES, step), TRUE, NAMES), step)


def test_equation_1_is_right_far_away_and_too_small_nearby():
    angle = 2 * math.atan(80 / F)
    far, points = seen_by(ALIGNED, 50, 0.0)
    points[:, 1] = 1e-6
    place = residuals(
        Tracks(far.arm_azimuth, 0 * far.arm_azimuth, 0 * far.arm_azimuth), ALIGNED, points
    )
    far = Tracks(far.arm_azimuth, place[..., 0], place[..., 1])
    # The lens is not linear: 0.3 of the width about the middle costs some tenths of a per cent.
    assert np.nanmedian(by_equation_1(far, ALIGNED)) == pytest.approx(angle, rel=0.01)
    near, points = seen_by(ALIGNED, 200, 0.0, nearest=0.6)
    by = by_equation_1(near, ALIGNED)
    expected = 2 * np.arctan(np.tan(angle / 2) * (1 - points[:, 1]))
    known = np.isfinite(by)
    assert known.mean() > 0.9
    np.testing.assert_allclose(by[known], expected[known], rtol=0.02)
