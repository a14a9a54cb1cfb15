"""
GRBL 1.1 on the wire: bytes to messages and commands to bytes, without any I/O.

The controller answers each line with ``ok`` or ``error:N``; ``ok`` means parsed, not moved. All
else comes unasked or on request: status reports ``<...>``, settings ``$N=value``, feedback
``[...]``, ``ALARM:N`` and the banner of a reset. The wire has no checksum, so whatever is not
exactly of a known form becomes :class:`Malformed`. Positions have three decimals in millimetres
(for a rotary axis: degrees) and four in inches: a report that lost a decimal is caught by that,
one that lost an integer digit only by comparing two reports.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

#: Axis letters in the order in which status reports list them.
AXES = 'XYZABC'

# Real-time bytes need no end of line and overtake all lines.
STATUS_QUERY = b'?'
FEED_HOLD = b'!'
CYCLE_START = b'~'
SOFT_RESET = b'\x18'
JOG_CANCEL = b'\x85'

# Lines.
BARRIER = b'G4P0\n'
READ_SETTINGS = b'$$\n'
UNLOCK = b'$X\n'
HOME = b'$H\n'

#: Longest line [bytes] that any answer may have; settings of grblHAL are the longest.
_MAX_LINE = 512

_ERRORS = {
    1: 'a word does not begin with a letter',
    2: 'a number is missing or malformed',
    3: 'the $ command is unknown',
    4: 'a value is negative that must not be',
    5: 'homing is not enabled ($22=0)',
    8: 'the $ command needs an idle controller',
    9: 'locked during alarm or jog',
    10: 'soft limits need homing to be enabled',
    11: 'the line is too long',
    15: 'the jog leaves the travel of the axis',
    16: 'the jog command is malformed',
    20: 'unsupported command or axis',
    21: 'two commands of one modal group',
    22: 'no feed rate',
    23: 'the command needs a whole number',
    24: 'two commands want axis words',
    25: 'a word is repeated',
    26: 'the command lacks axis words',
    28: 'the command lacks a value',
    30: 'G53 goes with G0 and G1 only',
    31: 'axis words that nothing uses',
    33: 'the target is invalid',
    36: 'values that nothing uses',
}

_ALARMS = {
    1: 'a limit switch was hit, position lost',
    2: 'the target lies outside the soft limits',
    3: 'reset while moving, position lost',
    4: 'the probe input was not as probing needs it at its begin',
    5: 'the probe input did not change',
    6: 'homing was interrupted by a reset',
    7: 'homing was interrupted by the safety door',
    8: 'homing could not pull off the limit switch',
    9: 'homing did not find the limit switch',
    10: 'homing did not find the second limit switch',
}

_STATES = ('Idle', 'Run', 'Hold', 'Jog', 'Alarm', 'Door', 'Check', 'Home', 'Sleep', 'Tool')


@dataclass(frozen=True, slots=True)
class Ok:
    """A line was parsed and accepted."""


@dataclass(frozen=True, slots=True)
class ErrorReply:
    """A line was refused."""

    code: int

    @property
    def meaning(self) -> str:
        """The number and what it says."""
        return f'error:{self.code} ({_ERRORS.get(self.code, "see the firmware manual")})'


@dataclass(frozen=True, slots=True)
class Alarm:
    """The controller stopped and is locked."""

    code: int

    @property
    def meaning(self) -> str:
        """The number and what it says."""
        return f'ALARM:{self.code} ({_ALARMS.get(self.code, "see the firmware manual")})'


@dataclass(frozen=True, slots=True)
class Banner:
    """The controller has just started, after power-up or a reset."""

    version: str


@dataclass(frozen=True, slots=True)
class Setting:
    """One stored setting ``$number=value``; a value that is not a number is None."""

    number: int
    value: float | None


@dataclass(frozen=True, slots=True)
class Feedback:
    """A message ``[...]`` or the result of a startup line ``>...``; for people."""

    text: str


@dataclass(frozen=True, slots=True)
class Malformed:
    """A line that is none of the known forms: noise, lost bytes, another device."""

    raw: bytes


@dataclass(frozen=True, slots=True)
class Status:
    """
    A status report.

    Attributes
    ----------
    state : str
        ``Idle``, ``Run``, ``Hold``, ``Jog``, ``Alarm``, ``Door``, ``Check``, ``Home``, ``Sleep``
        or ``Tool``.
    substate : int or None
        ``Hold:0`` is held, ``Hold:1`` still braking.
    machine : bool
        Whether ``position`` is in machine coordinates (MPos) or work coordinates (WPos).
    position : tuple of float
        One value per axis, in the controller's units ($13: millimetres or inches).
    offset : tuple of float or None
        Machine minus work coordinates, when the report carries them (WCO).
    feed : float or None
        Speed per minute, never negative, when the report carries it (F, FS).
    pins : str
        Letters of the inputs that are active (Pn); ``P`` is the probe.
    """

    state: str
    substate: int | None
    machine: bool
    position: tuple[float, ...]
    offset: tuple[float, ...] | None = None
    feed: float | None = None
    pins: str = ''

    @property
    def moves(self) -> bool:
        """Whether the controller says that it is moving its axes."""
        return self.state in ('Run', 'Jog') or (self.state == 'Hold' and self.substate == 1)


@dataclass(frozen=True, slots=True)
class Probe:
    """
    What probing found.

    Attributes
    ----------
    position : tuple of float
        Machine coordinates when the input changed, one value per axis, in the controller's units.
    found : bool
        Whether it changed; if not, the position means nothing.
    """

    position: tuple[float, ...]
    found: bool


Message = Probe | Ok | ErrorReply | Alarm | Banner | Setting | Feedback | Status | Malformed

_NUMBER = re.compile(r'-?\d+(?:\.\d+)?')
_STATE = re.compile(rf'({"|".join(_STATES)})(?::(\d{{1,2}}))?')
_COORDINATES = re.compile(
    r'-?\d{1,6}\.(?:\d{3}(?:,-?\d{1,6}\.\d{3})*|\d{4}(?:,-?\d{1,6}\.\d{4})*)'
)
_FEED = re.compile(r'(\d{1,6}(?:\.\d+)?)(?:,\d{1,6}(?:\.\d+)?)?')
_FIELD = re.compile(r'([A-Z][A-Za-z]*)(?::([^<>|:]*))?')


def _setting(match: re.Match[str]) -> Setting:
    return Setting(int(match[1]), float(match[2]) if _NUMBER.fullmatch(match[2]) else None)


def _probe(match: re.Match[str]) -> Message:
    position = _coordinates(match[1])
    return Probe(position, match[2] == '1') if position else Malformed(match[0].encode())


_FORMS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], Message]], ...] = (
    (re.compile(r'ok'), lambda _: Ok()),
    (re.compile(r'error:(\d{1,3})'), lambda match: ErrorReply(int(match[1]))),
    (re.compile(r'ALARM:(\d{1,3})'), lambda match: Alarm(int(match[1]))),
    (re.compile(r'Grbl(?:HAL)? (\d+\.\d+\w*) \[.*\]'), lambda match: Banner(match[1])),
    (re.compile(r'\$(\d{1,3})=(.*)'), _setting),
    (re.compile(rf'\[PRB:({_COORDINATES.pattern}):([01])\]'), _probe),
    (re.compile(r'\[[^\[\]]*\]|>.*:(?:ok|error:\d+)'), lambda match: Feedback(match[0])),
)


def parse(line: bytes) -> Message:
    """
    One line without its end, as a message.

    Parameters
    ----------
    line : bytes
        What :class:`LineAssembler` gave.

    Returns
    -------
    Message
        :class:`Malformed` for anything that is not exactly of a known form.
    """
    try:
        text = line.decode('ascii')
    except UnicodeDecodeError:
        return Malformed(line)
    for pattern, make in _FORMS:
        if match := pattern.fullmatch(text):
            return make(match)
    return _parse_status(text) or Malformed(line)


def _parse_status(text: str) -> Status | None:
    if len(text) < 2 or text[0] != '<' or text[-1] != '>':
        return None
    state, *rest = text[1:-1].split('|')
    matched = _STATE.fullmatch(state)
    fields: dict[str, str] = {}
    for field in rest:
        match = _FIELD.fullmatch(field)
        if match is None or match[1] in fields:
            return None
        fields[match[1]] = match[2] or ''
    kinds = [kind for kind in ('MPos', 'WPos') if kind in fields]
    if matched is None or len(kinds) != 1 or not rest[0].startswith(kinds[0]):
        return None
    position = _coordinates(fields[kinds[0]])
    offset = _coordinates(fields['WCO']) if 'WCO' in fields else None
    feed_field = fields.get('FS', fields.get('F'))
    feed = _FEED.fullmatch(feed_field) if feed_field is not None else None
    wrong = (
        position is None
        or ('WCO' in fields and (offset is None or len(offset) != len(position)))
        or (feed_field is not None and feed is None)
    )
    if wrong or position is None:
        return None
    return Status(
        state=matched[1],
        substate=int(matched[2]) if matched[2] else None,
        machine=kinds[0] == 'MPos',
        position=position,
        offset=offset,
        feed=float(feed[1]) if feed else None,
        pins=fields.get('Pn', ''),
    )


def _coordinates(text: str) -> tuple[float, ...] | None:
    if not _COORDINATES.fullmatch(text):
        return None
    values = tuple(float(value) for value in text.split(','))
    return values if 3 <= len(values) <= len(AXES) else None


class LineAssembler:
    """Cuts a stream of bytes, arriving in any portions, into lines."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    @property
    def rest(self) -> bytes:
        """What has come since the last end of line."""
        return bytes(self._buffer)

    def feed(self, data: bytes) -> list[bytes]:
        """
        Take bytes and return the lines they complete, without ends and without empty ones.

        A run of bytes longer than any line can be is cut, so that noise cannot fill the memory.
        """
        self._buffer += data
        *lines, rest = re.split(rb'[\r\n]', self._buffer)
        if len(rest) > _MAX_LINE:
            lines.append(rest)
            rest = b''
        self._buffer = bytearray(rest)
        return [bytes(line) for line in lines if line]


def encode_move(axis: str, position: float, feed: float) -> bytes:
    """
    Absolute straight move in machine coordinates.

    The line states every mode it depends on, because a reset forgets modes and feed, and startup
    lines or other programs may have changed them.

    Parameters
    ----------
    axis : str
        Letter of the axis.
    position : float
        Target [mm, for a rotary axis degrees].
    feed : float
        Speed per minute, > 0.
    """
    return f'G53G21G90G94G1{axis}{position:.4f}F{feed:.3f}\n'.encode('ascii')


def encode_probe(axis: str, way: float, feed: float, *, away: bool) -> bytes:
    """
    Relative straight move that ends where the probe input changes, without alarm if it does not.

    Parameters
    ----------
    axis : str
        Letter of the axis.
    way : float
        How far at most [mm, for a rotary axis degrees].
    feed : float
        Speed per minute, > 0.
    away : bool
        Whether the input is active at the begin and shall not be, instead of the reverse.
    """
    code = 'G38.5' if away else 'G38.3'
    return f'G21G91G94{code}{axis}{way:.4f}F{feed:.3f}\n'.encode('ascii')
