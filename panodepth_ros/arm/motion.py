"""Motion with limited speed and acceleration, as pieces of constant acceleration."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

from .truth import Piece


def trapezoid(
    begin: float, start: float, end: float, speed: float, acceleration: float
) -> list[Piece]:
    """
    Motion from rest to rest: speed up, cruise, brake, stand.

    Parameters
    ----------
    begin : float
        When it begins [s].
    start, end : float
        From where to where [rad].
    speed, acceleration : float
        Largest speed [rad/s] and the acceleration [rad/s²], both > 0. On a short way the speed
        is not reached.

    Returns
    -------
    list of Piece
        The last one stands at ``end`` and begins when the motion is over.
    """
    way = abs(end - start)
    if way == 0.0:
        return [Piece(begin, end)]
    sign = math.copysign(1.0, end - start)
    peak = min(speed, math.sqrt(acceleration * way))
    ramp_time = peak / acceleration
    ramp_way = 0.5 * peak * ramp_time
    cruise_time = (way - 2.0 * ramp_way) / peak
    braking = begin + ramp_time + cruise_time
    return [
        Piece(begin, start, 0.0, sign * acceleration),
        Piece(begin + ramp_time, start + sign * ramp_way, sign * peak, 0.0),
        Piece(braking, end - sign * ramp_way, sign * peak, -sign * acceleration),
        Piece(braking + ramp_time, end),
    ]


def brake(
    begin: float, start: float, velocity: float, acceleration: float, grid: float, origin: float
) -> list[Piece]:
    """
    Motion from a velocity to rest on a motor step.

    Parameters
    ----------
    begin : float
        When braking begins [s].
    start, velocity : float
        Where [rad] and how fast [rad/s] the arm moves then.
    acceleration : float
        About how hard it brakes [rad/s²]; adapted so that the arm ends on a motor step.
    grid, origin : float
        Motor steps are at ``origin + k·grid`` [rad].

    Returns
    -------
    list of Piece
        The last one stands and begins when the motion is over.
    """
    free_end = start + velocity * abs(velocity) / (2.0 * acceleration)
    end = origin + grid * round((free_end - origin) / grid)
    way = end - start
    if velocity == 0.0 or way * velocity <= 0.0:  # less than half a motor step: it snaps in
        return [Piece(begin, end)]
    return [
        Piece(begin, start, velocity, -velocity * velocity / (2.0 * way)),
        Piece(begin + 2.0 * way / velocity, end),
    ]


def state_at(pieces: Sequence[Piece], moment: float) -> tuple[float, float]:
    """Azimuth [rad] and velocity [rad/s] at a time [s] not before the first piece."""
    index = bisect.bisect_right(pieces, moment, key=lambda piece: piece.begin) - 1
    return pieces[index].at(moment)
