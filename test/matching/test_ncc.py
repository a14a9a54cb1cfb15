"""The correlation kernel against its definition, and against pairs with known disparity."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import noise_image, pair_of, shifted_pair, texture

from panodepth_ros.matching import Correspondence, match

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


def test_unseen_columns_equal_the_definition_without_them() -> None:
    rng = np.random.default_rng(5)
    rows, columns, candidates = 10, 170, 14
    left, right = shifted_pair(
        texture(rng, rows, columns), np.full((rows, columns), 6.4), noise=3.0, rng=rng
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
    assert matched[:, [1, 3, 39, 41, 42, 45, 99, 101]].mean() > 0.7  # gaps spoil no neighbour
