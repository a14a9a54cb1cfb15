"""
A scan becomes a map, a map becomes paths, and the true room says whether they are any good.

One scan, taken at the origin. The map is an occupancy grid by ray casting, paths come from
scikit-image, the robot is round.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from skimage.graph import route_through_array
from skimage.measure import label

from panodepth_ros.camera.simulated import Room

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

#: Cells of the map and of the truth [m], and half the side of both [m].
CELL, FINE_CELL, REACH = 0.05, 0.02, 5.0
UNKNOWN, FREE, OCCUPIED = np.uint8(0), np.uint8(1), np.uint8(2)
#: Heights of the band at which the true room is cut.
_CUTS = 7


@dataclass(frozen=True, slots=True)
class Outcome:
    """
    What became of goals that the true room lets a robot reach.

    Attributes
    ----------
    goals : int
    found : float
        Share of them to which a path was planned.
    free : float
        Share of those paths without a collision; NaN without paths.
    """

    goals: int
    found: float
    free: float


def to_cells(xy: Array, cell: float) -> npt.NDArray[np.int64]:
    """Row and column of points (..., 2), y and x; the origin is the corner of four cells."""
    return np.floor((xy[..., ::-1] + REACH) / cell).astype(np.int64)


def occupancy(
    ranges: npt.NDArray[np.floating], *, range_min: float, range_max: float
) -> npt.NDArray[np.uint8]:
    """
    Map of one scan.

    Parameters
    ----------
    ranges : ndarray of float, shape (N,)
        Counter-clockwise from −π [m]; NaN says nothing, +inf clears up to ``range_max``.
    range_min, range_max : float
        The scan's limits [m]. Within ``range_min`` is the robot's own place.

    Returns
    -------
    ndarray of uint8, shape (rows, columns)
        ``UNKNOWN``, ``FREE`` or ``OCCUPIED``; a cell that one beam hits is occupied, whatever
        others say.
    """
    size = round(2 * REACH / CELL)
    grid = np.full((size, size), UNKNOWN)
    ends = np.where(np.isposinf(ranges), range_max, ranges)
    azimuth = -np.pi + np.arange(ranges.size) * (2 * np.pi / ranges.size)
    # Rays between the beams, so that far cells are not left out between two of them.
    spread = np.linspace(-0.5, 0.5, 5)[:, np.newaxis] * (2 * np.pi / ranges.size)
    direction = np.stack([np.cos(azimuth + spread), np.sin(azimuth + spread)], axis=-1)
    for along in np.arange(0, REACH * 1.5, CELL / 2):
        with np.errstate(invalid='ignore'):
            passed = (along < ends - CELL / 2) | (along < range_min)
        _set(grid, direction[:, passed] * along, FREE)
    hit = np.isfinite(ranges)
    _set(grid, direction[:, hit] * ranges[hit, np.newaxis], OCCUPIED)
    return grid


def _set(grid: npt.NDArray[np.uint8], points: Array, value: np.uint8) -> None:
    cells = to_cells(points.reshape(-1, 2), CELL)
    row, column = cells[((cells >= 0) & (cells < grid.shape[0])).all(axis=1)].T
    grid[row, column] = value


def true_ranges(room: Room, band: tuple[float, float], beams: int) -> Array:
    """Nearest surface in a height band, seen from the axis [m], counter-clockwise from −π."""
    azimuth = -np.pi + np.arange(beams) * (2 * np.pi / beams)
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(beams)], axis=-1)
    cuts = [room.cast(np.array([0.0, 0.0, height]), rays) for height in np.linspace(*band, _CUTS)]
    return np.asarray(np.min(cuts, axis=0))


def outlines(room: Room, band: tuple[float, float]) -> Array:
    """Edges of all that reaches into the band, shape (M, 2, 2): start and end, x and y [m]."""
    cuts = [room.outline(float(height)) for height in np.linspace(*band, _CUTS)]
    return np.array([segment for cut in cuts for segment in cut])


def true_clearance(edges: Array) -> Array:
    """Distance to the nearest of some edges (M, 2, 2) [m], on the fine grid."""
    size = round(2 * REACH / FINE_CELL)
    open_floor = np.ones((size, size), np.uint8)
    for (y0, x0), (y1, x1) in to_cells(edges, FINE_CELL).tolist():
        cv2.line(open_floor, (x0, y0), (x1, y1), 0)
    return np.asarray(cv2.distanceTransform(open_floor, cv2.DIST_L2, 5) * FINE_CELL, np.float64)


def reachable_goals(
    clearance: Array, radius: float, count: int, rng: np.random.Generator
) -> Array:
    """Points (count, 2) at which a robot from the origin can stand [m]."""
    parts = label(clearance > radius, connectivity=1)
    origin = tuple(to_cells(np.zeros(2), FINE_CELL))
    cells = np.argwhere(parts == parts[origin])
    chosen = cells[rng.integers(0, len(cells), count)]
    return np.asarray((chosen[:, ::-1] + 0.5) * FINE_CELL - REACH)


def plan(grid: npt.NDArray[np.uint8], goals: Array, radius: float) -> list[Array | None]:
    """
    Shortest paths from the origin.

    Parameters
    ----------
    grid : ndarray of uint8
        Map of :func:`occupancy`.
    goals : ndarray of float64, shape (M, 2)
        [m].
    radius : float
        Of the robot, with its margin [m]: its centre keeps that far from what is occupied, and
        drives on free cells only.

    Returns
    -------
    list of ndarray of float64, shape (L, 2), or None
        Points of each path [m]; None where the map has none.
    """
    away = cv2.distanceTransform((grid != OCCUPIED).astype(np.uint8), cv2.DIST_L2, 5) * CELL
    allowed = (away > radius) & (grid == FREE)
    start = tuple(to_cells(np.zeros(2), CELL))
    allowed[start] = True
    parts = label(allowed, connectivity=1)
    paths: list[Array | None] = []
    for goal in goals:
        end = tuple(to_cells(goal, CELL))
        if parts[end] == 0 or parts[end] != parts[start]:
            paths.append(None)
            continue
        cells, _ = route_through_array(np.where(allowed, 1.0, -1.0), start, end, geometric=True)
        paths.append((np.array(cells)[:, ::-1] + 0.5) * CELL - REACH)
    return paths


def judge(paths: list[Array | None], clearance: Array, radius: float) -> Outcome:
    """Hold paths against the true room: a robot of that radius must not touch anything."""
    driven = [path for path in paths if path is not None]
    free = [
        bool((clearance[tuple(to_cells(path, FINE_CELL).T)] > radius).all()) for path in driven
    ]
    return Outcome(
        goals=len(paths),
        found=len(driven) / len(paths),
        free=float(np.mean(free)) if free else float('nan'),
    )
