"""
Where the arm stood when: standstills out of a stream of joint states.

A frame belongs to an arm azimuth only if the joint states just before and just after its stamp
agree that the arm stood still there, and if the arm was seen to arrive: then it is known to have
settled. That rule needs nothing but the data, so a live sweep and its replay decide alike. Who
leads the arm may know before the next joint state that it stands on.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

#: How long standstills are remembered for late frames [ns].
HISTORY = 30_000_000_000


def check_joint_state(
    newest: int | None, stamp: int, position: float, velocity: float | None
) -> None:
    """
    Refuse a joint state that cannot be placed after the newest one.

    Raises
    ------
    ValueError
        If the stamp [ns] does not grow, or position or velocity is not finite.
    """
    if not math.isfinite(position) or not math.isfinite(velocity or 0.0):
        raise ValueError(f'joint state has position {position}, velocity {velocity}')
    if newest is not None and stamp <= newest:
        raise ValueError(f'joint state is {(newest - stamp) / 1e9:.6f} s out of order')


@dataclass(slots=True)
class Standstill:
    """
    A stretch of time in which the arm did not move.

    Attributes
    ----------
    azimuth : float
        Measured arm azimuth γ [rad], continuous.
    start, end : int
        From the stamp of its first joint state to that of its last one so far, or to a later time
        until which the arm is known to stand [ns].
    arrived : bool
        Whether a motion was seen before it.
    """

    azimuth: float
    start: int
    end: int
    arrived: bool


class ArmTrack:
    """
    Standstills of the arm, from joint states in the order of their stamps.

    Parameters
    ----------
    tolerance : float
        Largest change of position that still counts as standing [rad].
    longest_gap : int
        Longest time between two joint states that still says what happened between them [ns].
    """

    def __init__(self, tolerance: float, longest_gap: int) -> None:
        self._tolerance = tolerance
        self._longest_gap = longest_gap
        self.forget()

    def forget(self) -> None:
        """Forget all joint states: their clock was set."""
        self._standstills: deque[Standstill] = deque()
        self._first: int | None = None
        self._newest: int | None = None
        self._position = math.nan
        self._still = False

    @property
    def newest(self) -> int | None:
        """Stamp of the newest joint state [ns]; None before the first."""
        return self._newest

    @property
    def position(self) -> float:
        """Position of the newest joint state [rad]; NaN before the first."""
        return self._position

    @property
    def current(self) -> Standstill | None:
        """The standstill that the newest joint state belongs to; None while the arm moves."""
        return self._standstills[-1] if self._still else None

    def add(self, stamp: int, position: float, velocity: float | None) -> None:
        """
        Take one joint state.

        Parameters
        ----------
        stamp : int
            When the position was read [ns].
        position : float
            Arm azimuth [rad], continuous.
        velocity : float or None
            [rad/s], exactly 0 only while the arm stands and has settled; None if not measured.

        Raises
        ------
        ValueError
            If the stamp does not grow or a number is not finite.
        """
        check_joint_state(self._newest, stamp, position, velocity)
        near = self._newest is not None and stamp - self._newest <= self._longest_gap
        same = abs(position - self._position) <= self._tolerance
        if velocity:
            self._still = False
        elif self._still and near and same:
            self._standstills[-1].end = max(stamp, self._standstills[-1].end)
        else:
            goes_on = self._still and same  # after a silence
            arrived = self._standstills[-1].arrived if goes_on else self._newest is not None
            self._standstills.append(Standstill(position, stamp, stamp, arrived))
            self._still = True
        self._position = position
        self._first = stamp if self._first is None else self._first
        self._newest = stamp
        while len(self._standstills) > 1 and self._standstills[0].end < stamp - HISTORY:
            self._first = self._standstills.popleft().end

    def at(self, stamp: int) -> Standstill | str | None:
        """
        Where the arm stood at a time.

        Parameters
        ----------
        stamp : int
            Time of exposure [ns].

        Returns
        -------
        Standstill, str or None
            The standstill; or why there is none; or None if only later joint states can tell.
        """
        current = self.current
        known = self._newest if current is None else current.end
        if known is None or stamp > known:
            return None
        if self._first is not None and stamp < self._first:
            return 'no joint state near its stamp'
        before = [run for run in reversed(self._standstills) if run.start <= stamp][:1]
        if before and stamp <= before[0].end:
            return before[0] if before[0].arrived else 'arm was not seen to arrive'
        after = next((run for run in self._standstills if run.start > stamp), None)
        silent = before and after and after.start - before[0].end > self._longest_gap
        return 'no joint state near its stamp' if silent else 'arm moved'
