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
from numba import int16, int32, int64, uint8

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.simd import (
    LANES,
    load,
    maximum,
    splat,
    square_root,
    store,
    to_double,
    widen,
)

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]
Int16Array = npt.NDArray[np.int16]
Int32Array = npt.NDArray[np.int32]

#: Half width of the correlation window, rows and columns alike.
HALF_WINDOW = 3
SIDE = 2 * HALF_WINDOW + 1
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
def _take_row(image: Bytes, y: int, rows: Int16Array) -> None:
    """Put a row, centred to −128 … 127, in the place of the one that leaves the window."""
    row = rows[y % SIDE]
    for x in range(image.shape[1]):
        row[x] = int16(image[y, x]) - int16(128)


@kernel
def _window_statistics(
    rows: Int16Array, of_columns: Int32Array, totals: Int32Array, spreads: Int32Array
) -> None:
    """
    Σv and N·Σv² − (Σv)² of the windows that begin at each column.

    Parameters
    ----------
    rows : ndarray of int16, shape (2n + 1, w)
        Rows of the windows, in any order.
    of_columns : ndarray of int32, shape (2w,)
        Working memory.
    totals, spreads : ndarray of int32, shape (w − LANES,)
        Receive the sums.
    """
    count, wide = splat(int32(SIDE * SIDE)), rows.shape[1]
    for x in range(0, wide, LANES):
        total = square = splat(int32(0))
        for j in range(SIDE):
            value = load(rows, j * wide + x)
            total = total + widen(value)
            square = square + widen(value * value)
        store(of_columns, x, total)
        store(of_columns, wide + x, square)
    for x in range(0, totals.size, LANES):
        total = square = splat(int32(0))
        for i in range(SIDE):
            total = total + load(of_columns, x + i)
            square = square + load(of_columns, wide + x + i)
        store(totals, x, total)
        store(spreads, x, count * square - total * total)


@kernel
def _correlate_run(
    left_rows: Int16Array, right_rows: Int16Array, x: int, at: int, length: int,
    left_totals: Int32Array, left_spreads: Int32Array, right_totals: Int32Array,
    right_spreads: Int32Array, products: Int32Array, rho: Float64Array,
) -> None:  # fmt: skip
    """
    Correlate the windows from column x on with those from column ``at`` on, one before, one after.

    ``rho``, shape (3, …), receives the coefficients of ``length`` windows from x on, and something
    of up to LANES more; 0 for windows without texture. ``products`` is working memory.
    """
    count, least, wide = splat(int32(SIDE * SIDE)), splat(1.0), rho.shape[1]
    for i in range(0, length + SIDE - 1, LANES):
        before = here = after = splat(int32(0))
        for j in range(SIDE):
            value = load(left_rows, j * left_rows.shape[1] + x + i)
            there = j * right_rows.shape[1] + at + i
            before = before + widen(value * load(right_rows, there))
            here = here + widen(value * load(right_rows, there + 1))
            after = after + widen(value * load(right_rows, there + 2))
        store(products, i, before)
        store(products, wide + i, here)
        store(products, 2 * wide + i, after)
    for i in range(0, length, LANES):
        total, spread = load(left_totals, x + i), to_double(load(left_spreads, x + i))
        for k in range(3):
            cross = splat(int32(0))
            for column in range(SIDE):
                cross = cross + load(products, k * wide + i + column)
            there = at + i + k
            covariance = to_double(count * cross - total * load(right_totals, there))
            variance = spread * to_double(load(right_spreads, there))
            store(rho, k * wide + x + i, covariance / square_root(maximum(variance, least)))


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
    columns = best.shape[1]
    wide, right_wide = _padded(left.shape[1]), _padded(right.shape[1])
    left_rows = np.zeros((SIDE, wide + LANES), np.int16)
    right_rows = np.zeros((SIDE, right_wide + LANES), np.int16)
    of_columns = np.empty(2 * (right_wide + LANES), np.int32)
    left_totals, left_spreads = np.empty((2, wide), np.int32)
    right_totals, right_spreads = np.empty((2, right_wide), np.int32)
    products = np.empty((3, wide + LANES), np.int32)
    rho = np.empty((3, wide + LANES))
    for y in range(start, start + SIDE - 1):
        _take_row(left, y, left_rows)
        _take_row(right, y, right_rows)
    for y in range(start, stop):
        _take_row(left, y + SIDE - 1, left_rows)
        _take_row(right, y + SIDE - 1, right_rows)
        _window_statistics(left_rows, of_columns, left_totals, left_spreads)
        _window_statistics(right_rows, of_columns, right_totals, right_spreads)
        winners = best[y]
        x = 0
        while x < columns:
            end = x + 1
            while end < columns and winners[end] == winners[x]:
                end += 1
            at = x + int64(winners[x])
            _correlate_run(
                left_rows, right_rows, x, at, end - x, left_totals, left_spreads, right_totals,
                right_spreads, products, rho,
            )  # fmt: skip
            for k in range(x, end):
                there = at + k - x
                fraction[y - start, k] = 0.0
                weight[y - start, k] = 0.0
                textured = left_spreads[k] > 0
                for c in range(3):
                    textured = textured and right_spreads[there + c] > 0
                before_it, at_it, after_it = rho[0, k], rho[1, k], rho[2, k]
                curvature = 2 * at_it - before_it - after_it
                if textured and at_it > LEAST_CORRELATION and curvature > LEAST_CURVATURE:
                    vertex = 0.5 * (after_it - before_it) / curvature
                    fraction[y - start, k] = min(max(vertex, -1.0), 1.0)
                    spread = float(left_spreads[k])
                    weight[y - start, k] = curvature * spread / (SIDE * SIDE * SIDE * SIDE)
            x = end


