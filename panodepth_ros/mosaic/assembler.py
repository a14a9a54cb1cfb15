"""
Sweeps of an arm that stops for every frame, by one rule for live and replayed data.

The first good frame of every standstill becomes columns.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panodepth_ros.mosaic.arm_track import ArmTrack, Standstill
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import Sweep


class Assembler(SweepBuilder[ArmTrack]):
    """
    Builds sweep after sweep out of standstills.

    Parameters
    ----------
    rig : Rig
        Arm and columns; may be replaced between sweeps by assigning ``rig``.
    track : ArmTrack
        Fresh arm track.
    settle_time : int
        Time after the start of a standstill before which frames are not used [ns].
    """

    def __init__(self, rig: Rig, track: ArmTrack, settle_time: int) -> None:
        super().__init__(rig, track)
        self._settle_time = settle_time
        self._served: int | None = None
        self._closed: Sweep | None = None  # the last one, whose frame at 360° may still come

    def restart(self, not_before: int) -> None:
        """See :meth:`SweepBuilder.restart`."""
        super().restart(not_before)
        self._served = None

    def has_frame_of(self, standstill: Standstill) -> bool:
        """Whether a frame exposed in a standstill is used."""
        return self._served is not None and self._served >= standstill.start

    def stands_on(self, standstill: Standstill) -> list[Sweep]:
        """
        Use the frames that wait for later joint states: the arm stood until they came.

        A leader who has asked for no step knows so. He may ask for one then, for no joint state
        that is lost with a process that dies or is held up decides about a frame any more.

        Returns
        -------
        list of Sweep
            Sweeps that came to their end.
        """
        if self._pending:
            standstill.end = max(standstill.end, self._pending[-1][0])
        return self._place_pending()

    def take_up(self, sweep: Sweep) -> None:
        """Go on with a sweep of an earlier process; the arm stands and has settled."""
        self.sweep = sweep
        standstill = self.track.current
        assert standstill is not None
        standstill.arrived = True

    def finish(self) -> list[Sweep]:
        """End the sweep under construction without the frames that it still lacks."""
        finished, self.sweep = [self.sweep] if self.sweep is not None else [], None
        return finished

    def _use(self, stamp: int, image: npt.NDArray[np.uint8], place: Standstill) -> list[Sweep]:
        """Give the first good frame of a standstill to the sweep."""
        if place.start < self._not_before or self._served == place.start:
            return []  # not of this sweep, or a further frame of a standstill already served
        if stamp < place.start + self._settle_time:
            self.drops['frame: arm was settling'] += 1
            return []
        closed, self._closed = self._closed, None
        if closed is not None and closed.closes_at(place.azimuth):
            return []
        finished = []
        if self.sweep is not None and self.sweep.columns_left(place.azimuth) < 0:
            finished.append(self.sweep)
            self.sweep = None
        assert self.camera is not None  # frames are kept only with a camera
        sweep = self.sweep or Sweep(self.rig, self.camera, place.azimuth)
        try:
            sweep.add(stamp, image, place.azimuth)
        except ValueError as error:
            self.drops[str(error)] += 1
            return finished
        self.taken(image, place.azimuth)
        self._served = place.start
        self.sweep = sweep
        # A sweep ends at its last column, also if frames were lost on the way.
        if sweep.ends_at(place.azimuth):
            finished.append(sweep)
            self.sweep = None
            self._closed = sweep if sweep.rig.turn_closes else None
        return finished
