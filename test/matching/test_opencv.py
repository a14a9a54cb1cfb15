"""What our side of OpenCV's matchers adds: confidence, and the way to our conventions."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import pair_of, shifted_pair, texture

from panodepth_ros.matching import match


def correlation_at(
    left: npt.NDArray[np.uint8],
    right: npt.NDArray[np.uint8],
    y: int,
    x: int,
    dx: int,
    seen: npt.NDArray[np.bool_],
) -> float:
    """ρ over the columns that both saw; NaN if these are fewer than five of nine."""
    rows, columns = left.shape
    window_rows = np.arange(max(y - 4, 0), min(y + 4, rows - 1) + 1)
    on_left = (x + np.arange(-4, 5)) % columns
    on_right = (on_left + dx) % columns
    both = seen[0, on_left] & seen[1, on_right]
    if both.sum() < 5:
        return np.nan
    a = left[np.ix_(window_rows, on_left[both])].astype(float).ravel()
    b = right[np.ix_(window_rows, on_right[both])].astype(float).ravel()
    return float(np.corrcoef(a, b)[0, 1])


@pytest.mark.parametrize('gaps', [False, True])
@pytest.mark.parametrize('method', ['sgbm', 'bm'])
def test_confidence_is_the_correlation_of_the_match(method: str, gaps: bool) -> None:
    rng = np.random.default_rng(1)
    columns = 200
    left, right = shifted_pair(
        texture(rng, 44, columns), np.full((44, columns), 11.3), noise=12.0, rng=rng
    )
    seen = np.ones((2, columns), bool)
    if gaps:
        seen[0, [50, 51, 52, 54, 55]] = seen[0, 90:120] = False
        seen[1, [20, 82, 84, 86, 88]] = False
    pair = pair_of(left, right, 20, left_seen=seen[0], right_seen=seen[1])
    result = match(*pair, method=method)
    matched = np.argwhere(np.isfinite(result.column_disparity))
    assert len(matched) > 1000
    for y, x in matched:
        dx = int(np.rint(result.column_disparity[y, x]))
        expected = max(correlation_at(left, right, y, x, dx, seen), 0)
        assert result.confidence[y, x] == pytest.approx(expected, abs=2e-6)


def test_a_bad_match_has_less_confidence_than_a_good_one() -> None:
    rng = np.random.default_rng(2)
    columns = 400
    truth = np.full((40, columns), 15.0)
    left, right = shifted_pair(texture(rng, 40, columns), truth, noise=4.0, rng=rng)
    right[:, 200:300] = rng.integers(90, 166, (40, 100))  # nothing of the left is here
    result = match(*pair_of(left, right, 30), method='sgbm')
    good = result.confidence[:, 20:150]
    bad = result.confidence[:, 200:270]
    assert np.isfinite(bad).sum() > 100
    assert np.nanmedian(good) > 0.9
    assert np.nanmedian(bad) < 0.6


@pytest.mark.parametrize('method', ['sgbm', 'bm'])
def test_beyond_the_search_range_is_unmatched(method: str) -> None:
    # OpenCV searches whole sixteens: 32 candidates for a range of 20. The truth is 25.
    rng = np.random.default_rng(3)
    left, right = shifted_pair(texture(rng, 40, 300), np.full((40, 300), 25.0))
    found = match(*pair_of(left, right, 20), method=method).column_disparity
    assert not (found > 20.5).any()
    within = match(*pair_of(left, right, 28), method=method).column_disparity
    assert (np.abs(within - 25) < 0.5).mean() > 0.6
