"""
How a room is put together: shell, openings, furniture where there is space, pictures.

World frame as in :mod:`panodepth_ros.camera.simulated.room`. All is drawn from one seed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.furniture import AT_WALL, FREE, picture
from panodepth_ros.camera.simulated.furniture_parts import Piece
from panodepth_ros.camera.simulated.room import Room
from panodepth_ros.camera.simulated.solids import Box, Material, Solid, Turned, corners, placed
from panodepth_ros.camera.simulated.textures import make_textures

Array = npt.NDArray[np.float64]

#: Height of the camera above the floor and of the room [m].
CAMERA_HEIGHT = 0.85
ROOM_HEIGHT = 2.6
#: Nothing stands closer to the axis than this [m].
CLEARANCE = 0.55

_FLOOR = -CAMERA_HEIGHT
_CEILING = ROOM_HEIGHT - CAMERA_HEIGHT
_WALL = 0.3


@dataclass(frozen=True, slots=True)
class _Side:
    """One side of the room, seen from inside: its middle, inward azimuth and half length."""

    x: float
    y: float
    yaw: float
    half: float

    def at(self, along: float, out: float) -> tuple[float, float]:
        """Point at a distance along the side, to the left of who looks in, and into the room."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + out * c - along * s, self.y + out * s + along * c


def _footprint(x: float, y: float, yaw: float, depth: float, width: float) -> Array:
    outline = Box(
        x=x,
        y=y,
        yaw=yaw,
        length_x=depth,
        length_y=width,
        bottom=0,
        top=0,
        material=Material('paint'),
    )
    return corners(outline)


def _apart(first: Array, second: Array, gap: float) -> bool:
    """Whether two rectangles keep a gap: one of their sides must separate them."""
    for rectangle in (first, second):
        for k in range(2):
            normal = rectangle[k + 1] - rectangle[k]
            normal = normal / np.linalg.norm(normal)
            a, b = first @ normal, second @ normal
            if a.min() > b.max() + gap or b.min() > a.max() + gap:
                return True
    return False


def _distance_from_axis(rectangle: Array) -> float:
    """Shortest distance of a rectangle's edge from the origin, which lies outside."""
    nearest = math.inf
    for start, end in zip(rectangle, np.roll(rectangle, -1, axis=0), strict=True):
        edge = end - start
        share = min(max(-(start @ edge) / (edge @ edge), 0.0), 1.0)
        nearest = min(nearest, float(np.linalg.norm(start + share * edge)))
    return nearest


