"""States of an arm, told to a listener in the order of their stamps."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from panodepth_ros.arm.interface import ArmState
from panodepth_ros.motion.turning import Reading, TurnEstimator

#: A clock this far behind the stamps it gave was set back [ns].
_SET_BACK = 10_000_000
#: How many round trips the shortest one is taken from.
_ROUND_TRIPS = 64


class StateTeller:
    """
    Tells where the arm is; of a steadily turning one better than any single reading does.

    Parameters
    ----------
    clock : callable
        Gives the stamps of states [ns].
    listener : callable
        Called with every state.
    """

    def __init__(self, clock: Callable[[], int], listener: Callable[[ArmState], None]) -> None:
        self._clock = clock
        self._listener = listener
        self._last_stamp = 0
        self._round_trips: deque[float] = deque(maxlen=_ROUND_TRIPS)
        self._estimator: TurnEstimator | None = None

    def resolve(self, motor_step: float) -> None:
        """Take note of the smallest motion [rad], before anything turns."""
        self._estimator = TurnEstimator(motor_step)

    def begin(self, azimuth: float, velocity: float) -> None:
        """Tell that a motion of a commanded velocity [rad/s] begins."""
        self.forget()
        self.tell(self._clock(), azimuth, velocity)

    def forget(self) -> None:
        """Forget how the arm turned: it stands, or was told to turn otherwise."""
        if self._estimator is not None:
            self._estimator.clear()

    def turn(self, stamp: int, azimuth: float, velocity: float, round_trip: float) -> None:
        """
        Tell how the arm turns: by a line through the last readings, as soon as one fits.

        Parameters
        ----------
        stamp : int
            When the position was asked for [ns].
        azimuth : float
            What was answered [rad].
        velocity : float
            What is believed of it as long as no line fits [rad/s].
        round_trip : float
            From the query to the answer [s]; +inf if it is not known.
        """
        self._follow_clock()
        estimate = None
        if self._estimator is not None and stamp > self._last_stamp:
            if math.isfinite(round_trip):
                self._round_trips.append(round_trip)
                delay = round_trip - min(self._round_trips)
                self._estimator.add(Reading(stamp, azimuth, delay))
            estimate = self._estimator.at(stamp)
        if estimate is not None and estimate.velocity:
            azimuth, velocity = estimate.azimuth, estimate.velocity
        self.tell(stamp, azimuth, velocity)

    def tell(self, stamp: int, azimuth: float, velocity: float) -> ArmState:
        """
        Tell a state as it is, but for a stamp that does not grow, and return it.

        Stamps go back only if the clock was set back: who listens has to know of that.
        """
        self._follow_clock()
        self._last_stamp = max(stamp, self._last_stamp + 1)
        state = ArmState(self._last_stamp, azimuth, velocity)
        self._listener(state)
        return state

    def _follow_clock(self) -> None:
        if self._clock() < self._last_stamp - _SET_BACK:
            self._last_stamp = 0
            self.forget()
