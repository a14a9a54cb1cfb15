"""The aggregation of a tile, against the recursion written out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matching_scenes import noise_image

from panodepth_ros.matching import semiglobal_costs as costs
from panodepth_ros.matching import semiglobal_paths as paths

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]

# An odd width has a column that both horizontal paths reach at once.
ROWS, COLUMNS, CANDIDATES, LANES = 9, 21, 50, 64
WIDE = COLUMNS + 2 * paths.MARGIN_COLUMNS


def path(cost: Integers, large: Integers) -> Integers:
    """States (n, lanes) of a path; ``large`` is the penalty of the step to each pixel."""
    states = [cost[0]]
    for here, penalty in zip(cost[1:], large[1:], strict=True):
        before = states[-1]
        guarded = np.pad(before, 1, constant_values=1000)
        beside = np.minimum(guarded[:-2], guarded[2:]) + paths.SMALL_PENALTY
        lowest = before.min()
        states.append(here + np.minimum(np.minimum(before, beside), lowest + penalty) - lowest)
    return np.array(states)


def test_tile_has_the_winners_of_the_recursion() -> None:
    rng = np.random.default_rng(1)
    left = rng.integers(90, 130, (3, ROWS, WIDE)).astype(np.uint8)
    right = rng.integers(90, 130, (3, ROWS, WIDE + LANES)).astype(np.uint8)
    left_grey = noise_image(rng, ROWS + 6, WIDE + 8)
    right_grey = noise_image(rng, ROWS + 6, WIDE + LANES + 8)
    left_seen, right_seen = np.ones(WIDE, bool), np.ones(WIDE + LANES, bool)
    left_seen[40] = right_seen[60] = False
    descriptors = [
        np.empty((costs.CENSUS_PLANES, ROWS, width), np.uint8) for width in (WIDE, WIDE + LANES)
    ]
    costs.census(left_grey, 1, descriptors[0])
    costs.census(right_grey, 1, descriptors[1])
    source = costs.PairCosts(left, right, *descriptors, left_seen, right_seen, 30, True)
    penalties = paths.vertical_penalties(1.0)
    best, margin = (np.zeros((ROWS, COLUMNS), np.uint16) for _ in range(2))
    right_best = np.full((ROWS, COLUMNS + LANES), paths.NOBODY, np.uint32)
    memory = np.empty(paths.tile_memory(ROWS, COLUMNS, LANES), np.uint8)
    paths.match_tile(
        source, left, left_seen, 0, CANDIDATES, penalties, memory, best, margin, right_best
    )

    one_byte = np.empty((ROWS, WIDE, LANES), np.uint8)
    for y in range(ROWS):
        costs.pair_costs(source, y, 0, paths.FILLER_COST, CANDIDATES, one_byte[y])
    cost = one_byte.astype(np.int64)
    core = slice(paths.MARGIN_COLUMNS, paths.MARGIN_COLUMNS + COLUMNS)
    everywhere = np.full(WIDE, paths.LARGE_PENALTY)
    edges = np.abs(np.diff(left.astype(np.int64), axis=1)).max(axis=0)
    total = np.zeros((ROWS, COLUMNS, LANES), np.int64)
    for y in range(ROWS):
        total[y] += path(cost[y], everywhere)[core]
        total[y] += path(cost[y, ::-1], everywhere)[::-1][core]
    for x in range(COLUMNS):
        at = core.start + x
        steps = penalties[edges[:, at]].astype(np.int64)
        total[:, x] += path(cost[:, at], np.append(0, steps))
        total[:, x] += path(cost[::-1, at], np.append(0, steps[::-1]))[::-1]
    total = total[..., :CANDIDATES]

    np.testing.assert_array_equal(best, total.argmin(axis=2))
    away = np.abs(np.arange(CANDIDATES) - best[..., np.newaxis]) > 1
    others = np.where(away, total, 65535).min(axis=2)
    np.testing.assert_array_equal(margin, others - total.min(axis=2))
    names = np.full((ROWS, COLUMNS + LANES), paths.NOBODY, np.int64)
    for x in np.flatnonzero(left_seen[core]):
        for k in range(CANDIDATES):
            names[:, x + k] = np.minimum(names[:, x + k], total[:, x, k] * 65536 + k)
    np.testing.assert_array_equal(right_best, names)
