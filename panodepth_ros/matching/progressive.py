"""
Semi-global matching of a growing pair: columns as soon as what decides about them is there.

A left column is decided by what lies within :data:`MARGIN` of it in the left panorama, and within
as much of its candidates in the right one. A block of ready columns is cut out with that margin
and matched as if it were a whole turn of which nothing else was seen; the margin is thrown away.

The paths of the aggregation begin at other columns than in a match of the whole turn, and in plain
surfaces they remember it for a hundred columns and more (docs/matching.md). Blocks are therefore
for the time until the whole turn is there, not in its place.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import semiglobal
from panodepth_ros.matching.exposure import clipped
from panodepth_ros.matching.interface import Correspondence, GreyPair, grey_pair
from panodepth_ros.matching.semiglobal_costs import grey_noise

Seen = npt.NDArray[np.bool_]

#: Columns on either side of a column, and of its candidates, that decide about it.
MARGIN = 64


class GrowingMatch:
    """
    The match of a sweep, as far as its columns are ready.

    Attributes
    ----------
    matched : Correspondence
        On the left panorama's grid, H × W; NaN in columns that are not ready.
    ready : ndarray of bool, shape (W,)
        Left columns that were matched; they may be unmatched all the same.
    """

    def __init__(self, rows: int, columns: int) -> None:
        nothing = np.full((2, rows, columns), np.nan, np.float32)
        self.matched = Correspondence(nothing[0], nothing[1])
        self.ready = np.zeros(columns, np.bool_)

    def add(self, left: Panorama, right: Panorama, *, threads: int) -> None:
        """
        Match what has become ready.

        Parameters
        ----------
        left, right : Panorama
            The pair as it is, H × W; columns that were seen before have not changed.
        threads : int
            Threads to use.

        Raises
        ------
        ValueError
            If the panoramas are not a pair or have another size.
        """
        if left.image.shape[:2] != self.matched.confidence.shape:
            raise ValueError(
                f'partial panorama is {left.image.shape[:2]} pixels; allowed: '
                f'{self.matched.confidence.shape}, as the sweep began'
            )
        pair = grey_pair(left, right)
        ready = ready_columns(pair)
        for start, stop in _stretches(ready & ~self.ready):
            noise = grey_noise(np.ascontiguousarray(pair.left[:, pair.left_seen]))
            block = match_block(left, right, start, stop, noise=noise, threads=threads)
            self.matched.column_disparity[:, start:stop] = block.column_disparity
            self.matched.confidence[:, start:stop] = block.confidence
        self.ready |= ready


def ready_columns(pair: GreyPair) -> Seen:
    """Left columns, shape (W,), of which everything was seen that decides about them."""
    around = _seen_around(pair.left_seen, -MARGIN, MARGIN)
    return around & _seen_around(pair.right_seen, pair.first - MARGIN, pair.last + MARGIN)


def _seen_around(seen: Seen, first: int, last: int) -> Seen:
    """Whether the columns x + first … x + last, which wrap around, were all seen, for every x."""
    columns = seen.size
    reach = last - first + 1
    if reach >= columns:
        return np.full(columns, seen.all())
    before = np.concatenate([[0], np.cumsum(np.concatenate([seen, seen[: reach - 1]]))])
    return np.roll(before[reach:] - before[:columns] == reach, -first)


def _stretches(mask: Seen) -> list[tuple[int, int]]:
    """Begin and end of the stretches of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def match_block(
    left: Panorama, right: Panorama, start: int, stop: int, *, noise: float, threads: int
) -> Correspondence:
    """
    Match the columns start … stop − 1 of a pair.

    Parameters
    ----------
    left, right : Panorama
        The pair, H × W, of which no more counts than what :func:`ready_columns` asks for.
    start, stop : int
        The block, 0 ≤ start < stop ≤ W.
    noise : float
        Noise of the grey levels, by which costs and penalties are chosen; a match of the whole
        turn estimates it from the whole left panorama.
    threads : int
        Threads to use; the result does not depend on it.

    Returns
    -------
    Correspondence
        Of the block's columns, shape (H, stop − start).

    Raises
    ------
    ValueError
        If the panoramas are not a symmetric pair, or too small for window and search range.
    """
    grey = grey_pair(left, right)
    first, last = grey.first, grey.last
    begin = start - MARGIN + min(first, 0)
    cut = np.arange(begin, stop + MARGIN + max(last, 0) + 1)
    left_used = (cut >= start - MARGIN) & (cut < stop + MARGIN)
    right_used = (cut >= start - MARGIN + first) & (cut <= stop - 1 + MARGIN + last)
    cut %= grey.left_seen.size
    left_seen, right_seen = grey.left_seen[cut] & left_used, grey.right_seen[cut] & right_used

    def only(image: npt.NDArray[np.uint8], seen: Seen) -> npt.NDArray[np.uint8]:
        return np.where(seen, image[..., cut], np.uint8(0))

    pair = semiglobal.ColourPair(
        left=only(semiglobal.colours(left), left_seen),
        right=only(semiglobal.colours(right), right_seen),
        left_grey=only(grey.left, left_seen),
        right_grey=only(grey.right, right_seen),
        left_seen=left_seen,
        right_seen=right_seen,
        first=first,
        candidates=last - first + 1,
    )
    with ThreadPoolExecutor(threads) as pool:
        pair = semiglobal.equalised(pair, semiglobal.rough_match(pair, pool))
        winners = semiglobal.aggregate(pair, noise, pool)
        disparity, probability = semiglobal.refine(pair, winners, pool)
    kept = semiglobal.kept(disparity, probability, 0, clipped(left)[:, cut])
    block = slice(start - begin, stop - begin)
    return Correspondence(kept.column_disparity[:, block], kept.confidence[:, block])
