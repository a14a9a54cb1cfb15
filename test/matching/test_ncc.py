"""The correlation kernel against its definition, and against pairs with known disparity."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import noise_image, pair_of, shifted_pair, texture

from panodepth_ros.matching import Correspondence
from panodepth_ros.matching import match as match_by
from panodepth_ros.matching.correlation import tile_columns
from panodepth_ros.matching.ncc import match_ncc

match = partial(match_by, method='ncc')

HALF = 4


def definition(
    left: npt.NDArray[np.uint8],
    right: npt.NDArray[np.uint8],
    candidates: int,
    left_seen: npt.NDArray[np.bool_],
    right_seen: npt.NDArray[np.bool_],
) -> npt.NDArray[np.float64]:
    """ρ of every pixel and candidate 1 … n, shape (H, W, n), straight from the definition."""
    rows, columns = left.shape
    rho = np.full((rows, columns, candidates), np.nan)
    offsets = np.arange(-HALF, HALF + 1)
    for y in range(rows):
        window_rows = np.arange(max(y - HALF, 0), min(y + HALF, rows - 1) + 1)
        for x in range(columns):
            for dx in range(1, candidates + 1):
                if not (left_seen[x] and right_seen[(x + dx) % columns]):
                    continue
                on_left, on_right = (x + offsets) % columns, (x + dx + offsets) % columns
                both = left_seen[on_left] & right_seen[on_right]
                if both.sum() <= HALF:
                    continue
                a = left[np.ix_(window_rows, on_left[both])].astype(float)
                b = right[np.ix_(window_rows, on_right[both])].astype(float)
                a, b = a - a.mean(), b - b.mean()
                norm = np.sqrt((a**2).sum() * (b**2).sum())
                rho[y, x, dx - 1] = (a * b).sum() / norm if norm > 1e-6 else 0.0
    return rho


def best_and_back(rho: npt.NDArray[np.float64]) -> Correspondence:
    """Best candidate, back-correlation and parabola from ρ."""
    rows, columns, candidates = rho.shape
    score = np.where(np.isnan(rho), -2.0, rho)
    disparity = np.full((rows, columns), np.nan)
    confidence = np.full((rows, columns), np.nan)
    dx = np.arange(1, candidates + 1)
    for y in range(rows):
        for x in range(columns):
            number = int(score[y, x].argmax())
            if score[y, x, number] <= 1e-6:
                continue
            right = x + number + 1
            from_right = score[y, (right - dx) % columns, dx - 1]
            if abs(int(from_right.argmax()) - number) > 1:
                continue
            disparity[y, x] = number + 1
            confidence[y, x] = score[y, x, number]
            if 0 < number < candidates - 1:
                before, peak, after = rho[y, x, number - 1 : number + 2]
                if not np.isnan(before + after):
                    disparity[y, x] += (before - after) / (2 * (before - 2 * peak + after))
    return Correspondence(disparity, confidence)


def assert_equal(result: Correspondence, truth: Correspondence) -> None:
    np.testing.assert_array_equal(
        np.isnan(result.column_disparity), np.isnan(truth.column_disparity)
    )
    np.testing.assert_allclose(result.column_disparity, truth.column_disparity, atol=2e-4)
    np.testing.assert_allclose(result.confidence, truth.confidence, atol=2e-6)


@pytest.mark.parametrize(('rows', 'columns', 'candidates'), [(9, 30, 12), (14, 150, 33)])
@pytest.mark.parametrize('kind', ['noise', 'shifted'])
def test_equals_the_definition(kind: str, rows: int, columns: int, candidates: int) -> None:
    rng = np.random.default_rng(rows)
    if kind == 'noise':
        left, right = noise_image(rng, rows, columns), noise_image(rng, rows, columns)
    else:
        disparity = np.full((rows, columns), candidates / 2 + 0.3)
        left, right = shifted_pair(texture(rng, rows, columns), disparity, noise=3.0, rng=rng)
        left[:, 3:15] = 77  # no texture
    seen = np.ones(columns, bool)
    truth = best_and_back(definition(left, right, candidates, seen, seen))
    assert np.isfinite(truth.column_disparity).sum() > 0.02 * rows * columns
    assert_equal(match(*pair_of(left, right, candidates)), truth)


@pytest.mark.parametrize('disparity', [6.4, 14.0])
def test_unseen_columns_equal_the_definition_without_them(disparity: float) -> None:
    rng = np.random.default_rng(5)
    rows, columns, candidates = 10, 170, 14
    left, right = shifted_pair(
        texture(rng, rows, columns), np.full((rows, columns), disparity), noise=3.0, rng=rng
    )
    left_seen, right_seen = np.ones(columns, bool), np.ones(columns, bool)
    left_seen[[2, 40, 43, 44, 100]] = False
    left_seen[60:80] = False
    right_seen[[0, 50, 90, 120]] = False
    right_seen[130:] = False
    truth = best_and_back(definition(left, right, candidates, left_seen, right_seen))
    left_panorama, right_panorama = pair_of(
        left, right, candidates, left_seen=left_seen, right_seen=right_seen
    )
    result = match(left_panorama, right_panorama)
    assert_equal(result, truth)
    matched = np.isfinite(result.column_disparity)
    assert not matched[:, ~left_seen].any()
    assert matched[:, [1, 3, 41, 42, 45, 99, 101]].mean() > 0.7  # gaps spoil no neighbour


@pytest.mark.parametrize('threads', [2, 3])
def test_threads_do_not_change_a_byte(threads: int) -> None:
    rng = np.random.default_rng(11)
    left, right = shifted_pair(
        texture(rng, 140, 160), np.full((140, 160), 7.3), noise=5.0, rng=rng
    )
    pair = pair_of(left, right, 12)  # more rows than one band holds
    one, several = match(*pair), match(*pair, threads=threads)
    np.testing.assert_array_equal(one.column_disparity, several.column_disparity)
    np.testing.assert_array_equal(one.confidence, several.confidence)
    assert np.isfinite(one.column_disparity).mean() > 0.8


#: More columns than a tile has at 30 candidates.
SEVERAL_TILES = 1700


@pytest.mark.parametrize('shift', [1, 163, 1000, SEVERAL_TILES - 1])
def test_rolling_both_panoramas_rolls_the_result(shift: int) -> None:
    assert tile_columns(32) < SEVERAL_TILES
    rng = np.random.default_rng(12)
    columns = SEVERAL_TILES
    left, right = shifted_pair(
        texture(rng, 12, columns), np.full((12, columns), 28.6), noise=5.0, rng=rng
    )
    left_seen, right_seen = np.ones(columns, bool), np.ones(columns, bool)
    left_seen[100:103] = right_seen[[160, 900]] = right_seen[250:260] = False
    still = match(*pair_of(left, right, 30, left_seen=left_seen, right_seen=right_seen))
    rolled = match(
        *pair_of(
            np.roll(left, shift, axis=1),
            np.roll(right, shift, axis=1),
            30,
            left_seen=np.roll(left_seen, shift),
            right_seen=np.roll(right_seen, shift),
        )
    )
    for name in ('column_disparity', 'confidence'):
        expected = np.roll(getattr(still, name), shift, axis=1)
        np.testing.assert_array_equal(getattr(rolled, name), expected)
    assert np.isfinite(still.column_disparity).mean() > 0.7


def test_partial_sweep_is_matched_up_to_its_ends() -> None:
    rng = np.random.default_rng(13)
    columns, truth = SEVERAL_TILES, 9.3
    left, right = shifted_pair(texture(rng, 12, columns), np.full((12, columns), truth))
    seen = np.zeros(columns, bool)
    seen[1533:1650] = True  # begins just before a tile's end
    result = match(*pair_of(left, right, 30, left_seen=seen, right_seen=seen))
    expected = seen & np.roll(seen, -9) & np.roll(seen, -10)
    off = np.abs(result.column_disparity - truth)[:, expected]
    assert np.isfinite(off).mean() > 0.98
    assert (off[np.isfinite(off)] < 0.5).mean() > 0.98
    assert np.isnan(result.column_disparity[:, ~seen]).all()


@pytest.mark.parametrize('fraction', [0.0, 0.125, 0.25, 0.375, 0.5, 0.75])
def test_sub_column_disparity_has_no_bias(fraction: float) -> None:
    rng = np.random.default_rng(21)
    rows, columns = 24, 400
    truth = np.full((rows, columns), 9 + fraction)
    left, right = shifted_pair(texture(rng, rows, columns), truth, noise=2.0, rng=rng)
    error = match(*pair_of(left, right, 20)).column_disparity - truth
    kept = np.isfinite(error)
    assert kept.mean() > 0.99
    assert (np.abs(error[kept]) > 1).mean() < 0.002
    right_ones = np.abs(error[kept]) <= 1
    # Quantisation and noise of 2 levels against a deviation of 40: about 0.02 columns; the
    # parabola's own bias on this texture stays below that.
    assert np.sqrt(np.mean(error[kept][right_ones] ** 2)) < 0.06
    assert abs(np.mean(error[kept][right_ones])) < 0.02


def test_disparity_that_varies_along_the_row_and_over_the_rows() -> None:
    rng = np.random.default_rng(22)
    rows, columns = 24, 400
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    truth = 18 + 6 * np.sin(2 * np.pi * x / columns) + 0.02 * y
    left, right = shifted_pair(texture(rng, rows, columns), truth, noise=2.0, rng=rng)
    error = match(*pair_of(left, right, 40)).column_disparity - truth
    kept = np.isfinite(error)
    assert kept.mean() > 0.97
    assert (np.abs(error[kept]) > 1).mean() < 0.005
    seam = np.r_[0:12, columns - 40 : columns]  # windows and matches that wrap around
    assert np.isfinite(error[:, seam]).mean() > 0.97
    assert np.nanmax(np.abs(error[:, seam])) < 1


def test_no_texture_matches_nothing() -> None:
    flat = np.full((12, 80), 130, np.uint8)
    result = match(*pair_of(flat, flat, 10))
    assert np.isnan(result.column_disparity).all()
    assert np.isnan(result.confidence).all()


def test_gain_and_offset_change_nothing() -> None:
    rng = np.random.default_rng(31)
    left = rng.integers(0, 100, (12, 120)).astype(np.uint8)
    right = np.roll(left, 7, axis=1)
    plain = match(*pair_of(left, right, 15))
    brighter = match(*pair_of(left, (2 * right + 31).astype(np.uint8), 15))
    np.testing.assert_allclose(plain.column_disparity, brighter.column_disparity, atol=1e-5)
    np.testing.assert_allclose(plain.confidence, brighter.confidence, atol=1e-6)
    np.testing.assert_allclose(plain.confidence, 1, atol=1e-6)
    np.testing.assert_array_equal(np.rint(plain.column_disparity), 7)


def test_inverted_contrast_is_no_match() -> None:
    rng = np.random.default_rng(32)
    left = noise_image(rng, 12, 60)
    right = np.roll(255 - left, 5, axis=1)
    result = match(*pair_of(left, right, 8))
    assert not (np.abs(result.column_disparity - 5) < 0.5).any()


def test_occluded_stripe_is_not_confirmed() -> None:
    # A near stripe (dx 6) before a far wall (dx 16) hides wall columns from the right eye.
    rng = np.random.default_rng(33)
    rows, columns = 30, 300
    wall, stripe = texture(rng, rows, columns), texture(rng, rows, columns)
    far, _ = shifted_pair(wall, np.full((rows, columns), 16.0))
    near, _ = shifted_pair(stripe, np.full((rows, columns), 6.0))
    far_right, near_right = wall[:, ::32], stripe[:, ::32]
    left, right = far.copy(), np.rint(far_right).clip(0, 255).astype(np.uint8)
    left[:, 100:140] = near[:, 100:140]
    right[:, 106:146] = np.rint(near_right[:, 106:146]).clip(0, 255)
    result = match(*pair_of(left, right, 30))
    # Wall columns 90 … 99 lie at 106 … 115 on the right, behind the stripe.
    hidden = result.column_disparity[:, 90:96]
    assert np.isnan(hidden).mean() > 0.7
    assert np.nanmedian(result.column_disparity[:, 110:130]) == pytest.approx(6, abs=0.05)
    assert np.nanmedian(result.column_disparity[:, 200:250]) == pytest.approx(16, abs=0.05)


def test_without_back_correlation_the_best_candidate_stands() -> None:
    rng = np.random.default_rng(34)
    left, right = noise_image(rng, 12, 90), noise_image(rng, 12, 90)
    pair = pair_of(left, right, 20)
    everything = np.ones(90, bool)
    rho = definition(left, right, 20, everything, everything)
    free = match_ncc(*pair, (), 1, back_correlation=False)
    np.testing.assert_array_equal(np.rint(free.column_disparity), rho.argmax(axis=2) + 1)
    held = match_ncc(*pair, (), 1)
    kept = np.isfinite(held.column_disparity)
    assert 0.2 < kept.mean() < 0.8  # of unrelated images
    for ours, theirs in (
        (held.column_disparity, free.column_disparity),
        (held.confidence, free.confidence),
    ):
        np.testing.assert_array_equal(ours[kept], theirs[kept])
