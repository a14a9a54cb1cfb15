"""
The clocks of camera and arm: one that was set back, and the constant delay between the two.

A clock that is set back shows in the order of the stamps. The delay comes out of turns to both
sides.

A frame whose true exposure is later than believed lies behind the arm in the direction of the
turn. So the panoramas of a forward and a backward turn are shifted against each other by the
delay times the difference of their velocities; from one direction alone it cannot be told.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama

Array = npt.NDArray[np.float64]

#: So many stamps that are older than the newest, but in order, tell that their clock was set back.
LATE_IN_A_ROW = 5
#: Sectors of the turn that estimate the shift each for itself.
SECTORS = 12
#: Fewest sectors with anything to see that make an estimate.
FEWEST_SECTORS = 4
#: Gauss-Newton steps, and the smoothing before them [columns].
STEPS, SMOOTHING = 20, 1.5
#: Least mean squared gradient of a sector [grey levels² per column²].
LEAST_GRADIENT = 4.0


class StampOrder:
    """
    Watches the stamps of one source for its clock being set back.

    Attributes
    ----------
    newest : int or None
        Newest stamp by the clock as it is set now [ns]; None before the first.
    """

    def __init__(self) -> None:
        self.newest: int | None = None
        self._late, self._late_stamp = 0, 0

    def see(self, stamp: int) -> int | None:
        """
        Take the next stamp.

        Parameters
        ----------
        stamp : int
            [ns].

        Returns
        -------
        int or None
            By how much the clock was set back before this stamp [ns], nearly always 0; None if
            the stamp is not newer than the newest, a single one that is late or comes twice.
        """
        newest = self.newest
        if newest is None or stamp > newest:
            self.newest, self._late = stamp, 0
            return 0
        self._late = self._late + 1 if self._late and stamp > self._late_stamp else 1
        self._late_stamp = stamp
        if self._late < LATE_IN_A_ROW:
            return None
        self.newest, self._late = stamp, 0
        return newest - stamp


@dataclass(frozen=True, slots=True)
class DelayEstimate:
    """
    How much later frames were exposed than their present delay says.

    Attributes
    ----------
    delay : float
        To be added to the delay in use [s].
    stddev : float
        Standard deviation of it, from how the sectors of the turn differ [s].
    """

    delay: float
    stddev: float


def estimate_delay(
    forward: Panorama, backward: Panorama, velocities: tuple[float, float]
) -> DelayEstimate:
    """
    Delay from two panoramas of one eye, taken turning to either side.

    Parameters
    ----------
    forward, backward : Panorama
        Of one principal angle and size, H × W.
    velocities : (float, float)
        Mean velocity of the arm in each [rad/s], signed.

    Returns
    -------
    DelayEstimate

    Raises
    ------
    ValueError
        If the panoramas do not belong together, the arm turned one way in both, or too little
        can be seen.

    Notes
    -----
    Placed minus true azimuth is −ω·τ for a delay τ not accounted for. A scene azimuth β lies in
    the forward panorama at β − ω_f·τ and in the backward one at β − ω_b·τ.
    """
    one, other = forward.geometry, backward.geometry
    for name in ('columns', 'rows', 'principal_angle'):
        if not np.isclose(getattr(one, name), getattr(other, name)):
            raise ValueError(
                f'{name} is {getattr(one, name)} forward and {getattr(other, name)} backward'
            )
    difference = velocities[0] - velocities[1]
    if velocities[0] * velocities[1] >= 0:
        raise ValueError(
            f'the arm turned by {velocities[0]:.3g} and {velocities[1]:.3g} rad/s; '
            'allowed: once to either side'
        )
    # Columns run clockwise: a larger azimuth is a smaller column.
    known = other.azimuth_column - one.azimuth_column
    shifts = _sector_shifts(_grey(forward), _grey(backward), one.seen, other.seen, known)
    if shifts.size < FEWEST_SECTORS:
        raise ValueError(
            f'only {shifts.size} of {SECTORS} sectors show enough; allowed: {FEWEST_SECTORS}'
        )
    # The backward column of what the forward one shows is x + known + (ω_b − ω_f)·τ/θ0.
    delays = -(shifts - known) * one.column_step / difference
    centre = float(np.median(delays))
    spread = 1.4826 * float(np.median(np.abs(delays - centre)))
    return DelayEstimate(centre, 1.2533 * spread / np.sqrt(delays.size))


class DelayCheck:
    """Watches sweep after sweep for two to either side, and tells the delay they show."""

    def __init__(self) -> None:
        self._last: tuple[Panorama, float, int] | None = None

    def add(self, center: Panorama, velocity: float, end: int) -> DelayEstimate | None:
        """
        Take the next sweep.

        Parameters
        ----------
        center : Panorama
            Of the sweep.
        velocity : float
            Mean velocity of the arm [rad/s], signed.
        end : int
            Stamp of the sweep's last frame [ns].

        Returns
        -------
        DelayEstimate or None
            None if the sweep before turned the same way, was of another size, ended longer
            before this one began than it took itself, for the robot may have turned meanwhile,
            or too little can be seen. A pair of sweeps is used once, for a correction may come
            between two pairs.
        """
        last, self._last = self._last, (center, velocity, end)
        if last is None or last[1] * velocity >= 0:
            return None
        pause = (end - last[2]) * 1e-9 - center.geometry.sweep_duration
        if not 0 <= pause <= last[0].geometry.sweep_duration:
            return None
        try:
            found = estimate_delay(last[0], center, (last[1], velocity))
        except ValueError:
            return None
        self._last = None
        return found


def _grey(panorama: Panorama) -> Array:
    image = panorama.image
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    turned = np.concatenate([grey, grey, grey], axis=1).astype(np.float64)
    smooth = cv2.GaussianBlur(turned, (0, 0), sigmaX=SMOOTHING, sigmaY=0.5)
    return np.asarray(smooth[:, grey.shape[1] : 2 * grey.shape[1]])


def _sector_shifts(
    one: Array,
    other: Array,
    seen: npt.NDArray[np.bool_],
    other_seen: npt.NDArray[np.bool_],
    start: float,
) -> Array:
    """By how many columns ``other`` lies to the right of ``one``, sector by sector."""
    columns = one.shape[1]
    spectrum = np.fft.rfft(one - one.mean(1, keepdims=True), axis=1).conj()
    spectrum *= np.fft.rfft(other - other.mean(1, keepdims=True), axis=1)
    correlation = np.fft.irfft(spectrum.sum(axis=0), columns)
    rough = float(np.argmax(correlation))
    rough = start + (rough - start + columns / 2) % columns - columns / 2
    edges = np.linspace(0, columns, SECTORS + 1).astype(int)
    found = []
    for first, last in pairwise(edges):
        shift = _shift(one, other, seen, other_seen, np.arange(first, last), rough)
        if shift is not None:
            found.append(shift)
    return np.array(found)


def _shift(
    one: Array,
    other: Array,
    seen: npt.NDArray[np.bool_],
    other_seen: npt.NDArray[np.bool_],
    x: npt.NDArray[np.int64],
    shift: float,
) -> float | None:
    """Least-squares shift of one sector; None where it shows too little."""
    columns = one.shape[1]
    begin = shift
    for _ in range(STEPS):
        at = x + shift
        low = np.floor(at).astype(np.int64)
        share = at - low
        low, high = low % columns, (low + 1) % columns
        use = seen[x] & other_seen[low] & other_seen[high]
        if use.sum() < x.size / 2:
            return None
        value = other[:, low] * (1 - share) + other[:, high] * share
        gradient = (other[:, high] - other[:, low])[:, use]
        if (gradient**2).mean() < LEAST_GRADIENT:
            return None
        residual = one[:, x[use]] - value[:, use]
        step = float((gradient * residual).sum() / (gradient**2).sum())
        shift += float(np.clip(step, -1.0, 1.0))
        if abs(shift - begin) > x.size / 4:
            return None
        if abs(step) < 1e-4:
            return shift
    return None
