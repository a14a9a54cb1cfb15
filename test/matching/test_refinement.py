"""The sub-column step against its definition."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panodepth_ros.matching import refinement

N = refinement.HALF_WINDOW
ROWS, COLUMNS, CANDIDATES = 5, 70, 40

Array = npt.NDArray[np.float64]


def correlation(one: Array, other: Array) -> float | None:
    """Correlation coefficient of two windows, None without texture."""
    one, other = one - one.mean(), other - other.mean()
    variance = (one**2).sum() * (other**2).sum()
    return float((one * other).sum() / np.sqrt(variance)) if variance > 1e-6 else None


def test_fraction_is_the_vertex_through_three_correlation_coefficients() -> None:
    rng = np.random.default_rng(1)
    # Runs of one winner that are shorter and longer than a vector, and single pixels.
    runs = np.repeat(rng.integers(0, CANDIDATES, 5), [1, 40, 1, 18, 10])
    best = np.tile(runs.astype(np.uint16), (ROWS, 1))
    best[0, ::7] = 0
    right = rng.integers(0, 256, (ROWS + 2 * N, COLUMNS + 2 * N + CANDIDATES + 1)).astype(np.uint8)
    right[:, runs[1] + 20 : runs[1] + 28] = 50  # no texture in one of three windows, or in two
    left = np.empty((ROWS + 2 * N, COLUMNS + 2 * N), np.uint8)
    for y, x in np.ndindex(left.shape):
        winner = best[np.clip(y - N, 0, ROWS - 1), np.clip(x - N, 0, COLUMNS - 1)]
        left[y, x] = right[y, x + winner + 1] // 2 + right[y, x + winner + 2] // 4
    left[:, 44:52] = 99  # no texture
    fraction, weight = np.empty((2, ROWS, COLUMNS), np.float32)
    refinement.locate(left, right, best, 0, ROWS, fraction, weight)

    expected, expected_weight = np.zeros((2, ROWS, COLUMNS))
    side = 2 * N + 1
    for y, x in np.ndindex(ROWS, COLUMNS):
        here = left[y : y + side, x : x + side].astype(np.float64)
        starts = range(x + int(best[y, x]), x + int(best[y, x]) + 3)
        windows = [right[y : y + side, k : k + side].astype(np.float64) for k in starts]
        rho = [correlation(here, window) for window in windows]
        if rho[0] is None or rho[1] is None or rho[2] is None or rho[1] <= 0.3:
            continue
        curvature = 2 * rho[1] - rho[0] - rho[2]
        if curvature > refinement.LEAST_CURVATURE:
            expected[y, x] = np.clip((rho[2] - rho[0]) / 2 / curvature, -1, 1)
            expected_weight[y, x] = curvature * here.var()
    assert np.mean(expected_weight > 0) > 0.5
    np.testing.assert_allclose(fraction, expected, atol=1e-5)
    np.testing.assert_allclose(weight, expected_weight, rtol=1e-5)


def test_a_disparity_is_held_to_its_winner_and_to_those_beside_it_around_the_turn() -> None:
    steps = np.array([[10, 20, 20, 20, 20, 20, 20, 11, 9]], np.int16)
    for smoothed, held in ((0.0, 12.5), (99.0, 15.5)):  # 9 … 11, plus the first disparity
        disparity = np.full(steps.shape, smoothed, np.float32)
        refinement.hold(disparity, steps, 4, 0, 1)
        assert disparity[0, 0] == held
        assert disparity[0, 3] == 24 + np.sign(smoothed - 24) / 2
