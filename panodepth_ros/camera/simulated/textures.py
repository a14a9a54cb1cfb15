"""
Procedural textures: everything that covers a wall, a floor or a piece of furniture.

A texture is a square, seamlessly repeating BGR picture. Each is kept with its halved copies
(a mip chain), so that a distant surface is sampled from a picture of its own resolution and
frames are free of aliasing. Brightness is that of the finished frame at full illumination.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.paintings import landscape, paintings
from panodepth_ros.camera.simulated.patterns import (
    Colour,
    Generator,
    Plane,
    cells,
    copies,
    finish,
    noise,
    painted,
    wood_grain,
)

#: Spines side by side in the texture ``spines``.
SPINES = 16
LEVELS = 9


class Textures(NamedTuple):
    """
    All textures in one pool, as the ray tracer reads them.

    Attributes
    ----------
    texels : ndarray of uint8, shape (3 * M,)
        BGR values of every level of every texture, row by row.
    start : ndarray of int64, shape (T, LEVELS)
        Index of a level's first texel.
    size : ndarray of int64, shape (T,)
        Edge of level 0 [px], a power of two; level k has ``size >> k``.
    """

    texels: npt.NDArray[np.uint8]
    start: npt.NDArray[np.int64]
    size: npt.NDArray[np.int64]


def _brick(rng: Generator, size: int = 1024) -> Plane:
    """2 m by 2 m of bricks, 8 by 28."""
    across, along, number = cells(size, 8, 28, 0.5)
    shade = rng.normal(0.0, 16.0, number.max() + 1).astype(np.float32)[number]
    hue = rng.normal(0.0, 7.0, number.max() + 1).astype(np.float32)[number]
    face = painted((62.0, 80.0, 142.0), shade, 9.0 * noise(rng, size, 64, 4, 0.7))
    face[..., 1] += hue
    mortar = painted((138.0, 146.0, 152.0), 7.0 * noise(rng, size, 40, 4, 0.5))
    edge = np.minimum(across, along) + 0.8 * noise(rng, size, 60, 10)
    share = np.clip((edge - 2.0) / 2.0, 0.0, 1.0)[..., None]
    wall: Plane = share * face + (1.0 - share) * mortar
    return wall


def _wallpaper(rng: Generator, size: int = 512) -> Plane:
    """0.53 m by 0.53 m: one repeat of a flower pattern on paper, as it comes off the roll."""
    paper = painted((176.0, 200.0, 206.0), 3.0 * noise(rng, size, 40, 3, 0.4))
    picture = finish(paper)
    petals = rng.uniform((40, 30, 120), (90, 80, 190))
    leaf = rng.uniform((50, 100, 60), (90, 140, 110))
    for step, (cx, cy) in enumerate([(0.25, 0.25), (0.75, 0.75), (0.72, 0.22), (0.2, 0.76)]):
        turn = rng.uniform(0, 360)
        big = step < 2
        radius = size * (0.105 if big else 0.055)
        for x, y in copies(cx * size, cy * size, size):
            for k in range(3):
                angle = np.deg2rad(turn + 120 * k)
                tip = (
                    round(x + 1.9 * radius * np.cos(angle)),
                    round(y + 1.9 * radius * np.sin(angle)),
                )
                axes = (round(radius * 0.75), round(radius * 0.28))
                degrees = turn + 120 * k + 25
                cv2.ellipse(picture, tip, axes, degrees, 0, 360, leaf.tolist(), -1, cv2.LINE_AA)
            for k in range(5):
                angle = np.deg2rad(turn + 72 * k)
                centre = (
                    round(x + 0.62 * radius * np.cos(angle)),
                    round(y + 0.62 * radius * np.sin(angle)),
                )
                axes = (round(radius * 0.62), round(radius * 0.42))
                colour = (petals * (1.0 if big else 1.25)).tolist()
                cv2.ellipse(picture, centre, axes, turn + 72 * k, 0, 360, colour, -1, cv2.LINE_AA)
            cv2.circle(picture, (x, y), round(radius * 0.25), (70, 180, 215), -1, cv2.LINE_AA)
    return picture.astype(np.float32) + 2.0 * noise(rng, size, 30, 3, 0.3)[..., None]


def _plaster(rng: Generator, size: int = 1024) -> Plane:
    """Painted plaster, 2.6 m by 2.6 m: hardly any texture."""
    stains = 2.2 * noise(rng, size, 1000, 60, 1.2)
    grain = 1.6 * noise(rng, size, 24, 3, 0.3)
    return painted((196.0, 206.0, 210.0), stains, grain)


def _roughcast(rng: Generator, size: int = 1024) -> Plane:
    """Coarse render, 2 m by 2 m."""
    pits = np.minimum(noise(rng, size, 40, 5, 0.6), 0.4)
    return painted((138.0, 160.0, 172.0), 9.0 * pits, 4.0 * noise(rng, size, 700, 60))


def _boards(rng: Generator, size: int, boards: int, colour: Colour, contrast: float) -> Plane:
    """Boards side by side, grain and joints running down the picture."""
    x = np.arange(size, dtype=np.float32) + 0.5
    wide = size / boards
    number = np.floor(x / wide).astype(np.int64)
    grain = wood_grain(rng, size, 20).T
    shifted = np.empty_like(grain)
    for board in range(boards):
        strip = number == board
        shifted[:, strip] = np.roll(grain[:, strip], int(rng.integers(size)), axis=0)
    joint = np.minimum(np.mod(x, wide), wide - np.mod(x, wide))
    shade = rng.normal(0.0, contrast, boards)[number] - 55.0 * np.exp(-((joint / 2.0) ** 2))
    lines = np.broadcast_to(shade.astype(np.float32), (size, size))
    return painted(colour, lines, 0.8 * contrast * shifted, 2.0 * noise(rng, size, 300, 30))


def _panel(rng: Generator, size: int = 1024) -> Plane:
    """Wood panelling, 1.6 m by 1.6 m, 12 boards."""
    return _boards(rng, size, 12, (74.0, 112.0, 158.0), 9.0)


def _parquet(rng: Generator, size: int = 1024) -> Plane:
    """Floor boards with butt joints, 1.8 m by 1.8 m."""
    plane = _boards(rng, size, 16, (66.0, 104.0, 150.0), 10.0)
    wide = size // 16
    for board in range(16):
        for end in rng.integers(0, size, 2):
            rows = np.mod(np.arange(end, end + 3), size)
            plane[rows, board * wide : (board + 1) * wide] -= 45.0
    return plane


def _carpet(rng: Generator, size: int = 512) -> Plane:
    """Short pile, 0.8 m by 0.8 m."""
    return painted((104.0, 96.0, 112.0), 9.0 * noise(rng, size, 30, 3, 0.2))


def _wood(rng: Generator, size: int = 512) -> Plane:
    """Light furniture wood, 1 m by 1 m, grain across the picture."""
    swing = 5.0 * noise(rng, size, 500, 100)
    return painted((112.0, 160.0, 200.0), 7.0 * wood_grain(rng, size, 14), swing)


def _dark_wood(rng: Generator, size: int = 512) -> Plane:
    """Stained furniture wood, 1 m by 1 m, grain across the picture."""
    swing = 4.0 * noise(rng, size, 500, 100)
    return painted((44.0, 66.0, 104.0), 6.0 * wood_grain(rng, size, 14), swing)


def _fabric(rng: Generator, size: int = 512) -> Plane:
    """Woven upholstery, 0.4 m by 0.4 m."""
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) * np.float32(2.0 * np.pi / size)
    weave = 5.0 * np.sin(64 * x) * np.sin(64 * y) + 4.0 * np.sign(np.sin(16 * (x + y)))
    return painted((150.0, 132.0, 96.0), weave, 5.0 * noise(rng, size, 200, 6, 0.6))


def _cardboard(rng: Generator, size: int = 512) -> Plane:
    """A side of a box: corrugation, tape and print; fitted to a face."""
    plane = painted((112.0, 152.0, 186.0), 2.5 * wood_grain(rng, size, 30).T)
    plane += 3.0 * noise(rng, size, 200, 20)[..., None]
    picture = finish(plane)
    middle = size // 2
    cv2.rectangle(picture, (0, middle - 26), (size, middle + 26), (140, 178, 205), -1)
    for _ in range(5):
        x, y = (int(v) for v in rng.integers(20, size - 150, 2))
        wide, tall = (int(v) for v in rng.integers(20, 130, 2))
        thickness = int(rng.choice([-1, 5]))
        cv2.rectangle(picture, (x, y), (x + wide, y + tall), (50, 62, 78), thickness, cv2.LINE_AA)
    cv2.putText(picture, 'FRAGILE', (60, 470), cv2.FONT_HERSHEY_DUPLEX, 2.4, (45, 50, 150), 6)
    return picture.astype(np.float32)


def _leaves(rng: Generator, size: int = 512) -> Plane:
    """Foliage, 0.5 m by 0.5 m."""
    picture = np.full((size, size, 3), (18, 40, 20), np.uint8)
    for depth in np.linspace(0.35, 1.0, 260):
        x, y = rng.uniform(0, size, 2)
        axes = (int(rng.integers(22, 46)), int(rng.integers(7, 14)))
        turn = rng.uniform(0, 360)
        green = rng.uniform((40, 110, 50), (80, 175, 110)) * depth
        for place in copies(x, y, size):
            cv2.ellipse(picture, place, axes, turn, 0, 360, green.tolist(), -1, cv2.LINE_AA)
            cv2.ellipse(picture, place, (axes[0], 1), turn, 0, 360, (green * 0.7).tolist(), 1)
    return picture.astype(np.float32)


def _paint(rng: Generator, size: int = 512) -> Plane:
    """Smooth varnish or metal: nearly nothing to see, 1 m by 1 m."""
    return painted((190.0, 194.0, 196.0), 1.5 * noise(rng, size, 300, 10, 0.8))


def _staves(rng: Generator, size: int = 512) -> Plane:
    """A quarter of a barrel, fitted to its height: staves running down."""
    return _boards(rng, size, 6, (52.0, 84.0, 126.0), 11.0)


def _stone(rng: Generator, size: int = 512) -> Plane:
    """Granite, 0.7 m by 0.7 m."""
    grains = 14.0 * noise(rng, size, 26, 4, 0.3)
    return painted((146.0, 146.0, 148.0), grains, 6.0 * noise(rng, size, 200, 30))


def _spines(rng: Generator, size: int = 512) -> Plane:
    """Backs of books side by side: bands and titles."""
    picture = np.full((size, size, 3), 185, np.uint8)
    wide = size // SPINES
    for book in range(SPINES):
        left = book * wide
        if rng.random() < 0.4:
            shade = rng.integers(120, 230, 3).tolist()
            top = int(rng.integers(20, 200))
            cv2.rectangle(picture, (left, top), (left + wide - 1, top + 130), shade, -1)
        ink = [30, 30, 30] if rng.random() < 0.5 else [245, 245, 245]
        for y in np.cumsum(rng.integers(18, 60, 12)):
            if y > size - 30:
                break
            inset = int(rng.integers(4, 12))
            tall = int(rng.integers(3, 14))
            corner = (left + wide - inset, int(y) + tall)
            cv2.rectangle(picture, (left + inset, int(y)), corner, ink, -1)
    return picture.astype(np.float32) + 4.0 * noise(rng, size, 60, 4, 0.5)[..., None]


def _view(rng: Generator, size: int = 512) -> Plane:
    """What the window shows."""
    return landscape(rng, size).astype(np.float32) * 1.12


def _door(rng: Generator, size: int = 512) -> Plane:
    """A door leaf with four panels, fitted to its face."""
    plane = painted((150.0, 176.0, 190.0), 3.0 * wood_grain(rng, size, 14).T)
    for top, bottom in ((0.06, 0.42), (0.5, 0.94)):
        for left, right in ((0.1, 0.46), (0.54, 0.9)):
            a, b, c, d = (round(v * size) for v in (top, bottom, left, right))
            plane[a:b, c:d] -= 22.0
            plane[a + 9 : b - 9, c + 9 : d - 9] += 15.0
    return plane


_MAKERS: dict[str, Callable[[Generator], Plane]] = {
    'brick': _brick,
    'wallpaper': _wallpaper,
    'plaster': _plaster,
    'roughcast': _roughcast,
    'panel': _panel,
    'parquet': _parquet,
    'carpet': _carpet,
    'wood': _wood,
    'dark_wood': _dark_wood,
    'fabric': _fabric,
    'cardboard': _cardboard,
    'leaves': _leaves,
    'paint': _paint,
    'staves': _staves,
    'stone': _stone,
    'spines': _spines,
    'paintings': paintings,
    'view': _view,
    'door': _door,
}

#: Names of the textures in the order of their numbers.
NAMES = tuple(_MAKERS)


def make_textures(rng: Generator) -> Textures:
    """Paint every texture and its halved copies."""
    chains = []
    starts = np.zeros((len(NAMES), LEVELS), np.int64)
    sizes = np.zeros(len(NAMES), np.int64)
    used = 0
    for number, name in enumerate(NAMES):
        level = np.clip(_MAKERS[name](rng), 0.0, 255.0)
        sizes[number] = len(level)
        for k in range(LEVELS):
            starts[number, k] = used
            chains.append(finish(level).reshape(-1, 3))
            used += len(chains[-1])
            level = 0.25 * (
                level[0::2, 0::2] + level[1::2, 0::2] + level[0::2, 1::2] + level[1::2, 1::2]
            )
    return Textures(np.concatenate(chains).ravel(), starts, sizes)
