"""Motion with limited speed and acceleration, as pieces of constant acceleration."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

from panodepth_ros.arm.truth import Piece


def chain(
    begin: float,
    start: float,
    velocity: float,
    moves: Sequence[tuple[float, float]],
    acceleration: float,
) -> tuple[list[Piece], list[float]]:
    """
    Motion through several targets, ending at rest, without a stop where the direction stays.

    Parameters
    ----------
    begin : float
        When it begins [s].
    start, velocity : float
        Where [rad] and how fast [rad/s] the arm is then.
    moves : sequence of (float, float)
        Target [rad] and largest speed [rad/s], > 0, of each move; every one has a way to go.
    acceleration : float
        [rad/s²], > 0. On a short way the speed is not reached.

    Returns
    -------
    pieces : list of Piece
        The last one stands at the last target and begins when the motion is over.
    ends : list of float
        When each move is over [s].
    """
    sources = [start, *(target for target, _ in moves)]
    ways = [target - source for source, (target, _) in zip(sources, moves, strict=False)]
    leaving = [0.0] * len(moves)  # speed at the end of each move, so that the rest can brake
    for i in range(len(moves) - 1, 0, -1):
        if ways[i] * ways[i - 1] > 0.0:
            braked = math.sqrt(leaving[i] ** 2 + 2.0 * acceleration * abs(ways[i]))
            leaving[i - 1] = min(moves[i][1], moves[i - 1][1], braked)
    pieces: list[Piece] = []
    ends: list[float] = []
    here, entry = start, abs(velocity)
    for (target, speed), way, wanted in zip(moves, ways, leaving, strict=True):
        sign, length = math.copysign(1.0, way), abs(way)
        reach = 2.0 * acceleration * length
        slowest, fastest = math.sqrt(max(0.0, entry**2 - reach)), math.sqrt(entry**2 + reach)
        leave = min(max(wanted, slowest), fastest)
        peak = max(min(speed, math.sqrt(0.5 * (reach + entry**2 + leave**2))), entry, leave)
        up = (peak**2 - entry**2) / (2.0 * acceleration)
        down = (peak**2 - leave**2) / (2.0 * acceleration)
        cruise = max(0.0, length - up - down)
        if peak > entry:
            pieces.append(Piece(begin, here, sign * entry, sign * acceleration))
            begin += (peak - entry) / acceleration
        if cruise > 0.0:
            pieces.append(Piece(begin, here + sign * up, sign * peak))
            begin += cruise / peak
        if peak > leave:
            pieces.append(Piece(begin, target - sign * down, sign * peak, -sign * acceleration))
            begin += (peak - leave) / acceleration
        here, entry = target, leave
        ends.append(begin)
    pieces.append(Piece(begin, here))
    return pieces, ends


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
