"""
The conversation with a GRBL controller: lines and their answers, reports, resets, trouble.

One thread reads the line. Whatever breaks a conversation (the port vanishes, the controller
restarts by itself or goes into alarm, somebody wants the arm to stop) is raised in the thread
that waits for an answer.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import (
    ArmConnectionError,
    ArmError,
    ArmPositionError,
    ArmProtocolError,
    ArmTimeoutError,
)
from panodepth_ros.arm.transport import SerialLine
from panodepth_ros.arm.trouble import Trouble

_LOGGER = logging.getLogger(__name__)

#: Answers to ``?`` get lost at times: how often it is sent within the response timeout.
_QUERIES = 8
#: How many bytes of noise an error message shows.
_NOISE = 60


class Answer(NamedTuple):
    """
    A status report and when it was asked for and came.

    Attributes
    ----------
    status : grbl.Status
        The report.
    asked, received : float
        By ``time.monotonic()`` [s]; the position was read in between. ``asked`` is when the
        first query was sent that this may be the answer to.
    """

    status: grbl.Status
    asked: float
    received: float


class SentLine:
    """A line that was sent and what the controller answered."""

    def __init__(self, text: bytes) -> None:
        self.text = text.decode('ascii').strip()
        self.answer: grbl.Ok | grbl.ErrorReply | None = None


class GrblLink:
    """
    A connected controller, from construction to :meth:`disconnect`.

    Commands run one at a time, in the thread that calls them; :meth:`interrupt` may be called
    from any other.

    Parameters
    ----------
    port : str
        Serial device.
    baud_rate : int
        Bits per second.
    response_timeout : float
        How long an answer may take [s].

    Attributes
    ----------
    settings : dict
        ``$N`` values that the controller has listed; None for one that is not a number.
    offset : tuple of float or None
        Machine minus work coordinates, as last reported.
    moving : bool
        Whether a motion was sent that has not been seen to end.
    probe : grbl.Probe or None
        What probing found since the last motion was sent.
    homing : bool
        Whether homing was sent that has not been answered.

    Raises
    ------
    ArmConnectionError
        If the port cannot be opened.
    """

    def __init__(self, port: str, baud_rate: int, response_timeout: float) -> None:
        self.port = port
        self.response_timeout = response_timeout
        self.settings: dict[int, float | None] = {}
        self.offset: tuple[float, ...] | None = None
        self.moving = False
        self.homing = False
        self.probe: grbl.Probe | None = None

        self._changed = threading.Condition()  # guards what two threads share
        self._pending: deque[SentLine] = deque()
        self._reports: deque[Answer] = deque(maxlen=1)  # since the last query
        self._asked: float | None = None  # when the first query was sent that is unanswered
        self._banner: grbl.Banner | None = None
        self._banner_wanted = True
        self._trouble = Trouble(port)
        self._noise = b''
        self._reading = True
        self._assembler = grbl.LineAssembler()
        self._line = SerialLine(port, baud_rate)
        self._reader = threading.Thread(target=self._read, name='arm reader', daemon=True)
        self._reader.start()

    # Trouble.

    @property
    def doubt(self) -> str:
        """Why the position is uncertain, as a sentence; empty if it is not."""
        with self._changed:
            return self._trouble.doubt

    def lose_position(self, reason: str) -> None:
        """Note why the position has become uncertain; the first reason stays."""
        with self._changed:
            self._trouble.doubt = self._trouble.doubt or reason
            self.moving = False

    def trust_position(self) -> None:
        """Note that the position is certain again."""
        with self._changed:
            self._trouble.trust_position()

    def begin_command(self, *, after_stop: bool) -> None:
        """Forget what broke the last command, and a stop if this command follows it."""
        with self._changed:
            self._trouble.begin_command(after_stop=after_stop)

    def require_certainty(self) -> None:
        """
        Make sure that the arm may move.

        Raises
        ------
        ArmPositionError
            If the position is uncertain.
        ArmError
            If something else is in the way.
        """
        with self._changed:
            self._trouble.check()
            if self.doubt:
                raise ArmPositionError(f'position is uncertain: {self.doubt}; home the arm')

    def interrupt(self) -> None:
        """Begin to brake and make the running command raise."""
        with self._changed:
            self._trouble.stop_wanted = True
            if self.homing:  # only a reset ends it
                self._banner_wanted = True
                self._line.write(grbl.SOFT_RESET)
            elif self.moving:
                self._line.write(grbl.FEED_HOLD)
            self._changed.notify_all()

    def kill(self) -> None:
        """Reset a controller that does not answer, as the last means to stop the arm."""
        with suppress(ArmError):
            self._line.write(grbl.SOFT_RESET)

    def disconnect(self) -> None:
        """End reading, fail who waits, close the port. Idempotent."""
        with self._changed:
            self._reading = False
            closed = ArmConnectionError(f'port {self.port} was closed')
            self._trouble.broken = self._trouble.broken or closed
            self._changed.notify_all()
        with suppress(ArmError):
            self._line.cancel_read()
        self._reader.join()
        with suppress(ArmError):
            self._line.close()

    # Questions and answers.

    def greet(self, timeout: float) -> bool:
        """
        Wait for the controller.

        Returns
        -------
        bool
            True if it has just started; False if it runs on and may be doing anything.

        Raises
        ------
        ArmTimeoutError
            If nothing answers.
        ArmProtocolError
            If something answers that is no GRBL controller.
        """
        deadline = time.monotonic() + timeout
        while True:
            self._query()
            if self.until(lambda: bool(self._banner or self._reports), self._query_timeout):
                return self._banner is not None
            if time.monotonic() > deadline:
                break
        noise = (self._noise + self._assembler.rest)[:_NOISE]
        if noise:
            raise ArmProtocolError(
                f'what answers on port {self.port} is no GRBL 1.1 controller, or baud_rate is '
                f'wrong; it sent {noise!r}'
            )
        raise ArmTimeoutError(
            f'port {self.port} stays silent: no answer to a status query for {timeout:g} s'
        )

    def reset(self) -> None:
        """
        Restart the controller and wait for its banner; a standing arm keeps its position.

        Raises
        ------
        ArmTimeoutError
            If the banner does not come.
        """
        with self._changed:
            self._banner = None
            self._banner_wanted = True
            self.write(grbl.SOFT_RESET)
        if not self.until(lambda: self._banner is not None, self.response_timeout):
            raise ArmTimeoutError(
                f'controller on port {self.port} did not restart within '
                f'{self.response_timeout:g} s'
            )

    def require_version(self) -> None:
        """
        Make sure that the controller, which has started, is recent enough.

        Raises
        ------
        ArmProtocolError
            If it is not.
        """
        if self._banner is not None and self._banner.version.startswith('0.'):
            raise ArmProtocolError(
                f'controller on port {self.port} is GRBL {self._banner.version}; '
                'version 1.1 is needed'
            )

    def send(self, *texts: bytes, moves: bool = False) -> list[SentLine]:
        """Send lines at once; ``moves`` says that they set the arm in motion."""
        lines = [SentLine(text) for text in texts]
        with self._changed:
            self._trouble.check()
            self._pending.extend(lines)
            self.moving = self.moving or moves
            self.probe = None if moves else self.probe
            self._line.write(b''.join(texts))
        return lines

    def answered(self, lines: list[SentLine], patience: float) -> bool:
        """Wait up to ``patience`` [s] until all lines are answered."""
        return self.until(lambda: lines[-1].answer is not None, patience)

    def require_ok(self, lines: list[SentLine]) -> None:
        """
        Make sure that answered lines were accepted.

        Raises
        ------
        ArmProtocolError
            If the controller refused one.
        """
        for line in lines:
            if isinstance(line.answer, grbl.ErrorReply):
                raise ArmProtocolError(
                    f'controller on port {self.port} refused {line.text} with '
                    f'{line.answer.meaning}'
                )

    def ask(self, *texts: bytes, timeout: float | None = None) -> None:
        """
        Send lines and wait until they are accepted.

        Raises
        ------
        ArmTimeoutError
            If they are not answered within ``timeout`` [s], by default the response timeout.
        ArmProtocolError
            If the controller refuses one.
        """
        lines = self.send(*texts)
        patience = self.response_timeout if timeout is None else timeout
        if not self.answered(lines, patience):
            raise self.unanswered(lines, patience)
        self.require_ok(lines)

    def unanswered(self, lines: list[SentLine], patience: float) -> ArmTimeoutError:
        """Make the error that says that lines were not answered in time."""
        return ArmTimeoutError(
            f'controller on port {self.port} did not answer {lines[-1].text} within '
            f'{patience:.1f} s'
        )

    def report(self) -> Answer | None:
        """Ask once for a status report; None if none comes within a part of the timeout."""
        with self._changed:
            self._query()
            if self.until(lambda: bool(self._reports), self._query_timeout):
                return self._reports[0]
        return None

    def write(self, data: bytes) -> None:
        """Send bytes that are not answered by ``ok``."""
        with self._changed:
            self._trouble.check()
            self._line.write(data)

    def until(self, happened: Callable[[], bool], timeout: float) -> bool:
        """Wait until something happened; raise whatever breaks the command meanwhile."""
        deadline = time.monotonic() + timeout
        with self._changed:
            while True:
                self._trouble.check()
                if happened():
                    return True
                remaining = deadline - time.monotonic()
                if remaining <= 0.0:
                    return False
                self._changed.wait(remaining)

    def _query(self) -> None:
        with self._changed:
            self._reports.clear()
            self._asked = self._asked or time.monotonic()
            self.write(grbl.STATUS_QUERY)

    @property
    def _query_timeout(self) -> float:
        return self.response_timeout / _QUERIES

    # The reader thread.

    def _read(self) -> None:
        try:
            while self._reading:
                data = self._line.read()
                received = time.monotonic()
                for line in self._assembler.feed(data):
                    with self._changed:
                        self._receive(grbl.parse(line), received)
                        self._changed.notify_all()
        except ArmConnectionError as error:
            with self._changed:
                self._trouble.broken = error
                self._changed.notify_all()

    def _receive(self, message: grbl.Message, received: float) -> None:
        if isinstance(message, grbl.Ok | grbl.ErrorReply):
            if self._pending:  # else the answer to a line that a reset cut off
                self._pending.popleft().answer = message
        elif isinstance(message, grbl.Status):
            self._reports.append(Answer(message, self._asked or received, received))
            self._asked = None
            self.offset = message.offset or self.offset
        elif isinstance(message, grbl.Setting):
            self.settings[message.number] = message.value
        elif isinstance(message, grbl.Probe):
            self.probe = message
        elif isinstance(message, grbl.Banner):
            self._receive_banner(message)
        elif isinstance(message, grbl.Alarm):
            self._receive_alarm(message)
        elif isinstance(message, grbl.Malformed):
            self._noise = (self._noise + message.raw)[:_NOISE]
            _LOGGER.debug('port %s sent noise: %r', self.port, message.raw)

    def _receive_banner(self, banner: grbl.Banner) -> None:
        self._pending.clear()
        self._banner = banner
        if not self._banner_wanted:
            self._trouble.note_restart()
            self.moving = False
        self._banner_wanted = False

    def _receive_alarm(self, alarm: grbl.Alarm) -> None:
        self._pending.clear()
        self.moving = False
        self._trouble.note_alarm(alarm.meaning)
