"""Pinhole views against the cloud, by the formulas of the nodes that will read them."""

import math

import numpy as np
import pytest

from panodepth_ros.camera.simulated import furnished_room, truth_panorama
from panodepth_ros.geometry import PanoramaGeometry, locate
from panodepth_ros.geometry.pinhole_views import render, ring_of_faces
from panodepth_ros.scan.beams import ScanSettings, laser_ranges

COLUMNS, ROWS = 720, 48
STEP = 2 * math.pi / COLUMNS
R, PHI = 0.3, math.radians(15.1)
#: Half the width of a panorama column and of a face pixel, generously [rad].
PIXEL = 0.75 * STEP


def geometry(**change):
    values = {
        'columns': COLUMNS,
        'rows': ROWS,
        'azimuth_column': COLUMNS / 2 - PHI / STEP,
        'focal_length_px': 108.0,
        'principal_row': 21.5,
        'arm_radius': R,
        'principal_angle': -PHI,
        'sweep_duration': 0.0,
        'ray_angle': np.full(COLUMNS, -PHI),
    }
    return PanoramaGeometry(**{**values, **change})


def colours():
    """A panorama whose pixels tell their index, which is never 0, in their three bytes."""
    index = np.arange(1, ROWS * COLUMNS + 1).reshape(ROWS, COLUMNS)
    return np.stack([index & 255, index >> 8 & 255, index >> 16], axis=-1).astype(np.uint8)


def deprojected(face, depth):
    """Azimuth, distance from the axis, height of a face's pixels, as depth_image_proc does it."""
    v, u = np.mgrid[0 : face.height, 0 : face.width]
    x = (u - face.cx) * depth / face.focal_length_px
    y = (v - face.cy) * depth / face.focal_length_px
    return face.azimuth - np.arctan2(x, depth), np.hypot(x, depth), -y


def wrapped(angle):
    return (angle + math.pi) % (2 * math.pi) - math.pi


@pytest.fixture(scope='module')
def room():
    """Exact distances of a furnished room: edges, slants, thin things."""
    panorama = geometry()
    truth = truth_panorama(
        furnished_room(1),
        arm_radius=R,
        ray_angle=-PHI,
        ray_azimuth=panorama.ray_azimuth(np.arange(COLUMNS)),
        slope=panorama.slope(np.arange(ROWS)),
    )
    distance = np.where(truth.occluded, np.nan, truth.radial_distance)
    return panorama, locate(distance, panorama)


def test_faces_share_the_turn_and_hold_all_rows():
    faces = ring_of_faces(geometry(), 4, 0)
    assert [face.azimuth for face in faces] == pytest.approx(
        [0, math.pi / 2, math.pi, -math.pi / 2]
    )
    face = faces[0]
    # The edges of the outermost pixels lie on the diagonals.
    assert (face.cx + 0.5) / face.focal_length_px == pytest.approx(math.tan(math.pi / 4))
    assert (face.width - 0.5 - face.cx) / face.focal_length_px == pytest.approx(1.0)
    top, bottom = geometry().slope(np.array([0, ROWS - 1]))
    assert face.cy / face.focal_length_px > top * math.sqrt(2)
    assert (face.height - 1 - face.cy) / face.focal_length_px > -bottom * math.sqrt(2)
    assert face.focal_length_px == pytest.approx(1 / STEP, rel=0.01)
    assert ring_of_faces(geometry(), 6, 200)[1].width == 200


@pytest.mark.parametrize(
    ('count', 'width', 'sentence'),
    [(2, 100, 'faces is 2; allowed: at least 3'), (4, 1, 'width of a face is 1 px')],
)
def test_impossible_faces_are_refused(count, width, sentence):
    with pytest.raises(ValueError, match=sentence):
        ring_of_faces(geometry(), count, width)


@pytest.mark.parametrize('count', [4, 5])
def test_every_pixel_of_a_face_is_a_point_of_the_cloud(room, count):
    panorama, points = room
    image = colours()
    for face in ring_of_faces(panorama, count, 0):
        view = render(points, image, panorama, face)
        azimuth, distance, height = deprojected(face, view.depth)
        seen = np.isfinite(view.depth)
        assert seen.sum() > 0.3 * seen.size
        assert (view.image[~seen] == 0).all()
        index = view.image[seen].astype(int) @ (1, 256, 65536) - 1
        row, column = np.unravel_index(index, (ROWS, COLUMNS))
        assert distance[seen] == pytest.approx(points.radial_distance[row, column], rel=1e-5)
        # Half a patch and half a pixel of the face.
        off = np.abs(wrapped(azimuth[seen] - points.azimuth[row, column]))
        assert off.max() < 3 * PIXEL
        assert np.mean(off < 1.5 * PIXEL) > 0.99
        rows_off = np.abs(height[seen] - points.height[row, column]) / distance[seen]
        assert rows_off.max() < 3 / 108.0


