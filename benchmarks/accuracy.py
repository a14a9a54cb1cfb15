"""Right and wrong: one row of figures, and curves over the confidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.scenes import Scene
from panodepth_ros.analysis.evaluation import ScanScore, nearest_visible, score_scan
from panodepth_ros.geometry import triangulate
from panodepth_ros.matching import Correspondence
from panodepth_ros.scan.beams import ScanSettings, laser_ranges

Array = npt.NDArray[np.float64]

#: Confidence steps of the reliability curve.
RELIABILITY_BINS = 10


@dataclass(frozen=True, eq=False, slots=True)
class Accuracy:
    """
    What a correspondence is worth.

    Attributes
    ----------
    kept : float
        Share of the pixels visible to both eyes that are matched.
    wrong : float
        Share of the matched pixels, occluded ones included, more than one column off.
    right_visible : float
        Share of the visible pixels that are matched within one column.
    median_distance_error : float
        Median relative error of the distance of the matched pixels.
    kept_curve, wrong_curve : ndarray of float64, shape (M,)
        ``kept`` and ``wrong`` of the most confident 1 … M pixels.
    reliability : ndarray of float64, shape (3, RELIABILITY_BINS)
        Per step of confidence: mean confidence, share within one column, share of the matches.
    """

    kept: float
    wrong: float
    right_visible: float
    median_distance_error: float
    kept_curve: Array
    wrong_curve: Array
    reliability: Array

    def wrong_at(self, kept: float) -> float:
        """``wrong`` of the most confident pixels that make up that ``kept``; NaN beyond all."""
        position = int(np.searchsorted(self.kept_curve, kept))
        return float(self.wrong_curve[position]) if position < self.kept_curve.size else np.nan


def measure(result: Correspondence, scene: Scene) -> Accuracy:
    """Compare a correspondence with the truth of its scene."""
    known = np.isfinite(scene.disparity)
    matched = np.isfinite(result.column_disparity) & known
    visible = scene.views[0].visible & known
    off = np.abs(result.column_disparity - scene.disparity) > 1
    distance = triangulate(
        result.column_disparity, scene.left.geometry, scene.right.geometry
    ).radial_distance
    error = np.abs(distance / scene.views[0].distance - 1)[matched]
    order = np.argsort(-result.confidence[matched], kind='stable')
    ranked_off, ranked_visible = off[matched][order], visible[matched][order]
    count = np.arange(1, order.size + 1)
    return Accuracy(
        kept=float((matched & visible).sum() / visible.sum()),
        wrong=float(off[matched].mean()),
        right_visible=float((matched & visible & ~off).sum() / visible.sum()),
        median_distance_error=float(np.nanmedian(error)),
        kept_curve=np.cumsum(ranked_visible) / visible.sum(),
        wrong_curve=np.cumsum(ranked_off) / count,
        reliability=_reliability(result.confidence[matched], ~off[matched]),
    )


def _reliability(confidence: npt.NDArray[np.float32], right: npt.NDArray[np.bool_]) -> Array:
    step = np.minimum((confidence * RELIABILITY_BINS).astype(np.int64), RELIABILITY_BINS - 1)
    count = np.bincount(step, minlength=RELIABILITY_BINS)
    with np.errstate(invalid='ignore'):
        return np.stack(
            [
                np.bincount(step, confidence, RELIABILITY_BINS) / count,
                np.bincount(step, right, RELIABILITY_BINS) / count,
                count / confidence.size,
            ]
        )


def scan_score(
    result: Correspondence, scene: Scene, settings: ScanSettings | None = None
) -> ScanScore:
    """
    Score the scan made of a correspondence; by default 720 beams, ±0.15 m.

    The truth of a beam is the nearest surface in the band that either eye shows and both see.
    """
    settings = ScanSettings() if settings is None else settings
    points = triangulate(result.column_disparity, scene.left.geometry, scene.right.geometry)
    truths = [
        nearest_visible(
            view.distance,
            view.geometry.ray_azimuth(np.arange(view.geometry.columns)),
            view.height,
            view.visible,
            signed_radius=view.geometry.arm_radius * np.sin(view.geometry.principal_angle),
            band=(settings.min_height, settings.max_height),
            beams=settings.beams,
        )
        for view in scene.views
    ]
    truth = np.fmin.reduce(truths)
    ranges = laser_ranges(points, result.confidence, settings).astype(np.float64)
    return score_scan(ranges, truth)