@kernel
def _padded(columns: int) -> int:
    """Length of whole vectors, and one more, in which that many columns fit."""
    return (columns // LANES + 2) * LANES


@kernel
def smooth_columns(
    disparity: Float32Array, weight: Float32Array, steps: npt.NDArray[np.int16], image: Bytes
) -> None:
    """
    Smooth along the columns.

    Parameters
    ----------
    disparity, weight : ndarray of float32, shape (H, W)
        Estimates d, which the minimiser of Σ w (x − d)² + Σ c (x − x')² replaces, and how much
        each counts, w > 0.
    steps : ndarray of int16, shape (H, W)
        Whole candidates: neighbours that differ by more than one do not pull.
    image : ndarray of uint8, shape (3, H, W)
        Colours: edges hold the pull off.
    """
    rows, columns = disparity.shape
    ratio = np.empty((rows, columns), np.float32)
    pull = np.zeros(columns, np.float32)
    for y in range(rows):
        for x in range(columns):
            above = pull[x]
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
                diagonal -= above * ratio[y - 1, x]
                carried = above * disparity[y - 1, x]
            ratio[y, x] = below / diagonal
            disparity[y, x] = (right_side + carried) / diagonal
            pull[x] = below
    for y in range(rows - 2, -1, -1):
        for x in range(columns):
            disparity[y, x] += ratio[y, x] * disparity[y + 1, x]


@kernel
def smooth_rows(
    disparity: Float32Array, weight: Float32Array, steps: npt.NDArray[np.int16], image: Bytes,
    start: int, stop: int, seam: int, overlap: int,
) -> None:  # fmt: skip
    """
    Smooth along the rows start … stop − 1, which wrap around.

    Parameters as in :func:`smooth_columns`; a row is solved from the column ``seam`` on, together
    with ``overlap`` columns beyond either end.
    """
    columns = disparity.shape[1]
    length = columns + 2 * overlap
    numbers = (np.arange(length + 1) + seam - overlap) % columns
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
        for k in range(overlap, overlap + columns):
            disparity[y, numbers[k]] = value[k]


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
    around = np.arange(-HOLD_REACH, columns + HOLD_REACH) % columns
    below, above = np.empty(columns, np.uint8), np.empty(columns, np.uint8)
    for y in range(start, stop):
        here, wide = steps[y], steps[y][around]
        below[:] = uint8(0)
        above[:] = uint8(0)
        for away in range(2 * HOLD_REACH + 1):
            beside = wide[away : away + columns]
            for x in range(columns):
                below[x] |= uint8(beside[x] == here[x] - 1)
                above[x] |= uint8(beside[x] == here[x] + 1)
        for x in range(columns):
            lower = np.float32(first + here[x] - below[x]) - np.float32(0.5)
            upper = np.float32(first + here[x] + above[x]) + np.float32(0.5)
            disparity[y, x] = min(max(disparity[y, x], lower), upper)
