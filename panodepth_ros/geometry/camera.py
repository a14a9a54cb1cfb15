"""The camera on the arm: a pinhole with lens distortion, as CameraInfo describes it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Coefficients that each distortion model of image_proc may have.
DISTORTION_MODELS = {
    'plumb_bob': (0, 4, 5),
    'rational_polynomial': (8, 12, 14),
    'equidistant': (4,),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PinholeCamera:
    """
    Intrinsics of a calibrated camera whose optical axis is radial.

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
        Angle from the optical axis to an ideal column, ψ = −atan(offset/fx).

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
        Pixel at which a ray arrives, lens distortion included.

        Parameters
        ----------
        ray_angle : array_like of float
            ψ, angle from the optical axis in the plane of rotation [rad], in (−π/2, π/2).
        slope : array_like of float
            z/d, height over horizontal distance from the camera centre; broadcast with
            ``ray_angle``.

        Returns
        -------
        (ndarray, ndarray) of float64
            u and v [px], of the broadcast shape.

        Notes
        -----
        Ideal coordinates x = −tan ψ, y = −slope/cos ψ, then the lens model and K.
        """
        ray_angle, slope = np.broadcast_arrays(
            np.asarray(ray_angle, np.float64), np.asarray(slope, np.float64)
        )
        x, y = -np.tan(ray_angle), -slope / np.cos(ray_angle)
        if not self.distorted:
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
