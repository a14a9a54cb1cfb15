"""What was heard of a LaserScan topic, and what a rule finds in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from panodepth_ros.motion.frames import FrameMotion

CONSUMERS = ('costmap', 'amcl', 'slam_toolbox', 'collision_monitor', 'laser_geometry', 'rviz')

Angles = tuple[float, float, float]


class Verdict(Enum):
    """What is known about a rule."""

    PASS = 'PASS'
    FAIL = 'FAIL'
    UNKNOWN = 'UNKNOWN'


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ReceivedScan:
    """
    A LaserScan and when it came.

    Attributes
    ----------
    stamp, received : float
        ``header.stamp`` and the clock on arrival [s].
    frame_id : str
    angle_min, angle_max, angle_increment : float
        [rad].
    time_increment, scan_time : float
        [s].
    range_min, range_max : float
        [m].
    ranges : ndarray of float, shape (N,)
        [m].
    intensities : int
        How many intensities it carries.
    """

    stamp: float
    received: float
    frame_id: str
    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    scan_time: float
    range_min: float
    range_max: float
    ranges: npt.NDArray[np.floating]
    intensities: int = 0

    @property
    def angles(self) -> Angles:
        """The three angles [rad]."""
        return self.angle_min, self.angle_max, self.angle_increment

    @property
    def age(self) -> float:
        """How old the stamp was on arrival [s]."""
        return self.received - self.stamp


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanStream:
    """
    What was heard of one topic.

    Attributes
    ----------
    scans : sequence of ReceivedScan
        In the order of arrival, at least one.
    reliable : mapping of str to bool
        Whether each publisher, by its node's name, is reliable.
    motion : FrameMotion
        What is known of the frames.
    obstacle_max_range : float
        The costmap's [m].
    """

    scans: Sequence[ReceivedScan]
    reliable: Mapping[str, bool] = field(default_factory=dict)
    motion: FrameMotion = field(default_factory=FrameMotion)
    obstacle_max_range: float = 2.5


@dataclass(frozen=True, slots=True)
class Finding:
    """
    What one rule says.

    Attributes
    ----------
    rule : str
    verdict : Verdict
    reason : str
        A sentence with the values.
    consumers : tuple of str
        Whom it concerns, of ``CONSUMERS``.
    """

    rule: str
    verdict: Verdict
    reason: str
    consumers: tuple[str, ...] = CONSUMERS
