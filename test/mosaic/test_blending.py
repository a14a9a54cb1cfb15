"""Columns between two frames of a steadily turning arm are the mean of both."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.steady import SteadySweep

COLUMNS = 180
STEP = 2 * math.pi / COLUMNS
F = 1 / math.tan(STEP)  # one pixel per column step near the centre
CAMERA = PinholeCamera(width=61, height=9, fx=F, fy=F, cx=30.0, cy=4.0)
#: A frame reaches 4.75 columns to either side.
RIG = Rig(
    arm_radius=0.3,
    column_offset=14.0,
    columns=COLUMNS,
    sweep_columns=COLUMNS,
    stripe_columns=9,
    stripe_distance=2.0,
)


def swept(places, image, kind=SteadySweep):
    """Sweep of frames taken where the arm was at these places [columns]."""
    sweep = kind(RIG, CAMERA, places[0] * STEP)
    for k, place in enumerate(places):
        sweep.add(1 + k, image(k, place), place * STEP)
    return sweep


def turned(image, kind=SteadySweep, way=4.0):
    """A full turn."""
    sweep = swept(np.arange(0.0, COLUMNS, way).tolist(), image, kind)
    if kind is SteadySweep:
        sweep.close(image(0, COLUMNS), COLUMNS * STEP, 0.0)
    assert sweep.complete
    return sweep


def level(k, _place):
    """Frame of one grey level, 100 and 200 in turn."""
    return np.full((9, 61), 100 + 100 * (k % 2), np.uint8)


def deviation(panorama):
    """Ray angles less the principal angle [columns]."""
    return (panorama.geometry.ray_angle - panorama.geometry.principal_angle) / STEP


@pytest.mark.parametrize('direction', [1, -1])
@pytest.mark.parametrize(
    ('way', 'shares'),
    [
        # Both frames reach all columns between them, ...
        (2, [0.0, 0.5]),
        (4, [0.0, 0.25, 0.5, 0.75]),
        # ... or those from 2.25 to 4.75 columns beyond the one, or only the middle one.
        (7, [0.0, 0.0, 0.0, 0.3, 0.7, 1.0, 1.0]),
        (8, [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0]),
    ],
)
def test_shares_grow_from_frame_to_frame(way, shares, direction):
    places = [direction * way * k for k in range(3)]
    sweep = swept(places, level)
    between = np.arange(way)
    x = COLUMNS // 2 - direction * between
    for panorama in sweep.panoramas().values():
        assert panorama.image[4, x] == pytest.approx(100 + 100 * np.array(shares), abs=0.51)
        # The ray is the mean of the two rays, by the same shares.
        phi = panorama.geometry.principal_angle
        rays = [
            [RIG.ray_angle(phi, direction * off * STEP) for off in (column, column - way)]
            for column in between
        ]
        mean = [(1 - share) * a + share * b for share, (a, b) in zip(shares, rays, strict=True)]
        assert panorama.geometry.ray_angle[x] == pytest.approx(mean, abs=1e-9)


def test_rays_are_one_angle_where_both_frames_reach():
    for panorama in turned(level).panoramas().values():
        assert np.abs(deviation(panorama)).max() < 0.01
    plain = turned(level, Sweep).panoramas()['left']
    assert np.ptp(deviation(plain)) > 3.0


def wall(distance):
    """What a cylinder of that radius [m] around the axis shows, smooth."""

    def image(_k, place):
        u = np.arange(61)
        psi = -np.arctan((u - 30.0) / F)
        beta = place * STEP + psi
        azimuth = beta - np.arcsin(0.3 * np.sin(psi) / distance)
        return np.tile(np.rint(128 + 100 * np.sin(18 * azimuth)), (9, 1)).astype(np.uint8)

    return image


@pytest.mark.parametrize('distance', [0.8, 1.2, 8.0])
def test_walls_at_any_distance_join(distance):
    # What the panorama shows, against what its rays say that it should.
    steps = {}
    for kind in (SteadySweep, Sweep):
        panorama = turned(wall(distance), kind).panoramas()['right']
        geometry = panorama.geometry
        azimuth = geometry.ray_azimuth(np.arange(COLUMNS))
        azimuth -= np.arcsin(0.3 * np.sin(geometry.ray_angle) / distance)
        off = panorama.image[4] - (128 + 100 * np.sin(18 * azimuth))
        assert np.abs(off).max() < 9.0
        steps[kind] = np.ptp(np.diff(azimuth)) / STEP
    assert steps[SteadySweep] < 0.01
    assert steps[Sweep] > 0.2


def test_sweep_holds_what_lies_between_its_first_and_last_frame():
    sweep = SteadySweep(RIG, CAMERA, 0.0)
    assert sweep.add(1, level(0, 0), 0.0) == 0
    assert sweep.start is None
    assert sweep.add(2, level(1, 4), 4 * STEP) == 5
    assert sweep.add(3, level(0, 8), 8 * STEP) == 4
    assert (sweep.start, sweep.end) == (1, 3)
    assert np.flatnonzero(sweep.seen).tolist() == list(range(90 - 8, 90 + 1))


@pytest.mark.parametrize('direction', [1, -1])
def test_frame_after_the_last_one_closes_a_turn_and_changes_nothing_else(direction):
    places = [direction * 3.7 * k for k in range(49)]  # to 177.6, the next is at 181.3
    sweep = swept(places, level)
    before = {name: p.image.copy() for name, p in sweep.panoramas().items()}
    seen, end = sweep.seen, sweep.end
    assert (~seen).sum() == 2
    sweep.close(level(49, 0), direction * 181.3 * STEP, 0.0)
    assert sweep.complete
    assert sweep.end == end
    for name, panorama in sweep.panoramas().items():
        assert np.array_equal(panorama.image[:, seen], before[name][:, seen])
        assert np.abs(deviation(panorama)).max() < 0.01


def test_gap_wider_than_two_frames_reach_stays_unknown():
    sweep = swept([0.0, 4.0, 15.0, 19.0], level)
    # 4.75 columns beyond the one and before the other.
    assert np.flatnonzero(~sweep.seen[90 - 19 : 91]).tolist() == [19 - 10, 19 - 9]
