"""
Bundle adjustment of a sweep: the camera on a known circle, and all points it saw.

A point's own three unknowns touch its own sightings only, so they are eliminated point by point
(Schur complement), and what is left is a system of the camera's few unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panodepth_ros.calibration.tracks import Tracks
from panodepth_ros.calibration.weighing import spread_of, weigh
from panodepth_ros.geometry import Mounting, PinholeCamera

Array = npt.NDArray[np.float64]

#: Unknowns of the camera, and the step of their numerical derivative.
UNKNOWNS = {
    'focal_length': 1e-5,  # of the natural logarithm; fy/fx is kept
    'yaw': 1e-5,
    'roll': 1e-5,
    'tilt': 1e-5,
    'cx': 1e-2,
    'cy': 1e-2,
    'k1': 1e-3,
}
#: Step of the derivative by a point's azimuth [rad], inverse distance [1/r], and z/l.
_POINT_STEPS = (1e-5, 1e-5, 1e-5)
_MOST_ITERATIONS = 40
#: Steps of the points alone after each of all.
_SETTLING = 2
#: Of the sum of squares over the variance; a smaller gain ends the fit.
_LEAST_GAIN = 1e-2
#: Added to a point's normal matrix, which is many orders larger.
_FLOOR = 1e-9
#: Damping at which no step helps any more.
_MOST_DAMPING = 1e6
#: Residuals beyond this many standard deviations lose weight.
_HUBER = 2.0


def moved(camera: PinholeCamera, names: Sequence[str], step: Array) -> PinholeCamera:
    """Return the camera with some of its unknowns changed by a step."""
    by = dict(zip(names, step.tolist(), strict=True))
    scale = float(np.exp(by.get('focal_length', 0.0)))
    distortion = list(camera.distortion)
    if 'k1' in by:
        distortion = distortion or [0.0] * 5
        distortion[0] += by['k1']
    mounting = camera.mounting
    return replace(
        camera,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=camera.cx + by.get('cx', 0.0),
        cy=camera.cy + by.get('cy', 0.0),
        distortion=tuple(distortion),
        mounting=Mounting(
            yaw=mounting.yaw + by.get('yaw', 0.0),
            roll=mounting.roll + by.get('roll', 0.0),
            tilt=mounting.tilt + by.get('tilt', 0.0),
        ),
    )


def difference(camera: PinholeCamera, origin: PinholeCamera, names: Sequence[str]) -> Array:
    """Return the step that :func:`moved` takes from ``origin`` to ``camera``, shape (G,)."""
    to, start = camera.mounting, origin.mounting
    (k1, *_), (start_k1, *_) = (lens.distortion or (0.0,) for lens in (camera, origin))
    by = {
        'focal_length': math.log(camera.fx / origin.fx),
        'yaw': to.yaw - start.yaw,
        'roll': to.roll - start.roll,
        'tilt': to.tilt - start.tilt,
        'cx': camera.cx - origin.cx,
        'cy': camera.cy - origin.cy,
        'k1': k1 - start_k1,
    }
    return np.array([by[name] for name in names])


@dataclass(frozen=True, eq=False, slots=True)
class Adjusted:
    """
    Outcome of :func:`adjust`.

    Attributes
    ----------
    camera : PinholeCamera
    points : ndarray of float64, shape (T, 3)
        Azimuth α [rad], arm_radius/l and z/l of each point.
    covariance : ndarray of float64, shape (G, G)
        Of the camera's unknowns in the order given, focal length as its logarithm. Errors within
        a sector and within a stripe of the image may depend on each other (``weighing``).
    bound : ndarray of float64, shape (G,)
        Standard deviations, were the errors of all sightings white noise: Cramér and Rao's bound.
    residual_px : ndarray of float64, shape (T,)
        Root mean square of each point's residuals, u and v together [px].
    """

    camera: PinholeCamera
    points: Array
    covariance: Array
    bound: Array
    residual_px: Array


def triangulated(tracks: Tracks, camera: PinholeCamera) -> Array:
    """Points where their rays pass each other, by linear least squares; shape (T, 3)."""
    angle, slope = camera.rays(np.nan_to_num(tracks.u), np.nan_to_num(tracks.v))
    seen = np.isfinite(tracks.u)
    gamma = np.where(seen, tracks.arm_azimuth, 0.0)
    beta = gamma + angle
    # In units of the arm's radius: sin β·(X − cos γ) = cos β·(Y − sin γ).
    a = np.where(seen[..., np.newaxis], np.stack([np.sin(beta), -np.cos(beta)], axis=-1), 0.0)
    b = np.where(seen, np.sin(beta - gamma), 0.0)
    normal = np.einsum('tki,tkj->tij', a, a) + 1e-9 * np.eye(2)
    place = np.linalg.solve(normal, np.einsum('tki,tk->ti', a, b)[..., np.newaxis])[..., 0]
    # A point behind the camera is put far ahead: its rays hardly meet.
    ahead = np.einsum('ti,ti->t', place, _mean_direction(beta, seen)) > 1.2
    place = np.where(ahead[:, np.newaxis], place, 20.0 * _mean_direction(beta, seen))
    distance = np.hypot(*place.T)
    alpha = np.arctan2(place[:, 1], place[:, 0])
    d = np.hypot(place[:, :1] - np.cos(gamma), place[:, 1:] - np.sin(gamma))
    z = np.sum(np.where(seen, slope * d, 0.0), axis=1) / seen.sum(axis=1)
    return np.stack([alpha, 1.0 / distance, z / distance], axis=1)


def _mean_direction(beta: Array, seen: npt.NDArray[np.bool_]) -> Array:
    x, y = (np.sum(np.where(seen, f(beta), 0.0), axis=1) for f in (np.cos, np.sin))
    return np.asarray(np.stack([x, y], axis=1) / np.hypot(x, y)[:, np.newaxis])


def residuals(tracks: Tracks, camera: PinholeCamera, points: Array) -> Array:
    """Predicted minus measured pixels, shape (T, K, 2); 0 where a point is not seen."""
    seen = np.isfinite(tracks.u)
    turned = points[:, :1] - np.where(seen, tracks.arm_azimuth, points[:, :1])
    x, y = np.cos(turned) - points[:, 1:2], np.sin(turned)
    z = np.broadcast_to(points[:, 2:], x.shape)
    u, v = camera.project_direction(np.stack([x, y, z]))
    off = np.stack([u - tracks.u, v - tracks.v], axis=-1)
    return np.asarray(np.where(seen[..., np.newaxis], off, 0.0))


def adjust(
    tracks: Tracks,
    camera: PinholeCamera,
    names: Sequence[str],
    prior: Array,
    *,
    origin: PinholeCamera,
    points: Array | None = None,
) -> Adjusted:
    """
    Fit the camera and all points to the tracks by robust least squares.

    Parameters
    ----------
    tracks : Tracks
        What was seen.
    camera : PinholeCamera
        Where to begin.
    names : sequence of str
        Unknowns of the camera, keys of :data:`UNKNOWNS`; the others are held as in ``origin``.
    prior : ndarray of float64, shape (G,)
        Standard deviation of what ``origin`` says of them; inf for none.
    origin : PinholeCamera
        What was known beforehand.
    points : ndarray of float64, shape (T, 3), optional
        Where the points begin; triangulated if not given.
    """
    begun, total = origin, difference(camera, origin, names)
    camera = moved(begun, names, total)  # what is held is that of origin
    points = triangulated(tracks, camera) if points is None else points
    weak = 1.0 / np.square(prior)
    damping = 1e-3
    off = residuals(tracks, camera, points)
    weight, sigma = _weights(off, tracks)
    points, off = _settled(tracks, camera, points, off, sigma)
    system = None
    for _ in range(_MOST_ITERATIONS):
        if system is None:
            weight, sigma = _weights(off, tracks)
            cost = _costs(off, sigma).sum() + float(weak @ total**2)
            system = _System(tracks, camera, points, names, off, weight)
        step, point_steps = system.solve(damping, weak, total)
        new_total, new_points = total + step, points + point_steps
        new_camera = moved(begun, names, new_total)
        new_off = residuals(tracks, new_camera, new_points)
        # Each point follows the camera along its own curve, which the common step leaves.
        new_points, new_off = _settled(tracks, new_camera, new_points, new_off, sigma)
        new_cost = _costs(new_off, sigma).sum() + float(weak @ new_total**2)
        if not new_cost <= cost:
            damping *= 10.0
            if damping > _MOST_DAMPING:
                break
            continue
        small = cost - new_cost < _LEAST_GAIN
        camera, points, total, off = new_camera, new_points, new_total, new_off
        damping, system = damping / 10.0, None
        if small:
            break
    weight, sigma = _weights(off, tracks)
    system = _System(tracks, camera, points, names, off, weight)
    azimuth = np.nanmean(tracks.arm_azimuth, axis=1)
    column = (np.nan_to_num(tracks.u) + 0.5) / camera.width
    information, by_track, by_sighting = system.scores()
    spread = spread_of(information, by_track, by_sighting, azimuth, column)
    total, covariance = weigh(information, spread, by_track.sum(axis=0), weak, total)
    bound = np.sqrt(np.diag(np.linalg.inv(information + np.diag(weak))))
    camera = moved(begun, names, total)
    points, off = _settled(tracks, camera, points, residuals(tracks, camera, points), sigma)
    count = np.maximum(np.isfinite(tracks.u).sum(axis=1), 1)
    rms = np.sqrt(np.square(off).sum(axis=(1, 2)) / count)
    return Adjusted(camera, points, covariance, bound, rms)


def _settled(
    tracks: Tracks, camera: PinholeCamera, points: Array, off: Array, sigma: float
) -> tuple[Array, Array]:
    """Points moved to where they fit a camera better, each for itself, and their residuals."""
    for _ in range(_SETTLING):
        weight = _weights(off, tracks, sigma)[0]
        by_point = _by_point(tracks, camera, points)
        normal = np.einsum('tkij,tkil,tk->tjl', by_point, by_point, weight)
        gradient = np.einsum('tkij,tki,tk->tj', by_point, off, weight)
        step = np.linalg.solve(normal + _FLOOR * np.eye(3), gradient[..., np.newaxis])[..., 0]
        new_off = residuals(tracks, camera, points - step)
        better = _costs(new_off, sigma) < _costs(off, sigma)
        points = np.where(better[:, np.newaxis], points - step, points)
        off = np.where(better[:, np.newaxis, np.newaxis], new_off, off)
    return points, off


def _weights(off: Array, tracks: Tracks, sigma: float | None = None) -> tuple[Array, float]:
    """Huber's weights over the variance, shape (T, K), and the scale [px], robust if not given."""
    size = np.hypot(off[..., 0], off[..., 1])
    if sigma is None:
        sigma = max(float(np.median(size[np.isfinite(tracks.u)])) / 1.18, 1e-6)
    return np.minimum(1.0, _HUBER / np.maximum(size / sigma, 1e-12)) / sigma**2, sigma


