"""
The solids a room is built of, and how they are packed for the ray tracer.

Two kinds suffice: an upright box, turned about the vertical, and a turned solid, whose radius ρ
over the height z follows ρ² = a + b·z + c·z² between two flat ends: cylinder, cone, sphere,
ellipsoid and barrel are all of this form. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.textures import NAMES, Textures

#: Faces of a box by number, named by the direction in which they look before it is turned. Of a
#: turned solid number 0 is the mantle.
FACES = ('+x', '-x', '+y', '-y', 'top', 'bottom')

BOX, TURNED = 0, 1


@dataclass(frozen=True, slots=True)
class Material:
    """
    What covers a face.

    Attributes
    ----------
    texture : str
        One of :data:`~panodepth_ros.camera.simulated.textures.NAMES`.
    tile : float
        Edge of one repeat [m]; around a mantle it is rounded so that repeats meet. 0 fits
        ``part`` of the texture to the face once.
    tint : (float, float, float)
        Factors on blue, green, red.
    glow : float
        Above 0: shines with this factor, whatever the light.
    part : (float, float, float, float)
        Left, top, width and height of the part of the texture to fit, as shares of its edge.
    offset : (float, float)
        Moves a repeating texture [m].
    """

    texture: str
    tile: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    glow: float = 0.0
    part: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """An upright box: centre, edges along its own axes, heights of its ends, azimuth of its x."""

    x: float
    y: float
    length_x: float
    length_y: float
    bottom: float
    top: float
    yaw: float = 0.0
    material: Material
    faces: Mapping[str, Material] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned:
    """
    A solid of revolution about an upright axis, see the module for its profile.

    ``profile`` holds a, b, c for z measured from ``origin`` [m].
    """

    x: float
    y: float
    bottom: float
    top: float
    profile: tuple[float, float, float]
    origin: float = 0.0
    material: Material

    def radius_squared(self, height: float) -> float:
        """ρ² at a height [m²]; negative beyond the end of a sphere."""
        a, b, c = self.profile
        z = height - self.origin
        return a + b * z + c * z * z

    @property
    def largest_radius(self) -> float:
        """Largest radius between both ends [m]."""
        _, b, c = self.profile
        heights = [self.bottom, self.top]
        if c < 0.0:
            heights.append(min(max(self.origin - 0.5 * b / c, self.bottom), self.top))
        return math.sqrt(max(self.radius_squared(height) for height in heights))


Solid = Box | Turned


def cylinder(
    x: float, y: float, radius: float, bottom: float, top: float, material: Material
) -> Turned:
    """Upright cylinder."""
    profile = (radius * radius, 0.0, 0.0)
    return Turned(x=x, y=y, bottom=bottom, top=top, profile=profile, material=material)


def cone(
    x: float,
    y: float,
    radius_bottom: float,
    radius_top: float,
    bottom: float,
    top: float,
    material: Material,
) -> Turned:
    """Upright truncated cone."""
    slope = (radius_top - radius_bottom) / (top - bottom)
    profile = (radius_bottom**2, 2.0 * radius_bottom * slope, slope * slope)
    return Turned(
        x=x, y=y, bottom=bottom, top=top, profile=profile, origin=bottom, material=material
    )


def ellipsoid(
    x: float, y: float, z: float, radius: float, half_height: float, material: Material
) -> Turned:
    """Ellipsoid of revolution about the vertical; a sphere if both lengths are equal."""
    return Turned(
        x=x,
        y=y,
        bottom=z - half_height,
        top=z + half_height,
        profile=(radius * radius, 0.0, -((radius / half_height) ** 2)),
        origin=z,
        material=material,
    )


def barrel(
    x: float,
    y: float,
    belly: float,
    ends: float,
    bottom: float,
    top: float,
    material: Material,
) -> Turned:
    """Ellipsoid of radius ``belly`` halfway up, cut off where its radius is ``ends``."""
    half = 0.5 * (top - bottom)
    profile = (belly * belly, 0.0, -(belly * belly - ends * ends) / half**2)
    return Turned(
        x=x, y=y, bottom=bottom, top=top, profile=profile, origin=bottom + half, material=material
    )


def placed(solid: Solid, x: float, y: float, yaw: float, z: float) -> Solid:
    """Turn a solid about the origin, then move it: from a piece's own frame into the room's."""
    c, s = math.cos(yaw), math.sin(yaw)
    moved_x, moved_y = x + c * solid.x - s * solid.y, y + s * solid.x + c * solid.y
    bottom, top = solid.bottom + z, solid.top + z
    if isinstance(solid, Box):
        turned = solid.yaw + yaw
        return replace(solid, x=moved_x, y=moved_y, yaw=turned, bottom=bottom, top=top)
    raised = solid.origin + z
    return replace(solid, x=moved_x, y=moved_y, origin=raised, bottom=bottom, top=top)


def corners(box: Box) -> npt.NDArray[np.float64]:
    """Corners of a box seen from above, counter-clockwise, shape (4, 2) [m]."""
    c, s = math.cos(box.yaw), math.sin(box.yaw)
    half = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (box.length_x, box.length_y)
    turned: npt.NDArray[np.float64] = half @ np.array([[c, s], [-s, c]])
    turned += (box.x, box.y)
    return turned


class Geometry(NamedTuple):
    """
    All solids as the ray tracer reads them.

    Attributes
    ----------
    kind : ndarray of int64, shape (P,)
        ``BOX`` or ``TURNED``.
    shape : ndarray of float64, shape (P, 9)
        x, y, bottom, top, then for a box cos(yaw), sin(yaw), half edges, 0; for a turned solid
        a, b, c for absolute heights, largest radius, 0.
    """

    kind: npt.NDArray[np.int64]
    shape: npt.NDArray[np.float64]


class Surfaces(NamedTuple):
    """
    All faces as the ray tracer reads them.

    Attributes
    ----------
    texture : ndarray of int64, shape (P, 6)
        Number of the texture.
    mapping : ndarray of float32, shape (P, 6, 4)
        Scale and offset from the face's coordinates [m] to texture columns, then to rows
        [repeats]. Around a mantle the first coordinate is the angle [rad].
    look : ndarray of float32, shape (P, 6, 5)
        Tint of blue, green, red, glow, and the edge of one texel of level 0 [m].
    """

    texture: npt.NDArray[np.int64]
    mapping: npt.NDArray[np.float32]
    look: npt.NDArray[np.float32]


def _shape(solid: Solid) -> list[float]:
    ends = [solid.x, solid.y, solid.bottom, solid.top]
    if isinstance(solid, Box):
        half = [0.5 * solid.length_x, 0.5 * solid.length_y]
        return [*ends, math.cos(solid.yaw), math.sin(solid.yaw), *half, 0.0]
    a, b, c = solid.profile
    z = solid.origin
    return [*ends, a - b * z + c * z * z, b - 2.0 * c * z, c, solid.largest_radius, 0.0]


def _extent(solid: Solid, face: int) -> tuple[float, float, float, float]:
    """Width and height of a face, and its coordinates at the left and upper edge [m]."""
    if isinstance(solid, Turned):
        if face == 0:
            around = 2.0 * math.pi
            return around, solid.top - solid.bottom, -math.pi, -solid.top
        wide = 2.0 * solid.largest_radius
        return wide, wide, -0.5 * wide, -0.5 * wide
    wide = solid.length_y if face < 2 else solid.length_x
    if face < 4:
        return wide, solid.top - solid.bottom, -0.5 * wide, -solid.top
    return wide, solid.length_y, -0.5 * wide, -0.5 * solid.length_y


def _mapping(solid: Solid, face: int, material: Material) -> tuple[list[float], float]:
    """One row of ``Surfaces.mapping`` and the size of the whole texture on this face [m]."""
    wide, tall, left, upper = _extent(solid, face)
    if material.tile == 0.0:
        x, y, share_x, share_y = material.part
        scale_x, scale_y = share_x / wide, share_y / tall
        row = [scale_x, x - scale_x * left, scale_y, y - scale_y * upper]
        if isinstance(solid, Turned) and face == 0:
            wide *= solid.largest_radius
        return row, math.sqrt(wide * tall / (share_x * share_y))
    scale = 1.0 / material.tile
    move_x, move_y = (scale * value for value in material.offset)
    if isinstance(solid, Turned) and face == 0:
        repeats = max(1, round(2.0 * math.pi * solid.largest_radius * scale))
        return [repeats / (2.0 * math.pi), move_x, scale, move_y], material.tile
    return [scale, move_x, scale, move_y], material.tile


def pack(solids: list[Solid], textures: Textures) -> tuple[Geometry, Surfaces]:
    """Pack solids into arrays, in their order."""
    count = len(solids)
    kind = np.array([BOX if isinstance(solid, Box) else TURNED for solid in solids], np.int64)
    shape = np.array([_shape(solid) for solid in solids], np.float64)
    texture = np.zeros((count, 6), np.int64)
    mapping = np.zeros((count, 6, 4), np.float32)
    look = np.zeros((count, 6, 5), np.float32)
    for index, solid in enumerate(solids):
        for face, name in enumerate(FACES):
            material = solid.material
            if isinstance(solid, Box):
                material = solid.faces.get(name, material)
            number = NAMES.index(material.texture)
            texture[index, face] = number
            mapping[index, face], edge = _mapping(solid, face, material)
            look[index, face] = (*material.tint, material.glow, edge / textures.size[number])
    return Geometry(kind, shape), Surfaces(texture, mapping, look)
