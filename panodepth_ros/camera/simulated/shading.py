"""Kernels that tell the colour of a point: its texture and the light that reaches it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.hits import TOP
from panodepth_ros.camera.simulated.kernels import inlined, kernel
from panodepth_ros.camera.simulated.solids import BOX
from panodepth_ros.camera.simulated.textures import LEVELS

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


@kernel
def _mix(texels, a, b, c, d, u, v):  # type: ignore[no-untyped-def]
    """Between four neighbouring values."""
    upper = np.float32(texels[a]) + u * (np.float32(texels[b]) - np.float32(texels[a]))
    lower = np.float32(texels[c]) + u * (np.float32(texels[d]) - np.float32(texels[c]))
    return upper + v * (lower - upper)


@kernel
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


@kernel
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


@inlined
def shade(  # type: ignore[no-untyped-def]
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
