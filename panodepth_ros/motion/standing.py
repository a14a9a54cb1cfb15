"""Since when a robot stands: what was measured before no longer counts."""

from __future__ import annotations

import math

from panodepth_ros.motion.standstill import GAP, Odometry, StillLimits, motion_between


class Standing:
    """
    Follows odometry.

    Parameters
    ----------
    limits : StillLimits
        What counts as standing; may be replaced.

    Attributes
    ----------
    moved : float
        Stamp until which odometry told of a motion [s]; −inf if it told of none.
    """

    def __init__(self, limits: StillLimits) -> None:
        self.limits = limits
        self.moved = -math.inf
        self._since = math.inf
        self._anchor: Odometry | None = None
        self._previous: Odometry | None = None
        self._moves = False

    def add(self, odometry: Odometry) -> None:
        """Take the next odometry."""
        anchor, step = self._anchor, 0.0
        if self._previous is not None:
            step = odometry.time - self._previous.time
        if not step >= 0:
            self.moved = -math.inf  # another time, as of a bag that begins anew
        begins = anchor is None or odometry.frame != anchor.frame or not 0 <= step <= GAP
        if anchor is None or begins:
            anchor = odometry
        moves = bool(motion_between(anchor, odometry, self.limits))
        # It may have moved until this odometry if it still moved at the last one.
        if moves or self._moves:
            self.moved = odometry.time
        if begins or moves or self._moves:
            self._since = odometry.time
        self._anchor = odometry if moves else anchor
        self._moves, self._previous = moves, odometry

    def proven_since(self, now: float) -> float:
        """Since when the robot provably stands [s]; +inf if nothing proves that it stands now."""
        if self._previous is None or self._moves or abs(now - self._previous.time) > GAP:
            return math.inf
        return self._since
