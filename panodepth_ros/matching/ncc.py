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

import numpy as np
from numba import float32, int16, int32, uint64

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
    MINIMAL_COLUMNS,
    SCORE_BITS,
    TILE_COLUMNS,
    WIDTH,
    Float32Array,
    Int16Array,
    Int32Array,
    N,
    PaddedPair,
    add_products,
    candidate_codes,
    clipped_rows,
    inverse_deviation,
    pad,
    score,
    slide,
    vertex,
    window_statistics,
)
from panodepth_ros.matching.interface import Correspondence, GreyPair, grey_pair

#: A match stands if the right pixel's best leads back to within this many columns.
BACK_TOLERANCE = 1
#: Rows that one call of the kernel handles, so that its memory does not grow with the image.
BAND_ROWS = 128


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
    shape = (padded.rows, padded.columns)
    result = Correspondence(np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32))
    bands = -(-padded.rows // (BAND_ROWS * threads)) * threads
    limits = [round(band * padded.rows / bands) for band in range(bands + 1)]

    def run(band: int) -> None:
        _match_rows(padded, result, limits[band], limits[band + 1])

    if threads == 1:
        for band in range(bands):
            run(band)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(bands)))
    return result


def _match_rows(padded: PaddedPair, result: Correspondence, start: int, stop: int) -> None:
    _match_band(
        padded.left,
        padded.right,
        padded.left_seen,
        padded.right_seen,
        padded.first,
        padded.candidates,
        candidate_codes(padded.candidates, padded.lanes),
        start,
        stop,
        result.column_disparity,
        result.confidence,
    )


