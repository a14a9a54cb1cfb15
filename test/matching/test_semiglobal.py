"""The semi-global matching, against disparities that are known."""

from __future__ import annotations

import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import noise_image, pair_of, shifted_pair, texture

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import (
    Correspondence,
    aggregation,
    confidence,
    evaluation,
    exposure,
    match,
    refinement,
    semiglobal,
    semiglobal_paths,
)
from panodepth_ros.matching.aggregation import PAIR_TILING, Tiling, Winners, aggregate
from panodepth_ros.matching.colour_pair import colour_pair

ROWS, COLUMNS, CANDIDATES = 40, 320, 45


def matched(pair: tuple[Panorama, Panorama], threads: int = 1) -> Correspondence:
    return match(*pair, method='semiglobal', threads=threads)


def raw_match(left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]) -> Correspondence:
    """Match and keep everything, however improbable."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(semiglobal, 'LEAST_CONFIDENCE', 0.0)
        return matched(pair_of(left, right, CANDIDATES))


def slanted(rows: int = ROWS, columns: int = COLUMNS) -> npt.NDArray[np.float64]:
    """A disparity that wanders smoothly around the turn between 12.3 and 31.7."""
    x = 2 * np.pi * np.arange(columns) / columns
    return np.tile(22.0 + 9.7 * np.sin(x), (rows, 1))


def wandering_pair(noise: float = 1.0, seed: int = 1) -> tuple[npt.NDArray[np.uint8], ...]:
    rng = np.random.default_rng(seed)
    return shifted_pair(texture(rng, ROWS, COLUMNS), slanted(), noise=noise, rng=rng)


def occluded_pair(seed: int = 2) -> tuple[npt.NDArray[np.uint8], ...]:
    """
    A near board before a far wall: left, right, true disparity, what only the left eye sees.

    The wall is at disparity 40, the board at 20 covers the columns 100 … 159 of the left image.
    """
    rng = np.random.default_rng(seed)
    wall, board = noise_image(rng, ROWS, COLUMNS), noise_image(rng, ROWS, 60)
    left, right = np.roll(wall, -40, axis=1), wall.copy()
    left[:, 100:160] = board
    right[:, 120:180] = board
    disparity = np.full((ROWS, COLUMNS), 40.0)
    disparity[:, 100:160] = 20.0
    hidden = np.zeros((ROWS, COLUMNS), bool)
    hidden[:, 80:100] = True  # their right column 120 … 139 shows the board
    return left, right, disparity, hidden


def test_sub_column_disparity_of_a_smooth_surface_without_pixel_locking() -> None:
    left, right = wandering_pair()
    found = matched(pair_of(left, right, CANDIDATES)).column_disparity
    error = found - slanted()
    assert np.isfinite(found).mean() > 0.99
    assert np.nanmedian(np.abs(error)) < 0.05
    # A parabola through aggregated costs pulls towards whole columns: an error that is a sine of
    # the fraction. What is left of it must be small beside that of a fit of 0.1 columns.
    fraction = slanted() - np.rint(slanted())
    locking = np.nanmean(error * np.sin(2 * np.pi * fraction))
    assert abs(locking) < 0.01


def test_a_plain_board_takes_its_depth_from_its_edges() -> None:
    left, right, disparity, hidden = occluded_pair()
    left[:, 106:154] = right[:, 126:174] = 128
    found = matched(pair_of(left, right, CANDIDATES)).column_disparity
    plain = np.zeros_like(hidden)
    plain[:, 106:154] = True
    wrong = np.abs(found - disparity)[plain] > 1
    assert wrong.mean() < 0.02


def test_a_thin_horizontal_board_is_not_taken_for_what_is_behind_it() -> None:
    # Two rows that hardly change along themselves, before a wall: a shelf's edge before books.
    found, right = [], []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wall = texture(rng, ROWS, COLUMNS, wavelength=20.0)[:, ::32]
        board = 60 + (texture(rng, ROWS, COLUMNS, wavelength=12.0)[0, : 100 * 32 : 32] - 128) / 4
        left, other = np.roll(wall, -30, axis=1), wall.copy()
        left[19:21, 90:190] = board
        other[19:21, 110:210] = board
        images = [
            np.clip(np.rint(image + rng.normal(0, 1, image.shape)), 0, 255).astype(np.uint8)
            for image in (left, other)
        ]
        raw = raw_match(*images).column_disparity[19:21, 90:190]
        kept = matched(pair_of(*images, CANDIDATES)).column_disparity[19:21, 90:190]
        found.append(np.mean(np.abs(raw - 20) <= 1))
        right.append(np.mean(np.abs(kept - 20) <= 1))
    assert np.mean(found) > 0.95
    assert np.mean(right) > 0.95


def test_smoothing_does_not_flatten_a_table_seen_at_a_grazing_angle() -> None:
    # A column nearer with every row, almost plain, below a box that is sure of its depth.
    rng = np.random.default_rng(6)
    step = np.clip(np.arange(ROWS) - 20, 0, 9)
    box, plain = (texture(rng, ROWS, COLUMNS, wavelength=w)[:, ::32] for w in (8.0, 12.0))
    image = np.where(step[:, np.newaxis] == 0, box, 110 + (plain[20] - 128) / 6)
    left = np.stack([np.roll(row, s - 30) for row, s in zip(image, step, strict=True)])
    images = [
        np.clip(np.rint(eye + rng.normal(0, 1, eye.shape)), 0, 255).astype(np.uint8)
        for eye in (left, image)
    ]
    error = raw_match(*images).column_disparity - (30 - step)[:, np.newaxis]
    assert np.mean(np.abs(error[20:30]) <= 1) > 0.95


def test_what_only_one_eye_sees_is_not_matched() -> None:
    left, right, disparity, hidden = occluded_pair()
    found = matched(pair_of(left, right, CANDIDATES))
    assert np.isfinite(found.column_disparity[hidden]).mean() < 0.1
    seen_by_both = np.isfinite(found.column_disparity) & ~hidden
    assert seen_by_both.sum() > 0.97 * (~hidden).sum()
    assert np.all(np.abs(found.column_disparity - disparity)[seen_by_both] <= 1)


def test_confidence_is_a_probability_where_there_is_a_disparity() -> None:
    left, right, _, _ = occluded_pair()
    found = matched(pair_of(left, right, CANDIDATES))
    matched_pixels = np.isfinite(found.column_disparity)
    assert np.array_equal(matched_pixels, np.isfinite(found.confidence))
    assert found.confidence[matched_pixels].min() >= semiglobal.LEAST_CONFIDENCE
    assert found.confidence[matched_pixels].max() <= 1


def test_agreement_in_colour_counts_seen_neighbours_of_like_colour_around_the_turn() -> None:
    rng = np.random.default_rng(11)
    rows, columns, side = 9, 40, confidence.ALIKE_COLUMNS
    best = rng.integers(0, 4, (rows, columns)).astype(np.int16)
    image = rng.integers(0, 40, (3, rows, columns)).astype(np.uint8)
    seen = rng.random(columns) < 0.8
    across = np.arange(-side, columns + side)
    far = confidence.FAR
    agreed = np.pad(best, ((far, far), (0, 0)), mode='edge').take(across, axis=1, mode='wrap')
    found = np.empty((rows, columns), np.float32)
    wrapped_seen = seen.take(across, mode='wrap')
    bordered = image.take(across, axis=2, mode='wrap')
    confidence.agreement_in_colour(best, agreed, bordered, wrapped_seen, 0, rows, found)
    for y, x in ((0, 0), (4, 39), (8, 20), (5, 3)):
        votes, alike = 0, 1
        for j in range(-confidence.ALIKE_ROWS, confidence.ALIKE_ROWS + 1):
            for i in range(-side, side + 1, confidence.ALIKE_STRIDE):
                row, column = min(max(y + j, 0), rows - 1), (x + i) % columns
                difference = np.abs(image[:, row, column].astype(int) - image[:, y, x]).max()
                if (j, i) == (0, 0) or not seen[column] or difference > confidence.ALIKE:
                    continue
                alike += 1
                votes += abs(int(best[row, column]) - int(best[y, x])) <= 1
        assert votes > 0
        assert found[y, x] == pytest.approx(votes / alike)


def test_unrelated_images_are_not_trusted() -> None:
    rng = np.random.default_rng(3)
    pair = pair_of(noise_image(rng, ROWS, COLUMNS), noise_image(rng, ROWS, COLUMNS), CANDIDATES)
    found = matched(pair)
    assert np.isfinite(found.column_disparity).mean() < 0.1
    assert not np.any(found.confidence > 0.9)


@pytest.mark.parametrize('level', [0, 255])
def test_a_black_or_overexposed_view_is_unknown(level: int) -> None:
    image = np.full((ROWS, COLUMNS), level, np.uint8)
    assert np.isnan(matched(pair_of(image, image, CANDIDATES)).column_disparity).all()


@pytest.mark.parametrize('level', [0, 255])
def test_a_black_or_overexposed_area_takes_no_depth_from_its_edges(level: int) -> None:
    # The edges are at the same columns in both eyes, as those of a reflection far away.
    rng = np.random.default_rng(9)
    right = np.clip(np.rint(texture(rng, ROWS, COLUMNS)[:, ::32]), 1, 254).astype(np.uint8)
    left = np.roll(right, -20, axis=1)
    left[10:30, 290:] = left[10:30, :80] = right[10:30, 290:] = right[10:30, :80] = level
    found = matched(pair_of(left, right, CANDIDATES)).column_disparity
    area = np.zeros((ROWS, COLUMNS), bool)
    area[10:30, 290:] = area[10:30, :80] = True
    assert np.isnan(found[area]).all()
    assert np.mean(np.abs(found[:, 150:250] - 20) < 0.5) > 0.99


def test_clipped_are_windows_of_one_extreme_value_around_the_turn() -> None:
    rng = np.random.default_rng(11)
    image = noise_image(rng, 3 * ROWS, COLUMNS * 3).reshape(ROWS, COLUMNS, 9)[..., :3].copy()
    image[5:15, 20:29], image[5:15, 40:48], image[20:26, 20:60] = 255, 255, 0
    image[30:, -5:], image[30:, :4], image[:9, -4:], image[:9, :4] = (0, 0, 255), (0, 0, 255), 0, 0
    image[5:15, 100:130], image[30:, 100:130], image[30:, 150:170] = 0, 255, 254
    image[5:15, 110:115] = 255
    image[20:36, 70:90, 2] = 255  # one channel tells nothing, the others do
    seen = np.ones(COLUMNS, bool)
    seen[122:124] = False
    expected = np.zeros((ROWS, COLUMNS), bool)
    expected[5:15, 20:29] = expected[30:, -5:] = expected[30:, :4] = True
    expected[5:15, 100:110] = expected[30:, 100:122] = True
    panorama, _ = pair_of(image, image, CANDIDATES, left_seen=seen)
    np.testing.assert_array_equal(exposure.clipped(panorama), expected)


def test_a_black_and_white_pattern_is_no_clipped_area() -> None:
    rng = np.random.default_rng(10)
    right = 255 * (noise_image(rng, ROWS, COLUMNS) >> 7)
    found = matched(pair_of(np.roll(right, -20, axis=1), right, CANDIDATES)).column_disparity
    assert np.mean(np.abs(found - 20) < 0.5) > 0.99


@pytest.mark.parametrize('columns_rolled', [1, 7, 159, -3])
def test_rolling_both_panoramas_rolls_the_result(columns_rolled: int) -> None:
    # Hardly more than noise: where tiles begin and end must show everywhere if it can show at all.
    rng = np.random.default_rng(8)
    plain = np.full((ROWS, COLUMNS), 128.0)
    plain[:, ::40] += 20
    left, right = (
        np.rint(plain + rng.normal(0, 2, plain.shape)).astype(np.uint8) for _ in range(2)
    )
    here = raw_match(left, right)
    rolled = [np.roll(image, columns_rolled, axis=1) for image in (left, right)]
    there = raw_match(*rolled)
    for name in ('column_disparity', 'confidence'):
        expected = np.roll(getattr(here, name), columns_rolled, axis=1)
        np.testing.assert_array_equal(getattr(there, name), expected)


def test_threads_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, 'ROW_BAND', 7)
    left, right = wandering_pair(noise=3.0)
    one = matched(pair_of(left, right, CANDIDATES), threads=1)
    three = matched(pair_of(left, right, CANDIDATES), threads=3)
    assert one.column_disparity.tobytes() == three.column_disparity.tobytes()
    assert one.confidence.tobytes() == three.confidence.tobytes()


def test_tiles_hardly_show(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = wandering_pair(noise=3.0)
    whole = matched(pair_of(left, right, CANDIDATES)).column_disparity
    monkeypatch.setattr(aggregation, 'TILE_ROWS', 16)
    monkeypatch.setattr(semiglobal, 'PAIR_TILING', Tiling(reach=8, widest=24, size=9_000_000))
    tiled = matched(pair_of(left, right, CANDIDATES)).column_disparity
    np.testing.assert_array_less(np.abs(tiled - whole)[np.isfinite(tiled - whole)], 0.5)
    assert np.mean(np.isfinite(tiled) != np.isfinite(whole)) < 0.005


def test_unseen_columns_are_nan_and_spoil_no_neighbour() -> None:
    left, right = wandering_pair()
    left_seen, right_seen = np.ones((2, COLUMNS), bool)
    left_seen[[50, 51, 52, 200]] = False
    right_seen[[10, 120]] = False
    # What stands in an unseen column must not matter.
    left[:, ~left_seen] = 255
    right[:, ~right_seen] = 0
    pair = pair_of(left, right, CANDIDATES, left_seen=left_seen, right_seen=right_seen)
    found = matched(pair)
    assert np.all(np.isnan(found.column_disparity[:, ~left_seen]))
    assert np.all(np.isnan(found.confidence[:, ~left_seen]))
    error = np.abs(found.column_disparity - slanted())
    beside = [47, 48, 49, 53, 54, 55, 198, 199, 201, 202]
    assert np.isfinite(error[:, beside]).mean() > 0.95
    assert np.nanmax(error[:, beside]) < 1
    # Where the right eye has the gap there may be no match, but no wrong one.
    assert np.nanmax(error) < 1
    assert np.isfinite(error[:, left_seen]).mean() > 0.97


def test_what_stands_in_unseen_left_columns_pulls_no_neighbour() -> None:
    rng = np.random.default_rng(9)
    right = noise_image(rng, ROWS, COLUMNS)
    right[:, 140:200] = 128
    left = np.roll(right, -40, axis=1)
    # In the middle of the plain part stands, unseen, a perfect match at disparity 5.
    seen = np.ones(COLUMNS, bool)
    seen[125:135] = False
    left[:, 125:135] = right[:, 130:140]
    found = matched(pair_of(left, right, CANDIDATES, left_seen=seen)).column_disparity
    beside = found[:, 135:150]
    assert np.isfinite(beside).mean() > 0.9
    assert np.nanmax(np.abs(beside - 40)) < 1


def test_what_stands_in_unseen_right_columns_attracts_no_match() -> None:
    rng = np.random.default_rng(10)
    wall = rng.normal(128, 4, (ROWS, COLUMNS))
    left = np.rint(wall + rng.normal(0, 2, wall.shape)).astype(np.uint8)
    right = np.rint(np.roll(wall, 30, axis=1) + rng.normal(0, 2, wall.shape)).astype(np.uint8)
    # Without noise and thus better than the true match, but unseen: the same at disparity 8.
    seen = np.ones(COLUMNS, bool)
    seen[108:130] = False
    right[:, 108:130] = left[:, 100:122]
    found = matched(pair_of(left, right, CANDIDATES, right_seen=seen)).column_disparity
    assert np.mean(np.abs(found[:, 101:121] - 30) <= 1) > 0.8


def test_partial_sweep_is_matched_where_both_eyes_saw() -> None:
    left, right = wandering_pair()
    seen = np.zeros(COLUMNS, bool)
    seen[40:200] = True
    pair = pair_of(left, right, CANDIDATES, left_seen=seen, right_seen=seen)
    found = matched(pair).column_disparity
    assert np.all(np.isnan(found[:, ~seen]))
    inside = found[:, 45:160]
    assert np.isfinite(inside).mean() > 0.97
    assert np.nanmax(np.abs(inside - slanted()[:, 45:160])) < 1


@pytest.mark.parametrize(('gain', 'offset'), [(1.1, 0.0), (1.0, 12.0), (0.9, 8.0)])
def test_another_exposure_of_one_eye_changes_little(gain: float, offset: float) -> None:
    left, right = wandering_pair()
    brighter = np.clip(np.rint(gain * (0.7 * right.astype(float) + 30) + offset), 0, 255)
    plainer = np.clip(np.rint(0.7 * left.astype(float) + 30), 0, 255).astype(np.uint8)
    found = matched(pair_of(plainer, brighter.astype(np.uint8), CANDIDATES)).column_disparity
    assert np.isfinite(found).mean() > 0.97
    assert np.nanmax(np.abs(found - slanted())) < 1


def test_colour_tells_apart_what_is_equally_bright() -> None:
    rng = np.random.default_rng(4)
    # Vertical stripes of 8 columns in colours that all have grey level 110.
    stripes = []
    for _ in range(COLUMNS // 8):
        blue, red = rng.uniform(40, 180, 2)
        green = (110 - 0.114 * blue - 0.299 * red) / 0.587
        stripes.append([blue, green, red])
    image = np.tile(np.repeat(stripes, 8, axis=0), (ROWS, 1, 1))
    image = np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)
    left = np.roll(image, -20, axis=1)
    found = matched(pair_of(left, image, CANDIDATES)).column_disparity
    assert np.mean(np.abs(found - 20) <= 1) > 0.9


def test_memory_does_not_grow_with_the_number_of_candidates_times_the_image() -> None:
    rng = np.random.default_rng(5)
    rows, columns, candidates = 144, 3600, 500
    right = noise_image(rng, rows, columns)
    left = np.roll(right, -250, axis=1)
    tracemalloc.start()
    try:
        found = matched(pair_of(left, right, candidates), threads=2)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert np.mean(np.abs(found.column_disparity - 250) < 0.5) > 0.99
    # The costs alone would take a byte for each of 259 million pixels times candidates.
    assert peak < 110e6


def test_too_small_panorama_is_refused() -> None:
    rng = np.random.default_rng(6)
    image = noise_image(rng, 8, 100)
    with pytest.raises(ValueError, match='panorama has 8 rows; allowed: at least 9'):
        matched(pair_of(image, image, 20))


def test_prepare_leaves_nothing_to_compile() -> None:
    semiglobal.prepare()
    kernels = [
        semiglobal_paths.match_tile,
        refinement.locate,
        refinement.smooth_columns,
        refinement.smooth_rows,
        confidence.agreement,
        confidence.agreement_in_colour,
    ]
    compiled = [len(kernel.signatures) for kernel in kernels]
    assert min(compiled) == 1
    left, right = wandering_pair()
    seen = np.ones(COLUMNS, bool)
    seen[5] = False
    for pair in (
        pair_of(left, right, CANDIDATES, left_seen=seen),
        pair_of(np.stack([left] * 3, axis=2), np.stack([right] * 3, axis=2), CANDIDATES),
    ):
        matched(pair)
    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_aggregation_finds_the_exact_optimum_on_one_row_of_one_path() -> None:
    """Without vertical neighbours and with one clear winner everywhere, the winner is exact."""
    rng = np.random.default_rng(7)
    image = noise_image(rng, ROWS, COLUMNS)
    pair = pair_of(np.roll(image, -17, axis=1), image, CANDIDATES)
    ready = colour_pair(*pair)
    winners = Winners.none(ROWS, COLUMNS)
    with ThreadPoolExecutor(1) as pool:
        aggregate(ready, 0.0, pool, winners, PAIR_TILING.sides(ready))
    assert np.all(winners.best + ready.first == 17)
    assert np.all(winners.eyes(ready.first, 0, COLUMNS) == 0)
    assert winners.margin.min() > 0
