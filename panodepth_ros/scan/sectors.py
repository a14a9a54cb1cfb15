"""Beams of a scan that is still made: which ones are decided, and the newest of each."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.scan.beams import NEIGHBOURHOOD, ScanSettings

Columns = npt.NDArray[np.intp]
Nanoseconds = npt.NDArray[np.int64]


def columns_of_beams(left: PanoramaGeometry, settings: ScanSettings) -> Columns:
    """
    Columns of the left panorama that may have a part in each beam.

    Parameters
    ----------
    left : PanoramaGeometry
        Of the left eye; at least one column was seen.
    settings : ScanSettings
        Number of the beams.

    Returns
    -------
    ndarray of int, shape (beams, M)
        Beam by beam; a column may be named twice.

    Notes
    -----
    A point beyond the arm's circle stands to the left of the ray that the left eye sees it along,
    by 0 at the horizon to |ψ| at the circle. Beam α therefore depends on the columns that look
    along α − |ψ| … α, and, by the support of surfaces, on those of its neighbourhood.
    """
    angles = left.ray_angle[left.seen]
    widest = float(np.abs(angles).max())
    beside = NEIGHBOURHOOD + settings.angle_increment + left.column_step
    if math.isfinite(left.stripe_distance):
        beside += float(np.abs(left.stripe_turn(angles)).max())
    azimuth = -np.pi + np.arange(settings.beams) * settings.angle_increment
    first = np.floor(left.azimuth_column - (azimuth + beside) / left.column_step)
    count = math.ceil((widest + 2 * beside) / left.column_step) + 1
    columns = first[:, np.newaxis].astype(np.intp) + np.arange(min(count, left.columns))
    return np.asarray(columns % left.columns, np.intp)


def oldest_of_columns(time: Nanoseconds, first: int, last: int) -> Nanoseconds:
    """
    Oldest of the columns x + first … x + last, which wrap around, for every column x.

    Parameters
    ----------
    time : ndarray of int64, shape (W,)
        When each column was exposed [ns].
    first, last : int
        What has a part in a column's match.

    Returns
    -------
    ndarray of int64, shape (W,)
    """
    turn = np.take(time, np.arange(first, time.size + last), mode='wrap')
    windows = np.lib.stride_tricks.sliding_window_view(turn, last - first + 1)
    return np.asarray(windows.min(axis=1), np.int64)


class SectorScan:
    """
    The newest measurement of each beam.

    Attributes
    ----------
    ranges : ndarray of float32, shape (beams,)
        As of :func:`laser_ranges` [m]; NaN where nothing was measured.
    time : ndarray of int64, shape (beams,)
        When the oldest frame was exposed that has a part in it [ns].
    """

    def __init__(self, beams: int) -> None:
        self.ranges = np.full(beams, np.nan, np.float32)
        self.time = np.zeros(beams, np.int64)

    def take(
        self,
        decided: npt.NDArray[np.bool_],
        ranges: npt.NDArray[np.float32],
        time: Nanoseconds,
    ) -> None:
        """Replace the beams that are decided; what is NaN among them is unknown from now on."""
        self.ranges[decided] = ranges[decided]
        self.time[decided] = time[decided]

    def forget_before(self, time: int) -> None:
        """Forget beams in which older frames have a part [ns]."""
        self.ranges[self.time < time] = np.nan

    def age(self, now: int) -> npt.NDArray[np.float32]:
        """Age of each beam [s], NaN where the range is."""
        age = (now - self.time) * 1e-9
        return np.where(np.isnan(self.ranges), np.nan, age).astype(np.float32)
