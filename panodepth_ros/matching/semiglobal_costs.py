"""
Matching costs of a pixel and all its candidates: colour difference and census, one byte each.

The colour difference is Σ over channels of |l − r|, cut off, because what is hidden in one eye
differs by any amount. The census compares a pixel with the 62 others of the 7 × 9 window around
it (rows × columns), ``neighbour > centre + margin`` or ``neighbour < centre − margin`` in the
manner of a chessboard, and the cost counts the comparisons that come out differently. The margin
is the noise of the images, so that plain surfaces, where comparisons would be tossed coins, cost
nothing anywhere and take their depth from where they end.

Everything is unsigned bytes and loops run over candidates, which lie side by side in the right
panorama, so that a vector instruction handles 16 to 64 of them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
import numpy.typing as npt
from numba import int16, types, uint8
from numba.extending import overload

from panodepth_ros.matching.colour_pair import wrapped
from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.simd import (
    WIDE,
    bit_count,
    load_wide,
    maximum,
    minimum,
    saturated_sum,
    splat_wide,
    store,
    where_at_most,
)

Bytes = npt.NDArray[np.uint8]
Seen = npt.NDArray[np.bool_]

CENSUS_ROWS = 3
CENSUS_COLUMNS = 4
#: Bytes of a census descriptor: 62 bits.
CENSUS_PLANES = 8
#: Sum of the channels' differences at which the colour cost is cut off, before doubling.
LOW_NOISE_CUT, HIGH_NOISE_CUT = 30, 60
#: Grey noise above which the colour difference is not doubled [grey levels].
HIGH_NOISE = 1.8
#: What noise is taken for, whatever it is [grey levels].
NOISE_STEPS = (0.0, 1.0, HIGH_NOISE, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
#: Rows in the middle that the noise is judged by.
NOISE_ROWS = 120
#: Columns beyond either end that the noise of a column is judged by.
NOISE_BORDER = 5
#: Largest cost of a candidate: 60 of colour, 62 of census.
LARGEST_COST = 122
#: Cost of a candidate in a column that nobody saw: between a good match and a bad one.
UNSEEN_COST = 45


def grey_noise(grey: Bytes, seen: Seen) -> float:
    """
    Standard deviation of the noise of a grey panorama [grey levels].

    Parameters
    ----------
    grey : ndarray of uint8, shape (H, W)
    seen : ndarray of bool, shape (W,)
        Columns that count; they wrap around.

    Notes
    -----
    The mean of a mask that no plane passes, over windows of 9 × 9 pixels without clipped ones;
    the calmest tenth of the windows is taken for free of texture. Immerkær, "Fast noise variance
    estimation", 1996.
    """
    middle = grey.shape[0] // 2
    grey = grey[max(middle - NOISE_ROWS // 2, 0) : middle + NOISE_ROWS // 2]
    grey = wrapped(grey, -NOISE_BORDER, seen.size + NOISE_BORDER)
    unseen = ~wrapped(seen, -NOISE_BORDER, seen.size + NOISE_BORDER)
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, mask, borderType=cv2.BORDER_REFLECT))
    clipped = ((grey <= 8) | (grey >= 247) | unseen).astype(np.uint8)
    core = slice(NOISE_BORDER, -NOISE_BORDER)
    usable = cv2.dilate(clipped, np.ones((9, 9), np.uint8))[:, core] == 0
    if not usable.any():
        return 0.0
    responses = cv2.blur(response, (9, 9))[:, core][usable]
    tenth = responses.size // 10
    return float(np.partition(responses, tenth)[tenth]) * math.sqrt(math.pi / 2) / 6


def noise_step(noise: float) -> float:
    """
    Nearest of ``NOISE_STEPS``, but never across ``HIGH_NOISE``.

    So coarse that it is known before the last columns of a turn have come.
    """
    nearest = min(NOISE_STEPS, key=lambda step: abs(step - noise))
    return min(nearest, HIGH_NOISE) if noise <= HIGH_NOISE else max(nearest, 2.0)


@kernel
def census(grey: Bytes, margin: int, planes: Bytes) -> None:
    """
    Census descriptors of a region.

    Parameters
    ----------
    grey : ndarray of uint8, shape (h + 6, w + 8)
        The region with a border of half a window.
    margin : int
        By how much a neighbour must differ [grey levels].
    planes : ndarray of uint8, shape (8, h, w)
        Receives the bits.
    """
    height, width = planes.shape[1], planes.shape[2]
    planes[:] = uint8(0)
    for y in range(height):
        centre = grey[y + CENSUS_ROWS, CENSUS_COLUMNS : CENSUS_COLUMNS + width]
        bit = 0
        for j in range(2 * CENSUS_ROWS + 1):
            for i in range(2 * CENSUS_COLUMNS + 1):
                if j == CENSUS_ROWS and i == CENSUS_COLUMNS:
                    continue
                other = grey[y + j, i : i + width]
                plane = planes[bit >> 3, y]
                value = uint8(1 << (bit & 7))
                if (j + i) & 1:
                    for x in range(width):
                        if int16(other[x]) > int16(int16(centre[x]) + int16(margin)):
                            plane[x] |= value
                else:
                    for x in range(width):
                        if int16(other[x]) < int16(int16(centre[x]) - int16(margin)):
                            plane[x] |= value
                bit += 1


class Source(Protocol):
    """What the costs of a tile come from: a NamedTuple that ``candidate_costs`` knows."""

    @property
    def left(self) -> Bytes:
        """Colours of the tile with its margins, shape (3, h, …)."""

    @property
    def left_seen(self) -> Seen:
        """Columns that a frame saw, shape (…,)."""


class PairCosts(NamedTuple):
    """
    What the costs of a tile of a pair come from.

    Attributes
    ----------
    left, right : ndarray of uint8, shapes (3, h, w) and (3, h, w + lanes)
        Colours; candidate k of column x is column x + k of ``right``.
    left_census, right_census : ndarray of uint8, shapes (8, h, w) and (8, h, w + lanes)
        Census of the same.
    left_seen, right_seen : ndarray of bool, shapes (w,) and (w + lanes,)
        Columns that a frame saw.
    cut : int
        Where the sum of colour differences is cut off.
    doubled : bool
        Whether the colour difference counts twice.
    """

    left: Bytes
    right: Bytes
    left_census: Bytes
    right_census: Bytes
    left_seen: Seen
    right_seen: Seen
    cut: int
    doubled: bool


def candidate_costs(
    source: Source, y: int, start: int, filler: int, candidates: int, costs: Bytes
) -> None:
    """
    Costs of the pixels of a row, inside kernels, whatever they come from.

    Parameters
    ----------
    source : PairCosts or fusion_costs.ViewCosts
    y, start : int
        The row and its first column.
    filler : int
        Cost of candidates beyond ``candidates``, which only fill up the vectors.
    candidates : int
        Number of candidates.
    costs : ndarray of uint8, shape (n, lanes)
        Receives the costs; 0 for all candidates of a left column that was not seen. What
        follows it in memory may be overwritten up to ``WIDE`` pixels on.
    """
    raise NotImplementedError('only kernels call it')


def costs_come_from(kind: type[NamedTuple], implementation: Any) -> None:
    """Let ``candidate_costs`` of such a source be this kernel with the same parameters."""

    def choose(source: Any, y: Any, start: Any, filler: Any, candidates: Any, costs: Any) -> Any:
        if not isinstance(source, types.NamedTuple) or source.instance_class is not kind:
            return None
        return implementation.py_func

    overload(candidate_costs, strict=False)(choose)  # their annotations differ


@kernel
def pair_costs(
    source: PairCosts, y: int, start: int, filler: int, candidates: int, costs: Bytes
) -> None:
    """Costs of a pair: see ``candidate_costs``."""
    left, right, left_seen, right_seen = (
        source.left, source.right, source.left_seen, source.right_seen
    )  # fmt: skip
    left_census, right_census = source.left_census, source.right_census
    count, lanes = costs.shape
    rows, right_wide = right.shape[1:]
    # Fillers cost more than any candidate, so the larger of both is right.
    least = np.zeros(lanes, np.uint8)
    least[candidates:] = uint8(filler)
    doubling = splat_wide(uint8(255 if source.doubled else 0))
    ceiling, unseen, nothing = (
        splat_wide(uint8(source.cut)), splat_wide(uint8(UNSEEN_COST)), splat_wide(uint8(0))
    )  # fmt: skip
    for x in range(count):
        at = start + x
        if not left_seen[at]:
            for k in range(0, lanes, WIDE):
                store(costs, x * lanes + k, nothing)
            continue
        blue, green, red = (
            splat_wide(left[0, y, at]), splat_wide(left[1, y, at]), splat_wide(left[2, y, at])
        )  # fmt: skip
        for k in range(0, lanes, WIDE):
            there = y * right_wide + at + k
            blues = load_wide(right, there)
            greens = load_wide(right, there + rows * right_wide)
            reds = load_wide(right, there + 2 * rows * right_wide)
            difference = saturated_sum(
                maximum(blue, blues) - minimum(blue, blues),
                maximum(green, greens) - minimum(green, greens),
            )
            difference = saturated_sum(difference, maximum(red, reds) - minimum(red, reds))
            cost = minimum(difference, ceiling)
            cost = cost + (cost & doubling)
            for plane in range(CENSUS_PLANES):
                bits = splat_wide(left_census[plane, y, at])
                others = load_wide(right_census, there + plane * rows * right_wide)
                cost = cost + bit_count(bits ^ others)
            seen = load_wide(right_seen, at + k)
            cost = where_at_most(seen, nothing, unseen, cost)
            store(costs, x * lanes + k, maximum(cost, load_wide(least, k)))


costs_come_from(PairCosts, pair_costs)
