"""Frames and joint states in, finished sweeps out: what stop-and-go and continuous turns share."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.clock import StampOrder
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import Sweep

#: A stamp after all others [ns].
NEVER = 2**63
#: Frames that may wait for joint states.
MOST_PENDING = 200


class Track(Protocol):
    """Where the arm was when: :class:`ArmTrack` or :class:`ArmMotion`."""

    @property
    def newest(self) -> int | None:
        """Stamp of the newest joint state [ns]; None before the first."""

    @property
    def position(self) -> float:
        """Position of the newest joint state [rad]; NaN before the first."""

    def add(self, stamp: int, position: float, velocity: float | None) -> None:
        """Take one joint state."""

    def forget(self) -> None:
        """Forget all joint states: their clock was set."""

    def at(self, stamp: int) -> Any:
        """Place of the arm; a str that says why there is none; None if it is not known yet."""


AnyTrack = TypeVar('AnyTrack', bound=Track)


class SweepBuilder(ABC, Generic[AnyTrack]):
    """
    Builds sweep after sweep.

    It holds each frame until the joint states around its stamp are known, gives those to the
    sweep that can be placed, and counts what it drops by reason.

    Parameters
    ----------
    rig : Rig
        Arm and columns; may be replaced between sweeps by assigning ``rig``.
    track : ArmTrack or ArmMotion
        Fresh.

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
    clock_set : callable
        Called when the clock of camera or arm was set back, so that the sweep under construction
        is forgotten: with a sentence, and whether there was one. Does nothing unless replaced.
    """

    def __init__(self, rig: Rig, track: AnyTrack) -> None:
        self.rig = rig
        self.track = track
        self.drops: Counter[str] = Counter()
        self.sweep: Sweep | None = None
        self.camera: PinholeCamera | None = None
        self._pending: deque[tuple[int, npt.NDArray[np.uint8]]] = deque()
        self._frame_order, self._joint_order = StampOrder(), StampOrder()
        self._not_before = 0
        self.taken: Callable[[npt.NDArray[np.uint8], float], None] = lambda *_: None
        self.clock_set: Callable[[str, bool], None] = lambda *_: None

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

    def rest(self, not_before: int) -> None:
        """Restart at a time, unless a later one was named before."""
        self.restart(max(self._not_before, not_before))

    def add_joint_state(self, stamp: int, position: float, velocity: float | None) -> list[Sweep]:
        """
        Take one joint state, and place the frames it decides.

        Parameters as of :meth:`ArmTrack.add`, but a bad state is dropped and counted.

        Returns
        -------
        list of Sweep
            Sweeps that came to their end.
        """
        if not math.isfinite(position) or not math.isfinite(velocity or 0.0):
            self.drops['joint state is not finite'] += 1
            return []
        set_back = self._joint_order.see(stamp)
        if set_back is None:
            self.drops['joint state out of order or twice'] += 1
            return []
        if set_back:
            self.track.forget()
            self._frame_order = StampOrder()  # the camera's clock may be the same
        self.track.add(stamp, position, velocity)
        if set_back:
            self._begin_anew('arm', set_back, stamp + 1)
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
        set_back = self._frame_order.see(stamp)
        if set_back is None:
            self.drops['frame out of order or twice'] += 1
            return []
        if set_back:
            self._begin_anew('camera', set_back, (self.track.newest or 0) + 1)
        self._pending.append((stamp, image))
        if len(self._pending) > MOST_PENDING:
            self._pending.popleft()
            self.drops['frame: no joint state or camera_info came'] += 1
        return self._place_pending()

    def _begin_anew(self, whose: str, set_back: int, not_before: int) -> None:
        """Forget the sweep: what the clock told before does not agree with what it tells now."""
        under_way = self.sweep is not None
        self.restart(not_before)
        self.clock_set(
            f'the clock of the {whose} was set back by {set_back * 1e-9:.1f} s', under_way
        )

    def _place_pending(self) -> list[Sweep]:
        finished = []
        while self._pending and self.camera is not None:
            stamp, image = self._pending[0]
            place = self.track.at(self._moment(stamp))
            if place is None:
                break
            self._pending.popleft()
            if isinstance(place, str):
                self.drops[f'frame: {place}'] += 1
            else:
                finished += self._use(stamp, image, place)
        return finished

    def _moment(self, stamp: int) -> int:
        """When the arm was where it is for a frame of this stamp [ns]."""
        return stamp

    @abstractmethod
    def _use(self, stamp: int, image: npt.NDArray[np.uint8], place: Any) -> list[Sweep]:
        """Give a frame of a known place to the sweep; return sweeps that came to their end."""
