"""The camera of a campaign: a V4L2 device that can be unplugged, and what it sees."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import Image

from benchmarks.v4l2_device import Device, build_library
from panodepth_ros.arm.truth import TruthError, TruthReader
from panodepth_ros.camera.calibration import Calibration, write_calibration
from panodepth_ros.camera.simulated import RoomCamera
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.ros.messages import to_nanoseconds

#: Time between frames, and from exposure to delivery [µs].
PERIOD, LATENCY = 20_000, 10_000
#: Of the sensor [grey levels].
_NOISE = 1.5


class FaultyCamera:
    """
    A camera on the arm, for the camera node's V4L2 driver.

    The device delivers frames of one shade at its times; :meth:`expose` gives each the picture
    of the room from where the arm truly was at its stamp.

    Parameters
    ----------
    folder : Path
        For the device, its calibration and the library that shows it to a program.
    lens : RoomCamera
        What its calibration says.
    look : callable
        Frame of an arm azimuth [rad], shape (H, W, 3).
    arm_truth : Path
        The simulated arm's truth file, which is there already.
    seed : int
        Of the noise.

    Attributes
    ----------
    parameters : dict
        Of the camera node.
    environment : dict
        Of its process.

    Raises
    ------
    RuntimeError
        If there is no C compiler.
    """

    def __init__(
        self,
        folder: Path,
        lens: RoomCamera,
        look: Callable[[float], npt.NDArray[np.uint8]],
        arm_truth: Path,
        seed: int,
    ) -> None:
        library = build_library(folder)
        if library is None:
            raise RuntimeError('the V4L2 device of the campaign needs a C compiler: cc')
        self._device = Device(folder / 'video77')
        self._device['width'], self._device['height'] = lens.width, lens.height
        self._device['period_us'], self._device['latency_us'] = PERIOD, LATENCY
        pinhole = PinholeCamera(**{name: getattr(lens, name) for name in RoomCamera.__slots__})
        calibration = folder / 'camera.yaml'
        write_calibration(Calibration.of_pinhole(pinhole, ''), calibration)
        self.parameters: dict[str, object] = {
            'video_device': self._device.path,
            'image_width': lens.width,
            'image_height': lens.height,
            'framerate': 1e6 / PERIOD,
            'camera_info_url': calibration.as_uri(),
            'auto_settle_time': 0.0,
            'frame_timeout': 1.0,
        }
        self.environment = self._device.environment(library)
        self._look = look
        self._arm = TruthReader(arm_truth)
        self._rng = np.random.default_rng(seed)

    def expose(self, image: Image) -> bool:
        """Give a frame its picture; return whether it is known where the arm was."""
        age = 1e-9 * (time.time_ns() - to_nanoseconds(image.header.stamp))
        try:
            azimuth = self._arm.azimuth(time.monotonic() - age)
        except TruthError:
            return False
        picture = self._look(azimuth)
        noise = self._rng.normal(0.0, _NOISE, picture.shape)
        image.data = np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8).tobytes()
        return True

    def unplug(self) -> None:
        """Take the device away."""
        self._device.unplug()

    def plug_in(self) -> None:
        """Bring it back."""
        self._device.plug_in()

    def close(self) -> None:
        """Let go of device and truth."""
        self._device.close()
        self._arm.close()
