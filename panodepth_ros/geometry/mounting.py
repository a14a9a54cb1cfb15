"""How the camera sits on the arm: the rotation between the arm's and the camera's directions."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """
    Rotation of the camera against the arm (docs/conventions.md, "Mounting").

    All 0: the optical axis is radial and the image rows lie in the plane of rotation. A camera
    held so is rolled about its optical axis first, then tilted, then turned about the vertical.

    Attributes
    ----------
    yaw : float
        Optical axis to the left, counter-clockwise seen from above [rad].
    roll : float
        Camera turned clockwise, seen from behind it [rad].
    tilt : float
        Optical axis up [rad].

    Raises
    ------
    ValueError
        If an angle is not finite, or the optical axis points away from the radial direction.
    """

    yaw: float = 0.0
    roll: float = 0.0
    tilt: float = 0.0

    def __post_init__(self) -> None:
        for name in ('yaw', 'roll', 'tilt'):
            value = getattr(self, name)
            limit = math.pi if name == 'roll' else math.pi / 2
            if not abs(value) <= limit:
                raise ValueError(
                    f'camera {name} is {value} rad; allowed: {-limit:.4f} to {limit:.4f}'
                )

    @property
    def aligned(self) -> bool:
        """Whether the camera is not turned at all."""
        return self.yaw == self.roll == self.tilt == 0.0

    @property
    def rotation(self) -> Array:
        """
        Rotation from camera to arm, shape (3, 3).

        Both have axes forward (optical axis, radial), left and up.
        """
        (cy, sy), (ct, st), (cr, sr) = (
            (math.cos(angle), math.sin(angle)) for angle in (self.yaw, self.tilt, self.roll)
        )
        yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        tilt = np.array([[ct, 0.0, -st], [0.0, 1.0, 0.0], [st, 0.0, ct]])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        return np.asarray(yaw @ tilt @ roll)

    def to_camera(self, direction: Array) -> Array:
        """Turn directions, shape (3, …), axes forward, left, up, from the arm to the camera."""
        return np.asarray(np.tensordot(self.rotation.T, direction, axes=1))

    def to_arm(self, direction: Array) -> Array:
        """Turn directions, shape (3, …), from camera to arm, the inverse of :meth:`to_camera`."""
        return np.asarray(np.tensordot(self.rotation, direction, axes=1))


#: Optical axis radial, rows in the plane of rotation.
ALIGNED = Mounting()
