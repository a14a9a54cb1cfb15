"""Triangulation of a left and a right panorama: column disparity to azimuth and distance."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry.equations import search_range
from panodepth_ros.geometry.panorama import PanoramaGeometry

#: Pixels whose distances differ by no more than this share belong to one surface.
SURFACE_DEPTH = 0.04
#: Rows computed at a time, so that what is between stays in the processor's cache.
_ROWS_AT_ONCE = 16


@dataclass(frozen=True, eq=False, slots=True)
class Points:
    """
    Points on the left panorama's pixel grid, in the scan frame.

    Attributes
    ----------
    radial_distance : ndarray of float64, shape (H, W)
        Horizontal distance l from the axis [m]; NaN where unknown.
    azimuth : ndarray of float64, shape (H, W)
        Azimuth α seen from the axis [rad], in [−π, π); NaN where unknown.
    height : ndarray of float64, shape (H, W)
        Height z above the optical centre [m]; NaN where unknown.
    """

    radial_distance: npt.NDArray[np.float64]
    azimuth: npt.NDArray[np.float64]
    height: npt.NDArray[np.float64]

    def xyz(self) -> npt.NDArray[np.float64]:
        """Return x (forward), y (left) and z (up) of every point [m], shape (H, W, 3)."""
        x = self.radial_distance * np.cos(self.azimuth)
        y = self.radial_distance * np.sin(self.azimuth)
        return np.stack([x, y, self.height], axis=-1)


def check_pair(left: PanoramaGeometry, right: PanoramaGeometry) -> None:
    """
    Refuse two panoramas that are not a left and a right eye of one sweep.

    Raises
    ------
    ValueError
        Names the property that differs or is wrong.
    """
    for name in ('columns', 'rows', 'arm_radius', 'focal_length_px', 'principal_row'):
        ours, theirs = getattr(left, name), getattr(right, name)
        if not np.isclose(ours, theirs, rtol=1e-9, atol=0):
            raise ValueError(f'{name} is {ours} on the left and {theirs} on the right panorama')
    if not np.isclose(left.principal_angle, -right.principal_angle) or right.principal_angle <= 0:
        raise ValueError(
            f'principal_angle is {left.principal_angle} on the left and {right.principal_angle} '
            'on the right panorama; allowed: −φ and +φ of a symmetric pair'
        )


def pair_search_range(left: PanoramaGeometry, right: PanoramaGeometry) -> int:
    """Return n: a point at column x on the left lies at x+1 … x+n on the right (sec. 6.2)."""
    check_pair(left, right)
    return search_range(right.principal_angle, right.column_step)


def triangulate(
    column_disparity: npt.NDArray[np.floating],
    left: PanoramaGeometry,
    right: PanoramaGeometry,
    *,
    threads: int = 1,
) -> Points:
    """
    Points from column disparities.

    Parameters
    ----------
    column_disparity : ndarray of float, shape (H, W)
        dx on the left panorama's grid, right column minus left column [columns], NaN unmatched.
    left, right : PanoramaGeometry
        The pair.
    threads : int
        Threads to use; the result does not depend on it.

    Returns
    -------
    Points
        NaN where unmatched, where a ray is unseen and where the rays do not meet ahead.

    Raises
    ------
    ValueError
        If the panoramas are not a pair or the disparity has another size.

    Notes
    -----
    A left ray touches the circle a = r·sin(−ψ_L), a right ray the circle b = r·sin ψ_R. With
    Δ = β_R − β_L they meet at l = √(a² + b² + 2ab·cos Δ) / sin Δ; for a = b this is eq. 2,
    l = r0 / sin(δ/2). Azimuth and height follow from the left ray, see :func:`locate`; for
    a = b the azimuth is (β_L + β_R)/2.
    """
    check_pair(left, right)
    if column_disparity.shape != (left.rows, left.columns):
        raise ValueError(
            f'column_disparity has shape {column_disparity.shape}; '
            f'allowed: {(left.rows, left.columns)}'
        )
    x_left = np.arange(left.columns, dtype=np.float64)
    a = left.arm_radius * np.sin(-left.ray_angle)
    beta_left = left.ray_azimuth(x_left)

    def distances(rows: slice) -> npt.NDArray[np.float64]:
        x_right = x_left + column_disparity[rows]
        ray_angle_right = right.ray_angle_at(x_right)
        b = right.arm_radius * np.sin(ray_angle_right)
        delta = right.ray_azimuth(x_right, ray_angle_right) - beta_left
        delta -= 2 * np.pi * np.rint(delta / (2 * np.pi))
        sine = np.sin(delta)
        with np.errstate(divide='ignore', invalid='ignore'):
            distance = np.sqrt(a**2 + b**2 + 2 * a * b * np.cos(delta)) / sine
            return np.where(sine > 0, distance, np.nan)

    return _located(distances, left, threads)


def locate(radial_distance: npt.NDArray[np.floating], panorama: PanoramaGeometry) -> Points:
    """
    Points from the distances of a panorama's pixels.

    Parameters
    ----------
    radial_distance : ndarray of float, shape (H, W)
        Horizontal distance from the axis [m]; NaN where unknown.
    panorama : PanoramaGeometry
        Whose pixels they are.

    Returns
    -------
    Points
        NaN where unknown, where a ray is unseen and within the arm's circle.

    Raises
    ------
    ValueError
        If the distances have another size than the panorama.

    Notes
    -----
    A ray touches the circle of signed radius c = r·sin ψ and meets a distance l at the azimuth
    α = β − asin(c/l), d = √(l² − c²) − r·cos ψ from the optical centre. Height: z = d·slope.
    """
    if radial_distance.shape != (panorama.rows, panorama.columns):
        raise ValueError(
            f'radial_distance has shape {radial_distance.shape}; '
            f'allowed: {(panorama.rows, panorama.columns)}, as the panorama'
        )
    return _located(lambda rows: radial_distance[rows], panorama)


def _located(
    distances: Callable[[slice], npt.NDArray[np.floating]],
    panorama: PanoramaGeometry,
    threads: int = 1,
) -> Points:
    """Points from a function that gives the distances of some rows; :func:`locate` has more."""
    beta = panorama.ray_azimuth(np.arange(panorama.columns))
    beta = (beta + np.pi) % (2 * np.pi) - np.pi
    c = panorama.arm_radius * np.sin(panorama.ray_angle)
    lens = panorama.arm_radius * np.cos(panorama.ray_angle)
    slope = panorama.slope(np.arange(panorama.rows))[:, np.newaxis]
    distance, azimuth, height = np.empty((3, panorama.rows, panorama.columns))

    def locate_rows(start: int) -> None:
        rows = slice(start, start + _ROWS_AT_ONCE)
        found = distances(rows)
        with np.errstate(invalid='ignore'):
            ahead = (found > panorama.arm_radius) & panorama.seen
            l = distance[rows] = np.where(ahead, found, np.nan)  # noqa: E741 - the paper's letter
            height[rows] = (np.sqrt(l**2 - c**2) - lens) * slope[rows]
            alpha = beta - np.arcsin(c / l)
            # β is within a turn, asin within a quarter.
            alpha = np.where(alpha < -np.pi, alpha + 2 * np.pi, alpha)
            azimuth[rows] = np.where(alpha >= np.pi, alpha - 2 * np.pi, alpha)

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(locate_rows, range(0, panorama.rows, _ROWS_AT_ONCE)):
            pass
    return Points(radial_distance=distance, azimuth=azimuth, height=height)


def distance_stddev(
    radial_distance: npt.NDArray[np.floating],
    left: PanoramaGeometry,
    disparity_stddev: float | npt.NDArray[np.floating],
) -> npt.NDArray[np.float64]:
    """
    Standard deviation of distances, to first order in the noise of the disparity.

    Parameters
    ----------
    radial_distance : ndarray of float, shape (H, W)
        l [m] on the left panorama's grid; NaN where unknown.
    left : PanoramaGeometry
        Left panorama of a symmetric pair.
    disparity_stddev : float or ndarray of float, shape (H, W)
        Standard deviation of the column disparity [columns].

    Returns
    -------
    ndarray of float64, shape (H, W)
        [m]; NaN where unknown.

    Notes
    -----
    l = r0/sin(δ/2) (eq. 2), so |dl/dδ| = l·√(l² − r0²)/(2·r0), and δ changes by θ0 a column.
    """
    r0 = left.arm_radius * np.sin(-left.ray_angle)
    l = radial_distance.astype(np.float64)  # noqa: E741 - the paper's letter
    with np.errstate(invalid='ignore'):
        slope = l * np.sqrt(l**2 - r0**2) / (2 * r0)
    return np.asarray(slope * left.column_step * disparity_stddev)
