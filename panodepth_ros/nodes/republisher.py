"""Scans for late joiners: the last one again with a fresh stamp, while the robot stands still."""

from __future__ import annotations

import copy
import threading
from collections.abc import Sequence
from typing import Any

from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_srvs.srv import Trigger

from panodepth_ros.motion.standing import Standing
from panodepth_ros.motion.standstill import Standstill, StillLimits
from panodepth_ros.ros.messages import odometry, to_nanoseconds, to_stamp


class Republisher:
    """
    Publishes the last messages of a node again.

    On a timer while ``odom`` proves that the robot has not moved since the end of the sweep, or
    a promise stands for it; by ``~/publish_last`` unless odometry speaks against it.
    Stamps never go back: a sweep that ended before an older scan was published again is stamped
    just after that.

    Parameters
    ----------
    node : rclpy.node.Node
    period : float
        Of the timer [s]; 0 for none.
    limits : StillLimits
        What counts as standing.
    promised : bool
        Whether the robot stands still by promise.
    """

    def __init__(self, node: Node, *, period: float, limits: StillLimits, promised: bool) -> None:
        self._node = node
        self._lock = threading.Lock()  # scans come from the node's worker
        self._standstill = Standstill(limits)
        self._standing = Standing(limits)
        self._promised = promised
        self._last: Sequence[tuple[Any, Any]] = ()
        self._newest_again = 0  # stamp of what was last published again [ns]
        self._pauses = 0
        node.create_subscription(
            OdometryMessage, 'odom', self._on_odometry, qos_profile_sensor_data
        )
        node.create_service(Trigger, '~/publish_last', self._on_request)
        if period > 0:
            node.create_timer(period, self._on_timer)

    def configure(self, limits: StillLimits, promised: bool) -> None:
        """Take new parameters; they act on what comes."""
        with self._lock:
            self._standstill.limits = self._standing.limits = limits
            self._promised = promised

    def take(self, messages: Sequence[tuple[Any, Any]]) -> None:
        """Publish messages of one sweep, each with its publisher, and keep them."""
        with self._lock:
            stamp = to_nanoseconds(messages[0][1].header.stamp)
            self._send(messages, max(stamp, self._newest_again + 1))
            self._last = messages
            self._standstill.since(stamp * 1e-9)

    def pause(self, paused: bool) -> None:
        """Hold the timer back while newer scans are made, whose stamps are older than now."""
        with self._lock:
            self._pauses += 1 if paused else -1

    def _on_odometry(self, message: OdometryMessage) -> None:
        with self._lock:
            self._standstill.add(odometry(message))
            self._standing.add(odometry(message))

    def earliest(self, start: int) -> int:
        """
        Time before which measurements no longer count [ns].

        That is the start of the current sweep, or earlier if the robot has provably stood for
        longer; later if it has moved meanwhile.
        """
        with self._lock:
            if self._promised:
                return 0
            proven = self._standing.proven_since(self._now().nanoseconds * 1e-9)
            return round(1e9 * max(min(start * 1e-9, proven), self._standing.moved))

    def _doubt(self) -> str:
        return '' if self._promised else self._standstill.doubt(self._now().nanoseconds * 1e-9)

    def _now(self) -> Any:
        return self._node.get_clock().now()

    def _on_timer(self) -> None:
        with self._lock:
            if self._last and not self._pauses and not self._doubt():
                self._publish()

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            doubt = self._doubt() if self._standstill.heard else ''
            if not self._last:
                response.message = 'there is no scan yet'
            elif doubt:
                response.message = f'the last scan may no longer be true: {doubt}'
            else:
                self._publish()
                response.success = True
                response.message = 'published'
        return response

    def _publish(self) -> None:
        self._newest_again = max(self._now().nanoseconds, self._newest_again + 1)
        self._send(self._last, self._newest_again)

    def _send(self, messages: Sequence[tuple[Any, Any]], stamp: int) -> None:
        """Publish messages with another stamp [ns]."""
        for publisher, message in messages:
            again = copy.copy(message)
            again.header = copy.copy(message.header)
            again.header.stamp = to_stamp(stamp)
            publisher.publish(again)
