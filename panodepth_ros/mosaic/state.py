"""
A sweep under way as a file, so that a mosaicer that was killed goes on where it stopped.

The file is a journal: a record of all there is, then one for what came since, and so on, each with
a checksum. A record that was not written to its end is as if it had not been begun; one that is
damaged before another makes the whole file useless. When what is out of date takes more room than
what is not, the file is written anew and replaced as a whole. It holds plain arrays and JSON;
nothing in it is executed. It is read only if it is no larger than it can be.
"""

from __future__ import annotations

import json
import os
import struct
import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import Sweep
from panodepth_ros.mosaic.view import Mark, by_column

#: A state that is older is not taken up: much may have changed [s].
OLDEST = 120.0
#: With what a file begins.
MAGIC = b'PANOSWP3'
#: Of a record: how long it is, and how long its text; CRC-32 of all that follows; CRC-32 of these.
HEADER = struct.Struct('<IIII')
#: Bytes that a state has besides its panoramas, at most, and that may be out of date in any case.
_OVERHEAD, _SLACK = 1_000_000, 2_000_000
#: Arrays of which a record holds what was added.
_GROWING = ('light.azimuths', 'light.ratios', 'light.changes')

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """
    A led sweep under way.

    Attributes
    ----------
    azimuth : float
        Where the arm stood when the next step was asked for [rad].
    sources : tuple of str
        Who told so.
    age : float
        How old the state is [s].
    description : str
        Rig and camera in words, to be compared.
    arrays : dict of ndarray
        What :meth:`Sweep.arrays` gave; empty before the first frame.
    """

    azimuth: float
    sources: tuple[str, ...]
    age: float
    description: str
    arrays: Mapping[str, npt.NDArray[Any]]

    def sweep(self, rig: Rig, camera: PinholeCamera) -> Sweep | None:
        """
        Return the sweep, None before its first frame.

        Raises
        ------
        ValueError
            If it is of another rig or camera, too old, or damaged.
        """
        if not -1.0 <= self.age <= OLDEST:
            raise ValueError(f'it is {self.age:.0f} s old; allowed: up to {OLDEST:.0f}')
        if not self.arrays:
            return None
        if self.description != _description(rig, camera):
            raise ValueError('it is of another rig or camera')
        return Sweep.restored(rig, camera, self.arrays)


