"""
The paper's dense matching: normalised correlation with back-correlation (sec. 7, Fig. 6 b, c).

Every pixel of the left panorama takes the candidate of its row that correlates best. The match
stands if the best of the right pixel leads back to within one column. The confidence is the
correlation coefficient. A parabola through the best and its neighbours gives the sub-column
part. A window without texture matches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import float32, int32

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
    MINIMAL_COLUMNS,
    SCORE_UNIT,
    TILE_COLUMNS,
    WIDTH,
    Float32Array,
    Int16Array,
    Int32Array,
    N,
    PaddedPair,
    Windows,
    add_row,
    clipped_rows,
    inverse_deviation,
    named_candidate,
    pad,
    vertex,
    window_statistics,
)
from panodepth_ros.matching.interface import Correspondence, GreyPair, grey_pair
from panodepth_ros.matching.simd import (
    LANES,
    largest,
    load,
    maximum,
    splat,
    store,
    to_float,
    to_integer,
    widen,
)

#: A match stands if the right pixel's best leads back to within this many columns.
BACK_TOLERANCE = 1
#: Rows that one call of the kernel handles, so that its memory does not grow with the image.
BAND_ROWS = 128


class Bests(NamedTuple):
    """
    What a band of rows finds.

    Attributes
    ----------
    numbers : ndarray of int32, shape (rows, W)
        Best candidate of each left pixel, −1 for none.
    right : ndarray of int32, shape (rows, W + M)
        Best named score of each right pixel so far.
    disparity, confidence : ndarray of float32, shape (rows, W)
        As in :class:`Correspondence`.
    """

    numbers: Int32Array
    right: Int32Array
    disparity: Float32Array
    confidence: Float32Array


def match_ncc(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match by normalised correlation and back-correlation; ``further`` is not used.

    Parameters and returns as in :func:`panodepth_ros.matching.match`.
    """
    return correlate(grey_pair(left, right), threads)


def prepare() -> None:
    """Compile the kernels."""
    grey = np.zeros((WIDTH, 2 * WIDTH), np.uint8)
    seen = np.ones(2 * WIDTH, np.bool_)
    correlate(GreyPair(grey, grey, seen, seen, first=1, last=WIDTH), 1)


def correlate(pair: GreyPair, threads: int) -> Correspondence:
    """
    Match a grey pair.

    Parameters
    ----------
    pair : GreyPair
        H × W.
    threads : int
        Bands of rows are handled at the same time; sums are exact, so the bands do not show.

    Returns
    -------
    Correspondence
    """
    padded = pad(pair)
    rows, columns = pair.left.shape
    disparity = np.empty((rows, columns), np.float32)
    confidence = np.empty((rows, columns), np.float32)
    bands = -(-rows // (BAND_ROWS * threads)) * threads
    limits = [round(band * rows / bands) for band in range(bands + 1)]

    def run(band: int) -> None:
        start, stop = limits[band], limits[band + 1]
        _match_band(padded, start, stop, disparity[start:stop], confidence[start:stop])

    if threads == 1:
        for band in range(bands):
            run(band)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(bands)))
    return Correspondence(disparity, confidence)


@kernel
def _match_band(
    pair: PaddedPair, start: int, stop: int, disparity: Float32Array, confidence: Float32Array
) -> None:
    """Match the rows start … stop − 1."""
    columns, lanes = disparity.shape[1], pair.codes.size
    rows = pair.left.shape[0] - WIDTH - 1
    disparity[:] = np.nan
    confidence[:] = np.nan
    bests = Bests(
        np.full((stop - start, columns), -1, np.int32),
        np.zeros((stop - start, columns + lanes), np.int32),
        disparity,
        confidence,
    )
    sums = np.empty((TILE_COLUMNS + 2 * N + 1) * lanes, np.int32)
    for tile in range(0, columns, TILE_COLUMNS):
        width = min(TILE_COLUMNS, columns - tile)
        if not np.any(pair.left_seen[tile + N : tile + N + width]):
            continue
        complete = np.all(pair.left_seen[tile : tile + width + 2 * N]) and np.all(
            pair.right_seen[tile : tile + width + pair.candidates + 2 * N]
        )
        left = window_statistics(pair.left, start, stop, tile, width)
        right = window_statistics(pair.right, start, stop, tile, width + lanes)
        sums[:] = 0
        for row in range(start, start + WIDTH):
            add_row(sums, pair.left, pair.right, row, 0, tile, width, lanes)
        for y in range(start, stop):
            if complete:
                _match_row(pair, y, y - start, rows, tile, width, sums, left, right, bests)
            else:
                add_row(sums, pair.left, pair.right, y + WIDTH, y, tile, width, lanes)
                _match_row_masked(pair, y, y - start, rows, tile, width, sums, bests)
    _keep_consistent(pair, bests)


