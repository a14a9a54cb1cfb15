"""
V4L2 devices below OpenCV: whether one captures, and the controls it has.

OpenCV's properties do not say what a device has, and what they mean by automatic exposure
depends on its version. The kernel's requests say it, and do not change.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import struct
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from panodepth_ros.camera.source import SourceError, SourceLostError

# From linux/videodev2.h: VIDIOC_QUERYCAP, size of its struct v4l2_capability, where its fields
# capabilities and device_caps are, and bits of these.
_QUERY_CAPABILITIES = 0x80685600
_CAPABILITY_SIZE, _CAPABILITIES_AT = 104, 84
_CAPTURES, _STREAMS, _HAS_DEVICE_CAPABILITIES = 0x1, 0x04000000, 0x80000000
# VIDIOC_QUERYCTRL with V4L2_CTRL_FLAG_NEXT_CTRL, VIDIOC_QUERYMENU, _G_CTRL and _S_CTRL.
_QUERY_CONTROL, _QUERY_MENU, _GET, _SET = 0xC0445624, 0xC02C5625, 0xC008561B, 0xC008561C
_NEXT, _DISABLED = 0x80000000, 0x1
_CONTROL, _MENU, _VALUE = struct.Struct('=II32siiiiI8x'), struct.Struct('=II32s4x'), '=Ii'


class ControlError(SourceError):
    """A device does not have a control, or does not do what it is told."""


class Control(NamedTuple):
    """
    What a device says of a control.

    Attributes
    ----------
    name : str
        The driver's name of it.
    low, high, step : int
        The values it takes.
    """

    name: str
    low: int
    high: int
    step: int


def device_path(video_device: str) -> str:
    """Path of a video device given by number or path."""
    return f'/dev/video{video_device}' if video_device.isdecimal() else video_device


def _opened(path: str) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError as error:
        known = sorted(str(device) for device in Path('/dev').glob('video*'))
        there = f'there are {", ".join(known)}' if known else 'there is no video device at all'
        raise SourceLostError(f'video device {path} does not exist; {there}') from error
    except PermissionError as error:
        raise SourceError(
            f'video device {path} may not be opened; is the user in the group video?'
        ) from error
    except OSError as error:
        gone = error.errno in (errno.ENODEV, errno.ENXIO, errno.EBUSY, errno.EIO)
        kind = SourceLostError if gone else SourceError
        raise kind(f'video device {path} cannot be opened: {error.strerror}') from error


def check_device(path: str) -> None:
    """
    Make sure that a path is a V4L2 device that captures.

    Raises
    ------
    SourceLostError
        If it is not there, or in use: it may come.
    SourceError
        If it is something else.
    """
    handle = _opened(path)
    try:
        if not stat.S_ISCHR(os.fstat(handle).st_mode):
            raise SourceError(f'{path} is not a video device; for a file set source to video')
        answer = fcntl.ioctl(handle, _QUERY_CAPABILITIES, bytes(_CAPABILITY_SIZE))
    except OSError as error:
        raise SourceError(f'{path} is not a V4L2 video device: {error.strerror}') from error
    finally:
        os.close(handle)
    capabilities, of_device = struct.unpack_from('=II', answer, _CAPABILITIES_AT)
    if capabilities & _HAS_DEVICE_CAPABILITIES:
        capabilities = of_device
    if not (capabilities & _CAPTURES and capabilities & _STREAMS):
        raise SourceError(
            f'video device {path} does not capture pictures; '
            'cameras often have a second device for metadata: try the one before'
        )


class Controls:
    """
    The controls of a device, within a ``with`` block; pictures may be taken meanwhile.

    Parameters
    ----------
    path : str
        The device.

    Attributes
    ----------
    offered : dict
        What it has, by the numbers of linux/v4l2-controls.h.

    Raises
    ------
    SourceError
        If the device cannot be opened; a :class:`SourceLostError` if it is not there.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._handle = _opened(path)
        self.offered: dict[int, Control] = {}
        number = 0
        while True:
            try:
                answer = self._ask(_QUERY_CONTROL, _CONTROL.pack(number | _NEXT, *_NOTHING))
            except OSError:  # there is no further one
                return
            number, _, name, low, high, step, _, flags = _CONTROL.unpack(answer)
            if not flags & _DISABLED:
                self.offered[number] = Control(_text(name), low, high, max(step, 1))

    def __enter__(self) -> Controls:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        os.close(self._handle)

    def _ask(self, request: int, data: bytes) -> bytes:
        return fcntl.ioctl(self._handle, request, data)

    def names(self) -> str:
        """What the device offers, in words."""
        return ', '.join(control.name for control in self.offered.values()) or 'none at all'

    def has_choice(self, number: int, choice: int) -> bool:
        """Whether a menu has an entry; the numbers of entries need not be without gaps."""
        try:
            self._ask(_QUERY_MENU, _MENU.pack(number, choice, b''))
        except OSError:
            return False
        return True

    def get(self, number: int) -> int:
        """
        Value of a control that is offered.

        Raises
        ------
        SourceError
            If the device does not tell it.
        """
        try:
            answer = self._ask(_GET, struct.pack(_VALUE, number, 0))
        except OSError as error:
            raise self._failure(number, 'cannot be read', error) from error
        return int(struct.unpack(_VALUE, answer)[1])

    def set(self, number: int, value: int) -> None:
        """
        Set a control that is offered, and make sure that it is set.

        Raises
        ------
        SourceError
            If the device does not take it, or has another value afterwards.
        """
        try:
            self._ask(_SET, struct.pack(_VALUE, number, value))
        except OSError as error:
            raise self._failure(number, f'cannot be set to {value}', error) from error
        now = self.get(number)
        if abs(now - value) >= self.offered[number].step:
            raise ControlError(
                f'{self.offered[number].name} of video device {self._path} is {now} after it was '
                f'set to {value}'
            )

    def _failure(self, number: int, what: str, error: OSError) -> SourceError:
        kind = SourceLostError if error.errno == errno.ENODEV else ControlError
        name = self.offered[number].name
        return kind(f'{name} of video device {self._path} {what}: {error.strerror}')


_NOTHING = (0, b'', 0, 0, 0, 0, 0)


def _text(name: bytes) -> str:
    return name.partition(b'\0')[0].decode(errors='replace')
