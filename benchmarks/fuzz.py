"""
Random and mutated bytes through the parsers of all that comes from outside: no crash, no growth.

    python -m benchmarks.fuzz --inputs 1000000
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

from benchmarks import fuzz_files as files
from benchmarks.report import table
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


class Kind(NamedTuple):
    """
    What is fuzzed.

    Attributes
    ----------
    name : str
        For the table.
    share : float
        Of all inputs; what takes milliseconds has fewer.
    check : callable
        Raises if an input does harm.
    seeds : tuple of bytes
        Good ones.
    """

    name: str
    share: float
    check: Callable[[bytes], None]
    seeds: tuple[bytes, ...]


def kinds(folder: Path) -> list[Kind]:
    """Return all kinds; files are written into a folder."""
    memory, state = Memory(), files.state(folder)
    bus = impatient_bus(memory)
    made = [
        Kind('GRBL', 0.4, partial(check_grbl, grbl.LineAssembler()), GRBL),
        Kind('Dynamixel', 0.3, partial(check_dynamixel, bus, memory), DYNAMIXEL),
        Kind('compressed frames', 0.2, files.check_frame, files.frames()),
        Kind(
            'calibration files',
            0.03,
            partial(files.check_calibration, folder),
            (files.calibration(folder),),
        ),
        Kind('state files', 0.02, partial(files.check_state, folder), (state,)),
    ]
    for number, name in enumerate(('first', 'second', 'third')):

        def check(data: bytes, number: int = number) -> None:
            files.check_state(folder, files.with_record(state, number, data))

        seed = files.records(state)[number][1]
        made.append(Kind(f'{name} record of state files', 0.01, check, (seed,)))
    for storage, suffix in (('mcap', '.mcap'), ('sqlite3', '.db3')):
        check_bag = partial(files.check_bag, folder / f'fuzzed{suffix}')
        made.append(Kind(f'bags, {storage}', 0.01, check_bag, (files.bag(folder, storage),)))
    return made


@contextmanager
def silence() -> Iterator[None]:
    """Let libraries in C not complain of each picture."""
    stderr, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nothing)


def main() -> None:
    """Run all kinds and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--inputs', type=int, default=1_000_000, help='of all kinds')
    parser.add_argument('--seed', type=int, default=0)
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for kind in kinds(Path(folder)):
            inputs = round(given.inputs * kind.share)
            with silence():
                slowest = run(inputs, kind.check, kind.seeds, given.seed)
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            rows.append([kind.name, str(inputs), f'{slowest * 1e3:.1f}', f'{peak:.0f}'])
    print(table(['', 'inputs', 'slowest ms', 'peak memory so far MB'], rows))


if __name__ == '__main__':
    main()
