"""
What a source of frames is: cameras, files, streams and the simulated room all look like this.

A source is opened, read and closed by one thread. It shares an event with its owner: once that
is set, a read that waits ends soon with :class:`SourceClosedError`.
"""

from __future__ import annotations

import math
import threading
import time
from typing import NamedTuple, Protocol

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]


class SourceError(RuntimeError):
    """A source cannot be opened or read, and trying again would not help."""


class SourceLostError(SourceError):
    """A source stopped delivering; opening it again may help."""


class SourceClosedError(SourceError):
    """The owner asked for the end."""


class Frame(NamedTuple):
    """
    One picture.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W, 3) or (H, W)
        Blue, green, red; or grey.
    stamp : float
        Start of the exposure as ``time.monotonic()`` [s], or the best that the source knows.
    """

    image: Image
    stamp: float


class FrameSource(Protocol):
    """A place where frames come from; see the module for whose thread does what."""

    @property
    def name(self) -> str:
        """What people call it: a device, a file, a URL."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its frames [px]."""

    @property
    def skipped(self) -> int:
        """Frames of its schedule it did not deliver, because reading was too slow."""

    def read(self) -> Frame | None:
        """
        Wait for the next frame.

        Returns
        -------
        Frame or None
            None after the last frame of a source that has an end.

        Raises
        ------
        SourceLostError
            If nothing came in time, or the device went away.
        SourceClosedError
            If the event was set.
        SourceError
            If the source is broken for good.
        """

    def close(self) -> None:
        """Let go of the device. Idempotent."""


class Schedule:
    """
    Equally spaced times that do not drift.

    Parameters
    ----------
    rate : float
        Times per second [Hz].
    stop : threading.Event
        Ends the waiting.
    skips : bool
        Whether times that have passed are left out, as a free-running camera does, or handed
        out late, as a file is played.
    """

    def __init__(self, rate: float, stop: threading.Event, *, skips: bool) -> None:
        self._period = 1.0 / rate
        self._stop = stop
        self._skips = skips
        self._next = time.monotonic()
        self.skipped = 0

    def wait(self) -> float:
        """
        Wait for the next time and return it [s of ``time.monotonic()``].

        Raises
        ------
        SourceClosedError
            If the event was set.
        """
        now = time.monotonic()
        if now > self._next + self._period:
            if self._skips:
                late = math.floor((now - self._next) / self._period)
                self.skipped += late
                self._next += late * self._period
            else:
                self._next = now
        if self._stop.wait(max(self._next - time.monotonic(), 0.0)):
            raise SourceClosedError('the source was closed')
        moment = self._next
        self._next += self._period
        return moment


def check_size(image: Image, size: tuple[int, int], name: str) -> None:
    """
    Refuse a frame of another size.

    Parameters
    ----------
    image : ndarray, shape (H, W) or (H, W, 3)
        The frame.
    size : (int, int)
        Wanted width and height [px]; 0 accepts any.
    name : str
        The source.

    Raises
    ------
    SourceError
        Names the source and both sizes.
    """
    height, width = image.shape[:2]
    if any(want not in (0, got) for want, got in zip(size, (width, height), strict=True)):
        raise SourceError(
            f'{name} gives frames of {width} by {height} pixels; '
            f'image_width and image_height ask for {size[0]} by {size[1]}'
        )


def to_grey(image: Image) -> Image:
    """Grey of a colour frame, shape (H, W, 3) to (H, W); a grey one as it is."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
