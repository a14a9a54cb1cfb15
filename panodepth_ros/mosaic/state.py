"""
A sweep under way as a file, so that a mosaicer that was killed goes on where it stopped.

The file is an uncompressed ``.npz`` of plain arrays and one text, replaced as a whole; nothing in
it is executed. It is read only if it is no larger than it can be.
"""

from __future__ import annotations

import json
import os
import time
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import Sweep

#: A state that is older is not taken up: much may have changed [s].
OLDEST = 120.0
#: Bytes that a state has besides its panoramas, at most.
_OVERHEAD = 1_000_000
_FORMAT = 1


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


def save_state(
    path: Path, sweep: Sweep | None, azimuth: float, sources: tuple[str, ...] = ()
) -> None:
    """
    Write a state, as a whole or not at all.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    arrays = sweep.arrays() if sweep is not None else {}
    about = {
        'format': _FORMAT,
        'time': time.time(),
        'azimuth': azimuth,
        'sources': list(sources),
        'description': _description(sweep.rig, sweep.camera) if sweep is not None else '',
    }
    text = np.frombuffer(json.dumps(about).encode(), np.uint8)
    fresh = path.with_name(f'{path.name}.new')
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW
    with open(os.open(fresh, flags, 0o600), 'wb') as file:
        np.savez(file, about=text, **arrays)  # type: ignore[arg-type]
    os.replace(fresh, path)


def load_state(path: Path, rig: Rig, camera: PinholeCamera) -> State | None:
    """
    Read a state, None if there is none.

    Raises
    ------
    ValueError
        If the file is no state, or larger than one of this rig and camera.
    OSError
        If it cannot be read.
    """
    views = 3 + 2 * len(rig.further_offsets)
    seam = 12 * camera.height * camera.width  # first frames, and small ones of the light
    most = views * rig.columns * (6 * camera.height + 8) + seam + _OVERHEAD
    try:
        with path.open('rb') as file:
            about_file = os.fstat(file.fileno())
            if about_file.st_uid != os.geteuid():
                raise ValueError(f'{path} is of another user; allowed: a state of our own')
            size = about_file.st_size
            with zipfile.ZipFile(file) as members:
                size = max(size, sum(member.file_size for member in members.infolist()))
            if size > most:
                raise ValueError(f'{path} has {size} bytes; allowed: up to {most}')
            file.seek(0)
            with np.load(file, allow_pickle=False) as loaded:
                arrays = {name: np.asarray(loaded[name]) for name in loaded.files}
        about = json.loads(arrays.pop('about').tobytes())
        if about['format'] != _FORMAT:
            raise ValueError(f'{path} has format {about["format"]}; allowed: {_FORMAT}')
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
    except Exception as error:  # of zipfile, zlib, NumPy, tokenize, json …
        raise ValueError(f'{path} is no state of a sweep: {error}') from error


def _description(rig: Rig, camera: PinholeCamera) -> str:
    mounted = replace(camera, mounting=rig.mounting)
    return json.dumps([asdict(rig), asdict(mounted)], default=repr)
