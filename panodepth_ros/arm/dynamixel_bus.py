"""One Dynamixel servo on its serial bus, by ROBOTIS' dynamixel-sdk, every fault an ArmError."""

from __future__ import annotations

import termios
import time
from collections.abc import Callable
from typing import Any

import serial

from panodepth_ros.arm.errors import (
    ArmConnectionError,
    ArmError,
    ArmProtocolError,
    ArmTimeoutError,
)

#: How long one read of the port waits for bytes [s].
_READ_TIMEOUT = 0.005
_READ = 0x02
#: Bit of a status packet's error that says that the servo has a hardware error.
_ALERT = 0x80
#: What a servo may take to start again [s].
_RESTART_TIME = 0.5

_MISSING = (
    "driver is 'dynamixel', which needs the package dynamixel-sdk; "
    "install it: pip install 'panodepth_ros[dynamixel]'"
)


class DynamixelBus:
    """
    An opened port and the one servo that is spoken to. For one thread at a time.

    Parameters
    ----------
    port : str
        Serial device.
    baud_rate : int
        Bits per second.
    servo_id : int
        The servo's number.
    response_timeout : float
        How long questions are repeated until an answer comes [s].
    open_port : callable
        Opens the port as serial.Serial does.

    Attributes
    ----------
    handler : dynamixel_sdk.PortHandler
        The SDK's view of the port.

    Raises
    ------
    ArmError
        If the SDK is not installed.
    ArmConnectionError
        If the port cannot be opened.
    """

    def __init__(
        self,
        port: str,
        baud_rate: int,
        servo_id: int,
        response_timeout: float,
        open_port: Callable[..., Any] = serial.Serial,
    ) -> None:
        try:
            import dynamixel_sdk  # noqa: PLC0415 - optional
        except ImportError as error:
            raise ArmError(_MISSING) from error
        self.port = port
        self._servo_id = servo_id
        self._response_timeout = response_timeout
        self._packets = dynamixel_sdk.Protocol2PacketHandler()
        try:
            self._serial = open_port(
                port, baud_rate, timeout=_READ_TIMEOUT, write_timeout=1.0, exclusive=True
            )
        except (OSError, ValueError, termios.error) as error:
            raise ArmConnectionError(f'cannot open port {port}: {error}') from error
        self.handler = _handler(dynamixel_sdk, self._serial, baud_rate)

    def ping(self) -> None:
        """Make sure that the servo is there."""
        self._ask('a ping', lambda: self._packets.ping(self.handler, self._servo_id)[1:])

    def read(self, address: int, length: int) -> int:
        """One unsigned value of the control table."""
        return int.from_bytes(self.read_block(address, length), 'little')

    def read_block(self, address: int, length: int) -> bytes:
        """
        Read bytes of the control table.

        Raises
        ------
        ArmProtocolError
            If the answer has another length.
        ArmError
            If the servo does not answer, refuses, or the port is gone.
        """
        data: list[int] = []

        # Not the SDK's readTxRx, which takes the CRC of a short answer for values.
        query = [0, 0, 0, 0, self._servo_id, 7, 0, _READ]
        query += [*address.to_bytes(2, 'little'), *length.to_bytes(2, 'little'), 0, 0]

        def ask() -> tuple[int, int]:
            nonlocal data
            packet, result, error = self._packets.txRxPacket(self.handler, list(query))
            if result == 0:
                data = packet[9 : 7 + int.from_bytes(packet[5:7], 'little') - 2]
            return result, error

        self._ask(f'a query of address {address}', ask)
        if len(data) != length:
            raise ArmProtocolError(
                f'servo {self._servo_id} on port {self.port} answered a query of address '
                f'{address} with {len(data)} bytes instead of {length}'
            )
        return bytes(data)

    def write(self, address: int, length: int, value: int) -> None:
        """Write one value of the control table."""
        data = list(value.to_bytes(length, 'little', signed=value < 0))
        self._ask(
            f'{value} for address {address}',
            lambda: self._packets.writeTxRx(self.handler, self._servo_id, address, length, data),
        )

    def restart(self) -> None:
        """Restart the servo, which ends a hardware error, and wait for it."""
        self._ask('a restart', lambda: self._packets.reboot(self.handler, self._servo_id))
        time.sleep(_RESTART_TIME)

    def close(self) -> None:
        """Close the port. Idempotent."""
        self._serial.close()

    def _ask(self, what: str, ask: Callable[[], tuple[int, int]]) -> None:
        """Repeat a question until it is answered."""
        deadline = time.monotonic() + self._response_timeout
        while True:
            try:
                result, error = ask()
            except (OSError, TypeError, termios.error) as fault:  # pyserial closed: TypeError
                raise ArmConnectionError(
                    f'connection on port {self.port} is lost: {fault}'
                ) from fault
            except (IndexError, ValueError) as fault:  # the SDK stumbled over a broken packet
                result, error = -1, 0
                reason = f'broken packet ({fault})'
            else:
                reason = self._packets.getTxRxResult(result)
            self.handler.is_using = False
            if result == 0:
                break
            if time.monotonic() > deadline:
                raise ArmTimeoutError(
                    f'servo {self._servo_id} on port {self.port} did not answer {what} within '
                    f'{self._response_timeout:g} s: {reason}; is it switched on, and are '
                    'servo_id and baud_rate right?'
                )
        if error & ~_ALERT:
            raise ArmProtocolError(
                f'servo {self._servo_id} on port {self.port} refused {what}: '
                f'{self._packets.getRxPacketError(error & ~_ALERT)}'
            )


def _handler(sdk: Any, port: Any, baud_rate: int) -> Any:
    """Make a port handler of the SDK's on an opened port; it waits and ends in endless noise."""

    class Handler(sdk.PortHandler):  # type: ignore[misc] # the SDK has no types
        def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
            if self.packet_timeout and self.getTimeSinceStart() > self.packet_timeout:
                return b''
            data: bytes = port.read(length)
            return data

        def getCurrentTime(self) -> float:  # noqa: N802 - the SDK's name
            return time.monotonic() * 1e3

    handler = Handler(port.port)
    handler.ser = port
    handler.is_open = True
    handler.baudrate = baud_rate
    handler.tx_time_per_byte = 1e4 / baud_rate
    return handler