def test_no_face_looks_through_what_the_cloud_holds(room):
    panorama, points = room
    checked = 0
    for face in ring_of_faces(panorama, 4, 0):
        depth = render(points, colours(), panorama, face).depth
        x, y, z = np.moveaxis(points.xyz(), -1, 0)
        forward = x * math.cos(face.azimuth) + y * math.sin(face.azimuth)
        left = -x * math.sin(face.azimuth) + y * math.cos(face.azimuth)
        with np.errstate(invalid='ignore'):
            u = face.cx - face.focal_length_px * left / forward
            v = face.cy - face.focal_length_px * z / forward
            inside = (forward > 0.1) & (np.abs(u - face.cx) < face.width / 2 - 1)
        found = depth[np.rint(v[inside]).astype(int), np.rint(u[inside]).astype(int)]
        # At the edge of a face, half a pixel of it is that much depth.
        assert (found <= forward[inside] * (1 + 0.55 * STEP)).all()
        checked += inside.sum()
    assert checked > 0.9 * np.isfinite(points.radial_distance).sum()


def test_a_wall_has_no_holes_and_what_is_unknown_stays_so():
    panorama = geometry()
    distance = np.full((ROWS, COLUMNS), 2.0)
    distance[:, 300:340] = np.nan
    points = locate(distance, panorama)
    depths = [
        render(points, colours(), panorama, face).depth for face in ring_of_faces(panorama, 4, 0)
    ]
    faces = ring_of_faces(panorama, 4, 0)
    azimuth = points.azimuth[0]
    for face, depth in zip(faces, depths, strict=True):
        angle = face.azimuth - np.arctan((np.arange(face.width) - face.cx) / face.focal_length_px)
        row = depth[round(face.cy)]
        gap = wrapped(angle - azimuth[320])
        half = 20 * STEP
        assert np.isfinite(row[np.abs(gap) > half + PIXEL]).all()
        assert np.isnan(row[np.abs(gap) < half - PIXEL]).all()


def test_what_only_the_axis_sees_stays_unknown():
    # A post before a wall: the left eye looks past its left side, so that on the other side the
    # axis sees wall that the eye did not.
    panorama = geometry()
    distance = np.full((ROWS, COLUMNS), 3.0)
    distance[:, 350:360] = 1.0
    points = locate(distance, panorama)
    face = ring_of_faces(panorama, 4, 0)[0]
    row = render(points, colours(), panorama, face).depth[round(face.cy)]
    post = np.flatnonzero(np.abs(row - 1.0) < 0.1)
    shift = (math.asin(R * math.sin(PHI)) - math.asin(R * math.sin(PHI) / 3)) / STEP
    assert post.size == pytest.approx(10, abs=2)
    hidden = np.isnan(row)
    assert hidden[post[-1] + 1 : face.width].sum() == pytest.approx(shift, abs=2)
    assert not hidden[: post[0]].any()


def test_a_thin_thing_is_in_a_coarse_face():
    panorama = geometry()
    distance = np.full((ROWS, COLUMNS), 3.0)
    distance[:, 350] = 1.0
    points = locate(distance, panorama)
    face = ring_of_faces(panorama, 4, 30)[0]
    assert np.nanmin(render(points, colours(), panorama, face).depth) < 1.0


def test_a_scan_line_from_the_faces_is_the_scan(room):
    panorama, points = room
    settings = ScanSettings(beams=360, min_support=0.0, row=21)
    ranges = laser_ranges(points, np.ones((ROWS, COLUMNS), np.float32), settings)
    differences = []
    for face in ring_of_faces(panorama, 4, 0):
        # depthimage_to_laserscan with scan_height 1: the range of column u of the middle row.
        depth = render(points, colours(), panorama, face).depth[round(face.cy)]
        x = (np.arange(face.width) - face.cx) * depth / face.focal_length_px
        azimuth = face.azimuth - np.arctan2(x, depth)
        seen = np.isfinite(depth)
        beam = np.rint((azimuth[seen] + math.pi) / settings.angle_increment).astype(int) % 360
        differences += list(np.hypot(x, depth)[seen] / ranges[beam] - 1)
    off = np.abs(np.array(differences))
    assert off.size > 700
    assert np.nanmedian(off) < 0.01
    assert np.nanmean(off < 0.05) > 0.95


def test_grey_panorama_gives_a_grey_view():
    panorama = geometry()
    points = locate(np.full((ROWS, COLUMNS), 2.0), panorama)
    grey = np.full((ROWS, COLUMNS), 77, np.uint8)
    face = ring_of_faces(panorama, 4, 0)[2]
    view = render(points, grey, panorama, face)
    assert view.image.shape == view.depth.shape == (face.height, face.width)
    assert set(np.unique(view.image)) == {0, 77}
