"""Status reports of a GRBL controller as azimuths, checked, and told to who listens."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmAlarmError, ArmProtocolError, ArmTimeoutError
from panodepth_ros.arm.interface import ArmState
from panodepth_ros.arm.link import Answer, GrblLink
from panodepth_ros.arm.telling import StateTeller

#: Whole motor steps that a position may count: 32-bit floats hold an eighth of a step there.
_COUNTED_STEPS = 2.0**21


class Report(NamedTuple):
    """
    A status report with the axis in radians.

    Attributes
    ----------
    stamp : int
        When it was asked for, by the driver's clock [ns].
    status : grbl.Status
        As it came.
    azimuth : float
        [rad].
    round_trip : float
        From the query to the answer [s]; +inf if the answer may be that to an older query.
    """

    stamp: int
    status: grbl.Status
    azimuth: float
    round_trip: float

    def agrees(self, other: Report) -> bool:
        """Whether both say the same of the arm."""
        return (self.status.state, self.azimuth) == (other.status.state, other.azimuth)


class Reports:
    """
    Asks for reports, reads the axis out of them and emits states.

    Parameters
    ----------
    link : GrblLink
        The controller.
    axis : str
        Letter of the rotary axis.
    clock : callable
        Gives the stamps of states [ns].
    listener : callable
        Called with every state.

    Attributes
    ----------
    velocity : float
        Commanded for the running motion [rad/s].
    zero : float
        Machine position of azimuth 0 [rad].
    """

    def __init__(
        self,
        link: GrblLink,
        axis: str,
        clock: Callable[[], int],
        listener: Callable[[ArmState], None],
    ) -> None:
        self.velocity = 0.0
        self.zero = 0.0
        self._link = link
        self._axis = axis
        self._axis_index = grbl.AXES.index(axis)
        self._clock = clock
        self._teller = StateTeller(clock, listener)

    # The axis.

    def require_axis(self) -> None:
        """
        Make sure that the controller has the axis and its settings.

        Raises
        ------
        ArmProtocolError
            If it has not.
        """
        if len(self.ask().status.position) <= self._axis_index:
            raise ArmProtocolError(
                f'controller on port {self._link.port} has no axis {self._axis}'
            )
        for number in (100, 110, 120):
            if self.setting(number) <= 0.0:
                raise ArmProtocolError(
                    f'controller on port {self._link.port} has no usable setting '
                    f'${number + self._axis_index}'
                )
        self._teller.resolve(self.motor_step)

    def setting(self, number: int) -> float:
        """One setting; those of axes (from 100 on) are named by their number for X."""
        number += self._axis_index if number >= 100 else 0
        return self._link.settings.get(number) or 0.0

    @property
    def motor_step(self) -> float:
        """Smallest motion [rad]."""
        return math.radians(1.0 / self.setting(100))

    @property
    def farthest(self) -> float:
        """Largest azimuth that is counted exactly [rad]."""
        return _COUNTED_STEPS * self.motor_step - abs(self.zero)

    @property
    def tolerance(self) -> float:
        """Half a motor step and the last digit of a report [rad]."""
        return 0.5 * self.motor_step + math.radians(self._digit)

    @property
    def _digit(self) -> float:
        return 25.4e-4 if self.setting(13) else 1e-3

    def _azimuth(self, status: grbl.Status) -> float | None:
        if len(status.position) <= self._axis_index:
            return 0.0  # require_axis says so
        value = status.position[self._axis_index]
        if not status.machine:
            if self._link.offset is None:
                return None
            value += self._link.offset[self._axis_index]
        return self._of_machine(value)

    def _of_machine(self, value: float) -> float:
        millimetres = value * 25.4 if self.setting(13) else value
        return math.radians(self._whole_steps(millimetres)) - self.zero

    def machine(self, azimuth: float) -> float:
        """Return the machine position [°] of an azimuth [rad]."""
        return math.degrees(azimuth + self.zero)

    def probed(self, probe: grbl.Probe) -> float | None:
        """
        Azimuth where probing found what it looked for [rad]; None if it found nothing.

        Raises
        ------
        ArmProtocolError
            If it does not tell the axis.
        """
        if not probe.found:
            return None
        if len(probe.position) <= self._axis_index:
            raise ArmProtocolError(
                f'controller on port {self._link.port} does not probe axis {self._axis}'
            )
        return self._of_machine(probe.position[self._axis_index])

    def _whole_steps(self, value: float) -> float:
        """Undo the rounding of a report, if a whole number of motor steps explains it."""
        per_degree = self.setting(100)
        if per_degree <= 0.0:
            return value
        exact = round(value * per_degree) / per_degree
        return exact if abs(exact - value) <= 0.51 * self._digit else value

    # Asking.

    def ask(self) -> Report:
        """
        Ask for a status report until one comes that tells the position.

        Raises
        ------
        ArmTimeoutError
            If none comes.
        """
        deadline = time.monotonic() + self._link.response_timeout
        while time.monotonic() < deadline:
            stamp, begin = self._clock(), time.monotonic()
            answer = self._link.report()
            azimuth = self._azimuth(answer.status) if answer is not None else None
            if answer is not None and azimuth is not None:
                return Report(stamp, answer.status, azimuth, _round_trip(answer, begin))
        raise ArmTimeoutError(
            f'controller on port {self._link.port} did not answer a status query within '
            f'{self._link.response_timeout:g} s'
        )

    def ask_standing(self) -> Report:
        """
        Ask until two reports agree that the arm stands.

        Raises
        ------
        ArmAlarmError
            If the controller is in alarm.
        ArmProtocolError
            If reports keep to disagree.
        ArmTimeoutError
            If none comes.
        """
        deadline = time.monotonic() + self._link.response_timeout
        last = self.ask()
        while time.monotonic() < deadline:
            report = self.ask()
            if report.agrees(last) and not report.status.moves:
                if report.status.state == 'Alarm':
                    self._link.lose_position(f'controller on port {self._link.port} is in alarm')
                    raise ArmAlarmError(f'{self._link.doubt}; home the arm')
                return report
            last = report
        raise ArmProtocolError(
            f'reports of the controller on port {self._link.port} do not agree that the arm '
            f'stands: {last.status.state} at {math.degrees(last.azimuth):.3f}°'
        )

    # Telling.

    def begin(self, start: Report, velocity: float) -> None:
        """Tell that a motion of a commanded velocity [rad/s] begins."""
        self.velocity = velocity
        self._teller.begin(start.azimuth, velocity)

    def stand(self, report: Report) -> ArmState:
        """Tell that the arm stands and has settled."""
        return self._teller.tell(report.stamp, report.azimuth, 0.0)

    def move(self, report: Report) -> None:
        """Tell that the arm moves, as reported."""
        if self.velocity != 0.0:  # else it is not a motion of this driver
            self._teller.tell(report.stamp, report.azimuth, self._velocity(report.status))

    def turn(self, report: Report) -> None:
        """Tell how the arm turns steadily."""
        velocity = self._velocity(report.status)
        self._teller.turn(report.stamp, report.azimuth, velocity, report.round_trip)

    def _velocity(self, status: grbl.Status) -> float:
        """Return what a report says of the velocity, or what was commanded [rad/s]."""
        if not status.feed:
            return self.velocity
        feed = status.feed * (25.4 if self.setting(13) else 1.0)
        return math.copysign(math.radians(feed / 60.0), self.velocity)


def _round_trip(answer: Answer, begin: float) -> float:
    return answer.received - begin if answer.asked >= begin else math.inf
