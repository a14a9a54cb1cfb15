"""The camera on the arm: a pinhole with lens distortion, as CameraInfo describes it, mounted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry.mounting import ALIGNED, Mounting

Array = npt.NDArray[np.float64]

#: Rays of pixels are found to this [px], or not at all after so many steps.
_EXACT_PX, _MOST_ITERATIONS = 1e-7, 100
#: Coefficients that each distortion model of image_proc may have.
DISTORTION_MODELS = {
    'plumb_bob': (0, 4, 5),
    'rational_polynomial': (8, 12, 14),
    'equidistant': (4,),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PinholeCamera:
    """
    Intrinsics of a calibrated camera and how it sits on the arm.

    Attributes
    ----------
    width, height : int
        Image size [px].
    fx, fy, cx, cy : float
        Focal lengths and principal point of K [px].
    distortion_model : str
        ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
    distortion : tuple of float
        D in the model's order.
    mounting : Mounting
        Its rotation against the arm; by default none, and the optical axis is radial.

    Raises
    ------
    ValueError
        If the values cannot describe a camera.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = 'plumb_bob'
    distortion: tuple[float, ...] = ()
    mounting: Mounting = ALIGNED

    def __post_init__(self) -> None:
        for name in ('width', 'height', 'fx', 'fy'):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise ValueError(
                    f'camera {name} is {value}; allowed: finite and above 0'
                    ' (an uncalibrated camera has 0: give it a camera_info)'
                )
        if not (math.isfinite(self.cx) and math.isfinite(self.cy)):
            raise ValueError(f'camera principal point is ({self.cx}, {self.cy}); allowed: finite')
        if self.distortion_model not in DISTORTION_MODELS:
            raise ValueError(
                f'camera distortion_model is {self.distortion_model!r}; '
                f'allowed: {", ".join(DISTORTION_MODELS)}'
            )
        lengths = DISTORTION_MODELS[self.distortion_model]
        if len(self.distortion) not in lengths or not all(map(math.isfinite, self.distortion)):
            raise ValueError(
                f'camera has {len(self.distortion)} {self.distortion_model} coefficients '
                f'{self.distortion}; allowed: {" or ".join(map(str, lengths))}, finite'
            )

    @property
    def distorted(self) -> bool:
        """Whether the lens bends rays at all."""
        return any(self.distortion)

    def ray_angle(self, offset_px: float) -> float:
        """
        Angle from the arm to an ideal column of the aligned camera, ψ = −atan(offset/fx).

        Parameters
        ----------
        offset_px : float
            Ideal (undistorted) column minus cx [px]; right of the centre is positive.

        Returns
        -------
        float
            [rad], counter-clockwise positive: a column right of the centre looks clockwise.
        """
        return -math.atan(offset_px / self.fx)

    def project(self, ray_angle: npt.ArrayLike, slope: npt.ArrayLike) -> tuple[Array, Array]:
        """
        Pixel at which a ray arrives, mounting and lens distortion included.

        Parameters
        ----------
        ray_angle : array_like of float
            ψ, angle from the arm in the plane of rotation [rad].
        slope : array_like of float
            z/d, height over horizontal distance from the camera centre; broadcast with
            ``ray_angle``.

        Returns
        -------
        (ndarray, ndarray) of float64
            u and v [px], of the broadcast shape; NaN for rays from behind the camera.
        """
        ray_angle, slope = np.broadcast_arrays(
            np.asarray(ray_angle, np.float64), np.asarray(slope, np.float64)
        )
        return self.project_direction(np.stack([np.cos(ray_angle), np.sin(ray_angle), slope]))

    def project_direction(self, direction: Array) -> tuple[Array, Array]:
        """
        Pixel at which the ray of a direction arrives, see :meth:`project`.

        Parameters
        ----------
        direction : ndarray of float64, shape (3, …)
            Along the arm, to its left, and up; of any length.

        Notes
        -----
        In the camera's frame: ideal coordinates x = −left/forward, y = −up/forward, then the
        lens model and K.
        """
        if not self.mounting.aligned:
            direction = self.mounting.to_camera(direction)
        forward, left, up = direction
        ahead = np.where(forward > 0, forward, np.nan)
        return self.imaged(-left / ahead, -up / ahead)

    def rays(self, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[Array, Array]:
        """
        Rays that arrive at pixels, the inverse of :meth:`project`.

        Parameters
        ----------
        u, v : array_like of float
            Pixels; broadcast.

        Returns
        -------
        (ndarray, ndarray) of float64
            Ray angle ψ [rad] and slope z/d in the arm's frame, of the broadcast shape.

        Raises
        ------
        ValueError
            If no ray arrives at one of the pixels by this lens model.
        """
        x, y = self.ideal(u, v)
        forward, left, up = self.mounting.to_arm(np.stack([np.ones_like(x), -x, -y]))
        return np.arctan2(left, forward), up / np.hypot(forward, left)

    def ideal(self, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[Array, Array]:
        """
        Ideal coordinates imaged at pixels, the inverse of :meth:`imaged`; errors as :meth:`rays`.

        Parameters
        ----------
        u, v : array_like of float
            Pixels; broadcast.
        """
        u, v = np.broadcast_arrays(np.asarray(u, np.float64), np.asarray(v, np.float64))
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        for _ in range(_MOST_ITERATIONS if self.distorted else 0):
            with np.errstate(over='ignore', invalid='ignore'):  # on the way to no ray
                reached_u, reached_v = self.imaged(x, y)
            off_u, off_v = u - reached_u, v - reached_v
            if max(np.abs(off_u).max(), np.abs(off_v).max()) < _EXACT_PX:
                break
            x, y = x + off_u / self.fx, y + off_v / self.fy
        else:
            if self.distorted:
                raise ValueError(
                    f'camera distortion {self.distortion} leaves pixels without a ray; '
                    'allowed: a lens model that holds in the whole image'
                )
        return x, y

    def imaged(self, x: Array, y: Array) -> tuple[Array, Array]:
        """
        Lens model and K: ideal coordinates to pixels.

        Parameters
        ----------
        x, y : ndarray of float64
            Right and down, over the distance along the optical axis; of one shape.
        """
        if not self.distorted:
            return self.cx + self.fx * x, self.cy + self.fy * y
        if self.distortion_model == 'plumb_bob':
            # As cv2.projectPoints, which takes ten times as long.
            k1, k2, p1, p2, *k3 = self.distortion
            xx, yy, xy = x * x, y * y, 2.0 * x * y
            rr = xx + yy
            bent = 1.0 + rr * (k1 + rr * (k2 + rr * (k3[0] if k3 else 0.0)))
            x, y = (
                x * bent + p1 * xy + p2 * (rr + 2.0 * xx),
                y * bent + p2 * xy + p1 * (rr + 2.0 * yy),
            )
            return self.cx + self.fx * x, self.cy + self.fy * y
        K = np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]])
        D = np.array(self.distortion)
        rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1)
        if self.distortion_model == 'equidistant':
            pixels, _ = cv2.fisheye.projectPoints(
                rays[:, np.newaxis], np.zeros(3), np.zeros(3), K, D
            )
        else:
            pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, D)
        pixels = pixels.reshape(-1, 2)
        return pixels[:, 0].reshape(x.shape), pixels[:, 1].reshape(x.shape)
