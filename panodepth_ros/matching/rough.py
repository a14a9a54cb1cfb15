"""A rough match of small panoramas: which points both eyes see, to compare their brightness by."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.matching.aggregation import Tiling, Winners, aggregate
from panodepth_ros.matching.colour_pair import ColourPair
from panodepth_ros.matching.seam import column_keys, texture_keys
from panodepth_ros.matching.semiglobal_costs import CENSUS_COLUMNS, CENSUS_ROWS

Bytes = npt.NDArray[np.uint8]

#: Size of the panoramas in which exposure is compared, as a fraction.
ROUGH_SCALE = 4
#: Its memory stays beside that of the real match.
ROUGH_TILING = Tiling(reach=64, widest=192, size=9_000_000 // ROUGH_SCALE)


@dataclass(frozen=True, eq=False, slots=True)
class RoughMatch:
    """
    Points that both eyes see, in panoramas of a ``ROUGH_SCALE``-th of the size.

    Attributes
    ----------
    y, x : ndarray of int, shape (M,)
        Their pixels in the left panorama; columns count from the pair's seam.
    disparity : ndarray of int, shape (M,)
        Their column disparity there.
    left, right : ndarray of uint8, shape (3, M)
        Their colours in both eyes.
    """

    y: npt.NDArray[np.intp]
    x: npt.NDArray[np.intp]
    disparity: npt.NDArray[np.intp]
    left: Bytes
    right: Bytes


def small(image: Bytes, seam: int) -> Bytes:
    """An image from its column ``seam`` on at a ``ROUGH_SCALE``-th of its size."""
    size = image.shape[1] // ROUGH_SCALE, image.shape[0] // ROUGH_SCALE
    rolled = np.roll(image, -seam, axis=1)
    return np.asarray(cv2.resize(rolled, size, interpolation=cv2.INTER_AREA), np.uint8)


def small_seen(seen: npt.NDArray[np.bool_], seam: int) -> npt.NDArray[np.bool_]:
    """Columns of a small panorama of which all was seen."""
    if seen.all():
        return np.ones(seen.size // ROUGH_SCALE, np.bool_)
    shares = small(np.tile(255 * seen.astype(np.uint8), (ROUGH_SCALE, 1)), seam)
    return np.asarray(shares[0] == 255)


def rough_match(pair: ColourPair, pool: ThreadPoolExecutor) -> RoughMatch | None:
    """Match the census of a small pair; None if it would be too small."""
    rows, columns = pair.left_grey.shape
    candidates = pair.candidates // ROUGH_SCALE
    narrow = columns // ROUGH_SCALE < candidates + 2 * CENSUS_COLUMNS
    if candidates < 2 or rows // ROUGH_SCALE < 2 * CENSUS_ROWS or narrow:
        return None

    seam = pair.seam
    greys = small(pair.left_grey, seam), small(pair.right_grey, seam)
    left_seen = small_seen(pair.left_seen, seam)
    rough = ColourPair(
        left=np.stack([small(channel, seam) for channel in pair.left]),
        right=np.stack([small(channel, seam) for channel in pair.right]),
        left_grey=greys[0],
        right_grey=greys[1],
        left_seen=left_seen,
        right_seen=small_seen(pair.right_seen, seam),
        first=round(pair.first / ROUGH_SCALE),
        candidates=candidates,
        keys=texture_keys(greys[0], left_seen, column_keys(*greys)),
    )
    winners = Winners.none(*greys[0].shape)
    aggregate(rough, 1.0, pool, winners, ROUGH_TILING.sides(rough), colour=False)
    partners = rough.partners(winners.best)
    agreed = winners.eyes(rough.first, 0, columns // ROUGH_SCALE) == 0
    agreed &= rough.left_seen & rough.right_seen[partners]
    y, x = np.nonzero(agreed)
    return RoughMatch(
        y=y,
        x=x,
        disparity=winners.best[y, x] + np.intp(rough.first),
        left=rough.left[:, y, x],
        right=rough.right[:, y, partners[y, x]],
    )
