"""Operating-system processes that a command starts, watches and stops."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: How long a process may take to end after SIGINT [s].
_STOP_TIMEOUT = 20.0


class ProcessError(RuntimeError):
    """A process ended by itself or did not end cleanly."""


class Processes:
    """
    Processes of this package, each with its output in a log file; stopped newest first.

    Parameters
    ----------
    log_directory : Path
        Where ``<name>.log`` files go.
    """

    def __init__(self, log_directory: Path) -> None:
        self._logs = log_directory
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str, module: str, arguments: Sequence[str]) -> None:
        """Run ``module.main`` of this package as a process of its own."""
        code = f'import sys; from {module} import main; sys.exit(main())'
        with (self._logs / f'{name}.log').open('wb') as log:
            self._running[name] = subprocess.Popen(
                [sys.executable, '-c', code, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C reaches them through stop(), in order
            )

    def check(self) -> None:
        """
        Make sure that all still run.

        Raises
        ------
        ProcessError
            With the last lines that the process printed.
        """
        for name, process in list(self._running.items()):
            if process.poll() is not None:
                del self._running[name]
                raise ProcessError(
                    f'{name} ended with code {process.returncode}:\n{self.output(name)}'
                )

    def stop(self) -> None:
        """
        Interrupt all, newest first, each when the newer ones, which may need it, have ended.

        Raises
        ------
        ProcessError
            If one did not end with code 0.
        """
        faults = []
        for name, process in reversed(self._running.items()):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.returncode != 0:
                faults.append(f'{name} ended with code {process.returncode}:\n{self.output(name)}')
        self._running.clear()
        if faults:
            raise ProcessError('\n'.join(faults))

    def output(self, name: str) -> str:
        """Return the last lines that a process printed, or that it printed none."""
        lines = self.text(name).splitlines()[-12:]
        return '\n'.join(lines) or f'it printed nothing into {self._logs}; is the disk full?'

    def text(self, name: str) -> str:
        """Return all that a process printed."""
        return (self._logs / f'{name}.log').read_text(errors='replace')

    def pid(self, name: str) -> int:
        """Return the number of a running process."""
        return self._running[name].pid
