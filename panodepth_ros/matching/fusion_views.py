"""
Where further panoramas of a sweep show what a pair's candidate stands for.

A candidate of the pair is a distance. For one distance every panorama is the left one shifted by
a constant number of columns, β = α + asin(r·sin ψ / l), and with its rows scaled about the
principal row, because the camera that took it stood a little nearer or farther.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching.colour_pair import ColourPair, bridged, wrapped
from panodepth_ros.matching.exposure import level_tables
from panodepth_ros.matching.rough import ROUGH_SCALE, RoughMatch, small, small_seen

Bytes = npt.NDArray[np.uint8]
Array = npt.NDArray[np.float64]

#: Arm radii that differ by less than this share count as equal.
RADIUS_TOLERANCE = 1e-6
#: By how many column steps ray angles may differ from the principal angle.
MOST_DEVIATION = 2.0
#: Least baseline to the left panorama that tells a distance, as a share of the pair's.
LEAST_BASELINE = 0.02
#: Panoramas with less than this share of the weight are left out: they cost as much as others.
LEAST_SHARE = 0.03


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """
    A panorama as seen from the left one.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W, 3) or (H, W)
        Colours or grey levels as they were taken.
    tables : ndarray of uint8, shape (3, 256), or None
        What gives the colours the pair's brightness.
    grey : ndarray of uint8, shape (H, W)
        Grey levels of the pair's brightness, interpolated across columns that were not seen.
    seen : ndarray of bool, shape (W,)
        Whether a frame saw the column.
    shift : ndarray of float64, shape (candidates,)
        Candidate k of the left column x is at column x + shift[k].
    row_scale, principal_rows : ndarray of float64, shape (candidates,); tuple of float
        Row v of the left panorama is at principal_rows[1] − (principal_rows[0] − v)·row_scale[k].
    baseline : float
        Distance from the left panorama's rays, as a share of the pair's.
    """

    image: Bytes
    tables: Bytes | None
    grey: Bytes
    seen: npt.NDArray[np.bool_]
    shift: Array
    row_scale: Array
    principal_rows: tuple[float, float]
    baseline: float

    def rows(self, row: npt.NDArray[np.intp], candidate: npt.NDArray[np.intp]) -> Array:
        """Where rows of the left panorama are for these candidates; broadcasts."""
        left, here = self.principal_rows
        return np.asarray(here - (left - row) * self.row_scale[candidate])

    def part(self, rows: npt.NDArray[np.intp], start: int, stop: int) -> Bytes:
        """Blue, green, red, grey of some ascending rows and of columns start … stop − 1."""
        first, last = rows[0], rows[-1] + 1
        taken = np.empty((4, rows.size, stop - start), np.uint8)
        taken[3] = wrapped(self.grey[first:last], start, stop)[rows - first]
        if self.image.ndim == 2:
            colours = wrapped(self.image[first:last], start, stop)
            taken[:3] = _levelled(colours, self.tables)[rows - first]
            return taken
        pixels = self.image[first:last].view('V3')[..., 0]  # three bytes at once
        colours = wrapped(pixels, start, stop).view(np.uint8).reshape(last - first, -1, 3)
        for plane, channel in zip(taken, cv2.split(_levelled(colours, self.tables)), strict=False):
            plane[:] = channel[rows - first]
        return taken


def check_further(left: PanoramaGeometry, further: Sequence[Panorama]) -> None:
    """
    Check that panoramas can be of one sweep with the left one and tell something.

    Raises
    ------
    ValueError
        If one cannot; names it.
    """
    for number, panorama in enumerate(further):
        name, other = f'further[{number}]', panorama.geometry
        if (other.rows, other.columns) != (left.rows, left.columns):
            raise ValueError(
                f'{name} has {other.columns} × {other.rows} pixels; '
                f'allowed: {left.columns} × {left.rows}, as the pair'
            )
        if abs(other.arm_radius / left.arm_radius - 1) > RADIUS_TOLERANCE:
            raise ValueError(
                f'{name} has arm radius {other.arm_radius} m; '
                f'allowed: {left.arm_radius} m, as the pair'
            )
        if abs(_baseline(left, other)) < LEAST_BASELINE:
            raise ValueError(
                f'{name} has principal angle {other.principal_angle} rad, as the left panorama; '
                'allowed: another one'
            )
        deviation = np.abs(other.ray_angle[other.seen] - other.principal_angle)
        most = MOST_DEVIATION * other.column_step
        if np.any(deviation > most):
            raise ValueError(
                f'{name} has ray angles up to {deviation.max():.3g} rad from its principal angle; '
                f'allowed: {most:.3g} rad, {MOST_DEVIATION:g} column steps'
            )


def helpful(left: PanoramaGeometry, further: Sequence[Panorama]) -> list[Panorama]:
    """Panoramas whose baseline gives them a say beside the pair's right one, by their angle."""
    shares = shares_of([1.0, *(_baseline(left, panorama.geometry) for panorama in further)])
    chosen = [
        panorama
        for panorama, share in zip(further, shares[1:], strict=True)
        if share >= LEAST_SHARE
    ]
    return sorted(chosen, key=lambda panorama: panorama.geometry.principal_angle)


