"""G-code as GRBL 1.1 reads it, for the simulated controller: what a line asks for, refusals."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from panodepth_ros.arm.simulated_settings import Modes

_GROUPS = {  # modal group of each known G command
    0: 'motion', 1: 'motion', 4: 'non-modal', 53: 'non-modal', 54: 'coordinates',
    382: 'motion', 383: 'motion', 384: 'motion', 385: 'motion',
    20: 'units', 21: 'units', 90: 'distance', 91: 'distance', 94: 'feed mode',
}  # fmt: skip
_INCH = np.float32(25.4)
_NUMBER = re.compile(r'[+-]?(?:\d+\.?\d*|\.\d+)')


class RefusedLineError(Exception):
    """A line is answered with ``error:code``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True, slots=True)
class Block:
    """
    What a line asks for, in millimetres.

    Attributes
    ----------
    modes : Modes
        In force after it.
    dwell : float or None
        How long to wait [s], if it is a dwell.
    target : float32 or None
        Machine position of the axis, if it is a motion.
    rapid : bool
        Whether the motion is as fast as the axis can.
    probe : int
        Which probing it is, 382 to 385; 0 for none.
    """

    modes: Modes
    dwell: float | None = None
    target: np.float32 | None = None
    rapid: bool = False
    probe: int = 0


class Reader:
    """
    Reads the G-code of a controller.

    Parameters
    ----------
    axis : str
        Letter of the rotary axis.
    axes : str
        Letters of all axes that the controller has.
    work_offset : float32
        Machine minus work coordinates of the rotary axis [mm].
    """

    def __init__(self, axis: str, axes: str, work_offset: np.float32) -> None:
        self._axis = axis
        self._axes = set(axes)
        self._work_offset = work_offset

    def read(self, line: str, modes: Modes, *, jog: bool) -> Block:
        """
        Tell what a line without blanks asks for, in the modes of the line before.

        Raises
        ------
        RefusedLineError
            With the firmware's code.
        """
        commands, words = words_of(line, self._axes)
        if jog and not commands <= {20, 21, 53, 90, 91}:
            raise RefusedLineError(16)
        modes = _changed(modes, commands)
        scale = _INCH if modes.inches else np.float32(1.0)
        if words.keys() - {'F'} - self._axes - ({'P'} if 4 in commands else set()):
            raise RefusedLineError(36)
        if 'F' in words:
            modes.feed = words['F'] * scale
        elif jog:
            raise RefusedLineError(22)
        if 4 in commands:
            if 'P' not in words:
                raise RefusedLineError(28)
            if words.keys() & self._axes:
                raise RefusedLineError(31)
            return Block(modes, dwell=float(words['P']))
        probing = commands & {382, 383, 384, 385}
        if words.keys() & self._axes:
            target = self._target(commands, words, modes)
            if probing and 53 in commands:
                raise RefusedLineError(30)
            rapid = not probing and modes.motion == 0 and not jog
            if not rapid and modes.feed == 0.0:
                raise RefusedLineError(22)
            return Block(modes, target=target, rapid=rapid, probe=max(probing, default=0))
        if jog or probing or commands & {0, 1, 53}:
            raise RefusedLineError(26)
        return Block(modes)

    def _target(
        self, commands: set[int], words: dict[str, np.float32], modes: Modes
    ) -> np.float32:
        if self._axis not in words:
            return modes.position
        target = words[self._axis] * (_INCH if modes.inches else np.float32(1.0))
        if modes.relative:
            return modes.position + target
        return target if 53 in commands else target + self._work_offset


def _changed(modes: Modes, commands: set[int]) -> Modes:
    modes = replace(modes)
    for command in commands:
        if command in (0, 1):
            modes.motion = command
        elif command in (20, 21):
            modes.inches = command == 20
        elif command in (90, 91):
            modes.relative = command == 91
    return modes


def words_of(line: str, axes: set[str]) -> tuple[set[int], dict[str, np.float32]]:
    """
    G commands and value words of a line without blanks, for a controller of some axes.

    Raises
    ------
    RefusedLineError
        With the firmware's code.
    """
    commands: set[int] = set()
    groups: set[str] = set()
    words: dict[str, np.float32] = {}
    at = 0
    while at < len(line):
        letter = line[at]
        if not 'A' <= letter <= 'Z':
            raise RefusedLineError(1)
        number = _NUMBER.match(line, at + 1)
        if number is None:
            raise RefusedLineError(2)
        at = number.end()
        value = float32(number[0])
        if letter == 'G':
            code = int(value)
            if code == 38:  # G38.2 to G38.5
                code = round(10.0 * float(value))
                value = np.float32(code)
            group = _GROUPS.get(code)
            if group is None:
                raise RefusedLineError(20)
            if value != code:
                raise RefusedLineError(23)
            if group in groups:
                raise RefusedLineError(21)
            groups.add(group)
            commands.add(code)
            continue
        if letter not in axes | set('FPNIJKRLST'):
            raise RefusedLineError(20)
        if letter in words:
            raise RefusedLineError(25)
        if letter in 'FNPST' and value < 0.0:
            raise RefusedLineError(4)
        words[letter] = value
    if 4 in commands and commands & {0, 1}:
        raise RefusedLineError(24 if words.keys() & axes else 21)
    return commands, words


def float32(text: str) -> np.float32:
    """A number as the firmware reads it: eight digits, scaled in 32-bit floats."""
    whole, _, decimals = text.lstrip('+-').partition('.')
    digits = (whole + decimals)[:8]
    value = np.float32(int(digits))
    exponent = min(len(whole) - len(digits), 20)
    while exponent <= -2:
        value *= np.float32(0.01)
        exponent += 2
    if exponent == -1:
        value *= np.float32(0.1)
    while exponent > 0:
        value *= np.float32(10.0)
        exponent -= 1
    return -value if text.startswith('-') else value
