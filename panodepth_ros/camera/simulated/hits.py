"""
Kernels that tell where a ray meets a solid.

A ray is origin + t·direction. Seen from above every solid is a rectangle or a circle: a solid can
be hit only in the interval of t in which the ray is over it. Distances are exact.
"""

from __future__ import annotations

import math

import numpy as np

from panodepth_ros.camera.simulated.kernels import kernel
from panodepth_ros.camera.simulated.solids import BOX

#: Face numbers, see ``solids.FACES``.
TOP, BOTTOM = 4, 5
_TINY = 1e-12


@kernel
def _slab(position, direction, half):  # type: ignore[no-untyped-def]
    """Interval of t in which a coordinate is between -half and half; reversed for never."""
    if abs(direction) < _TINY:
        if abs(position) > half:
            return math.inf, -math.inf
        return -math.inf, math.inf
    near, far = (-half - position) / direction, (half - position) / direction
    return min(near, far), max(near, far)


@kernel
def interval(kind, shape, k, ox, oy, dx, dy):  # type: ignore[no-untyped-def]
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


@kernel
def hit_box(shape, k, first, last, side, oz, dz):  # type: ignore[no-untyped-def]
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


@kernel
def hit_turned(shape, k, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
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


@kernel
def _first(kind, shape, chosen, ox, oy, oz, dx, dy, dz, reach):  # type: ignore[no-untyped-def]
    """First t of a ray that looks at some of the solids, at most ``reach``."""
    best = reach
    for k in chosen:
        first, last, side = interval(kind, shape, k, ox, oy, dx, dy)
        if first > last or last < 0.0 or first > best:
            continue
        if kind[k] == BOX:
            t, _ = hit_box(shape, k, first, last, side, oz, dz)
        else:
            t, _ = hit_turned(shape, k, ox, oy, oz, dx, dy, dz)
        best = min(best, t)
    return best


@kernel
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
    everything = np.arange(len(kind))
    for i in range(len(distances)):
        ox, oy, oz = origins[i, 0], origins[i, 1], origins[i, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        distances[i] = _first(kind, shape, everything, ox, oy, oz, dx, dy, dz, math.inf)


@kernel
def openness(geometry, points, sides, reach, shares):  # type: ignore[no-untyped-def]
    """
    How open the surroundings of points are: their mean free path to several sides.

    Parameters
    ----------
    geometry : Geometry
        The solids.
    points : ndarray of float64, shape (M, 3)
        Points outside of all solids [m].
    sides : ndarray of float64, shape (N, 3)
        Directions of length 1.
    reach : float
        Where a path is cut off [m].
    shares : ndarray of float64, shape (M,)
        Receives the mean free path as a share of the reach, 0 to 1.
    """
    kind, shape = geometry.kind, geometry.shape
    near = np.empty(len(kind), np.int64)
    for i in range(len(shares)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        count = 0
        for k in range(len(kind)):
            radius = shape[k, 7] + reach
            if kind[k] == BOX:
                radius = math.sqrt(shape[k, 6] ** 2 + shape[k, 7] ** 2) + reach
            if (
                shape[k, 2] < z + reach
                and shape[k, 3] > z - reach
                and (shape[k, 0] - x) ** 2 + (shape[k, 1] - y) ** 2 < radius * radius
            ):
                near[count] = k
                count += 1
        shares[i] = 0.0
        for side in range(len(sides)):
            dx, dy, dz = sides[side, 0], sides[side, 1], sides[side, 2]
            free = _first(kind, shape, near[:count], x, y, z, dx, dy, dz, reach)
            shares[i] += free / reach / len(sides)


@kernel
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
