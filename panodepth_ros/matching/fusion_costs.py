"""
Matching costs of a pixel over all views of a sweep, one byte per candidate.

Each view is compared with the left panorama as the pair is (``semiglobal_costs``), at a quarter
of a column and half a row, but the census counts half. What a view can say against a candidate
is cut off, so that a view in which the point is hidden does not outvote those that see it, and
the mean of the views is taken with the square of the baseline as weight: views close to the left
one agree with almost anything.

Rows of a view are resampled when a row of the left panorama first asks for them and kept in a
ring as long as the next rows may ask, too.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import int32, int64, types, uint8, uint16
from numba.extending import intrinsic

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_COLUMNS,
    CENSUS_PLANES,
    CENSUS_ROWS,
    census,
)

Bytes = npt.NDArray[np.uint8]
Shorts = npt.NDArray[np.int16]
Seen = npt.NDArray[np.bool_]

#: Steps per column and per row at which views are sampled.
PHASES, HALVES = 4, 2
#: Columns that the interpolation reads before and after one.
BEFORE, AFTER = 1, 2
#: What a view can say against a candidate at most, and what an unseen column says.
CUT, UNSEEN = 50, 25
#: The weights of all views add up to this; a mean of CUT gives a cost of 120.
WEIGHTS = 614
#: Colours and census of a sample.
_PLANES = 3 + CENSUS_PLANES
#: Interpolation between columns, cubic (Catmull and Rom), in 128ths.
_TAPS = np.array(
    [[0, 128, 0, 0], [-9, 111, 29, -3], [-8, 72, 72, -8], [-3, 29, 111, -9]], np.int32
)


def _count_bits(typing_context: Any, value: Any) -> Any:
    """Number of ones in a byte, one instruction where the processor has it."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint8(types.uint8), generate


bit_count = intrinsic(_count_bits)


@kernel
def _resampled(row: Bytes, other: Bytes, phase: int, out: Bytes) -> None:
    """The mean of two rows, ``phase`` quarters of a column on; ``row`` has the border."""
    a, b = _TAPS[phase, 0], _TAPS[phase, 1]
    c, d = _TAPS[phase, 2], _TAPS[phase, 3]
    mean = np.empty(row.size, np.int32)
    for x in range(row.size):
        mean[x] = (int32(row[x]) + int32(other[x]) + 1) >> 1
    for x in range(out.size):
        value = a * mean[x] + b * mean[x + 1] + c * mean[x + 2] + d * mean[x + 3]
        out[x] = uint8(min(max((value + 64) >> 7, 0), 255))


@kernel
def _fill(image: Bytes, grey: Bytes, noise: int, fine: int, out: Bytes) -> None:
    """
    Sample a fine row of a view.

    ``image`` and ``grey`` have a border of half a census window and of the interpolation; fine
    row 0 is the first one that has a whole window. ``out`` is (PHASES, 11, w).
    """
    width = out.shape[2]
    window = np.empty((2 * CENSUS_ROWS + 1, width + 2 * CENSUS_COLUMNS), np.uint8)
    first, odd = fine >> 1, fine & 1
    side = CENSUS_COLUMNS
    for phase in range(PHASES):
        y = first + CENSUS_ROWS
        for c in range(3):
            _resampled(
                image[c, y, side : side + width + BEFORE + AFTER],
                image[c, y + odd, side : side + width + BEFORE + AFTER],
                phase, out[phase, c],
            )  # fmt: skip
        for j in range(2 * CENSUS_ROWS + 1):
            _resampled(grey[first + j], grey[first + j + odd], phase, window[j])
        planes = np.empty((CENSUS_PLANES, 1, width), np.uint8)
        census(window, noise, planes)
        out[phase, 3:] = planes[:, 0]


