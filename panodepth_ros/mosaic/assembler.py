"""
Frames and joint states in, finished sweeps out, by one rule for live and replayed data.

The assembler holds each frame until the joint states around its stamp are known, gives the first
good frame of every standstill to the sweep, and counts what it drops by reason.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.arm_track import ArmTrack, Standstill
from panodepth_ros.mosaic.sweep import Rig, Sweep

#: Frames that may wait for joint states.
MOST_PENDING = 200


class Assembler:
    """
    Builds sweep after sweep.

    Parameters
    ----------
    rig : Rig
        Arm and columns; may be replaced between sweeps by assigning ``rig``.
    track : ArmTrack
        Fresh arm track.
    settle_time : int
        Time after the start of a standstill before which frames are not used [ns].

    Attributes
    ----------
    rig : Rig
        Used by the next sweep.
    drops : Counter
        Dropped frames and joint states by reason.
    sweep : Sweep or None
        The sweep under construction.
    camera : PinholeCamera or None
        The calibration in use.
    taken : callable
        Called with each frame that a sweep has taken and its arm azimuth; does nothing unless
        replaced.
    """

    def __init__(self, rig: Rig, track: ArmTrack, settle_time: int) -> None:
        self.rig = rig
        self.track = track
        self.drops: Counter[str] = Counter()
        self.sweep: Sweep | None = None
        self._settle_time = settle_time
        self.camera: PinholeCamera | None = None
        self._pending: deque[tuple[int, npt.NDArray[np.uint8]]] = deque()
        self._newest_frame: int | None = None
        self._served: int | None = None
        self._not_before = 0
        self.taken: Callable[[npt.NDArray[np.uint8], float], None] = lambda *_: None

    def set_camera(self, camera: PinholeCamera) -> list[Sweep]:
        """
        Use this calibration from now on, also for frames that came before any.

        A sweep begun with another one is forgotten.

        Returns
        -------
        list of Sweep
            Sweeps that came to their end.

        Raises
        ------
        ValueError
            If the rig's columns lie outside the image.
        """
        if camera == self.camera:
            return []
        Sweep(self.rig, camera, 0.0)
        if self.camera is not None:
            self.restart(self._not_before)
        self.camera = camera
        return self._place_pending()

    def restart(self, not_before: int) -> None:
        """Forget the sweep under construction; standstills that began before count no more."""
        self.sweep = None
        self._pending.clear()
        self._not_before = not_before

    def add_joint_state(self, stamp: int, position: float, velocity: float | None) -> list[Sweep]:
        """
        Take one joint state, and place the frames it decides.

        Parameters as of :meth:`ArmTrack.add`, but a bad state is dropped and counted.

        Returns
        -------
        list of Sweep
            Sweeps that came to their end.
        """
        try:
            self.track.add(stamp, position, velocity)
        except ValueError:
            self.drops['joint state out of order or not finite'] += 1
            return []
        return self._place_pending()

    def add_frame(self, stamp: int, image: npt.NDArray[np.uint8]) -> list[Sweep]:
        """
        Take one frame; it is used, kept until a joint state decides, or dropped and counted.

        Parameters
        ----------
        stamp : int
            Time of exposure [ns].
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
            The frame.

        Returns
        -------
        list of Sweep
            Sweeps that came to their end.
        """
        if self._newest_frame is not None and stamp <= self._newest_frame:
            self.drops['frame out of order or twice'] += 1
            return []
        self._newest_frame = stamp
        self._pending.append((stamp, image))
        if len(self._pending) > MOST_PENDING:
            self._pending.popleft()
            self.drops['frame: no joint state or camera_info came'] += 1
        return self._place_pending()

    def has_frame_of(self, standstill: Standstill) -> bool:
        """Whether a frame exposed in a standstill is used or waits for its joint state."""
        if self._served is not None and self._served >= standstill.start:
            return True
        ready = standstill.start + self._settle_time
        return any(stamp >= ready for stamp, _ in self._pending)

    def _place_pending(self) -> list[Sweep]:
        finished = []
        while self._pending and self.camera is not None:
            stamp, image = self._pending[0]
            place = self.track.at(stamp)
            if place is None:
                break
            self._pending.popleft()
            if isinstance(place, str):
                self.drops[f'frame: {place}'] += 1
            else:
                finished += self._use(stamp, image, place)
        return finished

    def _use(
        self, stamp: int, image: npt.NDArray[np.uint8], standstill: Standstill
    ) -> list[Sweep]:
        """Give the first good frame of a standstill to the sweep."""
        if standstill.start < self._not_before or self._served == standstill.start:
            return []  # not of this sweep, or a further frame of a standstill already served
        if stamp < standstill.start + self._settle_time:
            self.drops['frame: arm was settling'] += 1
            return []
        finished = []
        if self.sweep is not None and self.sweep.columns_left(standstill.azimuth) < 0:
            finished.append(self.sweep)
            self.sweep = None
        assert self.camera is not None  # frames are kept only with a camera
        sweep = self.sweep or Sweep(self.rig, self.camera, standstill.azimuth)
        try:
            sweep.add(stamp, image, standstill.azimuth)
        except ValueError as error:
            self.drops[str(error)] += 1
            return finished
        self._served = standstill.start
        self.sweep = sweep
        self.taken(image, standstill.azimuth)
        # A sweep ends at its last column, also if frames were lost on the way.
        if sweep.complete or sweep.columns_left(standstill.azimuth) == 0:
            finished.append(sweep)
            self.sweep = None
        return finished