class SweepJournal:
    """
    Writes the states of one sweep after the other into a file.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: int | None = None
        self._sweep: Sweep | None = None
        self._mark: Mark | None = None
        self._known: Arrays = {}  # what the file holds, and need not be told again
        self._whole = self._size = 0

    def write(self, sweep: Sweep | None, azimuth: float, sources: tuple[str, ...] = ()) -> None:
        """
        Add a state, as a whole or not at all.

        Parameters
        ----------
        sweep : Sweep or None
            None before the first frame.
        azimuth : float
            Where the arm stands, or stood when it was asked for a step [rad].
        sources : tuple of str
            Who told so.

        Raises
        ------
        OSError
            If it cannot be written. The next write begins the file anew.
        """
        about = {'time': time.time(), 'azimuth': azimuth, 'sources': list(sources)}
        if self._goes_on(sweep):
            record = self._record(sweep, about)
            if self._size + len(record) <= 2 * self._whole + _SLACK:
                self._append(record)
                return
        self._begin(sweep, about)

    def remove(self) -> None:
        """Remove the file: the sweep has ended."""
        self._close()
        self._path.unlink(missing_ok=True)

    def _goes_on(self, sweep: Sweep | None) -> bool:
        """Whether the file that is open is still there, and of this sweep."""
        if self._file is None or sweep is not self._sweep:
            return False
        try:
            return os.path.samestat(os.fstat(self._file), os.stat(self._path))
        except FileNotFoundError:
            return False

    def _begin(self, sweep: Sweep | None, about: dict[str, Any]) -> None:
        """Write a file with all there is, and put it in the place of the one before."""
        self._close()
        self._sweep = sweep
        about['description'] = _description(sweep.rig, sweep.camera) if sweep is not None else ''
        whole = MAGIC + self._record(sweep, about)
        fresh = self._path.with_name(f'{self._path.name}.new')
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
        self._file = os.open(fresh, flags, 0o600)
        self._append(whole)
        os.replace(fresh, self._path)
        self._whole = len(whole)

    def _record(self, sweep: Sweep | None, about: dict[str, Any]) -> bytes:
        """Put into a record what the file does not hold yet."""
        arrays = sweep.arrays(self._mark) if sweep is not None else {}
        self._mark = sweep.mark() if sweep is not None else None
        news = {name: a for name, a in arrays.items() if self._known.get(name) is not a}
        self._known = arrays
        about['arrays'] = [(name, a.dtype.str, a.shape) for name, a in news.items()]
        text = json.dumps(about).encode()
        return sealed(b''.join((text, *(array.tobytes() for array in news.values()))), len(text))

    def _append(self, data: bytes) -> None:
        assert self._file is not None
        try:
            if os.write(self._file, data) != len(data):
                raise OSError(f'{self._path} could not be written to its end')
        except OSError:
            self._close()
            raise
        self._size += len(data)

    def _close(self) -> None:
        if self._file is not None:
            os.close(self._file)
        self._file, self._sweep, self._mark, self._known = None, None, None, {}
        self._whole = self._size = 0


def sealed(body: bytes, text: int) -> bytes:
    """Make a record of what begins with so many bytes of text."""
    about = struct.pack('<III', len(body), text, zlib.crc32(body))
    return about + struct.pack('<I', zlib.crc32(about)) + body


def load_state(path: Path, rig: Rig, camera: PinholeCamera) -> State | None:
    """
    Read a state, None if there is none.

    Raises
    ------
    ValueError
        If the file is no state, damaged, or larger than one of this rig and camera.
    OSError
        If it cannot be read.
    """
    views = 3 + 2 * len(rig.further_offsets)
    frames = 12 * camera.height * camera.width  # first frames, and small ones of the light
    most = 2 * (views * rig.columns * (6 * camera.height + 8) + frames + _OVERHEAD) + _SLACK
    try:
        with path.open('rb') as file:
            about_file = os.fstat(file.fileno())
            if about_file.st_uid != os.geteuid():
                raise ValueError(f'{path} is of another user; allowed: a state of our own')
            if about_file.st_size > most:
                raise ValueError(f'{path} has {about_file.st_size} bytes; allowed: up to {most}')
            data = file.read(most)
        if not data.startswith(MAGIC):
            raise ValueError(f'{path} is no state of a sweep, or of another version')
        about: dict[str, Any] = {}
        arrays: Arrays = {}
        for told, news in _records(data):
            about |= told
            _merge(arrays, news)
        return State(
            azimuth=float(about['azimuth']),
            sources=tuple(map(str, about['sources'])),
            age=time.time() - float(about['time']),
            description=str(about['description']),
            arrays=arrays,
        )
    except FileNotFoundError:
        return None
    except (ValueError, OSError):
        raise
    except Exception as error:  # of json, NumPy, struct …
        raise ValueError(f'{path} is no state of a sweep: {error}') from error


def _records(data: bytes) -> Iterator[tuple[dict[str, Any], Arrays]]:
    """
    Text and arrays of every record.

    Raises
    ------
    ValueError
        If one is damaged, or there is none. One that was not written to its end is as if it had
        not been begun; that it was not, only a length that is known to be true can tell.
    """
    at, count = len(MAGIC), 0
    while at + HEADER.size <= len(data):
        length, text, crc, own_crc = HEADER.unpack_from(data, at)
        sound = zlib.crc32(data[at : at + HEADER.size - 4]) == own_crc
        at += HEADER.size
        body = data[at : at + length]
        at += length
        if sound and len(body) < length:
            break
        if not sound or zlib.crc32(body) != crc:
            raise ValueError('the state of the sweep is damaged')
        about = json.loads(body[:text])
        arrays = {}
        place = text
        for name, kind, shape in about.pop('arrays'):
            if kind not in ('|u1', '<i8', '<f8'):
                raise ValueError(f'{name} of the state is of {kind}')
            size = int(np.prod(shape, dtype=np.int64))
            arrays[name] = np.frombuffer(body, kind, size, place).reshape(shape)
            place += arrays[name].nbytes
        count += 1
        yield about, arrays
    if not count:
        raise ValueError('the state of the sweep ends before it begins')


def _merge(arrays: Arrays, news: Arrays) -> None:
    """Bring arrays up to date by those of the next record."""
    columns = news.pop('columns', None)
    for name, array in news.items():
        old = arrays.get(name)
        if columns is not None and old is not None and by_column(name):
            part = np.s_[:, columns] if old.ndim > 1 else np.s_[columns]
            if old[part].shape != array.shape or old.dtype != array.dtype:
                raise ValueError(f'{name} of the state is not as it was before')
            old[part] = array
        elif old is not None and name in _GROWING:
            arrays[name] = np.concatenate([old, array])
        else:
            arrays[name] = np.array(array)


def _description(rig: Rig, camera: PinholeCamera) -> str:
    mounted = replace(camera, mounting=rig.mounting)
    return json.dumps([asdict(rig), asdict(mounted)], default=repr)
