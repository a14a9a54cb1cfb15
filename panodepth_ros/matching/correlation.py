"""
Normalised correlation of windows on two panoramas, in exact integers.

For a left pixel (y, x) and a candidate d the window sums over the rows y−4 … y+4 and columns
x−4 … x+4 are N, Σl, Σr, Σl², Σr², Σlr, and

    ρ = (N·Σlr − Σl·Σr) / √((N·Σl² − (Σl)²)·(N·Σr² − (Σr)²)).

Grey levels are centred to −128 … 127, which changes nothing in ρ and lets every sum fit into 32
bits. Rows outside the image do not count: windows are clipped at the top and at the bottom.
Columns that were not seen on either panorama do not count either; a window needs both centres
and more than half of its columns.

Loops run over candidates inside, columns next, rows outside. The column sums hold Σlr of single
window columns for all candidates: going down a row adds the products that come in below and
takes away those that leave above, going right adds the column sum that enters the window and
takes away the one that leaves. Score and candidate share one integer, so that one maximum gives
the best candidate of a left and, with the same numbers, of a right pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import float32, int32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.interface import WINDOW_HALF_WIDTH, GreyPair
from panodepth_ros.matching.simd import LANES, load, splat, store, widen

Int16Array = npt.NDArray[np.int16]
Int32Array = npt.NDArray[np.int32]
Float32Array = npt.NDArray[np.float32]

N = WINDOW_HALF_WIDTH
WIDTH = 2 * N + 1
#: Column sums of a tile: they stay in the second-level cache.
TILE_SUMS = 49152
#: Score of ρ = 1 before its low bits name the candidate.
SCORE_UNIT = 2.0**30
#: Rows whose window statistics are kept at a time.
STATISTICS_ROWS = 32
#: A window needs this many seen columns.
MINIMAL_COLUMNS = N + 1


class PaddedPair(NamedTuple):
    """
    Grey levels with borders, so that kernels need no case distinctions.

    Attributes
    ----------
    left : ndarray of int16, shape (H + 2n + 2, W + LANES)
        Centred grey levels, 0 outside the image and where unseen; wraps around. Row y of the
        image is row y + n + 1, column x is column x + n.
    right : ndarray of int16, shape (H + 2n + 2, W + M + LANES)
        The same; candidate number d compares column x of ``left`` with column x + d.
    left_seen, right_seen : ndarray of int32, shapes (W + LANES,) and (W + M + LANES,)
        1 where seen, else 0.
    codes : ndarray of int32, shape (M,)
        Goes into the low bits of a candidate's score and names it. Of equal scores the smallest
        disparity wins; candidates that only fill up a vector make the score negative.
    name_bits : int
        Low bits of a score that name its candidate, as a mask.
    first, candidates : int
        Smallest disparity and number of disparities; M is that number in whole vectors.
    """

    left: Int16Array
    right: Int16Array
    left_seen: Int32Array
    right_seen: Int32Array
    codes: Int32Array
    name_bits: int
    first: int
    candidates: int


class Windows(NamedTuple):
    """
    What windows know alone.

    Attributes
    ----------
    totals : ndarray of int32, shape (rows, columns)
        Σv.
    inverses : ndarray of float32, shape (rows, columns)
        1/√(N·Σv² − (Σv)²), 0 without texture.
    """

    totals: Int32Array
    inverses: Float32Array


def pad(pair: GreyPair) -> PaddedPair:
    """Return the pair with wrapped columns and empty rows around it."""
    columns = pair.left.shape[1]
    candidates = pair.last - pair.first + 1
    lanes = -(-candidates // LANES) * LANES
    left_columns = np.arange(-N, columns + LANES - N) % columns
    right_columns = pair.first + np.arange(-N, columns + lanes + LANES - N)
    right_columns %= columns
    return PaddedPair(
        left=_centred(pair.left, pair.left_seen, left_columns),
        right=_centred(pair.right, pair.right_seen, right_columns),
        left_seen=pair.left_seen[left_columns].astype(np.int32),
        right_seen=pair.right_seen[right_columns].astype(np.int32),
        codes=_codes(candidates, lanes),
        name_bits=(1 << (lanes - 1).bit_length()) - 1,
        first=pair.first,
        candidates=candidates,
    )


def _centred(
    grey: npt.NDArray[np.uint8], seen: npt.NDArray[np.bool_], columns: npt.NDArray[np.int64]
) -> Int16Array:
    """Centre the grey levels at the given columns, which go up by one and wrap around."""
    rows = grey.shape[0]
    centred = np.zeros((rows + WIDTH + 1, columns.size), np.int16)
    image = centred[N + 1 : N + 1 + rows]
    at = 0
    while at < columns.size:  # whole runs of columns: many times faster than one by one
        run = grey[:, columns[at] :][:, : columns.size - at]
        np.subtract(run, 128, out=image[:, at : at + run.shape[1]], dtype=np.int16)
        at += run.shape[1]
    image[:, ~seen[columns]] = 0
    return centred


def _codes(candidates: int, lanes: int) -> Int32Array:
    codes = np.arange(lanes - 1, -1, -1, dtype=np.int32)
    codes[candidates:] = -(2**31)
    return codes


@kernel
def tile_columns(lanes: int) -> int:
    """Columns of a tile; not so few that its borders weigh."""
    return max(TILE_SUMS // lanes, 16 * WIDTH)


@kernel
def inverse_deviation(count: int, total: int, squares: int) -> float:
    """1/√(N·Σv² − (Σv)²), 0 for a window without texture."""
    variance = count * squares - total * total
    inverse: float = float32(1) / np.sqrt(float32(variance)) if variance > 0 else float32(0)
    return inverse


@kernel
def clipped_rows(row: int, rows: int) -> int:
    """Rows of the window around a row that lie in the image."""
    return min(row + N, rows - 1) - max(row - N, 0) + 1


@kernel
def window_statistics(
    padded: Int16Array, start: int, stop: int, first: int, columns: int
) -> Windows:
    """
    Statistics of the windows on the rows start … stop − 1, columns first … first + columns − 1.

    Columns count whether seen or not: where a window touches an unseen column the values are
    meaningless.
    """
    rows, end = padded.shape[0] - WIDTH - 1, first + columns + 2 * N
    totals = np.empty((stop - start, columns), np.int32)
    inverses = np.empty((stop - start, columns), np.float32)
    column_totals = np.zeros(columns + 2 * N, np.int32)
    column_squares = np.zeros(columns + 2 * N, np.int32)
    squares = np.empty(columns, np.int32)
    nothing = padded[0, first:end]
    for row in range(start, start + WIDTH):
        _move_down(padded[row, first:end], nothing, column_totals, column_squares)
    for y in range(start, stop):
        below, above = padded[y + WIDTH, first:end], padded[y, first:end]
        _move_down(below, above, column_totals, column_squares)
        _sum_windows(column_totals, totals[y - start])
        _sum_windows(column_squares, squares)
        count = int32(WIDTH * clipped_rows(y, rows))
        _invert(count, totals[y - start], squares, inverses[y - start])
    return Windows(totals, inverses)


@kernel
def _move_down(
    below: Int16Array, above: Int16Array, totals: Int32Array, squares: Int32Array
) -> None:
    """Add a row to the column sums Σv and Σv², take another one away."""
    for x in range(below.size):
        new, old = int32(below[x]), int32(above[x])
        totals[x] += new - old
        squares[x] += new * new - old * old


@kernel
def _sum_windows(columns: Int32Array, windows: Int32Array) -> None:
    """Sums over 2n + 1 neighbours."""
    total = int32(0)
    for x in range(2 * N):
        total += columns[x]
    for x in range(windows.size):
        total += columns[x + 2 * N]
        windows[x] = total
        total -= columns[x]


@kernel
def _invert(count: int, totals: Int32Array, squares: Int32Array, inverses: Float32Array) -> None:
    """Write 1/√(N·Σv² − (Σv)²) of a row."""
    for x in range(totals.size):
        inverses[x] = inverse_deviation(count, totals[x], squares[x])


@kernel
def add_row(
    sums: Int32Array, left: Int16Array, right: Int16Array, below: int, above: int,
    tile: int, width: int, lanes: int,
) -> None:  # fmt: skip
    """
    Move the column sums of a tile down by a row.

    Parameters
    ----------
    sums : ndarray of int32, shape ((width + 2n + 1)·lanes,)
        Σlr of the window column tile + x − n at (x + 1)·lanes; zeros come first.
    left, right : ndarray of int16
        As in :class:`PaddedPair`.
    below, above : int
        Padded rows whose products are added and taken away; row 0 is empty.
    tile, width : int
        First column of the tile and its columns.
    lanes : int
        Candidates, padded.
    """
    right_below, right_above = right[below], right[above]
    for x in range(width + 2 * N):
        new, old = splat(left[below, tile + x]), splat(left[above, tile + x])
        for d in range(0, lanes, LANES):
            at = (x + 1) * lanes + d
            added = new * load(right_below, tile + x + d)
            taken = old * load(right_above, tile + x + d)
            store(sums, at, load(sums, at) + widen(added - taken))


@kernel
def vertex(before: float, peak: float, after: float) -> float:
    """
    Where between its neighbours a parabola through three scores peaks, −0.5 … 0.5.

    0 where the middle one is no proper maximum or a neighbour is NaN.
    """
    curvature = before - peak - peak + after
    if not (peak >= before and peak >= after and curvature < 0):
        return float32(0)  # type: ignore[no-any-return]  # numba has no types
    return (before - after) / (curvature + curvature)


@kernel
def named_candidate(named: int, pair: PaddedPair) -> int:
    """Candidate that a score names."""
    return pair.codes.size - 1 - (named & pair.name_bits)


@kernel
def masked_correlation(pair: PaddedPair, y: int, x: int, number: int) -> float:
    """
    ρ of one left pixel and one candidate, without the columns either panorama did not see.

    NaN if a centre was not seen or too few columns were; 0 for a window without texture.
    """
    columns = left_total = left_squares = right_total = right_squares = products = 0
    for i in range(WIDTH):
        if pair.left_seen[x + i] == 0 or pair.right_seen[x + number + i] == 0:
            continue
        columns += 1
        for j in range(1, WIDTH + 1):
            left = int32(pair.left[y + j, x + i])
            right = int32(pair.right[y + j, x + number + i])
            left_total += left
            left_squares += left * left
            right_total += right
            right_squares += right * right
            products += left * right
    seen = pair.left_seen[x + N] * pair.right_seen[x + number + N]
    if seen == 0 or columns < MINIMAL_COLUMNS:
        return np.nan
    count = columns * clipped_rows(y, pair.left.shape[0] - WIDTH - 1)
    covariance = float32(count * products - left_total * right_total)
    rho: float = covariance * inverse_deviation(count, left_total, left_squares)
    return rho * inverse_deviation(count, right_total, right_squares)


@kernel
def match_correlation(pair: PaddedPair, numbers: Int32Array) -> Float32Array:
    """
    ρ of matches that were found by other means.

    Parameters
    ----------
    pair : PaddedPair
    numbers : ndarray of int32, shape (H, W)
        Candidate of each left pixel, negative for none.

    Returns
    -------
    ndarray of float32, shape (H, W)
        NaN where there is no candidate or a column was not seen.
    """
    rows, columns = numbers.shape
    lanes = pair.codes.size
    result = np.full((rows, columns), np.nan, np.float32)
    left_complete = complete_windows(pair.left_seen, columns)
    right_complete = complete_windows(pair.right_seen, columns + lanes)
    lane_sums = np.empty(LANES, np.int32)
    for y in range(rows):
        if y % STATISTICS_ROWS == 0:
            stop = min(y + STATISTICS_ROWS, rows)
            left = window_statistics(pair.left, y, stop, 0, columns)
            right = window_statistics(pair.right, y, stop, 0, columns + lanes)
        row = y % STATISTICS_ROWS
        count = int32(WIDTH * clipped_rows(y, rows))
        for x in range(columns):
            if numbers[y, x] < 0:
                continue
            at = x + numbers[y, x]
            if not (left_complete[x] and right_complete[at]):
                result[y, x] = masked_correlation(pair, y, x, numbers[y, x])
                continue
            lane_sum = splat(int32(0))
            for j in range(y + 1, y + WIDTH + 1):
                products = load(pair.left[j], x) * load(pair.right[j], at)
                lane_sum = lane_sum + widen(products)
            store(lane_sums, 0, lane_sum)
            cross = int32(0)
            for i in range(WIDTH):
                cross += lane_sums[i]
            covariance = float32(count * cross - left.totals[row, x] * right.totals[row, at])
            result[y, x] = covariance * left.inverses[row, x] * right.inverses[row, at]
    return result


@kernel
def complete_windows(seen: Int32Array, columns: int) -> npt.NDArray[np.bool_]:
    """Whether all columns of a window were seen, for the windows of the first columns."""
    complete = np.empty(columns, np.bool_)
    for x in range(columns):
        complete[x] = np.all(seen[x : x + WIDTH])
    return complete
