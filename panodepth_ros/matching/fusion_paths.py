"""
Semi-global aggregation of a tile whose costs are all there.

The recursion of ``semiglobal_paths``, written as plain loops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import int32, njit, uint8, uint16, uint32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.semiglobal_paths import (
    LARGE_PENALTY,
    MARGIN_COLUMNS,
    NOBODY,
    SMALL_PENALTY,
)

Bytes = npt.NDArray[np.uint8]
Totals = npt.NDArray[np.uint16]
Names = npt.NDArray[np.uint32]
Seen = npt.NDArray[np.bool_]
Function = TypeVar('Function', bound=Callable[..., object])

#: Rows whose horizontal paths advance together, so that no step waits for the one before.
ROWS_AT_ONCE = 4


def _inlined(function: Function) -> Function:
    """Compile a function into its callers."""
    return cast(Function, njit(inline='always')(function))


@_inlined
def _step(before: Bytes, costs: Bytes, after: Bytes, floor: int, large: int) -> int:
    """One step of a path; states have a guard of 255 at either end. Returns their minimum."""
    lanes = costs.size
    below, here, above = before[0:lanes], before[1 : 1 + lanes], before[2 : 2 + lanes]
    out = after[1 : 1 + lanes]
    ceiling = uint8(floor + uint8(large - uint8(SMALL_PENALTY)))
    for k in range(lanes):
        cheapest = min(below[k], above[k], ceiling)
        cheapest = min(here[k], uint8(cheapest + uint8(SMALL_PENALTY)))
        out[k] = uint8(uint8(cheapest - floor) + costs[k])
    lowest: int = uint8(255)
    for k in range(lanes):
        lowest = min(lowest, out[k])
    return lowest


@_inlined
def _add(total: Totals, state: Bytes) -> None:
    states = state[1 : 1 + total.size]
    for k in range(total.size):
        total[k] = uint16(total[k] + uint16(states[k]))


@kernel
def _down(
    before: Bytes, floors: Bytes, costs: Bytes, skip: int, large: Bytes, after: Bytes,
    totals: Totals, adding: bool,
) -> None:  # fmt: skip
    """Advance the vertical paths of all columns by a row; ``costs`` begins ``skip`` before."""
    for x in range(before.shape[0]):
        floors[x] = _step(before[x], costs[skip + x], after[x], floors[x], large[x])
        if adding:
            _add(totals[x], after[x])


@kernel
def _across(
    before: Bytes, floors: Bytes, costs: Bytes, y: int, rows: int, x: int, after: Bytes,
    totals: Totals, skip: int,
) -> None:  # fmt: skip
    """Advance the horizontal paths of a few rows by a column; totals begin ``skip`` later."""
    for r in range(rows):
        floors[r] = _step(before[r], costs[y + r, x], after[r], floors[r], LARGE_PENALTY)
    if skip <= x < skip + totals.shape[1]:
        for r in range(rows):
            _add(totals[y + r, x - skip], after[r])


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
def _find_winners(
    totals: Totals, candidates: int, seen: Seen, best: Totals,
    margin: Totals, right_best: Names,
) -> None:  # fmt: skip
    """
    Best candidate of every pixel of a row.

    ``margin`` is by how much the smallest total of a candidate that is not its neighbour exceeds
    its own; ``right_best`` holds total and candidate of the right pixels' best.
    """
    lanes = totals.shape[1]
    for x in range(totals.shape[0]):
        total = totals[x]
        for k in range(candidates, lanes):
            total[k] = uint16(65535)
        named = right_best[x : x + lanes] if seen[x] else np.empty(lanes, np.uint32)
        lowest = uint32(NOBODY)
        for k in range(lanes):
            name = uint32(uint32(uint32(total[k]) << uint32(16)) | uint32(k))
            lowest = min(lowest, name)
            named[k] = min(named[k], name)
        winner = int32(lowest & uint32(0xFFFF))
        best[x] = winner
        other = uint16(65535)
        for part in (total[0 : max(winner - 1, 0)], total[min(winner + 2, lanes) : lanes]):
            for k in range(part.size):
                other = min(other, part[k])
        margin[x] = uint16(other - uint16(lowest >> uint32(16)))


@kernel
def _clear(states: Bytes) -> None:
    """No preference, with guards."""
    lanes = states.shape[-1] - 2
    states[..., 1 : 1 + lanes] = uint8(0)
    states[..., 0] = uint8(255)
    states[..., 1 + lanes] = uint8(255)


@kernel
def aggregate_costs(
    image: Bytes, costs: Bytes, seen: npt.NDArray[np.bool_], above: int, candidates: int,
    penalties: Bytes, totals: Totals, best: Totals, margin: Totals, right_best: Names,
) -> None:  # fmt: skip
    """
    Aggregate the costs of a tile and find the winners of its core.

    Parameters
    ----------
    image : ndarray of uint8, shape (3, h, w)
        Colours of the tile with its margins.
    costs : ndarray of uint8, shape (h, w, lanes)
        Costs of the tile with its margins.
    seen : ndarray of bool, shape (w,)
        Columns that a frame saw.
    above, candidates, penalties, best, margin, right_best
        See ``semiglobal_paths.match_tile``.
    totals : ndarray of uint16, shape (rows, columns, lanes)
        Working memory.
    """
    height, wide, lanes = costs.shape
    rows, columns = best.shape
    large = np.empty((height + 1, columns), np.uint8)
    _vertical_edges(image, penalties, large)
    totals[:] = uint16(0)
    rightward = np.empty((2, ROWS_AT_ONCE, lanes + 2), np.uint8)
    leftward = np.empty((2, ROWS_AT_ONCE, lanes + 2), np.uint8)
    right_floors = np.empty(ROWS_AT_ONCE, np.uint8)
    left_floors = np.empty(ROWS_AT_ONCE, np.uint8)
    core = costs[above : above + rows]
    for y in range(0, rows, ROWS_AT_ONCE):
        together = min(ROWS_AT_ONCE, rows - y)
        _clear(rightward)
        _clear(leftward)
        right_floors[:] = uint8(0)
        left_floors[:] = uint8(0)
        for x in range(wide - MARGIN_COLUMNS):
            now = x & 1
            _across(
                rightward[now], right_floors, core, y, together, x, rightward[1 - now], totals,
                MARGIN_COLUMNS,
            )  # fmt: skip
            _across(
                leftward[now], left_floors, core, y, together, wide - 1 - x, leftward[1 - now],
                totals, MARGIN_COLUMNS,
            )  # fmt: skip
    here = np.empty((columns, lanes + 2), np.uint8)
    there = np.empty((columns, lanes + 2), np.uint8)
    floors = np.zeros(columns, np.uint8)
    _clear(here)
    _clear(there)
    for y in range(above + rows):
        inside = y >= above
        total = totals[max(y - above, 0)]
        _down(here, floors, costs[y], MARGIN_COLUMNS, large[y], there, total, inside)
        here, there = there, here
    _clear(here)
    floors[:] = uint8(0)
    core_seen = seen[MARGIN_COLUMNS : MARGIN_COLUMNS + columns]
    for y in range(height - 1, above - 1, -1):
        inside = y < above + rows
        row = min(y - above, rows - 1)
        _down(here, floors, costs[y], MARGIN_COLUMNS, large[y + 1], there, totals[row], inside)
        here, there = there, here
        if inside:
            _find_winners(
                totals[row], candidates, core_seen, best[row], margin[row], right_best[row]
            )
