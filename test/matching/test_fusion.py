"""The matching with all panoramas of a sweep, against geometry and generated rooms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import pair_of, texture

from benchmarks import accuracy, scenes
from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching import Correspondence, aggregation, fusion, match, semiglobal
from panodepth_ros.matching.aggregation import Tiling
from panodepth_ros.matching.fusion_views import view_of

Array = npt.NDArray[np.float64]

ROWS, COLUMNS = 40, 600
STEP = 2 * math.pi / COLUMNS
RADIUS, PAIR_ANGLE, FOCAL = 0.3, 0.25, 150.0
#: Principal angles of the further panoramas.
ANGLES = (-0.2, -0.1, 0.0, 0.12, 0.21)


def geometry(angle: float) -> PanoramaGeometry:
    return PanoramaGeometry(
        columns=COLUMNS,
        rows=ROWS,
        azimuth_column=COLUMNS / 2 + angle / STEP,
        focal_length_px=FOCAL / math.cos(angle),
        principal_row=(ROWS - 1) / 2 + 0.4,
        arm_radius=RADIUS,
        principal_angle=angle,
        sweep_duration=0.0,
        ray_angle=np.full(COLUMNS, angle),
    )


def cylinder(
    angle: float,
    distance: float,
    *,
    rng: np.random.Generator,
    noise: float = 2.0,
) -> Panorama:
    """
    A textured wall at one radial distance as an eye sees it, by the rays of its pixels.
    """
    eye = geometry(angle)
    signal = texture(np.random.default_rng(0), 4 * ROWS, COLUMNS)
    fine = signal.shape[1]
    azimuth = eye.ray_azimuth(np.arange(COLUMNS)) - np.arcsin(
        RADIUS * np.sin(eye.ray_angle) / distance
    )
    depth = np.sqrt(distance**2 - (RADIUS * np.sin(eye.ray_angle)) ** 2)
    depth -= RADIUS * np.cos(eye.ray_angle)
    height = np.outer(eye.slope(np.arange(ROWS)), depth)
    # The wall shows row 2·ROWS at height 0 and one row more per FOCAL-th of its distance.
    row = np.clip(2 * ROWS - height / distance * FOCAL, 0, 4 * ROWS - 2)
    upper = np.floor(row).astype(int)
    column = (-azimuth / STEP * (fine // COLUMNS)) % fine
    first = np.floor(column).astype(int)
    share, part = row - upper, column - first
    second = (first + 1) % fine
    levels = (1 - share) * ((1 - part) * signal[upper, first] + part * signal[upper, second])
    levels += share * ((1 - part) * signal[upper + 1, first] + part * signal[upper + 1, second])
    levels += rng.normal(0, noise, levels.shape)
    return Panorama(np.clip(np.rint(levels), 0, 255).astype(np.uint8), eye)


def sweep(
    distance: float, *, seed: int = 1, noise: float = 2.0
) -> tuple[Panorama, Panorama, list[Panorama]]:
    rng = np.random.default_rng(seed)
    left, right, *further = [
        cylinder(angle, distance, rng=rng, noise=noise)
        for angle in (-PAIR_ANGLE, PAIR_ANGLE, *ANGLES)
    ]
    return left, right, further


def with_image(panorama: Panorama, image: npt.NDArray[np.uint8]) -> Panorama:
    return Panorama(image, panorama.geometry)


def same(one: Correspondence, other: Correspondence) -> bool:
    return (
        one.column_disparity.tobytes() == other.column_disparity.tobytes()
        and one.confidence.tobytes() == other.confidence.tobytes()
    )


@pytest.mark.parametrize('angle', [-0.24, -0.1, 0.0, 0.17, 0.35])
def test_view_shows_a_point_where_its_ray_passes(angle: float) -> None:
    """The point's column by bisection over the arm's azimuth, without the arcsine."""
    left, right, other = (geometry(a) for a in (-PAIR_ANGLE, PAIR_ANGLE, angle))
    image = np.zeros((ROWS, COLUMNS), np.uint8)

    def seen_at(eye: PanoramaGeometry, azimuth: float, distance: float, height: float) -> Array:
        point = distance * np.array([math.cos(azimuth), math.sin(azimuth)])

        def ahead(arm: float) -> float:
            """Azimuth of the point from the camera, beyond the eye's ray."""
            x, y = point - RADIUS * np.array([math.cos(arm), math.sin(arm)])
            turn = math.atan2(y, x) - arm - eye.principal_angle
            return (turn + math.pi) % (2 * math.pi) - math.pi

        low, high = azimuth - 0.7, azimuth + 0.7
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if ahead(middle) > 0 else (low, middle)
        camera = RADIUS * np.array([math.cos(low), math.sin(low)])
        depth = float(np.hypot(*(point - camera)))
        column = eye.azimuth_column - (low + eye.principal_angle) / eye.column_step
        return np.array([column, eye.principal_row - height / depth * eye.focal_length_px])

    for azimuth, distance, height in ((0.3, 0.5, 0.1), (-2.0, 1.3, -0.2), (1.0, 6.0, 0.9)):
        places = [seen_at(eye, azimuth, distance, height) for eye in (left, right, other)]
        disparity = np.array([places[1][0] - places[0][0]])
        view = view_of(Panorama(image, other), left, right, disparity)
        assert places[0][0] + view.shift[0] == pytest.approx(places[2][0], abs=1e-6)
        row = view.rows(np.array([places[0][1]]), np.array([0]))[0]
        assert row == pytest.approx(places[2][1], abs=1e-6)


