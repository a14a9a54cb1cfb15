"""
The paper's dense matching: normalised correlation with back-correlation (sec. 7, Fig. 6 b, c).

Every pixel of the left panorama takes the candidate of its row that correlates best. The match
stands if the best of the right pixel leads back to within one column. The confidence is the
correlation coefficient. A parabola through the best and its neighbours gives the sub-column
part. A window without texture matches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import float32, int32

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.bands import run_bands
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
    SCORE_UNIT,
    WIDTH,
    Float32Array,
    Int32Array,
    N,
    PaddedPair,
    add_row,
    named_candidate,
    pad,
    tile_columns,
    vertex,
    window_statistics,
)
from panodepth_ros.matching.interface import Correspondence, GreyPair, grey_pair
from panodepth_ros.matching.masked import Reach, TileRow, correlate, reach_of, tile_row
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
    left: Panorama,
    right: Panorama,
    further: Sequence[Panorama],
    threads: int,
    *,
    back_correlation: bool = True,
) -> Correspondence:
    """
    Match by normalised correlation and back-correlation; ``further`` is not used.

    Parameters and returns as in :func:`panodepth_ros.matching.match`; without
    ``back_correlation`` the best candidate stands whatever the right pixel prefers.
    """
    return match_grey(grey_pair(left, right), threads, back_correlation=back_correlation)


def prepare() -> None:
    """Compile the kernels."""
    grey = np.zeros((WIDTH, 2 * WIDTH), np.uint8)
    seen = np.ones(2 * WIDTH, np.bool_)
    match_grey(GreyPair(grey, grey, seen, seen, first=1, last=WIDTH), 1)


def match_grey(pair: GreyPair, threads: int, *, back_correlation: bool = True) -> Correspondence:
    """
    Match a grey pair.

    Parameters
    ----------
    pair : GreyPair
        H × W.
    threads : int
        Bands of rows are handled at the same time; sums are exact, so the bands do not show.
    back_correlation : bool
        Whether a match needs the consent of the right pixel.

    Returns
    -------
    Correspondence
    """
    padded = pad(pair)
    rows, columns = pair.left.shape
    disparity = np.empty((rows, columns), np.float32)
    confidence = np.empty((rows, columns), np.float32)

    def run(start: int, stop: int) -> None:
        _match_band(
            padded,
            start,
            stop,
            back_correlation,
            disparity[start:stop],
            confidence[start:stop],
        )

    run_bands(run, rows, -(-rows // (BAND_ROWS * threads)) * threads, threads)
    return Correspondence(disparity, confidence)


@kernel
def _match_band(
    pair: PaddedPair, start: int, stop: int, back_correlation: bool,
    disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Match the rows start … stop − 1."""
    columns, lanes = disparity.shape[1], pair.codes.size
    disparity[:] = np.nan
    confidence[:] = np.nan
    bests = Bests(
        np.full((stop - start, columns), -1, np.int32),
        np.zeros((stop - start, columns + lanes), np.int32),
        disparity,
        confidence,
    )
    reach = reach_of(pair, columns)
    widest = tile_columns(lanes)
    sums = np.empty((widest + 2 * N + 1) * lanes, np.int32)
    for tile in range(0, columns, widest):
        width = min(widest, columns - tile)
        if not np.any(pair.left_seen[tile + N : tile + N + width]):
            continue
        gaps = not np.all(reach.search[tile : tile + width])
        left = window_statistics(pair.left, start, stop, tile, width)
        right = window_statistics(pair.right, start, stop, tile, width + lanes)
        sums[:] = 0
        for filling in range(start, start + WIDTH):
            add_row(sums, pair.left, pair.right, filling, 0, tile, width, lanes)
        for y in range(start, stop):
            row = tile_row(pair, y, y - start, tile, left, right, gaps)
            _match_row(pair, reach, row, y, y - start, width, sums, bests)
    if back_correlation:
        _keep_consistent(pair, bests)


