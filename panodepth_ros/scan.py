"""From points to a LaserScan's ranges: the nearest surface in a height band, beam by beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Points

#: Pixels whose distances differ by no more than this share belong to one surface.
SURFACE_DEPTH = 0.04


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSettings:
    """
    How points become beams.

    Attributes
    ----------
    beams : int
        N, beams of a full turn; beam k points at −π + k·2π/N.
    range_min, range_max : float
        Limits of the ranges [m].
    min_height, max_height : float
        Height band above the optical centre [m], both included.
    min_confidence : float
        Least confidence of a pixel that counts.
    min_support : int
        Least number of pixels that make a surface.
    row : int
        Use this single row of the panorama instead of the height band; −1 for the band.

    Raises
    ------
    ValueError
        If the values contradict each other.
    """

    beams: int = 720
    range_min: float = 0.35
    range_max: float = 8.0
    min_height: float = -0.15
    max_height: float = 0.15
    min_confidence: float = 0.0
    min_support: int = 3
    row: int = -1

    def __post_init__(self) -> None:
        if self.beams < 60:
            raise ValueError(f'beams is {self.beams}; allowed: at least 60')
        if not 0 < self.range_min < self.range_max < np.inf:
            raise ValueError(
                f'range_min is {self.range_min} m and range_max {self.range_max} m; '
                'allowed: 0 < range_min < range_max'
            )
        if not self.min_height < self.max_height:
            raise ValueError(
                f'min_height is {self.min_height} m and max_height {self.max_height} m; '
                'allowed: min_height < max_height'
            )

    @property
    def angle_increment(self) -> float:
        """Angle between beams [rad]."""
        return 2 * np.pi / self.beams


def laser_ranges(
    points: Points, confidence: npt.NDArray[np.float32], settings: ScanSettings
) -> npt.NDArray[np.float32]:
    """
    Ranges of a LaserScan.

    Parameters
    ----------
    points : Points
        Radial distance, azimuth and height of every pixel, shape (H, W).
    confidence : ndarray of float32, shape (H, W)
        Confidence of every pixel, NaN where unknown.
    settings : ScanSettings
        Band, limits, support.

    Returns
    -------
    ndarray of float32, shape (beams,)
        Range of each beam [m], counter-clockwise from −π (REP-117): NaN where nothing is known,
        +inf where the nearest surface is farther than ``range_max``, −inf where it is nearer
        than ``range_min``.

    Raises
    ------
    ValueError
        If the single row lies outside the panorama or the shapes differ.

    Notes
    -----
    A surface is the nearest group of at least ``min_support`` pixels of one beam whose distances
    lie within :data:`SURFACE_DEPTH` of the nearest of them; its range is their median.
    """
    distance, azimuth, height = points.radial_distance, points.azimuth, points.height
    if confidence.shape != distance.shape:
        raise ValueError(f'confidence has shape {confidence.shape}; allowed: {distance.shape}')
    if settings.row >= distance.shape[0]:
        raise ValueError(f'row is {settings.row}; allowed: -1 to {distance.shape[0] - 1}')
    with np.errstate(invalid='ignore'):
        use = np.isfinite(distance) & (confidence >= settings.min_confidence)
        if settings.row >= 0:
            use[: settings.row] = use[settings.row + 1 :] = False
        else:
            use &= (height >= settings.min_height) & (height <= settings.max_height)
    beam = np.rint((azimuth[use] + np.pi) / settings.angle_increment).astype(np.int64)
    beam %= settings.beams
    found = distance[use]
    support = 1 if settings.row >= 0 else settings.min_support
    return _as_ranges(_nearest_surfaces(beam, found, settings.beams, support), settings)


def _as_ranges(
    nearest: npt.NDArray[np.float64], settings: ScanSettings
) -> npt.NDArray[np.float32]:
    with np.errstate(invalid='ignore'):
        nearest = np.where(nearest > settings.range_max, np.inf, nearest)
        nearest = np.where(nearest < settings.range_min, -np.inf, nearest)
    return nearest.astype(np.float32)


def _nearest_surfaces(
    beam: npt.NDArray[np.int64], distance: npt.NDArray[np.float64], beams: int, support: int
) -> npt.NDArray[np.float64]:
    """Distance of the nearest supported surface of each beam, NaN where there is none."""
    order = np.lexsort((distance, beam))
    beam, distance = beam[order], distance[order]
    index = np.arange(beam.size)
    # Sorted by beam, then distance: pixel i starts a surface if the pixel `support − 1` places
    # on is of the same beam and close enough.
    last = index + support - 1
    inside = last < beam.size
    reachable = np.minimum(last, max(beam.size - 1, 0))
    starts = inside & (beam[reachable] == beam)
    starts &= distance[reachable] <= distance * (1 + SURFACE_DEPTH)
    nearest = np.full(beams, np.nan)
    first_beam, first = np.unique(beam[starts], return_index=True)
    ends = np.searchsorted(beam, first_beam, side='right')
    for k, start, end in zip(first_beam, index[starts][first], ends, strict=True):
        group = distance[start:end]
        nearest[k] = np.median(group[group <= group[0] * (1 + SURFACE_DEPTH)])
    return nearest
