"""
Kernels that cast rays into a room of upright solids.

A ray is origin + t·direction. Seen from above every solid is a rectangle or a circle, and all
pixels of one column of a level camera lie in one upright plane. So the solids a column can see,
and the interval of t in which each may be hit, are found once per column; each ray then looks at
those few, nearest first, and asks only at which height it passes. Distances are exact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from panodepth_ros.camera.simulated.solids import BOX
from panodepth_ros.camera.simulated.textures import LEVELS

#: Face numbers, see ``solids.FACES``.
TOP, BOTTOM = 4, 5
_TINY = 1e-12
#: Levels of halving per natural logarithm; the oldest numba we support has no log2.
_PER_LOG = 1.0 / math.log(2.0)


class Light(NamedTuple):
    """
    Two lamps and what the room does to their light.

    Attributes
    ----------
    lamps : ndarray of float32, shape (2, 6)
        x, y, z [m] and strength in blue, green, red.
    ambient : ndarray of float32, shape (3,)
        Light from everywhere: blue, green, red.
    grid : ndarray of float32, shape (X * Y * Z * 3,)
        At points of a lattice: how open the surroundings are, and how much of either lamp is
        seen; 0 to 1.
    shape : ndarray of int64, shape (3,)
        X, Y, Z.
    lattice : ndarray of float64, shape (4,)
        First point of the lattice x, y, z and distance between its points [m].
    """

    lamps: npt.NDArray[np.float32]
    ambient: npt.NDArray[np.float32]
    grid: npt.NDArray[np.float32]
    shape: npt.NDArray[np.int64]
    lattice: npt.NDArray[np.float64]


@njit(cache=True, nogil=True, error_model='numpy')
def _slab(position, direction, half):  # type: ignore[no-untyped-def]
    """Interval of t in which a coordinate is between -half and half; reversed for never."""
    if abs(direction) < _TINY:
        if abs(position) > half:
            return math.inf, -math.inf
        return -math.inf, math.inf
    near, far = (-half - position) / direction, (half - position) / direction
    return min(near, far), max(near, far)


@njit(cache=True, nogil=True, error_model='numpy')
def _interval(kind, shape, k, ox, oy, dx, dy):  # type: ignore[no-untyped-def]
    """
    Interval of t in which a ray, seen from above, is over a solid, and the side it enters.

    Returns first, last (first > last: never) and the face of a box it comes in through.
    """
    x, y = ox - shape[k, 0], oy - shape[k, 1]
    if kind[k] == BOX:
        c, s = shape[k, 4], shape[k, 5]
        ldx, ldy = c * dx + s * dy, c * dy - s * dx
        first, last = _slab(c * x + s * y, ldx, shape[k, 6])
        begin, end = _slab(c * y - s * x, ldy, shape[k, 7])
        if begin > first:
            return begin, min(last, end), 3 if ldy > 0.0 else 2
        return first, min(last, end), 1 if ldx > 0.0 else 0
    square = dx * dx + dy * dy
    outside = x * x + y * y - shape[k, 7] * shape[k, 7]
    along = x * dx + y * dy
    root = along * along - square * outside
    if square < _TINY * _TINY:
        if outside > 0.0:
            return math.inf, -math.inf, 0
        return -math.inf, math.inf, 0
    if root < 0.0:
        return math.inf, -math.inf, 0
    root = math.sqrt(root)
    return (-along - root) / square, (-along + root) / square, 0


@njit(cache=True, nogil=True, error_model='numpy')
def _hit_box(shape, k, first, last, side, oz, dz):  # type: ignore[no-untyped-def]
    """Where a ray meets a box from outside: t, +inf for never, and the face."""
    begin = max(first, 0.0)
    height = oz if begin == 0.0 else oz + begin * dz
    if height > shape[k, 3]:
        if dz < 0.0:
            t = (shape[k, 3] - oz) / dz
            if t <= last:
                return t, TOP
    elif height < shape[k, 2]:
        if dz > 0.0:
            t = (shape[k, 2] - oz) / dz
            if t <= last:
                return t, BOTTOM
    elif first > 0.0:
        return first, side
    return math.inf, 0


@njit(cache=True, nogil=True, error_model='numpy')
def _hit_turned(shape, k, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Where a ray meets a turned solid from outside: t, +inf for never, and the face."""
    best, face = math.inf, 0
    x, y = ox - shape[k, 0], oy - shape[k, 1]
    p, q, r = shape[k, 4], shape[k, 5], shape[k, 6]
    a = dx * dx + dy * dy - r * dz * dz
    b = x * dx + y * dy - (0.5 * q + r * oz) * dz
    c = x * x + y * y - (p + q * oz + r * oz * oz)
    root = b * b - a * c
    if root >= 0.0:
        # The stable pair of solutions: neither subtracts nearly equal numbers.
        m = -b - math.copysign(math.sqrt(root), b)
        for t in (m / a, c / m):
            if 0.0 < t < best:
                z = oz + t * dz
                if shape[k, 2] <= z <= shape[k, 3] and p + q * z + r * z * z >= 0.0:
                    best = t
    if dz != 0.0:
        for end in (TOP, BOTTOM):
            z = shape[k, 3] if end == TOP else shape[k, 2]
            t = (z - oz) / dz
            if 0.0 < t < best:
                ex, ey = x + t * dx, y + t * dy
                if ex * ex + ey * ey <= p + q * z + r * z * z:
                    best, face = t, end
    return best, face


