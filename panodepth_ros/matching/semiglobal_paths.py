"""
Semi-global aggregation of a tile: costs summed along four paths, and the winners.

Along a path the state of candidate d at the pixel p with cost C is (Hirschmüller, "Stereo
processing by semiglobal matching and mutual information", 2008, eq. 13)

    L(p, d) = C(p, d) + min(L(p', d), L(p', d ± 1) + P1, m + P2) − m,   m = min over d of L(p', d)

with the pixel p' before it. Paths run along the row from the left and from the right, and along
the column from above and from below. C + P2 fits into a byte, and so does every state.

Along the columns P2 falls towards P1 where the colour changes. A plain board that is a few rows
high says nothing along its rows but what their ends say; vertical paths that carried the
surroundings through it at full price would outvote that.

A tile is a core and a margin: paths start that many pixels outside of the core, where they forget
that they started. What a tile keeps does not grow with the panorama.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import int32, int64, njit, uint8, uint16, uint32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.semiglobal_costs import Source, candidate_costs
from panodepth_ros.matching.simd import (
    WIDE,
    lane_after,
    lane_before,
    load_wide,
    minimum,
    smallest,
    splat_wide,
    store,
    where_at_most,
    widen_bytes,
)

Bytes = npt.NDArray[np.uint8]
Totals = npt.NDArray[np.uint16]
Names = npt.NDArray[np.uint32]
Seen = npt.NDArray[np.bool_]
Function = TypeVar('Function', bound=Callable[..., object])

#: Penalty of one column's change of disparity, and of any larger change.
SMALL_PENALTY, LARGE_PENALTY = 60, 125
#: Colour difference over which a vertical path's large penalty falls towards the small one.
EDGE_SCALE = 20.0
#: Differences up to this multiple of the noise are none.
EDGE_NOISE = 2.0
#: Candidates are padded to a multiple of this, whole vector registers.
LANES = WIDE
#: Rows whose horizontal paths advance together, so that no step waits for the one before.
ROWS_AT_ONCE = 4
#: Margin of a tile [columns, rows].
MARGIN_COLUMNS, MARGIN_ROWS = 32, 16
#: Cost of candidates that only fill up a vector: larger than any, and fits with the penalty.
FILLER_COST = 255 - LARGE_PENALTY
#: What becomes of L − C: nothing, it is kept, it is added to what is there.
NOTHING, KEEP, ADD = 0, 1, 2
#: What a right pixel holds that no left pixel was compared with.
NOBODY = 0xFFFFFFFF


def vertical_penalties(noise: float) -> Bytes:
    """
    Large penalty of a vertical step by the largest difference of a channel, shape (256,).

    Parameters
    ----------
    noise : float
        Noise of the grey levels.
    """
    edge = np.maximum(np.arange(256) - EDGE_NOISE * noise, 0.0)
    part = np.exp(-edge / EDGE_SCALE)
    penalty = np.rint(SMALL_PENALTY + (LARGE_PENALTY - SMALL_PENALTY) * part)
    return np.asarray(penalty, np.uint8)


def _inlined(function: Function) -> Function:
    """Compile a function into its callers."""
    return cast(Function, njit(inline='always')(function))


@_inlined
def _deviations(before: Any, here: Any, after: Any, ceiling: Any, floors: Any) -> Any:
    """L − C of a vector of candidates from the states before, and those of either side."""
    cheapest = minimum(minimum(lane_before(before, here), lane_after(here, after)), ceiling)
    return minimum(here, cheapest + splat_wide(uint8(SMALL_PENALTY))) - floors


@_inlined
def _step(
    states: Bytes, at: int, lanes: int, floor: int, large: int, costs: Bytes, cost_at: int,
    sums: Bytes, sum_at: int, mode: int,
) -> int:  # fmt: skip
    """Advance a path's states by a pixel; return their minimum. Adds L − C to ``sums``."""
    floors = splat_wide(uint8(floor))
    ceiling = splat_wide(uint8(floor + uint8(large - uint8(SMALL_PENALTY))))
    before = least = splat_wide(uint8(255))
    here = load_wide(states, at)
    for k in range(0, lanes, WIDE):
        after = load_wide(states, at + k + WIDE)
        deviations = _deviations(before, here, after, ceiling, floors)
        now = deviations + load_wide(costs, cost_at + k)
        store(states, at + k, now)
        least = minimum(least, now)
        if mode == KEEP:
            store(sums, sum_at + k, deviations)
        elif mode == ADD:
            store(sums, sum_at + k, deviations + load_wide(sums, sum_at + k))
        before = here
        here = after
    lowest: int = smallest(least)
    return lowest


