"""
Where a turning arm was when: azimuth and velocity at any time, out of dense joint states.

The counterpart of ``arm_track``, which knows standstills only. A time that no two joint states
enclose closely has no azimuth: nothing is extrapolated.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from dataclasses import dataclass
from itertools import islice

from panodepth_ros.mosaic.arm_track import HISTORY, check_joint_state


@dataclass(frozen=True, slots=True)
class Turning:
    """
    The arm at a moment of its turn.

    Attributes
    ----------
    azimuth : float
        Arm azimuth γ [rad], continuous.
    velocity : float
        [rad/s], counter-clockwise positive.
    """

    azimuth: float
    velocity: float


class ArmMotion:
    """
    Joint states in the order of their stamps, interpolated.

    Parameters
    ----------
    longest_gap : int
        Longest time between two joint states that still says what happened between them [ns].

    Notes
    -----
    Interpolation is linear. Between joint states that are Δt apart it errs by at most a·Δt²/8
    while the arm accelerates by a; a steadily turning arm has no such error.
    """

    def __init__(self, longest_gap: int) -> None:
        self._longest_gap = longest_gap
        self._states: deque[tuple[int, float]] = deque()

    @property
    def newest(self) -> int | None:
        """Stamp of the newest joint state [ns]; None before the first."""
        return self._states[-1][0] if self._states else None

    @property
    def position(self) -> float:
        """Position of the newest joint state [rad]; NaN before the first."""
        return self._states[-1][1] if self._states else math.nan

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
            Must be finite; positions and stamps tell it better.

        Raises
        ------
        ValueError
            If the stamp does not grow or a number is not finite.
        """
        check_joint_state(self.newest, stamp, position, velocity)
        self._states.append((stamp, position))
        while len(self._states) > 2 and self._states[1][0] < stamp - HISTORY:
            self._states.popleft()

    def forget(self) -> None:
        """Forget all joint states: their clock was set."""
        self._states.clear()

    def at(self, stamp: int) -> Turning | str | None:
        """
        Where the arm was at a time, and how fast it turned.

        Parameters
        ----------
        stamp : int
            Time of exposure [ns].

        Returns
        -------
        Turning, str or None
            The arm; or why it is unknown; or None if only later joint states can tell.
        """
        newest = self.newest
        if newest is None or stamp > newest:
            return None
        after = bisect.bisect_left(self._states, stamp, key=lambda state: state[0])
        if after == 0 and self._states[0][0] != stamp:
            return 'no joint state near its stamp'
        first = max(after - 1, 0)
        if first + 1 == len(self._states):
            return None  # the only joint state so far
        (t0, p0), (t1, p1) = islice(self._states, first, first + 2)
        if t1 - t0 > self._longest_gap:
            return 'no joint state near its stamp'
        velocity = (p1 - p0) / (t1 - t0)
        return Turning(p0 + velocity * (stamp - t0), velocity * 1e9)
