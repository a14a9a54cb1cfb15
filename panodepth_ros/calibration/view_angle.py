"""
The paper's calibration of the view angle (eq. 1), and what parallax does to it.

Eq. 1 takes the shift of the image for a turn of the camera about its optical centre. On the arm
the centre moves: a point at distance l turns l/(l − r) times as fast through the middle of the
image as the arm does, so the view angle comes out too small, and the more so the nearer it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.calibration.self_calibration import Estimate, SelfCalibration
from panodepth_ros.calibration.tracks import Tracks
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.geometry.equations import view_angle

Array = npt.NDArray[np.float64]

#: Sightings within this share of the image's width about its middle: eq. 1 is linear, lenses not.
_MIDDLE = 0.3
#: Fewer points than this have no median worth telling.
_FEWEST = 8


@dataclass(frozen=True, slots=True)
class ViewAngle:
    """
    The view angle by eq. 1 and with parallax.

    Attributes
    ----------
    equation_1 : Estimate
        Median of eq. 1 over all points [rad].
    nearest, farthest : Estimate
        The same over the nearest and the farthest third of the points [rad].
    with_parallax : Estimate
        Of the fit of camera and distances together [rad].
    """

    equation_1: Estimate
    nearest: Estimate
    farthest: Estimate
    with_parallax: Estimate


def by_equation_1(tracks: Tracks, camera: PinholeCamera) -> Array:
    """
    View angle of eq. 1 from each point's shift through the middle of the image.

    Returns
    -------
    ndarray of float64, shape (T,)
        [rad]; NaN for points seen less than three times there.

    Notes
    -----
    The linear eq. 1 gives W/fx for a pinhole's middle; the view angle 2·atan(W/2fx) is handed out.
    """
    middle = np.abs(tracks.u - 0.5 * (camera.width - 1)) < 0.5 * _MIDDLE * camera.width
    angles = np.full(len(tracks), np.nan)
    for n, seen in enumerate(middle):
        if np.count_nonzero(seen) < 3:
            continue
        rotation, u = tracks.arm_azimuth[n][seen], tracks.u[n][seen]
        turn = float(np.ptp(rotation))
        # All sightings count: the shift is that of the straight line through them.
        shift = abs(float(np.polyfit(rotation - rotation.mean(), u, 1)[0])) * turn
        if shift > 0:
            angles[n] = 2.0 * math.atan(0.5 * view_angle(camera.width, shift, turn))
    return angles


def compare_view_angles(calibration: SelfCalibration) -> ViewAngle:
    """
    Eq. 1 beside the fit that models the parallax.

    Raises
    ------
    ValueError
        If too few points cross the middle of the image.
    """
    angles = by_equation_1(calibration.tracks, calibration.camera)
    inverse = calibration.adjusted.points[:, 1]
    known = np.isfinite(angles)
    if np.count_nonzero(known) < 3 * _FEWEST:
        raise ValueError(
            f'only {np.count_nonzero(known)} points cross the middle of the image; '
            f'allowed: {3 * _FEWEST} or more'
        )
    far, near = np.quantile(inverse[known], [1 / 3, 2 / 3])
    return ViewAngle(
        equation_1=_median(angles[known]),
        nearest=_median(angles[known & (inverse >= near)]),
        farthest=_median(angles[known & (inverse <= far)]),
        with_parallax=calibration.view_angle,
    )


def _median(values: Array) -> Estimate:
    middle = float(np.median(values))
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    return Estimate(middle, 1.2533 * spread / math.sqrt(values.size))
