"""
Matching costs of a pixel over all views of a sweep, one byte per candidate.

Each view is compared with the left panorama much as the pair is (``semiglobal_costs``), at a
quarter of a column and half a row. The census has 28 comparisons, with the columns one and three
away. What a view can say against a candidate is cut off, so that a view in which the point is
hidden does not outvote those that see it, and the mean of the views is taken with the square of
the baseline as weight: views close to the left one agree with almost anything.

Half rows are means of whole ones. At a horizontal edge they differ from what the left panorama
shows there, and candidates at whole rows would win: on a plain board, about which the columns say
nothing, whichever they are. So colours may differ by a part of the left panorama's own vertical
steps, but in the pair's right panorama, which has the same rows.

A candidate is a constant shift of a view, but not by whole columns: here vectors hold
neighbouring pixels, and are turned to neighbouring candidates at the end. Rows of a view are
resampled when a row of the left panorama first asks for them and kept in a ring as long as the
next rows may ask, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import int64, uint8, uint16

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_COLUMNS,
    CENSUS_ROWS,
    costs_come_from,
)
from panodepth_ros.matching.simd import (
    WIDE,
    bit_count,
    load_wide,
    maximum,
    minimum,
    narrow_words,
    saturated_difference,
    saturated_sum,
    splat_wide,
    store,
    transpose,
    where_at_most,
    widen_bytes,
)

Bytes = npt.NDArray[np.uint8]
Shorts = npt.NDArray[np.int16]
Places = npt.NDArray[np.int64]
Integers = npt.NDArray[np.int32]
Seen = npt.NDArray[np.bool_]

#: Steps per column and per row at which views are sampled.
PHASES, HALVES = 4, 2
#: Columns that the interpolation reads before and after one.
BEFORE, AFTER = 1, 2
#: What a view can say against a candidate at most, and what an unseen column says.
CUT, UNSEEN = 50, 25
#: The weights of all views add up to this; a mean of CUT gives a cost of 120.
WEIGHTS = 614
#: Bytes of a census of 28 bits.
CENSUS_PLANES = 4
#: Colours and census of a sample.
PLANES = 3 + CENSUS_PLANES
#: Fine rows of grey levels that a census reads at once.
CENSUS_FINE_ROWS = 2 * HALVES * CENSUS_ROWS + 1
#: By what part of the vertical steps around it, in 16ths, a pixel's colours may differ.
SLACK = 6
#: Interpolation between columns, cubic (Catmull and Rom), in 128ths modulo 2¹⁶.
_TAPS = np.array(
    [[0, 128, 0, 0], [-9, 111, 29, -3], [-8, 72, 72, -8], [-3, 29, 111, -9]], np.int16
).view(np.uint16)


class ViewCosts(NamedTuple):
    """
    What the costs of a tile come from with all views of a sweep, and memory to work with.

    Attributes
    ----------
    left, left_census : ndarray of uint8, shapes (3, h, w) and (4, h, w)
        Colours and census of the tile and of ``WIDE`` or more columns after it.
    slack : ndarray of uint8, shape (h, w)
        By how much colours may differ, likewise.
    left_seen : ndarray of bool, shape (w,)
        Columns that a frame saw, likewise.
    images : ndarray of uint8, shape (V, 4, h', w')
        Blue, green, red, grey of the views with half a census window more on all sides, BEFORE
        and AFTER columns for the interpolation, and one more row.
    seen : ndarray of bool, shape (V, PHASES, …)
        Samples that frames saw.
    columns : ndarray of int16, shape (V, K)
        Sample at which the tile's first column is for a candidate [1/PHASES columns].
    rows : ndarray of int16, shape (V, h, K)
        Fine row of a row and a candidate [1/HALVES rows].
    weights : ndarray of uint16, shape (V,)
        Weights of the views, together ``WEIGHTS``.
    noise : int
        Margin of the census [grey levels].
    cut : int
        Where the sum of colour differences is cut off.
    doubled : bool
        Whether the colour difference counts twice.
    samples : ndarray of uint8, shape (V, ring, PHASES, PLANES, n)
        Rings of resampled rows; a power of 2 above the number of fine rows of a view that one
        row asks for.
    held : ndarray of int32, shape (V, ring, PHASES)
        Which rows they hold.
    greys : ndarray of uint8, shape (V, ring', PHASES, n + 2·CENSUS_COLUMNS)
        Rings of resampled grey levels; ``CENSUS_FINE_ROWS`` more.
    held_greys : ndarray of int32, shape (V, ring', PHASES)
        Which rows they hold.
    """

    left: Bytes
    left_census: Bytes
    slack: Bytes
    left_seen: Seen
    images: Bytes
    seen: Seen
    columns: Shorts
    rows: Shorts
    weights: npt.NDArray[np.uint16]
    noise: int
    cut: int
    doubled: bool
    samples: Bytes
    held: Integers
    greys: Bytes
    held_greys: Integers


@kernel
def _resample(image: Bytes, fine: int, start: int, phase: int, out: Bytes) -> None:
    """Sample a fine row of a channel from a column on, ``phase`` quarters of a column on."""
    width = image.shape[1]
    upper = (fine >> 1) * width + start
    lower = upper + (fine & 1) * width
    one, half = splat_wide(uint16(1)), splat_wide(uint16(64))
    seven, highest = splat_wide(uint16(7)), splat_wide(uint16(255))
    # What a negative tap takes away must not go below zero before it is limited.
    lifted, lift = splat_wide(uint16(32 << 7)), splat_wide(uint16(32))
    for x in range(0, out.size, WIDE):
        value = half + lifted
        for tap in range(BEFORE + 1 + AFTER):
            above = widen_bytes(load_wide(image, upper + x + tap))
            below = widen_bytes(load_wide(image, lower + x + tap))
            mean = (above + below + one) >> one
            value = value + mean * splat_wide(_TAPS[phase, tap])
        value = saturated_difference(value >> seven, lift)
        store(out, x, narrow_words(minimum(value, highest)))


@kernel
def _census_row(
    levels: Bytes, rows: Places, noise: int, out: Bytes, at: int, step: int, width: int
) -> None:
    """
    Census of a row, whole vectors.

    ``rows`` has the places in ``levels`` at which the rows of the windows begin; planes go to
    ``at`` and every ``step`` from there.
    """
    margin, nothing = splat_wide(uint8(noise)), splat_wide(uint8(0))
    for x in range(0, width, WIDE):
        centre = load_wide(levels, rows[CENSUS_ROWS] + CENSUS_COLUMNS + x)
        above, below = saturated_sum(centre, margin), saturated_difference(centre, margin)
        bit = 0
        bits = nothing
        for j in range(2 * CENSUS_ROWS + 1):
            for i in range(1, 2 * CENSUS_COLUMNS + 1, 2):
                other = load_wide(levels, rows[j] + x + i)
                value = splat_wide(uint8(1 << (bit & 7)))
                if (j + i) & 1:
                    bits = bits | where_at_most(other, above, nothing, value)
                else:
                    bits = bits | where_at_most(below, other, nothing, value)
                bit += 1
                if bit & 7 == 0:
                    store(out, at + (bit // 8 - 1) * step + x, bits)
                    bits = nothing
        store(out, at + (CENSUS_PLANES - 1) * step + x, bits)


@kernel
def short_census(grey: Bytes, noise: int, planes: Bytes) -> None:
    """
    Census descriptors of a region with the columns one and three away.

    Parameters
    ----------
    grey : ndarray of uint8, shape (h + 6, w + 8)
        The region with a border of half a window.
    noise : int
        By how much a neighbour must differ [grey levels].
    planes : ndarray of uint8, shape (4, h, w)
        Receives the bits; w is a multiple of ``WIDE``.
    """
    height, width = planes.shape[1:]
    for y in range(height):
        rows = (y + np.arange(2 * CENSUS_ROWS + 1)) * grey.shape[1]
        _census_row(grey, rows, noise, planes, y * width, height * width, width)


@kernel
def _fill(source: ViewCosts, view: int, fine: int, phase: int) -> None:
    """Sample a fine row of a view; row 0 is the first one that has a whole window."""
    images, greys, held = source.images[view], source.greys[view], source.held_greys[view]
    ring = greys.shape[0]
    sample = source.samples[view, fine & (source.samples.shape[1] - 1), phase]
    rows = np.empty(2 * CENSUS_ROWS + 1, np.int64)
    for c in range(3):
        _resample(images[c], fine + HALVES * CENSUS_ROWS, CENSUS_COLUMNS, phase, sample[c])
    for j in range(2 * CENSUS_ROWS + 1):
        row = fine + HALVES * j
        slot = row & (ring - 1)
        if held[slot, phase] != row:
            held[slot, phase] = row
            _resample(images[3], row, 0, phase, greys[slot, phase])
        rows[j] = (slot * PHASES + phase) * greys.shape[2]
    wide = sample.shape[1]
    _census_row(greys, rows, source.noise, sample, 3 * wide, wide, wide)


@kernel
def fused_costs(
    source: ViewCosts, y: int, start: int, filler: int, candidates: int, costs: Bytes
) -> None:
    """Costs over all views: see ``semiglobal_costs.candidate_costs``."""
    count, lanes = costs.shape
    left, left_census, samples = source.left, source.left_census, source.samples
    height, left_wide = left.shape[1:]
    views, ring = samples.shape[:2]
    wide, seen_wide = samples.shape[4], source.seen.shape[2]
    places = np.empty((candidates, views), np.int64)
    seen_places = np.empty((candidates, views), np.int64)
    for v in range(views):
        for k in range(candidates):
            fine, at = int64(source.rows[v, y, k]), int64(source.columns[v, k])
            slot, phase, column = fine & (ring - 1), at % PHASES, at // PHASES + start
            if source.held[v, slot, phase] != fine:
                source.held[v, slot, phase] = fine
                _fill(source, v, fine, phase)
            places[k, v] = ((v * ring + slot) * PHASES + phase) * PLANES * wide + column
            seen_places[k, v] = (v * PHASES + phase) * seen_wide + column
    ceiling, highest = splat_wide(uint8(source.cut)), splat_wide(uint8(CUT))
    unseen, nothing = splat_wide(uint8(UNSEEN)), splat_wide(uint8(0))
    doubling = splat_wide(uint8(255 if source.doubled else 0))
    eight = splat_wide(uint16(8))
    block = np.full(lanes * WIDE, filler, np.uint8)
    for x in range(0, count, WIDE):
        here = y * left_wide + start + x
        blue, green = load_wide(left, here), load_wide(left, here + height * left_wide)
        red = load_wide(left, here + 2 * height * left_wide)
        slack = load_wide(source.slack, here)
        for k in range(candidates):
            total = splat_wide(uint16(0))
            for v in range(views):
                there = places[k, v] + x
                blues, greens = load_wide(samples, there), load_wide(samples, there + wide)
                reds = load_wide(samples, there + 2 * wide)
                difference = saturated_sum(
                    maximum(blue, blues) - minimum(blue, blues),
                    maximum(green, greens) - minimum(green, greens),
                )
                difference = saturated_sum(difference, maximum(red, reds) - minimum(red, reds))
                if v < views - 1:
                    difference = saturated_difference(difference, slack)
                colour = minimum(difference, ceiling)
                colour = colour + (colour & doubling)
                differing = nothing
                for plane in range(CENSUS_PLANES):
                    bits = load_wide(left_census, here + plane * height * left_wide)
                    others = load_wide(samples, there + (3 + plane) * wide)
                    differing = differing + bit_count(bits ^ others)
                cost = minimum(colour + differing, highest)
                seen = load_wide(source.seen, seen_places[k, v] + x)
                cost = where_at_most(seen, nothing, unseen, cost)
                total = total + widen_bytes(cost) * splat_wide(source.weights[v])
            store(block, k * WIDE, narrow_words(total >> eight))
        for k in range(0, lanes, WIDE):
            transpose(block, k * WIDE, WIDE, costs, x * lanes + k, lanes)
    for x in range(count):
        if not source.left_seen[start + x]:
            costs[x] = uint8(0)


costs_come_from(ViewCosts, fused_costs)