@kernel
def _down(
    states: Bytes, floors: Bytes, large: Bytes, costs: Bytes, cost_at: int, sums: Bytes,
    sum_at: int, mode: int, lanes: int,
) -> None:  # fmt: skip
    """Advance the vertical paths of all columns by a row."""
    for x in range(floors.size):
        floors[x] = _step(
            states, x * (lanes + WIDE), lanes, floors[x], large[x], costs, cost_at + x * lanes,
            sums, sum_at + x * lanes, mode,
        )  # fmt: skip


@kernel
def _across(
    states: Bytes, costs: Bytes, rows: int, top: int, columns: int, sums: Bytes, lanes: int
) -> None:
    """
    Run the horizontal paths of a few rows from ``top`` on, in both directions at once.

    ``sums`` receives L − C of both for the ``columns`` of the core, from the first of the rows on.
    """
    wide = columns + 2 * MARGIN_COLUMNS
    stride = lanes + WIDE
    floors = np.zeros(2 * rows, np.uint8)
    for x in range(wide - MARGIN_COLUMNS):
        column = x - MARGIN_COLUMNS
        other = columns - 1 - column
        rightward = leftward = NOTHING
        if column >= 0:  # whoever comes first keeps, whoever comes second adds
            rightward = KEEP if column <= other else ADD
            leftward = KEEP if other > column else ADD
        for r in range(rows):
            row_costs, row_sums = (top + r) * wide, r * columns
            floors[2 * r] = _step(
                states, 2 * r * stride, lanes, floors[2 * r], LARGE_PENALTY,
                costs, (row_costs + x) * lanes, sums, (row_sums + column) * lanes, rightward,
            )  # fmt: skip
            floors[2 * r + 1] = _step(
                states, (2 * r + 1) * stride, lanes, floors[2 * r + 1], LARGE_PENALTY,
                costs, (row_costs + wide - 1 - x) * lanes,
                sums, (row_sums + other) * lanes, leftward,
            )  # fmt: skip


