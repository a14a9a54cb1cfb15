"""
The rotating arm on a Dynamixel servo of the X series (protocol 2.0): one servo turns the arm.

The servo runs in extended position mode, counts 4096 pulses a turn over ±256 turns, and follows a
trapezoidal profile of its own. Its encoder is absolute within one turn: after a loss of power the
azimuth within the turn is right, and the number of turns is lost.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple, NoReturn

from panodepth_ros.arm.dynamixel_bus import DynamixelBus
from panodepth_ros.arm.errors import (
    ArmAlarmError,
    ArmBusyError,
    ArmConnectionError,
    ArmError,
    ArmPositionError,
    ArmProtocolError,
    ArmStoppedError,
    ArmTimeoutError,
)
from panodepth_ros.arm.interface import ArmState
from panodepth_ros.arm.telling import StateTeller

_PULSE = 2.0 * math.pi / 4096.0
_FARTHEST_PULSE = 1_048_575
#: Unit of velocities, 0.229 turns per minute [rad/s].
_VELOCITY = 0.229 * 2.0 * math.pi / 60.0
#: Profile acceleration, in units of 214.577 turns/min²: 429 °/s².
_ACCELERATION = 20
#: Unit of accelerations [rad/s²].
_PROFILE_UNIT = 214.577 * 2.0 * math.pi / 3600.0
#: How far from its goal the servo may stand [pulses]: its controller has no integral part.
_TOLERANCE = 4
#: Longest time between two readings of a motion [s].
_LONGEST_PERIOD = 0.1

# Control table: address, bytes.
_OPERATING_MODE = (11, 1)
_TORQUE_ENABLE = (64, 1)
_HARDWARE_ERROR = (70, 1)
_PROFILE_ACCELERATION = (108, 4)
_PROFILE_VELOCITY = (112, 4)
_GOAL_POSITION = (116, 4)
_PRESENT = (122, 14)  # moving flag, moving status, ..., velocity at 128, position at 132
#: Bit of the moving status; the moving flag alone is 0 below the moving threshold, 14 °/s.
_PROFILE_ONGOING = 0x02
_EXTENDED_POSITION = 4

_HARDWARE_ERRORS = {
    0: 'input voltage',
    2: 'overheating',
    3: 'motor encoder',
    4: 'electrical shock or too little power',
    5: 'overload',
}


class _Present(NamedTuple):
    """What the servo says of itself; position in pulses."""

    stamp: int
    moving: bool
    velocity: float
    position: int
    round_trip: float


class DynamixelArm:
    """
    The arm, connected from construction to :meth:`close`.

    The methods are those of :class:`~panodepth_ros.arm.interface.Arm`.

    Parameters
    ----------
    port : str
        Serial device.
    baud_rate : int
        Bits per second, one of the servo's.
    servo_id : int
        The servo's number on the bus.
    speed : float
        Speed of motions [rad/s], > 0.
    settle_time : float
        How long the arm swings after a motion [s].
    response_timeout : float
        How long the servo may not answer [s].
    status_period : float
        Time between two measurements during a motion [s].
    clock : callable
        Gives the stamps of states [ns].
    listener : callable
        Called with every state, in the thread of the command that measured it.

    Raises
    ------
    ArmError
        If the port, the servo or the package dynamixel-sdk is missing.
    """

    def __init__(
        self,
        port: str,
        *,
        baud_rate: int = 57600,
        servo_id: int = 1,
        speed: float,
        settle_time: float = 0.0,
        response_timeout: float = 1.0,
        status_period: float = 0.1,
        clock: Callable[[], int] = time.time_ns,
        listener: Callable[[ArmState], None] = lambda state: None,
    ) -> None:
        self.status_period = status_period
        self._speed = speed
        self._settle_time = settle_time
        self._response_timeout = response_timeout
        self._clock = clock
        self._teller = StateTeller(clock, listener)
        self._teller.resolve(_PULSE)
        self._doubt = ''
        self._moving = False
        self._stop_wanted = threading.Event()
        self._busy = threading.Lock()
        self._closing = threading.Lock()  # held for ever once closed
        self._bus = DynamixelBus(port, baud_rate, servo_id, response_timeout)
        try:
            self._prepare()
        except BaseException:
            self._bus.close()
            raise

    @property
    def port(self) -> str:
        """The serial device."""
        return self._bus.port

    @property
    def doubt(self) -> str:
        """Why the position is uncertain, as a sentence; empty if it is not."""
        return self._doubt

    @property
    def motor_step(self) -> float:
        """Smallest motion [rad]."""
        return _PULSE

    @property
    def farthest(self) -> float:
        """Largest azimuth, of either sign, that the servo counts [rad]."""
        return _FARTHEST_PULSE * _PULSE

    @property
    def advice(self) -> str:
        """Nothing: what the servo needs is set by the driver."""
        return ''

    def distrust(self, reason: str) -> None:
        """Declare the position uncertain until the arm is homed; ``reason`` is a sentence."""
        self._doubt = self._doubt or reason

    def measure(self) -> ArmState:
        """Where the standing arm is."""
        with self._command():
            self._require_certainty()
            return self._stand()

    def move_to(self, azimuth: float) -> ArmState:
        """Turn to an azimuth [rad], not wrapped; return when the arm stands and has settled."""
        with self._command():
            self._require_certainty()
            return self._move(azimuth)

    def home(self) -> ArmState:
        """Restart the servo after an error, and turn to its 0 by its absolute encoder."""
        with self._command():
            if self._doubt:
                self._bus.restart()
                self._prepare()
                self._doubt = ''
            return self._move(0.0)

    def spin(
        self, speed: Callable[[], float], low: float, high: float, started: Callable[[], None]
    ) -> NoReturn:
        """Turn steadily, back and forth between two azimuths [rad], until interrupted."""
        with self._command():
            self._require_certainty()
            self._stand()
            wanted = way = speed()
            self._turn(wanted, high if way > 0.0 else low)
            started()
            while True:
                here = self._follow(way)
                room = high - here if way > 0.0 else here - low
                changed = speed() != wanted
                if changed:
                    wanted = way = speed()
                elif room <= _TOLERANCE * _PULSE:
                    way = -way
                else:
                    continue
                self._teller.forget()
                self._turn(wanted, high if way > 0.0 else low)

    def interrupt(self) -> None:
        """Make the running command raise; :meth:`stop` must follow."""
        self._stop_wanted.set()

    def stop(self) -> ArmState | None:
        """Stop the arm, whatever it does; None if its position is uncertain then."""
        self.interrupt()
        with self._command(wait=True):
            try:
                self._halt()
            except ArmAlarmError:
                return None  # the servo has let go of its motor
            return None if self._doubt else self._stand()

    def close(self) -> None:
        """Leave the arm stopped and close the port. Idempotent."""
        if not self._closing.acquire(blocking=False):
            return
        with suppress(ArmError):
            self.interrupt()
            with self._command(wait=True):
                if self._moving:
                    self._halt()
        self._bus.close()

    # Commands; the lock is held.

    @contextmanager
    def _command(self, *, wait: bool = False) -> Iterator[None]:
        timeout = 3.0 * self._response_timeout if wait else -1
        if not self._busy.acquire(blocking=wait, timeout=timeout):
            raise ArmBusyError(f'arm on port {self.port} is executing another command')
        try:
            if wait:
                self._stop_wanted.clear()
            self._require_no_stop()
            yield
        except ArmConnectionError:
            self._moving = False
            raise
        except (ArmTimeoutError, ArmProtocolError):
            if self._moving:  # the arm must not go on by itself
                with suppress(ArmError):
                    self._halt()
            raise
        finally:
            self._busy.release()

    def _prepare(self) -> None:
        self._bus.ping()
        self._require_no_alarm()
        if self._bus.read(*_OPERATING_MODE) != _EXTENDED_POSITION:
            self._bus.write(*_TORQUE_ENABLE, 0)
            self._bus.write(*_OPERATING_MODE, _EXTENDED_POSITION)
        self._bus.write(*_PROFILE_ACCELERATION, _ACCELERATION)
        self._bus.write(*_TORQUE_ENABLE, 1)
        self._halt()  # another program may have left it moving

    def _require_certainty(self) -> None:
        self._require_no_alarm()
        if not self._doubt and not self._bus.read(*_TORQUE_ENABLE):
            self._doubt = f'servo on port {self.port} restarted by itself or let go of its motor'
        if self._doubt:
            raise ArmPositionError(f'position is uncertain: {self._doubt}; home the arm')

    def _require_no_alarm(self) -> None:
        errors = self._bus.read(*_HARDWARE_ERROR)
        if errors:
            names = ', '.join(
                _HARDWARE_ERRORS.get(bit, f'bit {bit}') for bit in range(8) if errors & 1 << bit
            )
            self._doubt = f'servo on port {self.port} reported a hardware error: {names}'
            self._moving = False
            raise ArmAlarmError(f'{self._doubt}; remove the cause and home the arm')

    def _require_no_stop(self) -> None:
        if self._stop_wanted.is_set():
            raise ArmStoppedError(f'arm on port {self.port} was stopped')

    def _turn(self, speed: float, azimuth: float) -> None:
        self._require_no_stop()
        pulse = round(azimuth / _PULSE)
        if abs(pulse) > _FARTHEST_PULSE:
            raise ArmProtocolError(
                f'{math.degrees(azimuth):.3f}° is beyond what the servo on port {self.port} '
                f'counts, ±{math.degrees(self.farthest):.0f}°'
            )
        self._bus.write(*_PROFILE_VELOCITY, max(1, round(abs(speed) / _VELOCITY)))
        self._moving = True
        self._bus.write(*_GOAL_POSITION, pulse)

    def _move(self, azimuth: float) -> ArmState:
        start = self._stand()
        way = azimuth - start.azimuth
        if abs(way) <= 0.5 * _PULSE:
            return start
        velocity = math.copysign(self._speed, way)
        self._teller.begin(start.azimuth, velocity)
        deadline = time.monotonic() + 1.5 * abs(way) / self._speed + 1.0 + self._response_timeout
        self._turn(velocity, azimuth)
        while abs(self._follow(velocity) - azimuth) > _TOLERANCE * _PULSE:
            if time.monotonic() > deadline:
                raise ArmTimeoutError(
                    f'arm on port {self.port} did not reach {math.degrees(azimuth):.3f}° in time'
                )
        self._wait(self._settle_time)
        state = self._stand()
        self._moving = False
        return state

    def _follow(self, velocity: float) -> float:
        """Wait for a period and tell how the arm turns; return where it is [rad]."""
        self._wait(min(self.status_period, _LONGEST_PERIOD))
        present = self._read()
        self._require_no_alarm()
        azimuth = present.position * _PULSE
        self._teller.turn(present.stamp, azimuth, present.velocity or velocity, present.round_trip)
        return azimuth

    def _halt(self) -> None:
        """Brake at the profile's acceleration and wait until the arm stands."""
        present = self._read()
        braking = present.velocity * abs(present.velocity) / (2.0 * _ACCELERATION * _PROFILE_UNIT)
        goal = present.position + round(braking / _PULSE)
        self._bus.write(*_GOAL_POSITION, max(-_FARTHEST_PULSE, min(_FARTHEST_PULSE, goal)))
        deadline = time.monotonic() + 2.0 * self._response_timeout
        while self._read().moving:
            if time.monotonic() > deadline:
                raise ArmTimeoutError(f'arm on port {self.port} does not stop')
            time.sleep(0.01)
        self._moving = False
        self._wait(self._settle_time)

    def _read(self) -> _Present:
        stamp, begin = self._clock(), time.monotonic()
        data = self._bus.read_block(*_PRESENT)
        return _Present(
            stamp,
            bool(data[0] or data[1] & _PROFILE_ONGOING),
            int.from_bytes(data[6:10], 'little', signed=True) * _VELOCITY,
            int.from_bytes(data[10:14], 'little', signed=True),
            time.monotonic() - begin,
        )

    def _stand(self) -> ArmState:
        """Read until two readings agree to a pulse that the arm stands."""
        deadline = time.monotonic() + self._response_timeout
        last = self._read()
        while time.monotonic() < deadline:
            present = self._read()
            if not present.moving and abs(present.position - last.position) <= 1:
                self._teller.forget()
                return self._teller.tell(present.stamp, present.position * _PULSE, 0.0)
            last = present
        raise ArmProtocolError(f'arm on port {self.port} does not stand')

    def _wait(self, seconds: float) -> None:
        self._stop_wanted.wait(seconds)
        self._require_no_stop()
