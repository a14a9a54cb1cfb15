"""Pinhole views from the axis: what a camera in the middle of the rig would see, with depth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from panodepth_ros.compiled import compiler
from panodepth_ros.geometry import SURFACE_DEPTH, PanoramaGeometry, Points

Array = npt.NDArray[np.float64]
_kernel = compiler(Path(__file__).parent)

#: Patches farther than this from the optical axis are in no face [rad].
_WIDEST = math.pi / 2 - 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Face:
    """
    A pinhole camera on the axis, its optical axis horizontal; square pixels, no distortion.

    Attributes
    ----------
    azimuth : float
        Where the optical axis points [rad].
    width, height : int
        Size [px].
    focal_length_px : float
        fx = fy.
    cx, cy : float
        Principal point [px]; 0 is the centre of the first pixel.
    """

    azimuth: float
    width: int
    height: int
    focal_length_px: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """
    What a face sees.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        The panorama's colours; 0 where the depth is unknown.
    depth : ndarray of float32, shape (H, W)
        z along the optical axis [m]; NaN where unknown.
    """

    image: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]


def ring_of_faces(panorama: PanoramaGeometry, count: int, width: int) -> list[Face]:
    """
    Faces that share a full turn, the first one forward, the others counter-clockwise.

    Parameters
    ----------
    panorama : PanoramaGeometry
        Its rows say how high and low the faces look: whatever it saw lies within a face.
    count : int
        Number of faces, at least 3: each looks 2π/count wide.
    width : int
        Columns of a face [px]; 0 for those of the panorama where it is finest.

    Raises
    ------
    ValueError
        If there are too few faces or columns.
    """
    if count < 3:
        raise ValueError(f'faces is {count}; allowed: at least 3, for one is less than 180° wide')
    half = math.pi / count
    if width == 0:
        width = math.ceil(2 * math.tan(half) / panorama.column_step)
    if width < 2:
        raise ValueError(f'width of a face is {width} px; allowed: 0 or at least 2')
    focal_length = width / 2 / math.tan(half)
    # Seen from the axis, nothing is steeper than from the optical centre. At a face's edge, a
    # slope takes the most rows.
    steepest = panorama.slope(np.array([-0.5, panorama.rows - 0.5])) / math.cos(half)
    above, below = (math.ceil(max(0.0, float(s)) * focal_length) for s in steepest * (1, -1))
    return [
        Face(
            azimuth=math.remainder(2 * half * k, 2 * math.pi),
            width=width,
            height=above + below + 1,
            focal_length_px=focal_length,
            cx=(width - 1) / 2,
            cy=float(above),
        )
        for k in range(count)
    ]


def render(
    points: Points, image: npt.NDArray[np.uint8], panorama: PanoramaGeometry, face: Face
) -> View:
    """
    Draw a panorama's points into a face, the nearest in front.

    Parameters
    ----------
    points : Points
        On the panorama's pixels, shape (H, W); NaN where unknown.
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        The panorama.
    panorama : PanoramaGeometry
        Whose pixels they are.
    face : Face
        The camera.

    Returns
    -------
    View
        Of the face's size.

    Notes
    -----
    The points lie at azimuths of their own, not at those of the panorama's columns. Each pixel is
    a patch of a cylinder around the axis: it reaches half-way to a neighbour of the same surface
    (distances within :data:`~panodepth_ros.geometry.SURFACE_DEPTH`), and to the pixel's own edge
    otherwise. Face pixels whose centres lie in a patch take its distance and colour, and so does
    the one that the point itself is in. What no patch covers, such as what an edge hides from
    the eye but not from the axis, stays unknown.
    """
    azimuths, slopes = _patches(points, panorama)
    nearest = np.full((face.height, face.width), np.inf)
    source = np.full((face.height, face.width), -1)
    _draw(
        *(points.radial_distance, azimuths, slopes, nearest, source),
        *(face.azimuth, face.focal_length_px, face.cx, face.cy),
    )
    seen = source >= 0
    colours = image.reshape(-1, *image.shape[2:])[np.maximum(source, 0)]
    colours[~seen] = 0
    return View(colours, np.where(seen, nearest, np.nan).astype(np.float32))


def _patches(points: Points, panorama: PanoramaGeometry) -> tuple[Array, Array]:
    """
    Edges of each pixel as seen from the axis.

    Returns
    -------
    (ndarray, ndarray) of float64, shape (3, H, W)
        Azimuths of the clockwise edge, the point itself and the counter-clockwise edge [rad], not
        wrapped; slopes z/l of the lower edge, the point and the upper edge.
    """
    distance, azimuth = points.radial_distance, points.azimuth
    c = panorama.arm_radius * np.sin(panorama.ray_angle)
    azimuths = np.empty((3, *distance.shape))
    slopes = np.empty_like(azimuths)
    with np.errstate(invalid='ignore'):
        # By d/l is a slope seen from the axis smaller than from the optical centre.
        d = np.sqrt(distance**2 - c**2) - panorama.arm_radius * np.cos(panorama.ray_angle)
        half_row = d / distance / panorama.focal_length_px / 2
        slope = points.height / distance
        azimuths[1], slopes[1] = azimuth, slope
        for edge, sign in ((0, -1), (2, 1)):
            # Columns run clockwise and rows down: lower edges are to the right and below.
            turn = np.roll(azimuth, sign, axis=1) - azimuth
            turn = (turn + np.pi) % (2 * np.pi) - np.pi
            joined = _same_surface(distance, np.roll(distance, sign, axis=1)) & (turn * sign > 0)
            half_column = sign * panorama.column_step / 2
            azimuths[edge] = azimuth + np.where(joined, turn / 2, half_column)
            rise = _shifted(slope, sign) - slope
            joined = _same_surface(distance, _shifted(distance, sign)) & (rise * sign > 0)
            slopes[edge] = slope + np.where(joined, rise / 2, sign * half_row)
    return azimuths, slopes


def _shifted(values: Array, rows: int) -> Array:
    """Rows moved down by one (1) or up by one (−1); NaN where none came from."""
    moved = np.roll(values, rows, axis=0)
    moved[0 if rows > 0 else -1] = np.nan
    return moved


def _same_surface(one: Array, other: Array) -> npt.NDArray[np.bool_]:
    return np.asarray(np.abs(one - other) <= SURFACE_DEPTH * np.minimum(one, other))


@_kernel
def _draw(
    distance: Array,
    azimuths: Array,
    slopes: Array,
    nearest: Array,
    source: npt.NDArray[np.int64],
    face_azimuth: float,
    focal_length: float,
    cx: float,
    cy: float,
) -> None:
    """Enter depth and index of the nearest pixel of the panorama into each pixel of the face."""
    width = nearest.shape[1]
    rows, columns = distance.shape
    for row in range(rows):
        for column in range(columns):
            l = distance[row, column]  # noqa: E741 - the paper's letter
            azimuth = azimuths[1, row, column] - face_azimuth
            azimuth -= 2 * math.pi * math.floor((azimuth + math.pi) / (2 * math.pi))
            if not (math.isfinite(l) and abs(azimuth) < _WIDEST):
                continue
            high = min(azimuth + azimuths[2, row, column] - azimuths[1, row, column], _WIDEST)
            low = max(azimuth + azimuths[0, row, column] - azimuths[1, row, column], -_WIDEST)
            index = row * columns + column
            # The face pixel that the point itself is in sees it, however small its patch.
            u = round(cx - focal_length * math.tan(azimuth))
            v = round(cy - focal_length * slopes[1, row, column] / math.cos(azimuth))
            z = l * _foreshortening(u, focal_length, cx)
            _enter(nearest, source, v, v, u, z, index)
            first = math.ceil(cx - focal_length * math.tan(high))
            last = math.floor(cx - focal_length * math.tan(low))
            for u in range(max(first, 0), min(last, width - 1) + 1):
                cosine = _foreshortening(u, focal_length, cx)
                top = math.ceil(cy - focal_length * slopes[2, row, column] / cosine)
                bottom = math.floor(cy - focal_length * slopes[0, row, column] / cosine)
                _enter(nearest, source, top, bottom, u, l * cosine, index)


@_kernel
def _foreshortening(u: int, focal_length: float, cx: float) -> float:
    """Return z over the horizontal distance along column u."""
    return 1 / math.sqrt(1 + ((cx - u) / focal_length) ** 2)


@_kernel
def _enter(
    nearest: Array,
    source: npt.NDArray[np.int64],
    top: int,
    bottom: int,
    u: int,
    z: float,
    index: int,
) -> None:
    """Put a depth into rows of a column wherever nothing nearer is."""
    height, width = nearest.shape
    if not 0 <= u < width:
        return
    for v in range(max(top, 0), min(bottom, height - 1) + 1):
        if z < nearest[v, u]:
            nearest[v, u] = z
            source[v, u] = index
