"""
Single moves of an arm on a GRBL controller.

A motion is over when the barrier after it is answered (``ok`` of the move itself only means
parsed) and two status reports, the second one asked for after the settle time, agree on the
target.
"""

from __future__ import annotations

import math
import time

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmProtocolError
from panodepth_ros.arm.interface import ArmState
from panodepth_ros.arm.link import GrblLink, SentLine
from panodepth_ros.arm.reports import Report, Reports


class Mover:
    """
    Moves the arm of a connected controller, one command at a time.

    Parameters
    ----------
    link, reports
        The controller.
    axis : str
        Letter of the axis.
    settle_time : float
        How long the arm swings after a motion [s].

    Attributes
    ----------
    speed : float
        Speed of moves [rad/s].
    status_period : float
        Time between two reports during a motion [s].
    """

    def __init__(self, link: GrblLink, reports: Reports, axis: str, settle_time: float) -> None:
        self._link = link
        self._reports = reports
        self._axis = axis
        self._settle_time = settle_time
        self.speed = 0.0
        self.status_period = 0.1

    def standing(self) -> Report:
        """
        Make sure that the arm stands, ready to move.

        Raises
        ------
        ArmProtocolError
            If the controller is in another state than Idle.
        ArmError
            Whatever else is in the way.
        """
        start = self._reports.ask_standing()
        if start.status.state != 'Idle':
            raise ArmProtocolError(
                f'controller on port {self._link.port} is in state {start.status.state}, not '
                'Idle; stop or home the arm first'
            )
        return start

    def move(self, azimuth: float) -> ArmState:
        """
        Turn to an azimuth [rad]; return when the arm stands there and has settled.

        Raises
        ------
        ArmProtocolError
            If the controller refuses, or says that it stands elsewhere.
        ArmError
            Whatever else breaks a motion.
        """
        start = self.standing()
        state = self._reports.stand(start)
        way = azimuth - start.azimuth
        if abs(way) <= self._reports.tolerance:
            return state
        acceleration = math.radians(self._reports.setting(120))
        duration = abs(way) / self.speed + self.speed / acceleration
        feed = math.degrees(self.speed) * 60.0
        move = grbl.encode_move(self._axis, self._reports.machine(azimuth), feed)
        self._reports.begin(start, math.copysign(self.speed, way))
        self.follow(
            self._link.send(move, grbl.BARRIER, moves=True),
            1.5 * duration + self._link.response_timeout,
        )
        arrived = self._reports.ask()
        self._reports.move(arrived)
        self._link.until(lambda: False, self._settle_time)
        settled = self._reports.ask()
        if not settled.agrees(arrived):
            settled = self._reports.ask_standing()
        self._link.moving = False
        off = abs(settled.azimuth - azimuth)
        if settled.status.state != 'Idle' or off > self._reports.tolerance:
            raise ArmProtocolError(
                f'arm on port {self._link.port} was sent to {math.degrees(azimuth):.3f}° but the '
                f'controller reports {settled.status.state} at '
                f'{math.degrees(settled.azimuth):.3f}°'
            )
        return self._reports.stand(settled)

    def follow(self, lines: list[SentLine], timeout: float) -> None:
        """
        Wait until the lines of a motion are answered, and tell where the arm is meanwhile.

        Raises
        ------
        ArmTimeoutError
            If they are not answered within the timeout [s].
        ArmError
            Whatever else breaks a motion.
        """
        deadline = time.monotonic() + timeout
        while not self._link.answered(lines, self.status_period):
            if time.monotonic() > deadline:
                raise self._link.unanswered(lines, timeout)
            self._reports.move(self._reports.ask())
        self._link.require_ok(lines)