@kernel
def _up(
    states: Bytes, floors: Bytes, large: Bytes, costs: Bytes, cost_at: int, across: Bytes,
    across_at: int, down: Bytes, down_at: int, lanes: int, candidates: int, seen: Seen,
    best: Totals, margin: Totals, right_best: Names,
) -> None:  # fmt: skip
    """
    Advance the upward paths by a row, the last to come, and find the winners of the row.

    ``margin`` is by how much the smallest total of a candidate that is not its neighbour exceeds
    its own; ``right_best`` holds total and candidate of the right pixels' best.
    """
    columns = floors.size
    numbers = np.arange(lanes).astype(np.uint16)
    fillers = np.zeros(lanes, np.uint16)
    fillers[candidates:] = uint16(65535)
    totals = np.empty(lanes + 2, np.uint16)  # with a guard at either end
    totals[0] = totals[lanes + 1] = uint16(65535)
    right_totals = np.full(columns + lanes, 65535, np.uint16)
    right_columns = np.zeros(columns + lanes, np.uint16)
    highest = splat_wide(uint16(65535))
    for x in range(columns):
        at = x * (lanes + WIDE)
        floor = splat_wide(floors[x])
        ceiling = splat_wide(uint8(floors[x] + uint8(large[x] - uint8(SMALL_PENALTY))))
        before = least = splat_wide(uint8(255))
        here = load_wide(states, at)
        lowest = highest
        column = splat_wide(uint16(x))
        for k in range(0, lanes, WIDE):
            after = load_wide(states, at + k + WIDE)
            deviations = _deviations(before, here, after, ceiling, floor)
            cost = load_wide(costs, cost_at + x * lanes + k)
            now = deviations + cost
            store(states, at + k, now)
            least = minimum(least, now)
            before = here
            here = after
            vertical = widen_bytes(deviations + load_wide(down, down_at + x * lanes + k))
            total = vertical + widen_bytes(load_wide(across, across_at + x * lanes + k))
            twice = widen_bytes(cost) + widen_bytes(cost)
            total = (total + twice + twice) | load_wide(fillers, k)
            store(totals, 1 + k, total)
            lowest = minimum(lowest, total)
            if seen[x]:
                others = load_wide(right_totals, x + k)
                named = where_at_most(total, others, column, load_wide(right_columns, x + k))
                store(right_totals, x + k, minimum(total, others))
                store(right_columns, x + k, named)
        floors[x] = smallest(least)
        winning = smallest(lowest)
        first = highest
        for k in range(0, lanes, WIDE):
            number = where_at_most(
                load_wide(totals, 1 + k), splat_wide(winning), load_wide(numbers, k), highest
            )
            first = minimum(first, number)
        winner = int64(smallest(first))
        best[x] = winner
        totals[winner : winner + 3] = uint16(65535)
        lowest = highest
        for k in range(0, lanes, WIDE):
            lowest = minimum(lowest, load_wide(totals, 1 + k))
        margin[x] = uint16(smallest(lowest) - winning)
    for x in range(columns + lanes):
        if right_totals[x] < uint16(65535):
            candidate = uint32(x - int64(right_columns[x]))
            right_best[x] = uint32(uint32(uint32(right_totals[x]) << uint32(16)) | candidate)


@kernel
def _vertical_edges(image: Bytes, penalties: Bytes, large: Bytes) -> None:
    """Large penalty between row y − 1 and row y of the core's columns."""
    height, columns = image.shape[1], large.shape[1]
    large[0] = large[height] = uint8(LARGE_PENALTY)
    for y in range(1, height):
        for x in range(columns):
            edge = int32(0)
            for c in range(3):
                above = int32(image[c, y - 1, MARGIN_COLUMNS + x])
                edge = max(edge, abs(int32(image[c, y, MARGIN_COLUMNS + x]) - above))
            large[y, x] = penalties[edge]


@kernel
def _clear(states: Bytes, lanes: int) -> None:
    """No preference, with a vector of guards after each pixel's states."""
    for at in range(0, states.size, lanes + WIDE):
        states[at : at + lanes] = uint8(0)
        states[at + lanes : at + lanes + WIDE] = uint8(255)


@kernel
def disagreement(best: Totals, right_best: Names, first: int, eyes: Bytes) -> None:
    """
    By how many columns the right eye's winner differs from the left eye's.

    Parameters
    ----------
    best : ndarray of uint16, shape (H, w)
        Winning candidate of each left pixel of some columns.
    right_best : ndarray of uint32, shape (H, W)
        The right pixels' winners as ``match_tile`` names them.
    first : int
        Candidate k of column x of ``best`` is column (x + first + k) mod W.
    eyes : ndarray of uint8, shape (H, w)
        Receives the difference, at most 255.
    """
    columns = right_best.shape[1]
    for y in range(best.shape[0]):
        for x in range(best.shape[1]):
            winner = int32(best[y, x])
            there = int32(right_best[y, (x + first + winner) % columns] & uint32(0xFFFF))
            eyes[y, x] = uint8(min(abs(there - winner), 255))


def tile_memory(rows: int, columns: int, lanes: int) -> int:
    """Bytes that ``match_tile`` works in, for a core of that size."""
    wide = columns + 2 * MARGIN_COLUMNS
    return (rows * (wide + columns) + ROWS_AT_ONCE * columns + WIDE) * lanes


