"""Frames through OpenCV: V4L2 devices, video files and network streams."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import cv2

from panodepth_ros.camera.automatics import Automatics
from panodepth_ros.camera.source import (
    Frame,
    Image,
    Schedule,
    SourceClosedError,
    SourceError,
    SourceLostError,
    check_size,
    to_grey,
)
from panodepth_ros.camera.v4l2 import check_device, device_path

#: usb_cam's names of pixel formats and V4L2's. ``auto`` leaves the choice to the driver.
PIXEL_FORMATS = {
    'auto': '',
    'yuyv2rgb': 'YUYV',
    'uyvy2rgb': 'UYVY',
    'mjpeg2rgb': 'MJPG',
    'mono8': 'GREY',
}

#: How soon a waiting read notices that it should end, and the least time between looks [s].
_SLICE, _PAUSE = 0.2, 0.002
#: How long to look for a frame that is there already [s].
_GLANCE = 1e-6
#: OpenCV 4.6 cannot wait for a while from Python: its reads block, by its own time limit.
_CAN_WAIT = hasattr(cv2.VideoCapture, 'waitAny')
#: A read that is done within this found its frame there [s].
_AT_ONCE = 1e-3
#: Which clock buffer times are of shows the first one that is younger than this by it [s].
_OLDEST_STAMP = 2.0


class BufferClock:
    """
    Tells times of a driver's buffers as ``time.monotonic()``.

    Most drivers take them from the monotonic clock, old ones from that of the day, some leave
    them 0. Once known, the clock stays: a frame that waited for long keeps its age.
    """

    def __init__(self) -> None:
        self._clock: Callable[[], float] | None = None

    def stamp(self, buffer_time: float) -> float | None:
        """Time of a buffer [s] by ``time.monotonic()``; None if its clock is unknown."""
        if self._clock is None:
            for clock in (time.monotonic, time.time):
                if 0.0 <= clock() - buffer_time < _OLDEST_STAMP:
                    self._clock = clock
        if self._clock is None:
            return None
        return time.monotonic() - max(self._clock() - buffer_time, 0.0)


class V4l2Source:
    """
    A camera of the machine.

    Stamps are the kernel's times of the buffers, which most drivers take at the start of the
    frame. Where they are of no known clock, the time of reading stands in, and frames that were
    waiting to be read are dropped: nobody can tell how old they are.

    Parameters
    ----------
    video_device : str
        Number, ``/dev/video0`` or ``/dev/v4l/by-id/...``.
    size : (int, int)
        Wanted width and height [px]; 0 leaves it to the driver.
    framerate : float
        Wanted rate [Hz]; 0 leaves it to the driver.
    pixel_format : str
        Key of :data:`PIXEL_FORMATS`.
    automatics : Automatics
        Tells the camera what it may decide; frames that it still decides about are dropped.
    frame_timeout : float
        Longest wait for a frame [s].
    stop : threading.Event
        Ends a read.

    Raises
    ------
    SourceError
        If it cannot be opened so; a :class:`SourceLostError` if it is not there.
    """

    def __init__(
        self,
        video_device: str,
        *,
        size: tuple[int, int],
        framerate: float,
        pixel_format: str,
        automatics: Automatics,
        frame_timeout: float,
        stop: threading.Event,
    ) -> None:
        self.name = device_path(video_device)
        self.skipped = 0
        self._stop = stop
        self._grey = pixel_format == 'mono8'
        self._automatics = automatics
        self._frame_timeout = frame_timeout
        self._clock = BufferClock()
        check_device(self.name)
        self._capture = cv2.VideoCapture(self.name, cv2.CAP_V4L2)
        try:
            if not self._capture.isOpened():
                raise SourceLostError(f'video device {self.name} cannot be opened; is it in use?')
            self._configure(size, framerate, pixel_format)
            self.size = (
                int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
                int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            )
            for axis, want, got in zip(('width', 'height'), size, self.size, strict=True):
                if want not in (0, got):
                    raise SourceError(
                        f'video device {self.name} gives {self.size[0]} by {self.size[1]} '
                        f'pixels; image_{axis} is {want}. v4l2-ctl --list-formats-ext shows '
                        'what it can'
                    )
            automatics.begin(self.name)
        except BaseException:
            self.close()
            raise

    def _configure(self, size: tuple[int, int], framerate: float, pixel_format: str) -> None:
        fourcc = PIXEL_FORMATS[pixel_format]
        if fourcc:
            code = cv2.VideoWriter.fourcc(*fourcc)
            self._capture.set(cv2.CAP_PROP_FOURCC, code)
            if int(self._capture.get(cv2.CAP_PROP_FOURCC)) != code:
                raise SourceError(
                    f'video device {self.name} has no pixel_format {pixel_format}; '
                    'v4l2-ctl --list-formats shows which it has'
                )
        for key, value in (
            (cv2.CAP_PROP_FRAME_WIDTH, size[0]),
            (cv2.CAP_PROP_FRAME_HEIGHT, size[1]),
            (cv2.CAP_PROP_FPS, framerate),
        ):
            if value:
                self._capture.set(key, value)

    def read(self) -> Frame:
        """See :meth:`panodepth_ros.camera.source.FrameSource.read`."""
        while True:
            frame = self._next()
            if frame is not None and self._automatics.admits(frame.stamp):
                return frame

    def _next(self) -> Frame | None:
        if self._stop.is_set():
            raise SourceClosedError(f'video device {self.name} was closed')
        waited = self._wait() if _CAN_WAIT else self._grab()
        read, image = self._capture.read() if _CAN_WAIT else self._capture.retrieve()
        now = time.monotonic()
        if not read or image is None:
            raise SourceLostError(f'video device {self.name} stopped delivering frames')
        stamp = self._clock.stamp(self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
        if stamp is None and not waited:
            self.skipped += 1
            return None
        return Frame(to_grey(image) if self._grey else image, now if stamp is None else stamp)

    def _grab(self) -> bool:
        """Block until there is a frame; return whether it had to be waited for."""
        begin = time.monotonic()
        if not self._capture.grab():
            raise SourceLostError(f'video device {self.name} stopped delivering frames')
        return time.monotonic() - begin > _AT_ONCE

    def _wait(self) -> bool:
        """Wait for a frame, that reading will not block; return whether that took a while."""
        deadline = time.monotonic() + self._frame_timeout
        if self._ready(_GLANCE):
            return False
        while not self._ready(_SLICE):
            if self._stop.wait(_PAUSE):
                raise SourceClosedError(f'video device {self.name} was closed')
            if time.monotonic() > deadline:
                raise SourceLostError(
                    f'video device {self.name} gave no frame for {self._frame_timeout:g} s'
                )
        return True

    def _ready(self, seconds: float) -> bool:
        """Wait a little for a frame."""
        try:
            _, ready = cv2.VideoCapture.waitAny([self._capture], round(seconds * 1e9))
        except cv2.error as error:
            raise SourceLostError(
                f'video device {self.name} cannot be waited for: {error.err}'
            ) from error
        if len(ready) == 0 and not os.path.exists(self.name):
            raise SourceLostError(f'video device {self.name} was unplugged')
        return len(ready) > 0

    def close(self) -> None:
        """Let go of the device. Idempotent."""
        self._capture.release()


class VideoFileSource:
    """
    A video file, played once.

    Stamps are the times at which the frames are handed out.

    Parameters
    ----------
    path : str
        The file.
    size : (int, int)
        Width and height it must have [px]; 0 accepts any.
    framerate : float
        Frames per second to play [Hz]; 0 plays the file at its own rate.
    grey : bool
        Whether frames are handed out grey.
    stop : threading.Event
        Ends a read.

    Raises
    ------
    SourceError
        If it is missing, no video, or of another size.
    """

    def __init__(
        self,
        path: str,
        *,
        size: tuple[int, int],
        framerate: float,
        grey: bool,
        stop: threading.Event,
    ) -> None:
        self.name = path
        self.skipped = 0
        self._grey = grey
        if not os.path.isfile(path):
            missing = 'is not a file' if os.path.exists(path) else 'does not exist'
            raise SourceError(f'video file {path} {missing}')
        self._capture = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
        read, first = self._capture.read()
        if not read or first is None:
            self.close()
            raise SourceError(f'video file {path} holds no frame that can be decoded')
        self._ahead: Image | None = first
        self.size = (first.shape[1], first.shape[0])
        try:
            check_size(first, size, f'video file {path}')
            rate = framerate or self._capture.get(cv2.CAP_PROP_FPS)
            if not 0.0 < rate < 1e4:
                raise SourceError(f'video file {path} knows no frame rate; set framerate')
        except SourceError:
            self.close()
            raise
        self._schedule = Schedule(rate, stop, skips=False)

    def read(self) -> Frame | None:
        """See :meth:`panodepth_ros.camera.source.FrameSource.read`."""
        image = self._ahead
        if image is None:
            return None
        stamp = self._schedule.wait()
        read, following = self._capture.read()
        self._ahead = following if read else None
        return Frame(to_grey(image) if self._grey else image, stamp)

    def close(self) -> None:
        """Close the file. Idempotent."""
        self._capture.release()


class StreamSource:
    """
    A network stream.

    Stamps are the times at which frames were read; what the network delays is unknown.

    Parameters
    ----------
    url : str
        ``rtsp://``, ``http://`` or whatever else FFmpeg opens.
    size : (int, int)
        Width and height it must have [px]; 0 accepts any.
    grey : bool
        Whether frames are handed out grey.
    frame_timeout : float
        Longest wait for the connection, and for a frame [s].
    stop : threading.Event
        Ends a read, at the latest after ``frame_timeout``.

    Raises
    ------
    SourceLostError
        If it does not answer.
    SourceError
        If the URL is none, or the frames are of another size.
    """

    def __init__(
        self,
        url: str,
        *,
        size: tuple[int, int],
        grey: bool,
        frame_timeout: float,
        stop: threading.Event,
    ) -> None:
        if '://' not in url:
            raise SourceError(f'stream {url!r} is not a URL such as rtsp://host/path')
        self.name = url
        self.skipped = 0
        self._grey = grey
        self._stop = stop
        self._timeout = frame_timeout
        milliseconds = round(1000 * frame_timeout)
        self._capture = cv2.VideoCapture(
            url,
            cv2.CAP_FFMPEG,
            [
                cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
                milliseconds,
                cv2.CAP_PROP_READ_TIMEOUT_MSEC,
                milliseconds,
            ],
        )
        read, first = self._capture.read()
        if not read or first is None:
            self.close()
            raise SourceLostError(f'stream {url} does not deliver within {frame_timeout:g} s')
        self.size = (first.shape[1], first.shape[0])
        try:
            check_size(first, size, f'stream {url}')
        except SourceError:
            self.close()
            raise

    def read(self) -> Frame:
        """See :meth:`panodepth_ros.camera.source.FrameSource.read`."""
        if self._stop.is_set():
            raise SourceClosedError(f'stream {self.name} was closed')
        read, image = self._capture.read()
        now = time.monotonic()
        if not read or image is None:
            raise SourceLostError(
                f'stream {self.name} ended or gave no frame for {self._timeout:g} s'
            )
        check_size(image, self.size, f'stream {self.name}')
        return Frame(to_grey(image) if self._grey else image, now)

    def close(self) -> None:
        """Close the connection. Idempotent."""
        with suppress(cv2.error):  # a broken connection must not keep us
            self._capture.release()
