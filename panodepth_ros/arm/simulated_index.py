"""The mark on a simulated arm that a sensor at the controller's probe input sees."""

from __future__ import annotations

import math
from collections.abc import Sequence

from panodepth_ros.arm.motion import state_at
from panodepth_ros.arm.truth import Piece


class IndexMark:
    """
    A mark on the arm.

    Parameters
    ----------
    begin, width : float
        True azimuth where it begins, counter-clockwise, and its width [°].
    """

    def __init__(self, begin: float, width: float) -> None:
        self._begin, self._width = math.radians(begin), math.radians(width)

    def active(self, azimuth: float) -> bool:
        """Whether the sensor sees it at a true azimuth [rad]."""
        return (azimuth - self._begin) % (2.0 * math.pi) < self._width

    def changes_at(self, pieces: Sequence[Piece], begin: float, end: float) -> float:
        """When the sensor first tells something else than at the begin [s]; +inf if never."""
        before = self.active(state_at(pieces, begin)[0])
        fastest = max(abs(state_at(pieces, piece.begin)[1]) for piece in pieces)
        fastest = max(fastest, abs(state_at(pieces, begin)[1]), 1e-9)
        step = 0.25 * self._width / fastest
        early = begin
        for k in range(1, math.ceil((end - begin) / step) + 1):
            late = min(begin + k * step, end)
            if self.active(state_at(pieces, late)[0]) != before:
                while late - early > 1e-6:
                    middle = 0.5 * (early + late)
                    changed = self.active(state_at(pieces, middle)[0]) != before
                    early, late = (early, middle) if changed else (middle, late)
                return late
            early = late
        return math.inf