@kernel
def _match_row(
    pair: PaddedPair, y: int, row: int, rows: int, tile: int, width: int,
    sums: Int32Array, left: Windows, right: Windows, bests: Bests,
) -> None:  # fmt: skip
    """Move a tile down to row y and match it; every column was seen."""
    codes, lanes = pair.codes, pair.codes.size
    count = int32(WIDTH * clipped_rows(y, rows))
    below, above = pair.right[y + WIDTH], pair.right[y]
    totals, inverses = right.totals[row], right.inverses[row]
    right_best = bests.right[row, tile : tile + width + lanes]
    add_row(sums, pair.left, pair.right, y + WIDTH, y, tile, 0, lanes)
    cross = np.zeros(lanes, np.int32)
    for at in range(lanes, (2 * N + 1) * lanes, lanes):
        for d in range(0, lanes, LANES):
            store(cross, d, load(cross, d) + load(sums, at + d))
    counts, score_bits = splat(count), splat(int32(~pair.name_bits))
    for x in range(width):
        entering = tile + x + 2 * N
        at, at_leaving = (x + 2 * N + 1) * lanes, x * lanes
        new, old = splat(pair.left[y + WIDTH, entering]), splat(pair.left[y, entering])
        total, inverse = left.totals[row, x], left.inverses[row, x]
        left_total, left_scale = splat(total), splat(float32(inverse * SCORE_UNIT))
        best = splat(int32(0))
        for d in range(0, lanes, LANES):
            added = new * load(below, entering + d)
            taken = old * load(above, entering + d)
            column_sum = load(sums, at + d) + widen(added - taken)
            store(sums, at + d, column_sum)
            products = load(cross, d) + column_sum - load(sums, at_leaving + d)
            store(cross, d, products)
            covariance = counts * products - left_total * load(totals, x + d)
            scaled = to_float(covariance) * load(inverses, x + d) * left_scale
            named = (to_integer(scaled) & score_bits) | load(codes, d)
            best = maximum(best, named)
            store(right_best, x + d, maximum(load(right_best, x + d), named))
        named_best = largest(best)
        if named_best <= pair.name_bits:
            continue
        number = named_candidate(named_best, pair)
        k = number
        peak = float32(count * cross[k] - total * totals[x + k]) * inverses[x + k] * inverse
        offset = float32(0)
        if 0 < number < pair.candidates - 1:
            k = number - 1
            before = float32(count * cross[k] - total * totals[x + k]) * inverses[x + k] * inverse
            k = number + 1
            after = float32(count * cross[k] - total * totals[x + k]) * inverses[x + k] * inverse
            offset = vertex(before, peak, after)
        bests.numbers[row, tile + x] = number
        bests.disparity[row, tile + x] = float32(pair.first + number) + offset
        bests.confidence[row, tile + x] = min(peak, float32(1))


@kernel
def _match_row_masked(
    pair: PaddedPair, y: int, row: int, rows: int, tile: int, width: int,
    sums: Int32Array, bests: Bests,
) -> None:  # fmt: skip
    """Match a tile's part of row y without the columns that either panorama did not see."""
    lanes, candidates = pair.codes.size, pair.candidates
    window_rows = clipped_rows(y, rows)
    left_columns = _column_statistics(pair.left, y, tile, width + 2 * N)
    right_columns = _column_statistics(pair.right, y, tile, width + 2 * N + candidates)
    # Seen columns, Σl, Σl², Σr, Σr², Σlr of the window for each candidate.
    window = np.zeros((6, candidates), np.int32)
    rho = np.zeros(candidates, np.float32)
    for x in range(-2 * N, width):
        column = tile + x
        for side in range(2):
            # The window's right end enters, then the column left of its left end leaves.
            i = x - 1 if side else x + 2 * N
            if i < 0:
                continue
            sign = -1 if side else 1
            seen = pair.left_seen[tile + i] * sign
            for d in range(candidates):
                both = seen * pair.right_seen[tile + i + d]
                window[0, d] += both
                window[1, d] += both * left_columns[0, i]
                window[2, d] += both * left_columns[1, i]
                window[3, d] += both * right_columns[0, i + d]
                window[4, d] += both * right_columns[1, i + d]
                window[5, d] += sign * sums[(i + 1) * lanes + d]
        if x < 0 or pair.left_seen[column + N] == 0:
            continue
        best = int32(0)
        for d in range(candidates):
            rho[d] = np.nan
            if window[0, d] < MINIMAL_COLUMNS or pair.right_seen[column + N + d] == 0:
                continue
            count = int32(window_rows * window[0, d])
            inverse = inverse_deviation(count, window[1, d], window[2, d])
            right_inverse = inverse_deviation(count, window[3, d], window[4, d])
            covariance = float32(count * window[5, d] - window[1, d] * window[3, d])
            rho[d] = covariance * right_inverse * inverse
            scaled = covariance * right_inverse * float32(inverse * SCORE_UNIT)
            named = int32((int32(scaled) & ~pair.name_bits) | pair.codes[d])
            bests.right[row, column + d] = max(bests.right[row, column + d], named)
            best = max(best, named)
        if best <= pair.name_bits:
            continue
        number = named_candidate(best, pair)
        offset = float32(0)
        if 0 < number < candidates - 1:
            offset = vertex(rho[number - 1], rho[number], rho[number + 1])
        bests.numbers[row, column] = number
        bests.disparity[row, column] = float32(pair.first + number) + offset
        bests.confidence[row, column] = min(rho[number], float32(1))


@kernel
def _column_statistics(padded: Int16Array, y: int, start: int, width: int) -> Int32Array:
    """Σv and Σv² over the window's rows of single columns, shape (2, width)."""
    statistics = np.zeros((2, width), np.int32)
    for row in range(y + 1, y + WIDTH + 1):
        for x in range(width):
            value = int32(padded[row, start + x])
            statistics[0, x] += value
            statistics[1, x] += value * value
    return statistics


@kernel
def _keep_consistent(pair: PaddedPair, bests: Bests) -> None:
    """Unmatch what back-correlation does not confirm."""
    rows, columns = bests.numbers.shape
    for y in range(rows):
        numbers, right = bests.numbers[y], bests.right[y]
        for x in range(columns, right.size):
            right[x - columns] = max(right[x - columns], right[x])
        for x in range(columns):
            if numbers[x] < 0:
                continue
            at = x + numbers[x]
            back = named_candidate(right[at if at < columns else at - columns], pair)
            if abs(back - numbers[x]) > BACK_TOLERANCE:
                bests.disparity[y, x] = np.nan
                bests.confidence[y, x] = np.nan