def shares_of(baselines: Sequence[float]) -> Array:
    """Share of views in the mean: by the square of the baseline."""
    squares = np.square(baselines)
    return np.asarray(squares / squares.sum())


def view_of(
    panorama: Panorama,
    left: PanoramaGeometry,
    right: PanoramaGeometry,
    disparity: Array,
) -> View:
    """
    See a panorama from the left one of a symmetric pair.

    Parameters
    ----------
    panorama : Panorama
        Any of the sweep's, the pair's right one included.
    left, right : PanoramaGeometry
        The pair.
    disparity : ndarray of float64, shape (candidates,)
        Column disparity of each candidate, inside the pair's search range.
    """
    here = panorama.geometry
    radius, step = left.arm_radius, left.column_step
    half, widest = left.columns / 2, 2 * right.principal_angle
    delta = (np.mod(_column_offset(left, right) - disparity + half, left.columns) - half) * step
    # Stripes are searched beyond both ends, where there is no distance: that of the end is near.
    delta = np.clip(delta, 1e-6 * widest, (1 - 1e-6) * widest)
    distance = radius * math.sin(right.principal_angle) / np.sin(delta / 2)  # eq. 2
    shift = _column_offset(left, here) - (_lead(here, distance) - _lead(left, distance)) / step
    scale = _depth(left, distance) * here.focal_length_px
    scale /= _depth(here, distance) * left.focal_length_px
    return View(
        image=np.ascontiguousarray(panorama.image),
        tables=None,
        grey=_grey(panorama.image, here.seen),
        seen=here.seen,
        shift=shift,
        row_scale=scale,
        principal_rows=(left.principal_row, here.principal_row),
        baseline=_baseline(left, here),
    )


def equalised_view(view: View, rough: RoughMatch | None, pair: ColourPair) -> View:
    """Give a view the brightness of the right eye, judged by the pair's rough match."""
    if rough is None:
        return view
    image = small(view.image, pair.seam)
    candidate = np.clip(ROUGH_SCALE * rough.disparity - pair.first, 0, view.shift.size - 1)
    ratio = view.seen.size / image.shape[1]
    rows = view.rows(ROUGH_SCALE * rough.y, candidate) / ROUGH_SCALE
    rows = np.clip(np.rint(rows), 0, image.shape[0] - 1).astype(np.intp)
    columns = np.rint(rough.x + view.shift[candidate] / ratio).astype(np.intp) % image.shape[1]
    seen = small_seen(view.seen, pair.seam)[columns]
    found = image[rows[seen], columns[seen]]
    found = found.T if image.ndim == 3 else np.stack([found] * 3)
    tables = level_tables(found, rough.right[:, seen])
    if tables is None:
        return view
    grey = _grey(_levelled(view.image, tables), view.seen)
    return replace(view, tables=tables, grey=grey)


def _levelled(image: Bytes, tables: Bytes | None) -> Bytes:
    """Image, colours or grey levels, with the new values of tables if there are any."""
    if tables is None:
        return image
    if image.ndim == 2:
        return np.asarray(cv2.LUT(image, tables[0]), np.uint8)
    return np.asarray(cv2.LUT(image, tables.T[np.newaxis]), np.uint8)


def _grey(image: Bytes, seen: npt.NDArray[np.bool_]) -> Bytes:
    """Grey levels, interpolated across columns that were not seen."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return bridged(np.asarray(grey, np.uint8), seen)


def _baseline(left: PanoramaGeometry, other: PanoramaGeometry) -> float:
    sine = math.sin(left.principal_angle)
    return (math.sin(other.principal_angle) - sine) / (-2 * sine)


def _column_offset(left: PanoramaGeometry, other: PanoramaGeometry) -> float:
    """Column of an azimuth in ``other`` minus that in ``left``, the smallest."""
    offset = other.azimuth_column - left.azimuth_column
    return offset - left.columns * math.floor(offset / left.columns + 0.5)


def _lead(eye: PanoramaGeometry, distance: Array) -> Array:
    """By how much a ray's azimuth exceeds that of the point it meets at a radial distance."""
    return np.asarray(np.arcsin(eye.arm_radius * math.sin(eye.principal_angle) / distance))


def _depth(eye: PanoramaGeometry, distance: Array) -> Array:
    """Horizontal distance from the camera of a point at a radial distance."""
    circle = eye.arm_radius * math.sin(eye.principal_angle)
    along = np.sqrt(distance**2 - circle**2)
    return np.asarray(along - eye.arm_radius * math.cos(eye.principal_angle))
