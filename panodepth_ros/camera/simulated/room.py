"""
A furnished room to sweep: seen by a camera, measured by rays, drawn from above.

World frame: right-handed, metres, z up; the arm's axis is the z axis and the camera's optical
centre turns at z = 0, so the floor is below zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated import hits, raytracer
from panodepth_ros.camera.simulated.shading import Light
from panodepth_ros.camera.simulated.solids import Box, Solid, Turned, corners, pack
from panodepth_ros.camera.simulated.textures import Textures

Array = npt.NDArray[np.float64]
Segment = tuple[tuple[float, float], tuple[float, float]]

_LATTICE = 0.15
_REACH = 0.6
_BRIGHT = 225.0
_CIRCLE = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomCamera:
    """An ideal pinhole camera without distortion: image size and K [px]."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def from_field_of_view(cls, width: int, height: int, field_of_view: float) -> RoomCamera:
        """Camera with square pixels, a centred axis and a horizontal field of view [rad]."""
        focal_length = 0.5 * width / math.tan(0.5 * field_of_view)
        centre = 0.5 * (width - 1), 0.5 * (height - 1)
        return cls(
            width=width,
            height=height,
            fx=focal_length,
            fy=focal_length,
            cx=centre[0],
            cy=centre[1],
        )

    def column(self, u: int) -> RoomCamera:
        """Only one column of this camera's image; a panorama is rendered soonest with it."""
        return replace(self, width=1, cx=self.cx - u)