@kernel
def _match_row(
    pair: PaddedPair, reach: Reach, row: TileRow, y: int, band_row: int, width: int,
    sums: Int32Array, bests: Bests,
) -> None:  # fmt: skip
    """Move a tile down to row y and match it, in runs with and without unseen columns."""
    lanes = pair.codes.size
    add_row(sums, pair.left, pair.right, y + WIDTH, y, row.tile, 0, lanes)
    cross = np.zeros(lanes, np.int32)
    for at in range(lanes, (2 * N + 1) * lanes, lanes):
        for d in range(0, lanes, LANES):
            store(cross, d, load(cross, d) + load(sums, at + d))
    search = reach.search[row.tile : row.tile + width]
    x = 0
    while x < width:
        end = x + 1
        while end < width and search[end] == search[x]:
            end += 1
        if search[x]:
            _match_whole(pair, row, y, band_row, x, end, sums, cross, bests)
        else:
            _match_masked(pair, reach, row, y, band_row, x, end, sums, cross, bests)
        x = end


@kernel
def _match_whole(
    pair: PaddedPair, row: TileRow, y: int, band_row: int, first: int, end: int,
    sums: Int32Array, cross: Int32Array, bests: Bests,
) -> None:  # fmt: skip
    """Match the columns first … end − 1 of a tile, whose searches meet no unseen column."""
    tile, lanes, codes = row.tile, cross.size, pair.codes
    below, above = pair.right[y + WIDTH], pair.right[y]
    totals, inverses = row.right.totals, row.right.inverses
    right_best = bests.right[band_row, tile:]
    count = int32(WIDTH * row.window_rows)
    counts, score_bits = splat(count), splat(int32(~pair.name_bits))
    for x in range(first, end):
        entering = tile + x + 2 * N
        at, at_leaving = (x + 2 * N + 1) * lanes, x * lanes
        new, old = splat(pair.left[y + WIDTH, entering]), splat(pair.left[y, entering])
        total, inverse = row.left.totals[x], row.left.inverses[x]
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
        bests.numbers[band_row, tile + x] = number
        bests.disparity[band_row, tile + x] = float32(pair.first + number) + offset
        bests.confidence[band_row, tile + x] = min(peak, float32(1))


@kernel
def _match_masked(
    pair: PaddedPair, reach: Reach, row: TileRow, y: int, band_row: int, first: int, end: int,
    sums: Int32Array, cross: Int32Array, bests: Bests,
) -> None:  # fmt: skip
    """Do as ``_match_whole`` without the columns that either panorama did not see."""
    tile, lanes = row.tile, cross.size
    below, above = pair.right[y + WIDTH], pair.right[y]
    right_best = bests.right[band_row, tile:]
    rho, names = np.empty(lanes, np.float32), np.empty(lanes, np.int32)
    for x in range(first, end):
        entering = tile + x + 2 * N
        at, at_leaving = (x + 2 * N + 1) * lanes, x * lanes
        new, old = splat(pair.left[y + WIDTH, entering]), splat(pair.left[y, entering])
        for d in range(0, lanes, LANES):
            added = new * load(below, entering + d)
            taken = old * load(above, entering + d)
            column_sum = load(sums, at + d) + widen(added - taken)
            store(sums, at + d, column_sum)
            store(cross, d, load(cross, d) + column_sum - load(sums, at_leaving + d))
        if pair.left_seen[tile + x + N] == 0:
            continue
        named_best = correlate(pair, reach, row, x, cross, rho, names)
        for d in range(0, lanes, LANES):
            store(right_best, x + d, maximum(load(right_best, x + d), load(names, d)))
        if named_best <= pair.name_bits:
            continue
        number = named_candidate(named_best, pair)
        offset = float32(0)
        if 0 < number < pair.candidates - 1:
            offset = vertex(rho[number - 1], rho[number], rho[number + 1])
        bests.numbers[band_row, tile + x] = number
        bests.disparity[band_row, tile + x] = float32(pair.first + number) + offset
        bests.confidence[band_row, tile + x] = min(rho[number], float32(1))


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
