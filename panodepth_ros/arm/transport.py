"""The serial line: bytes in, bytes out, and every fault of the port as an :class:`ArmError`."""

from __future__ import annotations

import errno
import os
import termios
from collections.abc import Iterator
from contextlib import contextmanager

import serial

from panodepth_ros.arm.errors import ArmConnectionError, ArmTimeoutError

#: A line of the protocol is short; a port that does not take it in this time [s] is stuck.
_WRITE_TIMEOUT = 1.0
#: How long a read waits for the first byte [s].
_READ_TIMEOUT = 0.2

# What pyserial raises when a device goes away depends on the call that noticed.
_FAULTS = (OSError, serial.SerialException, termios.error)

_ADVICE = {
    errno.ENOENT: 'there is no such device; is the arm plugged in?',
    errno.EACCES: 'permission denied; is the user in the group of the device (dialout)?',
    errno.EAGAIN: 'it is in use by another program',
    errno.EBUSY: 'it is in use by another program',
}


class SerialLine:
    """
    An exclusively opened serial port.

    The line that resets most boards when a port is opened (DTR) is left as it is when the port is
    closed, by whatever ends the process: opened again, the board runs on and keeps its count.

    Parameters
    ----------
    port : str
        Device path.
    baud_rate : int
        Bits per second, 8N1.

    Raises
    ------
    ArmConnectionError
        If the port cannot be opened.
    """

    def __init__(self, port: str, baud_rate: int) -> None:
        self.port = port
        try:
            self._serial = serial.Serial(
                port,
                baud_rate,
                timeout=_READ_TIMEOUT,
                write_timeout=_WRITE_TIMEOUT,
                exclusive=True,
            )
            _keep_dtr(self._serial.fileno())
        except (*_FAULTS, ValueError) as error:
            raise ArmConnectionError(f'cannot open port {port}: {_reason(error)}') from error

    def read(self) -> bytes:
        """
        Wait a moment for bytes and return all that have come, possibly none.

        Raises
        ------
        ArmConnectionError
            If the port has vanished.
        """
        with self._translated():
            data: bytes = self._serial.read(1)
            if data:
                data += self._serial.read(self._serial.in_waiting)
            return data

    def write(self, data: bytes) -> None:
        """
        Send bytes.

        Raises
        ------
        ArmConnectionError
            If the port has vanished.
        ArmTimeoutError
            If the port takes no bytes.
        """
        with self._translated():
            self._serial.write(data)

    def cancel_read(self) -> None:
        """End a :meth:`read` that waits in another thread."""
        with self._translated():
            self._serial.cancel_read()

    def close(self) -> None:
        """Close the port. Idempotent; no other thread may be using it."""
        with self._translated():
            self._serial.close()

    @contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except serial.SerialTimeoutException as error:
            raise ArmTimeoutError(
                f'port {self.port} took no bytes for {_WRITE_TIMEOUT:g} s'
            ) from error
        except _FAULTS as error:
            raise ArmConnectionError(
                f'connection on port {self.port} is lost: {_reason(error)}'
            ) from error


def _keep_dtr(descriptor: int) -> None:
    """Let the modem lines be when the port is closed (``stty -hupcl``)."""
    attributes = termios.tcgetattr(descriptor)
    attributes[2] &= ~termios.HUPCL
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


def _reason(error: BaseException) -> str:
    number = getattr(error, 'errno', None)
    if number is None and isinstance(error, termios.error):
        number = error.args[0]
    if number in _ADVICE:
        return _ADVICE[number]
    return os.strerror(number) if isinstance(number, int) else str(error)
