"""How far the arm may turn: the cable to the camera, and what the controller can count."""

from __future__ import annotations

import math

from panodepth_ros.arm.errors import ArmLimitError

_TURN = 2.0 * math.pi


class Cable:
    """
    Allowed azimuths, from minus to plus a limit around 0.

    Parameters
    ----------
    limit : float
        How far the cable lets the arm turn from 0 to each side [rad]; 0 for an endless axis.
    farthest : float
        How far the controller counts exactly [rad].
    tolerance : float
        By how much the arm may be beyond [rad].
    """

    def __init__(self, limit: float, farthest: float, tolerance: float) -> None:
        self.limit = min(limit, farthest) if limit else farthest
        self._endless = not limit
        self._tolerance = tolerance

    def require(self, here: float, target: float) -> None:
        """
        Make sure that the arm may turn from one azimuth to another [rad].

        Raises
        ------
        ArmLimitError
            If that would wind the cable farther than the limit.
        """
        if abs(target) <= max(self.limit + self._tolerance, abs(here)):
            return
        what = 'what the controller counts exactly' if self._endless else 'cable_limit_deg'
        raise ArmLimitError(
            f'a turn from {math.degrees(here):.3f}° to {math.degrees(target):.3f}° is beyond '
            f'{what}, ±{math.degrees(self.limit):g}°; call ~/unwind or ~/home'
        )

    def unwound(self, azimuth: float, step: float) -> float:
        """
        Where to turn back to, so that a whole turn and one step more, if allowed, have room.

        Parameters
        ----------
        azimuth : float
            Where the arm stands [rad].
        step : float
            One step of the turn, positive if it is to be counter-clockwise [rad].

        Returns
        -------
        float
            ``azimuth`` if there is room; else the nearest azimuth with room that points the same
            way; else, where the limit allows none, the one that leaves the most room [rad].
        """
        sign, room = math.copysign(1.0, step), _TURN + abs(step)
        if room > 2 * (self.limit + self._tolerance):
            room = _TURN
        lacking = sign * azimuth + room - self.limit - self._tolerance
        if lacking <= 0.0:
            return azimuth
        turned = sign * azimuth - _TURN * math.ceil(lacking / _TURN)
        return sign * max(turned, -self.limit)
