"""
The true motion of the simulated arm, in a small memory-mapped file beside its terminal.

A real camera sees by light where the arm stands, whatever the controller believes. The simulated
camera reads this file instead. It holds the last pieces of motion, each with constant
acceleration, as functions of ``time.monotonic()``, which is the same clock in all processes of a
machine; pieces may lie in the future, because a planned motion is written when it starts.

Layout, little-endian: magic (8 bytes), CRC-32 of all that follows, number of pieces, ended flag
(4 bytes each), then per piece begin [s], azimuth [rad], velocity [rad/s] and acceleration
[rad/s²] as doubles. A reader that catches a half-written record sees it by the CRC and reads
again.
"""

from __future__ import annotations

import bisect
import fcntl
import math
import mmap
import os
import struct
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

MAGIC = b'PANOARM1'
CAPACITY = 128
_HEADER = struct.Struct('<8sIII')
_CHECKED_FROM = 12  # the CRC covers all that comes after it
_PIECE = struct.Struct('<4d')
_SIZE = _HEADER.size + CAPACITY * _PIECE.size
#: A record is written in microseconds; a writer that takes this long [s] died while writing.
_READ_TIMEOUT = 0.5


class TruthError(RuntimeError):
    """The file of the true motion is missing, in use, of another format, or forgot that time."""


class Piece(NamedTuple):
    """
    A piece of motion with constant acceleration, valid until the next piece begins.

    Attributes
    ----------
    begin : float
        Begin on ``time.monotonic()`` [s]; −inf for where the arm stood at first.
    azimuth, velocity, acceleration : float
        At the begin, counter-clockwise positive, not wrapped [rad, rad/s, rad/s²].
    """

    begin: float
    azimuth: float
    velocity: float = 0.0
    acceleration: float = 0.0

    def at(self, moment: float) -> tuple[float, float]:
        """Azimuth [rad] and velocity [rad/s] at a time [s] not before the begin."""
        if self.velocity == 0.0 and self.acceleration == 0.0:
            return self.azimuth, 0.0
        elapsed = moment - self.begin
        velocity = self.velocity + self.acceleration * elapsed
        return self.azimuth + 0.5 * (self.velocity + velocity) * elapsed, velocity


def truth_path(link: str | os.PathLike[str]) -> Path:
    """Path of the truth file of the simulated arm whose terminal is linked at ``link``."""
    return Path(f'{os.fspath(link)}.truth')


class TruthWriter:
    """
    Writes the true motion; one writer at a time owns a file.

    Parameters
    ----------
    path : path-like
        The file; a left-over of a writer that died is taken over.
    azimuth : float
        Where the arm stands at first [rad].

    Raises
    ------
    TruthError
        If another writer owns the file or the file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], azimuth: float = 0.0) -> None:
        self._path = Path(path)
        try:
            self._file = open(self._path, 'a+b')  # noqa: SIM115 - held until close
        except OSError as error:
            raise TruthError(f'truth file {path} cannot be written: {error.strerror}') from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise TruthError(f'truth file {path} is in use by another simulated arm') from error
        self._file.truncate(_SIZE)
        self._map = mmap.mmap(self._file.fileno(), _SIZE)
        self.write([Piece(-math.inf, azimuth)])

    def write(self, pieces: Sequence[Piece]) -> None:
        """Replace all pieces, oldest first; of more than ``CAPACITY`` the last are kept."""
        self._write(pieces[-CAPACITY:], ended=False)

    def close(self) -> None:
        """Remove the file; readers that hold it keep the last motion. Idempotent."""
        if self._file.closed:
            return
        count = _HEADER.unpack_from(self._map)[2]
        pieces = [
            Piece(*_PIECE.unpack_from(self._map, _HEADER.size + i * _PIECE.size))
            for i in range(count)
        ]
        self._write(pieces, ended=True)
        self._path.unlink(missing_ok=True)
        self._map.close()
        self._file.close()

    def _write(self, pieces: Sequence[Piece], *, ended: bool) -> None:
        body = struct.pack('<II', len(pieces), ended)
        body += b''.join(_PIECE.pack(*piece) for piece in pieces)
        self._map[: _CHECKED_FROM + len(body)] = MAGIC + struct.pack('<I', zlib.crc32(body)) + body


class TruthReader:
    """
    Reads the true motion from any process.

    Follows the file when the simulated arm is started anew. After the arm's program has ended
    the arm stands, or moves on, as last written.

    Parameters
    ----------
    path : path-like
        The truth file, see :func:`truth_path`.

    Raises
    ------
    TruthError
        If the file is missing or is not a truth file.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        self._map = self._open()

    def azimuth(self, moment: float) -> float:
        """
        Where the arm truly points.

        Parameters
        ----------
        moment : float
            ``time.monotonic()`` [s], now, in the recent past or in the planned future.

        Returns
        -------
        float
            Azimuth [rad], counter-clockwise positive, not wrapped.

        Raises
        ------
        TruthError
            If the motion at that time is no longer kept, or the file is damaged.
        """
        pieces = self._read()
        index = bisect.bisect_right(pieces, moment, key=lambda piece: piece.begin) - 1
        if index < 0:
            raise TruthError(
                f'truth file {self._path} knows nothing of monotonic time {moment:.3f} s; '
                f'its memory begins at {pieces[0].begin:.3f} s'
            )
        return pieces[index].at(moment)[0]

    def close(self) -> None:
        """Let go of the file. Idempotent."""
        self._map.close()

    def _open(self) -> mmap.mmap:
        try:
            with open(self._path, 'rb') as file:
                found = file.read(len(MAGIC))
                if found != MAGIC or os.fstat(file.fileno()).st_size != _SIZE:
                    raise TruthError(
                        f'{self._path} is not a truth file of a simulated arm: it begins with '
                        f'{found!r}, not {MAGIC!r}, or has another size than {_SIZE} bytes'
                    )
                return mmap.mmap(file.fileno(), _SIZE, prot=mmap.PROT_READ)
        except OSError as error:
            raise TruthError(
                f'truth file {self._path} of the simulated arm cannot be read: {error.strerror}'
            ) from error

    def _read(self) -> list[Piece]:
        deadline = time.monotonic() + _READ_TIMEOUT
        while True:
            data = self._map[:]
            _, crc, count, ended = _HEADER.unpack_from(data)
            end = _HEADER.size + count * _PIECE.size
            if 0 < count <= CAPACITY and zlib.crc32(data[_CHECKED_FROM:end]) == crc:
                if ended and self._path.exists():
                    self._map.close()
                    self._map = self._open()
                    continue
                return [Piece(*values) for values in _PIECE.iter_unpack(data[_HEADER.size : end])]
            if time.monotonic() > deadline:
                raise TruthError(f'truth file {self._path} is damaged: its CRC does not match')
