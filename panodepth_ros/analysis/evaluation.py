"""A depth panorama and a scan against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: A beam is right within this share of the distance, and dangerous or a phantom beyond that.
RIGHT, WRONG = 0.05, 0.10


@dataclass(frozen=True, slots=True)
class ScanScore:
    """
    How a scan compares with the nearest visible surface.

    Attributes
    ----------
    coverage : float
        Share of the beams with a known truth that hold a finite range.
    median_error, p90_error : float
        Median and 90th percentile of the relative error of those beams.
    within_5_percent : float
        Share of those beams within 5 % of the truth.
    too_far : float
        Share more than 10 % too far: a robot would hit something.
    too_near : float
        Share more than 10 % too near: a phantom.
    """

    coverage: float
    median_error: float
    p90_error: float
    within_5_percent: float
    too_far: float
    too_near: float


def nearest_in_beams(distance: Array, azimuth: Array, beams: int) -> Array:
    """
    Nearest distance in each beam.

    Parameters
    ----------
    distance, azimuth : ndarray of float64, same shape
        Points seen from the axis [m], [rad]; points that are not finite are left out.
    beams : int
        Beams of a turn; beam k points at −π + k·2π/beams.

    Returns
    -------
    ndarray of float64, shape (beams,)
        NaN where no point fell.
    """
    use = np.isfinite(distance) & np.isfinite(azimuth)
    beam = np.rint((azimuth[use] + np.pi) / (2 * np.pi) * beams).astype(np.int64) % beams
    nearest = np.full(beams, np.inf)
    np.minimum.at(nearest, beam, distance[use])
    return np.where(np.isfinite(nearest), nearest, np.nan)


def score_scan(ranges: Array, truth: Array, *, neighbours: int = 1) -> ScanScore:
    """
    Score a scan.

    Parameters
    ----------
    ranges, truth : ndarray of float64, shape (N,)
        Ranges of the scan and of the nearest visible surface, beam by beam [m]. Whatever is not
        finite is unknown.
    neighbours : int
        The truth may be taken from this many beams to either side, whichever agrees best: at a
        depth edge the beam's width decides what is nearest.

    Returns
    -------
    ScanScore

    Raises
    ------
    ValueError
        If the sizes differ or no beam can be compared.
    """
    if ranges.shape != truth.shape:
        raise ValueError(f'scan has {ranges.size} beams, truth has {truth.size}')
    have = np.isfinite(ranges) & np.isfinite(truth)
    if not have.any():
        raise ValueError('no beam has both a finite range and a known truth')
    candidates = np.stack([np.roll(truth, k) for k in range(-neighbours, neighbours + 1)])
    with np.errstate(invalid='ignore'):
        errors = (ranges - candidates) / candidates
    size = np.where(np.isfinite(errors), np.abs(errors), np.inf)
    best = np.argmin(size, axis=0)
    error = np.take_along_axis(errors, best[np.newaxis], axis=0)[0][have]
    return ScanScore(
        coverage=float(have.sum() / np.isfinite(truth).sum()),
        median_error=float(np.median(np.abs(error))),
        p90_error=float(np.percentile(np.abs(error), 90)),
        within_5_percent=float(np.mean(np.abs(error) <= RIGHT)),
        too_far=float(np.mean(error > WRONG)),
        too_near=float(np.mean(error < -WRONG)),
    )


@dataclass(frozen=True, slots=True)
class DepthScore:
    """
    How a depth panorama compares with the truth.

    Attributes
    ----------
    kept : float
        Share of the pixels visible to both eyes that hold a distance.
    wrong : float
        Share of the pixels that hold a distance, occluded ones included, whose column disparity
        is off by more than one column.
    median_error : float
        Median relative error of the distance of the pixels that hold one.
    columns_off : float
        How far off the column disparity of two thirds of those pixels is at most [columns]; the
        standard deviation if errors were normal.
    """

    kept: float
    wrong: float
    median_error: float
    columns_off: float


def score_depth(
    distance: Array,
    truth: Array,
    occluded: npt.NDArray[np.bool_],
    *,
    viewing_circle_radius: float,
    column_step: float,
) -> DepthScore:
    """
    Score a depth panorama.

    Parameters
    ----------
    distance, truth : ndarray of float64, shape (H, W)
        Radial distance measured and true [m]; NaN where unknown.
    occluded : ndarray of bool, shape (H, W)
        Pixels that the other eye does not see.
    viewing_circle_radius : float
        r0 = r·sin φ [m].
    column_step : float
        θ0 [rad].

    Returns
    -------
    DepthScore

    Notes
    -----
    A distance stands for the column disparity dx = (2φ − δ)/θ0 with δ = 2·asin(r0/l) (eq. 2).
    """
    known = np.isfinite(truth)
    have = np.isfinite(distance) & known
    visible = known & ~occluded
    measured, true = distance[have], truth[have]
    delta = 2 * np.arcsin(viewing_circle_radius / np.stack([measured, true]))
    columns_off = np.abs(delta[0] - delta[1]) / column_step
    return DepthScore(
        kept=float((have & visible).sum() / visible.sum()),
        wrong=float(np.mean(columns_off > 1)),
        median_error=float(np.median(np.abs(measured / true - 1))),
        columns_off=float(np.percentile(columns_off, 68.3)),
    )


def nearest_visible(
    distance: Array,
    ray_azimuth: Array,
    height: Array,
    visible: npt.NDArray[np.bool_],
    *,
    signed_radius: float | Array,
    band: tuple[float, float],
    beams: int,
) -> Array:
    """
    True ranges of a scan: the nearest surface that a panorama can show in a height band.

    Parameters
    ----------
    distance, height : ndarray of float64, shape (H, W)
        True radial distance and height of what each pixel looks at [m].
    ray_azimuth : ndarray of float64, shape (W,)
        Where each column looks [rad].
    visible : ndarray of bool, shape (H, W)
        Pixels whose point the other eye sees, too.
    signed_radius : float or ndarray of float64, shape (W,)
        r·sin ψ of the panorama's rays [m], negative for the left eye.
    band : (float, float)
        Lowest and highest height [m].
    beams : int
        Beams of the scan.

    Returns
    -------
    ndarray of float64, shape (beams,)
        NaN where nothing is visible in the band.
    """
    azimuth = ray_azimuth[np.newaxis, :] - np.arcsin(signed_radius / distance)
    azimuth = (azimuth + np.pi) % (2 * np.pi) - np.pi
    use = visible & (height >= band[0]) & (height <= band[1])
    return nearest_in_beams(distance[use], azimuth[use], beams)
