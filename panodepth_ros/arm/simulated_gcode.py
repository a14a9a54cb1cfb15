"""G-code as GRBL 1.1 reads it, for the simulated controller: words, numbers, refusals."""

from __future__ import annotations

import re

import numpy as np

_GROUPS = {  # modal group of each known G command
    0: 'motion', 1: 'motion', 4: 'non-modal', 53: 'non-modal', 54: 'coordinates',
    382: 'motion', 383: 'motion', 384: 'motion', 385: 'motion',
    20: 'units', 21: 'units', 90: 'distance', 91: 'distance', 94: 'feed mode',
}  # fmt: skip
_NUMBER = re.compile(r'[+-]?(?:\d+\.?\d*|\.\d+)')


class RefusedLineError(Exception):
    """A line is answered with ``error:code``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def words_of(line: str) -> tuple[set[int], dict[str, np.float32]]:
    """
    G commands and value words of a line without blanks.

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
        if letter not in 'FPXYZNIJKRLST':
            raise RefusedLineError(20)
        if letter in words:
            raise RefusedLineError(25)
        if letter in 'FNPST' and value < 0.0:
            raise RefusedLineError(4)
        words[letter] = value
    if 4 in commands and commands & {0, 1}:
        raise RefusedLineError(24 if words.keys() & set('XYZ') else 21)
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
