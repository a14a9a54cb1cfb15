"""One column out of a frame, against an image whose grey levels are linear in u and v."""

import gc
import math
import weakref
from dataclasses import replace

import numpy as np
import pytest

from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.mosaic import ColumnLookup
from panodepth_ros.mosaic.lookup import focal_length, snapped, visible_rows

W, H, F = 21, 9, 40.0
CAMERA = PinholeCamera(width=W, height=H, fx=F, fy=F, cx=10.0, cy=4.0)
v_grid, u_grid = np.mgrid[0:H, 0:W]
#: A column that is not wider than a pixel [rad].
PIXEL = 0.8 / F
LINEAR = (5 * u_grid + 12 * v_grid).astype(np.uint8)


def rows_of(offset_px):
    """Slopes of the image's own rows in the column at an offset."""
    return (4.0 - np.arange(H)) / focal_length(CAMERA, offset_px)


def sampled(u, slope_offset=None, image=LINEAR):
    """Column at pixel coordinate u, along the rows of the column at ``slope_offset``."""
    offset = u - 10.0
    slope = rows_of(offset if slope_offset is None else slope_offset)
    return ColumnLookup(CAMERA, slope, PIXEL).column(image, CAMERA.ray_angle(offset))


@pytest.mark.parametrize('u', [0, 3, 10, 20])
def test_whole_columns_are_copied(u):
    assert np.array_equal(sampled(u), LINEAR[:, u])


@pytest.mark.parametrize('u', [0.25, 7.4, 12.5, 19.75])
def test_fractional_columns_are_interpolated(u):
    assert sampled(u).tolist() == pytest.approx(5 * u + 12 * np.arange(H), abs=0.5001)


def test_rows_are_interpolated_too():
    # Along the slopes of column 20, column 4.5 is seen at rows pulled towards the middle.
    psi, far = CAMERA.ray_angle(4.5 - 10), CAMERA.ray_angle(10.0)
    v = 4 + (np.arange(H) - 4) * math.cos(far) / math.cos(psi)
    assert sampled(4.5, 10.0).tolist() == pytest.approx(5 * 4.5 + 12 * v, abs=0.5001)
    assert np.abs(v - np.arange(H)).max() > 0.05


@pytest.mark.parametrize(('u', 'column'), [(-0.45, 0), (20.45, 20)])
def test_half_a_pixel_beyond_the_side_still_belongs_to_the_image(u, column):
    difference = np.abs(sampled(u).astype(int) - LINEAR[:, column])
    assert difference.max() <= 1  # the rows shift a little with the ray


@pytest.mark.parametrize('u', [-0.55, 20.55])
def test_ray_beyond_the_side_gives_nothing(u):
    assert sampled(u) is None