@kernel
def _add_costs(
    left: Bytes, left_census: Bytes, y: int, sample: Bytes, seen: Seen, cut: int, doubled: bool,
    weight: int, costs: npt.NDArray[np.uint16], buffer: Bytes,
) -> None:  # fmt: skip
    """Add a view's costs of one candidate for a row."""
    width = costs.size
    ceiling = uint8(cut)
    blue, green, red = left[0, y], left[1, y], left[2, y]
    blues, greens, reds = sample[0], sample[1], sample[2]
    for x in range(width):
        b = min(uint8(max(blue[x], blues[x]) - min(blue[x], blues[x])), ceiling)
        g = min(uint8(max(green[x], greens[x]) - min(green[x], greens[x])), ceiling)
        r = min(uint8(max(red[x], reds[x]) - min(red[x], reds[x])), ceiling)
        buffer[x] = min(uint8(uint8(b + g) + r), ceiling)
    differing = np.zeros(width, np.uint8)
    for plane in range(CENSUS_PLANES):
        bits, others = left_census[plane, y], sample[3 + plane]
        for x in range(width):
            differing[x] = uint8(differing[x] + bit_count(uint8(bits[x] ^ others[x])))
    double = uint8(2 if doubled else 1)
    for x in range(width):
        cost = min(uint8(uint8(double * buffer[x]) + (differing[x] >> uint8(1))), uint8(CUT))
        buffer[x] = cost if seen[x] else uint8(UNSEEN)
    heavy = uint16(weight)
    for x in range(width):
        costs[x] = uint16(costs[x] + uint16(heavy * uint16(buffer[x])))


@kernel
def fused_costs(
    left: Bytes, left_census: Bytes, left_seen: Seen, images: Bytes, greys: Bytes, seen: Seen,
    columns: Shorts, rows: Shorts, ring: int, weights: npt.NDArray[np.uint16], noise: int,
    cut: int, doubled: bool, filler: int, costs: Bytes,
) -> None:  # fmt: skip
    """
    Costs of all pixels of a tile.

    Parameters
    ----------
    left, left_census : ndarray of uint8, shapes (3, h, w) and (8, h, w)
        Colours and census of the tile.
    left_seen : ndarray of bool, shape (w,)
        Columns that a frame saw.
    images, greys : ndarray of uint8, shapes (V, 3, h', w') and (V, h', w')
        The views with half a census window more on all sides, BEFORE and AFTER columns for the
        interpolation, and one more row.
    seen : ndarray of bool, shape (V, PHASES, w' − …)
        Samples that frames saw.
    columns : ndarray of int16, shape (V, K)
        Sample at which the tile's first column is for a candidate [1/PHASES columns].
    rows : ndarray of int16, shape (V, h, K)
        Fine row of a row and a candidate [1/HALVES rows].
    ring : int
        A power of 2 above the number of fine rows of a view that one row asks for.
    weights : ndarray of uint16, shape (V,)
        Weights of the views, together ``WEIGHTS``.
    noise, cut, doubled, filler : int, int, bool, int
        As in ``semiglobal_paths.match_tile`` and ``semiglobal_costs.candidate_costs``.
    costs : ndarray of uint8, shape (h, w, lanes)
        Receives the costs; 0 for all candidates of a left column that was not seen.
    """
    height, width, lanes = costs.shape
    views, candidates = columns.shape
    wide = seen.shape[2]
    samples = np.empty((views, ring, PHASES, _PLANES, wide), np.uint8)
    held = np.full((views, ring), -1, np.int64)
    sums = np.empty((candidates, width), np.uint16)
    buffer = np.empty(width, np.uint8)
    for y in range(height):
        sums[:] = uint16(0)
        for v in range(views):
            for k in range(candidates):
                fine = int64(rows[v, y, k])
                slot = fine & (ring - 1)
                if held[v, slot] != fine:
                    held[v, slot] = fine
                    _fill(images[v], greys[v], noise, fine, samples[v, slot])
                start = int64(columns[v, k]) // PHASES
                phase = int64(columns[v, k]) % PHASES
                _add_costs(
                    left, left_census, y, samples[v, slot, phase, :, start : start + width],
                    seen[v, phase, start : start + width], cut, doubled, weights[v], sums[k],
                    buffer,
                )  # fmt: skip
        for x in range(width):
            out = costs[y, x]
            if not left_seen[x]:
                out[:] = uint8(0)
                continue
            for k in range(candidates):
                out[k] = uint8(sums[k, x] >> uint16(8))
            for k in range(candidates, lanes):
                out[k] = uint8(filler)
