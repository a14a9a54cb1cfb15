"""
Braking an arm on a GRBL controller without losing its count.

That takes three steps: feed hold ``!``, wait for ``Hold:0``, soft reset. The reset then drops the
rest of the motion but keeps the position, whereas a reset of a moving arm stops the pulses at
once and loses it. A jog could be cancelled by one byte, but its end has no barrier: lines are
refused while it runs.
"""

from __future__ import annotations

import math
import time

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmTimeoutError
from panodepth_ros.arm.link import GrblLink
from panodepth_ros.arm.reports import Reports

#: Status period while the arm brakes [s].
_PERIOD = 0.02
#: How long the arm may take to stop as long as nothing is known of it [s].
_UNKNOWN = 5.0


class Brake:
    """
    Stops the arm of a connected controller.

    Parameters
    ----------
    link, reports
        The controller.
    settle_time : float
        How long the arm swings after a motion [s].

    Attributes
    ----------
    speed : float
        Speed of the arm's motions [rad/s].
    """

    def __init__(self, link: GrblLink, reports: Reports, settle_time: float) -> None:
        self._link = link
        self._reports = reports
        self._settle_time = settle_time
        self.speed = 0.0

    def halt(self) -> None:
        """
        Brake, drop all motions, and wait until the arm stands and has settled.

        Raises
        ------
        ArmError
            If the controller does not answer, is in alarm, or the port is gone.
        """
        restart = self._link.moving or bool(self._link.doubt)
        if self.hold() != 'Idle' or restart:
            self._link.reset()
        self._link.moving = False
        self._link.until(lambda: False, self._settle_time)

    def hold(self) -> str:
        """
        Hold the feed until the arm stands; return the controller's state then.

        Raises
        ------
        ArmTimeoutError
            If the arm does not stop.
        ArmError
            Whatever else is in the way.
        """
        deadline = time.monotonic() + self._link.response_timeout + self._braking_time()
        while True:
            if self._link.moving:
                self._link.write(grbl.FEED_HOLD)
            try:
                report = self._reports.ask()
            except ArmTimeoutError:
                if not self._link.doubt:
                    raise
                return 'Alarm'  # some alarms answer nothing but a reset
            if not report.status.moves:
                return report.status.state
            if time.monotonic() > deadline:
                raise ArmTimeoutError(
                    f'arm on port {self._link.port} does not stop; the controller reports '
                    f'{report.status.state}'
                )
            self._link.moving = True
            self._reports.move(report)
            time.sleep(_PERIOD)

    def _braking_time(self) -> float:
        acceleration = math.radians(self._reports.setting(120))
        if acceleration <= 0.0:  # not yet known
            return _UNKNOWN
        return max(self.speed, abs(self._reports.velocity)) / acceleration
