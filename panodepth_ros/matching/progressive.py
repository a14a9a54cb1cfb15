"""
Semi-global matching of a growing pair: tiles as soon as what decides about them is there.

Where tiles begin is decided by the columns around (``seam``), so the tiles of a growing turn are
those of the whole turn. What the whole turn decides, noise and exposure (``semiglobal.Look``), is
taken as it looks so far. In the end it is checked, and so is every column that was used: what
still holds is taken over, everything else matched anew. The result is that of a match of the
whole turn, bit by bit, however the turn has grown; only the time that it takes is not.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.aggregation import DECIDING, PAIR_TILING, aggregate
from panodepth_ros.matching.colour_pair import ColourPair, colour_pair
from panodepth_ros.matching.confidence import ALIKE_COLUMNS
from panodepth_ros.matching.evaluation import evaluate, smoothed
from panodepth_ros.matching.exposure import clipped
from panodepth_ros.matching.interface import Correspondence
from panodepth_ros.matching.rough import rough_match
from panodepth_ros.matching.seam import Side, seen_around
from panodepth_ros.matching.semiglobal import Look, Work, complete, kept

Seen = npt.NDArray[np.bool_]

#: Columns on either side of a column, and of its candidates, that have a part in its match: what
#: is farther away paths of the aggregation have mostly forgotten.
MARGIN = 64


class GrowingMatch:
    """
    The match of a sweep, as far as its columns are ready.

    Attributes
    ----------
    reused : int
        Left columns that the last :meth:`finish` had not to match any more.
    """

    def __init__(self, rows: int, columns: int) -> None:
        self._shape = rows, columns
        self.reused = 0
        self._forget()

    def _forget(self) -> None:
        self._work = Work.none(*self._shape)
        self._left: Panorama | None = None
        self._pair: ColourPair | None = None
        self._look: Look | None = None
        self._looked_at = 0

    @property
    def ready(self) -> Seen:
        """Left columns, shape (W,), that were matched; they may be unmatched all the same."""
        return _columns_of(self._work.aggregated, self._shape[1])

    def add(self, left: Panorama, right: Panorama, *, threads: int) -> None:
        """
        Match what has become ready.

        Parameters
        ----------
        left, right : Panorama
            The pair as it is, H × W. If columns that were used are other than before, all is
            matched anew.
        threads : int
            Threads to use.

        Raises
        ------
        ValueError
            If the panoramas are not a pair or have another size.
        """
        pair = self._checked(left, right)
        if not self._holds(pair):
            self._forget()
        self._left, self._pair = left, pair
        decided = _decided(pair)
        if not decided - self._work.aggregated:
            return
        with ThreadPoolExecutor(threads) as pool:
            look = Look.of(pair, rough_match(pair, pool))
            seen = int((pair.left_seen & pair.right_seen).sum())
            # Not each time: what is thrown away stays less than twice what is kept.
            if self._look is None or (not look.same(self._look) and seen >= 1.5 * self._looked_at):
                self._work = Work.none(*self._shape)
                self._look, self._looked_at = look, seen
            pair, noise, work = self._look.equalised(pair), self._look.noise, self._work
            rest = sorted(decided - work.aggregated)
            aggregate(pair, noise, pool, work.winners, rest)
            work.aggregated.update(rest)
            rest = sorted(self._to_evaluate(pair) - work.evaluated)
            evaluate(pair, work.winners, pool, work.estimates, rest)
            work.evaluated.update(rest)

    def _checked(self, left: Panorama, right: Panorama) -> ColourPair:
        if left.image.shape[:2] != self._shape:
            raise ValueError(
                f'panorama is {left.image.shape[:2]} pixels; allowed: {self._shape}, as the sweep '
                'began'
            )
        return colour_pair(left, right)

    def _to_evaluate(self, pair: ColourPair) -> set[Side]:
        """Tiles whose right pixels are compared with no left column that is still to come."""
        reach = ALIKE_COLUMNS + pair.candidates
        around = seen_around(self.ready, -reach, reach)
        return {side for side in self._work.aggregated if _within(side, around)}

    def _holds(self, pair: ColourPair) -> bool:
        """Whether a pair shows in all columns that were used what they showed then."""
        before = self._pair
        if before is None or not self._work.aggregated:
            return True
        if (before.first, before.candidates) != (pair.first, pair.candidates):
            return False
        used_left, used_right = np.zeros((2, self._shape[1]), np.bool_)
        for start, stop in self._work.aggregated:
            across = np.arange(start - DECIDING, stop + DECIDING)
            used_left[across % used_left.size] = True
            across = np.arange(start - DECIDING, stop + DECIDING + pair.candidates) + pair.first
            used_right[across % used_right.size] = True
        return all(
            seen[used].all() and np.array_equal(old[..., used], new[..., used])
            for used, seen, old, new in (
                (used_left, pair.left_seen, before.left, pair.left),
                (used_right, pair.right_seen, before.right, pair.right),
            )
        )

    def so_far(self, *, threads: int) -> Correspondence:
        """
        Return the match of the columns that are ready.

        Parameters
        ----------
        threads : int
            Threads to use.

        Returns
        -------
        Correspondence
            On the left panorama's grid, H × W; NaN in columns that are not ready. Near those it
            may change: of pixels that only one eye sees not all are found out, and smoothing
            along the rows goes as far as there are columns.
        """
        ready = self.ready
        if self._pair is None or self._left is None or self._look is None:
            nothing = np.full((2, *self._shape), np.nan, np.float32)
            return Correspondence(nothing[0], nothing[1])
        pair, work = replace(self._look.equalised(self._pair), left_seen=ready), self._work
        estimates = work.estimates.copy()
        with ThreadPoolExecutor(threads) as pool:
            rest = work.aggregated - work.evaluated
            evaluate(pair, work.winners, pool, estimates, sorted(rest))
            disparity = smoothed(pair, work.winners, estimates, pool)
        return kept(disparity, estimates.probability, clipped(self._left) | ~ready)

    def finish(self, left: Panorama, right: Panorama, *, threads: int) -> Correspondence:
        """
        Match the finished pair and forget it.

        Parameters
        ----------
        left, right : Panorama
            The pair, H × W.
        threads : int
            Threads to use.

        Returns
        -------
        Correspondence
            On the left panorama's grid, bit by bit that of
            :func:`~panodepth_ros.matching.match`.

        Raises
        ------
        ValueError
            If the panoramas are not a pair, have another size or are too small.
        """
        pair = self._checked(left, right)
        with ThreadPoolExecutor(threads) as pool:
            look = Look.of(pair, rough_match(pair, pool))
            work, sides = self._work, set(PAIR_TILING.sides(pair))
            holds = self._look is not None and look.same(self._look) and self._holds(pair)
            if not holds or not work.aggregated <= sides:
                work = Work.none(*self._shape)
            self._forget()
            self.reused = int(_columns_of(work.aggregated, self._shape[1]).sum())
            disparity, probability = complete(look.equalised(pair), look.noise, work, pool)
        return kept(disparity, probability, clipped(left))


def _decided(pair: ColourPair) -> set[Side]:
    """Tiles of a growing pair of which everything was seen that decides about them."""
    around = seen_around(pair.left_seen, -DECIDING, DECIDING)
    first, last = pair.first - DECIDING, pair.first + pair.candidates - 1 + DECIDING
    around &= seen_around(pair.right_seen, first, last)
    return {side for side in PAIR_TILING.sides(pair, decided=True) if _within(side, around)}


def _columns_of(sides: set[Side], columns: int) -> Seen:
    """Mask of the columns, shape (W,), of some tiles."""
    mask = np.zeros(columns, np.bool_)
    for start, stop in sides:
        mask[np.arange(start, stop) % columns] = True
    return mask


def _within(side: Side, mask: Seen) -> bool:
    """Whether a mask holds for all columns of a tile."""
    return bool(np.take(mask, range(*side), mode='wrap').all())
