"""Aggregation of a pair, tile by tile: which tiles, where costs come from, both eyes' winners."""

from __future__ import annotations

import mmap
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from panodepth_ros.matching.colour_pair import ColourPair, put, wrapped
from panodepth_ros.matching.seam import EDGE_REACH, Side, local_cuts, seen_around, sides_of
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_COLUMNS,
    CENSUS_PLANES,
    CENSUS_ROWS,
    HIGH_NOISE,
    HIGH_NOISE_CUT,
    LOW_NOISE_CUT,
    PairCosts,
    Source,
    census,
)
from panodepth_ros.matching.semiglobal_paths import (
    LANES,
    MARGIN_COLUMNS,
    MARGIN_ROWS,
    NOBODY,
    disagreement,
    match_tile,
    tile_memory,
    vertical_penalties,
)

Bytes = npt.NDArray[np.uint8]
#: Rows top … bottom − 1 and columns start … stop − 1, as (top, bottom, start, stop).
Tile = tuple[int, int, int, int]

#: Most rows of a tile.
TILE_ROWS = 128
#: See ``Tiling``.
LEAST_CUTS = 14
#: Memory of a tile up to which it stays with the process [bytes].
KEPT_MEMORY = 12_000_000
#: Columns that decide about a tile, and about its candidates, beyond its own.
DECIDING = MARGIN_COLUMNS + CENSUS_COLUMNS


