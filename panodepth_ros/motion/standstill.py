"""Whether a robot has provably stood still since a moment, by its odometry."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

#: Odometry that pauses longer proves nothing [s].
GAP = 1.0
#: Poses kept from before a moment is named; it lies back as long as a sweep takes to match.
_KEPT = 6000


@dataclass(frozen=True, slots=True, kw_only=True)
class Odometry:
    """
    A pose and a velocity.

    Attributes
    ----------
    time : float
        Stamp [s].
    frame : str
        Frame of the pose.
    x, y, yaw : float
        Pose [m], [rad].
    speed, turn_rate : float
        Sizes of the velocities [m/s], [rad/s].
    """

    time: float
    frame: str
    x: float
    y: float
    yaw: float
    speed: float
    turn_rate: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StillLimits:
    """
    What still counts as standing.

    Attributes
    ----------
    distance, turn : float
        Change of the pose [m], [rad].
    speed, turn_rate : float
        Velocities [m/s], [rad/s].
    """

    distance: float
    turn: float
    speed: float
    turn_rate: float


class Standstill:
    """Watches odometry from a named moment on; any doubt stays until the next one is named."""

    def __init__(self, limits: StillLimits) -> None:
        self.limits = limits
        self._heard: deque[Odometry] = deque(maxlen=_KEPT)
        self._anchor: Odometry | None = None
        self._doubt = 'no moment was named'

    @property
    def heard(self) -> bool:
        """Whether there ever was odometry."""
        return bool(self._heard)

    def since(self, time: float) -> None:
        """Name the moment from which on the robot must have stood still [s]."""
        before = [k for k, odometry in enumerate(self._heard) if odometry.time <= time]
        if not before or time - self._heard[before[-1]].time > GAP:
            self._anchor, self._doubt = None, 'there was no odometry at the end of the sweep'
            return
        self._anchor, self._doubt = self._heard[before[-1]], ''
        previous = self._anchor
        for odometry in list(self._heard)[before[-1] + 1 :]:
            self._doubt = self._doubt or self._against(odometry, previous)
            previous = odometry

    def add(self, odometry: Odometry) -> None:
        """Take the next odometry."""
        if self._anchor is not None and not self._doubt:
            self._doubt = self._against(odometry, self._heard[-1])
        self._heard.append(odometry)

    def doubt(self, now: float) -> str:
        """Why it is not proven that the robot has stood still until now [s]; empty if it is."""
        if not self.heard:
            return 'there is no odometry'
        silent = now - self._heard[-1].time
        if not self._doubt and self._anchor is not None and silent > GAP:
            self._doubt = f'odometry has been silent for {silent:.1f} s'
        return self._doubt

    def _against(self, odometry: Odometry, previous: Odometry) -> str:
        """What one odometry says against a standstill since the anchor."""
        anchor, limits = self._anchor, self.limits
        if anchor is None:
            raise RuntimeError('no anchor to compare with')
        if odometry.frame != anchor.frame:
            return f'odometry changed from frame {anchor.frame} to {odometry.frame}'
        if not 0 <= odometry.time - previous.time <= GAP:
            return f'odometry jumped by {odometry.time - previous.time:.1f} s'
        turn = (odometry.yaw - anchor.yaw + math.pi) % (2 * math.pi) - math.pi
        moved = math.hypot(odometry.x - anchor.x, odometry.y - anchor.y)
        degrees = math.degrees
        for verb, value, allowed, unit in (
            ('moved by', moved, limits.distance, ' m'),
            ('turned by', degrees(abs(turn)), degrees(limits.turn), '°'),
            ('went at', odometry.speed, limits.speed, ' m/s'),
            ('turned at', degrees(odometry.turn_rate), degrees(limits.turn_rate), ' °/s'),
        ):
            if not value <= allowed:  # NaN is a doubt, too
                return f'the robot {verb} {value:.3f}{unit}; allowed: {allowed:g}{unit}'
        return ''
