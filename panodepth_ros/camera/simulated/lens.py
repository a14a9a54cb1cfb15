"""Frames of a real camera in the simulated room: its lens distorts, its mount is not true."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.room import Room, RoomCamera
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.geometry.sampling import sampling_maps

#: A level, ideal picture is rendered this much finer, sampled, and averaged over pixels. Linear
#: interpolation shifts details by where between the pixels it falls: at 2, by up to 0.008 px, the
#: same in a whole column, which a calibration takes for a lens with 5 % less of a focal length.
_FINER = 3
#: Pixels of the fine picture around what is sampled.
_BORDER = 2
#: Rays may look so far from the level radial direction [rad].
_WIDEST = math.radians(75.0)


class RealCamera:
    """
    Renders what a camera with a distorting lens and a mount of any rotation sees.

    Parameters
    ----------
    camera : PinholeCamera
        Its true intrinsics, distortion and mounting.

    Raises
    ------
    ValueError
        If the lens model does not hold in the whole image, or the camera looks too far aside.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera
        self._level: RoomCamera | None = None
        if camera.distorted or not camera.mounting.aligned:
            self._level, self._u, self._v = _rectified(camera)

    def render(self, room: Room, arm_azimuth: float, arm_radius: float) -> npt.NDArray[np.uint8]:
        """
        Return one frame, shape (H, W, 3), in blue, green, red, without noise.

        Parameters
        ----------
        room : Room
            What there is to see.
        arm_azimuth : float
            Where the arm points [rad].
        arm_radius : float
            Axis to optical centre [m].
        """
        camera = self.camera
        if self._level is None:
            ideal = RoomCamera(
                width=camera.width,
                height=camera.height,
                fx=camera.fx,
                fy=camera.fy,
                cx=camera.cx,
                cy=camera.cy,
            )
            return room.render(arm_azimuth, ideal, arm_radius)
        level = room.render(arm_azimuth, self._level, arm_radius)
        fine = cv2.remap(level, self._u, self._v, cv2.INTER_LINEAR)
        size = (camera.width, camera.height)
        return np.asarray(cv2.resize(fine, size, interpolation=cv2.INTER_AREA), np.uint8)


def _rectified(
    camera: PinholeCamera,
) -> tuple[RoomCamera, npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Level camera that sees all that this one does, and where in it each fine pixel looks."""
    rows, columns = (_FINER * size for size in (camera.height, camera.width))
    v, u = np.mgrid[0:rows, 0:columns]
    centre = 0.5 * (1 - 1 / _FINER)
    ray_angle, slope = camera.rays(u / _FINER - centre, v / _FINER - centre)
    if np.abs(ray_angle).max() > _WIDEST or np.abs(slope).max() > math.tan(_WIDEST):
        raise ValueError(
            f'the simulated camera looks {math.degrees(np.abs(ray_angle).max()):.0f}° aside and '
            f'{math.degrees(math.atan(np.abs(slope).max())):.0f}° up or down of the arm; '
            f'allowed: {math.degrees(_WIDEST):.0f}°'
        )
    x, y = -np.tan(ray_angle), -slope / np.cos(ray_angle)
    fx, fy = _FINER * camera.fx, _FINER * camera.fy
    left, top = math.floor(fx * x.min()) - _BORDER, math.floor(fy * y.min()) - _BORDER
    level = RoomCamera(
        width=math.ceil(fx * x.max()) + _BORDER - left,
        height=math.ceil(fy * y.max()) + _BORDER - top,
        fx=fx,
        fy=fy,
        cx=-left,
        cy=-top,
    )
    return level, *sampling_maps(fx * x - left, fy * y - top)