@kernel
def _match_band(
    left: Int16Array, right: Int16Array, left_seen: Int32Array, right_seen: Int32Array,
    first: int, candidates: int, codes: Int32Array, start: int, stop: int,
    disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Match the rows start … stop − 1."""
    rows, columns = disparity.shape
    lanes = codes.size
    left_totals, left_inverses = window_statistics(left, rows, start, stop)
    right_totals, right_inverses = window_statistics(right, rows, start, stop)
    numbers = np.full((stop - start, columns), -1, np.int32)
    right_best = np.zeros((stop - start, columns + lanes), np.int32)
    sums = np.empty((TILE_COLUMNS + 2 * N + 1) * lanes, np.int32)
    for tile in range(0, columns, TILE_COLUMNS):
        width = min(TILE_COLUMNS, columns - tile)
        if not np.any(left_seen[tile + N : tile + N + width]):
            continue
        whole = np.all(left_seen[tile : tile + width + 2 * N]) and np.all(
            right_seen[tile : tile + width + candidates + 2 * N]
        )
        sums[:] = 0
        for row in range(start, start + WIDTH):
            _add_row(sums, left, right, row, -1, tile, width, lanes)
        for y in range(start, stop):
            _add_row(sums, left, right, y + WIDTH, y, tile, width, lanes)
            if whole:
                _match_row(
                    sums, y - start, WIDTH * clipped_rows(y, rows), tile, width,
                    left_totals, left_inverses, right_totals, right_inverses,
                    first, candidates, codes, right_best, numbers, disparity[y], confidence[y],
                )  # fmt: skip
            else:
                _match_row_masked(
                    sums, y - start, clipped_rows(y, rows), tile, width,
                    left, right, left_seen, right_seen, y,
                    first, candidates, codes, right_best, numbers, disparity[y], confidence[y],
                )  # fmt: skip
    _keep_consistent(numbers, right_best, codes, start, disparity, confidence)


@kernel
def _add_row(
    sums: Int32Array, left: Int16Array, right: Int16Array, below: int, above: int,
    tile: int, width: int, lanes: int,
) -> None:  # fmt: skip
    """Move the column sums of a tile down by a row; ``above`` is −1 while they fill."""
    stride = uint64(right.shape[1])
    flat = right.reshape(-1)
    nothing = int16(0)
    for x in range(width + 2 * N):
        old = left[above, tile + x] if above >= 0 else nothing
        add_products(
            sums, uint64(x + 1) * uint64(lanes), left[below, tile + x],
            uint64(below) * stride + uint64(tile + x),
            old, uint64(max(above, 0)) * stride + uint64(tile + x), flat, uint64(lanes),
        )  # fmt: skip


@kernel
def _match_row(
    sums: Int32Array, row: int, count: int, tile: int, width: int,
    left_totals: Int32Array, left_inverses: Float32Array,
    right_totals: Int32Array, right_inverses: Float32Array,
    first: int, candidates: int, codes: Int32Array, right_best: Int32Array,
    numbers: Int32Array, disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Match a tile's part of a row where every column was seen."""
    lanes = uint64(codes.size)
    shift = _shift(codes)
    unit = float32(1 << (SCORE_BITS - shift))
    cross = np.zeros(codes.size, np.int32)
    for x in range(2 * N):
        slide(cross, sums, uint64(x + 1) * lanes, uint64(0), lanes)
    totals, inverses = right_totals[row], right_inverses[row]
    bests = right_best[row]
    for x in range(width):
        slide(cross, sums, uint64(x + 2 * N + 1) * lanes, uint64(x) * lanes, lanes)
        column = tile + x
        total, inverse = left_totals[row, column], left_inverses[row, column]
        best = score(
            cross, int32(count), total, float32(inverse * unit), totals, inverses,
            uint64(column), codes, int32(shift), bests, uint64(column), lanes,
        )  # fmt: skip
        if best >> shift == 0:
            continue
        number = _number(best, shift, codes)
        numbers[row, column] = number
        rho = np.zeros(3, np.float64)
        for k in range(3):
            d = min(max(number + k - 1, 0), candidates - 1)
            covariance = count * cross[d] - total * totals[column + d]
            rho[k] = np.float64(covariance) * inverse * inverses[column + d]
        offset = 0.0
        if 0 < number < candidates - 1:
            offset = vertex(rho[0], rho[1], rho[2])
        disparity[column] = first + number + offset
        confidence[column] = min(rho[1], 1.0)


@kernel
def _shift(codes: Int32Array) -> int:
    """Bits that a candidate's number needs."""
    shift = 0
    while 1 << shift < codes.size:
        shift += 1
    return shift


@kernel
def _number(named: int, shift: int, codes: Int32Array) -> int:
    """Candidate that a named score names."""
    return codes.size - 1 - (named & ((1 << shift) - 1))


@kernel
def _match_row_masked(
    sums: Int32Array, row: int, window_rows: int, tile: int, width: int,
    left: Int16Array, right: Int16Array, left_seen: Int32Array, right_seen: Int32Array, y: int,
    first: int, candidates: int, codes: Int32Array, right_best: Int32Array,
    numbers: Int32Array, disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Match a tile's part of a row without the columns that either panorama did not see."""
    shift = _shift(codes)
    unit = float32(1 << (SCORE_BITS - shift))
    lanes = codes.size
    left_columns = _column_statistics(left, y, tile, width + 2 * N)
    right_columns = _column_statistics(right, y, tile, width + 2 * N + candidates)
    window = np.zeros((6, candidates), np.int32)
    rho = np.zeros(candidates, np.float64)
    for x in range(-2 * N, width):
        for side in range(2):
            # The window's right end enters, then the column left of its left end leaves.
            i = x + 2 * N if side == 0 else x - 1
            if i < 0:
                continue
            sign = 1 - 2 * side
            seen = left_seen[tile + i] * sign
            for d in range(candidates):
                both = seen * right_seen[tile + i + d]
                window[0, d] += both
                window[1, d] += both * left_columns[0, i]
                window[2, d] += both * left_columns[1, i]
                window[3, d] += both * right_columns[0, i + d]
                window[4, d] += both * right_columns[1, i + d]
                window[5, d] += sign * sums[(i + 1) * lanes + d]
        column = tile + x
        if x < 0 or left_seen[column + N] == 0:
            continue
        best = int32(0)
        for d in range(candidates):
            rho[d] = np.nan
            if window[0, d] < MINIMAL_COLUMNS or right_seen[column + N + d] == 0:
                continue
            count = window_rows * window[0, d]
            inverse = inverse_deviation(count, window[1, d], window[2, d])
            right_inverse = inverse_deviation(count, window[3, d], window[4, d])
            covariance = count * window[5, d] - window[1, d] * window[3, d]
            rho[d] = np.float64(covariance) * inverse * right_inverse
            scaled = float32(float32(int32(covariance)) * right_inverse)
            scaled = float32(scaled * float32(inverse * unit))
            named = int32(int32(int32(scaled) << shift) + codes[d])
            right_best[row, column + d] = max(right_best[row, column + d], named)
            best = max(best, named)
        if best >> shift == 0:
            continue
        number = _number(best, shift, codes)
        numbers[row, column] = number
        offset = 0.0
        if 0 < number < candidates - 1 and not np.isnan(rho[number - 1] + rho[number + 1]):
            offset = vertex(rho[number - 1], rho[number], rho[number + 1])
        disparity[column] = first + number + offset
        confidence[column] = min(rho[number], 1.0)


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
def _keep_consistent(
    numbers: Int32Array, right_best: Int32Array, codes: Int32Array, start: int,
    disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Unmatch what back-correlation does not confirm."""
    rows, columns = numbers.shape
    shift = _shift(codes)
    for y in range(rows):
        for x in range(columns, right_best.shape[1]):
            right_best[y, x - columns] = max(right_best[y, x - columns], right_best[y, x])
        for x in range(columns):
            if numbers[y, x] < 0:
                continue
            back = right_best[y, (x + numbers[y, x]) % columns]
            if abs(_number(back, shift, codes) - numbers[y, x]) > BACK_TOLERANCE:
                disparity[start + y, x] = np.nan
                confidence[start + y, x] = np.nan
