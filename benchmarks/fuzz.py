"""
Random and mutated bytes through the parsers of what controllers send: no crash, no growth.

    python -m benchmarks.fuzz --inputs 1000000
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial

from panodepth_ros.arm import grbl
from panodepth_ros.arm.dynamixel_bus import DynamixelBus
from panodepth_ros.arm.errors import ArmError
from panodepth_ros.arm.simulated_dynamixel import crc16

GRBL = (
    b'<Idle|MPos:41.709,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n',
    b'<Hold:1|WPos:-1.0000,0.0000,0.0000|F:600>\r\nok\r\n',
    b"error:33\r\nALARM:1\r\n$100=25.000\r\n[MSG:x]\r\nGrbl 1.1h ['$' for help]\r\n",
)
_ANSWER = bytes.fromhex('FFFFFD000112005500')
DYNAMIXEL = (
    _ANSWER + bytes(16),
    _ANSWER + bytes.fromhex('01 02 0000 0000 0F000000 FFFFFDFD') + bytes(2),
    bytes.fromhex('FFFFFD0001040055800000'),
)
#: What a line assembler may keep [bytes].
_LIMIT = 600


class Memory:
    """A port that answers every packet with given bytes and then is silent."""

    def __init__(self) -> None:
        self.port = 'memory'
        self.answer = b''
        self._rest = b''

    def write(self, data: bytes) -> int:
        """Take a packet."""
        self._rest = self.answer
        return len(data)

    def read(self, length: int) -> bytes:
        """Give bytes of the answer."""
        data, self._rest = self._rest[:length], self._rest[length:]
        return data

    def is_silent(self) -> bool:
        """Whether nothing is left to read."""
        return not self._rest

    def reset_input_buffer(self) -> None:
        """Forget the rest."""
        self._rest = b''

    def close(self) -> None:
        """Nothing to close."""


def mutated(random_: random.Random, seeds: tuple[bytes, ...]) -> bytes:
    """Return a known answer with bytes lost, doubled, changed; or plain noise."""
    data = bytearray(random_.choice(seeds))
    if random_.random() < 0.1:
        return random_.randbytes(random_.randrange(1, 64))
    for _ in range(random_.randrange(1, 5)):
        at = random_.randrange(len(data)) if data else 0
        kind = random_.randrange(3)
        if kind == 0:
            del data[at : at + random_.randrange(1, 4)]
        elif kind == 1:
            data[at:at] = data[at : at + 8]
        elif data:
            data[at] = random_.randrange(256)
    return bytes(data)


def sealed(data: bytes) -> bytes:
    """Return a servo's packet with the length and the CRC that its bytes ask for."""
    if len(data) < 9:
        return data
    data = data[:5] + (len(data) - 7).to_bytes(2, 'little') + data[7:-2]
    return data + crc16(data).to_bytes(2, 'little')


def check_grbl(assembler: grbl.LineAssembler, data: bytes) -> None:
    """Parse what a stream makes of some bytes."""
    for line in assembler.feed(data):
        grbl.parse(line)
    if len(assembler.rest) > _LIMIT:
        raise AssertionError(f'the line assembler keeps {len(assembler.rest)} bytes')


def check_dynamixel(bus: DynamixelBus, memory: Memory, data: bytes) -> None:
    """Ask a servo that answers with some bytes, as they are and with a right CRC."""
    for answer in (data, sealed(data)):
        memory.answer = answer
        with suppress(ArmError):
            bus.read_block(122, 14)


def run(inputs: int, check: Callable[[bytes], None], seeds: tuple[bytes, ...], seed: int) -> float:
    """Check many inputs; return how long the slowest took [s]."""
    random_ = random.Random(seed)
    slowest = 0.0
    for _ in range(inputs):
        data = mutated(random_, seeds)
        begin = time.perf_counter()
        try:
            check(data)
        except Exception as error:
            raise AssertionError(f'input {data!r}') from error
        slowest = max(slowest, time.perf_counter() - begin)
    return slowest


def impatient_bus(memory: Memory) -> DynamixelBus:
    """Make a bus on a port in memory, which takes silence for a timeout at once."""
    bus = DynamixelBus('memory', 57600, 1, 0.0, open_port=lambda *_, **__: memory)
    bus.handler.setPacketTimeout = bus.handler.setPacketTimeoutMillis = lambda _: None
    bus.handler.isPacketTimeout = memory.is_silent
    return bus


def main() -> None:
    """Run both and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--inputs', type=int, default=1_000_000, help='of each kind')
    parser.add_argument('--seed', type=int, default=0)
    given = parser.parse_args()
    memory = Memory()
    for name, check, seeds in (
        ('GRBL', partial(check_grbl, grbl.LineAssembler()), GRBL),
        ('Dynamixel', partial(check_dynamixel, impatient_bus(memory), memory), DYNAMIXEL),
    ):
        slowest = run(given.inputs, check, seeds, given.seed)
        print(f'{name}: {given.inputs} inputs, slowest {slowest * 1e3:.2f} ms')


if __name__ == '__main__':
    main()
