"""The simulated room: exact rays, pictures that fit them, and the truth of a panorama."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from panodepth_ros.camera.simulated import (
    Room,
    RoomCamera,
    furnished_room,
    hits,
    truth_panorama,
)
from panodepth_ros.camera.simulated.furnished import CLEARANCE
from panodepth_ros.camera.simulated.patterns import noise
from panodepth_ros.camera.simulated.solids import (
    Box,
    Material,
    Solid,
    barrel,
    cone,
    cylinder,
    ellipsoid,
    pack,
    placed,
)
from panodepth_ros.camera.simulated.textures import NAMES, Textures, make_textures

Array = npt.NDArray[np.float64]

RADIUS = 0.3
CAMERA = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
PHI = math.atan(70.5 / CAMERA.fx)
PAINT = Material('paint', 1.0)
LAMPS = np.array([[0.0, 0.0, 1.0, 0.5, 0.5, 0.5], [0.5, 0.0, 1.0, 0.3, 0.3, 0.3]])


@pytest.fixture(scope='module')
def textures() -> Textures:
    return make_textures(np.random.default_rng(0))


@pytest.fixture(scope='module')
def furnished() -> Room:
    return furnished_room(0)


def room_of(textures: Textures, *solids: Solid) -> Room:
    return Room(list(solids), textures, LAMPS, (0.5, 0.5, 0.5))


def box(x: float, y: float, length_x: float, length_y: float, **more: object) -> Box:
    values = {'bottom': -1.0, 'top': 1.0, 'material': PAINT} | more
    return Box(x=x, y=y, length_x=length_x, length_y=length_y, **values)


def inside(solid: Solid, points: Array) -> npt.NDArray[np.bool_]:
    """Whether points are in a solid, by its definition."""
    x, y, z = points[:, 0] - solid.x, points[:, 1] - solid.y, points[:, 2]
    within = (z >= solid.bottom) & (z <= solid.top)
    if isinstance(solid, Box):
        c, s = math.cos(solid.yaw), math.sin(solid.yaw)
        across = abs(c * x + s * y) <= 0.5 * solid.length_x
        return within & across & (abs(c * y - s * x) <= 0.5 * solid.length_y)
    a, b, c = solid.profile
    height = z - solid.origin
    return within & (x * x + y * y <= a + b * height + c * height * height)


SOLIDS = {
    'box': box(0.4, -0.3, 0.7, 0.4, yaw=0.6, bottom=-0.4, top=0.3),
    'cylinder': cylinder(-0.3, 0.2, 0.5, -0.6, 0.4, PAINT),
    'cone': cone(0.1, 0.2, 0.6, 0.0, -0.5, 0.5, PAINT),
    'flaring': cone(0.1, 0.2, 0.2, 0.7, -0.5, 0.2, PAINT),
    'sphere': ellipsoid(0.2, 0.1, -0.1, 0.5, 0.5, PAINT),
    'disc': ellipsoid(0.2, 0.1, -0.1, 0.7, 0.1, PAINT),
    'barrel': barrel(-0.2, -0.2, 0.6, 0.4, -0.5, 0.5, PAINT),
    'moved': placed(cone(0.1, 0.0, 0.3, 0.1, 0.0, 0.6, PAINT), 0.2, -0.3, 0.7, -0.4),
}


@pytest.mark.parametrize('name', SOLIDS)
def test_a_ray_ends_where_the_definition_of_a_solid_begins(textures: Textures, name: str) -> None:
    solid = SOLIDS[name]
    room = room_of(textures, solid)
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(3000, 3))
    origins *= 2.5 / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = rng.uniform(-0.8, 0.8, (3000, 3)) - origins
    origins[:20] = np.column_stack([rng.uniform(-0.3, 0.5, (20, 2)), np.full(20, 2.0)])
    directions[:20] = (0.0, 0.0, -1.0)
    directions[20:40] *= (1.0, 1.0, 0.0)  # level
    directions[40:60] *= (1.0, 0.0, 0.0)
    distances = room.cast(origins, directions)

    hit = np.isfinite(distances)
    assert hit[:20].any()
    assert 200 < hit.sum() < 2900
    just_before = origins[hit] + (distances[hit, None] - 1e-6) * directions[hit]
    just_behind = origins[hit] + (distances[hit, None] + 1e-6) * directions[hit]
    assert not inside(solid, just_before).any()
    # A ray may graze an edge over less than the step.
    assert inside(solid, just_behind).mean() > 0.995
    upto = np.where(hit, distances, 3.0)
    for share in np.linspace(0.0, 1.0, 400, endpoint=False):
        assert not inside(solid, origins + share * upto[:, None] * directions).any()


def test_the_nearest_of_several_solids_is_hit(textures: Textures) -> None:
    room = room_of(textures, box(3.0, 0.0, 0.2, 4.0), cylinder(1.5, 0.0, 0.1, -1.0, 1.0, PAINT))
    distances = room.cast((0.0, 0.0, 0.0), [(1.0, 0.0, 0.0), (1.0, 0.5, 0.0), (-1.0, 0.0, 0.0)])
    np.testing.assert_allclose(distances, [1.4, 2.9, np.inf], atol=1e-12)


def test_openness_is_the_mean_of_what_rays_over_all_solids_tell(
    textures: Textures, furnished: Room
) -> None:
    geometry, _ = pack(list(furnished.solids), textures)
    rng = np.random.default_rng(3)
    points = rng.uniform((-2.5, -3.0, -0.9), (2.5, 3.0, 1.8), (1500, 3))
    points = points[~np.any([inside(solid, points) for solid in furnished.solids], axis=0)]
    sides = rng.normal(size=(14, 3))
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    shares = np.empty(len(points))
    hits.openness(geometry, points, sides, 0.6, shares)

    paths = np.stack([np.minimum(furnished.cast(points, side), 0.6) for side in sides])
    np.testing.assert_allclose(shares, paths.mean(axis=0) / 0.6, atol=1e-12)
    assert 0.1 < np.mean(shares > 0.999) < 0.9


def test_noise_has_its_band_and_no_more() -> None:
    spectrum = np.abs(np.fft.fft2(noise(np.random.default_rng(4), 128, 40.0, 5.0)))
    f = np.hypot(np.fft.fftfreq(128)[:, None], np.fft.fftfreq(128))
    within = (f >= 1 / 40) & (f <= 1 / 5)
    assert spectrum[~within].max() < 1e-3 * np.median(spectrum[within])
    rings = [
        np.mean(spectrum[(f > low) & (f < low + 0.03)] ** 2) ** 0.5 for low in (0.04, 0.08, 0.16)
    ]
    middles = np.array((0.055, 0.095, 0.175))
    np.testing.assert_allclose(rings / rings[0], middles[0] / middles, rtol=0.15)


@pytest.mark.parametrize('gamma', [0.0, 0.7, -2.0])
@pytest.mark.parametrize(('left', 'up'), [(0.15, 0.1), (-0.2, -0.12)])
def test_a_point_appears_where_the_pinhole_puts_it(
    textures: Textures, gamma: float, left: float, up: float
) -> None:
    """A bright ball 1.5 m ahead of the camera; its rim is counted in eighths of a pixel."""
    ahead = RADIUS + 1.5
    x = ahead * math.cos(gamma) - left * math.sin(gamma)
    y = ahead * math.sin(gamma) + left * math.cos(gamma)
    glowing = Material('paint', 1.0, glow=1.3)
    plain = textures._replace(texels=np.full_like(textures.texels, 150))
    room = room_of(plain, ellipsoid(x, y, up, 0.03, 0.03, glowing))
    image = room.render(gamma, CAMERA, RADIUS)[..., 1].astype(float)
    v, u = np.mgrid[0:120, 0:160]
    assert (image * u).sum() / image.sum() == pytest.approx(
        CAMERA.cx - CAMERA.fx * left / 1.5, abs=0.08
    )
    assert (image * v).sum() / image.sum() == pytest.approx(
        CAMERA.cy - CAMERA.fy * up / 1.5, abs=0.08
    )


def test_texture_is_not_mirrored(textures: Textures) -> None:
    """A picture whose left half is dark, on each side of a box in turn."""
    size = int(textures.size[NAMES.index('view')])
    texels = textures.texels.copy()
    start = 3 * textures.start[NAMES.index('view'), 0]
    half_dark = np.full((size, size, 3), 200, np.uint8)
    half_dark[:, : size // 2] = 20
    half_dark[: size // 2] //= 2
    texels[start : start + half_dark.size] = half_dark.ravel()
    sign = Material('view', glow=1.0)
    for quarter in range(4):
        room = room_of(
            textures._replace(texels=texels),
            box(
                1.0, 0.0, 0.3, 0.3, bottom=-0.15, top=0.15, material=sign, yaw=quarter * np.pi / 2
            ),
        )
        # Level 0 of the texture is seen from close by only.
        close = RoomCamera.from_field_of_view(1280, 960, math.radians(34.0))
        image = room.render(0.0, close, RADIUS)[..., 0]
        quadrants = [image[y, x] for y in (430, 530) for x in (590, 690)]
        assert quadrants == [10, 100, 20, 200]


def test_a_frame_is_the_mean_of_finer_ones(furnished: Room) -> None:
    """No aliasing: a frame agrees with one rendered four times as fine and then averaged."""
    fine = RoomCamera.from_field_of_view(640, 480, math.radians(34.0))
    for gamma in np.arange(0.0, 6.0, 0.5):
        image = furnished.render(gamma, CAMERA, RADIUS).astype(float)
        wanted = cv2.resize(
            furnished.render(gamma, fine, RADIUS), (160, 120), interpolation=cv2.INTER_AREA
        )
        # The frame is a little softer than a plain mean: its blur is part of the model.
        softened = cv2.GaussianBlur(wanted.astype(float), (0, 0), 0.45)
        difference = np.abs(image - softened)[2:-2, 2:-2]
        assert np.median(difference) < 2.0
        assert np.percentile(difference, 98.0) < 15.0


def test_a_column_is_that_of_the_whole_frame(furnished: Room) -> None:
    for gamma in np.arange(0.0, 6.0, 0.7):
        whole = furnished.render(gamma, CAMERA, RADIUS)
        for u in (0, 79, 159):
            column = furnished.render(gamma, CAMERA.column(u), RADIUS)
            np.testing.assert_allclose(column[:, 0].astype(int), whole[:, u], atol=1)


@pytest.mark.parametrize('v', [0, 60, 119])
def test_a_row_is_that_of_the_whole_frame(furnished: Room, v: int) -> None:
    whole = furnished.render(1.0, CAMERA, RADIUS)
    row = furnished.render(1.0, replace(CAMERA, height=1, cy=CAMERA.cy - v), RADIUS)
    assert np.array_equal(row[0], whole[v])


def test_nothing_in_view_is_left_out(furnished: Room, textures: Textures) -> None:
    """A closed room whose every face shines has no dark pixel, however little of a face shows."""
    shining = Material('paint', 1.0, glow=1.0)
    solids = [
        replace(solid, material=shining, faces={})
        if isinstance(solid, Box)
        else replace(solid, material=shining)
        for solid in furnished.solids
    ]
    room = room_of(textures, *solids)
    for width, field_of_view in ((24, 34.0), (24, 100.0), (2, 1.0)):
        camera = RoomCamera.from_field_of_view(width, 18, math.radians(field_of_view))
        for gamma in np.arange(0.0, 6.28, 0.1):
            assert room.render(gamma, camera, RADIUS).min() > 150


def test_frames_look_lit(furnished: Room) -> None:
    around = [furnished.render(gamma, CAMERA, RADIUS) for gamma in np.arange(0.0, 6.28, 0.5)]
    assert 60 < np.mean(around) < 170
    assert np.mean(np.array(around) == 255) < 0.05
    assert np.mean(np.array(around) == 0) < 0.02


def test_a_seed_gives_one_room(furnished: Room) -> None:
    again, other = furnished_room(0), furnished_room(1)
    first = furnished.render(0.3, CAMERA, RADIUS)
    np.testing.assert_array_equal(again.render(0.3, CAMERA, RADIUS), first)
    assert np.abs(other.render(0.3, CAMERA, RADIUS).astype(int) - first).mean() > 5.0


@pytest.mark.parametrize('seed', [0, 1, 2, 7])
def test_the_arm_is_free_and_the_room_is_closed(seed: int) -> None:
    room = furnished_room(seed)
    azimuth, slope = np.meshgrid(np.linspace(0, 2 * np.pi, 1440), np.linspace(-1.2, 1.2, 31))
    directions = np.column_stack([np.cos(azimuth).ravel(), np.sin(azimuth).ravel(), slope.ravel()])
    distances = room.cast((0.0, 0.0, 0.0), directions)
    assert distances.max() < 5.0
    level = distances[slope.ravel() == 0.0]
    assert distances[np.abs(slope.ravel()) < 0.9].min() >= CLEARANCE
    assert np.ptp(level) > 1.0


def test_the_outline_is_what_level_rays_meet(furnished: Room) -> None:
    azimuth = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    rays = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(720)])
    points = (furnished.cast((0.0, 0.0, 0.0), rays)[:, None] * rays)[:, :2]
    segments = np.array(furnished.outline(0.0))
    start, edge = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum((edge**2).sum(axis=1), 1e-12)
    share = ((points[:, None] - start) * edge).sum(axis=2) / length
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * edge
    off = np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1)
    assert off.max() < 0.002  # a chord of 1/48 of a circle of 0.33 m


def panorama_rays(columns: int = 360) -> tuple[Array, Array]:
    """Ray azimuths, clockwise, and slopes of the rows of the standard camera."""
    azimuth = (columns / 2 - np.arange(columns)) * (2.0 * np.pi / columns)
    slope = (CAMERA.cy - np.arange(0, 120, 7)) / (CAMERA.fy / math.cos(PHI))
    return azimuth, slope


@pytest.mark.parametrize('ray_angle', [-PHI, PHI, 0.0])
def test_truth_in_a_round_room(textures: Textures, ray_angle: float) -> None:
    """720 walls around the axis: l is the same everywhere, nothing is hidden."""
    turns = np.arange(720) * (2.0 * np.pi / 720)
    walls = [box(2.1 * math.cos(t), 2.1 * math.sin(t), 0.2, 0.02, yaw=float(t)) for t in turns]
    azimuth, slope = panorama_rays()
    truth = truth_panorama(
        room_of(textures, *walls),
        arm_radius=RADIUS,
        ray_angle=ray_angle,
        ray_azimuth=azimuth,
        slope=slope,
    )
    np.testing.assert_allclose(truth.radial_distance, 2.0, rtol=2e-5)
    forward = math.sqrt(4.0 - (RADIUS * math.sin(ray_angle)) ** 2) - RADIUS * math.cos(ray_angle)
    np.testing.assert_allclose(truth.height, np.outer(slope * forward, np.ones(360)), atol=1e-4)
    assert not truth.occluded.any()


def test_truth_before_a_plane_wall(textures: Textures) -> None:
    room = room_of(textures, box(2.1, 0.0, 0.2, 20.0, yaw=0.0, bottom=-5.0, top=5.0))
    for ray_angle in (-PHI, PHI, np.linspace(-PHI - 0.05, -PHI + 0.05, 61)):
        azimuth = np.linspace(-0.9, 0.9, 61)
        truth = truth_panorama(
            room, arm_radius=RADIUS, ray_angle=ray_angle, ray_azimuth=azimuth, slope=[0.1, 0.0]
        )
        # From the camera at γ = β − ψ straight to x = 2.
        gamma = azimuth - ray_angle
        away = (2.0 - RADIUS * np.cos(gamma)) / np.cos(azimuth)
        y = RADIUS * np.sin(gamma) + away * np.sin(azimuth)
        np.testing.assert_allclose(truth.radial_distance[1], np.hypot(2.0, y), atol=1e-12)
        np.testing.assert_allclose(truth.height[0], 0.1 * away, atol=1e-12)
        np.testing.assert_array_equal(truth.height[1], 0.0)
        assert not truth.occluded.any()


def test_truth_says_what_nothing_is(textures: Textures) -> None:
    room = room_of(textures, box(2.1, 0.0, 0.2, 1.0))
    truth = truth_panorama(
        room, arm_radius=RADIUS, ray_angle=-PHI, ray_azimuth=[0.0, np.pi], slope=[0.0]
    )
    assert np.isfinite(truth.radial_distance[0, 0])
    assert np.isposinf(truth.radial_distance[0, 1])
    assert np.isnan(truth.height[0, 1])
    assert truth.occluded[0, 1]


@pytest.mark.parametrize('ray_angle', [-PHI, PHI])
def test_truth_knows_what_a_pole_hides_from_the_other_eye(
    textures: Textures, ray_angle: float
) -> None:
    """Seen by one eye at β and by the other at 2α − β: the pole stands in that way or not."""
    pole = np.array([1.2, 0.1])
    room = room_of(
        textures,
        cylinder(pole[0], pole[1], 0.05, -1.0, 1.0, PAINT),
        box(3.1, 0.0, 0.2, 20.0),
    )
    azimuth = np.linspace(-0.5, 0.6, 1101)
    truth = truth_panorama(
        room, arm_radius=RADIUS, ray_angle=ray_angle, ray_azimuth=azimuth, slope=[0.0]
    )
    distance = truth.radial_distance[0]
    alpha = azimuth - np.arcsin(RADIUS * np.sin(ray_angle) / distance)
    other = 2.0 * alpha - azimuth + ray_angle
    eye = RADIUS * np.column_stack([np.cos(other), np.sin(other)])
    point = distance[:, None] * np.column_stack([np.cos(alpha), np.sin(alpha)])
    way = point - eye
    share = np.clip(((pole - eye) * way).sum(axis=1) / (way**2).sum(axis=1), 0.0, 1.0)
    gap = np.linalg.norm(eye + share[:, None] * way - pole, axis=1) - 0.05
    on_wall = point[:, 0] > 2.9
    hidden = gap < 0.0
    clear = on_wall & (np.abs(gap) > 1e-6)
    np.testing.assert_array_equal(truth.occluded[0][clear], hidden[clear])
    assert 10 < truth.occluded[0].sum() < 200
    assert (~on_wall).sum() > 10


def test_truth_agrees_with_the_pictures(furnished: Room) -> None:
    """Where a point is visible to both eyes, both panoramas show the same colour there."""
    columns = 900
    azimuth = (columns / 2 - np.arange(columns)) * (2.0 * np.pi / columns)
    slope = (CAMERA.cy - np.arange(120)) / (CAMERA.fy / math.cos(PHI))
    left, right = (
        np.stack(
            [furnished.render(b - sign * PHI, CAMERA.column(u), RADIUS)[:, 0] for b in azimuth],
            axis=1,
        ).astype(float)
        for sign, u in ((-1, 150), (1, 9))
    )
    truth = truth_panorama(
        furnished, arm_radius=RADIUS, ray_angle=-PHI, ray_azimuth=azimuth, slope=slope
    )
    delta = 2.0 * np.arcsin(RADIUS * math.sin(PHI) / truth.radial_distance)
    other = (np.arange(columns) - delta * columns / (2.0 * np.pi)) % columns
    low = np.floor(other).astype(int)
    part = (other - low)[..., None]
    rows = np.arange(120)[:, None]
    seen = (1 - part) * right[rows, low] + part * right[rows, (low + 1) % columns]
    difference = np.abs(seen - left).mean(axis=2)
    assert np.median(difference[~truth.occluded]) < 3.0
    assert np.median(difference[truth.occluded]) > 10.0
