"""
A simulated Dynamixel servo of the X series with the arm it turns, fed bytes and times.

It speaks protocol 2.0 as documented: byte stuffing, CRC-16, status packets with their error
codes. Of the control table it has what an arm needs. Its profile is trapezoidal, its position
quantised to pulses; settings below address 64 refuse to change while the torque is on.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

from panodepth_ros.arm.motion import chain, state_at
from panodepth_ros.arm.truth import CAPACITY, Piece

_HEADER = b'\xff\xff\xfd'
_PULSE = 2.0 * math.pi / 4096.0
_VELOCITY = 0.229 * 2.0 * math.pi / 60.0
_ACCELERATION = 214.577 * 2.0 * math.pi / 3600.0
_FARTHEST = 1_048_575
_MOVING_THRESHOLD = 10 * _VELOCITY  # as delivered
_PING, _READ, _WRITE, _REBOOT, _STATUS = 1, 2, 3, 8, 0x55
_INSTRUCTION, _CRC, _LENGTH, _RANGE, _ACCESS = 2, 3, 5, 6, 7  # error numbers
_WRITABLE = {11: 1, 64: 1, 108: 4, 112: 4, 116: 4}


def crc16(data: bytes) -> int:
    """CRC-16 with the polynomial 0x8005, beginning with 0, as the protocol wants it."""
    crc = 0
    for value in data:
        crc ^= value << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class SimulatedServo:
    """
    The servo and the arm; usable where a SimulatedController is.

    Parameters
    ----------
    publish : callable, optional
        Called with the pieces of the true motion whenever they change.
    servo_id : int
        Its number on the bus.
    """

    def __init__(
        self,
        *,
        publish: Callable[[Sequence[Piece]], None] = lambda pieces: None,
        servo_id: int = 1,
    ) -> None:
        self._publish = publish
        self._servo_id = servo_id
        self._pieces = [Piece(-math.inf, 0.0)]
        self._forgotten = 0  # whole turns since the last start [pulses]
        self._received = bytearray()
        self._output = bytearray()
        self._table = bytearray(147)
        self._table[11] = 3  # position mode, as delivered

    def power_up(self, now: float) -> None:
        """Start anew: torque off, the turns forgotten; the encoder is absolute within a turn."""
        azimuth = self._position(now)
        turns = math.floor(azimuth / 4096.0 + 0.5) * 4096
        self._received.clear()
        self._table[64:] = bytes(len(self._table) - 64)
        self._forgotten += turns
        self._move([Piece(now, state_at(self._pieces, now)[0])])

    def raise_alarm(self, code: int, now: float) -> None:
        """Have a hardware error (bits of address 70): the motor is let go."""
        self._table[70] = code
        self._table[64] = 0
        self._move([Piece(now, state_at(self._pieces, now)[0])])

    def advance(self, now: float) -> None:
        """Do nothing: all that happens by itself is the motion."""

    def next_event(self) -> float:
        """Nothing happens by itself."""
        return math.inf

    def take_output(self) -> bytes:
        """Return what was sent since the last call."""
        output = bytes(self._output)
        self._output.clear()
        return output

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that arrive at the time ``now`` [s]."""
        self._received += data
        while (begin := self._received.find(_HEADER)) >= 0:
            del self._received[:begin]
            if len(self._received) < 7:
                return
            length = int.from_bytes(self._received[5:7], 'little')
            if length < 3 or length > 1024:
                del self._received[:3]
                continue
            if len(self._received) < 7 + length:
                return
            packet = bytes(self._received[: 7 + length])
            del self._received[: 7 + length]
            if packet[4] == self._servo_id:
                self._execute(packet, now)
        del self._received[:-2]

    def _execute(self, packet: bytes, now: float) -> None:
        if crc16(packet[:-2]) != int.from_bytes(packet[-2:], 'little'):
            self._answer(_CRC)
            return
        instruction = packet[7]
        parameters = packet[8:-2].replace(_HEADER + b'\xfd', _HEADER)
        if instruction == _PING:
            self._answer(0, struct.pack('<HB', 1060, 45))
        elif instruction == _READ and len(parameters) == 4:
            address, count = struct.unpack('<HH', parameters)
            if address + count > len(self._table):
                self._answer(_RANGE)
                return
            self._refresh(now)
            self._answer(0, bytes(self._table[address : address + count]))
        elif instruction == _WRITE and len(parameters) > 2:
            self._answer(
                self._write(int.from_bytes(parameters[:2], 'little'), parameters[2:], now)
            )
        elif instruction == _REBOOT:
            self._answer(0)
            self.power_up(now)
        else:
            self._answer(_INSTRUCTION)

    def _write(self, address: int, data: bytes, now: float) -> int:
        """Change the control table; return the error number."""
        if address not in _WRITABLE or (address < 64 and self._table[64]):
            return _ACCESS
        if len(data) != _WRITABLE[address]:
            return _LENGTH
        value = int.from_bytes(data, 'little', signed=len(data) == 4)
        if address == 64:
            if value and self._table[70]:
                return _INSTRUCTION
            self._goal(round(self._position(now)))
        if address == 116:
            if not self._table[64] or self._table[11] != 4 or abs(value) > _FARTHEST:
                return _RANGE
            self._goal(value)
            self._start(value, now)
        self._table[address : address + len(data)] = data
        return 0

    def _answer(self, error: int, parameters: bytes = b'') -> None:
        error |= 0x80 if self._table[70] else 0
        body = (bytes([_STATUS, error]) + parameters).replace(_HEADER, _HEADER + b'\xfd')
        packet = _HEADER + b'\x00' + struct.pack('<BH', self._servo_id, len(body) + 2) + body
        self._output += packet + struct.pack('<H', crc16(packet))

    # The motor.

    def _position(self, now: float) -> float:
        return state_at(self._pieces, now)[0] / _PULSE - self._forgotten

    def _goal(self, pulse: int) -> None:
        self._table[116:120] = struct.pack('<i', pulse)

    def _refresh(self, now: float) -> None:
        _, velocity = state_at(self._pieces, now)
        ongoing = now < self._pieces[-1].begin
        self._table[122] = abs(velocity) > _MOVING_THRESHOLD
        self._table[123] = 0x02 if ongoing else 0x01
        self._table[128:132] = struct.pack('<i', round(velocity / _VELOCITY))
        self._table[132:136] = struct.pack('<i', round(self._position(now)))

    def _start(self, pulse: int, now: float) -> None:
        here, velocity = state_at(self._pieces, now)
        end = (pulse + self._forgotten) * _PULSE
        acceleration = (int.from_bytes(self._table[108:112], 'little') or 32767) * _ACCELERATION
        speed = (int.from_bytes(self._table[112:116], 'little') or 300) * _VELOCITY
        pieces: list[Piece] = []
        way = end - here
        stopping = velocity * abs(velocity) / (2.0 * acceleration)
        if velocity and (way * velocity <= 0.0 or abs(way) < abs(stopping) - _PULSE):
            duration = abs(velocity) / acceleration  # it must turn back: brake first
            pieces = [Piece(now, here, velocity, -math.copysign(acceleration, velocity))]
            here, velocity, now = here + stopping, 0.0, now + duration
        moves = [(end, speed)] if end != here else []
        self._move(pieces + chain(now, here, velocity, moves, acceleration)[0])

    def _move(self, pieces: list[Piece]) -> None:
        past = [piece for piece in self._pieces if piece.begin < pieces[0].begin]
        self._pieces = (past + pieces)[-CAPACITY:]
        self._publish(self._pieces)
