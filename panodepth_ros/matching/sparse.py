"""
The paper's sparse matching: normalised correlation at vertical edges only (sec. 7, Fig. 6 e).

A pixel of the left panorama is matched where the Sobel filter for vertical edges answers with
at least ``EDGE_THRESHOLD`` and with more than at its neighbours in the row; an ideal edge of h
grey levels answers with 4h. There is no back-correlation, as in the paper. The confidence is the
correlation coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt
from numba import float32

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.bands import run_bands
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.correlation import (
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
from panodepth_ros.matching.masked import correlate, reach_of, tile_row
from panodepth_ros.matching.simd import LANES, load, store

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

    def run(start: int, stop: int) -> None:
        _match_edges(padded, edges, start, stop, disparity, confidence)

    run_bands(run, rows, threads, threads)
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
    reach = reach_of(pair, columns)
    cross, names = np.empty(lanes, np.int32), np.empty(lanes, np.int32)
    rho = np.empty(lanes, np.float32)
    widest = tile_columns(lanes)
    sums = np.empty((widest + 2 * N + 1) * lanes, np.int32)
    for tile in range(0, columns, widest):
        width = min(widest, columns - tile)
        if not np.any(edges[start:stop, tile : tile + width]):
            continue
        gaps = not np.all(reach.search[tile : tile + width])
        left = window_statistics(pair.left, start, stop, tile, width)
        right = window_statistics(pair.right, start, stop, tile, width + lanes)
        sums[:] = 0
        for filling in range(start, start + WIDTH):
            add_row(sums, pair.left, pair.right, filling, 0, tile, width, lanes)
        for y in range(start, stop):
            add_row(sums, pair.left, pair.right, y + WIDTH, y, tile, width, lanes)
            row = tile_row(pair, y, y - start, tile, left, right, gaps)
            for x in range(width):
                if not edges[y, tile + x]:
                    continue
                _sum_columns(sums, x, cross)
                named = correlate(pair, reach, row, x, cross, rho, names)
                if named <= pair.name_bits:
                    continue
                number = named_candidate(named, pair)
                offset = float32(0)
                if 0 < number < pair.candidates - 1:
                    offset = vertex(rho[number - 1], rho[number], rho[number + 1])
                disparity[y, tile + x] = float32(pair.first + number) + offset
                confidence[y, tile + x] = min(rho[number], float32(1))


@kernel
def _sum_columns(sums: Int32Array, x: int, cross: Int32Array) -> None:
    """Write Σlr of column x of a tile for all candidates."""
    lanes = cross.size
    for d in range(0, lanes, LANES):
        products = load(sums, (x + 1) * lanes + d)
        for i in range(1, WIDTH):
            products = products + load(sums, (x + 1 + i) * lanes + d)
        store(cross, d, products)
