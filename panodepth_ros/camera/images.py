"""Frames out of picture files."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import cv2

from panodepth_ros.camera.source import Frame, Image, Schedule, SourceError, check_size

SUFFIXES = ('.png', '.jpg', '.jpeg', '.bmp', '.pgm', '.ppm', '.tif', '.tiff', '.webp')


def image_files(pattern: str) -> list[Path]:
    """
    Picture files of a folder or a pattern, in the order of their names, numbers by value.

    Parameters
    ----------
    pattern : str
        A folder, or a path whose last part has wildcards (``frame_*.png``) or a number
        (``frame_%04d.png``).

    Raises
    ------
    SourceError
        If there are none.
    """
    path = Path(pattern)
    if path.is_dir():
        found = [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    elif number := re.search(r'%0?\d*d', path.name):
        before, after = path.name[: number.start()], path.name[number.end() :]
        exact = re.compile(rf'{re.escape(before)}\d+{re.escape(after)}')
        there = path.parent.iterdir() if path.parent.is_dir() else ()
        found = [file for file in there if exact.fullmatch(file.name)]
    else:
        found = list(path.parent.glob(path.name))
    if not found:
        raise SourceError(
            f'no images at {pattern}; allowed: a folder with {", ".join(SUFFIXES)} files, '
            'or a path with wildcards or a number such as %04d in its last part'
        )
    return sorted(found, key=_by_numbers)


def _by_numbers(file: Path) -> list[tuple[int, str]]:
    parts = re.split(r'(\d+)', file.name)
    return [(int(part), '') if part.isdecimal() else (0, part) for part in parts]


class ImageSequenceSource:
    """
    Picture files, shown once each.

    Stamps are the times at which the frames are handed out.

    Parameters
    ----------
    pattern : str
        See :func:`image_files`.
    size : (int, int)
        Width and height they must have [px]; 0 accepts any, but all must be of one size.
    framerate : float
        Pictures per second [Hz].
    grey : bool
        Whether frames are handed out grey.
    stop : threading.Event
        Ends a read.

    Raises
    ------
    SourceError
        If there are none, the first cannot be decoded, or is of another size.
    """

    def __init__(
        self,
        pattern: str,
        *,
        size: tuple[int, int],
        framerate: float,
        grey: bool,
        stop: threading.Event,
    ) -> None:
        self.name = pattern
        self.skipped = 0
        self._flags = cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR
        if framerate <= 0.0:
            raise SourceError(f'framerate is {framerate:g}; images need one above 0')
        self._files = image_files(pattern)
        first = self._decoded(self._files[0])
        check_size(first, size, f'image {self._files[0]}')
        self.size = (first.shape[1], first.shape[0])
        self._position = 0
        self._schedule = Schedule(framerate, stop, skips=False)

    def read(self) -> Frame | None:
        """See :meth:`panodepth_ros.camera.source.FrameSource.read`."""
        if self._position == len(self._files):
            return None
        file = self._files[self._position]
        image = self._decoded(file)
        check_size(image, self.size, f'image {file}')
        self._position += 1
        return Frame(image, self._schedule.wait())

    def close(self) -> None:
        """Nothing is held open."""

    def _decoded(self, file: Path) -> Image:
        image: Image | None = cv2.imread(str(file), self._flags)
        if image is None:
            raise SourceError(f'image {file} cannot be decoded')
        return image
