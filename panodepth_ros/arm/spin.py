"""
Steady turning on a GRBL controller.

The controller's planner is fed with straight moves of a turn or more, all in one direction: it
blends such moves into each other and plans to stop at the end of the last one. So there is always
more way in the planner than the arm needs to brake, and never more lines under way than the
controller's input holds. Short moves also keep the firmware's 32-bit rest of the way exact, which
else makes the speed of a very long move wrong by up to a per cent.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmProtocolError
from panodepth_ros.arm.link import GrblLink, SentLine
from panodepth_ros.arm.reports import Report, Reports

#: How long the planner can do without new moves [s], besides the time to brake.
_RESERVE = 1.0
#: Longest time between two reports [s], so that the planner does not run dry.
_LONGEST_PERIOD = 0.1
#: Into how many moves the way ahead is cut at least; the planner holds 15.
_MOVES_AHEAD = 8


class Leg:
    """
    One steady turn from where the arm stands to where it turns back.

    Parameters
    ----------
    link, reports
        The controller; the arm stands and no other command runs.
    axis : str
        Letter of the axis.
    speed : float
        [rad/s], > 0.
    """

    def __init__(self, link: GrblLink, reports: Reports, axis: str, speed: float) -> None:
        self._link = link
        self._reports = reports
        self._axis = axis
        self._speed = speed
        self._ahead = _RESERVE * speed + speed**2 / (2.0 * math.radians(reports.setting(120)))
        self._length = max(2.0 * math.pi, self._ahead / _MOVES_AHEAD)
        self._lines: list[SentLine] = []
        self._sent = math.nan  # target of the last move
        self._end = math.nan

    def run(
        self,
        start: Report,
        end: float,
        period: Callable[[], float],
        changed: Callable[[], bool],
        started: Callable[[], None],
    ) -> bool:
        """
        Turn to the end.

        Parameters
        ----------
        start : Report
            Where the arm stands.
        end : float
            Where to [rad].
        period : callable
            Time between two reports [s].
        changed : callable
            Asked at every report whether to give up this leg.
        started : callable
            Called whenever the controller has accepted all moves so far.

        Returns
        -------
        bool
            True if the arm is at the end; False if the leg was given up, with the arm turning.

        Raises
        ------
        ArmProtocolError
            If the controller refuses a move, or the arm stands although it should turn.
        ArmError
            Whatever else breaks a motion.
        """
        self._sent, self._end = start.azimuth, end
        position = start.azimuth
        moved = time.monotonic()
        while not self._over():
            self._feed(position)
            self._link.until(self._over, min(period(), _LONGEST_PERIOD))
            if self._lines[-1].answer is not None:
                self._link.require_ok(self._lines)
                started()
            report = self._reports.ask()
            self._reports.turn(report)
            position = report.azimuth
            if report.status.state == 'Run':
                moved = time.monotonic()
            elif time.monotonic() - moved > self._link.response_timeout:
                raise ArmProtocolError(
                    f'arm on port {self._link.port} should turn, but the controller reports '
                    f'{report.status.state} at {math.degrees(report.azimuth):.3f}°'
                )
            if changed():
                return False
        return True

    def _over(self) -> bool:
        """Whether the barrier behind the last move is answered."""
        return self._sent == self._end and self._lines[-1].answer is not None

    def _feed(self, position: float) -> None:
        """Send a move if there is too little way ahead and the last one was taken."""
        way = self._end - self._sent
        scarce = abs(self._sent - position) < self._ahead + self._length
        if way == 0.0 or not scarce or (self._lines and self._lines[-1].answer is None):
            return
        if abs(way) > 1.5 * self._length:
            self._sent += math.copysign(self._length, way)
            behind = []
        else:
            self._sent = self._end
            behind = [grbl.BARRIER]
        feed = math.degrees(self._speed) * 60.0
        move = grbl.encode_move(self._axis, self._reports.machine(self._sent), feed)
        self._lines = self._link.send(move, *behind, moves=True)
