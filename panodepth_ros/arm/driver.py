"""
The rotating arm on a GRBL controller: azimuths in, measured azimuths out.

Commands run in the thread that calls them, one at a time. They raise errors and leave the arm
standing. When the position becomes uncertain (reboot, alarm), every motion but
:meth:`GrblArm.home` is refused until the arm was homed.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NoReturn

from panodepth_ros.arm import grbl
from panodepth_ros.arm.braking import Brake
from panodepth_ros.arm.errors import (
    ArmAlarmError,
    ArmBusyError,
    ArmError,
    ArmPositionError,
    ArmProtocolError,
    ArmTimeoutError,
)
from panodepth_ros.arm.index import IndexSearch
from panodepth_ros.arm.interface import ArmState
from panodepth_ros.arm.link import GrblLink
from panodepth_ros.arm.moving import Mover
from panodepth_ros.arm.reports import Reports
from panodepth_ros.arm.spin import Leg

_LOGGER = logging.getLogger(__name__)


class GrblArm:
    """
    The arm, connected from construction to :meth:`close`.

    All methods may be called from any thread.

    Parameters
    ----------
    port : str
        Serial device.
    baud_rate : int
        Bits per second.
    axis : str
        Letter of the rotary axis, whose millimetres are degrees.
    index_within : float or None
        None if the controller's homing, or its count, is the reference. Else the reference is an
        index mark that a sensor at the probe input sees, and this is how far the cable lets the
        arm turn from 0 to each side [rad], 0 for an endless axis.
    speed : float
        Speed of motions [rad/s], > 0; the controller's maximum limits it.
    settle_time : float
        How long the arm swings after a motion [s].
    response_timeout : float
        How long an answer may take [s].
    boot_timeout : float
        How long the controller may take from opening the port to its banner [s].
    status_period : float
        Time between two status reports during a motion [s]; may be changed at any time.
    clock : callable
        Gives the stamps of states [ns].
    listener : callable
        Called with every state, in the thread of the command that measured it.

    Raises
    ------
    ArmConnectionError
        If the port cannot be opened.
    ArmTimeoutError
        If nothing answers.
    ArmProtocolError
        If something answers that is no GRBL 1.1 controller or lacks the axis.
    ArmAlarmError
        If the controller is in alarm and has no homing that could end it.
    """

    def __init__(
        self,
        port: str,
        *,
        baud_rate: int = 115200,
        axis: str = 'X',
        index_within: float | None = None,
        speed: float,
        settle_time: float = 0.0,
        response_timeout: float = 1.0,
        boot_timeout: float = 6.0,
        status_period: float = 0.1,
        clock: Callable[[], int] = time.time_ns,
        listener: Callable[[ArmState], None] = lambda state: None,
    ) -> None:
        self._axis = axis
        self._index_within = index_within
        self._settle_time = settle_time
        self._busy = threading.Lock()  # held by the command that runs
        self._closing = threading.Lock()  # held for ever once closed
        self._link = GrblLink(port, baud_rate, response_timeout)
        self._reports = Reports(self._link, axis, clock, listener)
        self._brake = Brake(self._link, self._reports, settle_time)
        self._mover = Mover(self._link, self._reports, axis, settle_time)
        self.status_period = status_period
        try:
            if not self._link.greet(boot_timeout):
                self._brake.hold()  # another program may have left it moving
                self._link.reset()
            self._link.require_version()
            self._link.ask(grbl.READ_SETTINGS)
            self._reports.require_axis()
            self._fastest = math.radians(self._setting(110) / 60.0)
            self._mover.speed = self._brake.speed = min(speed, self._fastest)
            self._check_state()
        except BaseException:
            self._link.disconnect()
            raise

    # What the user calls.

    @property
    def port(self) -> str:
        """The serial device."""
        return self._link.port

    @property
    def doubt(self) -> str:
        """Why the position is uncertain, as a sentence; empty if it is not."""
        return self._link.doubt

    @property
    def motor_step(self) -> float:
        """Smallest motion [rad]."""
        return self._reports.motor_step

    @property
    def farthest(self) -> float:
        """Largest azimuth, of either sign, that the controller counts exactly [rad]."""
        return self._reports.farthest

    @property
    def advice(self) -> str:
        """What the user should change about the controller, as a sentence; empty if nothing."""
        if self._link.settings.get(1) in (None, 255.0):
            return ''
        return (
            'the controller releases the motor after each motion, which lets the arm move; '
            'set $1=255 to hold it'
        )

    @property
    def status_period(self) -> float:
        """Time between two status reports during a motion [s]; may be changed at any time."""
        return self._mover.status_period

    @status_period.setter
    def status_period(self, seconds: float) -> None:
        self._mover.status_period = seconds

    def distrust(self, reason: str) -> None:
        """Declare the position uncertain until the arm is homed; ``reason`` is a sentence."""
        self._link.lose_position(reason)

    def measure(self) -> ArmState:
        """
        Where the standing arm is.

        Raises
        ------
        ArmBusyError
            If a command is running.
        ArmPositionError
            If the position is uncertain.
        ArmError
            If the controller does not answer, is in alarm, or the port is gone.
        """
        with self._command():
            self._link.require_certainty()
            return self._reports.stand(self._reports.ask_standing())

    def move_to(self, azimuth: float) -> ArmState:
        """
        Turn to an azimuth and return when the arm stands there and has settled.

        Parameters
        ----------
        azimuth : float
            Target [rad], not wrapped: 2π is a full turn away from 0.

        Raises
        ------
        ArmBusyError
            If another command is running.
        ArmPositionError
            If the position is uncertain.
        ArmStoppedError
            If :meth:`stop` or :meth:`interrupt` ended the motion.
        ArmError
            If the controller refuses, does not answer, goes into alarm, or the port is gone.
        """
        with self._command():
            self._require_ready()
            return self._mover.move(azimuth)

    def home(self) -> ArmState:
        """
        Make the position certain and return where the arm stands then.

        With homing enabled (``$22=1``) the controller searches its switch. Without, its count is
        trusted: an alarm is unlocked and the arm turns back to 0. After a reboot the count is 0
        where the arm stands, so it stays and that place is the new origin. With an index mark
        the arm searches that and turns to it: azimuth 0 is where the mark begins.

        Raises
        ------
        ArmError
            As :meth:`move_to`, but an uncertain position is no obstacle.
        """
        with self._command():
            if self.doubt or self._setting(22) or self._link.moving:
                self._brake.halt()
            if self._index_within is not None:
                self._search_index(self._index_within)
                return self._mover.move(0.0)
            if self._setting(22):
                self._search_switch()
            elif self._reports.ask().status.state == 'Alarm':
                self._link.ask(grbl.UNLOCK)
            self._link.trust_position()
            if self._setting(22):
                return self._reports.stand(self._reports.ask_standing())
            return self._mover.move(0.0)

    def spin(
        self, speed: Callable[[], float], low: float, high: float, started: Callable[[], None]
    ) -> NoReturn:
        """
        Turn steadily, back and forth between two azimuths, until interrupted.

        Parameters
        ----------
        speed : callable
            The wanted speed [rad/s], positive counter-clockwise first, never 0; the controller's
            maximum limits it. When it changes the arm brakes and goes on at the new one.
        low, high : float
            Where the arm turns back [rad].
        started : callable
            Called once when the controller has accepted the motion.

        Raises
        ------
        ArmStoppedError
            If :meth:`stop` or :meth:`interrupt` ended it.
        ArmError
            Otherwise, as :meth:`move_to`.
        """
        accepted = False

        def accept() -> None:
            nonlocal accepted
            if not accepted:
                accepted = True
                started()

        with self._command():
            self._require_ready()
            start = self._mover.standing()
            self._reports.stand(start)
            wanted = way = speed()

            def changed() -> bool:
                return speed() != wanted

            while True:
                if (high - start.azimuth if way > 0.0 else start.azimuth - low) <= self.motor_step:
                    way = -way
                velocity = math.copysign(min(abs(way), self._fastest), way)
                self._reports.begin(start, velocity)
                leg = Leg(self._link, self._reports, self._axis, abs(velocity))
                end = high if way > 0.0 else low
                if leg.run(start, end, lambda: self.status_period, changed, accept):
                    self._link.moving = False
                else:
                    self._brake.halt()
                    wanted = way = speed()
                start = self._mover.standing()

    def interrupt(self) -> None:
        """Begin to brake and make the running command raise; :meth:`stop` must follow."""
        self._link.interrupt()

    def stop(self) -> ArmState | None:
        """
        Stop the arm, whatever it does, and keep its position.

        Returns
        -------
        ArmState or None
            Where it stands; None if it stands but its position is uncertain, for instance
            because homing was interrupted (:attr:`doubt` says why).

        Raises
        ------
        ArmError
            If the controller does not answer or the port is gone.
        """
        self.interrupt()
        with self._command(wait=True):
            try:
                self._brake.halt()
            except (ArmAlarmError, ArmPositionError):
                return None  # the controller has stopped the motor by itself
            return None if self.doubt else self._reports.stand(self._reports.ask_standing())

    def close(self) -> None:
        """Leave the arm stopped and close the port. Idempotent."""
        if not self._closing.acquire(blocking=False):
            return
        try:
            if self._link.moving or self._link.homing:
                self.stop()
        except ArmError as error:
            _LOGGER.warning('the arm may not have stopped: %s', error)
            self._link.kill()
        finally:
            self._link.disconnect()

    # Opening.

    def _check_state(self) -> None:
        if self._index_within is not None:
            self._link.lose_position(
                f'arm on port {self.port} has not searched its index since it was connected'
            )
            return
        if self._reports.ask().status.state != 'Alarm':
            return
        if not self._setting(22):
            raise ArmAlarmError(
                f'controller on port {self.port} is in alarm and its position uncertain; remove '
                'the cause, then switch it off and on, or send $X from a terminal'
            )
        self._link.lose_position(
            f'controller on port {self.port} has not been homed since it started'
        )

    def _setting(self, number: int) -> float:
        return self._reports.setting(number)

    # Motions; the command lock is held.

    @contextmanager
    def _command(self, *, wait: bool = False) -> Iterator[None]:
        # A command that was interrupted ends within the time of one answer.
        timeout = 2.0 * self._link.response_timeout if wait else -1
        if not self._busy.acquire(blocking=wait, timeout=timeout):
            raise ArmBusyError(f'arm on port {self.port} is executing another command')
        try:
            self._link.begin_command(after_stop=wait)
            yield
        except (ArmTimeoutError, ArmProtocolError):
            if self._link.moving:  # the arm must not go on by itself
                with suppress(ArmError):
                    self._brake.halt()
            raise
        finally:
            self._busy.release()

    def _require_ready(self) -> None:
        """Make sure that the arm may move; end a motion whose braking an error has cut short."""
        self._link.require_certainty()
        if self._link.moving:
            self._brake.halt()

    def _search_switch(self) -> None:
        travel, seek, fine, pull_off = (self._setting(n) for n in (130, 25, 24, 27))
        timeout = 10.0 * self._link.response_timeout
        if seek > 0.0 and fine > 0.0:
            timeout += 60.0 * (1.5 * travel / seek + 10.0 * pull_off / fine)
        self._reports.velocity = math.radians(seek / 60.0) or self._mover.speed
        self._reports.move(self._reports.ask())
        self._link.homing = True
        try:
            self._link.ask(grbl.HOME, timeout=timeout)
            self._link.until(lambda: False, self._settle_time)
        finally:
            self._link.homing = False

    def _search_index(self, limit: float) -> None:
        if self._reports.ask().status.state == 'Alarm':
            self._link.ask(grbl.UNLOCK)
        search = IndexSearch(self._link, self._reports, self._axis, limit, self._mover)
        self._reports.zero += search.run()
        self._link.trust_position()