class Room:
    """
    Solids with textures and light.

    Parameters
    ----------
    solids : list of Box and Turned
        What there is; the camera must be inside of none.
    textures : Textures
        What it is covered with.
    lamps : ndarray of float, shape (2, 6)
        Two lamps: x, y, z [m], strength in blue, green, red.
    ambient : (float, float, float)
        Light from everywhere: blue, green, red.
    """

    def __init__(
        self,
        solids: list[Solid],
        textures: Textures,
        lamps: Array,
        ambient: tuple[float, float, float],
    ) -> None:
        self.solids = tuple(solids)
        self._textures = textures
        self._geometry, self._surfaces = pack(solids, textures)
        self._light = self._lit(lamps, ambient)

    def render(
        self,
        arm_azimuth: float,
        camera: RoomCamera,
        arm_radius: float,
        robot: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> npt.NDArray[np.uint8]:
        """
        What the camera on the arm sees, without noise.

        Parameters
        ----------
        arm_azimuth : float
            Where the arm and the optical axis point [rad], counter-clockwise.
        camera : RoomCamera
            The lens.
        arm_radius : float
            Axis to optical centre [m].
        robot : (float, float, float)
            Where the axis stands, x and y [m], and how the robot is turned [rad].

        Returns
        -------
        ndarray of uint8, shape (H, W, 3)
            Blue, green, red.
        """
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        azimuth = arm_azimuth + robot[2]
        x = robot[0] + arm_radius * math.cos(azimuth)
        y = robot[1] + arm_radius * math.sin(azimuth)
        raytracer.render(
            self._geometry,
            self._surfaces,
            self._textures,
            self._light,
            (x, y, 0.0, float(azimuth)),
            (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
            image,
        )
        return image

    def expose(self) -> None:
        """Scale the light so that a look around has few blown-out pixels, as a camera would."""
        camera = RoomCamera.from_field_of_view(40, 30, math.radians(40.0))
        look = [self.render(azimuth, camera, 0.3) for azimuth in np.arange(0.0, 2 * math.pi, 0.6)]
        factor = np.float32(_BRIGHT / np.percentile(look, 97.0))
        light = self._light
        lamps = light.lamps.copy()
        lamps[:, 3:] *= factor
        self._light = light._replace(lamps=lamps, ambient=light.ambient * factor)

    def cast(self, origins: npt.ArrayLike, directions: npt.ArrayLike) -> Array:
        """
        Exact distances along rays.

        Parameters
        ----------
        origins, directions : array_like of float, shape (M, 3)
            Rays in the world frame [m]; either may have shape (3,) and then serves for all. The
            origin must be outside of every solid.

        Returns
        -------
        ndarray of float64, shape (M,)
            To the first surface, in lengths of the direction; +inf where there is none.
        """
        starts = np.atleast_2d(np.asarray(origins, np.float64))
        ways = np.atleast_2d(np.asarray(directions, np.float64))
        shape = np.broadcast_shapes(starts.shape, ways.shape)
        distances = np.empty(shape[0])
        hits.cast(
            self._geometry,
            np.array(np.broadcast_to(starts, shape)),
            np.array(np.broadcast_to(ways, shape)),
            distances,
        )
        return distances

    def outline(self, height: float = 0.0) -> list[Segment]:
        """
        The room cut open at a height, as a plan shows it.

        Parameters
        ----------
        height : float
            Height of the cut [m].

        Returns
        -------
        list of ((x, y), (x, y))
            Edges of all solids that reach through this height [m]; circles as 48 chords.
        """
        segments: list[Segment] = []
        for solid in self.solids:
            if not solid.bottom <= height <= solid.top:
                continue
            edge = corners(solid) if isinstance(solid, Box) else _circle(solid, height)
            points = [(float(x), float(y)) for x, y in edge]
            segments.extend(zip(points, points[1:] + points[:1], strict=True))
        return segments

    def _lit(self, lamps: Array, ambient: tuple[float, float, float]) -> Light:
        """
        Find out how light reaches the points of a lattice.

        Openness is the mean free path to 14 sides, cut off at ``_REACH``. Points inside of
        solids take the mean of their neighbours outside. Blurring over neighbours makes lamps
        large and shadows soft.
        """
        low = np.min([[s.x, s.y, s.bottom] for s in self.solids], axis=0) - _LATTICE
        high = np.max([[s.x, s.y, s.top] for s in self.solids], axis=0) + _LATTICE
        axes = [np.arange(a, b + _LATTICE, _LATTICE) for a, b in zip(low, high, strict=True)]
        lattice = np.stack(np.meshgrid(*axes, indexing='ij'), axis=-1)
        points = lattice.reshape(-1, 3)
        blocked = np.empty(len(points), np.bool_)
        hits.inside(self._geometry, points, blocked)
        grid = np.zeros((len(points), 4))
        free = points[~blocked]
        sides = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
        sides = [side for side in sides if sum(map(abs, side)) in (1, 3)]
        units = np.array(sides) / np.linalg.norm(sides, axis=1, keepdims=True)
        shares = np.empty(len(free))
        hits.openness(self._geometry, free, units, _REACH, shares)
        grid[~blocked, 0] = shares
        for k, lamp in enumerate(lamps):
            # A lamp may hang in its own solid: the last decimetre does not count.
            towards = lamp[:3] - free
            away = np.linalg.norm(towards, axis=1)
            grid[~blocked, 1 + k] = self.cast(free, towards) * away > away - 0.1
        grid[~blocked, 3] = 1.0
        planes = grid.reshape(*lattice.shape[:3], 4)
        for axis in range(3):
            pad = [(1, 1) if a == axis else (0, 0) for a in range(4)]
            padded = np.pad(planes, pad)
            length = planes.shape[axis]
            before, here, after = (
                np.take(padded, np.arange(k, k + length), axis) for k in range(3)
            )
            planes = 0.25 * before + 0.5 * here + 0.25 * after
        planes = planes[..., :3] / np.maximum(planes[..., 3:], 1e-6)
        return Light(
            np.asarray(lamps, np.float32),
            np.asarray(ambient, np.float32),
            np.ascontiguousarray(planes, np.float32).ravel(),
            np.array(planes.shape[:3]),
            np.array([*(axis[0] for axis in axes), _LATTICE]),
        )


def _circle(solid: Turned, height: float) -> Array:
    """Corners of a circle's chords, shape (48, 2) [m]."""
    angles = np.arange(_CIRCLE) * (2.0 * math.pi / _CIRCLE)
    radius = math.sqrt(max(solid.radius_squared(height), 0.0))
    return np.column_stack([solid.x + radius * np.cos(angles), solid.y + radius * np.sin(angles)])