@pytest.mark.parametrize('distance', [1.5, 4.0])
def test_noise_shows_less_in_the_disparity_than_with_the_pair_alone(distance: float) -> None:
    left, right, further = sweep(distance, noise=12.0)
    angle = 2 * (PAIR_ANGLE - math.asin(RADIUS * math.sin(PAIR_ANGLE) / distance))
    truth = angle / STEP  # eq. 2 and 4
    alone, fused = (match(left, right, further=f).column_disparity for f in ((), further))
    assert np.isfinite(fused).mean() > 0.98
    spread = [np.sqrt(np.nanmean((found - truth) ** 2)) for found in (alone, fused)]
    assert spread[1] < 0.95 * spread[0]
    assert np.abs(np.nanmean(fused - truth)) < 0.05


def test_without_further_panoramas_it_is_the_pair_s_matching() -> None:
    left, right, _ = sweep(1.5)
    assert same(match(left, right), semiglobal.match_semiglobal(left, right, (), 1))


def test_order_and_threads_do_not_show() -> None:
    left, right, further = sweep(1.0, noise=6.0)
    one = match(left, right, further=further)
    assert same(one, match(left, right, further=further[::-1], threads=3))


@pytest.mark.parametrize('columns_rolled', [1, 299, -7])
def test_rolling_all_panoramas_rolls_the_result(
    columns_rolled: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Little more than noise, everything kept: where tiles begin and end must show if it can.
    monkeypatch.setattr(semiglobal, 'LEAST_CONFIDENCE', 0.0)
    rng = np.random.default_rng(4)
    left, right, further = sweep(1.0)
    panoramas = []
    for panorama in (left, right, *further):
        levels = 128 + 0.05 * (panorama.image.astype(float) - 128)
        levels += rng.normal(0, 2, levels.shape)
        panoramas.append(with_image(panorama, np.rint(levels).astype(np.uint8)))
    rolled = [with_image(p, np.roll(p.image, columns_rolled, axis=1)) for p in panoramas]
    here = match(*panoramas[:2], further=panoramas[2:])
    there = match(*rolled[:2], further=rolled[2:])
    for name in ('column_disparity', 'confidence'):
        expected = np.roll(getattr(here, name), columns_rolled, axis=1)
        np.testing.assert_array_equal(getattr(there, name), expected)


def test_tiles_hardly_show(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, further = sweep(0.8, noise=6.0)
    whole = match(left, right, further=further).column_disparity
    monkeypatch.setattr(aggregation, 'TILE_ROWS', 16)
    monkeypatch.setattr(fusion, 'TILING', Tiling(reach=8, widest=24, size=9_000_000))
    tiled = match(left, right, further=further).column_disparity
    assert np.nanmax(np.abs(tiled - whole)) < 0.5
    assert np.mean(np.isfinite(tiled) != np.isfinite(whole)) < 0.005


def test_unseen_columns_are_nan_and_what_stands_in_them_does_not_matter() -> None:
    left, right, further = sweep(1.0)
    truth = match(left, right, further=further).column_disparity

    def gapped(panorama: Panorama, columns: Sequence[int], level: int) -> Panorama:
        angles, image = panorama.geometry.ray_angle.copy(), panorama.image.copy()
        angles[columns] = np.nan
        image[:, columns] = level
        return Panorama(image, replace(panorama.geometry, ray_angle=angles))

    results = [
        match(
            gapped(left, [50, 51, 300], level),
            right,
            further=[gapped(p, [100, 101, 102, 400 + k], level) for k, p in enumerate(further)],
        )
        for level in (0, 255)
    ]
    assert same(*results)
    found = results[0].column_disparity
    assert np.all(np.isnan(found[:, [50, 51, 300]]))
    others = np.delete(found - truth, [50, 51, 300], axis=1)
    assert np.isfinite(others).mean() > 0.98
    assert np.mean(np.abs(others[np.isfinite(others)]) > 1) < 0.001


def test_another_exposure_of_further_panoramas_changes_little() -> None:
    """A lens that is darker at the side gives the middle columns more light."""
    left, right, further = sweep(1.0)
    plain = match(left, right, further=further).column_disparity
    dimmed = [with_image(p, (0.8 * p.image).astype(np.uint8)) for p in (left, right)]
    found = match(*dimmed, further=further).column_disparity
    assert np.isfinite(found).mean() > 0.98
    assert np.nanmedian(np.abs(found - plain)) < 0.1


def test_fewer_errors_than_the_pair_in_a_room() -> None:
    """A third of the usual columns, 49 candidates, noise of 1.5 grey levels."""
    room = scenes.own_room(2, columns=600)
    alone, fused = (
        accuracy.measure(match(room.left, room.right, further=further), room)
        for further in ((), room.further)
    )
    assert fused.wrong_at(0.9) < 0.9 * alone.wrong_at(0.9)
    assert fused.kept > alone.kept
    # Promised and held, where a tenth of the confidences holds enough pixels to judge.
    promised, held, share = fused.reliability
    np.testing.assert_array_less((promised - held)[share > 0.02], 0.1)


def test_unusable_panoramas_are_named() -> None:
    left, right, further = sweep(1.0)
    eye = further[1].geometry
    small = pair_of(left.image[:, :300], right.image[:, :300], 30)[0]
    for bad, message in (
        (small, r'further\[1\] has 300 × 40 pixels; allowed: 600 × 40'),
        (Panorama(left.image, replace(eye, arm_radius=0.31)), r'further\[1\] has arm radius 0.31'),
        (left, r'further\[1\] has principal angle -0.25 rad, as the left panorama'),
        (
            Panorama(left.image, replace(eye, ray_angle=eye.ray_angle + 3 * STEP)),
            r'further\[1\] has ray angles up to .* allowed: .*, 2 column steps',
        ),
    ):
        with pytest.raises(ValueError, match=message):
            match(left, right, further=[further[0], bad])


def test_prepare_leaves_nothing_to_compile() -> None:
    fusion.prepare()
    kernels = [aggregation.match_tile, fusion.add_view]
    compiled = [len(kernel.signatures) for kernel in kernels]
    assert min(compiled) > 0
    left, right, further = sweep(1.0)
    match(left, right, further=further)
    coloured = [with_image(p, np.stack([p.image] * 3, axis=2)) for p in (left, right, *further)]
    match(*coloured[:2], further=coloured[2:])
    assert [len(kernel.signatures) for kernel in kernels] == compiled
