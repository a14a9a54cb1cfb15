"""
A simulated GRBL 1.1h controller with the arm it drives, as strict as the firmware.

The controller is a machine in time: it is handed bytes and the time, and gives bytes. It keeps
the firmware's ways that a driver can trip over: ``ok`` means parsed and not moved, positions are
quantised to motor steps, numbers are 32-bit floats, a status in the same write as a move shows
the old Idle, resets forget modes, braking takes time, homing and critical alarms answer nothing.

Differences from the firmware: only the G-code a rotary axis needs is known (G0 G1 G4 G20 G21
G38.2 to G38.5 G53 G54 G90 G91 G94), probing is not a mode that persists; check mode, sleep,
overrides, safety door, spindle and stored startup lines are absent. One axis is the rotary one,
one degree per millimetre; the others stand.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from panodepth_ros.arm.motion import chain
from panodepth_ros.arm.simulated_firmware import NEVER, SimulatedFirmware
from panodepth_ros.arm.simulated_gcode import Reader, RefusedLineError
from panodepth_ros.arm.truth import Piece

_LINE_BUFFER = 79
_PLANNER_BLOCKS = 15
_FARTHEST = 1e6  # the firmware's 32-bit count of steps must not overflow


class SimulatedController(SimulatedFirmware):
    """
    The firmware; the arm it drives is a :class:`SimulatedMotor`.

    Parameters
    ----------
    settings : dict
        ``$N`` values of all axes, see :func:`default_settings`. ``$13`` (inches), ``$20`` (soft
        limits), ``$22`` (homing) and bit 0 of ``$10`` (MPos or WPos) act as in the firmware.
    boot_time : float
        From power-up to the banner [s].
    publish : callable, optional
        Called with the pieces of the true motion whenever they change.
    home_position : float or None
        True azimuth at which homing leaves the arm [°]; None if the switch is broken.
    index : (float, float) or None
        True azimuth and width of the mark that the sensor at the probe input sees [°]; None if
        there is no sensor.
    work_offset : float
        Stored G54 offset of the axis [mm]; work = machine − offset.
    axis : str
        Letter of the rotary axis. The firmware has X, Y and Z; its relatives have more.
    """

    def __init__(
        self,
        settings: dict[int, float] | None = None,
        *,
        boot_time: float = 0.0,
        publish: Callable[[Sequence[Piece]], None] = lambda pieces: None,
        home_position: float | None = 0.0,
        index: tuple[float, float] | None = None,
        work_offset: float = 0.0,
        axis: str = 'X',
    ) -> None:
        super().__init__(settings, boot_time, publish, index, work_offset, axis)
        self._home_position = home_position
        self._reader = Reader(axis, self._axes, self._work_offset)

    def _run(self, now: float) -> None:
        while not self._blocked(now):
            end = re.search(rb'[\r\n]', self._received)
            if end is None:
                break
            raw = bytes(self._received[: end.start()])
            del self._received[: end.end()]
            try:
                self._execute(raw, now)
            except RefusedLineError as refusal:
                self._output += f'error:{refusal.code}\r\n'.encode()
        if self._state == 'Idle':
            self._start_motion(now)

    def _blocked(self, now: float) -> bool:
        if self._state in ('Boot', 'Hold', 'Home') or self._critical:
            return True
        if self._waiting is None:
            return False
        if self._state == 'Idle':
            self._start_motion(now)
        if not self._waiting(now):
            return True
        self._waiting = None
        self._output += b'ok\r\n'
        return False

    def _execute(self, raw: bytes, now: float) -> None:
        line = re.sub(r'\([^)]*\)?|;.*', '', raw.decode('ascii', 'replace'))
        line = re.sub(r'[\s/\x00-\x20]', '', line).upper()
        if len(line) > _LINE_BUFFER:
            raise RefusedLineError(11)
        if line.startswith('$'):
            self._system_command(line, now)
        elif line and self._state in ('Alarm', 'Jog'):
            raise RefusedLineError(9)
        elif line:
            self._block(line, now, jog=False)
        if self._waiting is None and not self._critical and self._state != 'Home':
            self._output += b'ok\r\n'

    def _system_command(self, line: str, now: float) -> None:
        if line.startswith('$J='):
            if self._state not in ('Idle', 'Jog'):
                raise RefusedLineError(8)
            self._block(line[3:], now, jog=True)
        elif line == '$$':
            if self._state in ('Run', 'Hold'):
                raise RefusedLineError(8)
            for number, value in sorted(self.settings.items()):
                decimals = 3 if number in (11, 12, 24, 25, 27) or number >= 100 else 0
                self._output += f'${number}={value:.{decimals}f}\r\n'.encode()
        elif line == '$X':
            if self._state == 'Alarm':
                self._output += b'[MSG:Caution: Unlocked]\r\n'
                self._state = 'Idle'
        elif self._state not in ('Idle', 'Alarm'):
            raise RefusedLineError(8)
        elif line == '$H':
            self._home(now)
        elif match := re.fullmatch(r'\$(\d+)=(\d+(?:\.\d*)?)', line):
            if int(match[1]) not in self.settings:
                raise RefusedLineError(3)
            self.settings[int(match[1])] = float(match[2])
        else:
            raise RefusedLineError(3)

    def _block(self, line: str, now: float, *, jog: bool) -> None:
        block = self._reader.read(line, self._modes, jog=jog)
        if block.dwell is not None:
            self._dwell(block.dwell)
        elif block.target is not None and block.probe:
            self._probe(block.target, float(block.modes.feed), now, block.probe)
        elif block.target is not None:
            feed = math.inf if block.rapid else float(block.modes.feed)
            self._line(block.target, feed, now, jog=jog)
            block.modes.position = self._modes.position = block.target
        if not jog and not self._critical:
            self._modes = block.modes

    def _dwell(self, seconds: float) -> None:
        def over(moment: float) -> bool:
            nonlocal seconds
            if self._motor.blocks or self._state != 'Idle':
                return False
            if seconds > 0.0:
                self._dwell_until = moment + seconds
                seconds = 0.0
            return self._dwell_until == NEVER

        self._waiting = over

    def _line(self, target: np.float32, feed: float, now: float, *, jog: bool) -> None:
        if self.settings[20] and not -self._setting(130) <= target <= 0.0:
            if jog:
                raise RefusedLineError(15)
            if self._motor.moving(now):
                self._motor.brake(now)
            self._alarm(2)
            return
        if abs(target) > _FARTHEST:
            raise RefusedLineError(33)
        exact = float(target * np.float32(self._setting(100)))
        steps = int(math.copysign(math.floor(abs(exact) + 0.5), exact))
        speed = math.radians(min(feed, self._setting(110)) / 60.0)

        def planned(moment: float) -> bool:
            if len(self._motor.blocks) >= _PLANNER_BLOCKS:
                return False
            last = self._motor.blocks[-1][0] if self._motor.blocks else self._motor.end
            if steps != self._motor.steps(last):
                self._motor.blocks.append((self._motor.azimuth_of(steps), speed))
                if self._motor.planned:  # the moving arm need not stop before this block
                    self._motor.plan(moment)
            return True

        if not planned(now):
            self._waiting = planned
        if jog and self._motor.blocks and self._state == 'Idle':
            self._state = 'Jog'
            self._motor.plan(now)

    def _probe(self, target: np.float32, feed: float, now: float, code: int) -> None:
        away, tolerant = code in (384, 385), code in (383, 385)
        if target == self._modes.position:
            raise RefusedLineError(33)
        started = False

        def over(moment: float) -> bool:
            nonlocal started
            if self._motor.blocks or self._state != 'Idle':
                return False
            if not started:
                if self._motor.contact(moment) != away:
                    self._output += b'ALARM:4\r\n'
                    self._state = 'Alarm'
                    return True
                started = self._motor.watching = True
                self._probed = None
                self._line(target, feed, moment, jog=False)
                self._start_motion(moment)
                # Soft limits may have refused it.
                return not self._motor.blocks and not self._motor.watching
            self._motor.watching = False
            found = self._probed is not None
            if not found and not tolerant:
                self._output += b'ALARM:5\r\n'
                self._state = 'Alarm'
            self._probed = self._motor.steps() if self._probed is None else self._probed
            where = np.float32(self._probed) / np.float32(self._setting(100))
            self._output += f'[PRB:{self._coordinates(where)}:{found:d}]\r\n'.encode()
            self._modes.position = self._count()
            return True

        self._waiting = over

    def _contact(self, now: float) -> None:
        """Note where the probe input changed, and brake."""
        self._motor.watching = False
        self._probed = self._motor.steps(self._motor.state(now)[0])
        self._motor.blocks.clear()
        self._motor.brake(now)

    def _home(self, now: float) -> None:
        if not self.settings[22]:
            raise RefusedLineError(5)
        here = self._motor.state(now)[0]
        reach = 1.5 * math.radians(self._setting(130))
        found = self._home_position is not None
        end = math.radians(self._home_position or 0.0) if found else here + reach
        found = found and abs(end - here) <= reach

        def finish(_: float) -> bool:
            if not found:
                self._alarm(9)
                self._output += b'ok\r\n'
                self._critical = False
                self._begin('Alarm')
                return False
            self._motor.zero = end + math.radians(self.settings[27])
            self._modes.position = np.float32(-self.settings[27])
            return True

        self._state = 'Home'
        self._waiting = finish
        speed = math.radians(self.settings[25] / 60.0)
        acceleration = math.radians(self._setting(120))
        moves = [(end, speed)] if end != here else []
        self._motor.follow(chain(now, here, 0.0, moves, acceleration)[0])

    # The motor.

    def _start_motion(self, now: float) -> None:
        if self._motor.blocks:
            self._state = 'Run'
            self._motor.plan(now)

    def _end_block(self, now: float) -> None:
        if self._motor.end_block(now):
            if self._state == 'Jog':
                self._modes.position = self._count()
            if self._state in ('Run', 'Jog', 'Home'):
                self._state = 'Idle'
