"""Paintings: what frames and the window hold."""

from __future__ import annotations

import cv2
import numpy as np

from panodepth_ros.camera.simulated.patterns import (
    Generator,
    Picture,
    Plane,
    finish,
    noise,
    painted,
)

#: Paintings side by side and one above the other in the texture ``paintings``.
PAINTINGS = 2


def landscape(rng: Generator, size: int) -> Picture:
    """Hills under a sky, with trees."""
    ramp = np.linspace(0.0, 1.0, size, dtype=np.float32)[:, None, None]
    sky = (1 - ramp) * np.array((225, 180, 130)) + ramp * np.array((190, 215, 235))
    sky = sky + 10.0 * noise(rng, size, 300, 20, 1.5)[..., None]
    picture = finish(np.broadcast_to(sky, (size, size, 3)))
    x = np.arange(size)
    for depth in range(4):
        base = size * (0.45 + 0.14 * depth)
        phase = rng.uniform(0, 6.28, 3)
        ridge = base - sum(
            size * 0.05 / k * np.sin(2 * np.pi * k * x / size * 1.3 + phase[k - 1])
            for k in (1, 2, 3)
        )
        outline = np.column_stack([x, ridge]).round().astype(np.int32)
        outline = np.vstack([outline, [[size, size], [0, size]]])
        green = rng.uniform((40, 70, 40), (90, 130, 100)) * (0.6 + 0.13 * depth)
        cv2.fillPoly(picture, [outline], green.tolist(), cv2.LINE_AA)
        for tree in rng.integers(0, size, 5):
            foot = (int(tree), int(ridge[tree]))
            crown = int(size * rng.uniform(0.015, 0.05))
            cv2.circle(picture, foot, crown, (green * 0.7).tolist(), -1, cv2.LINE_AA)
    return picture


def _still_life(rng: Generator, size: int) -> Picture:
    """Round fruit on a cloth."""
    picture = finish(painted((70.0, 80.0, 100.0), 12.0 * noise(rng, size, 200, 10)))
    cv2.rectangle(picture, (0, round(size * 0.62)), (size, size), (170, 190, 205), -1)
    for _ in range(9):
        centre = (
            int(rng.uniform(0.1, 0.9) * size),
            int(rng.normal(0.6, 0.1) * size),
        )
        radius = int(size * rng.uniform(0.06, 0.14))
        colour = rng.uniform((20, 60, 120), (70, 190, 240))
        for step in range(4):
            part = (centre[0] - step * radius // 8, centre[1] - step * radius // 8)
            shade = np.clip(colour * (0.7 + 0.15 * step), 0, 255).tolist()
            cv2.circle(picture, part, radius * (4 - step) // 4, shade, -1, cv2.LINE_AA)
    return picture


def _abstract(rng: Generator, size: int) -> Picture:
    """Coloured fields between black bars."""
    picture = np.full((size, size, 3), 225, np.uint8)
    palette = [(40, 40, 190), (170, 80, 30), (50, 200, 235), (225, 225, 225), (60, 60, 60)]
    for _ in range(9):
        x, y = (int(v) for v in rng.integers(0, size, 2))
        wide, tall = (int(v) for v in rng.integers(size // 8, size // 2, 2))
        colour = palette[int(rng.integers(len(palette)))]
        cv2.rectangle(picture, (x, y), (x + wide, y + tall), colour, -1)
        cv2.rectangle(picture, (x, y), (x + wide, y + tall), (20, 20, 20), size // 40)
    return picture


def _poster(rng: Generator, size: int) -> Picture:
    """A page of print with a headline and a diagram."""
    picture = np.full((size, size, 3), (200, 215, 220), np.uint8)
    cv2.rectangle(picture, (20, 20), (size - 20, size // 6), (90, 60, 40), -1)
    for y in range(size // 4, size - 20, 14):
        stop = int(rng.uniform(0.5, 0.95) * size)
        cv2.line(picture, (24, y), (stop, y), (70, 70, 70), 4)
    centre = (round(size * 0.7), round(size * 0.6))
    cv2.circle(picture, centre, size // 5, (60, 110, 190), -1, cv2.LINE_AA)
    cv2.circle(picture, centre, size // 9, (215, 225, 230), -1, cv2.LINE_AA)
    return picture


def paintings(rng: Generator, size: int = 512) -> Plane:
    """All paintings in one picture."""
    half = size // PAINTINGS
    rows = [[landscape, _still_life], [_abstract, _poster]]
    pictures = [np.hstack([paint(rng, half) for paint in row]) for row in rows]
    return np.vstack(pictures).astype(np.float32)
