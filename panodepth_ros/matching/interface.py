"""
What every matching method takes and gives, and the table of the methods.

A method lives in a module with a function ``(left, right, further, threads) → Correspondence``
and a function ``prepare()`` that compiles its kernels. Methods are imported on first use.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PanoramaGeometry, Points, check_pair, triangulate

#: Half width of the correlation window (2n+1)², n = 4 in the paper (sec. 7).
WINDOW_HALF_WIDTH = 4

_MODULES = {
    'semiglobal': ('panodepth_ros.matching.fusion', 'match_sweep'),
    'ncc': ('panodepth_ros.matching.ncc', 'match_ncc'),
    'sparse': ('panodepth_ros.matching.sparse', 'match_sparse'),
    'sgbm': ('panodepth_ros.matching.opencv', 'match_sgbm'),
    'bm': ('panodepth_ros.matching.opencv', 'match_bm'),
}

#: Names of the methods.
METHODS = tuple(_MODULES)


@dataclass(frozen=True, eq=False, slots=True)
class Correspondence:
    """
    Where the right panorama shows what the left panorama shows.

    Attributes
    ----------
    column_disparity : ndarray of float32, shape (H, W)
        dx, right column minus left column of the same point, on the left panorama's grid
        [columns], sub-column; NaN where unmatched.
    confidence : ndarray of float32, shape (H, W)
        From 0 to 1, higher is better; NaN where unmatched. What it means is the method's.
    """

    column_disparity: npt.NDArray[np.float32]
    confidence: npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False, slots=True)
class GreyPair:
    """
    A pair made ready for a kernel.

    Attributes
    ----------
    left, right : ndarray of uint8, shape (H, W), C-contiguous
        Grey levels; 0 in columns that were not seen.
    left_seen, right_seen : ndarray of bool, shape (W,)
        Whether a frame saw the column.
    first, last : int
        Search range: a left column x is sought at (x + dx) mod W, dx = first … last.
    """

    left: npt.NDArray[np.uint8]
    right: npt.NDArray[np.uint8]
    left_seen: npt.NDArray[np.bool_]
    right_seen: npt.NDArray[np.bool_]
    first: int
    last: int


def candidate_range(left: PanoramaGeometry, right: PanoramaGeometry) -> tuple[int, int]:
    """
    Smallest and largest column disparity worth searching.

    Parameters
    ----------
    left, right : PanoramaGeometry
        A symmetric pair.

    Returns
    -------
    first, last : int
        1 and n = φ div θ0/2 (sec. 6.2) if equal columns were taken at equal arm azimuths; both
        are shifted if the two panoramas start at different azimuths, and stripes move them apart.

    Raises
    ------
    ValueError
        If the panoramas are not a symmetric pair.

    Notes
    -----
    A point at infinity has parallel rays, β_L = β_R, so dx is the difference of the azimuth
    columns; a point on the arm's circle lies (ψ_R − ψ_L)/θ0 columns below that, 2φ/θ0 for the
    principal rays. Both ends are excluded. Where stripes turn the eyes' rays farther apart than
    2φ the near end moves by whole columns; a fraction, as of a quantised arm, shows only what
    touches the lens. Where they turn their azimuths (``stripe_turn``), both ends move.
    """
    check_pair(left, right)
    span = 2 * right.principal_angle / right.column_step
    nearest = right.azimuth_column - left.azimuth_column - span
    nearest -= left.columns * math.floor(nearest / left.columns + 0.5)
    tolerance = 1e-6
    first = math.floor(nearest + tolerance) + 1
    last = math.ceil(nearest + span - tolerance) - 1
    if left.seen.any() and right.seen.any():
        turns = [eye.stripe_turn(eye.ray_angle) / eye.column_step for eye in (left, right)]
        angles = [
            eye.ray_angle / eye.column_step - turn
            for eye, turn in zip((left, right), turns, strict=True)
        ]
        widest = float(np.nanmax(angles[1]) - np.nanmin(angles[0]))
        farthest = float(np.nanmax(turns[1]) - np.nanmin(turns[0]))
        first -= math.floor(max(widest - span, 0.0) + tolerance)
        last += math.ceil(max(farthest, 0.0) - tolerance)
    return first, last


def grey_pair(left: Panorama, right: Panorama) -> GreyPair:
    """
    Grey levels, seen columns and search range of a pair.

    Raises
    ------
    ValueError
        If the panoramas are not a symmetric pair, or too small for window and search range.
    """
    first, last = candidate_range(left.geometry, right.geometry)
    rows, columns = left.geometry.rows, left.geometry.columns
    window = 2 * WINDOW_HALF_WIDTH + 1
    if rows < window:
        raise ValueError(f'panorama has {rows} rows; allowed: at least {window}, the window')
    if last < first:
        raise ValueError(
            f'principal_angle {right.geometry.principal_angle} rad leaves no column to search at '
            f'a column step of {right.geometry.column_step} rad; allowed: above half a step'
        )
    if columns < last - first + 1 + window:
        raise ValueError(
            f'panorama has {columns} columns; allowed: at least {last - first + 1 + window}, '
            'the search range and the window'
        )
    return GreyPair(
        left=_grey(left),
        right=_grey(right),
        left_seen=left.geometry.seen,
        right_seen=right.geometry.seen,
        first=first,
        last=last,
    )


def window_geometry(geometry: PanoramaGeometry) -> PanoramaGeometry:
    """
    Geometry with which a match is to be triangulated.

    Parameters
    ----------
    geometry : PanoramaGeometry
        Of a panorama that was matched.

    Returns
    -------
    PanoramaGeometry
        The same, but each ray angle is the mean of those that the correlation window around its
        column sees: a disparity is that of its window, and in stripes no two of its columns have
        the same ray angle. A panorama of one ray angle is returned as it is.
    """
    if geometry.uniform:
        return geometry
    seen = geometry.seen
    angles = np.where(seen, geometry.ray_angle, 0.0)
    shifts = range(-WINDOW_HALF_WIDTH, WINDOW_HALF_WIDTH + 1)
    total = sum(np.roll(angles, shift) for shift in shifts)
    count = sum(np.roll(seen.astype(np.int64), shift) for shift in shifts)
    mean = np.full(geometry.columns, np.nan)
    mean[seen] = (total / np.maximum(count, 1))[seen]
    return replace(geometry, ray_angle=mean)


def triangulate_match(
    matched: Correspondence,
    left: PanoramaGeometry,
    right: PanoramaGeometry,
    *,
    threads: int = 1,
) -> Points:
    """
    Points of a match.

    Parameters
    ----------
    matched : Correspondence
        Made of the pair, H × W.
    left, right : PanoramaGeometry
        The pair.
    threads : int
        Threads to use; the result does not depend on it.

    Returns
    -------
    Points
        On the left panorama's grid, by the mean rays of the windows (:func:`window_geometry`).

    Raises
    ------
    ValueError
        If the panoramas are not a pair or the match has another size.
    """
    geometries = window_geometry(left), window_geometry(right)
    return triangulate(matched.column_disparity, *geometries, threads=threads)


def _grey(panorama: Panorama) -> npt.NDArray[np.uint8]:
    image = panorama.image
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image.copy()
    grey[:, ~panorama.geometry.seen] = 0
    return np.ascontiguousarray(grey, np.uint8)


def match(
    left: Panorama,
    right: Panorama,
    *,
    further: Sequence[Panorama] = (),
    method: str = 'semiglobal',
    threads: int = 1,
) -> Correspondence:
    """
    Match a symmetric pair of panoramas, row by row.

    Parameters
    ----------
    left, right : Panorama
        Left eye (principal angle −φ) and right eye (+φ) of one sweep, H × W.
    further : sequence of Panorama
        Other panoramas of the same sweep, any principal angles; only ``semiglobal`` uses them.
    method : str
        One of ``METHODS``.
    threads : int
        Threads to use, at least 1. The result does not depend on it.

    Returns
    -------
    Correspondence
        On the left panorama's grid. Rolling both panoramas rolls it.

    Raises
    ------
    ValueError
        If the panoramas are not a pair or too small, the method is unknown, or a further panorama
        that is used has another size or arm radius than the pair.
    """
    if threads < 1:
        raise ValueError(f'threads is {threads}; allowed: at least 1')
    module, function = _method(method)
    run: Callable[[Panorama, Panorama, Sequence[Panorama], int], Correspondence]
    run = getattr(import_module(module), function)
    return run(left, right, further, threads)


def prepare(method: str) -> None:
    """
    Compile the kernels of a method, or load them from numba's cache.

    Raises
    ------
    ValueError
        If the method is unknown.
    """
    module, _ = _method(method)
    import_module(module).prepare()


def _method(name: str) -> tuple[str, str]:
    if name not in _MODULES:
        raise ValueError(f'method is {name!r}; allowed: {", ".join(METHODS)}')
    return _MODULES[name]
