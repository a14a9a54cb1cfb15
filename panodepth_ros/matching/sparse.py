"""
The paper's sparse matching: normalised correlation at vertical edges only (sec. 7, Fig. 6 e).

A pixel of the left panorama is matched where the Sobel filter for vertical edges answers with
at least ``EDGE_THRESHOLD`` and with more than at its neighbours in the row; an ideal edge of h
grey levels answers with 4h. There is no back-correlation, as in the paper. The confidence is the
correlation coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import numpy.typing as npt
from numba import float32, int32

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
    SCORE_UNIT,
    TILE_COLUMNS,
    WIDTH,
    Float32Array,
    Int32Array,
    N,
    PaddedPair,
    Windows,
    add_row,
    clipped_rows,
    complete_windows,
    masked_correlation,
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
)

#: Sobel response of an edge that is matched: a step of 32 grey levels.
EDGE_THRESHOLD = 128


def match_sparse(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match vertical edges; ``further`` is not used.

    Parameters and returns as in :func:`panodepth_ros.matching.match`.
    """
    pair = grey_pair(left, right)
    edges = vertical_edges(pair)
    padded = pad(pair)
    rows, columns = pair.left.shape
    disparity = np.full((rows, columns), np.nan, np.float32)
    confidence = np.full((rows, columns), np.nan, np.float32)
    limits = [round(band * rows / threads) for band in range(threads + 1)]

    def run(band: int) -> None:
        _match_edges(padded, edges, limits[band], limits[band + 1], disparity, confidence)

    if threads == 1:
        run(0)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(threads)))
    return Correspondence(disparity, confidence)


def prepare() -> None:
    """Compile the kernels."""
    grey = np.zeros((WIDTH, 2 * WIDTH), np.uint8)
    seen = np.ones(2 * WIDTH, np.bool_)
    pair = GreyPair(grey, grey, seen, seen, first=1, last=WIDTH)
    _match_edges(
        pad(pair),
        np.zeros(grey.shape, np.bool_),
        0,
        0,
        np.empty(grey.shape, np.float32),
        np.empty(grey.shape, np.float32),
    )


def vertical_edges(pair: GreyPair) -> npt.NDArray[np.bool_]:
    """Where the left panorama has a vertical edge, shape (H, W); seen columns on both sides."""
    wrapped = cv2.copyMakeBorder(pair.left, 0, 0, 2, 2, cv2.BORDER_WRAP)
    response = np.abs(cv2.Sobel(wrapped, cv2.CV_16S, 1, 0, borderType=cv2.BORDER_REPLICATE))
    before, here, after = response[:, 1:-3], response[:, 2:-2], response[:, 3:-1]
    seen = pair.left_seen & np.roll(pair.left_seen, 1) & np.roll(pair.left_seen, -1)
    return np.asarray((here >= EDGE_THRESHOLD) & (here >= before) & (here > after) & seen)


@kernel
def _match_edges(
    pair: PaddedPair, edges: npt.NDArray[np.bool_], start: int, stop: int,
    disparity: Float32Array, confidence: Float32Array,
) -> None:  # fmt: skip
    """Match the edges on the rows start … stop − 1."""
    columns, lanes = edges.shape[1], pair.codes.size
    whole = _whole_searches(pair, columns)
    rho = np.empty(lanes, np.float32)
    sums = np.empty((TILE_COLUMNS + 2 * N + 1) * lanes, np.int32)
    for tile in range(0, columns, TILE_COLUMNS):
        width = min(TILE_COLUMNS, columns - tile)
        if not np.any(edges[start:stop, tile : tile + width]):
            continue
        left = window_statistics(pair.left, start, stop, tile, width)
        right = window_statistics(pair.right, start, stop, tile, width + lanes)
        sums[:] = 0
        for row in range(start, start + WIDTH):
            add_row(sums, pair.left, pair.right, row, 0, tile, width, lanes)
        for y in range(start, stop):
            add_row(sums, pair.left, pair.right, y + WIDTH, y, tile, width, lanes)
            for x in range(width):
                column = tile + x
                if not edges[y, column]:
                    continue
                if whole[column]:
                    named = _correlate(pair, y, y - start, x, sums, left, right, rho)
                else:
                    named = _correlate_masked(pair, y, column, rho)
                if named <= pair.name_bits:
                    continue
                number = named_candidate(named, pair)
                offset = float32(0)
                if 0 < number < pair.candidates - 1:
                    offset = vertex(rho[number - 1], rho[number], rho[number + 1])
                disparity[y, column] = float32(pair.first + number) + offset
                confidence[y, column] = min(rho[number], float32(1))


@kernel
def _whole_searches(pair: PaddedPair, columns: int) -> npt.NDArray[np.bool_]:
    """Whether all windows that a left column's search compares were seen, shape (columns,)."""
    left = complete_windows(pair.left_seen, columns)
    right = complete_windows(pair.right_seen, columns + pair.candidates)
    whole = np.empty(columns, np.bool_)
    run = 0  # complete windows from here to the right
    for x in range(columns + pair.candidates - 1, -1, -1):
        run = run + 1 if right[x] else 0
        if x < columns:
            whole[x] = left[x] and run >= pair.candidates
    return whole


@kernel
def _correlate(
    pair: PaddedPair, y: int, row: int, x: int,
    sums: Int32Array, left: Windows, right: Windows, rho: Float32Array,
) -> int:  # fmt: skip
    """Write ρ of a left pixel, column x of the tile, for all candidates; name the best."""
    lanes = pair.codes.size
    totals, inverses = right.totals[row], right.inverses[row]
    count = splat(int32(WIDTH * clipped_rows(y, pair.left.shape[0] - WIDTH - 1)))
    total, inverse = splat(left.totals[row, x]), splat(left.inverses[row, x])
    unit, score_bits = splat(float32(SCORE_UNIT)), splat(int32(~pair.name_bits))
    best = splat(int32(0))
    for d in range(0, lanes, LANES):
        products = load(sums, (x + 1) * lanes + d)
        for i in range(1, WIDTH):
            products = products + load(sums, (x + 1 + i) * lanes + d)
        covariance = count * products - total * load(totals, x + d)
        correlation = to_float(covariance) * load(inverses, x + d) * inverse
        store(rho, d, correlation)
        named = (to_integer(correlation * unit) & score_bits) | load(pair.codes, d)
        best = maximum(best, named)
    named_best: int = largest(best)
    return named_best


@kernel
def _correlate_masked(pair: PaddedPair, y: int, x: int, rho: Float32Array) -> int:
    """Do as ``_correlate`` without the columns that either panorama did not see."""
    best: int = int32(0)
    for d in range(pair.candidates):
        rho[d] = masked_correlation(pair, y, x, d)
        if not np.isnan(rho[d]):
            named = int32((int32(rho[d] * SCORE_UNIT) & ~pair.name_bits) | pair.codes[d])
            best = max(best, named)
    return best
