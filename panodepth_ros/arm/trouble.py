"""What is in the way of commands to an arm."""

from __future__ import annotations

from panodepth_ros.arm.errors import (
    ArmAlarmError,
    ArmConnectionError,
    ArmError,
    ArmPositionError,
    ArmStoppedError,
)


class Trouble:
    """
    A lost connection, a wanted stop, what broke the running command, an uncertain position.

    Several threads may note it; who has it guards it.

    Parameters
    ----------
    port : str
        Named in the sentences.

    Attributes
    ----------
    doubt : str
        Why the position is uncertain, as a sentence; empty if it is not.
    stop_wanted : bool
        Whether the arm shall stop.
    broken : ArmConnectionError or None
        What ended the connection.
    """

    def __init__(self, port: str) -> None:
        self._port = port
        self.doubt = ''
        self.stop_wanted = False
        self.broken: ArmConnectionError | None = None
        self._incident: ArmError | None = None  # what broke the running command

    def begin_command(self, *, after_stop: bool) -> None:
        """Forget what broke the last command, and a stop if this command follows it."""
        self._incident = None
        if after_stop:
            self.stop_wanted = False

    def trust_position(self) -> None:
        """Note that the position is certain again."""
        self.doubt = ''
        self._incident = None

    def note_restart(self) -> None:
        """Note that the controller restarted by itself; an earlier doubt stays."""
        if not self.doubt:
            self.doubt = f'controller on port {self._port} restarted by itself'
            self._incident = ArmPositionError(f'position is lost: {self.doubt}')

    def note_alarm(self, meaning: str) -> None:
        """Note that the controller went into alarm."""
        self.doubt = f'controller on port {self._port} reported {meaning}'
        self._incident = ArmAlarmError(f'{self.doubt}; home the arm')

    def check(self) -> None:
        """
        Raise what is in the way of any command.

        Raises
        ------
        ArmError
            If something is; an uncertain position is not.
        """
        if self.broken is not None:
            raise ArmConnectionError(str(self.broken)) from self.broken
        if self.stop_wanted:
            raise ArmStoppedError(f'arm on port {self._port} was stopped')
        if self._incident is not None:
            raise self._incident