def _costs(off: Array, sigma: float) -> Array:
    """Huber's cost of each point, shape (T,)."""
    size = np.hypot(off[..., 0], off[..., 1]) / sigma
    cost = np.where(size < _HUBER, size**2, _HUBER * (2.0 * size - _HUBER))
    return np.asarray(cost.sum(axis=1))


def _by_point(tracks: Tracks, camera: PinholeCamera, points: Array) -> Array:
    """Derivatives of the residuals by their point, shape (T, K, 2, 3)."""
    return np.stack(
        [
            _slope(tracks, (camera, points + shift), (camera, points - shift), size)
            for shift, size in zip(np.diag(_POINT_STEPS), _POINT_STEPS, strict=True)
        ],
        axis=-1,
    )


def _slope(
    tracks: Tracks,
    ahead: tuple[PinholeCamera, Array],
    behind: tuple[PinholeCamera, Array],
    size: float,
) -> Array:
    """Derivative by central differences: what tells fx from k1 is of the third order."""
    return (residuals(tracks, *ahead) - residuals(tracks, *behind)) / (2.0 * size)


class _System:
    """Normal equations at one place, with the points eliminated."""

    def __init__(
        self,
        tracks: Tracks,
        camera: PinholeCamera,
        points: Array,
        names: Sequence[str],
        off: Array,
        weight: Array,
    ) -> None:
        sizes = np.array([UNKNOWNS[name] for name in names])
        by_camera = np.stack(
            [
                _slope(
                    tracks,
                    (moved(camera, names, shift), points),
                    (moved(camera, names, -shift), points),
                    size,
                )
                for shift, size in zip(np.diag(sizes), sizes.tolist(), strict=True)
            ],
            axis=-1,
        )
        by_point = _by_point(tracks, camera, points)
        count, unknowns = len(off), len(names)
        root = np.sqrt(weight)[..., np.newaxis]
        jc = (by_camera * root[..., np.newaxis]).reshape(count, -1, unknowns)
        jp = (by_point * root[..., np.newaxis]).reshape(count, -1, 3)
        e = (off * root).reshape(count, -1, 1)
        jpt = jp.transpose(0, 2, 1)
        self._by_camera, self._by_point, self._off = jc, jp, e
        self._camera = jc.transpose(0, 2, 1) @ jc
        self._cross = jpt @ jc
        self._point = jpt @ jp
        self._camera_gradient = (jc.transpose(0, 2, 1) @ e)[..., 0]
        self._point_gradient = jpt @ e

    def _reduced(self) -> tuple[Array, Array, Array, Array]:
        """Each point's share of the system and its gradient; and what gives the points' steps."""
        solved = np.linalg.solve(
            self._point + _FLOOR * np.eye(3),
            np.concatenate([self._cross, self._point_gradient], axis=2),
        )
        back, own = solved[..., :-1], solved[..., -1]
        cross = self._cross.transpose(0, 2, 1)
        gradient = self._camera_gradient - (cross @ own[..., np.newaxis])[..., 0]
        return self._camera - cross @ back, gradient, back, own

    def solve(self, damping: float, weak: Array, total: Array) -> tuple[Array, Array]:
        """Step of the camera's unknowns, and of the points."""
        shares, gradients, back, own = self._reduced()
        matrix = shares.sum(axis=0) + np.diag(weak)
        # Damped points would hold the camera by what they know of it at their places of now.
        matrix += damping * np.diag(np.diag(matrix))
        step = -np.linalg.solve(matrix, gradients.sum(axis=0) + weak * total)
        return step, -own - back @ step

    def scores(self) -> tuple[Array, Array, Array]:
        """Information, shape (G, G); gradient by points, (T, G), and by sightings, (T, K, G)."""
        shares, gradients, back, _ = self._reduced()
        own = (self._by_camera - self._by_point @ back) * self._off
        return (
            shares.sum(axis=0),
            gradients,
            own.reshape(len(own), -1, 2, own.shape[-1]).sum(axis=2),
        )
