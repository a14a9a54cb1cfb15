"""
Pieces of furniture, each made of solids in a frame of its own.

The frame stands on the floor in the middle of the piece's footprint: x out of its front, y to
the left of who looks out of it, z up, metres. Every maker draws its sizes and colours anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from panodepth_ros.camera.simulated.furniture_parts import (
    Generator,
    Piece,
    block,
    book,
    fresh,
    ornament,
    random_tint,
    random_wood,
)
from panodepth_ros.camera.simulated.paintings import PAINTINGS
from panodepth_ros.camera.simulated.solids import (
    Box,
    Material,
    Solid,
    barrel,
    cone,
    cylinder,
    ellipsoid,
)


def bookshelf(rng: Generator) -> Piece:
    """Open shelves, some full of books, some half empty."""
    depth, width = float(rng.uniform(0.26, 0.34)), float(rng.uniform(0.8, 1.15))
    levels = int(rng.integers(4, 7))
    pitch = 0.34
    height = levels * pitch + 0.06
    wood, back = random_wood(rng), random_wood(rng)
    board = 0.022
    inner = width - 2 * board
    solids: list[Solid] = [
        block(0.0, s * 0.5 * (width - board), 0.0, (depth, board, height), wood) for s in (-1, 1)
    ]
    solids.append(block(-0.5 * depth + 0.006, 0.0, 0.0, (0.012, inner, height), back))
    for level in range(levels + 1):
        z = 0.03 + level * pitch
        solids.append(block(0.0, 0.0, z, (depth - 0.005, inner, board), wood))
        if level == levels:
            break
        y = -0.5 * inner + 0.01
        stop = 0.5 * inner - 0.03 if rng.random() < 0.7 else float(rng.uniform(-0.1, 0.4)) * inner
        while y < stop:
            thick = float(rng.uniform(0.018, 0.05))
            deep = float(rng.uniform(0.6, 0.92)) * (depth - 0.02)
            tall = float(rng.uniform(0.6, 0.94)) * (pitch - board)
            x = -0.5 * depth + 0.014 + 0.5 * deep
            solids.append(book(rng, x, y + 0.5 * thick, z + board, (deep, thick, tall)))
            y += thick + (float(rng.uniform(0.0, 0.06)) if rng.random() < 0.1 else 0.001)
    return Piece(solids, depth, width, height)


def cabinet(rng: Generator) -> Piece:
    """Chest of drawers with things on it."""
    depth, width = float(rng.uniform(0.4, 0.52)), float(rng.uniform(0.8, 1.3))
    height = float(rng.uniform(0.62, 1.1))
    body = random_wood(rng)
    solids: list[Solid] = [
        block(0.0, 0.0, 0.06, (depth - 0.02, width - 0.03, height - 0.09), body),
        block(0.0, 0.0, height - 0.03, (depth + 0.02, width, 0.03), random_wood(rng)),
        block(
            -0.02,
            0.0,
            0.0,
            (depth - 0.08, width - 0.1, 0.06),
            Material('paint', 1.0, (0.2, 0.2, 0.2)),
        ),
    ]
    rows, columns = (int(v) for v in (rng.integers(2, 4), rng.integers(1, 4)))
    tall, wide = (height - 0.13) / rows, (width - 0.05) / columns
    knob = Material('paint', 1.0, random_tint(rng, 0.2, 0.5))
    front = fresh(rng, body.texture, 1.0, body.tint)
    for row in range(rows):
        for column in range(columns):
            y = (column - 0.5 * (columns - 1)) * wide
            z = 0.08 + row * tall
            size = (0.015, wide - 0.02, tall - 0.02)
            solids.append(block(0.5 * depth - 0.005, y, z, size, front))
            solids.append(
                ellipsoid(0.5 * depth + 0.016, y, z + 0.5 * tall - 0.01, 0.016, 0.016, knob)
            )
    for y in np.arange(-0.5 * width + 0.2, 0.5 * width - 0.15, 0.34):
        if rng.random() < 0.75:
            shift = rng.uniform(-0.05, 0.05, 2)
            solids.extend(ornament(rng, float(shift[0]), float(y + shift[1]), height))
    return Piece(solids, depth + 0.05, width, height)


def table(rng: Generator) -> Piece:
    """Table with four legs, a lamp, a screen or other things on it."""
    depth, width = float(rng.uniform(0.6, 0.75)), float(rng.uniform(1.0, 1.5))
    height = float(rng.uniform(0.71, 0.76))
    wood = random_wood(rng)
    solids: list[Solid] = [block(0.0, 0.0, height - 0.03, (depth, width, 0.03), wood)]
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (0.5 * depth - 0.05), sy * (0.5 * width - 0.05)
            solids.append(block(x, y, 0.0, (0.05, 0.05, height - 0.03), wood))
    solids.append(block(-0.5 * depth + 0.06, 0.0, height - 0.13, (0.02, width - 0.1, 0.1), wood))
    grey = Material('paint', 1.0, (0.25, 0.25, 0.27))
    y = float(rng.uniform(-0.2, 0.2))
    solids += [
        block(-0.1, y, height, (0.18, 0.26, 0.015), grey),
        block(-0.12, y, height + 0.015, (0.03, 0.05, 0.12), grey),
        Box(
            x=-0.08,
            y=y,
            length_x=0.04,
            length_y=0.52,
            bottom=height + 0.1,
            top=height + 0.43,
            material=grey,
            faces={'+x': Material('view', tint=(0.7, 0.7, 0.7), glow=0.8)},
        ),
    ]
    for y in (-0.5 * width + 0.18, 0.5 * width - 0.18):
        solids.extend(ornament(rng, float(rng.uniform(-0.12, 0.12)), float(y), height))
    return Piece(solids, depth, width, height)


def chair(rng: Generator) -> Piece:
    """Chair with a slatted back."""
    wide, deep, seat = 0.44, 0.44, float(rng.uniform(0.43, 0.48))
    height = float(rng.uniform(0.86, 1.05))
    tint = random_tint(rng, 0.4, 1.0)
    wood = fresh(rng, 'wood', 1.0, tint)
    solids: list[Solid] = [block(0.0, 0.0, seat - 0.035, (deep, wide, 0.035), wood)]
    for sy in (-1, 1):
        y = sy * (0.5 * wide - 0.025)
        solids.append(block(0.5 * deep - 0.03, y, 0.0, (0.035, 0.035, seat - 0.035), wood))
        solids.append(block(-0.5 * deep + 0.02, y, 0.0, (0.035, 0.035, height), wood))
    solids.append(block(-0.5 * deep + 0.02, 0.0, height - 0.09, (0.025, wide, 0.09), wood))
    for y in np.linspace(-0.13, 0.13, 4):
        slat = (0.015, 0.035, height - 0.09 - seat)
        solids.append(block(-0.5 * deep + 0.02, float(y), seat, slat, wood))
    return Piece(solids, deep, wide, height)


def sofa(rng: Generator) -> Piece:
    """Upholstered sofa with cushions."""
    depth, width = float(rng.uniform(0.78, 0.88)), float(rng.uniform(1.3, 1.8))
    height = float(rng.uniform(0.82, 0.98))
    cloth = fresh(rng, 'fabric', 0.4, random_tint(rng, 0.5, 1.15))
    solids: list[Solid] = [
        block(0.0, 0.0, 0.08, (depth, width, 0.32), cloth),
        block(-0.5 * depth + 0.11, 0.0, 0.4, (0.22, width, height - 0.4), cloth),
    ]
    for sy in (-1, 1):
        y = sy * (0.5 * width - 0.09)
        solids.append(block(0.03, y, 0.4, (depth - 0.06, 0.18, 0.2), cloth))
    for y in np.linspace(-0.28, 0.28, 3) * width:
        if rng.random() < 0.7:
            solids.append(
                Box(
                    x=-0.04,
                    y=float(y),
                    length_x=0.13,
                    length_y=0.42,
                    bottom=0.4,
                    top=0.4 + float(rng.uniform(0.36, 0.42)),
                    yaw=float(rng.uniform(-0.25, 0.25)),
                    material=fresh(rng, 'wallpaper', 0.3, random_tint(rng, 0.5, 1.1)),
                )
            )
    return Piece(solids, depth, width, height)


def lamp(rng: Generator) -> Piece:
    """Standing lamp: a thin pole with a shade."""
    height, radius = float(rng.uniform(1.4, 1.7)), float(rng.uniform(0.009, 0.016))
    metal = Material('paint', 1.0, random_tint(rng, 0.15, 0.4))
    shade = Material('paint', 1.0, (0.72, 0.9, 1.02), glow=1.0)
    solids: list[Solid] = [
        cylinder(0.0, 0.0, 0.14, 0.0, 0.03, metal),
        cylinder(0.0, 0.0, radius, 0.03, height - 0.2, metal),
        cone(0.0, 0.0, 0.2, 0.12, height - 0.26, height, shade),
    ]
    return Piece(solids, 0.4, 0.4, height)


def plant(rng: Generator) -> Piece:
    """Pot plant: a thin stem or two and tufts of leaves."""
    pot_height = float(rng.uniform(0.26, 0.36))
    clay = fresh(rng, 'roughcast', 0.8, (0.5, 0.65, 1.0))
    stem = Material('dark_wood', 0.6)
    solids: list[Solid] = [
        cone(0.0, 0.0, 0.12, 0.17, 0.0, pot_height, clay),
        cylinder(0.0, 0.0, 0.013, pot_height, 1.15, stem),
    ]
    for _ in range(int(rng.integers(34, 48))):
        turn, out = float(rng.uniform(0.0, 2.0 * math.pi)), float(rng.uniform(0.02, 0.21))
        z = float(rng.uniform(0.55, 1.25))
        radius, half = float(rng.uniform(0.03, 0.085)), float(rng.uniform(0.012, 0.035))
        green = float(rng.uniform(0.8, 1.5))
        leaf = fresh(rng, 'leaves', 0.4, (green, green, green))
        solids.append(ellipsoid(out * math.cos(turn), out * math.sin(turn), z, radius, half, leaf))
    return Piece(solids, 0.5, 0.5, 1.35)


def cask(rng: Generator) -> Piece:
    """Wooden barrel with iron hoops."""
    height, belly = float(rng.uniform(0.86, 1.08)), float(rng.uniform(0.27, 0.33))
    ends = 0.8 * belly
    staves = fresh(rng, 'staves', 0.55, (1.1, 1.1, 1.1))
    iron = fresh(rng, 'stone', 0.5, (0.4, 0.38, 0.38))
    body = barrel(0.0, 0.0, belly, ends, 0.0, height, staves)
    solids: list[Solid] = [body]
    for middle in (0.06, 0.28, 0.72, 0.94):
        low, high = middle * height - 0.022, middle * height + 0.022
        below, above = (math.sqrt(body.radius_squared(z)) + 0.005 for z in (low, high))
        solids.append(cone(0.0, 0.0, below, above, low, high, iron))
    return Piece(solids, 2 * belly + 0.02, 2 * belly + 0.02, height)


def boxes(rng: Generator) -> Piece:
    """A stack of cardboard boxes, none quite above the other."""
    solids: list[Solid] = []
    z = 0.0
    height = float(rng.uniform(0.85, 1.35))
    while z < height:
        size = rng.uniform((0.3, 0.34, 0.24), (0.44, 0.52, 0.42)) * (1.0 - 0.12 * z)
        shift = rng.uniform(-0.03, 0.03, 2)
        solids.append(
            Box(
                x=float(shift[0]),
                y=float(shift[1]),
                length_x=float(size[0]),
                length_y=float(size[1]),
                bottom=z,
                top=z + float(size[2]),
                yaw=float(rng.uniform(-0.25, 0.25)),
                material=Material('cardboard', tint=random_tint(rng, 0.75, 1.05)),
            )
        )
        z += float(size[2])
    return Piece(solids, 0.62, 0.66, z)


def pillar(rng: Generator) -> Piece:
    """Round stone column from floor to ceiling."""
    radius = float(rng.uniform(0.1, 0.17))
    stone = fresh(rng, 'stone', 0.7)
    plinth = radius + 0.04
    solids: list[Solid] = [
        cylinder(0.0, 0.0, radius, 0.0, 2.6, stone),
        block(0.0, 0.0, 0.0, (2 * plinth, 2 * plinth, 0.12), stone),
    ]
    return Piece(solids, 2 * plinth, 2 * plinth, 2.6)


def wardrobe(rng: Generator) -> Piece:
    """Tall cupboard with two doors."""
    depth, width = float(rng.uniform(0.5, 0.6)), float(rng.uniform(0.9, 1.2))
    height = float(rng.uniform(1.7, 2.0))
    wood = random_wood(rng)
    leaf = Material('door', tint=random_tint(rng, 0.7, 1.0))
    solids: list[Solid] = [
        block(-0.01, 0.0, 0.0, (depth - 0.02, width, height), wood),
        block(0.0, 0.0, height, (depth + 0.03, width + 0.03, 0.04), wood),
    ]
    knob = Material('paint', 1.0, (0.3, 0.5, 0.6))
    for sy in (-1, 1):
        half = 0.5 * width - 0.012
        size = (0.02, half, height - 0.1)
        solids.append(block(0.5 * depth - 0.01, sy * 0.25 * width, 0.06, size, leaf))
        solids.append(ellipsoid(0.5 * depth + 0.02, sy * 0.05, 0.98, 0.02, 0.02, knob))
    return Piece(solids, depth + 0.05, width + 0.03, height)


def picture(rng: Generator) -> Piece:
    """Framed painting, to hang with its back at x = 0 and its middle at z = 0."""
    width, height = (float(v) for v in rng.uniform(0.3, 0.75, 2))
    frame = Material('dark_wood', 1.0, random_tint(rng, 0.4, 1.4))
    column, row = (float(v) / PAINTINGS for v in rng.integers(0, PAINTINGS, 2))
    share = 1.0 / PAINTINGS
    inset = 0.02
    part = (
        column + inset * share,
        row + inset * share,
        share * (1 - 2 * inset),
        share * (1 - 2 * inset),
    )
    solids: list[Solid] = [
        block(0.0125, 0.0, -0.5 * height, (0.025, width, height), frame),
        Box(
            x=0.014,
            y=0.0,
            length_x=0.026,
            length_y=width - 0.06,
            bottom=-0.5 * height + 0.03,
            top=0.5 * height - 0.03,
            material=frame,
            faces={'+x': Material('paintings', part=part)},
        ),
    ]
    return Piece(solids, 0.03, width, height)


Maker = Callable[[Generator], Piece]

#: What stands with its back to a wall.
AT_WALL: tuple[Maker, ...] = (bookshelf, cabinet, table, sofa, wardrobe, bookshelf, cabinet)
#: What stands free, and within which distances of the axis its middle should be [m].
FREE: tuple[tuple[Maker, float, float], ...] = (
    (cask, 0.9, 1.4),
    (chair, 0.85, 1.5),
    (boxes, 0.95, 1.9),
    (lamp, 0.75, 1.7),
    (plant, 0.9, 1.9),
    (pillar, 0.75, 2.0),
    (chair, 1.2, 2.2),
)
