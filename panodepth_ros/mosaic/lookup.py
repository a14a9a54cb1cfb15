"""One column of a panorama out of one frame: mounting, lens and quantised arm included."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.geometry.panorama import RAY_ANGLE_TOLERANCE

Image = npt.NDArray[np.uint8]

#: A pixel covers half a pixel on either side of its centre.
_HALF_PIXEL = 0.5 + 1e-6
#: Closer than this to pixel centres, pixels are taken as they are [px].
_EXACT = 1e-3
#: Ray angles whose sampling positions are remembered: they are the same in every frame.
_TABLES = 128


def visible_rows(
    camera: PinholeCamera, offsets_px: tuple[float, ...], margin: float
) -> tuple[int, int]:
    """
    Rows that every panorama of a sweep can show.

    Parameters
    ----------
    camera : PinholeCamera
        The calibrated camera.
    offsets_px : tuple of float
        Ideal columns of the panoramas, relative to the principal point [px].
    margin : float
        How far rays may deviate from the principal angles [rad], for a quantised arm.

    Returns
    -------
    (int, int)
        First row and number of rows: those of the image, moved by whole rows as far as the camera
        is tilted, less those that distortion and mounting take out of it at either side.

    Raises
    ------
    ValueError
        If a column lies outside the image or no row is left.
    """
    tilted = round(camera.fy * np.tan(camera.mounting.tilt))
    rows = np.arange(camera.height, dtype=np.float64) - tilted
    seen = np.ones(camera.height, dtype=bool)
    for offset in offsets_px:
        angle = camera.ray_angle(offset)
        slope = (camera.cy - rows) / focal_length(camera, offset)
        middle = np.tan(camera.mounting.tilt)
        u, _ = camera.project([angle], [middle])
        if not -_HALF_PIXEL <= u[0] <= camera.width - 1 + _HALF_PIXEL:
            raise ValueError(
                f'the column {offset:+g} px from the principal point cx = {camera.cx:g} is at '
                f'u = {u[0]:.1f}, outside the image; allowed: 0 to {camera.width - 1}'
            )
        u, _ = camera.project(angle, slope)
        seen &= (u >= -_HALF_PIXEL) & (u <= camera.width - 1 + _HALF_PIXEL)
        for ray_angle in (angle - margin, angle, angle + margin):
            _, v = camera.project(ray_angle, slope)
            seen &= (v >= -_HALF_PIXEL) & (v <= camera.height - 1 + _HALF_PIXEL)
    kept = np.flatnonzero(seen)
    if not kept.size:
        raise ValueError('no row of the image is seen by every panorama column')
    return int(rows[kept[0]]), int(kept[-1] - kept[0] + 1)


def focal_length(camera: PinholeCamera, offset_px: float) -> float:
    """Return F = fy/cos φ [px], the vertical focal length of a panorama."""
    return float(camera.fy / np.cos(camera.ray_angle(offset_px)))


class _Table(NamedTuple):
    """Where a column is sampled: pixels and, unless they are met exactly, shares of neighbours."""

    top: npt.NDArray[np.intp]
    left: npt.NDArray[np.intp]
    bottom: npt.NDArray[np.intp]
    right: npt.NDArray[np.intp]
    share_v: npt.NDArray[np.float64]
    share_u: npt.NDArray[np.float64]
    exact: bool


def _positions(
    camera: PinholeCamera, slope: npt.NDArray[np.float64], ray_angle: float, row_turn: float
) -> _Table | None:
    height, width = camera.height, camera.width
    u, v = camera.project(ray_angle, slope)
    if row_turn:
        # A row that is exposed later sees the same azimuth at a smaller angle to the arm.
        behind = ray_angle - row_turn * (v - 0.5 * (height - 1))
        u, v = camera.project(behind, slope)
    if not (u.min() >= -_HALF_PIXEL and u.max() <= width - 1 + _HALF_PIXEL):
        return None
    u, v = np.clip(u, 0, width - 1), np.clip(v, 0, height - 1)
    left, top = np.rint(u).astype(np.intp), np.rint(v).astype(np.intp)
    exact = max(np.abs(u - left).max(), np.abs(v - top).max()) < _EXACT
    if not exact:
        left = np.minimum(np.floor(u), max(width - 2, 0)).astype(np.intp)
        top = np.minimum(np.floor(v), max(height - 2, 0)).astype(np.intp)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    return _Table(top, left, bottom, right, v - top, u - left, exact)


class ColumnLookup:
    """
    Samples frames along the rays of one panorama's columns.

    The sampling positions of a ray angle are computed once and then looked up.

    Parameters
    ----------
    camera : PinholeCamera
        The calibrated camera.
    slope : ndarray of float64, shape (H,)
        z/d of each row of the panorama.
    """

    def __init__(self, camera: PinholeCamera, slope: npt.NDArray[np.float64]) -> None:
        # Of no method: a lookup that refers to itself would keep its positions until garbage is
        # collected, which comes late where objects are few, though large.
        self._table = lru_cache(maxsize=_TABLES)(partial(_positions, camera, slope))

    def column(self, image: Image, ray_angle: float, row_turn: float = 0.0) -> Image | None:
        """
        Sample a frame along one ray angle.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
            The frame.
        ray_angle : float
            ψ [rad], against the arm as it is when the middle row is exposed.
        row_turn : float
            How far the arm turns from the exposure of one row to that of the next [rad].

        Returns
        -------
        ndarray of uint8, shape (H,) or (H, 3), or None
            None if the ray leaves the image at its side. Pixels are copied where the rays meet
            their centres, and interpolated linearly elsewhere.
        """
        table = self._table(ray_angle, row_turn)
        if table is None:
            return None
        top, left, bottom, right, share_v, share_u, exact = table
        if exact:
            return np.ascontiguousarray(image[top, left])
        if image.ndim == 3:
            share_u, share_v = share_u[:, np.newaxis], share_v[:, np.newaxis]
        above = image[top, left] * (1 - share_u) + image[top, right] * share_u
        below = image[bottom, left] * (1 - share_u) + image[bottom, right] * share_u
        mixed = above * (1 - share_v) + below * share_v
        return np.asarray(np.rint(mixed), dtype=np.uint8)


def snapped(ray_angle: float, principal_angle: float) -> float:
    """Return the principal angle itself where the ray differs from it by rounding only."""
    exact = abs(ray_angle - principal_angle) <= RAY_ANGLE_TOLERANCE
    return principal_angle if exact else ray_angle
