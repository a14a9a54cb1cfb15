"""
From whole candidates to fractions of a column, in two steps.

First the vertex of a parabola through the correlation coefficients of a small window at the
winner and its two neighbours. Coefficients lean towards whole columns much less than aggregated
costs do. Then an edge-aware smoothing that lets every estimate weigh as much as its window
determines it: depth flows from texture into plain surfaces, not across edges of the image nor
across steps of the disparity. Two one-dimensional least-squares problems, along the columns and
then along the rows, each a tridiagonal system solved in one sweep there and back (Min et al.,
"Fast global image smoothing based on weighted least squares", 2014). After each, a disparity is
held to half a column around the winner, for a table top seen at a grazing angle gets a column
nearer with every row: without steps that stop the pull, it would take the depth of what stands
on it.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import int32, int64

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.simd import LANES, load, maximum, splat, square_root, store

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Int64Array = npt.NDArray[np.int64]

#: Half width of the correlation window, rows and columns alike.
HALF_WINDOW = 3
#: How strongly neighbours pull, along columns and along rows, against the weight of an estimate.
VERTICAL_PULL, HORIZONTAL_PULL = 60.0, 10.0
#: Grey-level difference over which the pull falls to 1/e.
EDGE_SCALE = 7.0
#: Pull by the grey-level difference, as a share.
_PULL = np.exp(-np.arange(256) / EDGE_SCALE).astype(np.float32)
#: Weight of an estimate whose window says nothing.
LEAST_WEIGHT = 0.3
#: Correlation below which the parabola is not trusted, and least curvature of the parabola.
LEAST_CORRELATION, LEAST_CURVATURE = 0.3, 1e-4


@kernel
def _running_sums(rows: Bytes, totals: Int64Array, squares: Int64Array) -> None:
    """Sums of all columns before each, and of their squares, over a few rows of an image."""
    columns = rows.shape[1]
    of_column, square_of_column = np.zeros((2, columns), np.int32)
    for y in range(rows.shape[0]):
        for x in range(columns):
            value = int32(rows[y, x])
            of_column[x] += value
            square_of_column[x] += value * value
    total, square = 0, 0
    for x in range(columns):
        totals[x], squares[x] = total, square
        total += int64(of_column[x])
        square += int64(square_of_column[x])
    totals[columns], squares[columns] = total, square


@kernel
def _correlations(numerators: Float64Array, variances: Float64Array, rho: Float64Array) -> None:
    """Correlation coefficients, whole vectors at once."""
    least = splat(1.0)
    for i in range(0, rho.size, LANES):
        root = square_root(maximum(load(variances, i), least))
        store(rho, i, load(numerators, i) / root)


@kernel
def locate(
    left: Bytes, right: Bytes, best: npt.NDArray[np.uint16], start: int, stop: int,
    fraction: Float32Array, weight: Float32Array,
) -> None:  # fmt: skip
    """
    Sub-column part of the winners of the rows start … stop − 1.

    Parameters
    ----------
    left, right : ndarray of uint8, shapes (H + 2n, W + 2n) and (H + 2n, W + 2n + candidates + 1)
        Grey levels with a border of n, half a window, ``right`` with one more column before it;
        candidate k of a column is k columns on in ``right``.
    best : ndarray of uint16, shape (H, W)
        Winning candidate.
    start, stop : int
        Rows to handle.
    fraction : ndarray of float32, shape (stop − start, W)
        Receives −1 … 1 to add to the winner; 0 where the parabola is not to be trusted.
    weight : ndarray of float32, shape (stop − start, W)
        Receives the curvature of the squared difference, the inverse variance of the estimate
        but for the noise; 0 where the parabola is not to be trusted.
    """
    side = 2 * HALF_WINDOW + 1
    count = side * side
    left_sums, left_squares = np.empty((2, left.shape[1] + 1), np.int64)
    right_sums, right_squares = np.empty((2, right.shape[1] + 1), np.int64)
    # Σ l·r of each column of the window for the candidates before, at and after the winner: as
    # long as the winner stays the same from pixel to pixel, only one column of it is new.
    products = np.zeros((side, 3), np.int64)
    crosses = np.zeros(3, np.int64)
    columns = best.shape[1]
    padded = -(-columns // LANES) * LANES
    # Of the candidates before, at and after each column's winner.
    numerators, variances, rho = np.zeros((3, 3, padded))
    spreads = np.empty(columns)
    for y in range(start, stop):
        _running_sums(left[y : y + side], left_sums, left_squares)
        _running_sums(right[y : y + side], right_sums, right_squares)
        previous = -1
        for x in range(columns):
            candidate = int64(best[y, x])
            at = x + candidate
            if candidate != previous:
                previous = candidate
                products[:] = 0
                crosses[:] = 0
                first = 0
            else:
                first = side - 1
            for i in range(first, side):
                before, here, after = int32(0), int32(0), int32(0)
                for j in range(side):
                    value = int32(left[y + j, x + i])
                    before += value * int32(right[y + j, at + i])
                    here += value * int32(right[y + j, at + i + 1])
                    after += value * int32(right[y + j, at + i + 2])
                column = products[(x + i) % side]
                crosses[0] += before - column[0]
                crosses[1] += here - column[1]
                crosses[2] += after - column[2]
                column[0], column[1], column[2] = before, here, after
            total = left_sums[x + side] - left_sums[x]
            spread = float(count * (left_squares[x + side] - left_squares[x]) - total * total)
            spreads[x] = spread
            for k in range(3):
                there = right_sums[at + k + side] - right_sums[at + k]
                square = right_squares[at + k + side] - right_squares[at + k]
                variances[k, x] = spread * float(count * square - there * there)
                numerators[k, x] = float(count * crosses[k] - total * there)
        _correlations(numerators, variances, rho)
        for x in range(columns):
            fraction[y - start, x] = 0.0
            weight[y - start, x] = 0.0
            textured = variances[0, x] > 0 and variances[1, x] > 0 and variances[2, x] > 0
            before_it, at_it, after_it = rho[0, x], rho[1, x], rho[2, x]
            curvature = 2 * at_it - before_it - after_it
            if textured and at_it > LEAST_CORRELATION and curvature > LEAST_CURVATURE:
                vertex = 0.5 * (after_it - before_it) / curvature
                fraction[y - start, x] = min(max(vertex, -1.0), 1.0)
                weight[y - start, x] = curvature * spreads[x] / (count * count)


@kernel
def smooth_columns(
    disparity: Float32Array, weight: Float32Array, steps: npt.NDArray[np.int16], image: Bytes,
    start: int, stop: int,
) -> None:  # fmt: skip
    """
    Smooth along the columns start … stop − 1.

    Parameters
    ----------
    disparity, weight : ndarray of float32, shape (H, W)
        Estimates d, which the minimiser of Σ w (x − d)² + Σ c (x − x')² replaces, and how much
        each counts, w > 0.
    steps : ndarray of int16, shape (H, W)
        Whole candidates: neighbours that differ by more than one do not pull.
    image : ndarray of uint8, shape (3, H, W)
        Colours: edges hold the pull off.
    start, stop : int
        Columns to handle.
    """
    rows = disparity.shape[0]
    width = stop - start
    ratio = np.empty((rows, width), np.float32)
    pull = np.zeros(width, np.float32)
    for y in range(rows):
        for k in range(width):
            x = start + k
            above = pull[k]
            below = np.float32(0)
            if y + 1 < rows and abs(int32(steps[y + 1, x]) - int32(steps[y, x])) <= 1:
                edge = int32(0)
                for c in range(3):
                    edge = max(edge, abs(int32(image[c, y + 1, x]) - int32(image[c, y, x])))
                below = np.float32(VERTICAL_PULL) * _PULL[edge]
            carried = np.float32(0)
            right_side = weight[y, x] * disparity[y, x]
            diagonal = weight[y, x] + above + below
            if y > 0:
                diagonal -= above * ratio[y - 1, k]
                carried = above * disparity[y - 1, x]
            ratio[y, k] = below / diagonal
            disparity[y, x] = (right_side + carried) / diagonal
            pull[k] = below
    for y in range(rows - 2, -1, -1):
        for k in range(width):
            disparity[y, start + k] += ratio[y, k] * disparity[y + 1, start + k]


@kernel
def smooth_rows(
    disparity: Float32Array, weight: Float32Array, steps: npt.NDArray[np.int16], image: Bytes,
    start: int, stop: int, overlap: int,
) -> None:  # fmt: skip
    """
    Smooth along the rows start … stop − 1, which wrap around.

    Parameters as in :func:`smooth_columns`; a row is solved together with ``overlap`` columns
    beyond either end.
    """
    columns = disparity.shape[1]
    length = columns + 2 * overlap
    numbers = (np.arange(length + 1) - overlap) % columns
    ratio = np.empty(length, np.float32)
    value = np.empty(length, np.float32)
    for y in range(start, stop):
        before = np.float32(0)
        for k in range(length):
            x = numbers[k]
            after = np.float32(0)
            following = numbers[k + 1]
            if k + 1 < length and abs(int32(steps[y, following]) - int32(steps[y, x])) <= 1:
                edge = int32(0)
                for c in range(3):
                    edge = max(edge, abs(int32(image[c, y, following]) - int32(image[c, y, x])))
                after = np.float32(HORIZONTAL_PULL) * _PULL[edge]
            diagonal = weight[y, x] + before + after
            carried = np.float32(0)
            if k > 0:
                diagonal -= before * ratio[k - 1]
                carried = before * value[k - 1]
            ratio[k] = after / diagonal
            value[k] = (weight[y, x] * disparity[y, x] + carried) / diagonal
            before = after
        for k in range(length - 2, -1, -1):
            value[k] += ratio[k] * value[k + 1]
        disparity[y] = value[overlap : overlap + columns]


#: Winners in the row within as many columns say where a disparity may lie.
HOLD_REACH = 2


@kernel
def hold(
    disparity: Float32Array, steps: npt.NDArray[np.int16], first: int, start: int, stop: int
) -> None:
    """
    Hold the disparities of the rows start … stop − 1 to their winners.

    Parameters
    ----------
    disparity : ndarray of float32, shape (H, W)
        Smoothed; what is more than half a column away from the winner, and from those winners
        within ``HOLD_REACH`` columns of the row that differ from it by one, is moved there.
    steps : ndarray of int16, shape (H, W)
        Whole candidates.
    first : int
        Disparity of candidate 0.
    start, stop : int
        Rows to handle.
    """
    columns = steps.shape[1]
    for y in range(start, stop):
        for x in range(columns):
            here = int32(steps[y, x])
            lowest, highest = here, here
            for away in range(-HOLD_REACH, HOLD_REACH + 1):
                beside = int32(steps[y, (x + away) % columns])
                if beside == here - 1:
                    lowest = beside
                elif beside == here + 1:
                    highest = beside
            lower = np.float32(first + lowest) - np.float32(0.5)
            upper = np.float32(first + highest) + np.float32(0.5)
            disparity[y, x] = min(max(disparity[y, x], lower), upper)
