"""No panoramas of a sweep during which the robot moved, as odometry and commands tell it."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from panodepth_ros.mosaic import Sweep
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.motion.standstill import GAP, Standstill, motion_at
from panodepth_ros.nodes.stepping_settings import SteppingParameters
from panodepth_ros.ros.messages import odometry

#: A robot that moved has to stand this long before a sweep may begin [s].
CALM = 1.0
#: How often it is looked whether a finished sweep has waited long enough for odometry [s].
_PERIOD = 0.25
_NEVER = -math.inf


class RobotWatch:
    """
    Watches ``odom`` and ``cmd_vel`` during sweeps, by ``robot_motion``.

    Odometry is judged from the last one before a sweep's first frame to the first one after its
    last frame, by its stamps. A finished sweep therefore waits for that one, no longer than
    ``GAP``, if there is odometry at all. A command counts when it arrives.

    Parameters
    ----------
    node : rclpy.node.Node
        Owns the subscriptions.
    builder : SweepBuilder
        Makes the sweeps.
    settings : SteppingParameters
        In force.
    look : callable
        Called when something was heard, or time has passed, that may decide about a sweep;
        calls :meth:`passed`.
    give_up : callable
        Called with a sentence when the robot has moved.
    """

    def __init__(
        self,
        node: Node,
        builder: SweepBuilder[Any],
        settings: SteppingParameters,
        look: Callable[[], None],
        give_up: Callable[[str], None],
    ) -> None:
        self._builder = builder
        self._look = look
        self._give_up = give_up
        self._watches = settings.robot_motion != 'ignore'
        self._required = settings.robot_motion == 'require'
        self._standstill = Standstill(settings.still_limits(), proof=self._required)
        self._followed: Sweep | None = None
        self._held: deque[Sweep] = deque()
        self._held_since = 0.0
        self._heard_at = _NEVER  # odometry
        self._moved, self._moved_at = '', _NEVER  # the last motion, by odometry or command
        self._commanded, self._commanded_at = '', _NEVER  # what the robot was last told
        self._told = ''  # what it was told during the sweep that is followed
        if not self._watches:
            return
        node.create_subscription(Odometry, 'odom', self._on_odometry, qos_profile_sensor_data)
        if settings.stamped_cmd_vel:
            node.create_subscription(
                TwistStamped, 'cmd_vel', lambda m: self._on_command(m.twist), 10
            )
        else:
            node.create_subscription(Twist, 'cmd_vel', self._on_command, 10)
        node.create_timer(_PERIOD, look)

    def configure(self, settings: SteppingParameters) -> None:
        """Take new limits; they act on what comes."""
        self._standstill.limits = settings.still_limits()

    @property
    def state(self) -> str:
        """What is known of the robot, for diagnostics."""
        if not self._watches:
            return 'not watched'
        if self._moves():
            return self._moved
        silent = time.monotonic() - self._heard_at
        return 'no odometry' if silent > GAP else 'stands, by odometry'

    def why_not_start(self) -> str:
        """Return why no sweep can begin now, empty if nothing is in the way."""
        if self._moves():
            return f'{self._moved}; a sweep needs a robot that stands'
        if self._required and time.monotonic() - self._heard_at > GAP:
            return 'robot_motion is require, and there is no odometry'
        return ''

    def passed(self, finished: list[Sweep], under_way: bool) -> list[Sweep]:
        """
        Take sweeps that came to their end.

        Parameters
        ----------
        finished : list of Sweep
        under_way : bool
            Whether a sweep is led, though it may have no frame yet.

        Returns
        -------
        list of Sweep
            Those, of now or before, during which the robot stood.
        """
        if not self._watches:
            return finished
        if not self._held:
            self._held_since = time.monotonic()
        self._held += finished
        passed: list[Sweep] = []
        while self._held:
            self._follow(self._held[0])
            if self._doubt() or self._may_be_told_more(self._held[0]):
                break
            passed.append(self._held.popleft())
            self._held_since = time.monotonic()
        if not self._held:
            self._follow(self._builder.sweep)
        doubt = self._doubt()
        if doubt and (self._followed is not None or under_way):
            self._move(doubt)
            self._give_up(doubt)
        if self._moves() and not under_way:
            # Of an arm that is followed, take no frame before the robot has stood for a while.
            self._builder.rest((self._builder.track.newest or 0) + round(CALM * 1e9))
        return passed

    def forget(self) -> None:
        """Forget the sweeps that are followed: they were given up."""
        self._held.clear()
        self._followed = None

    def _may_be_told_more(self, sweep: Sweep) -> bool:
        """Whether odometry from after the end of a finished sweep has to be waited for."""
        now = time.monotonic()
        if self._standstill.newest >= (sweep.end or 0) * 1e-9:
            return False
        if self._required:
            return True  # silence becomes a doubt
        return now - self._heard_at <= GAP and now - self._held_since <= GAP

    def _follow(self, sweep: Sweep | None) -> None:
        if sweep is self._followed:
            return
        self._followed = sweep
        self._told = ''
        if sweep is not None:
            self._standstill.since((sweep.start or 0) * 1e-9, 'the beginning of the sweep')
            fresh = time.monotonic() - self._commanded_at <= CALM
            self._told = self._commanded if fresh else ''

    def _doubt(self) -> str:
        """Why the robot may have moved during the sweep that is followed."""
        if self._followed is None:
            return self._moved if self._moves() else ''
        silent = time.monotonic() - self._heard_at
        if self._required and silent > GAP:
            return f'odometry has been silent for {silent:.1f} s'
        return self._told or self._standstill.told

    def _move(self, how: str) -> None:
        self._moved, self._moved_at = how, time.monotonic()

    def _moves(self) -> bool:
        return time.monotonic() - self._moved_at <= CALM

    def _on_odometry(self, message: Odometry) -> None:
        heard = odometry(message)
        self._heard_at = time.monotonic()
        self._standstill.add(heard)
        how = motion_at(heard.speed, heard.turn_rate, self._standstill.limits)
        if how:
            self._move(how)
        self._look()

    def _on_command(self, twist: Twist) -> None:
        how = motion_at(
            math.hypot(twist.linear.x, twist.linear.y),
            abs(twist.angular.z),
            self._standstill.limits,
        )
        self._commanded = how.replace('the robot', 'by cmd_vel the robot', 1)
        self._commanded_at = time.monotonic()
        if how:
            if self._followed is not None:
                self._told = self._commanded
            self._move(self._commanded)
        self._look()
