"""One column of a panorama out of one frame: mounting, lens and quantised arm included."""

from __future__ import annotations

import math
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
#: Columns that cover more of a frame are its mean there: one or two pixels out of many are noisy,
#: and show patterns that are not in the room [px].
WIDE = 2.0
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
    """Pixels whose weighted sum is a column, by their place in the frame, each of shape (H, M)."""

    pixel: npt.NDArray[np.intp]
    share: npt.NDArray[np.float64]


def _positions(
    camera: PinholeCamera,
    slope: npt.NDArray[np.float64],
    column_step: float,
    ray_angle: float,
    row_turn: float,
) -> _Table | None:
    # As wide in the middle of the image as at its edges, but for a strongly distorting lens.
    angles = np.full(slope.size + 2, ray_angle)
    angles[-2:] += np.array([-0.5, 0.5]) * column_step
    middle = slope.size // 2
    u, v = camera.project(angles, np.concatenate([slope, slope[[middle, middle]]]))
    extent_u, extent_v = abs(u[-1] - u[-2]), abs(v[-1] - v[-2])
    u, v = u[:-2], v[:-2]
    if row_turn:
        # A row that is exposed later sees the same azimuth at a smaller angle to the arm.
        behind = ray_angle - row_turn * (v - 0.5 * (camera.height - 1))
        u, v = camera.project(behind, slope)
    if not (u.min() >= -_HALF_PIXEL and u.max() <= camera.width - 1 + _HALF_PIXEL):
        return None
    if u.min() == u.max():
        u = u[:1]  # upright in the frame: all rows have the same shares
    rows, share_v = _shares(v, extent_v, camera.height)
    columns, share_u = _shares(u, extent_u, camera.width)
    pixel = rows[:, :, np.newaxis] * camera.width + columns[:, np.newaxis]
    share = share_v[:, :, np.newaxis] * share_u[:, np.newaxis]
    return _Table(pixel.reshape(rows.shape[0], -1), share.reshape(rows.shape[0], -1))


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
    column_step : float
        What a column covers [rad].
    """

    def __init__(
        self, camera: PinholeCamera, slope: npt.NDArray[np.float64], column_step: float
    ) -> None:
        # Of no method: a lookup that refers to itself would keep its positions until garbage is
        # collected, which comes late where objects are few, though large.
        self._table = lru_cache(maxsize=_TABLES)(partial(_positions, camera, slope, column_step))

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
            their centres, and interpolated linearly elsewhere; a column that covers more than
            ``WIDE`` pixels of the frame is their mean.
        """
        table = self._table(ray_angle, row_turn)
        if table is None:
            return None
        # Several times as fast as indices of two dimensions and a product of mixed types.
        pixels = image.reshape(-1, *image.shape[2:]).take(table.pixel, axis=0)
        if table.share.shape[1] == 1:
            return np.asarray(pixels[:, 0])
        if image.ndim == 2:
            mean = (table.share * pixels).sum(axis=1)
        else:
            mean = np.matmul(table.share[:, np.newaxis], pixels.astype(np.float64))[:, 0]
        return np.asarray(np.rint(mean), dtype=np.uint8)


def _shares(
    middle: npt.NDArray[np.float64], extent: float, size: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """
    Pixels of one dimension around positions (H,), and their shares of the mean, shape (H, M).

    The mean is over the extent if that is ``WIDE``, else over a pixel's size. At the image's side
    it is cut off on both sides of the position, which would move otherwise.
    """
    middle = np.minimum(np.maximum(middle, 0.0), size - 1.0)
    nearest = np.rint(middle)
    if np.abs(middle - nearest).max() < _EXACT:
        middle = nearest
    if extent <= WIDE:
        first = np.floor(middle)
        beyond = middle - first
        pixel = first.astype(np.intp)[:, np.newaxis] + np.arange(2 if beyond.any() else 1)
        share = np.stack([1.0 - beyond, beyond], axis=-1)[:, : pixel.shape[1]]
        return np.minimum(pixel, size - 1), share
    reach = np.minimum(np.minimum(middle, size - 1.0 - middle) + 0.5, 0.5 * extent)
    # A pixel covers from its number to the next one here.
    low = middle + 0.5 - reach
    first = np.floor(low)
    begin, end = low - first, low - first + 2 * reach
    number = np.arange(math.ceil(end.max()))
    share = np.minimum(np.maximum(end[:, np.newaxis] - number, 0.0), 1.0)
    share[:, 0] -= begin
    share /= 2 * reach[:, np.newaxis]
    pixel = first.astype(np.intp)[:, np.newaxis] + number
    return np.minimum(pixel, size - 1), share


def snapped(ray_angle: float, principal_angle: float) -> float:
    """Return the principal angle itself where the ray differs from it by rounding only."""
    exact = abs(ray_angle - principal_angle) <= RAY_ANGLE_TOLERANCE
    return principal_angle if exact else ray_angle
