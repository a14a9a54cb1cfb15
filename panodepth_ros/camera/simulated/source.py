"""The simulated camera: exposes at its own rate, wherever the simulated arm then stands."""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from panodepth_ros.arm.truth import TruthError, TruthReader
from panodepth_ros.camera.simulated.lens import RealCamera
from panodepth_ros.camera.simulated.room import Room
from panodepth_ros.camera.source import (
    Frame,
    Image,
    Schedule,
    SourceClosedError,
    SourceError,
    SourceLostError,
    to_grey,
)
from panodepth_ros.geometry import PinholeCamera

#: How long an arm that starts at the same time may take to begin its truth file [s].
_ARM_START_TIMEOUT = 10.0
#: How often a missing truth file is looked for [s].
_LOOK_PERIOD = 0.05


class SimulatedSource:
    """
    A free-running camera on the simulated arm.

    Each exposure sees the arm where it truly is, moving or not; its stamp is the middle of it.
    Exposures that come while a frame is still rendered are skipped.

    Parameters
    ----------
    room : Room
        What it sees.
    camera : PinholeCamera
        Its true lens and mounting.
    arm_radius : float
        Axis to optical centre [m].
    arm_truth : str
        Path of the simulated arm's truth file.
    framerate : float
        Exposures per second [Hz].
    exposure : float
        How long each of them is [s]: a turning arm blurs the frame.
    noise_stddev : float
        Standard deviation of the sensor's noise [grey levels].
    seed : int
        Of the noise.
    grey : bool
        Whether frames are handed out grey.
    stop : threading.Event
        Ends a read.

    Notes
    -----
    The first read waits a while for the truth file: arm and camera may be started at once.
    """

    def __init__(
        self,
        room: Room,
        camera: PinholeCamera,
        *,
        arm_radius: float,
        arm_truth: str,
        framerate: float,
        exposure: float,
        noise_stddev: float,
        seed: int,
        grey: bool,
        stop: threading.Event,
    ) -> None:
        self.name = 'simulated room'
        self.size = (camera.width, camera.height)
        self._room = room
        self._camera = RealCamera(camera)
        self._arm_radius = arm_radius
        self._exposure = exposure
        self._noise_stddev = noise_stddev
        self._rng = np.random.default_rng(seed)
        self._grey = grey
        self._arm_truth = arm_truth
        self._stop = stop
        self._arm: TruthReader | None = None
        self._schedule = Schedule(framerate, stop, skips=True)

    @property
    def skipped(self) -> int:
        """Exposures that came while a frame was still rendered."""
        return self._schedule.skipped

    def read(self) -> Frame:
        """See :meth:`panodepth_ros.camera.source.FrameSource.read`."""
        if self._arm is None:
            self._arm = _wait_for_arm(self._arm_truth, self._stop)
        stamp = self._schedule.wait()
        try:
            image = self._exposed(self._arm, stamp)
        except TruthError as error:
            raise SourceLostError(str(error)) from error
        noisy = self._noisy(to_grey(image) if self._grey else image)
        return Frame(noisy, stamp)

    def close(self) -> None:
        """Let go of the truth file. Idempotent."""
        if self._arm is not None:
            self._arm.close()

    def _exposed(self, arm: TruthReader, stamp: float) -> Image:
        """Mean of what is seen at moments between which the picture moves by up to a pixel."""
        begin, end = (arm.azimuth(stamp + side * self._exposure) for side in (-0.5, 0.5))
        parts = 1 + math.ceil(abs(end - begin) * self._camera.camera.fx)
        moments = stamp + self._exposure * ((np.arange(parts) + 0.5) / parts - 0.5)
        seen = [
            self._camera.render(self._room, arm.azimuth(float(moment)), self._arm_radius)
            for moment in moments
        ]
        if parts == 1:
            return seen[0]
        return np.asarray(np.rint(np.mean(seen, axis=0, dtype=np.float32)), np.uint8)

    def _noisy(self, image: Image) -> Image:
        if self._noise_stddev == 0.0:
            return image
        noise = self._rng.standard_normal(image.shape, np.float32)
        noise *= np.float32(self._noise_stddev)
        noise += image
        noise += np.float32(0.5)
        return np.clip(noise, 0.0, 255.0, out=noise).astype(np.uint8)


def _wait_for_arm(path: str, stop: threading.Event) -> TruthReader:
    deadline = time.monotonic() + _ARM_START_TIMEOUT
    while True:
        try:
            return TruthReader(path)
        except TruthError as error:
            if not isinstance(error.__cause__, FileNotFoundError):
                raise SourceError(str(error)) from error
            if time.monotonic() > deadline:
                raise SourceLostError(f'{error}; is simulated_arm running?') from error
        if stop.wait(_LOOK_PERIOD):
            raise SourceClosedError('the simulated camera was closed')
