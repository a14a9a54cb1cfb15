"""
Core: where a steadily turning arm is at a time, out of readings that are coarse and late.

A controller counts whole motor steps, and its answer to a query tells where the arm was somewhere
between the query and the answer. While the arm turns steadily, a line through the last readings is
better than any one of them; readings are used as long as one line agrees with all of them.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

#: Readings that a line is laid through at most, and for how long they are used [ns].
_READINGS, _MEMORY = 64, 5_000_000_000
#: How late a reading may be without that its delay shows it [s].
_UNSEEN_DELAY = 2e-4
#: A line needs this many readings to be better than the last one.
_FEWEST = 4


class Reading(NamedTuple):
    """
    One answer of the controller.

    Attributes
    ----------
    stamp : int
        When the position was asked for [ns].
    azimuth : float
        What was answered [rad].
    delay : float
        How much later than ``stamp`` it may have been read [s], beyond what every reading
        takes, ≥ 0.
    """

    stamp: int
    azimuth: float
    delay: float


class Estimate(NamedTuple):
    """
    Where the arm is believed to be.

    Attributes
    ----------
    azimuth, velocity : float
        [rad], [rad/s].
    uncertainty : float
        Standard deviation of the azimuth [rad].
    """

    azimuth: float
    velocity: float
    uncertainty: float


class TurnEstimator:
    """
    A line through the last readings of an arm that turns at a steady speed.

    Parameters
    ----------
    resolution : float
        One motor step [rad], > 0: readings are whole ones.
    """

    def __init__(self, resolution: float) -> None:
        self._resolution = resolution
        self._readings: deque[Reading] = deque(maxlen=_READINGS)

    def clear(self) -> None:
        """Forget all readings, because the arm was told to turn otherwise."""
        self._readings.clear()

    def add(self, reading: Reading) -> None:
        """
        Take a reading.

        Raises
        ------
        ValueError
            If its stamp is not later than that of the one before.
        """
        if self._readings and reading.stamp <= self._readings[-1].stamp:
            late = (self._readings[-1].stamp - reading.stamp) / 1e9
            raise ValueError(f'reading is {late:.6f} s older than the last one')
        self._readings.append(reading)
        while reading.stamp - self._readings[0].stamp > _MEMORY:
            self._readings.popleft()

    def at(self, stamp: int) -> Estimate | None:
        """
        Where the arm is at a time, by the newest readings that agree on a steady speed.

        Parameters
        ----------
        stamp : int
            In the time of the readings or a little later [ns].

        Returns
        -------
        Estimate or None
            None as long as too few readings agree, as while the arm speeds up.
        """
        while len(self._readings) >= _FEWEST:
            estimate = self._fit(stamp)
            if estimate is not None:
                return estimate
            for _ in range(max(1, len(self._readings) // 4)):
                self._readings.popleft()
        return None

    def _fit(self, stamp: int) -> Estimate | None:
        """Weighted least squares; None if a reading cannot lie on the line."""
        reference = self._readings[-1].stamp
        times = np.array([reading.stamp - reference for reading in self._readings]) * 1e-9
        azimuths = np.array([reading.azimuth for reading in self._readings])
        delays = np.array([reading.delay for reading in self._readings])
        origin = azimuths[-1]
        speed = (azimuths[-1] - azimuths[0]) / (times[-1] - times[0])
        # Evenly distributed within a motor step. Which of the two ways was delayed is unknown and
        # likely the same for all readings, so half the delay counts in full.
        variances = self._resolution**2 / 12.0 + (0.5 * speed * delays) ** 2
        middle = times + 0.5 * delays
        line, covariance = _line(middle, azimuths - origin, 1.0 / variances)
        off = np.abs(azimuths - origin - line[0] - line[1] * middle)
        allowed = 0.75 * self._resolution + abs(line[1]) * (0.5 * delays + _UNSEEN_DELAY)
        if np.any(off > allowed):
            return None
        at = np.array([1.0, (stamp - reference) * 1e-9])
        azimuth, variance = origin + at @ line, at @ covariance @ at
        return Estimate(float(azimuth), float(line[1]), float(np.sqrt(variance)))


def _line(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], weights: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Offset and slope of the line of least squares, and their covariance."""
    design = np.stack([np.ones_like(x), x], axis=1)
    inverse = np.linalg.inv(design.T @ (weights[:, None] * design))
    covariance: npt.NDArray[np.float64] = inverse.astype(np.float64)
    line = covariance @ (design.T @ (weights * y))
    return line, covariance
