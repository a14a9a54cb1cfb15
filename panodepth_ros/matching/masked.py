"""
Correlation of single pixels with all their candidates, unseen columns left out.

What :mod:`panodepth_ros.matching.correlation` defines for whole windows holds here for windows
that miss columns: only columns that both panoramas saw count, in all sums alike. Vectors of
candidates whose windows are whole take the statistics that the tile has anyway.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import float32, int32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
    MINIMAL_COLUMNS,
    SCORE_UNIT,
    WIDTH,
    Float32Array,
    Int32Array,
    N,
    PaddedPair,
    Windows,
    clipped_rows,
    complete_windows,
)
from panodepth_ros.matching.simd import (
    LANES,
    greater,
    largest,
    load,
    maximum,
    splat,
    square_root,
    store,
    to_float,
    to_integer,
)


class Reach(NamedTuple):
    """
    Where windows are whole.

    Attributes
    ----------
    left : ndarray of bool, shape (W,)
        Whether the window around a left column was seen.
    right_run : ndarray of int32, shape (W + M,)
        Number of whole windows on the right panorama from a column on.
    search : ndarray of bool, shape (W,)
        Whether all windows were seen that the search of a left column compares.
    """

    left: npt.NDArray[np.bool_]
    right_run: Int32Array
    search: npt.NDArray[np.bool_]


class TileRow(NamedTuple):
    """
    What one row of a tile knows; x counts from the tile's first column.

    Attributes
    ----------
    tile : int
        First column of the tile.
    window_rows : int
        Rows of the window that lie in the image.
    left, right : Windows
        Statistics of whole windows, shapes (width,) and (width + M,).
    left_totals, left_squares : ndarray of int32, shape (width + 2n,)
        Σl and Σl² of single window columns; empty where all windows are whole.
    right_totals, right_squares : ndarray of int32, shape (width + M + 2n,)
        The same of the right panorama.
    """

    tile: int
    window_rows: int
    left: Windows
    right: Windows
    left_totals: Int32Array
    left_squares: Int32Array
    right_totals: Int32Array
    right_squares: Int32Array


@kernel
def reach_of(pair: PaddedPair, columns: int) -> Reach:
    """Find where windows are whole, for a panorama of that many columns."""
    lanes = pair.codes.size
    left = complete_windows(pair.left_seen, columns)
    right = complete_windows(pair.right_seen, columns + lanes)
    right_run = np.empty(columns + lanes, np.int32)
    run = 0
    for x in range(columns + lanes - 1, -1, -1):
        run = run + 1 if right[x] else 0
        right_run[x] = run
    return Reach(left, right_run, left & (right_run[:columns] >= pair.candidates))


@kernel
def tile_row(
    pair: PaddedPair, y: int, row: int, tile: int, left: Windows, right: Windows, gaps: bool
) -> TileRow:
    """
    Gather what row y of a tile knows.

    Parameters
    ----------
    pair : PaddedPair
    y, row : int
        Row of the image, and its row in ``left`` and ``right``.
    tile : int
        First column of the tile.
    left, right : Windows
        Statistics of the tile, shapes (rows, width) and (rows, width + M).
    gaps : bool
        Whether a search in this tile meets an unseen column.
    """
    width = left.totals.shape[1] + 2 * N if gaps else 0
    right_width = right.totals.shape[1] + 2 * N if gaps else 0
    left_totals, left_squares = _column_statistics(pair.left, y, tile, width)
    right_totals, right_squares = _column_statistics(pair.right, y, tile, right_width)
    return TileRow(
        tile,
        clipped_rows(y, pair.left.shape[0] - WIDTH - 1),
        Windows(left.totals[row], left.inverses[row]),
        Windows(right.totals[row], right.inverses[row]),
        left_totals,
        left_squares,
        right_totals,
        right_squares,
    )


@kernel
def _column_statistics(
    padded: npt.NDArray[np.int16], y: int, start: int, width: int
) -> tuple[Int32Array, Int32Array]:
    """Σv and Σv² over the window's rows of single columns, shape (width,) each."""
    totals, squares = np.zeros(width, np.int32), np.zeros(width, np.int32)
    for row in range(y + 1, y + WIDTH + 1):
        values = padded[row, start : start + width]
        for x in range(width):
            value = int32(values[x])
            totals[x] += value
            squares[x] += value * value
    return totals, squares


@kernel
def correlate(
    pair: PaddedPair, reach: Reach, row: TileRow, x: int,
    cross: Int32Array, rho: Float32Array, names: Int32Array,
) -> int:  # fmt: skip
    """
    Correlate one seen pixel of the left panorama with all its candidates.

    Parameters
    ----------
    pair, reach, row
        Where.
    x : int
        Column of the tile.
    cross : ndarray of int32, shape (M,)
        Σlr of the pixel's windows.
    rho : ndarray of float32, shape (M,)
        Receives ρ; NaN for candidates without enough seen columns.
    names : ndarray of int32, shape (M,)
        Receives the named scores.

    Returns
    -------
    int
        The best named score, or 0.
    """
    column = row.tile + x
    score_bits = splat(int32(~pair.name_bits))
    total, inverse = splat(row.left.totals[x]), splat(row.left.inverses[x])
    count = splat(int32(WIDTH * row.window_rows))
    best = splat(int32(0))
    for d in range(0, cross.size, LANES):
        if reach.left[column] and reach.right_run[column + d] >= min(LANES, pair.candidates - d):
            covariance = count * load(cross, d) - total * load(row.right.totals, x + d)
            score = to_float(covariance) * load(row.right.inverses, x + d) * inverse
            store(rho, d, score)
        else:
            score = _masked_scores(pair, row, x, d, cross, rho)
        score = score * splat(float32(SCORE_UNIT))
        named = (to_integer(score) & score_bits) | load(pair.codes, d)
        store(names, d, named)
        best = maximum(best, named)
    best_name: int = largest(best)
    return best_name


@kernel
def _masked_scores(
    pair: PaddedPair, row: TileRow, x: int, d: int, cross: Int32Array, rho: Float32Array
) -> object:
    """Write ρ of one vector of candidates, return it with 0 instead of NaN."""
    column = row.tile + x
    zero = splat(int32(0))
    columns = left_total = left_square = right_total = right_square = zero
    for i in range(WIDTH):
        seen = splat(pair.left_seen[column + i])
        both = seen * load(pair.right_seen, column + i + d)
        columns = columns + both
        left_total = left_total + both * splat(row.left_totals[x + i])
        left_square = left_square + both * splat(row.left_squares[x + i])
        right_total = right_total + seen * load(row.right_totals, x + i + d)
        right_square = right_square + seen * load(row.right_squares, x + i + d)
    count = columns * splat(int32(row.window_rows))
    covariance = count * load(cross, d) - left_total * right_total
    # Without texture the covariance is 0, too, so any variance but 0 will do.
    one = splat(int32(1))
    left_variance = maximum(count * left_square - left_total * left_total, one)
    right_variance = maximum(count * right_square - right_total * right_total, one)
    unit = splat(float32(1))
    score = to_float(covariance) * (unit / square_root(to_float(right_variance)))
    score = score * (unit / square_root(to_float(left_variance)))
    enough = greater(columns, splat(int32(MINIMAL_COLUMNS - 1)))
    valid = to_float(enough * load(pair.right_seen, column + N + d))
    store(rho, d, score * (valid / valid))  # 0/0 is NaN
    return score * valid
