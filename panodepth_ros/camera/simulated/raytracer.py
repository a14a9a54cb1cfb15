"""
Kernels that render the room: which rays a frame takes, what they see, and how they are blended.

All pixels of one column of a level camera lie in one upright plane. So the solids a column can
see, and the interval of t in which each may be hit, are found once per column; each ray then
looks at those few, nearest first, and asks only at which height it passes.
"""

from __future__ import annotations

import math

import numpy as np

from panodepth_ros.camera.simulated.hits import hit_box, hit_turned, interval
from panodepth_ros.camera.simulated.kernels import kernel
from panodepth_ros.camera.simulated.shading import shade
from panodepth_ros.camera.simulated.solids import BOX


@kernel
def _in_view(geometry, pose, lens, width, height, chosen):  # type: ignore[no-untyped-def]
    """Write the numbers of the solids that may be in view into ``chosen``; return how many."""
    shape = geometry.shape
    ox, oy, oz, azimuth = pose
    fx, fy, cx, cy = lens
    axis_x, axis_y = math.cos(azimuth), math.sin(azimuth)
    left, right = (cx + 1.0) / fx, (width - cx) / fx
    # Of an image that the horizon does not cross what is near counts, too, on one side.
    up, down = max(0.0, (cy + 1.0) / fy), max(0.0, (height - cy) / fy)
    left_scale, right_scale = math.sqrt(1.0 + left * left), math.sqrt(1.0 + right * right)
    count = 0
    for k in range(len(geometry.kind)):
        x, y = shape[k, 0] - ox, shape[k, 1] - oy
        radius = shape[k, 7]
        if geometry.kind[k] == BOX:
            radius = math.sqrt(shape[k, 6] ** 2 + shape[k, 7] ** 2)
        ahead, aside = axis_x * x + axis_y * y, axis_x * y - axis_y * x
        far = math.sqrt(x * x + y * y) + radius
        if (
            ahead > -radius
            and aside - left * ahead < radius * left_scale
            and -aside - right * ahead < radius * right_scale
            and shape[k, 2] < oz + up * far
            and shape[k, 3] > oz - down * far
        ):
            chosen[count] = k
            count += 1
    return count


@kernel
def _trace(geometry, chosen, ox, oy, oz, dx, dy, rises, distance, seen):  # type: ignore[no-untyped-def]
    """
    Find what the rays of one upright plane see.

    ``dx, dy`` is their common horizontal direction, of length 1; ``rises`` holds each ray's dz.
    ``distance`` receives t and ``seen`` 8·solid + face, −1 for nothing.
    """
    kind, shape = geometry.kind, geometry.shape
    # Solids this plane cuts, by the distance at which it first meets them.
    order = np.empty(len(chosen), np.int64)
    begin, end = np.empty(len(chosen)), np.empty(len(chosen))
    side = np.empty(len(chosen), np.int64)
    nearby = 0
    for n in range(len(chosen)):
        first, last, face = interval(kind, shape, chosen[n], ox, oy, dx, dy)
        if first > last or last < 0.0:
            continue
        place = nearby
        while place > 0 and begin[order[place - 1]] > first:
            order[place] = order[place - 1]
            place -= 1
        order[place], begin[n], end[n], side[n] = n, first, last, face
        nearby += 1
    for j in range(len(rises)):
        dz = rises[j]
        best, hit = math.inf, -1
        for place in range(nearby):
            n = order[place]
            if begin[n] > best:
                break
            k = chosen[n]
            if kind[k] == BOX:
                t, face = hit_box(shape, k, begin[n], end[n], side[n], oz, dz)
            else:
                t, face = hit_turned(shape, k, ox, oy, oz, dx, dy, dz)
            if t < best:
                best, hit = t, 8 * k + face
        distance[j], seen[j] = best, hit


@kernel
def _colour(  # type: ignore[no-untyped-def]
    geometry, surfaces, textures, light, ox, oy, oz, rays, rises, distance, seen, spread, samples
):
    """
    Shade the rays of one column of pixels, two by two of one pixel at once if they see one face.

    ``rays`` holds horizontal directions by half column and odd or even row, shape (2, 2, 2),
    ``rises`` dz by half column and row, and ``spread`` the angle of one pixel [rad].
    ``samples`` receives the colours.
    """
    for j in range(0, samples.shape[1], 2):
        same = seen[0, j] == seen[0, j + 1] == seen[1, j] == seen[1, j + 1]
        for n in range(1 if same else 4):
            h, i = n & 1, j + (n >> 1)
            t, dz, size = distance[h, i], rises[h, i], 0.5
            dx, dy = rays[h, i & 1, 0], rays[h, i & 1, 1]
            if same:
                t = 0.25 * (t + distance[1, i] + distance[0, i + 1] + distance[1, i + 1])
                dx = 0.25 * (dx + rays[0, 1, 0] + rays[1, 0, 0] + rays[1, 1, 0])
                dy = 0.25 * (dy + rays[0, 1, 1] + rays[1, 0, 1] + rays[1, 1, 1])
                dz, size = 0.5 * (dz + rises[1, i + 1]), 1.0
            blue = green = red = np.float32(0.0)
            if seen[h, i] >= 0:
                length = math.sqrt(1.0 + dz * dz)
                blue, green, red = shade(
                    geometry,
                    surfaces,
                    textures,
                    light,
                    seen[h, i] >> 3,
                    seen[h, i] & 7,
                    ox + t * dx,
                    oy + t * dy,
                    oz + t * dz,
                    dx / length,
                    dy / length,
                    dz / length,
                    t * length * size * spread,
                )
            for a in range(2 if same else 1):
                for b in range(2 if same else 1):
                    samples[h + a, i + b, 0] = blue
                    samples[h + a, i + b, 1] = green
                    samples[h + a, i + b, 2] = red


