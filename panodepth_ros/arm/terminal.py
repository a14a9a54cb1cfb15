"""The simulated controller on a pseudo-terminal that looks like a serial port."""

from __future__ import annotations

import logging
import math
import os
import select
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol

from panodepth_ros.arm.simulated import SimulatedController
from panodepth_ros.arm.simulated_line import PacedLine
from panodepth_ros.arm.truth import TruthWriter, truth_path

_LOGGER = logging.getLogger(__name__)

#: How often a port that nobody has open is looked at [s].
_OPEN_POLL = 0.02


class TerminalError(RuntimeError):
    """The link of the pseudo-terminal cannot be made."""


class Controller(Protocol):
    """A simulated controller with its arm, as :class:`SimulatedController` describes it."""

    def power_up(self, now: float) -> None:
        """Start as after power-up."""

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes."""

    def advance(self, now: float) -> None:
        """Let everything happen that is due."""

    def next_event(self) -> float:
        """When something happens by itself [s]."""

    def take_output(self) -> bytes:
        """Return what was sent since the last call."""


class SimulatedArm:
    """
    Serves one controller on one pseudo-terminal, linked at a path, and publishes its truth.

    Opening the port powers the controller up anew, as the DTR line does on most boards: the
    banner comes after the boot time and the count starts at 0 wherever the arm stands; but not if
    the port was closed with DTR left on (``-hupcl``), for then opening it changes nothing. A port
    that is opened again in the same instant in which it was closed passes for never closed.

    Parameters
    ----------
    link : path-like
        Symbolic link to the terminal; the true motion is in ``truth_path(link)``. A link left
        over by a program that died is replaced.
    reset_on_open : bool
        False for a board that runs on when its port is opened.
    baud_rate : float
        Bits per second that the line carries; +inf for one that takes no time.
    controller_type : type
        What is on the far side of the line.
    **controller
        Its arguments but ``publish``.

    Raises
    ------
    TerminalError
        If something else is at the link.
    TruthError
        If another simulated arm uses the link, or its folder cannot be written.
    """

    def __init__(
        self,
        link: str | os.PathLike[str],
        *,
        reset_on_open: bool = True,
        baud_rate: float = math.inf,
        controller_type: Callable[..., Controller] = SimulatedController,
        **controller: object,
    ) -> None:
        self.link = Path(link)
        self._reset_on_open = reset_on_open
        self._line = PacedLine(baud_rate)
        if self.link.exists() and not self.link.is_symlink():
            raise TerminalError(f'{self.link} exists and is not a link of a simulated arm')
        self._truth = TruthWriter(truth_path(self.link))
        self.controller = controller_type(publish=self._truth.write, **controller)
        self._master, terminal = os.openpty()
        tty.setraw(terminal)
        attributes = termios.tcgetattr(terminal)
        attributes[2] |= termios.HUPCL  # as serial ports have it from the beginning
        termios.tcsetattr(terminal, termios.TCSANOW, attributes)
        self.terminal = os.ttyname(terminal)
        os.set_blocking(self._master, False)
        os.close(terminal)  # from now on the master sees whether somebody has the port open
        self._wake, self._waker = os.pipe()
        self._open = False
        self._dtr = False  # whether the modem line stayed on when the port was closed
        self._stopping = False
        self._closed = False
        self._poll = select.poll()
        self._poll.register(self._wake, select.POLLIN)
        self._poll.register(self._master, select.POLLIN)
        fresh = self.link.with_name(f'{self.link.name}.{os.getpid()}')
        fresh.symlink_to(self.terminal)
        fresh.replace(self.link)
        if not reset_on_open:
            self.controller.power_up(time.monotonic())

    def __enter__(self) -> SimulatedArm:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def run(self) -> None:
        """Serve until :meth:`stop`."""
        while True:
            if self._open:
                select.select([self._wake, self._master], [], [], self._patience())
            events = dict(self._poll.poll(0))
            if self._wake in events:
                os.read(self._wake, 64)
            if self._stopping:
                return
            now = time.monotonic()
            is_open = not events.get(self._master, 0) & select.POLLHUP
            if is_open and not self._open:
                self.controller.take_output()  # what was sent while nobody listened is lost
                self._line.clear()
                if self._reset_on_open and not self._dtr:
                    self.controller.power_up(now)
            elif self._open and not is_open:
                self._dtr = not termios.tcgetattr(self._master)[2] & termios.HUPCL
            self._open = is_open
            if events.get(self._master, 0) & select.POLLIN:  # also what came before a hang-up
                self._line.send(os.read(self._master, 4096), now)
            self._pass_on(now)
            if not is_open:
                time.sleep(_OPEN_POLL)  # a hung-up terminal is always ready

    def _pass_on(self, now: float) -> None:
        """Let happen what is due, in its order."""
        while (due := self.controller.next_event()) <= now:
            self._hear(due)
            self.controller.advance(due)
            self._line.answer(self.controller.take_output(), due)
        self._hear(now)
        self.controller.advance(now)
        self._line.answer(self.controller.take_output(), now)
        self.send(self._line.answered(now))

    def _hear(self, now: float) -> None:
        for moment, data in self._line.arrived(now):
            self.controller.receive(data, moment)
            self._line.answer(self.controller.take_output(), moment)

    def send(self, data: bytes) -> None:
        """Send bytes to whoever has the port open; they are lost if nobody has."""
        if data and self._open:
            try:
                os.write(self._master, data)
            except BlockingIOError:
                _LOGGER.warning('nobody reads port %s; %d bytes are lost', self.link, len(data))

    def stop(self) -> None:
        """Make :meth:`run` return; callable from any thread and from a signal handler."""
        self._stopping = True
        self.wake()

    def wake(self) -> None:
        """Make :meth:`run` look at the controller, after it was changed from outside."""
        os.write(self._waker, b'.')

    def close(self) -> None:
        """Take the port away, as unplugging it does, and remove link and truth. Idempotent."""
        if self._closed:
            return
        self._closed = True
        if self.link.is_symlink() and os.readlink(self.link) == self.terminal:
            self.link.unlink(missing_ok=True)  # its folder may be gone, too
        for descriptor in (self._master, self._wake, self._waker):
            os.close(descriptor)
        self._truth.close()

    def _patience(self) -> float | None:  # [s]
        due = min(self.controller.next_event(), self._line.next_event())
        return None if due == math.inf else max(0.0, due - time.monotonic())
