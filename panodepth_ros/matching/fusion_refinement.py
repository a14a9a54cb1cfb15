"""
The sub-column step with further views: each is a measurement of its own.

In every view the vertex of a parabola through correlation coefficients says where the left
window is, as ``refinement.locate`` does for the pair; divided by how fast the view's column moves
with the disparity it is an estimate of the same fraction, and all are averaged with their inverse
variances.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import int32, int64

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.refinement import HALF_WINDOW, LEAST_CURVATURE, SIDE
from panodepth_ros.matching.simd import LANES, load, maximum, splat, square_root, store

Bytes = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Int32Array = npt.NDArray[np.int32]
Int64Array = npt.NDArray[np.int64]
Float32Array = npt.NDArray[np.float32]

#: Correlation below which a view does not count: the point may be hidden there.
LEAST_CORRELATION = 0.6
#: Steps per row at which a view is sampled.
ROW_STEPS = 16
#: Columns of a view that a window is compared with.
RING = SIDE + 2


@kernel
def _running_sums(rows: Bytes, totals: Int64Array, squares: Int64Array) -> None:
    """Sums of all columns before each, and of their squares, over a few rows of an image."""
    total, square = 0, 0
    for x in range(rows.shape[1]):
        totals[x], squares[x] = total, square
        for y in range(rows.shape[0]):
            value = int64(rows[y, x])
            total += value
            square += value * value
    totals[rows.shape[1]], squares[rows.shape[1]] = total, square


@kernel
def _coefficients(numerators: Array, variances: Array, rho: Array) -> None:
    """Correlation coefficients, whole vectors at once."""
    least = splat(1.0)
    for i in range(0, rho.size, LANES):
        root = square_root(maximum(load(variances, i), least))
        store(rho, i, load(numerators, i) / root)


@kernel
def _rows_of_window(
    y: int, scale: float, left_row: float, view_row: float, last: int, upper: Int64Array,
    part: Int32Array,
) -> None:  # fmt: skip
    """Rows of a view at which the rows of a window are: ``upper`` and 16ths of a row more."""
    for j in range(SIDE):
        there = view_row - (left_row - (y + j - HALF_WINDOW)) * scale
        fine = int64(np.floor(there * ROW_STEPS + 0.5))
        fine = min(max(fine, 0), last * ROW_STEPS)
        upper[j] = fine // ROW_STEPS
        part[j] = int32(fine - upper[j] * ROW_STEPS)


@kernel
def _read(
    grey: Bytes, upper: Int64Array, part: Int32Array, at: int, slot: int, values: Int32Array,
    sums: Int64Array,
) -> None:  # fmt: skip
    """Sample a column of a view, Σ r and Σ r² of it."""
    last = grey.shape[0] - 1
    total, square = int32(0), int32(0)
    for j in range(SIDE):
        above, below = int32(grey[upper[j], at]), int32(grey[min(upper[j] + 1, last), at])
        value = int32(ROW_STEPS) * above + part[j] * (below - above)
        values[slot, j] = value
        total += value
        square += value * value
    sums[slot, 0], sums[slot, 1] = total, square


@kernel
def _multiply(
    left: Bytes, y: int, column: int, first: int, values: Int32Array, products: Int64Array
) -> None:
    """Σ l·r of a column of the left window and three of a view, from a slot on."""
    second, third = (first + 1) % RING, (first + 2) % RING
    before, here, after = int32(0), int32(0), int32(0)
    for j in range(SIDE):
        value = int32(left[y + j, column])
        before += value * values[first, j]
        here += value * values[second, j]
        after += value * values[third, j]
    products[0], products[1], products[2] = before, here, after


@kernel
def _correlate(
    left: Bytes, grey: Bytes, offset: int, best: npt.NDArray[np.uint16], shift: Array,
    row_scale: Array, left_row: float, view_row: float, y: int, numerators: Array,
    variances: Array, spreads: Array,
) -> None:  # fmt: skip
    """Parts of the correlation of a row's windows at the columns −1 … 1 around the winner."""
    rows, columns = grey.shape
    values, sums = np.zeros((RING, SIDE), np.int32), np.zeros((RING, 2), np.int64)
    products = np.zeros((SIDE, 3), np.int64)
    crosses, totals, squares = np.zeros((3, 3), np.int64)
    upper, part = np.empty(SIDE, np.int64), np.empty(SIDE, np.int32)
    left_totals, left_squares = np.empty((2, left.shape[1] + 1), np.int64)
    _running_sums(left[y : y + SIDE], left_totals, left_squares)
    count = int64(SIDE * SIDE)
    previous, begin = -1, int64(0)
    for x in range(best.shape[1]):
        k = int64(best[y, x])
        if k != previous:
            previous = k
            begin = int64(np.floor(shift[k] + 0.5)) + offset - HALF_WINDOW - 1
            _rows_of_window(y, row_scale[k], left_row, view_row, rows - 1, upper, part)
            for i in range(RING):
                _read(
                    grey, upper, part, (x + begin + i) % columns, (x + i) % RING, values, sums
                )  # fmt: skip
            crosses[:] = 0
            for i in range(SIDE):
                column = products[(x + i) % SIDE]
                _multiply(left, y, x + i, (x + i) % RING, values, column)
                for c in range(3):
                    crosses[c] += column[c]
            for c in range(3):
                totals[c], squares[c] = 0, 0
                for i in range(SIDE):
                    totals[c] += sums[(x + i + c) % RING, 0]
                    squares[c] += sums[(x + i + c) % RING, 1]
        else:  # only the windows' last columns are new
            # Three windows side by side: each takes the place of the one before it.
            totals[0], squares[0] = totals[1], squares[1]
            totals[1], squares[1] = totals[2], squares[2]
            totals[2] -= sums[(x + 1) % RING, 0]
            squares[2] -= sums[(x + 1) % RING, 1]
            slot = (x + RING - 1) % RING
            _read(grey, upper, part, (x + begin + RING - 1) % columns, slot, values, sums)
            totals[2] += sums[slot, 0]
            squares[2] += sums[slot, 1]
            column = products[(x + SIDE - 1) % SIDE]
            for c in range(3):
                crosses[c] -= column[c]
            _multiply(left, y, x + SIDE - 1, (x + SIDE - 1) % RING, values, column)
            for c in range(3):
                crosses[c] += column[c]
        total = left_totals[x + SIDE] - left_totals[x]
        spread = float(count * (left_squares[x + SIDE] - left_squares[x]) - total * total)
        spreads[x] = spread
        for c in range(3):
            variances[c, x] = spread * float(count * squares[c] - totals[c] * totals[c])
            numerators[c, x] = float(count * crosses[c] - total * totals[c])


