"""A V4L2 camera without a kernel: programs that preload its library see it."""

from __future__ import annotations

import mmap
import os
import shutil
import struct
import subprocess
from pathlib import Path

#: What the file of a device holds, in the order of v4l2_device.c.
STATE: tuple[str, ...] = (
    'plugged',
    'width',
    'height',
    'light',
    'colour',
    'period_us',
    'latency_us',
    'clock',
    'frames',
)
CONTROLS: tuple[str, ...] = (
    'auto_exposure',
    'exposure',
    'auto_white_balance',
    'white_balance',
    'autofocus',
    'focus',
    'gain',
    'autogain',
)
WORKS, ABSENT, REFUSES, IGNORES = range(4)
MONOTONIC, REALTIME, NO_CLOCK = range(3)
_STAMPS, _STAMPS_AT, _SIZE = 64, 256, 1024

#: A UVC camera in a room: it chooses everything itself, and has no automatic gain apart.
_INITIAL = {
    'plugged': 1,
    'width': 64,
    'height': 48,
    'light': 400,
    'colour': 4000,
    'period_us': 20_000,
    'latency_us': 0,
    'clock': MONOTONIC,
    'auto_exposure': 3,
    'exposure': 30,
    'auto_white_balance': 1,
    'white_balance': 6000,
    'autofocus': 1,
    'focus': 100,
}


class Device:
    """The camera as the room and its plug see it: every number of the file is an attribute."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.write_bytes(bytes(_SIZE))
        with path.open('r+b') as file:
            self._memory = mmap.mmap(file.fileno(), _SIZE)
        for name, value in _INITIAL.items():
            self[name] = value
        self.behave('autogain', ABSENT)

    def __getitem__(self, name: str) -> int:
        return int(struct.unpack_from('=i', self._memory, self._place(name))[0])

    def __setitem__(self, name: str, value: int) -> None:
        struct.pack_into('=i', self._memory, self._place(name), value)

    @staticmethod
    def _place(name: str) -> int:
        return 4 * (STATE + CONTROLS).index(name)

    def behave(self, control: str, kind: int) -> None:
        """Say what a control does when it is set."""
        place = len(STATE) + len(CONTROLS) + CONTROLS.index(control)
        struct.pack_into('=i', self._memory, 4 * place, kind)

    def stamps(self) -> list[float]:
        """Return when the last frames were exposed [s of ``time.monotonic()``]."""
        known = min(self['frames'], _STAMPS)
        return [k / 1e6 for k in struct.unpack_from(f'={known}q', self._memory, _STAMPS_AT)]

    def unplug(self) -> None:
        """Take it away."""
        self.path.rename(self.path.with_suffix('.away'))
        self['plugged'] = 0

    def plug_in(self) -> None:
        """Bring it back, as a USB camera comes: it has forgotten what it was told."""
        for control in CONTROLS:
            self[control] = _INITIAL.get(control, 0)
        self['plugged'] = 1
        self.path.with_suffix('.away').rename(self.path)

    def environment(self, library: Path) -> dict[str, str]:
        """Return what a program needs in its environment to see it, besides a built library."""
        return {'TEST_V4L2_DEVICE': os.path.realpath(self.path), 'LD_PRELOAD': str(library)}

    def close(self) -> None:
        """Let go of the file."""
        self._memory.close()


def build_library(folder: Path) -> Path | None:
    """Compile what programs have to preload; None if there is no C compiler."""
    compiler = shutil.which('cc')
    if compiler is None:
        return None
    library = folder / 'v4l2_device.so'
    source = Path(__file__).with_suffix('.c')
    flags = ['-O1', '-Wall', '-Wextra', '-Werror', '-shared', '-fPIC']
    subprocess.run([compiler, *flags, '-o', library, source, '-ldl', '-lpthread'], check=True)
    return library
