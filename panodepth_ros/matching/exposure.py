"""
The same brightness in both eyes: gain and offset per colour from a rough match; what is clipped.

Colours are compared as they are, which is what carries depth into surfaces without texture, but
a camera that changed its exposure between the two sightings would make everything differ.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.semiglobal_costs import CENSUS_COLUMNS, CENSUS_ROWS

Bytes = npt.NDArray[np.uint8]

#: Grey levels outside of these may be clipped and tell nothing.
DARKEST, BRIGHTEST = 6, 248
#: Corrections below this are noise of the estimate and are not made [grey levels].
LEAST_CHANGE = 0.75
#: Fewest pixels that an estimate may rest on.
LEAST_PIXELS = 200
#: Pixels that are enough for an estimate.
ENOUGH_PIXELS = 3000


def clipped(panorama: Panorama) -> npt.NDArray[np.bool_]:
    """
    Areas of a panorama that are overexposed or black: what is in them cannot be told.

    Where such an area ends, the light ends, and not a surface: its edges tell nothing of its
    depth, as those of a plain wall do.

    Returns
    -------
    ndarray of bool, shape (H, W)
        Whether a pixel is part of a census window in which every channel is 0 everywhere or 255
        everywhere. Columns that were not seen are part of none.
    """
    window = np.ones((2 * CENSUS_ROWS + 1, 2 * CENSUS_COLUMNS + 1), np.uint8)
    around = 2 * CENSUS_COLUMNS
    columns = np.arange(-around, panorama.geometry.columns + around) % panorama.geometry.columns
    unseen = ~panorama.geometry.seen
    # Mostly no window is all 0 or 255, which one plane tells; three take many times as long.
    zero_or_one = panorama.image + np.uint8(1)
    channels = 1 if zero_or_one.ndim == 2 else 3
    extreme = cv2.inRange(zero_or_one, (0,) * channels, (1,) * channels)
    extreme[:, unseen] = 0
    if not cv2.erode(extreme[:, columns], window).any():
        return np.zeros(extreme.shape, np.bool_)
    image = panorama.image[:, columns]
    image[:, unseen[columns]] = 128
    whole = (cv2.erode(image, window) == 255) | (cv2.dilate(image, window) == 0)
    if whole.ndim == 3:
        whole = whole.all(axis=2)
    areas = cv2.dilate(whole.astype(np.uint8), window)[:, around:-around]
    return np.asarray(areas > 0)


def level_tables(left: Bytes, right: Bytes) -> Bytes | None:
    """
    Tables that give the left eye's colours the brightness of the right eye's.

    Parameters
    ----------
    left, right : ndarray of uint8, shape (3, M)
        Colours of points that both eyes see.

    Returns
    -------
    ndarray of uint8, shape (3, 256), or None
        New value of each value, or None where nothing needs to change.

    Notes
    -----
    Gain is the ratio of the standard deviations, offset the difference of the means, over the
    points that fit three median deviations well, twice.
    """
    inside = np.all((left > DARKEST) & (left < BRIGHTEST), axis=0)
    inside &= np.all((right > DARKEST) & (right < BRIGHTEST), axis=0)
    points = np.flatnonzero(inside)
    if points.size < LEAST_PIXELS:
        return None
    points = points[:: -(-points.size // ENOUGH_PIXELS)]
    tables = np.empty((3, 256), np.uint8)
    change = 0.0
    for channel in range(3):
        x = left[channel, points].astype(np.float64)
        y = right[channel, points].astype(np.float64)
        gain, offset = 1.0, float(np.median(y - x))
        for _ in range(3):
            residual = np.abs(y - (gain * x + offset))
            fits = residual <= 3 * max(float(np.median(residual)), 1.0)
            spread = float(np.std(x[fits]))
            gain = float(np.std(y[fits])) / spread if spread > 1.0 else 1.0
            offset = float(np.mean(y[fits]) - gain * np.mean(x[fits]))
        middle, spread = float(np.mean(x)), float(np.std(x))
        for level in (middle - spread, middle, middle + spread):
            change = max(change, abs(gain * level + offset - level))
        levels = np.rint(gain * np.arange(256) + offset)
        tables[channel] = np.clip(levels, 0, 255).astype(np.uint8)
    return tables if change >= LEAST_CHANGE else None
