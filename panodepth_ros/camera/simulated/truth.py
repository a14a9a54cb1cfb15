"""
The truth about a panorama of a simulated room: what depth and scan are measured against.

Conventions are those of docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.room import Room

Array = npt.NDArray[np.float64]

#: A point counts as seen if its ray ends less than this before it [m].
_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class TruthPanorama:
    """
    What every pixel of one panorama looks at.

    Attributes
    ----------
    radial_distance : ndarray of float64, shape (H, N)
        Horizontal distance of the point from the axis [m]; +inf where there is nothing.
    height : ndarray of float64, shape (H, N)
        z of the point [m]; NaN where there is nothing.
    occluded : ndarray of bool, shape (H, N)
        Whether the other eye's ray to the point is blocked. True where there is nothing.
    """

    radial_distance: Array
    height: Array
    occluded: npt.NDArray[np.bool_]


def truth_panorama(
    room: Room,
    *,
    arm_radius: float,
    ray_angle: npt.ArrayLike,
    ray_azimuth: npt.ArrayLike,
    slope: npt.ArrayLike,
) -> TruthPanorama:
    """
    Cast the ray of every pixel of a panorama, and the other eye's ray to the same point.

    Parameters
    ----------
    room : Room
        What there is.
    arm_radius : float
        Axis to optical centre [m].
    ray_angle : array_like of float, shape () or (N,)
        Arm to the ray of the columns [rad]: negative for the left eye, positive for the right.
        The other eye's is the same with the other sign.
    ray_azimuth : array_like of float, shape (N,)
        Where each column looks [rad].
    slope : array_like of float, shape (H,)
        Rise over horizontal distance from the optical centre of each row, (cy − v)/F.

    Returns
    -------
    TruthPanorama
        In the order of rows and columns given.

    Notes
    -----
    A ray of azimuth β passes the axis at r·sin ψ, so a point at distance l and azimuth α is seen
    where sin(β − α) = r·sin ψ / l, from an arm at β − ψ. Both eyes see it at the same row, since
    their optical centres are equally far from it.
    """
    beta = np.asarray(ray_azimuth, np.float64)
    psi = np.broadcast_to(np.asarray(ray_angle, np.float64), beta.shape)
    rise = np.asarray(slope, np.float64)
    shape = (len(rise), len(beta), 3)
    rays = np.empty(shape)
    rays[..., 0], rays[..., 1] = np.cos(beta), np.sin(beta)
    rays[..., 2] = rise[:, None]
    directions = rays.reshape(-1, 3)
    centres = _optical_centres(beta - psi, arm_radius)
    origins = np.broadcast_to(centres, shape).reshape(-1, 3)
    distance = room.cast(origins, directions)
    hit = np.isfinite(distance)
    points = origins[hit] + distance[hit, None] * directions[hit]
    radial = np.hypot(points[:, 0], points[:, 1])
    alpha = np.arctan2(points[:, 1], points[:, 0])
    psi_hit = np.broadcast_to(psi, shape[:2]).ravel()[hit]
    other_beta = alpha - np.arcsin(arm_radius * np.sin(psi_hit) / radial)
    other = _optical_centres(other_beta + psi_hit, arm_radius)
    towards = points - other
    away = np.linalg.norm(towards, axis=1)
    blocked = room.cast(other, towards / away[:, None]) < away - _TOLERANCE

    radial_distance = np.full(len(hit), np.inf)
    height = np.full(len(hit), np.nan)
    occluded = np.ones(len(hit), np.bool_)
    radial_distance[hit], height[hit], occluded[hit] = radial, points[:, 2], blocked
    size = shape[:2]
    return TruthPanorama(
        radial_distance.reshape(size), height.reshape(size), occluded.reshape(size)
    )


def _optical_centres(arm_azimuth: Array, arm_radius: float) -> Array:
    """Where the camera stands for each arm azimuth [m], shape (N, 3)."""
    return np.stack(
        [
            arm_radius * np.cos(arm_azimuth),
            arm_radius * np.sin(arm_azimuth),
            np.zeros_like(arm_azimuth),
        ],
        axis=-1,
    )
