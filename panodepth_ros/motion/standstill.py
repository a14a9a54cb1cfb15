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
    """
    Watches odometry from a named moment on; any doubt stays until the next one is named.

    Parameters
    ----------
    limits : StillLimits
        What counts as standing; may be replaced.
    proof : bool
        Whether standing must be proven, so that silence and jumps are doubts as well; without,
        nothing but a motion that odometry tells of is one.
    """

    def __init__(self, limits: StillLimits, *, proof: bool = True) -> None:
        self.limits = limits
        self._proof = proof
        self._heard: deque[Odometry] = deque(maxlen=_KEPT)
        self._named = False
        self._anchor: Odometry | None = None
        self._doubt = 'no moment was named'

    @property
    def heard(self) -> bool:
        """Whether there ever was odometry."""
        return bool(self._heard)

    @property
    def newest(self) -> float:
        """Stamp of the last odometry [s], −inf before the first."""
        return self._heard[-1].time if self._heard else -math.inf

    @property
    def told(self) -> str:
        """What odometry so far says against standing since the moment named; empty if nothing."""
        return self._doubt

    def since(self, time: float, moment: str = 'the end of the sweep') -> None:
        """Name the moment from which on the robot must have stood still [s], and in words."""
        before = [k for k, odometry in enumerate(self._heard) if odometry.time <= time]
        heard = list(self._heard)[before[-1] if before else 0 :]
        near = bool(before) and time - heard[0].time <= GAP
        self._named, self._anchor, self._doubt = True, heard.pop(0) if near else None, ''
        if not near and self._proof:
            self._doubt = f'there was no odometry at {moment}'
            return
        previous = self._anchor
        for odometry in heard if near or not before else heard[1:]:
            self._doubt = self._doubt or self._against(odometry, previous)
            previous = odometry

    def add(self, odometry: Odometry) -> None:
        """Take the next odometry."""
        if self._named and not self._doubt:
            self._doubt = self._against(odometry, self._heard[-1] if self._heard else None)
        self._heard.append(odometry)

    def doubt(self, now: float) -> str:
        """Why it is not proven that the robot has stood still until now [s]; empty if it is."""
        if not self.heard:
            return 'there is no odometry'
        silent = now - self.newest
        if not self._doubt and silent > GAP:
            self._doubt = f'odometry has been silent for {silent:.1f} s'
        if not self._doubt and silent < -GAP:
            self._doubt = f'odometry is stamped {-silent:.1f} s ahead of the clock'
        return self._doubt

    def _against(self, odometry: Odometry, previous: Odometry | None) -> str:
        """What one odometry says against a standstill since the anchor."""
        anchor = self._anchor
        if anchor is not None and previous is not None:
            step = odometry.time - previous.time
            if odometry.frame != anchor.frame or not step >= 0:
                self._anchor = None  # its poses cannot be compared
            if self._proof and odometry.frame != anchor.frame:
                return f'odometry changed from frame {anchor.frame} to {odometry.frame}'
            if self._proof and not 0 <= step <= GAP:
                return f'odometry jumped by {step:.1f} s'
        self._anchor = self._anchor or odometry
        return motion_between(self._anchor, odometry, self.limits)


def motion_between(anchor: Odometry, odometry: Odometry, limits: StillLimits) -> str:
    """Say how a robot moved away from an anchor, or moves; empty within the limits."""
    turn = (odometry.yaw - anchor.yaw + math.pi) % (2 * math.pi) - math.pi
    moved = math.hypot(odometry.x - anchor.x, odometry.y - anchor.y)
    return _first_beyond(
        ('moved by', moved, limits.distance, ' m'),
        ('turned by', math.degrees(abs(turn)), math.degrees(limits.turn), '°'),
    ) or motion_at(odometry.speed, odometry.turn_rate, limits)


def motion_at(speed: float, turn_rate: float, limits: StillLimits) -> str:
    """Say how a robot of these velocities [m/s], [rad/s] moves; empty within the limits."""
    return _first_beyond(
        ('went at', speed, limits.speed, ' m/s'),
        ('turned at', math.degrees(turn_rate), math.degrees(limits.turn_rate), ' °/s'),
    )


def _first_beyond(*measured: tuple[str, float, float, str]) -> str:
    for verb, value, allowed, unit in measured:
        if not value <= allowed:  # NaN is a doubt, too
            return f'the robot {verb} {value:.3f}{unit}; allowed: {allowed:g}{unit}'
    return ''