@kernel
def _blur_down(samples, half, column):  # type: ignore[no-untyped-def]
    """Weights 1 3 3 1 along a half column: from two rays a pixel to one value a pixel."""
    outer, inner = np.float32(0.125), np.float32(0.375)
    for v in range(column.shape[0]):
        j = 2 * v + 1
        for c in range(3):
            value = outer * (samples[half, j, c] + samples[half, j + 3, c])
            column[v, c] = value + inner * (samples[half, j + 1, c] + samples[half, j + 2, c])


@kernel
def _blur_across(columns, before, middle, after, image, u):  # type: ignore[no-untyped-def]
    """Weights 1 3 3 1 across four half columns: one column of the image, in grey levels."""
    outer, inner = np.float32(0.125), np.float32(0.375)
    for v in range(image.shape[0]):
        for c in range(3):
            value = outer * (columns[before, v, c] + columns[after, v, c])
            value += inner * (columns[middle, v, c] + columns[middle + 1, v, c])
            image[v, u, c] = np.uint8(min(value + np.float32(0.5), np.float32(255.0)))


@kernel
def render(geometry, surfaces, textures, light, pose, lens, image):  # type: ignore[no-untyped-def]
    """
    Render one frame of a level camera.

    Two by two rays pass through every pixel and find what is seen; those of the odd rows stand
    a quarter pixel beside those of the even ones, so that upright edges cross them in small
    steps. If all four see one face it is shaded once, else once per ray. A pixel is then the
    mean of the 4 by 4 rays in and around it with weights 1 3 3 1 in either direction, which is
    about the blur of a good lens.

    Parameters
    ----------
    geometry, surfaces, textures, light : Geometry, Surfaces, Textures, Light
        The room.
    pose : (float, float, float, float)
        Optical centre x, y, z [m] and azimuth of the optical axis [rad].
    lens : (float, float, float, float)
        fx, fy, cx, cy [px].
    image : ndarray of uint8, shape (H, W, 3)
        Receives blue, green, red.
    """
    ox, oy, oz, azimuth = pose
    fx, fy, cx, cy = lens
    height, width = image.shape[0], image.shape[1]
    chosen = np.empty(len(geometry.kind), np.int64)
    chosen = chosen[: _in_view(geometry, pose, lens, width, height, chosen)]
    # One pixel beyond every border, two rays per pixel.
    rows = 2 * (height + 2)
    slopes = (cy - (0.5 * np.arange(rows) - 1.25)) / fy
    rays, rises = np.empty((2, 2, 2)), np.empty((2, rows))
    distance, seen = np.empty((2, rows)), np.empty((2, rows), np.int64)
    samples = np.empty((2, rows, 3), np.float32)
    # The last three pairs of half columns, already blurred along the column.
    columns = np.empty((6, height, 3), np.float32)
    axis_x, axis_y = math.cos(azimuth), math.sin(azimuth)
    for u in range(-1, width + 1):
        for plane in range(4):
            half, odd = plane >> 1, plane & 1
            across = (u - 0.375 + 0.5 * half + 0.25 * odd - cx) / fx
            scale = 1.0 / math.sqrt(1.0 + across * across)
            dx, dy = scale * (axis_x + across * axis_y), scale * (axis_y - across * axis_x)
            rays[half, odd, 0], rays[half, odd, 1] = dx, dy
            rises[half, odd::2] = scale * slopes[odd::2]
            _trace(
                geometry,
                chosen,
                ox,
                oy,
                oz,
                dx,
                dy,
                rises[half, odd::2],
                distance[half, odd::2],
                seen[half, odd::2],
            )
        _colour(
            geometry,
            surfaces,
            textures,
            light,
            ox,
            oy,
            oz,
            rays,
            rises,
            distance,
            seen,
            1.0 / fx,
            samples,
        )
        now, before = 2 * ((u + 1) % 3), 2 * (u % 3)
        for half in range(2):
            _blur_down(samples, half, columns[now + half])
        if u >= 1:
            _blur_across(columns, 2 * ((u - 1) % 3) + 1, before, now, image, u - 1)
