"""
Sweeps of an arm that turns steadily while the camera runs at its own rate.

Every frame is placed by the arm's azimuth at the middle of its exposure and fills the columns
within its stripe, those that the next one reaches together with it (``sweep``).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from panodepth_ros.mosaic.arm_motion import ArmMotion, Turning
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.steady import SteadySweep
from panodepth_ros.mosaic.sweep import Sweep

#: An arm slower than this counts as standing: its frames show nothing new [columns/s].
SLOWEST = 1.0
#: A sweep that lacks columns, for the arm turned back or frames were lost, is worth publishing
#: from this share on.
LEAST_SHARE = 0.5


class ContinuousAssembler(SweepBuilder[ArmMotion]):
    """
    Builds sweep after sweep while the arm turns.

    A sweep begins with the first frame of a turning arm and ends when the arm has travelled the
    sweep's columns, or turns back; the next one begins with the frame that ended it.

    Parameters
    ----------
    rig : Rig
        Arm and columns; may be replaced between sweeps by assigning ``rig``.
    motion : ArmMotion
        Fresh arm motion.
    image_delay : int
        From the stamp of a frame to the middle of its exposure, by the arm's clock [ns].
    row_time : float
        From the exposure of one row to that of the next [s], 0 for a global shutter.

    Attributes
    ----------
    image_delay : int
        May be replaced at any time; frames that wait for joint states have the new one.
    row_time : float
        Likewise.
    """

    def __init__(
        self, rig: Rig, motion: ArmMotion, image_delay: int = 0, row_time: float = 0.0
    ) -> None:
        super().__init__(rig, motion)
        self.image_delay = image_delay
        self.row_time = row_time
        self._direction = 0.0

    def _moment(self, stamp: int) -> int:
        return stamp + self.image_delay

    def _use(self, stamp: int, image: npt.NDArray[np.uint8], place: Turning) -> list[Sweep]:
        """Give every frame of the turning arm to the sweep."""
        if (
            self._moment(stamp) < self._not_before
            or abs(place.velocity) < SLOWEST * self.rig.column_step
        ):
            return []
        direction, row_turn = math.copysign(1.0, place.velocity), place.velocity * self.row_time
        assert self.camera is not None  # frames are kept only with a camera
        finished = []
        try:
            finished = self._end_before(image, place.azimuth, direction, row_turn)
            sweep = self.sweep or SteadySweep(self.rig, self.camera, place.azimuth)
            sweep.add(stamp, image, place.azimuth, row_turn=row_turn)
        except ValueError as error:
            self.drops[str(error)] += 1
            return finished
        self.sweep, self._direction = sweep, direction
        self.taken(image, place.azimuth)
        return finished

    def _end_before(
        self, image: npt.NDArray[np.uint8], azimuth: float, direction: float, row_turn: float
    ) -> list[Sweep]:
        """End the sweep under construction if this frame is not its own any more."""
        sweep = self.sweep
        if sweep is None:
            return []
        assert isinstance(sweep, SteadySweep)  # no other is begun
        turned_back = direction != self._direction
        if not turned_back and sweep.travelled(azimuth) < sweep.rig.sweep_columns:
            return []
        if not turned_back:
            sweep.close(image, azimuth, row_turn)
        self.sweep = None
        if sweep.progress < LEAST_SHARE:
            why = 'arm turned back before' if turned_back else 'frames reached less than'
            self.drops[f'sweep: {why} {LEAST_SHARE:.0%} of it'] += 1
            return []
        return [sweep]