@kernel
def add_view(
    left: Bytes, grey: Bytes, offset: int, best: npt.NDArray[np.uint16], shift: Array,
    row_scale: Array, left_row: float, view_row: float, start: int, stop: int,
    sums: Float32Array, weights: Float32Array,
) -> None:  # fmt: skip
    """
    Add a view's estimates of the rows start … stop − 1.

    Parameters
    ----------
    left : ndarray of uint8, shape (H + 2n, W + 2n)
        Grey levels with a border of n, half a window.
    grey : ndarray of uint8, shape (H, W)
        The view's grey levels.
    offset : int
        The view's column at the left column 0.
    best : ndarray of uint16, shape (H, w)
        Winning candidate.
    shift, row_scale : ndarray of float64, shape (K,)
    left_row, view_row : float
        See ``fusion_views.View``.
    start, stop : int
        Rows to handle.
    sums, weights : ndarray of float32, shape (stop − start, W)
        Σ w·f and Σ w, to which the view's are added.
    """
    columns = best.shape[1]
    numerators, variances, rho = np.zeros((3, 3, -(-columns // LANES) * LANES))
    spreads = np.empty(columns)
    last = shift.size - 1
    for y in range(start, stop):
        _correlate(
            left, grey, offset, best, shift, row_scale, left_row, view_row, y, numerators,
            variances, spreads,
        )  # fmt: skip
        _coefficients(numerators, variances, rho)
        for x in range(columns):
            before, here, after = rho[0, x], rho[1, x], rho[2, x]
            curvature = 2 * here - before - after
            if here <= LEAST_CORRELATION or curvature <= LEAST_CURVATURE:
                continue
            if min(variances[0, x], variances[1, x], variances[2, x]) <= 0:
                continue
            k = int64(best[y, x])
            low, high = max(k - 1, 0), min(k + 1, last)
            slope = (shift[high] - shift[low]) / (high - low) if high > low else 1.0
            rest = shift[k] - np.floor(shift[k] + 0.5)
            fraction = (0.5 * (after - before) / curvature - rest) / slope
            if abs(fraction) <= 1:
                weight = curvature * spreads[x] / (SIDE * SIDE) ** 2 * slope * slope
                sums[y - start, x] += np.float32(weight * fraction)
                weights[y - start, x] += np.float32(weight)
