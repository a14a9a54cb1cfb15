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
from typing import TypeVar, cast

import numpy as np
import numpy.typing as npt
from numba import int32, njit, uint8, uint16, uint32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_PLANES,
    candidate_costs,
    census,
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
LANES = 32
#: Rows whose horizontal paths advance together, so that no step waits for the one before.
ROWS_AT_ONCE = 4
#: Margin of a tile [columns, rows].
MARGIN_COLUMNS, MARGIN_ROWS = 32, 16
#: Cost of candidates that only fill up a vector: larger than any, and fits with the penalty.
FILLER_COST = 255 - LARGE_PENALTY
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
def _winners(
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
def disagreement(best: Totals, right_best: Names, first: int, eyes: Bytes) -> None:
    """
    By how many columns the right eye's winner differs from the left eye's.

    Parameters
    ----------
    best : ndarray of uint16, shape (H, W)
        Winning candidate of each left pixel.
    right_best : ndarray of uint32, shape (H, W)
        The right pixels' winners as ``match_tile`` names them.
    first : int
        Candidate k of column x is column (x + first + k) mod W.
    eyes : ndarray of uint8, shape (H, W)
        Receives the difference, at most 255.
    """
    columns = best.shape[1]
    for y in range(best.shape[0]):
        for x in range(columns):
            winner = int32(best[y, x])
            there = int32(right_best[y, (x + first + winner) % columns] & uint32(0xFFFF))
            eyes[y, x] = uint8(min(abs(there - winner), 255))


@kernel
def match_tile(
    left: Bytes, right: Bytes, left_grey: Bytes, right_grey: Bytes, left_seen: Seen,
    right_seen: Seen, above: int, candidates: int, noise: int, cut: int, doubled: bool,
    penalties: Bytes, costs_memory: Bytes, totals_memory: Totals, best: Totals, margin: Totals,
    right_best: Names,
) -> None:  # fmt: skip
    """
    Match the core of a tile.

    Parameters
    ----------
    left, right : ndarray of uint8, shapes (3, h, w) and (3, h, w + lanes)
        Colours of the tile: its core, ``above`` rows before it, up to ``MARGIN_ROWS`` after it
        and ``MARGIN_COLUMNS`` on either side. Candidate k of a column is k columns on in
        ``right``.
    left_grey, right_grey : ndarray of uint8, shapes (h + 6, w + 8) and (h + 6, w + lanes + 8)
        Grey levels, with half a census window more on all sides.
    left_seen, right_seen : ndarray of bool, shapes (w,) and (w + lanes,)
        Columns that a frame saw.
    above : int
        Rows before the core.
    candidates : int
        Number of candidates; the lanes are these, padded to whole vectors.
    noise : int
        Margin of the census [grey levels].
    cut, doubled : int, bool
        See ``candidate_costs``.
    penalties : ndarray of uint8, shape (256,)
        See ``vertical_penalties``.
    costs_memory, totals_memory : ndarray of uint8, uint16, one-dimensional
        Working memory, at least rows·w·lanes and rows·columns·lanes of the core's rows and
        columns.
    best, margin : ndarray of uint16, shape (rows, columns)
        Receive the core's winning candidates and by how much the next ones cost more.
    right_best : ndarray of uint32, shape (rows, columns + lanes)
        Receives total · 2¹⁶ + candidate of the right pixels' best, from the core's left pixels
        only; column 0 is candidate 0 of the first column.
    """
    height, wide = left.shape[1], left.shape[2]
    rows, columns = best.shape
    lanes = right.shape[2] - wide
    costs = costs_memory[: rows * wide * lanes].reshape(rows, wide, lanes)
    totals = totals_memory[: rows * columns * lanes].reshape(rows, columns, lanes)
    left_census = np.empty((CENSUS_PLANES, height, wide), np.uint8)
    right_census = np.empty((CENSUS_PLANES, height, wide + lanes), np.uint8)
    census(left_grey, noise, left_census)
    census(right_grey, noise, right_census)
    row_costs = np.empty((columns, lanes), np.uint8)
    large = np.empty((height + 1, columns), np.uint8)
    _vertical_edges(left, penalties, large)
    here = np.empty((columns, lanes + 2), np.uint8)
    there = np.empty((columns, lanes + 2), np.uint8)
    floors = np.zeros(columns, np.uint8)
    _clear(here)
    _clear(there)
    for y in range(above):
        candidate_costs(
            left, right, left_census, right_census, left_seen, right_seen, y, MARGIN_COLUMNS,
            cut, doubled, FILLER_COST, candidates, row_costs,
        )  # fmt: skip
        _down(here, floors, row_costs, 0, large[y], there, totals[0], False)
        here, there = there, here
    rightward = np.empty((2, ROWS_AT_ONCE, lanes + 2), np.uint8)
    leftward = np.empty((2, ROWS_AT_ONCE, lanes + 2), np.uint8)
    right_floors = np.empty(ROWS_AT_ONCE, np.uint8)
    left_floors = np.empty(ROWS_AT_ONCE, np.uint8)
    for y in range(0, rows, ROWS_AT_ONCE):
        together = min(ROWS_AT_ONCE, rows - y)
        for r in range(y, y + together):
            candidate_costs(
                left, right, left_census, right_census, left_seen, right_seen, above + r, 0,
                cut, doubled, FILLER_COST, candidates, costs[r],
            )  # fmt: skip
            totals[r] = uint16(0)
        _clear(rightward)
        _clear(leftward)
        right_floors[:] = uint8(0)
        left_floors[:] = uint8(0)
        for x in range(wide - MARGIN_COLUMNS):
            now = x & 1
            _across(
                rightward[now], right_floors, costs, y, together, x, rightward[1 - now], totals,
                MARGIN_COLUMNS,
            )  # fmt: skip
            _across(
                leftward[now], left_floors, costs, y, together, wide - 1 - x, leftward[1 - now],
                totals, MARGIN_COLUMNS,
            )  # fmt: skip
        for r in range(y, y + together):
            entered = large[above + r]
            _down(here, floors, costs[r], MARGIN_COLUMNS, entered, there, totals[r], True)
            here, there = there, here
    _clear(here)
    floors[:] = uint8(0)
    for y in range(height - 1, above + rows - 1, -1):
        candidate_costs(
            left, right, left_census, right_census, left_seen, right_seen, y, MARGIN_COLUMNS,
            cut, doubled, FILLER_COST, candidates, row_costs,
        )  # fmt: skip
        _down(here, floors, row_costs, 0, large[y + 1], there, totals[0], False)
        here, there = there, here
    seen = left_seen[MARGIN_COLUMNS : MARGIN_COLUMNS + columns]
    for r in range(rows - 1, -1, -1):
        entered = large[above + r + 1]
        _down(here, floors, costs[r], MARGIN_COLUMNS, entered, there, totals[r], True)
        here, there = there, here
        _winners(totals[r], candidates, seen, best[r], margin[r], right_best[r])
