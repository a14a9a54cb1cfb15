"""Many panoramas of one sweep, and stripes wider than a column, against columns taken by hand."""

import dataclasses
import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera, triangulate
from panodepth_ros.geometry.equations import search_range
from panodepth_ros.matching.interface import candidate_range, window_geometry
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.rig import panorama_names

COLUMNS = 180
STEP = 2 * math.pi / COLUMNS
F = 1 / math.tan(STEP)  # one pixel per column step near the centre
CAMERA = PinholeCamera(width=41, height=9, fx=F, fy=F, cx=20.0, cy=4.0)
RIG = Rig(arm_radius=0.3, column_offset=14.0, columns=COLUMNS, sweep_columns=COLUMNS)


def frame(k):
    """Frame whose pixel (v, u) tells k, u and v."""
    v, u = np.mgrid[0:9, 0:41]
    return np.stack([np.full_like(u, k), u, v], axis=-1).astype(np.uint8)


def swept(stripe, frames=None, camera=CAMERA, start=0.0, **rig):
    """Sweep whose frames stand ``stripe`` columns apart; of these numbers, or all."""
    rig = dataclasses.replace(RIG, stripe_columns=stripe, **rig)
    sweep = Sweep(rig, camera, start)
    for k in range(rig.sweep_frames) if frames is None else frames:
        sweep.add(1 + k, frame(k), start + k * stripe * STEP)
    return sweep


def test_names_are_those_of_the_topics():
    assert panorama_names(0) == ('left', 'right', 'center')
    assert panorama_names(2, center=False) == (
        *('left', 'right', 'pair_1/left', 'pair_1/right', 'pair_2/left', 'pair_2/right'),
    )


