"""A growing sweep of a steadily turning arm: columns are made of the two frames beside them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import SAME_PLACE, Sweep

Image = npt.NDArray[np.uint8]


class _Frame(NamedTuple):
    """A frame, where the arm was, and how far it turned from row to row [rad]."""

    stamp: int
    image: Image
    azimuth: float
    row_turn: float


class SteadySweep(Sweep):
    """
    Panoramas filled between frame and frame of an arm that turns in one direction.

    Each column between a frame and the next one is the mean of what both show along their rays,
    and its ray angle the mean of theirs. The share of the next one grows from 0 to 1 on the way
    from place to place, over the part that both reach: what stands nearer or farther than the
    stripe distance moves steadily from column to column, instead of jumping once a frame.

    Parameters as of :class:`Sweep`.
    """

    def __init__(self, rig: Rig, camera: PinholeCamera, first_azimuth: float) -> None:
        super().__init__(rig, camera, first_azimuth)
        self._frame = np.zeros(rig.columns)
        self._before: _Frame | None = None

    def close(self, image: Image, arm_azimuth: float, row_turn: float) -> None:
        """
        Fill the last columns, up to those where the sweep began.

        Parameters
        ----------
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
            The frame after the sweep's last one.
        arm_azimuth, row_turn : float
            As of :meth:`add`.

        Raises
        ------
        ValueError
            As of :meth:`add`.
        """
        self._check(image, row_turn)
        if self._before is not None and self.start is not None:
            self._fill_between(self._before, _Frame(0, image, arm_azimuth, row_turn))

    def _take(self, stamp: int, image: Image, arm_azimuth: float, row_turn: float) -> int:
        """Fill the columns between the frame before and this one; return how many."""
        frame = _Frame(stamp, image, arm_azimuth, row_turn)
        before, self._before = self._before, frame
        if before is None:
            return 0
        if self.start is None:
            self._count(before.stamp, before.image, before.azimuth)
        filled = self._fill_between(before, frame)
        self._count(stamp, image, arm_azimuth)
        return filled

    def _fill_between(self, before: _Frame, after: _Frame) -> int:
        """Fill the columns beyond the place of a frame, up to that of the next one."""
        first, most = self._column(self._first_azimuth), self.rig.columns - SAME_PLACE
        begin, end = self._column(before.azimuth), self._column(after.azimuth)
        side = math.copysign(1.0, end - begin)
        from_here = side * begin - (SAME_PLACE if begin == first else 0.0)
        filled = 0
        for column in range(math.floor(min(begin, end)), math.ceil(max(begin, end)) + 1):
            if from_here < side * column <= side * end and side * (column - first) < most:
                filled += self._mix(column, before, after)
        return filled

    def _mix(self, column: int, before: _Frame, after: _Frame) -> bool:
        """Make a column, not wrapped, of the frames beside it; return whether one shows it."""
        places = [self._column(frame.azimuth) - column for frame in (before, after)]
        share = self._share(*map(abs, places))
        samples = [
            self._samples(place * self.rig.column_step, frame.image, frame.row_turn)
            if abs(place) <= self.rig.reach and part > SAME_PLACE
            else None
            for place, frame, part in zip(places, (before, after), (1 - share, share), strict=True)
        ]
        # A ray that leaves the image at its side is seen by the other frame alone.
        one, other = samples[0] or samples[1], samples[1] or samples[0]
        if one is None or other is None:
            return False
        x = column % self.rig.columns
        for view, (angle, shown), (beside, also) in zip(
            self._views.values(), one, other, strict=True
        ):
            mean = shown + share * (also.astype(np.float64) - shown)
            view.fill(x, angle + share * (beside - angle), np.rint(mean).astype(np.uint8))
        self._deviation[x] = 0.0
        self._frame[x] = self.light.frames - 1 + share if self.light is not None else 0.0
        return True

    def _share(self, before: float, after: float) -> float:
        """Share of the next frame in a column so far from either [columns], positive."""
        way = before + after
        both = min(way, 2 * self.rig.reach - way)
        if both <= 0.0:
            return float(after < before)
        return min(max(0.5 + 0.5 * (before - after) / both, 0.0), 1.0)