@dataclass(frozen=True, slots=True)
class Tiling:
    """
    How large tiles are.

    Attributes
    ----------
    reach : int
        Columns to either side that decide whether a tile begins, at most a
        ``LEAST_CUTS``-th of the turn.
    widest : int
        Most columns of a tile; less in a small panorama, as ``reach``.
    size : int
        Most pixels times candidates.
    """

    reach: int
    widest: int
    size: int

    def sides(self, pair: ColourPair, *, decided: bool = False) -> list[Side]:
        """Columns of a pair's tiles, or only of those that what is still unseen cannot change."""
        rows, columns = pair.left_grey.shape
        strips = -(-rows // TILE_ROWS)
        reach = min(self.reach, columns // LEAST_CUTS)
        widest = max(self.size * strips // (rows * lanes_of(pair)), MARGIN_COLUMNS)
        seen = pair.left_seen & pair.right_seen
        cuts = local_cuts(pair.keys, seen, reach)
        decides = reach + EDGE_REACH
        known = seen_around(seen, -decides, decides) if decided else None
        widest = min(widest, self.widest * reach // self.reach)
        return sides_of(pair.keys, cuts, widest, pair.seam, known)


#: Small, so that of a growing turn as much as possible is decided before its end.
PAIR_TILING = Tiling(reach=96, widest=256, size=7_000_000)


@dataclass(frozen=True, eq=False, slots=True)
class Winners:
    """
    What the aggregation finds, shape (H, W).

    Attributes
    ----------
    best : ndarray of uint16
        Number of the best candidate.
    margin : ndarray of uint16
        Aggregated cost of the next best one that is not its neighbour, minus its own.
    right_best : ndarray of uint32
        The right pixels' best as ``semiglobal_paths.match_tile`` names them.
    """

    best: npt.NDArray[np.uint16]
    margin: npt.NDArray[np.uint16]
    right_best: npt.NDArray[np.uint32]

    @classmethod
    def none(cls, rows: int, columns: int) -> Winners:
        """Nothing found yet."""
        best, margin = np.zeros((2, rows, columns), np.uint16)
        return cls(best, margin, np.full((rows, columns), NOBODY, np.uint32))

    def eyes(self, first: int, start: int, stop: int) -> Bytes:
        """
        By how many columns the right pixels' best candidates differ, at most 255.

        Of the columns start … stop − 1, which wrap around; ``first`` is the pair's.
        """
        best = wrapped(self.best, start, stop)
        eyes = np.empty(best.shape, np.uint8)
        disagreement(best, self.right_best, first + start, eyes)
        return eyes


def aggregate(
    pair: ColourPair,
    noise: float,
    pool: ThreadPoolExecutor,
    winners: Winners,
    sides: Iterable[Side],
    *,
    colour: bool = True,
) -> None:
    """
    Aggregate the costs of all candidates of some columns and find the winners of both eyes.

    Parameters
    ----------
    pair : ColourPair
    noise : float
        Noise of the grey levels.
    pool : ThreadPoolExecutor
        The tiles do not depend on how many threads it has.
    winners : Winners
        Receives them; a right pixel's is complete when all left columns are in that are compared
        with it.
    sides : iterable of Side
        Columns of the tiles.
    colour : bool
        Whether the colour difference counts, or only the census, as in a rough match.
    """

    def source(tile: Tile) -> PairCosts:
        return _pair_costs_of(pair, tile, noise, colour=colour)

    aggregate_costs(pair, noise, pool, winners, sides, source)


def aggregate_costs(
    pair: ColourPair,
    noise: float,
    pool: ThreadPoolExecutor,
    winners: Winners,
    sides: Iterable[Side],
    source_of: Callable[[Tile], Source],
) -> None:
    """Aggregate what a tile's costs come from, tile by tile; otherwise as :func:`aggregate`."""
    lanes = lanes_of(pair)
    penalties = vertical_penalties(noise)
    merging = threading.Lock()
    memory = threading.local()
    tiles = tiles_of(pair.left_grey.shape[0], sides)
    if not tiles:
        return

    def run(tile: Tile) -> None:
        top, bottom, start, stop = tile
        if not hasattr(memory, 'block'):
            memory.block = _one_piece(tile_memory(height, width, lanes))
        best, margin = np.empty((2, bottom - top, stop - start), np.uint16)
        found = np.full((bottom - top, stop - start + lanes), NOBODY, np.uint32)
        source = source_of(tile)
        match_tile(
            source, source.left, source.left_seen, top - max(top - MARGIN_ROWS, 0),
            pair.candidates, penalties, memory.block, best, margin, found,
        )  # fmt: skip
        put(winners.best[top:bottom], start, best)
        put(winners.margin[top:bottom], start, margin)
        with merging:
            _merge(winners.right_best[top:bottom], found, pair.first + start)

    height = max(bottom - top for top, bottom, _, _ in tiles)
    width = max(stop - start for _, _, start, stop in tiles)
    for _ in pool.map(run, tiles):
        pass


def tiles_of(rows: int, sides: Iterable[Side]) -> list[Tile]:
    """Cut sides into tiles."""
    strips = -(-rows // TILE_ROWS)
    edges = [round(strip * rows / strips) for strip in range(strips + 1)]
    return [(top, bottom, *side) for side in sides for top, bottom in pairwise(edges)]


def _one_piece(size: int) -> Bytes:
    """Memory that malloc keeps for the next match if small, that is given back if large."""
    if size <= KEPT_MEMORY:
        return np.empty(size, np.uint8)
    return np.frombuffer(mmap.mmap(-1, size), np.uint8)


def lanes_of(pair: ColourPair) -> int:
    """Candidates of a pair, padded to whole vectors."""
    return -(-pair.candidates // LANES) * LANES


def colour_cut(noise: float) -> tuple[int, bool]:
    """Where colour differences are cut off, and whether they are doubled."""
    return (HIGH_NOISE_CUT, False) if noise > HIGH_NOISE else (LOW_NOISE_CUT, True)


def _pair_costs_of(pair: ColourPair, tile: Tile, noise: float, *, colour: bool) -> PairCosts:
    """What the costs of a tile with its margins come from."""
    first, last, start, stop = with_margins(tile, pair.left_grey.shape[0])
    right_start, right_stop = start + pair.first, stop + pair.first + lanes_of(pair)
    cut, doubled = colour_cut(noise)
    return PairCosts(
        left=wrapped(pair.left[:, first:last], start, stop),
        right=wrapped(pair.right[:, first:last], right_start, right_stop),
        left_census=_census_of(pair.left_grey, (first, last, start, stop), noise),
        right_census=_census_of(pair.right_grey, (first, last, right_start, right_stop), noise),
        left_seen=wrapped(pair.left_seen, start, stop),
        right_seen=wrapped(pair.right_seen, right_start, right_stop),
        cut=cut if colour else 0,
        doubled=doubled,
    )


def with_margins(tile: Tile, rows: int) -> Tile:
    """Tile with the margins around its core."""
    top, bottom, start, stop = tile
    top, bottom = max(top - MARGIN_ROWS, 0), min(bottom + MARGIN_ROWS, rows)
    return top, bottom, start - MARGIN_COLUMNS, stop + MARGIN_COLUMNS


def surroundings(grey: Bytes, part: Tile) -> Bytes:
    """Grey levels of a part of a panorama, with half a census window more on all sides."""
    top, bottom, start, stop = part
    rows = np.clip(np.arange(top - CENSUS_ROWS, bottom + CENSUS_ROWS), 0, grey.shape[0] - 1)
    return wrapped(grey, start - CENSUS_COLUMNS, stop + CENSUS_COLUMNS)[rows]


def _census_of(grey: Bytes, part: Tile, noise: float) -> Bytes:
    """Census of a part of a panorama, shape (8, h, w)."""
    top, bottom, start, stop = part
    planes = np.empty((CENSUS_PLANES, bottom - top, stop - start), np.uint8)
    census(surroundings(grey, part), round(noise), planes)
    return planes


def _merge(right_best: npt.NDArray[np.uint32], found: npt.NDArray[np.uint32], column: int) -> None:
    """Take in the right pixels' best that a tile found from ``column`` on, which wraps around."""
    columns = right_best.shape[1]
    start = 0
    while start < found.shape[1]:
        at = (column + start) % columns
        length = min(columns - at, found.shape[1] - start)
        part = right_best[:, at : at + length]
        np.minimum(part, found[:, start : start + length], out=part)
        start += length
