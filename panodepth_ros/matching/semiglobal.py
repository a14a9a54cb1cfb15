"""
The default matching: semi-global, both eyes consistent, sub-column, with calibrated confidence.

docs/matching.md says what was tried and why it is this. The panoramas are aggregated tile by tile
(``aggregation``), checked for what only one eye sees, refined and given a probability
(``evaluation``). All of it may happen while the turn still grows (``progressive``).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.aggregation import PAIR_TILING, Winners, aggregate
from panodepth_ros.matching.colour_pair import ColourPair, colour_pair
from panodepth_ros.matching.evaluation import Estimates, evaluate, smoothed
from panodepth_ros.matching.exposure import clipped, level_tables
from panodepth_ros.matching.interface import Correspondence
from panodepth_ros.matching.rough import RoughMatch, rough_match
from panodepth_ros.matching.seam import Side
from panodepth_ros.matching.semiglobal_costs import grey_noise, noise_step
from panodepth_ros.matching.semiglobal_paths import LANES

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]

#: Disparities that are less probably right than this count as unmatched.
LEAST_CONFIDENCE = 0.3


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """
    What the whole of a pair decides about every pixel.

    Attributes
    ----------
    noise : float
        Of the grey levels, in steps.
    tables : ndarray of uint8, shape (3, 256), or None
        What gives the left eye the brightness of the right eye.
    """

    noise: float
    tables: Bytes | None

    @classmethod
    def of(cls, pair: ColourPair, rough: RoughMatch | None) -> Look:
        """Look at a pair as it is, all seen columns of it."""
        tables = None if rough is None else level_tables(rough.left, rough.right)
        return cls(noise_of(pair), tables)

    def same(self, other: Look) -> bool:
        """Whether both decide the same."""
        tables = [look.tables is not None and look.tables.tobytes() for look in (self, other)]
        return self.noise == other.noise and tables[0] == tables[1]

    def equalised(self, pair: ColourPair) -> ColourPair:
        """Give the left eye the brightness of the right eye."""
        if self.tables is None:
            return pair
        channels = zip(self.tables, pair.left, strict=True)
        return replace(pair, left=np.stack([cv2.LUT(c, table) for table, c in channels]))


def noise_of(pair: ColourPair) -> float:
    """Noise of the grey levels of a pair, in steps."""
    return noise_step(grey_noise(pair.left_grey, pair.left_seen))


@dataclass(frozen=True, eq=False, slots=True)
class Work:
    """
    What is done of a pair's match.

    Attributes
    ----------
    winners : Winners
    estimates : Estimates
    aggregated, evaluated : set of Side
        The tiles' columns of which winners and estimates are final.
    """

    winners: Winners
    estimates: Estimates
    aggregated: set[Side]
    evaluated: set[Side]

    @classmethod
    def none(cls, rows: int, columns: int) -> Work:
        """Nothing done yet."""
        return cls(Winners.none(rows, columns), Estimates.none(rows, columns), set(), set())


def match_semiglobal(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match a pair; ``further`` is not used here, but by :func:`fusion.match_sweep`.

    Parameters and returns as in :func:`panodepth_ros.matching.match`. The confidence is the
    probability that the disparity is right within one column.
    """
    pair = colour_pair(left, right)
    with ThreadPoolExecutor(threads) as pool:
        look = Look.of(pair, rough_match(pair, pool))
        work = Work.none(*pair.left_grey.shape)
        disparity, probability = complete(look.equalised(pair), look.noise, work, pool)
    return kept(disparity, probability, clipped(left))


def complete(
    pair: ColourPair, noise: float, work: Work, pool: ThreadPoolExecutor
) -> tuple[Float32Array, Float32Array]:
    """Do what is not done of a pair's match; disparities and probabilities, shape (H, W)."""
    sides = PAIR_TILING.sides(pair)
    rest = [side for side in sides if side not in work.aggregated]
    aggregate(pair, noise, pool, work.winners, rest)
    rest = [side for side in sides if side not in work.evaluated]
    evaluate(pair, work.winners, pool, work.estimates, rest)
    return smoothed(pair, work.winners, work.estimates, pool), work.estimates.probability


def kept(
    disparity: Float32Array, probability: Float32Array, unknown: npt.NDArray[np.bool_]
) -> Correspondence:
    """What is probable enough and not ``unknown``; changes what it is given."""
    unmatched = (probability < LEAST_CONFIDENCE) | unknown
    disparity[unmatched] = np.nan
    probability[unmatched] = np.nan
    return Correspondence(disparity, probability)


def prepare() -> None:
    """Compile the kernels."""
    size = 2 * LANES
    image = np.random.default_rng(0).integers(0, 256, (LANES, size)).astype(np.uint8)
    colours, seen = np.stack([image] * 3), np.ones(size, np.bool_)
    pair = ColourPair(
        left=colours,
        right=colours,
        left_grey=image,
        right_grey=image,
        left_seen=seen,
        right_seen=seen,
        first=0,
        candidates=LANES,
        keys=np.arange(size),
    )
    with ThreadPoolExecutor(1) as pool:
        complete(pair, 1.0, Work.none(LANES, size), pool)
