"""Columns of panoramas out of frames, against a scene of known bearings."""

import dataclasses
import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.rig import columns_per_turn
from panodepth_ros.mosaic.steady import SteadySweep

COLUMNS = 90
STEP = 2 * math.pi / COLUMNS
F = 1 / math.tan(STEP)  # one pixel per column step near the centre
CAMERA = PinholeCamera(width=21, height=7, fx=F, fy=F, cx=10.0, cy=3.0)
RIG = Rig(arm_radius=0.3, column_offset=8.0, columns=COLUMNS, sweep_columns=COLUMNS)


def frame(k, height=7):
    """Frame whose pixel (v, u) tells k, u and v."""
    v, u = np.mgrid[0:height, 0:21]
    return np.stack([np.full_like(u, k), u, v], axis=-1).astype(np.uint8)


def swept(azimuths, rig=RIG, camera=CAMERA):
    sweep = Sweep(rig, camera, azimuths[0])
    for k, azimuth in enumerate(azimuths):
        sweep.add(1_000_000_000 + k * 100_000_000, frame(k), azimuth)
    return sweep


def test_columns_are_taken_symmetrically_and_run_clockwise():
    panoramas = swept([k * STEP for k in range(COLUMNS)]).panoramas()
    for name, u in (('left', 18), ('right', 2), ('center', 10)):
        image = panoramas[name].image
        assert (image[:, :, 1] == u).all(), name
        assert (image[:, :, 2] == np.arange(7)[:, np.newaxis]).all()
        # Column N/2 is arm azimuth 0, columns to its right lie clockwise, i.e. backwards.
        assert list(image[0, [COLUMNS // 2, COLUMNS // 2 - 1, COLUMNS // 2 + 1], 0]) == [0, 1, 89]


def test_geometry_of_the_columns():
    start = 0.3
    panoramas = swept([start + k * STEP for k in range(COLUMNS)]).panoramas()
    phi = math.atan(8.0 / F)
    for name, sign in (('left', -1), ('right', 1), ('center', 0)):
        geometry = panoramas[name].geometry
        assert geometry.principal_angle == pytest.approx(sign * phi)
        assert geometry.uniform
        assert geometry.focal_length_px == pytest.approx(F / math.cos(sign * phi))
        assert geometry.principal_row == 3.0
        assert geometry.sweep_duration == pytest.approx(8.9)
        for k in (0, 17, 89):
            column = np.flatnonzero(panoramas[name].image[0, :, 0] == k)[0]
            beta = start + k * STEP + sign * phi
            turns = (float(geometry.ray_azimuth(column)) - beta) / (2 * math.pi)
            assert turns == pytest.approx(round(turns), abs=1e-9)


def test_column_of_a_quantised_arm_is_sampled_along_its_exact_ray():
    # The arm stops 0.25 columns past the grid: the column's ray is 0.25 steps behind the axis.
    azimuths = [k * STEP for k in range(COLUMNS)]
    azimuths[30] += 0.25 * STEP
    sweep = swept(azimuths)
    x = COLUMNS // 2 - 30
    for name, sign in (('left', -1), ('right', 1)):
        panorama = sweep.panoramas()[name]
        psi = sign * math.atan(8.0 / F) - 0.25 * STEP
        assert panorama.geometry.ray_angle[x] == pytest.approx(psi)
        assert panorama.image[3, x, 1] == round(10 - F * math.tan(psi))
        assert not panorama.geometry.uniform


def test_grid_follows_the_first_frame():
    assert (
        swept([0.4 * STEP + k * STEP for k in range(COLUMNS)]).panoramas()['left'].geometry.uniform
    )


def test_unseen_columns_are_unknown_and_named():
    sweep = swept([k * STEP for k in range(COLUMNS) if k not in (40, 41)])
    assert not sweep.complete
    assert sweep.progress == pytest.approx(88 / 90)
    geometry = sweep.panoramas()['left'].geometry
    assert np.flatnonzero(~geometry.seen).tolist() == [45 - 41, 45 - 40]
    assert sweep.missing_sectors() == [pytest.approx((41 * STEP, 40 * STEP))]


def test_every_missing_sector_is_named():
    unseen = {10, 11, 12, 13, 20, 70, 72}
    sweep = swept([k * STEP for k in range(COLUMNS) if k not in unseen])
    # Clockwise from behind: arm azimuths 44 … -45 steps, those above 45 one turn less.
    expected = [(20, 20), (13, 10), (72 - 90, 72 - 90), (70 - 90, 70 - 90)]
    found = [(first / STEP, last / STEP) for first, last in sweep.missing_sectors()]
    assert found == [pytest.approx(pair) for pair in expected]
    assert swept([k * STEP for k in range(COLUMNS)]).missing_sectors() == []


def test_add_tells_how_many_columns_it_filled():
    sweep = Sweep(RIG, CAMERA, 0.0)
    assert sweep.add(1, frame(0), 0.0) == 1
    assert sweep.add(2, frame(1), 0.0) == 0
    assert sweep.add(3, frame(2), 1.5 * STEP) == 2
    assert (sweep.start, sweep.end) == (1, 3)
    edge = Rig(arm_radius=0.3, column_offset=10.0, columns=COLUMNS, sweep_columns=COLUMNS)
    outside = Sweep(edge, CAMERA, 0.0)
    assert outside.add(1, frame(0), 0.4 * STEP) == 0, 'its ray leaves the image'


def test_nearer_frame_wins_and_of_equals_the_first():
    sweep = swept([0.0, STEP, 1.25 * STEP, 2 * STEP, 2 * STEP])
    image = sweep.panoramas()['left'].image
    assert image[0, COLUMNS // 2 - 1, 0] == 1
    assert image[0, COLUMNS // 2 - 2, 0] == 3


def test_sweep_is_complete_with_its_last_column_and_not_before():
    rig = Rig(arm_radius=0.3, column_offset=8.0, columns=COLUMNS, sweep_columns=10)
    assert not swept([k * STEP for k in range(9)], rig).complete
    assert swept([k * STEP for k in range(10)], rig).complete


def test_columns_left_to_the_end_of_the_sweep():
    sweep = swept([0.0])
    for travelled, left in ((0.0, 89), (0.4, 89), (88.6, 0), (89.4, 0), (89.6, -1), (-90, -1)):
        assert sweep.columns_left(travelled * STEP) == left


def test_distorted_lens_is_honoured():
    camera = PinholeCamera(
        width=21, height=7, fx=F, fy=F, cx=10.0, cy=3.0, distortion=(0.5, 0.0, 0.0, 0.0)
    )
    rig = Rig(arm_radius=0.3, column_offset=6.0, columns=COLUMNS, sweep_columns=COLUMNS)
    image = swept([0.0], rig, camera).panoramas()['left'].image
    x = 6.0 / F
    u = 10 + F * x * (1 + 0.5 * x * x)
    assert image[3, COLUMNS // 2, 1] == round(u)
    assert round(u) != 16


def test_rows_bent_out_of_the_image_are_left_out():
    camera = PinholeCamera(
        width=21, height=7, fx=F, fy=F, cx=10.0, cy=3.0, distortion=(2.0, 0.0, 0.0, 0.0)
    )
    rig = Rig(arm_radius=0.3, column_offset=6.0, columns=COLUMNS, sweep_columns=COLUMNS)
    panorama = swept([0.0], rig, camera).panoramas()['left']
    assert panorama.geometry.rows < 7
    assert panorama.image.shape[0] == panorama.geometry.rows
    # The lens is symmetric about the middle row, and so is what is left.
    assert panorama.geometry.principal_row == (panorama.geometry.rows - 1) / 2
    # Row of slope 0 still shows the image row cy.
    assert panorama.image[round(panorama.geometry.principal_row), COLUMNS // 2, 2] == 3


def test_columns_outside_the_image_are_refused():
    rig = Rig(arm_radius=0.3, column_offset=12.0, columns=COLUMNS, sweep_columns=COLUMNS)
    with pytest.raises(ValueError, match=r'u = 22\.0, outside the image; allowed: 0 to 20'):
        Sweep(rig, CAMERA, 0.0)


def test_frame_of_another_size_or_kind_is_refused():
    sweep = swept([0.0])
    with pytest.raises(ValueError, match='frame is 21 × 8 px; allowed: 21 × 7'):
        sweep.add(2, frame(1, height=8), STEP)
    with pytest.raises(ValueError, match='1 channels, the sweep began with 3'):
        sweep.add(2, frame(1)[..., 0], STEP)
    assert int(sweep.seen.sum()) == 1


def test_grey_frames_make_grey_panoramas():
    sweep = Sweep(RIG, CAMERA, 0.0)
    sweep.add(1, frame(0)[..., 1], 0.0)
    assert sweep.panoramas()['left'].image.shape == (7, COLUMNS)


def test_panoramas_of_nothing_are_refused():
    with pytest.raises(ValueError, match='no column'):
        Sweep(RIG, CAMERA, 0.0).panoramas()


def test_progress_never_exceeds_one():
    rig = Rig(arm_radius=0.3, column_offset=8.0, columns=COLUMNS, sweep_columns=10)
    sweep = swept([k * STEP for k in range(12)], rig)
    assert sweep.progress == 1.0


@pytest.mark.parametrize(('step', 'columns'), [(0.2, 1800), (0.0514285, 7000), (-0.2, 1800)])
def test_columns_of_a_turn(step, columns):
    assert columns_per_turn(step) == columns


def test_step_that_does_not_fit_a_turn_is_refused():
    with pytest.raises(ValueError, match=r'column_step_deg is 0\.7'):
        columns_per_turn(0.7)
    with pytest.raises(ValueError, match=r'1800\.050 columns'):
        columns_per_turn(360 / 1800.05)


@pytest.mark.parametrize('direction', [1, -1], ids=['forward', 'backward'])
@pytest.mark.parametrize('stripe', [1, 5, 6])
@pytest.mark.parametrize('kind', [Sweep, SteadySweep])
def test_settled_columns_stay_as_they_are_and_follow_the_arm(stripe, direction, kind):
    rig = dataclasses.replace(RIG, stripe_columns=stripe, column_offset=6.0, stripe_distance=2.0)
    steps = np.random.default_rng(1).uniform(0.5, 0.9 * max(stripe, 1), 400).cumsum()
    azimuths = 0.2 + direction * STEP * np.concatenate([[0], steps[steps < COLUMNS]])
    if stripe == 1:
        azimuths = 0.2 + direction * STEP * np.arange(COLUMNS)
    sweep = kind(rig, CAMERA, azimuths[0])
    seen_so_far = []
    for k, azimuth in enumerate(azimuths):
        sweep.add(k, frame(k % 256), azimuth)
        if sweep.start is None:
            continue
        seen_so_far.append((sweep.settled, sweep.panoramas(settled=True)))
        travelled = abs(azimuth - azimuths[0]) / STEP
        assert sweep.settled.sum() > travelled - stripe - 1
    final = sweep.panoramas()
    assert (np.diff([settled.sum() for settled, _ in seen_so_far]) >= 0).all()
    for settled, partial in seen_so_far:
        for name in ('left', 'right'):
            assert np.array_equal(partial[name].geometry.seen, settled)
            assert np.array_equal(partial[name].image[:, settled], final[name].image[:, settled])
            rays = partial[name].geometry.ray_angle, final[name].geometry.ray_angle
            assert np.array_equal(rays[0][settled], rays[1][settled])
