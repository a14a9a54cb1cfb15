"""The simulated arm with faults on its line, in its controller and in its motor."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from panodepth_ros.arm.simulated import SimulatedController
from panodepth_ros.arm.simulated_settings import default_settings
from panodepth_ros.arm.terminal import SimulatedArm

#: Quick, so that the campaign is about faults: [°/s], [°/s²], [s].
MAX_RATE, ACCELERATION, BOOT_TIME = 180.0, 20000.0, 0.2


class FaultyController(SimulatedController):
    """A controller whose motor may lose steps, and whose arm a person may put in its place."""

    def displace(self, azimuth: float) -> None:
        """Turn the arm, standing or not, by an angle [rad] that the controller does not count."""
        self._motor.displace(azimuth)

    def put_right(self) -> float:
        """Turn the arm to where the controller's count says that it stands; return how far."""
        off = -math.remainder(self._motor.zero, 2 * math.pi)
        self.displace(off)
        return off


class FaultyArm(SimulatedArm):
    """Served in a thread; passes all that it sends through :attr:`spoil`."""

    def __init__(self, link: Path) -> None:
        super().__init__(
            link,
            settings=default_settings(
                steps_per_degree=25.0, max_rate=MAX_RATE, acceleration=ACCELERATION
            ),
            boot_time=BOOT_TIME,
            controller_type=FaultyController,
        )
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self._lock = threading.RLock()
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """See :meth:`SimulatedArm.send`."""
        super().send(self.spoil(data))

    def _pass_on(self, now: float) -> None:
        with self._lock:
            super()._pass_on(now)

    def do(self, action: Callable[[Any, float], None]) -> None:
        """Do something to the controller, now."""
        with self._lock:
            action(self.controller, time.monotonic())
        self.wake()

    def unplug(self) -> None:
        """Take the port away."""
        self.stop()
        self._thread.join()
        self.close()