def test_colours_are_interpolated_alike():
    colour = np.stack([LINEAR, 255 - LINEAR, LINEAR // 2], axis=-1)
    column = sampled(7.4, image=colour)
    assert column.shape == (H, 3)
    assert column[:, 0].tolist() == sampled(7.4).tolist()
    assert column[:, 1].tolist() == pytest.approx(255 - (5 * 7.4 + 12 * np.arange(H)), abs=0.5001)


def wide(u, pixels, image, roll=0.0):
    """Column around pixel coordinate u that covers so many pixels."""
    camera = replace(CAMERA, mounting=Mounting(roll=roll))
    angle, side = CAMERA.ray_angle(u - 10.0), (10.0 - u) / F
    step = pixels / F / (1 + side**2)
    return ColumnLookup(camera, np.zeros(1), step).column(image, angle)


def test_wide_column_is_the_mean_of_what_it_covers():
    noise = np.random.default_rng(3).integers(0, 256, (H, W)).astype(np.uint8)
    row = noise[4].astype(float)
    assert wide(7.0, 3.0, noise)[0] == pytest.approx(row[6:9].mean(), abs=0.51)
    quarters = 0.25 * row[5] + row[6:9].sum() + 0.75 * row[9]
    assert wide(7.25, 4.0, noise)[0] == pytest.approx(quarters / 4, abs=0.6)
    assert wide(10.0, 3.0, noise, roll=math.pi / 2)[0] == pytest.approx(
        noise[3:6, 10].mean(), abs=0.51
    )


@pytest.mark.parametrize('u', [0.0, 0.6, 19.7, 20.0])
def test_wide_column_at_the_side_stays_in_its_place(u):
    assert wide(u, 5.0, LINEAR)[0] == pytest.approx(5 * u + 12 * 4, abs=0.51)


def test_image_of_one_row():
    camera = PinholeCamera(width=W, height=1, fx=F, fy=F, cx=10.0, cy=0.0)
    column = ColumnLookup(camera, np.zeros(1), PIXEL).column(LINEAR[:1], camera.ray_angle(2.5))
    assert column.tolist() == [62]  # 5 · 12.5, halves go to the even side


def test_all_rows_of_an_ideal_lens_are_visible():
    assert visible_rows(CAMERA, (8.0, -8.0, 0.0), 0.003) == (0, H)


@pytest.mark.parametrize('k1', [6.0, 12.0])
def test_visible_rows_stay_inside_the_image_over_the_whole_margin(k1):
    camera = PinholeCamera(
        width=W, height=H, fx=F, fy=F, cx=10.0, cy=4.0, distortion=(k1, 0.0, 0.0, 0.0)
    )
    margin, offsets = 0.02, (6.0, -3.0)
    first, count = visible_rows(camera, offsets, margin)
    assert 0 < count < H

    def outside(row):
        slope = (camera.cy - row) / np.array([focal_length(camera, o) for o in offsets])
        angles = np.array([camera.ray_angle(o) for o in offsets])
        v = [camera.project(angles + m, slope)[1] for m in (-margin, 0.0, margin)]
        return (np.abs(np.array(v) - (H - 1) / 2) > H / 2).any()

    assert [outside(row) for row in range(H)] == [
        not first <= row < first + count for row in range(H)
    ]


def test_lens_that_shows_no_row_is_refused():
    camera = PinholeCamera(
        width=W, height=H, fx=F, fy=F, cx=10.0, cy=200.0, distortion=(0.1, 0.0, 0.0, 0.0)
    )
    with pytest.raises(ValueError, match='no row'):
        visible_rows(camera, (0.0,), 0.01)


def test_rounding_of_the_ray_angle_is_snapped_away():
    assert snapped(0.25 + 5e-8, 0.25) == 0.25
    assert snapped(0.25 + 2e-7, 0.25) == 0.25 + 2e-7


def test_positions_of_a_ray_are_computed_once(monkeypatch):
    lens = PinholeCamera(
        width=W, height=H, fx=F, fy=F, cx=10.0, cy=4.0, distortion=(0.1, 0.0, 0.0, 0.0)
    )
    lookup, angle = ColumnLookup(lens, rows_of(2.0), PIXEL), lens.ray_angle(2.0)
    first = lookup.column(LINEAR, angle)
    monkeypatch.setattr(PinholeCamera, 'project', None)
    assert np.array_equal(lookup.column(LINEAR, angle), first)
    assert not np.array_equal(lookup.column(255 - LINEAR, angle), first)


def test_rows_of_a_tilted_camera_are_those_it_sees():
    tilted = replace(CAMERA, mounting=Mounting(tilt=math.atan(3 / F)))
    first, count = visible_rows(tilted, (0.0,), 0.0)
    assert first == -3
    assert count >= H - 1


def test_rolled_columns_lose_the_rows_that_leave_the_image_at_its_side():
    rolled = replace(CAMERA, mounting=Mounting(roll=0.3))
    first, count = visible_rows(rolled, (8.0, -8.0, 0.0), 0.0)
    assert 0 < count < H
    for offset in (8.0, -8.0):
        slope = (4.0 - np.arange(first, first + count)) / focal_length(CAMERA, offset)
        lookup = ColumnLookup(rolled, slope, PIXEL)
        assert lookup.column(LINEAR, CAMERA.ray_angle(offset)) is not None


def test_lookup_is_gone_as_soon_as_nobody_refers_to_it():
    # Else the mosaicer of an arm that never stops grows by its sampling positions with each turn.
    gc.disable()
    try:
        lookup = ColumnLookup(CAMERA, rows_of(0.0), PIXEL)
        lookup.column(LINEAR, 0.1)
        gone = weakref.ref(lookup)
        del lookup
        assert gone() is None
    finally:
        gc.enable()