class _Builder:
    """Puts pieces where there is room for them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.solids: list[Solid] = []
        self.taken: list[Array] = []
        self.openings: list[Array] = []
        self.shell_size = 0
        wide, long = rng.uniform(3.7, 4.3), rng.uniform(4.7, 5.3)
        east, north = 0.5 * wide + rng.uniform(-0.3, 0.3), 0.5 * long + rng.uniform(-0.4, 0.4)
        west, south = east - wide, north - long
        middle_x, middle_y = 0.5 * (east + west), 0.5 * (north + south)
        self.sides = [
            _Side(east, middle_y, math.pi, 0.5 * long),
            _Side(middle_x, north, -0.5 * math.pi, 0.5 * wide),
            _Side(west, middle_y, 0.0, 0.5 * long),
            _Side(middle_x, south, 0.5 * math.pi, 0.5 * wide),
        ]
        self.middle, self.size = (middle_x, middle_y), (wide, long)

    def shell(self) -> None:
        """Floor, ceiling and four walls, one with a door niche, one with a window."""
        rng = self.rng
        (x, y), (wide, long) = self.middle, self.size
        for bottom, top, material in (
            (_FLOOR - 0.1, _FLOOR, Material('parquet' if rng.random() < 0.7 else 'carpet', 1.8)),
            (_CEILING, _CEILING + 0.1, Material('plaster', 2.6, (1.1, 1.1, 1.1))),
        ):
            self.solids.append(
                Box(
                    x=x,
                    y=y,
                    length_x=wide + 2 * _WALL,
                    length_y=long + 2 * _WALL,
                    bottom=bottom,
                    top=top,
                    material=material,
                )
            )
        tiles = {'brick': 2.0, 'wallpaper': 0.53, 'plaster': 2.6, 'roughcast': 2.0, 'panel': 1.6}
        names = rng.permutation(list(tiles))[:4]
        door, window = rng.permutation(4)[:2]
        for k, side in enumerate(self.sides):
            tint = 1.0 + rng.uniform(-0.1, 0.1, 3)
            paper = Material(str(names[k]), tiles[str(names[k])], tuple(tint.tolist()))
            # Each covers the corner on its left.
            if k == door:
                along = float(rng.uniform(-0.5, 0.5) * side.half)
                self._wall(side, paper, along, 0.95, (_FLOOR, _FLOOR + 2.05), Material('door'))
                self.taken.append(_footprint(*side.at(along, 0.3), side.yaw, 0.6, 1.0))
            elif k == window:
                along = float(rng.uniform(-0.4, 0.4) * side.half)
                span = (_FLOOR + 0.8, _FLOOR + 2.1)
                view = Material('view', glow=1.25)
                self._wall(side, paper, along, float(rng.uniform(1.1, 1.6)), span, view)
                self.window = side.at(along, -0.1)
            else:
                self._slab(side, paper, -side.half, side.half + _WALL, _FLOOR, _CEILING)
        self.shell_size = len(self.solids)
        corner = self.sides[int(rng.integers(4))]
        paper = Material('plaster', 2.6, (0.9, 0.95, 1.0))
        chimney = Piece(
            [
                Box(
                    x=0,
                    y=0,
                    length_x=0.3,
                    length_y=0.6,
                    bottom=0,
                    top=ROOM_HEIGHT,
                    material=paper,
                )
            ],
            0.3,
            0.6,
            ROOM_HEIGHT,
        )
        self._put(chimney, *corner.at(corner.half - 0.3, 0.15), corner.yaw)

    def _slab(
        self,
        side: _Side,
        material: Material,
        begin: float,
        end: float,
        bottom: float,
        top: float,
        recess: float = 0.0,
    ) -> None:
        """Part of a wall between two places along the side, its face set back by ``recess``."""
        middle = 0.5 * (begin + end)
        x, y = side.at(middle, -0.5 * (_WALL + recess))
        if material.tile:
            material = Material(
                material.texture, material.tile, material.tint, offset=(middle, 0.0)
            )
        self.solids.append(
            Box(
                x=x,
                y=y,
                length_x=_WALL - recess,
                length_y=end - begin,
                bottom=bottom,
                top=top,
                yaw=side.yaw,
                material=material,
            )
        )

    def _wall(
        self,
        side: _Side,
        paper: Material,
        along: float,
        width: float,
        span: tuple[float, float],
        behind: Material,
    ) -> None:
        """A wall with an opening, what closes the opening, and its frame."""
        left, right = along - 0.5 * width, along + 0.5 * width
        self.openings.append(_footprint(*side.at(along, 0.0), side.yaw, 0.3, width + 0.1))
        self._slab(side, paper, -side.half, left, _FLOOR, _CEILING)
        self._slab(side, paper, right, side.half + _WALL, _FLOOR, _CEILING)
        self._slab(side, paper, left, right, span[1], _CEILING)
        if span[0] > _FLOOR:
            self._slab(side, paper, left, right, _FLOOR, span[0])
        self._slab(side, behind, left, right, span[0], span[1], recess=0.18)
        white = Material('paint', 1.0, (1.1, 1.1, 1.1))
        bars = [(left, 0.05), (right, 0.05)]
        if behind.glow:
            bars.append((along, 0.04))
        for place, thick in bars:
            x, y = side.at(place, -0.08 if behind.glow and place == along else 0.0)
            self.solids.append(
                Box(
                    x=x,
                    y=y,
                    length_x=0.05,
                    length_y=thick,
                    bottom=span[0],
                    top=span[1],
                    yaw=side.yaw,
                    material=white,
                )
            )
        for z in (span[1], span[0]):
            if z > _FLOOR:
                x, y = side.at(along, 0.0)
                self.solids.append(
                    Box(
                        x=x,
                        y=y,
                        length_x=0.09 if z == span[0] else 0.05,
                        length_y=width + 0.08,
                        bottom=z - 0.025,
                        top=z + 0.025,
                        yaw=side.yaw,
                        material=white,
                    )
                )

    def _put(self, piece: Piece, x: float, y: float, yaw: float, z: float = _FLOOR) -> None:
        self.solids.extend(placed(solid, x, y, yaw, z) for solid in piece.solids)
        self.taken.append(_footprint(x, y, yaw, piece.depth, piece.width))

    def _fits(self, rectangle: Array, gap: float) -> bool:
        (x, y), (wide, long) = self.middle, self.size
        inside = np.abs(rectangle - (x, y)) <= (0.5 * wide - 0.01, 0.5 * long - 0.01)
        return (
            bool(inside.all())
            and _distance_from_axis(rectangle) >= CLEARANCE + 0.03
            and all(_apart(rectangle, other, gap) for other in self.taken)
        )

    def furnish(self) -> None:
        """Place pieces at walls, then free ones, then pictures; some may find no place."""
        rng = self.rng
        for make in AT_WALL:
            piece = make(rng)
            for _ in range(60):
                side = self.sides[int(rng.integers(4))]
                along = float(rng.uniform(-1.0, 1.0)) * (side.half - 0.5 * piece.width)
                x, y = side.at(along, 0.5 * piece.depth + 0.02)
                rectangle = _footprint(x, y, side.yaw, piece.depth, piece.width)
                if self._fits(rectangle, 0.05):
                    self._put(piece, x, y, side.yaw)
                    break
        for make, nearest, farthest in FREE:
            piece = make(rng)
            for _ in range(60):
                azimuth, away = rng.uniform(-math.pi, math.pi), rng.uniform(nearest, farthest)
                x, y = float(away * math.cos(azimuth)), float(away * math.sin(azimuth))
                yaw = float(rng.uniform(-math.pi, math.pi))
                rectangle = _footprint(x, y, yaw, piece.depth, piece.width)
                if self._fits(rectangle, 0.1):
                    self._put(piece, x, y, yaw)
                    break
        self._hang_pictures()

    def _hang_pictures(self) -> None:
        """Hang pictures on walls where neither opening nor tall furniture is."""
        rng = self.rng
        for _ in range(9):
            piece = picture(rng)
            side = self.sides[int(rng.integers(4))]
            along = float(rng.uniform(-1.0, 1.0)) * (side.half - 0.5 * piece.width - 0.1)
            x, y = side.at(along, 0.0)
            z = float(rng.uniform(0.15, 0.5))
            wall_strip = _footprint(*side.at(along, 0.0), side.yaw, 0.3, piece.width + 0.1)
            if all(_apart(wall_strip, other, 0.0) for other in self._tall(side, z, piece.height)):
                self.solids.extend(placed(s, x, y, side.yaw, z) for s in piece.solids)

    def _tall(self, side: _Side, z: float, height: float) -> list[Array]:
        """Footprints of what a picture would collide with: openings, any solid at its height."""
        low, high = z - 0.5 * height, z + 0.5 * height
        found = list(self.openings)
        for solid in self.solids[self.shell_size :]:
            if solid.top < low or solid.bottom > high:
                continue
            if isinstance(solid, Turned):
                edge = 2.0 * solid.largest_radius
                found.append(_footprint(solid.x, solid.y, 0.0, edge, edge))
            else:
                found.append(corners(solid))
        return found


def furnished_room(seed: int = 0) -> Room:
    """
    A room of about 4 m by 5 m full of furniture.

    Parameters
    ----------
    seed : int
        Each gives another room: size, walls, furniture, textures, light.

    Returns
    -------
    Room
        Nothing in it is closer to the axis than ``CLEARANCE``.
    """
    rng = np.random.default_rng(seed)
    textures = make_textures(rng)
    builder = _Builder(rng)
    builder.shell()
    builder.furnish()
    ceiling_lamp = (*builder.middle + rng.uniform(-0.5, 0.5, 2), _CEILING - 0.3, 0.58, 0.62, 0.68)
    day = (*builder.window, 0.6, 0.58, 0.52, 0.48)
    room = Room(builder.solids, textures, np.array([ceiling_lamp, day]), (0.47, 0.45, 0.45))
    room.expose()
    return room
