"""
Camera and mounting from a sweep, without a target.

The arm's azimuths are known and its radius is the unit of length; every scene point that crosses
the image bends its path by its distance, the lens and the mounting in different ways. What one
sweep can tell and what it cannot: docs/calibration.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.calibration.adjustment import UNKNOWNS, Adjusted, adjust, moved
from panodepth_ros.calibration.tracks import Tracks, track
from panodepth_ros.geometry import PinholeCamera

Array = npt.NDArray[np.float64]

#: Tracks that fit worse than so many times the median are of no one point: edges, glare.
_WORST = 2.0
#: Fewer points say nothing trustworthy.
FEWEST_POINTS = 100
#: Less of a turn shows too few points from too few sides [rad].
_LEAST_TURN = math.radians(20.0)
#: Passes of tracking and adjustment; the second unrolls frames by what the first found.
_PASSES = 2
#: How well the principal point is known by a calibration, and as the image centre [widths].
KNOWN_CENTRE, UNKNOWN_CENTRE = 0.002, 0.01
#: An estimate whose uncertainty is more than this share of what was given is not observed.
_UNOBSERVED = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """
    How well the camera is known beforehand: standard deviations, inf for not at all, 0 for held.

    Attributes
    ----------
    focal_length : float
        Relative, of fx and fy together; their ratio is always held.
    principal_point : float
        Relative to the image's width, of cx and cy each.
    mounting : float
        Yaw, roll and tilt, each [rad].
    k1 : float
        First coefficient of the distortion; the others are held.
    """

    focal_length: float = 0.001
    principal_point: float = KNOWN_CENTRE
    mounting: float = math.inf
    k1: float = math.inf

    def __post_init__(self) -> None:
        for name in ('focal_length', 'principal_point', 'mounting', 'k1'):
            if not getattr(self, name) >= 0:
                raise ValueError(f'{name} is given to ±{getattr(self, name)}; allowed: 0 or more')

    def deviation(self, unknown: str, camera: PinholeCamera) -> float:
        """Standard deviation of one of the unknowns of the adjustment."""
        if unknown in ('cx', 'cy'):
            return self.principal_point * camera.width
        if unknown in ('yaw', 'roll', 'tilt'):
            return self.mounting
        return self.k1 if unknown == 'k1' else self.focal_length


@dataclass(frozen=True, slots=True)
class Estimate:
    """
    A number and how well it is known.

    Attributes
    ----------
    value, deviation : float
        The number and its standard deviation.
    observed : bool
        Whether the sweep told it; else it is what was given beforehand.
    """

    value: float
    deviation: float
    observed: bool = True


@dataclass(frozen=True, eq=False, slots=True)
class SelfCalibration:
    """
    What a sweep told of its camera.

    Attributes
    ----------
    camera : PinholeCamera
        Intrinsics, distortion and mounting.
    estimates : dict of str to Estimate
        Of the unknowns: ``focal_length`` fx [px], ``yaw``, ``roll``, ``tilt`` [rad], ``cx``,
        ``cy`` [px], ``k1``.
    radial_column, radial_row : Estimate
        Pixel that looks along the arm [px]: what yaw and cx, tilt and cy tell together.
    view_angle : Estimate
        Horizontal view angle of the image in its middle row [rad]: what fx, k1 and the others
        tell together, and what distances depend on.
    tracks : Tracks
    adjusted : Adjusted
        Their points, and the covariance of the unknowns in the order of ``estimates``.
    residual_px : float
        Median over the points of their root mean square residual [px].
    """

    camera: PinholeCamera
    estimates: dict[str, Estimate]
    radial_column: Estimate
    radial_row: Estimate
    view_angle: Estimate
    tracks: Tracks
    adjusted: Adjusted
    residual_px: float

    def focal_length_limits(self) -> tuple[float, float] | None:
        """
        Return what limits fx, as shares of it.

        Returns
        -------
        tuple of two float, or None
            Its standard deviation were all errors white noise, and were k1 known exactly; None
            if fx or k1 was held.
        """
        names = list(self.estimates)
        if not {'focal_length', 'k1'} <= set(names):
            return None
        fx, k1 = names.index('focal_length'), names.index('k1')
        covariance = self.adjusted.covariance
        left = covariance[fx, fx] - covariance[fx, k1] ** 2 / covariance[k1, k1]
        return float(self.adjusted.bound[fx]), math.sqrt(left)


def self_calibrate(
    frames: Iterable[npt.NDArray[np.uint8]],
    arm_azimuth: Array,
    camera: PinholeCamera,
    given: Given,
) -> SelfCalibration:
    """
    Estimate the camera from the frames of a sweep.

    Parameters
    ----------
    frames : iterable of ndarray of uint8, shape (H, W) or (H, W, 3)
        In the order in which the arm turned; gone through twice.
    arm_azimuth : ndarray of float64, shape (N,)
        γ of each frame, not wrapped [rad].
    camera : PinholeCamera
        What is known beforehand, mounting included.
    given : Given
        How well.

    Raises
    ------
    ValueError
        If the sweep is too short, or too few points could be followed.
    """
    turn = float(np.ptp(arm_azimuth))
    if turn < _LEAST_TURN:
        raise ValueError(
            f'the frames cover {math.degrees(turn):.1f}° of arm azimuth; allowed: '
            f'{math.degrees(_LEAST_TURN):.0f}° or more, best a full turn'
        )
    begin = camera
    for _ in range(_PASSES):
        found = calibrate_by(track(frames, arm_azimuth, begin), camera, given, begin)
        begin = found.camera
    return found


def calibrate_by(
    tracks: Tracks, camera: PinholeCamera, given: Given, begin: PinholeCamera | None = None
) -> SelfCalibration:
    """
    Estimate the camera from points that were followed through a sweep.

    Parameters
    ----------
    tracks : Tracks
        What was seen; points that fit badly are dropped.
    camera : PinholeCamera
        What is known beforehand, mounting included.
    given : Given
        How well.
    begin : PinholeCamera, optional
        Where the fit begins; what is known if not given.

    Raises
    ------
    ValueError
        If there are too few points.
    """
    names = [name for name in UNKNOWNS if given.deviation(name, camera) > 0]
    prior = np.array([given.deviation(name, camera) for name in names])
    _check_points(len(tracks))
    first = adjust(tracks, begin or camera, names, prior, origin=camera)
    good = first.residual_px < _WORST * np.median(first.residual_px)
    tracks = tracks.chosen(good)
    _check_points(len(tracks))
    adjusted = adjust(tracks, first.camera, names, prior, origin=camera, points=first.points[good])
    fitted = adjusted.camera

    def estimate(quantity: Callable[[PinholeCamera], float]) -> Estimate:
        value = quantity(fitted)
        slopes = np.empty(len(names))
        for k, name in enumerate(names):
            step = np.zeros(len(names))
            step[k] = UNKNOWNS[name]
            slopes[k] = (quantity(moved(fitted, names, step)) - value) / UNKNOWNS[name]
        return Estimate(value, math.sqrt(slopes @ adjusted.covariance @ slopes))

    estimates = {}
    for name, deviation in zip(names, prior, strict=True):
        found = estimate(_QUANTITIES[name])
        scale = fitted.fx if name == 'focal_length' else 1.0
        seen = found.deviation < _UNOBSERVED * deviation * scale
        estimates[name] = Estimate(found.value, found.deviation, bool(seen))
    return SelfCalibration(
        camera=fitted,
        estimates=estimates,
        radial_column=estimate(lambda lens: float(lens.project(0.0, 0.0)[0])),
        radial_row=estimate(lambda lens: float(lens.project(0.0, 0.0)[1])),
        view_angle=estimate(view_angle_of),
        tracks=tracks,
        adjusted=adjusted,
        residual_px=float(np.median(adjusted.residual_px)),
    )


def _check_points(count: int) -> None:
    if count < FEWEST_POINTS:
        raise ValueError(
            f'only {count} points could be followed through the frames; allowed: '
            f'{FEWEST_POINTS} or more. Is the scene textured, the picture sharp, the turn full '
            'and the focal length about right?'
        )


def view_angle_of(camera: PinholeCamera) -> float:
    """Angle between the rays of the left and the right edge of the image, in its middle row."""
    edges = np.array([-0.5, camera.width - 0.5])
    angle, _ = camera.rays(edges, np.full(2, 0.5 * (camera.height - 1)))
    return float(angle[0] - angle[1])


_QUANTITIES: dict[str, Callable[[PinholeCamera], float]] = {
    'focal_length': lambda camera: camera.fx,
    'yaw': lambda camera: camera.mounting.yaw,
    'roll': lambda camera: camera.mounting.roll,
    'tilt': lambda camera: camera.mounting.tilt,
    'cx': lambda camera: camera.cx,
    'cy': lambda camera: camera.cy,
    'k1': lambda camera: camera.distortion[0] if camera.distortion else 0.0,
}
