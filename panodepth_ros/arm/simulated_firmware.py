"""
What a simulated GRBL controller does at any time: bytes, start, reset, alarm, real-time commands.

What it does line by line is :class:`~panodepth_ros.arm.simulated.SimulatedController`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from panodepth_ros.arm import grbl
from panodepth_ros.arm.simulated_index import IndexMark
from panodepth_ros.arm.simulated_motor import SimulatedMotor
from panodepth_ros.arm.simulated_settings import Modes, default_settings
from panodepth_ros.arm.truth import Piece

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
#: Of grblHAL, which may have more axes.
HAL_BANNER = b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
UNLOCK_HINT = b"[MSG:'$H'|'$X' to unlock]\r\n"
NEVER = math.inf

_RX_BUFFER = 127  # bytes that fit while the main program is busy; more are lost
_INCH = np.float32(25.4)


class SimulatedFirmware(ABC):
    """
    The firmware without its main program.

    Parameters
    ----------
    settings, boot_time, publish, index, work_offset, axis
        As of :class:`~panodepth_ros.arm.simulated.SimulatedController`.
    """

    def __init__(
        self,
        settings: dict[int, float] | None,
        boot_time: float,
        publish: Callable[[Sequence[Piece]], None],
        index: tuple[float, float] | None,
        work_offset: float,
        axis: str,
    ) -> None:
        self._axis = grbl.AXES.index(axis)
        self._axes = grbl.AXES[: max(3, self._axis + 1)]
        self.settings = default_settings(axes=len(self._axes)) if settings is None else settings
        self._boot_time = boot_time
        mark = None if index is None else IndexMark(*index)
        self._motor = SimulatedMotor(self.settings, self._axis, publish, mark)
        self._work_offset = np.float32(work_offset)
        self._output = bytearray()
        self._state = 'Boot'
        self._boot_at = NEVER
        self._dwell_until = NEVER
        self._clear()

    # What the outside does.

    def power_up(self, now: float) -> None:
        """Start as after power-up: the count is 0 wherever the arm stands."""
        if self._motor.moving(now):
            self._motor.kill(now)
        self._motor.zero = self._motor.state(now)[0]
        self._output.clear()
        self._clear()
        self._state = 'Boot'
        self._boot_at = now + self._boot_time
        self.advance(now)

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that arrive at the time ``now`` [s]."""
        self.advance(now)
        for value in data:
            if self._state == 'Boot':
                continue
            byte = bytes([value])
            if byte in (
                grbl.STATUS_QUERY,
                grbl.FEED_HOLD,
                grbl.CYCLE_START,
                grbl.SOFT_RESET,
                grbl.JOG_CANCEL,
            ):
                self._real_time(byte, now)
            elif value < 0x80:
                self._received.append(value)
        self._run(now)
        del self._received[_RX_BUFFER:]

    def advance(self, now: float) -> None:
        """Let everything happen that is due at the time ``now`` [s]."""
        while (due := self.next_event()) <= now:
            if due == self._boot_at:
                self._boot_at = NEVER
                self._begin('Alarm' if self.settings[22] else 'Idle')
            elif due == self._motor.contact_at:
                self._contact(due)
            elif due == self._dwell_until:
                self._dwell_until = NEVER
            else:
                self._end_block(due)
            self._run(due)

    def next_event(self) -> float:
        """When something happens by itself [s]; +inf if nothing will."""
        return min(self._boot_at, self._dwell_until, self._motor.next_event())

    def take_output(self) -> bytes:
        """Return what was sent since the last call."""
        output = bytes(self._output)
        self._output.clear()
        return output

    def raise_alarm(self, code: int, now: float) -> None:
        """Go into alarm, as when a limit switch is hit (code 1)."""
        self._motor.kill(now)
        self._alarm(code)

    def slip(self, degrees: float, now: float) -> None:
        """Turn the standing arm by an angle that is not counted, as lost motor steps do."""
        self._motor.slip(math.radians(degrees), now)

    # Firmware: start, reset, alarm.

    def _clear(self) -> None:
        self._received = bytearray()
        self._modes = Modes()
        self._motor.clear()
        self._waiting: Callable[[float], bool] | None = None
        self._dwell_until = NEVER
        self._critical = False
        self._offset_countdown = 0
        self._probed: int | None = None  # motor steps

    def _begin(self, state: str) -> None:
        self._state = state
        self._modes.position = self._count()
        self._output += BANNER if len(self._axes) == 3 else HAL_BANNER
        if state == 'Alarm':
            self._output += UNLOCK_HINT

    def _reset(self, now: float) -> None:
        state = 'Alarm' if self._state == 'Alarm' else 'Idle'
        if self._state == 'Home' or self._motor.moving(now):
            homing = self._state == 'Home'
            self._motor.kill(now)
            self._output += f'ALARM:{6 if homing else 3}\r\n'.encode()
            state = 'Alarm'
        if (
            self._waiting is not None or self._critical
        ):  # the line that was cut off is answered all the same
            self._output += b'ok\r\n'
        self._clear()
        self._begin(state)

    def _alarm(self, code: int) -> None:
        self._output += f'ALARM:{code}\r\n'.encode()
        self._clear()
        self._state = 'Alarm'
        if code in (1, 2):
            self._output += b'[MSG:Reset to continue]\r\n'
            self._critical = True

    # Firmware: real-time bytes.

    def _real_time(self, byte: bytes, now: float) -> None:
        if byte == grbl.SOFT_RESET:
            self._reset(now)
        elif self._critical or self._state == 'Home':
            return
        elif byte == grbl.STATUS_QUERY:
            self._report(now)
        elif byte == grbl.FEED_HOLD and self._state in ('Idle', 'Run'):
            if self._state == 'Run':
                self._motor.brake(now)
            self._state = 'Hold'
        elif self._state == 'Jog' and byte in (grbl.FEED_HOLD, grbl.JOG_CANCEL):
            self._motor.brake(now)
            self._motor.blocks.clear()
        elif byte == grbl.CYCLE_START and self._state == 'Hold' and not self._motor.moving(now):
            self._state = 'Idle'
            self._start_motion(now)

    def _report(self, now: float) -> None:
        state = self._state
        if state == 'Hold':
            state += ':1' if self._motor.moving(now) else ':0'
        azimuth, velocity = self._motor.state(now)
        machine = np.float32(self._motor.steps(azimuth)) / np.float32(self._setting(100))
        work = not int(self.settings[10]) & 1
        position = machine - self._work_offset if work else machine
        feed = abs(math.degrees(velocity)) * 60.0
        fields = f'{state}|{"WPos" if work else "MPos"}:{self._coordinates(position)}'
        fields += f'|FS:{feed / 25.4:.1f},0' if self.settings[13] else f'|FS:{feed:.0f},0'
        if self._motor.contact(now):
            fields += '|Pn:P'
        if self._offset_countdown == 0:
            fields += f'|WCO:{self._coordinates(self._work_offset)}'
            self._offset_countdown = 10 if state in ('Idle', 'Alarm') else 30
        self._offset_countdown -= 1
        self._output += f'<{fields}>\r\n'.encode()

    def _coordinates(self, value: np.float32) -> str:
        values = [np.float32(0.0)] * len(self._axes)
        values[self._axis] = value
        if self.settings[13]:
            return ','.join(f'{value / _INCH:.4f}' for value in values)
        return ','.join(f'{value:.3f}' for value in values)

    # What the main program does.

    @abstractmethod
    def _run(self, now: float) -> None:
        """Take the lines that have come, as far as the one before is done."""

    @abstractmethod
    def _start_motion(self, now: float) -> None:
        """Let the planned blocks move the arm."""

    @abstractmethod
    def _end_block(self, now: float) -> None:
        """Go on after a block that is over."""

    @abstractmethod
    def _contact(self, now: float) -> None:
        """Heed the probe input, which has changed."""

    # The axis.

    def _setting(self, number: int) -> float:
        """One setting of the axis, by its number for X."""
        return self.settings[number + self._axis]

    def _count(self) -> np.float32:
        """Machine position where the arm stands, or will stand when it has moved."""
        return np.float32(self._motor.steps()) / np.float32(self._setting(100))
