"""
OpenCV's matchers on panoramas, for comparison and for those who want them.

OpenCV looks for x on the left at x − d on the right; mirrored panoramas fit that with d = dx.
Columns are repeated beyond both ends so that the seam is as good as any other place: ``bm`` is
local and exactly circular, the paths of ``sgbm`` start outside the panorama and have forgotten
where after ``SEAM_COLUMNS``. OpenCV has no confidence; ours is the correlation of the match in
the window of :mod:`panodepth_ros.matching.correlation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.correlation import match_correlation, pad
from panodepth_ros.matching.interface import Correspondence, GreyPair, grey_pair

#: Columns repeated beyond the ends in addition to the search range.
SEAM_COLUMNS = 64
#: Block of the semi-global matcher, and of the block matcher [pixels].
SGBM_BLOCK = 5
BM_BLOCK = 9
#: Largest difference between the disparities found from left to right and back [columns].
BACK_TOLERANCE = 1
#: By how much the best must be better than any other but its neighbours [%].
UNIQUENESS = 10
#: OpenCV's disparities are integers in this fraction of a column.
FRACTION = 16


def match_sgbm(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match by cv2.StereoSGBM; it has one thread, ``further`` is not used.

    Parameters and returns as in :func:`panodepth_ros.matching.match`.
    """
    pair = grey_pair(left, right)
    matcher = cv2.StereoSGBM.create(
        minDisparity=1,
        numDisparities=whole_sixteens(pair),
        blockSize=SGBM_BLOCK,
        P1=8 * SGBM_BLOCK**2,
        P2=32 * SGBM_BLOCK**2,
        disp12MaxDiff=BACK_TOLERANCE,
        uniquenessRatio=UNIQUENESS,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    return match_by(pair, matcher)


def match_bm(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match by cv2.StereoBM; it takes OpenCV's own threads, ``further`` is not used.

    Parameters and returns as in :func:`panodepth_ros.matching.match`.
    """
    pair = grey_pair(left, right)
    matcher = cv2.StereoBM.create(whole_sixteens(pair), BM_BLOCK)
    matcher.setMinDisparity(1)
    matcher.setDisp12MaxDiff(BACK_TOLERANCE)
    matcher.setUniquenessRatio(UNIQUENESS)
    return match_by(pair, matcher)


def prepare() -> None:
    """Compile the kernels of the confidence."""
    grey = np.zeros((BM_BLOCK, 4 * BM_BLOCK), np.uint8)
    seen = np.ones(4 * BM_BLOCK, np.bool_)
    pair = GreyPair(grey, grey, seen, seen, first=1, last=1)
    match_correlation(pad(pair), np.zeros(grey.shape, np.int32))


def whole_sixteens(pair: GreyPair) -> int:
    """Return the number of candidates, rounded up to what OpenCV can search."""
    return -(-(pair.last - pair.first + 1) // 16) * 16


def match_by(pair: GreyPair, matcher: Any) -> Correspondence:
    """
    Match by one of OpenCV's matchers.

    Parameters
    ----------
    pair : GreyPair
        H × W.
    matcher : cv2.StereoMatcher
        Its smallest disparity is 1 and it searches as many as :func:`whole_sixteens` says.

    Returns
    -------
    Correspondence
    """
    columns = pair.left.shape[1]
    margin = whole_sixteens(pair) + SEAM_COLUMNS
    mirrored = np.arange(columns - 1 + margin, -1 - margin, -1)
    found = matcher.compute(
        _at_columns(pair.left, pair.left_seen, mirrored),
        _at_columns(pair.right, pair.right_seen, mirrored + pair.first - 1),
    )
    disparity = found[:, margin : margin + columns][:, ::-1].astype(np.float32) / FRACTION
    numbers = np.rint(disparity).astype(np.int32) - 1
    unmatched = (numbers < 0) | (numbers > pair.last - pair.first)
    confidence = match_correlation(pad(pair), np.where(unmatched, -1, numbers))
    unmatched |= np.isnan(confidence)
    disparity += np.float32(pair.first - 1)
    disparity[unmatched] = np.nan
    confidence[unmatched] = np.nan
    return Correspondence(disparity, np.clip(confidence, 0, 1))


def _at_columns(
    grey: npt.NDArray[np.uint8], seen: npt.NDArray[np.bool_], columns: npt.NDArray[np.int64]
) -> npt.NDArray[np.uint8]:
    """Columns of a panorama, wrapped; an unseen one shows its nearest seen neighbour."""
    width = grey.shape[1]
    where = np.flatnonzero(seen)
    if not where.size:
        return np.ascontiguousarray(grey[:, columns % width])
    around = np.concatenate([where - width, where, where + width])
    after = np.searchsorted(around, columns % width)
    after_distance = np.abs(around[after] - columns % width)
    before_distance = np.abs(around[after - 1] - columns % width)
    nearest = around[np.where(before_distance < after_distance, after - 1, after)] % width
    return np.ascontiguousarray(grey[:, nearest])
