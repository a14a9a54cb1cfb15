"""A pair of panoramas as the semi-global matching takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.interface import grey_pair
from panodepth_ros.matching.seam import Keys, canonical_seam, column_keys, texture_keys

Bytes = npt.NDArray[np.uint8]
Scalar = TypeVar('Scalar', bound=np.generic)


@dataclass(frozen=True, eq=False, slots=True)
class ColourPair:
    """
    A pair whose columns wrap around.

    Attributes
    ----------
    left, right : ndarray of uint8, shape (3, H, W)
        Blue, green, red; thrice the grey level of a grey panorama.
    left_grey, right_grey : ndarray of uint8, shape (H, W)
        Grey levels, interpolated across columns that were not seen.
    left_seen, right_seen : ndarray of bool, shape (W,)
        Whether a frame saw the column.
    first, candidates : int
        Candidate k of column x is column (x + first + k) mod W.
    keys : ndarray of int64, shape (W,)
        Of what was seen in and around both columns x, see ``seam.texture_keys``.
    """

    left: Bytes
    right: Bytes
    left_grey: Bytes
    right_grey: Bytes
    left_seen: npt.NDArray[np.bool_]
    right_seen: npt.NDArray[np.bool_]
    first: int
    candidates: int
    keys: Keys

    @property
    def seam(self) -> int:
        """Column at which to begin what cannot but begin somewhere."""
        return canonical_seam(self.keys)

    def partners(
        self, best: npt.NDArray[np.uint16], start: int = 0, stop: int | None = None
    ) -> npt.NDArray[np.intp]:
        """Right column of the candidates of columns start … stop − 1, shape (H, stop − start)."""
        columns = self.left_seen.size
        across = np.arange(start, columns if stop is None else stop)
        return np.asarray((across + self.first + best) % columns, np.intp)


def colour_pair(left: Panorama, right: Panorama) -> ColourPair:
    """
    Make a pair ready.

    Raises
    ------
    ValueError
        If the panoramas are not a symmetric pair, or too small for window and search range.
    """
    grey = grey_pair(left, right)
    seen = np.stack([grey.left_seen, grey.right_seen]).astype(np.uint8)
    keys = column_keys(seen, grey.left, grey.right)
    return ColourPair(
        left=colours(left),
        right=colours(right),
        left_grey=bridged(grey.left, grey.left_seen),
        right_grey=bridged(grey.right, grey.right_seen),
        left_seen=grey.left_seen,
        right_seen=grey.right_seen,
        first=grey.first,
        candidates=grey.last - grey.first + 1,
        keys=texture_keys(grey.left, grey.left_seen, keys),
    )


def colours(panorama: Panorama) -> Bytes:
    """Blue, green and red of a panorama, shape (3, H, W); thrice the grey level of a grey one."""
    image = panorama.image
    if image.ndim == 3:
        return np.ascontiguousarray(np.moveaxis(image, 2, 0))
    return np.repeat(image[np.newaxis], 3, axis=0)


def bridged(grey: Bytes, seen: npt.NDArray[np.bool_]) -> Bytes:
    """Grey levels with unseen columns interpolated, so that windows beside them stay usable."""
    if seen.all() or not seen.any():
        return grey
    known = np.flatnonzero(seen)
    known = np.concatenate([[known[-1] - seen.size], known, [known[0] + seen.size]])
    gaps = np.flatnonzero(~seen)
    after = np.searchsorted(known, gaps)
    start, stop = known[after - 1], known[after]
    share = (gaps - start) / (stop - start)
    before = grey[:, start % seen.size].astype(np.float64)
    beyond = grey[:, stop % seen.size]
    bridged = grey.copy()
    bridged[:, gaps] = np.rint(before + share * (beyond - before))
    return bridged


def wrapped(array: npt.NDArray[Scalar], start: int, stop: int) -> npt.NDArray[Scalar]:
    """Columns start … stop − 1 of an array that wraps around."""
    found = np.empty((*array.shape[:-1], stop - start), array.dtype)
    at = 0
    while at < stop - start:  # whole runs of columns: many times faster than one by one
        run = array[..., (start + at) % array.shape[-1] :][..., : stop - start - at]
        found[..., at : at + run.shape[-1]] = run
        at += run.shape[-1]
    return found


def put(array: npt.NDArray[Scalar], start: int, values: npt.NDArray[Scalar]) -> None:
    """Put columns in the place of those from ``start`` on of an array that wraps around."""
    at, columns = 0, values.shape[-1]
    while at < columns:
        run = array[..., (start + at) % array.shape[-1] :][..., : columns - at]
        run[...] = values[..., at : at + run.shape[-1]]
        at += run.shape[-1]