@njit(cache=True, nogil=True, error_model='numpy')
def cast(geometry, origins, directions, distances):  # type: ignore[no-untyped-def]
    """
    First t of every ray.

    Parameters
    ----------
    geometry : Geometry
        The solids.
    origins, directions : ndarray of float64, shape (M, 3)
        Rays; t counts in lengths of the direction.
    distances : ndarray of float64, shape (M,)
        Receives t, +inf where a ray meets nothing.
    """
    kind, shape = geometry.kind, geometry.shape
    for i in range(len(distances)):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        best = math.inf
        for k in range(len(kind)):
            first, last, side = _interval(kind, shape, k, ox, oy, dx, dy)
            if first > last or last < 0.0 or first > best:
                continue
            if kind[k] == BOX:
                t, _ = _hit_box(shape, k, first, last, side, oz, dz)
            else:
                t, _ = _hit_turned(shape, k, ox, oy, oz, dx, dy, dz)
            best = min(best, t)
        distances[i] = best


@njit(cache=True, nogil=True, error_model='numpy')
def inside(geometry, points, flags):  # type: ignore[no-untyped-def]
    """
    Whether points lie in a solid.

    Parameters
    ----------
    geometry : Geometry
        The solids.
    points : ndarray of float64, shape (M, 3)
        Points [m].
    flags : ndarray of bool, shape (M,)
        Receives the answer.
    """
    kind, shape = geometry.kind, geometry.shape
    for i in range(len(flags)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        flags[i] = False
        for k in range(len(kind)):
            if not shape[k, 2] <= z <= shape[k, 3]:
                continue
            lx, ly = x - shape[k, 0], y - shape[k, 1]
            if kind[k] == BOX:
                c, s = shape[k, 4], shape[k, 5]
                if abs(c * lx + s * ly) <= shape[k, 6] and abs(c * ly - s * lx) <= shape[k, 7]:
                    flags[i] = True
                    break
            elif lx * lx + ly * ly <= shape[k, 4] + shape[k, 5] * z + shape[k, 6] * z * z:
                flags[i] = True
                break


@njit(cache=True, nogil=True, error_model='numpy')
def _mix(texels, a, b, c, d, u, v):  # type: ignore[no-untyped-def]
    """Between four neighbouring values."""
    upper = np.float32(texels[a]) + u * (np.float32(texels[b]) - np.float32(texels[a]))
    lower = np.float32(texels[c]) + u * (np.float32(texels[d]) - np.float32(texels[c]))
    return upper + v * (lower - upper)


@njit(cache=True, nogil=True, error_model='numpy')
def _texture(textures, number, column, row, level):  # type: ignore[no-untyped-def]
    """Sample a texture at a position in repeats, between two levels: blue, green, red."""
    level = min(max(level, np.float32(0.0)), np.float32(LEVELS - 1.001))
    low = int(level)
    between = level - np.float32(low)
    texels = textures.texels
    blue = green = red = np.float32(0.0)
    for k in range(low, low + 2):
        share = between if k > low else np.float32(1.0) - between
        size = textures.size[number] >> k
        mask = size - 1
        u = column * np.float32(size) - np.float32(0.5)
        v = row * np.float32(size) - np.float32(0.5)
        left, upper = math.floor(u), math.floor(v)
        u, v = u - np.float32(left), v - np.float32(upper)
        u0, v0 = int(left) & mask, int(upper) & mask
        start = 3 * textures.start[number, k]
        u1, v1 = 3 * ((u0 + 1) & mask), start + 3 * ((v0 + 1) & mask) * size
        u0, v0 = 3 * u0, start + 3 * v0 * size
        # Unsigned: numba then does not look for indices that count from the end.
        a, b = np.uint64(v0 + u0), np.uint64(v0 + u1)
        c, d = np.uint64(v1 + u0), np.uint64(v1 + u1)
        one = np.uint64(1)
        blue += share * _mix(texels, a, b, c, d, u, v)
        green += share * _mix(texels, a + one, b + one, c + one, d + one, u, v)
        one = np.uint64(2)
        red += share * _mix(texels, a + one, b + one, c + one, d + one, u, v)
    return blue, green, red


@njit(cache=True, nogil=True, error_model='numpy')
def _surroundings(light, x, y, z):  # type: ignore[no-untyped-def]
    """Openness and both lamps' shares at a point, between the points of the lattice."""
    grid, lattice, shape = light.grid, light.lattice, light.shape
    scale = 1.0 / lattice[3]
    gx = min(max((x - lattice[0]) * scale, 0.0), shape[0] - 1.001)
    gy = min(max((y - lattice[1]) * scale, 0.0), shape[1] - 1.001)
    gz = min(max((z - lattice[2]) * scale, 0.0), shape[2] - 1.001)
    ix, iy, iz = int(gx), int(gy), int(gz)
    fx, fy, fz = np.float32(gx - ix), np.float32(gy - iy), np.float32(gz - iz)
    along_y = 3 * shape[2]
    along_x = along_y * shape[1]
    corner = along_x * ix + along_y * iy + 3 * iz
    openness = first = second = np.float32(0.0)
    for n in range(4):
        wx = fx if n & 1 else np.float32(1.0) - fx
        w = wx * (fy if n & 2 else np.float32(1.0) - fy)
        k = np.uint64(corner + (along_x if n & 1 else 0) + (along_y if n & 2 else 0))
        openness += w * (grid[k] + fz * (grid[k + np.uint64(3)] - grid[k]))
        k += np.uint64(1)
        first += w * (grid[k] + fz * (grid[k + np.uint64(3)] - grid[k]))
        k += np.uint64(1)
        second += w * (grid[k] + fz * (grid[k + np.uint64(3)] - grid[k]))
    return openness, first, second


# Inlined, because handing over some dozen arrays costs as much as the shading.
@njit(cache=True, nogil=True, error_model='numpy', inline='always')
def _shade(  # type: ignore[no-untyped-def]
    geometry, surfaces, textures, light, k, face, x, y, z, dx, dy, dz, size
):
    """
    Colour of a face of solid k at a point: blue, green, red in grey levels.

    The direction of view has length 1; ``size`` is how much of a surface across the view one
    sample covers [m].
    """
    shape, mapping, look = geometry.shape, surfaces.mapping, surfaces.look
    lx, ly = x - shape[k, 0], y - shape[k, 1]
    nx = ny = nz = 0.0
    # Coordinates on the face: to the right for who looks at it, and down.
    right, down = 0.0, -z
    if face >= TOP:
        nz = 1.0 if face == TOP else -1.0
    if geometry.kind[k] == BOX:
        c, s = shape[k, 4], shape[k, 5]
        lx, ly = c * lx + s * ly, c * ly - s * lx
        if face < 2:
            sign = 1.0 if face == 0 else -1.0
            nx, ny, right = sign * c, sign * s, sign * ly
        elif face < TOP:
            sign = 1.0 if face == 2 else -1.0
            nx, ny, right = -sign * s, sign * c, -sign * lx
        else:
            right, down = lx, -ly
    elif face < TOP:
        nx, ny, nz = lx, ly, -0.5 * shape[k, 5] - shape[k, 6] * z
        scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * scale, ny * scale, nz * scale
        right = math.atan2(ly, lx)
    else:
        right, down = lx, -ly
    facing = max(-(nx * dx + ny * dy + nz * dz), 0.05)
    level = math.log(size / (math.sqrt(facing) * look[k, face, 4])) * _PER_LOG
    blue, green, red = _texture(
        textures,
        surfaces.texture[k, face],
        np.float32(right * mapping[k, face, 0] + mapping[k, face, 1]),
        np.float32(down * mapping[k, face, 2] + mapping[k, face, 3]),
        np.float32(level),
    )
    blue, green, red = blue * look[k, face, 0], green * look[k, face, 1], red * look[k, face, 2]
    glow = look[k, face, 3]
    if glow > 0.0:
        return blue * glow, green * glow, red * glow
    step = 0.6 * light.lattice[3]
    openness, first, second = _surroundings(light, x + step * nx, y + step * ny, z + step * nz)
    lamps, ambient = light.lamps, light.ambient
    lit_b, lit_g, lit_r = openness * ambient[0], openness * ambient[1], openness * ambient[2]
    for n in range(2):
        px, py, pz = lamps[n, 0] - x, lamps[n, 1] - y, lamps[n, 2] - z
        cosine = (nx * px + ny * py + nz * pz) / math.sqrt(px * px + py * py + pz * pz)
        seen = np.float32(max(cosine, 0.0)) * (second if n else first)
        lit_b += seen * lamps[n, 3]
        lit_g += seen * lamps[n, 4]
        lit_r += seen * lamps[n, 5]
    return blue * lit_b, green * lit_g, red * lit_r


@njit(cache=True, nogil=True, error_model='numpy')
def _in_view(geometry, pose, lens, width, height, chosen):  # type: ignore[no-untyped-def]
    """Write the numbers of the solids that may be in view into ``chosen``; return how many."""
    shape = geometry.shape
    ox, oy, oz, azimuth = pose
    fx, fy, cx, cy = lens
    axis_x, axis_y = math.cos(azimuth), math.sin(azimuth)
    left, right = (cx + 1.0) / fx, (width - cx) / fx
    up, down = (cy + 1.0) / fy, (height - cy) / fy
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


@njit(cache=True, nogil=True, error_model='numpy')
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
        first, last, face = _interval(kind, shape, chosen[n], ox, oy, dx, dy)
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
                t, face = _hit_box(shape, k, begin[n], end[n], side[n], oz, dz)
            else:
                t, face = _hit_turned(shape, k, ox, oy, oz, dx, dy, dz)
            if t < best:
                best, hit = t, 8 * k + face
        distance[j], seen[j] = best, hit


@njit(cache=True, nogil=True, error_model='numpy')
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
                blue, green, red = _shade(
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


@njit(cache=True, nogil=True, error_model='numpy')
def _blur_down(samples, half, column):  # type: ignore[no-untyped-def]
    """Weights 1 3 3 1 along a half column: from two rays a pixel to one value a pixel."""
    outer, inner = np.float32(0.125), np.float32(0.375)
    for v in range(column.shape[0]):
        j = 2 * v + 1
        for c in range(3):
            value = outer * (samples[half, j, c] + samples[half, j + 3, c])
            column[v, c] = value + inner * (samples[half, j + 1, c] + samples[half, j + 2, c])


@njit(cache=True, nogil=True, error_model='numpy')
def _blur_across(columns, before, middle, after, image, u):  # type: ignore[no-untyped-def]
    """Weights 1 3 3 1 across four half columns: one column of the image, in grey levels."""
    outer, inner = np.float32(0.125), np.float32(0.375)
    for v in range(image.shape[0]):
        for c in range(3):
            value = outer * (columns[before, v, c] + columns[after, v, c])
            value += inner * (columns[middle, v, c] + columns[middle + 1, v, c])
            image[v, u, c] = np.uint8(min(value + np.float32(0.5), np.float32(255.0)))


@njit(cache=True, nogil=True, error_model='numpy')
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
