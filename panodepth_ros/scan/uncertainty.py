"""How uncertain a beam is: disparity, focal length and arm radius, to first order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PanoramaGeometry, check_pair

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """
    Standard deviations of what a range is computed from.

    Attributes
    ----------
    certain_disparity, doubtful_disparity : float
        Of a beam's column disparity at a confidence of 1 and of 0 [columns]; what is between is
        interpolated. Every beam has an error of its own, though neighbours resemble each other.
    focal_length : float
        Of fx, as a share of fx; the same error for all beams.
    arm_radius : float
        Of r [m]; the same error for all beams.

    Raises
    ------
    ValueError
        If one is negative or not finite.
    """

    certain_disparity: float
    doubtful_disparity: float
    focal_length: float
    arm_radius: float

    def __post_init__(self) -> None:
        for name in ('certain_disparity', 'doubtful_disparity', 'focal_length', 'arm_radius'):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise ValueError(f'{name} is {value}; allowed: finite, at least 0')

    def of_disparity(self, confidence: npt.NDArray[np.floating]) -> Array:
        """Standard deviation of column disparities of a confidence, any shape [columns]."""
        certain, doubtful = self.certain_disparity, self.doubtful_disparity
        return np.asarray(doubtful + confidence * (certain - doubtful), np.float64)


def range_stddev(
    ranges: npt.NDArray[np.floating],
    confidence: Array,
    left: PanoramaGeometry,
    right: PanoramaGeometry,
    uncertainty: Uncertainty,
) -> Array:
    """
    Standard deviation of each range of a scan.

    Parameters
    ----------
    ranges : ndarray of float, shape (N,)
        Counter-clockwise from −π [m].
    confidence : ndarray of float64, shape (N,)
        Of each range, 0 … 1.
    left, right : PanoramaGeometry
        The pair that the scan was made from.
    uncertainty : Uncertainty

    Returns
    -------
    ndarray of float64, shape (N,)
        [m]; NaN where the range is not finite.

    Raises
    ------
    ValueError
        If the panoramas are not a pair.

    Notes
    -----
    Rays that touch the circles a = r·sin(−ψ_L) and b = r·sin ψ_R meet at the l that solves
    asin(a/l) + asin(b/l) = Δ, the angle between them. Its derivatives follow with
    G = a/(l·√(l² − a²)) + b/(l·√(l² − b²)): ∂l/∂Δ = −1/G, which is −l²/(2·r0) far away,
    ∂l/∂a = 1/(G·√(l² − a²)), the same for b, and ∂l/∂r = l/r. A share ε of fx turns a ray by
    −sin ψ·cos ψ·ε.
    """
    check_pair(left, right)
    distance: Array = np.array(ranges, np.float64)
    distance[~(np.isfinite(distance) & (distance > left.arm_radius))] = np.nan
    azimuth = -np.pi + np.arange(distance.size) * (2 * np.pi / distance.size)
    psi_left, psi_right = (_ray_angle(eye, azimuth, distance) for eye in (left, right))
    r = left.arm_radius
    a, b = r * np.sin(-psi_left), r * np.sin(psi_right)
    from_left, from_right = np.sqrt(distance**2 - a**2), np.sqrt(distance**2 - b**2)
    slope = a / (distance * from_left) + b / (distance * from_right)

    turn_left, turn_right = (-np.sin(psi) * np.cos(psi) for psi in (psi_left, psi_right))
    by_angle = -(turn_right - turn_left) / slope
    by_left = -r * np.cos(psi_left) * turn_left / (slope * from_left)
    by_right = r * np.cos(psi_right) * turn_right / (slope * from_right)
    variance = (
        (uncertainty.of_disparity(confidence) * left.column_step / slope) ** 2
        + (uncertainty.focal_length * (by_angle + by_left + by_right)) ** 2
        + (uncertainty.arm_radius * distance / r) ** 2
    )
    return np.asarray(np.sqrt(variance))


def _ray_angle(eye: PanoramaGeometry, azimuth: npt.NDArray[np.floating], distance: Array) -> Array:
    """ψ of the column that shows what lies at an azimuth and a distance from the axis."""
    towards = azimuth + np.arcsin(eye.arm_radius * np.sin(eye.principal_angle) / distance)
    column = np.rint(np.nan_to_num(eye.azimuth_column - towards / eye.column_step))
    angle = eye.ray_angle[column.astype(np.int64) % eye.columns]
    # The pixels of a beam lie beside an unseen column, if not in it.
    return np.where(np.isfinite(angle), angle, eye.principal_angle)


def scan_with_stddev(
    ranges: npt.NDArray[np.float32],
    confidence: Array,
    pair: tuple[PanoramaGeometry, PanoramaGeometry],
    uncertainty: Uncertainty,
    *,
    range_max: float,
    allowed: float = 0.0,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """
    Ranges without those that are too uncertain, and the standard deviations of the others.

    Parameters
    ----------
    ranges : ndarray of float32, shape (N,)
        Counter-clockwise from −π [m]; +inf stands for "farther than range_max".
    confidence : ndarray of float64, shape (N,)
        Of each range, 0 … 1; that of a +inf is taken for 1.
    pair : (PanoramaGeometry, PanoramaGeometry)
        Left and right panorama that the scan was made from.
    uncertainty : Uncertainty
    range_max : float
        What a +inf counts as [m].
    allowed : float
        Largest standard deviation of a range [m]; 0 allows any.

    Returns
    -------
    ranges, stddev : ndarray of float32, shape (N,)
        NaN where the standard deviation is larger than allowed; stddev is NaN wherever the range
        is not finite.
    """
    seen = np.where(np.isposinf(ranges), np.float32(range_max), ranges)
    confidence = np.where(np.isposinf(ranges), 1.0, confidence)
    stddev = range_stddev(seen, confidence, *pair, uncertainty)
    if allowed > 0:
        with np.errstate(invalid='ignore'):
            ranges = np.where(stddev > allowed, np.float32(np.nan), ranges)
    stddev = np.where(np.isfinite(ranges), stddev, np.nan)
    return ranges, stddev.astype(np.float32)
