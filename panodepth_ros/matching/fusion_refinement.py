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
from numba import int64

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.refinement import HALF_WINDOW, LEAST_CURVATURE

Bytes = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]
Int64Array = npt.NDArray[np.int64]
Float32Array = npt.NDArray[np.float32]

#: Correlation below which a view does not count: the point may be hidden there.
LEAST_CORRELATION = 0.6
#: Steps per row at which a view is sampled.
ROW_STEPS = 16


@kernel
def _rows_of_window(
    y: int, scale: float, left_row: float, view_row: float, last: int, upper: Int64Array,
    part: Int64Array,
) -> None:  # fmt: skip
    """Rows of a view at which the rows of a window are: ``upper`` and 16ths of a row more."""
    for j in range(upper.size):
        there = view_row - (left_row - (y + j - HALF_WINDOW)) * scale
        fine = int64(np.floor(there * ROW_STEPS + 0.5))
        fine = min(max(fine, 0), last * ROW_STEPS)
        upper[j] = fine // ROW_STEPS
        part[j] = fine - upper[j] * ROW_STEPS


@kernel
def _read(
    grey: Bytes, upper: Int64Array, part: Int64Array, x: int, begin: int, fresh: int,
    values: Int64Array, sums: Int64Array,
) -> None:  # fmt: skip
    """Sample columns of a view from number ``fresh`` on; number i is at x + begin + i."""
    rows, columns = grey.shape
    ring = values.shape[0]
    for i in range(fresh, ring):
        at = (x + begin + i) % columns
        slot = (x + i) % ring
        total, square = int64(0), int64(0)
        for j in range(upper.size):
            below = min(upper[j] + 1, rows - 1)
            value = (ROW_STEPS - part[j]) * int64(grey[upper[j], at])
            value += part[j] * int64(grey[below, at])
            values[slot, j] = value
            total += value
            square += value * value
        sums[slot, 0], sums[slot, 1] = total, square


@kernel
def _multiply(
    left: Bytes, y: int, x: int, fresh: int, oldest: int, values: Int64Array,
    products: Int64Array, sums: Int64Array,
) -> None:  # fmt: skip
    """
    Σ l·r for three positions of the window's columns from ``oldest`` on.

    Also Σ l and Σ l² of those from ``fresh`` on.
    """
    side, ring = products.shape[0], values.shape[0]
    for i in range(fresh, side):
        total, square = int64(0), int64(0)
        for j in range(side):
            value = int64(left[y + j, x + i])
            total += value
            square += value * value
        slot = (x + i) % side
        sums[slot, 0], sums[slot, 1] = total, square
    for i in range(oldest, side):
        before, here, after = int64(0), int64(0), int64(0)
        first, second, third = (x + i) % ring, (x + i + 1) % ring, (x + i + 2) % ring
        for j in range(side):
            value = int64(left[y + j, x + i])
            before += value * values[first, j]
            here += value * values[second, j]
            after += value * values[third, j]
        column = products[(x + i) % side]
        column[0], column[1], column[2] = before, here, after


@kernel
def _vertex(
    x: int, left_sums: Int64Array, view_sums: Int64Array, products: Int64Array
) -> tuple[float, float]:
    """Where between the columns −1 … 1 the window fits best, and its weight or 0."""
    side, ring = products.shape[0], view_sums.shape[0]
    count = side * side
    total, square = left_sums[:, 0].sum(), left_sums[:, 1].sum()
    spread = float(count * square - total * total)
    rho = np.empty(3)
    for c in range(3):
        there, squares, cross = int64(0), int64(0), int64(0)
        for i in range(side):
            slot = (x + i + c) % ring
            there += view_sums[slot, 0]
            squares += view_sums[slot, 1]
            cross += products[(x + i) % side, c]
        variance = spread * float(count * squares - there * there)
        if variance <= 0:
            return 0.0, 0.0
        rho[c] = float(count * cross - total * there) / np.sqrt(variance)
    curvature = 2 * rho[1] - rho[0] - rho[2]
    if rho[1] <= LEAST_CORRELATION or curvature <= LEAST_CURVATURE:
        return 0.0, 0.0
    return 0.5 * (rho[2] - rho[0]) / curvature, curvature * spread / (count * count)


@kernel
def add_view(
    left: Bytes, grey: Bytes, seam: int, best: npt.NDArray[np.uint16], shift: Array,
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
    seam : int
        The view's column at the left column 0.
    best : ndarray of uint16, shape (H, W)
        Winning candidate.
    shift, row_scale : ndarray of float64, shape (K,)
    left_row, view_row : float
        See ``fusion_views.View``.
    start, stop : int
        Rows to handle.
    sums, weights : ndarray of float32, shape (stop − start, W)
        Σ w·f and Σ w, to which the view's are added.
    """
    rows, columns = grey.shape
    side = 2 * HALF_WINDOW + 1
    ring = side + 2
    values, view_sums = np.zeros((ring, side), np.int64), np.zeros((ring, 2), np.int64)
    products, left_sums = np.zeros((side, 3), np.int64), np.zeros((side, 2), np.int64)
    upper, part = np.empty(side, np.int64), np.empty(side, np.int64)
    last = shift.size - 1
    for y in range(start, stop):
        previous = -1
        base = int64(0)
        rest, slope = 0.0, 1.0
        for x in range(columns):
            # As long as the winner stays the same only the window's last column is new.
            k = int64(best[y, x])
            skip = 1 if k == previous else 0
            if k != previous:
                previous = k
                base = int64(np.floor(shift[k] + 0.5))
                rest = shift[k] - base
                low, high = max(k - 1, 0), min(k + 1, last)
                slope = (shift[high] - shift[low]) / (high - low) if high > low else 1.0
                _rows_of_window(y, row_scale[k], left_row, view_row, rows - 1, upper, part)
            begin = base + seam - HALF_WINDOW - 1
            _read(grey, upper, part, x, begin, skip * (ring - 1), values, view_sums)
            fresh = 0 if x == 0 else side - 1
            _multiply(left, y, x, fresh, skip * (side - 1), values, products, left_sums)
            vertex, weight = _vertex(x, left_sums, view_sums, products)
            fraction = (vertex - rest) / slope
            if weight > 0 and abs(fraction) <= 1:
                weight *= slope * slope
                sums[y - start, x] += np.float32(weight * fraction)
                weights[y - start, x] += np.float32(weight)