@kernel
def match_tile(
    source: Source, image: Bytes, seen: Seen, above: int, candidates: int, penalties: Bytes,
    memory: Bytes, best: Totals, margin: Totals, right_best: Names,
) -> None:  # fmt: skip
    """
    Match the core of a tile.

    Parameters
    ----------
    source : Source
        What ``candidate_costs`` takes the tile's costs from.
    image : ndarray of uint8, shape (3, h, …)
        Colours of the tile: its core, ``above`` rows before it, up to ``MARGIN_ROWS`` after it
        and ``MARGIN_COLUMNS`` on either side.
    seen : ndarray of bool, shape (…,)
        Columns that a frame saw, likewise.
    above : int
        Rows before the core.
    candidates : int
        Number of candidates; the lanes are these, padded to whole vectors.
    penalties : ndarray of uint8, shape (256,)
        See ``vertical_penalties``.
    memory : ndarray of uint8, one-dimensional
        Working memory of at least ``tile_memory`` bytes.
    best, margin : ndarray of uint16, shape (rows, columns)
        Receive the core's winning candidates and by how much the next ones cost more.
    right_best : ndarray of uint32, shape (rows, columns + lanes)
        Receives total · 2¹⁶ + candidate of the right pixels' best, from the core's left pixels
        only; column 0 is candidate 0 of the first column. What none is compared with stays.
    """
    height = image.shape[1]
    rows, columns = best.shape
    wide, lanes = columns + 2 * MARGIN_COLUMNS, right_best.shape[1] - columns
    size = rows * wide * lanes
    costs, flat_costs = memory[:size].reshape(rows, wide, lanes), memory[:size]
    sums = memory[size + WIDE * lanes :]
    down, across = sums[: rows * columns * lanes], sums[rows * columns * lanes :]
    flat_row = np.empty((columns + WIDE) * lanes, np.uint8)
    row_costs = flat_row[: columns * lanes].reshape(columns, lanes)
    large = np.empty((height + 1, columns), np.uint8)
    _vertical_edges(image, penalties, large)
    states = np.empty(columns * (lanes + WIDE), np.uint8)
    floors = np.zeros(columns, np.uint8)
    _clear(states, lanes)
    for y in range(above):
        candidate_costs(source, y, MARGIN_COLUMNS, FILLER_COST, candidates, row_costs)
        _down(states, floors, large[y], flat_row, 0, down, 0, NOTHING, lanes)
    for r in range(rows):
        candidate_costs(source, above + r, 0, FILLER_COST, candidates, costs[r])
        _down(
            states, floors, large[above + r], flat_costs, (r * wide + MARGIN_COLUMNS) * lanes,
            down, r * columns * lanes, KEEP, lanes,
        )  # fmt: skip
    _clear(states, lanes)
    floors[:] = uint8(0)
    for y in range(height - 1, above + rows - 1, -1):
        candidate_costs(source, y, MARGIN_COLUMNS, FILLER_COST, candidates, row_costs)
        _down(states, floors, large[y + 1], flat_row, 0, down, 0, NOTHING, lanes)
    core_seen = seen[MARGIN_COLUMNS : MARGIN_COLUMNS + columns]
    across_states = np.empty(2 * ROWS_AT_ONCE * (lanes + WIDE), np.uint8)
    for top in range((rows - 1) // ROWS_AT_ONCE * ROWS_AT_ONCE, -1, -ROWS_AT_ONCE):
        together = min(ROWS_AT_ONCE, rows - top)
        _clear(across_states, lanes)
        _across(across_states, flat_costs, together, top, columns, across, lanes)
        for r in range(top + together - 1, top - 1, -1):
            _up(
                states, floors, large[above + r + 1], flat_costs,
                (r * wide + MARGIN_COLUMNS) * lanes, across, (r - top) * columns * lanes, down,
                r * columns * lanes, lanes, candidates, core_seen, best[r], margin[r],
                right_best[r],
            )  # fmt: skip