def test_eleven_panoramas_of_one_sweep_are_the_frames_columns():
    rng = np.random.default_rng(5)
    frames = rng.integers(0, 256, (COLUMNS, 9, 41, 3), dtype=np.uint8)
    offsets = (14, 11, 8, 5, 2)
    rig = dataclasses.replace(RIG, further_offsets=tuple(map(float, offsets[1:])))
    sweep = Sweep(rig, CAMERA, 0.0)
    for k in range(COLUMNS):
        sweep.add(1 + k, frames[k], k * STEP)
    panoramas = sweep.panoramas()
    assert tuple(panoramas) == panorama_names(4)
    assert len(panoramas) == 11
    k = (COLUMNS // 2 - np.arange(COLUMNS)) % COLUMNS  # column N/2 is arm azimuth 0
    for name, panorama in panoramas.items():
        pair, _, eye = name.rpartition('/')
        offset = offsets[int(pair.removeprefix('pair_') or 0)]
        u = {'left': 20 + offset, 'right': 20 - offset, 'center': 20}[eye]
        assert np.array_equal(panorama.image, np.moveaxis(frames[k, :, u], 0, 1)), name
        geometry = panorama.geometry
        assert geometry.uniform
        # Rows are those of the frame in all of them: the slopes differ, and F with them.
        assert (geometry.rows, geometry.principal_row) == (9, 4.0)
        assert geometry.principal_angle == pytest.approx(-math.atan((u - 20) / F))
        assert geometry.focal_length_px == pytest.approx(F / math.cos(math.atan((u - 20) / F)))


@pytest.mark.parametrize('start', [0.0, 0.3 * STEP])
@pytest.mark.parametrize(('stripe', 'frames'), [(1, 180), (2, 90), (5, 36), (9, 20)])
def test_stripes_hold_the_columns_beside_the_principal_one(stripe, frames, start):
    sweep = swept(stripe, start=start)
    assert sweep.rig.sweep_frames == frames
    assert sweep.complete
    deviations = (np.arange(stripe) - (stripe - 1) / 2) * STEP
    for name, panorama in sweep.panoramas().items():
        geometry = panorama.geometry
        phi = geometry.principal_angle
        of_frame = panorama.image[4, :, 0]
        assert (np.bincount(of_frame, minlength=frames) == stripe).all(), name
        for k in (0, 3, frames - 1):
            (columns,) = np.nonzero(of_frame == k)
            psi = geometry.ray_angle[columns]
            assert np.sort(psi - phi) == pytest.approx(deviations, abs=1e-12)
            # Every column's own ray looks where the column does, from where the arm stood ...
            beta = geometry.ray_azimuth(columns)
            turns = (beta - psi - (start + k * stripe * STEP)) / (2 * math.pi)
            assert turns == pytest.approx(np.round(turns), abs=1e-9)
            # ... and is that of the pixel it was taken from.
            assert panorama.image[4, columns, 1] == pytest.approx(20 - F * np.tan(psi), abs=0.51)


def test_rows_of_a_stripe_keep_the_slopes_of_the_panorama():
    # A row shows v in its second colour: at another ray angle another v has the row's slope.
    tall = dataclasses.replace(CAMERA, height=101, cy=50.0)
    rig = dataclasses.replace(RIG, stripe_columns=9)
    image = np.tile(np.arange(101, dtype=np.uint8)[:, np.newaxis], (1, 41))
    sweep = Sweep(rig, tall, 0.0)
    sweep.add(1, image, 0.0)
    panorama = sweep.panoramas()['left']
    geometry = panorama.geometry
    (columns,) = np.nonzero(geometry.seen)
    slope = geometry.slope(np.arange(geometry.rows))[:, np.newaxis]
    v = 50 - F * slope / np.cos(geometry.ray_angle[columns])
    assert np.abs(panorama.image[:, columns] - v).max() <= 0.51
    assert np.ptp(v[0]) > 2, 'the rows differ within the stripe'


def test_stripe_of_a_lost_frame_is_unknown():
    lost = swept(5, frames=[k for k in range(36) if k != 7])
    assert not lost.complete
    for panorama in lost.panoramas().values():
        unseen = np.flatnonzero(~panorama.geometry.seen)
        assert unseen.tolist() == list(range(90 - 37, 90 - 32))
        assert not panorama.image[:, unseen].any()
    assert lost.missing_sectors() == [pytest.approx((37 * STEP, 33 * STEP))]


def test_nearest_of_overlapping_frames_wins():
    # Frames anywhere: each column comes from the nearest one within reach of it.
    rng = np.random.default_rng(2)
    azimuths = np.cumsum(rng.uniform(0.5, 6.5, 40)) * STEP
    azimuths = np.concatenate([[0.0], azimuths[azimuths < (COLUMNS - 10) * STEP]])
    rig = dataclasses.replace(RIG, column_offset=8.0, stripe_columns=5)
    sweep = Sweep(rig, CAMERA, 0.0)
    for k, azimuth in enumerate(azimuths):
        sweep.add(1 + k, frame(k), azimuth)
    panorama = sweep.panoramas()['right']
    away = (90 - np.arange(COLUMNS))[:, np.newaxis] - azimuths / STEP
    away = np.minimum(away % COLUMNS, -away % COLUMNS)
    assert np.array_equal(panorama.geometry.seen, away.min(axis=1) <= 2.75)
    seen = panorama.geometry.seen
    assert np.array_equal(panorama.image[4, seen, 0], away.argmin(axis=1)[seen])
    assert 0 < (~seen).sum() < COLUMNS // 2


@pytest.mark.parametrize(('sweep_columns', 'frames'), [(60, 12), (62, 13)])
def test_partial_sweep_ends_with_the_frame_of_its_last_column(sweep_columns, frames):
    sweep = swept(5, frames=range(frames - 1), sweep_columns=sweep_columns)
    assert not sweep.complete
    assert [sweep.columns_left(k * 5 * STEP) for k in (0, frames - 1, frames)] == [
        *(5 * (frames - 1), 0, -5),
    ]
    assert swept(5, frames=range(frames), sweep_columns=sweep_columns).complete


def test_stripe_over_the_side_of_the_image_is_refused():
    swept(10, frames=[0])
    with pytest.raises(ValueError, match=r'11 columns around \+14 px .* from u = 28\.2 to 40\.8'):
        swept(11, frames=[0])


@pytest.mark.parametrize('distance', [math.inf, 2.0])
@pytest.mark.parametrize('stripe', [2, 5, 9])
def test_own_rays_give_the_distance_where_one_angle_for_all_is_biased(stripe, distance):
    # A point on the ray of every left column, and the right column whose ray passes nearest.
    panoramas = swept(stripe, stripe_distance=distance, column_offset=12.0).panoramas()
    left, right = panoramas['left'].geometry, panoramas['right'].geometry
    x, true = np.arange(COLUMNS), np.linspace(0.8, 1.6, COLUMNS)
    alpha = left.ray_azimuth(x) - np.arcsin(0.3 * np.sin(left.ray_angle) / true)
    off = right.ray_azimuth(x) - alpha[:, np.newaxis]
    off -= np.arcsin(0.3 * np.sin(right.ray_angle) / true[:, np.newaxis])
    off = (off + math.pi) % (2 * math.pi) - math.pi
    partner = np.argmin(np.abs(off), axis=1)
    met = np.abs(off[x, partner]) < 0.02 * STEP
    assert met.sum() > 5
    dx = ((partner - x + 90) % COLUMNS - 90).astype(np.float64)[np.newaxis, :]
    exact = triangulate(np.repeat(dx, left.rows, axis=0), left, right).radial_distance[0, met]
    one_angle = [
        dataclasses.replace(eye, ray_angle=np.full(COLUMNS, eye.principal_angle))
        for eye in (left, right)
    ]
    naive = triangulate(np.repeat(dx, left.rows, axis=0), *one_angle).radial_distance[0, met]
    assert np.abs(exact / true[met] - 1).max() < 0.006
    assert np.abs(naive / true[met] - 1).max() > 0.02


@pytest.mark.parametrize('distance', [1.5, 4.0])
def test_stripes_join_at_their_distance(distance):
    # Points on a cylinder of that radius stand at the columns where one angle would show them.
    panoramas = swept(9, stripe_distance=distance, column_offset=12.0).panoramas()
    for panorama in panoramas.values():
        geometry = panorama.geometry
        x = np.arange(COLUMNS)
        azimuth = geometry.ray_azimuth(x) - np.arcsin(0.3 * np.sin(geometry.ray_angle) / distance)
        principal = math.asin(0.3 * math.sin(geometry.principal_angle) / distance)
        one_angle = (geometry.azimuth_column - x) * STEP - principal
        assert azimuth == pytest.approx(one_angle, abs=1e-12)
        # The camera stood at β − ψ: whole stripes apart.
        arm = np.unique(np.round((geometry.ray_azimuth(x) - geometry.ray_angle) / STEP, 6))
        assert np.diff(arm) == pytest.approx(9.0)
        # The pixel is that of the ray.
        u = 20 - F * np.tan(geometry.ray_angle)
        assert panorama.image[4, :, 1] == pytest.approx(u, abs=0.51)


def test_stripe_distance_within_reach_of_the_arm_is_refused():
    with pytest.raises(ValueError, match=r'stripe_distance is 0\.5 m; allowed: at least 0\.6'):
        dataclasses.replace(RIG, stripe_distance=0.5)


@pytest.mark.parametrize('distance', [math.inf, 2.0])
@pytest.mark.parametrize('stripe', [1, 5, 9])
def test_search_range_holds_every_point_in_view(stripe, distance):
    panoramas = swept(stripe, stripe_distance=distance, column_offset=12.0).panoramas()
    left, right = panoramas['left'].geometry, panoramas['right'].geometry
    first, last = candidate_range(left, right)
    x = np.arange(COLUMNS)
    extremes = []
    # Beyond 6 m two columns of 2° look alike, unless stripes turn them apart.
    far = 20.0 if stripe > 1 and math.isfinite(distance) else 6.0
    for true in (0.33, 1.0, far):
        alpha = left.ray_azimuth(x) - np.arcsin(0.3 * np.sin(left.ray_angle) / true)
        off = right.ray_azimuth(x) - np.arcsin(0.3 * np.sin(right.ray_angle) / true)
        off = np.abs(np.remainder(off - alpha[:, np.newaxis] + math.pi, 2 * math.pi) - math.pi)
        dx = (off.argmin(axis=1) - x + 90) % COLUMNS - 90
        extremes += [dx.min(), dx.max()]
    assert first <= min(extremes)
    assert max(extremes) <= last
    if stripe > 1:
        plain = search_range(right.principal_angle, STEP)
        assert min(extremes) < 1 or max(extremes) > plain, 'stripes move it'


def test_match_is_triangulated_with_the_mean_ray_of_its_window():
    sweep = swept(9, frames=[k for k in range(20) if k != 7], column_offset=12.0)
    geometry = sweep.panoramas()['left'].geometry
    window = window_geometry(geometry)
    unseen = ~geometry.seen
    assert unseen.sum() == 9
    assert np.array_equal(~window.seen, unseen)
    # Nine columns of a window hold a whole stripe, wherever it begins, ...
    whole = ~np.any([np.roll(unseen, shift) for shift in range(-4, 5)], axis=0)
    assert window.ray_angle[whole] == pytest.approx(geometry.principal_angle, abs=1e-12)
    # ... less what was not seen.
    (first,) = np.flatnonzero(unseen & ~np.roll(unseen, 1))
    assert window.ray_angle[first - 1] == pytest.approx(
        geometry.ray_angle[first - 5 : first].mean()
    )
    uniform = swept(1).panoramas()['left'].geometry
    assert window_geometry(uniform) is uniform


@pytest.mark.parametrize(('stripe', 'distance', 'shift'), [(8, 1.0, 0.55), (16, 1.0, 1.2)])
def test_rows_of_a_pair_differ_by_what_the_conventions_say(stripe, distance, shift):
    # 640 × 480 at 34°, columns of 0.2°: the largest shift, of the uppermost row.
    fx = 320 / math.tan(math.radians(17))
    rig = Rig(
        **{'arm_radius': 0.3, 'column_offset': 282.0, 'columns': 1800, 'sweep_columns': 1800},
        **{'stripe_columns': stripe, 'stripe_distance': 2.0},
    )
    phi, half = math.atan(282 / fx), (stripe - 1) / 2 * rig.column_step
    angles = np.array([rig.ray_angle(phi, half), rig.ray_angle(phi, -half)])
    away = np.sqrt(distance**2 - (0.3 * np.sin(angles)) ** 2) - 0.3 * np.cos(angles)
    exact = 239.5 * (away[0] / away[1] - 1)
    r0 = 0.3 * math.sin(phi)
    rule = 239.5 * r0 * (angles[0] - angles[1]) / math.sqrt(distance**2 - r0**2)
    assert exact == pytest.approx(rule, rel=0.02)
    assert exact == pytest.approx(shift, rel=0.05)
