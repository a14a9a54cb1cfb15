"""What pieces of furniture are made of and what stands on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from panodepth_ros.camera.simulated.solids import (
    Box,
    Material,
    Solid,
    barrel,
    cone,
    cylinder,
    ellipsoid,
)
from panodepth_ros.camera.simulated.textures import SPINES

Tint = tuple[float, float, float]
Generator = np.random.Generator


@dataclass(frozen=True, slots=True)
class Piece:
    """Solids of one piece, its footprint (depth along x, width along y) and its height [m]."""

    solids: list[Solid]
    depth: float
    width: float
    height: float


def random_tint(rng: Generator, low: float, high: float, colour: float = 0.5) -> Tint:
    """A tint between two brightnesses; ``colour`` 0 is grey, 1 as colourful as chance has it."""
    grey = rng.uniform(low, high)
    blue, green, red = grey + colour * (rng.uniform(low, high, 3) - grey)
    return float(blue), float(green), float(red)


def fresh(rng: Generator, texture: str, tile: float, tint: Tint = (1.0, 1.0, 1.0)) -> Material:
    """A repeating material whose repeats begin anywhere."""
    shift = rng.uniform(0.0, tile, 2)
    return Material(texture, tile, tint, offset=(float(shift[0]), float(shift[1])))


def random_wood(rng: Generator) -> Material:
    """Light or dark wood of some shade."""
    shade = float(rng.uniform(0.7, 1.1))
    texture = 'wood' if rng.random() < 0.6 else 'dark_wood'
    return fresh(rng, texture, 1.0, (shade, shade, shade))


def block(
    x: float, y: float, bottom: float, size: tuple[float, float, float], material: Material
) -> Box:
    """A box by its centre seen from above, its lower end and its size."""
    return Box(
        x=x,
        y=y,
        length_x=size[0],
        length_y=size[1],
        bottom=bottom,
        top=bottom + size[2],
        material=material,
    )


def book(rng: Generator, x: float, y: float, z: float, size: tuple[float, float, float]) -> Box:
    """A book standing with its back to the front."""
    tint = random_tint(rng, 0.2, 1.0, 0.7)
    left = float(rng.integers(SPINES)) / SPINES
    back = Material('spines', tint=tint, part=(left, 0.0, 1.0 / SPINES, 1.0))
    return Box(
        x=x,
        y=y,
        length_x=size[0],
        length_y=size[1],
        bottom=z,
        top=z + size[2],
        material=Material('paint', 1.0, tint),
        faces={'+x': back},
    )


def ornament(rng: Generator, x: float, y: float, z: float) -> list[Solid]:
    """Something that stands on a table or a cabinet."""
    kind = int(rng.integers(4))
    if kind == 0:
        tint = random_tint(rng, 0.3, 1.0)
        glaze = fresh(rng, 'stone', 0.5, tint)
        radius, tall = float(rng.uniform(0.06, 0.1)), float(rng.uniform(0.2, 0.34))
        neck = 0.4 * radius
        return [
            barrel(x, y, radius, neck, z, z + tall, glaze),
            cone(x, y, neck, 0.7 * radius, z + tall, z + tall + 0.05, glaze),
        ]
    if kind == 1:
        size = (
            float(rng.uniform(0.16, 0.26)),
            float(rng.uniform(0.2, 0.34)),
            float(rng.uniform(0.14, 0.26)),
        )
        return [block(x, y, z, size, Material('cardboard', tint=random_tint(rng, 0.6, 1.0)))]
    if kind == 2:
        radius = float(rng.uniform(0.09, 0.14))
        globe = Material('view', 0.0, random_tint(rng, 0.6, 1.0))
        wood = random_wood(rng)
        return [
            cylinder(x, y, 0.08, z, z + 0.02, wood),
            cylinder(x, y, 0.012, z + 0.02, z + 0.08, wood),
            ellipsoid(x, y, z + 0.07 + radius, radius, radius, globe),
        ]
    lying: list[Solid] = []
    for _ in range(int(rng.integers(3, 7))):
        thick = float(rng.uniform(0.02, 0.045))
        tint = random_tint(rng, 0.3, 1.0)
        deep, wide = float(rng.uniform(0.13, 0.18)), float(rng.uniform(0.19, 0.27))
        cover = block(x, y, z, (deep, wide, thick), Material('spines', 0.6, tint))
        lying.append(cover)
        z += thick
    return lying
