"""
Know when subscribers have taken a message, so that nothing sent is ever dropped.

DDS alone does not say. A reliable subscriber acknowledges a message when it is in its queue,
not when its callback has it, and a full queue drops its oldest message. So the sender keeps to
one message per topic under way and sends the next only after

1. every reliable subscriber has acknowledged it: it is in the queue; and
2. every node that subscribes has answered a call of its ``get_parameter_types`` service made
   after that. Its executor then went round once more, and one round takes a message from every
   subscription that has one before it comes to the services.

Hence not even a queue of depth 1 overflows, however slow the callbacks are, if the node spins
subscriptions and parameter services in one single-threaded executor, as rclpy and rclcpp do
unless told otherwise.

Not covered, but told by a warning: nodes without parameter services, and best-effort
subscribers. Not covered and not to be seen from outside: subscriptions with an executor of
their own, two nodes of one name, and what a node drops after its callback had it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Collection
from typing import Any

from rcl_interfaces.srv import GetParameterTypes
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import ReliabilityPolicy

from panodepth_ros.bag.storage import BagError

POLL = 0.05
"""Seconds between two looks at whether to stop and who is still there."""

DISCOVERY = 5.0
"""Seconds within which a subscriber's node shows its name and its services."""

PATIENCE = 60.0
"""Seconds until a subscriber that neither acknowledges nor answers is an error."""


class Interrupted(Exception):  # noqa: N818 - asked for, not an error
    """Waiting was ended from outside."""


class FlowControl:
    """
    Waits for subscribers.

    Parameters
    ----------
    node : rclpy.node.Node
        Node of the publishers.
    executor : rclpy.executors.SingleThreadedExecutor
        Spins the node while waiting.
    stop : threading.Event
        Makes any waiting raise :class:`Interrupted`.
    """

    def __init__(self, node: Node, executor: SingleThreadedExecutor, stop: threading.Event):
        self._node = node
        self._executor = executor
        self._stop = stop
        self._counts: dict[Publisher, int] = {}
        self._nodes: dict[Publisher, set[str]] = {}
        self._clients: dict[str, Client] = {}
        self._warned: set[str] = set()

    def wait(self, publishers: Collection[Publisher]) -> None:
        """
        Wait until what each publisher sent last has been taken by all its subscribers.

        Raises
        ------
        BagError
            If a subscriber shows no sign of life for :data:`PATIENCE`.
        Interrupted
            If told to stop.
        """
        self.wait_for_acknowledgement(publishers)
        self._ask({name for publisher in publishers for name in self._subscribers(publisher)})

    def wait_for_acknowledgement(self, publishers: Collection[Publisher]) -> None:
        """
        Wait until every reliable subscriber has in its queue what was sent.

        Raises
        ------
        BagError
            If one acknowledges nothing for ``PATIENCE`` seconds.
        """
        deadline = time.monotonic() + PATIENCE
        for publisher in publishers:
            while not publisher.wait_for_all_acked(Duration(seconds=POLL)):
                self._pause(0.0)
                if time.monotonic() > deadline:
                    raise BagError(
                        f'subscribers of {publisher.topic_name} have acknowledged nothing '
                        f'for {PATIENCE:g} s'
                    )

    def wait_for_subscribers(self, wanted: dict[Publisher, int]) -> None:
        """Wait until each publisher has at least so many subscribers."""
        missing = wanted
        while missing:
            missing = {p: n for p, n in missing.items() if p.get_subscription_count() < n}
            if missing:
                names = ', '.join(sorted(publisher.topic_name for publisher in missing))
                self._warn_once(f'waiting for subscribers of {names}')
            self._pause(POLL if missing else 0.0)

    def _pause(self, seconds: float) -> None:
        if self._stop.wait(seconds):
            raise Interrupted

    def _warn_once(self, text: str) -> None:
        if text not in self._warned:
            self._warned.add(text)
            self._node.get_logger().warning(text)

    def _subscribers(self, publisher: Publisher) -> set[str]:
        """Names of the nodes that subscribe and can be asked, looked up when they change."""
        count = publisher.get_subscription_count()
        if self._counts.get(publisher) != count:
            self._nodes[publisher] = self._look_up(publisher, count)
            self._counts[publisher] = count
        return self._nodes[publisher]

    def _look_up(self, publisher: Publisher, count: int) -> set[str]:
        topic = publisher.topic_name
        deadline = time.monotonic() + DISCOVERY
        while True:
            endpoints = self._node.get_subscriptions_info_by_topic(topic)
            names = {
                f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
                for endpoint in endpoints
            }
            named = {name for name in names if '_UNKNOWN_' not in name}
            ready = {name for name in named if self._client(name).service_is_ready()}
            late = time.monotonic() > deadline
            if late or (len(endpoints) >= count and ready == names):
                break
            self._pause(POLL)
        for name in sorted(names - ready):
            self._warn_once(
                f'{name if name in named else "a subscriber without a name"} takes {topic} but '
                f'has no parameter services to ask; if it is slow it may lose messages'
            )
        if any(e.qos_profile.reliability != ReliabilityPolicy.RELIABLE for e in endpoints):
            self._warn_once(f'{topic} has a best-effort subscriber; it may lose messages')
        return ready

    def _client(self, name: str) -> Client:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(
                GetParameterTypes, f'{name}/get_parameter_types'
            )
        return self._clients[name]

    def _ask(self, names: Collection[str]) -> None:
        """Call a service of each node and wait for the answers of those that still live."""
        futures: dict[str, Any] = {
            name: self._client(name).call_async(GetParameterTypes.Request()) for name in names
        }
        deadline = time.monotonic() + PATIENCE
        while futures:
            self._executor.spin_once(timeout_sec=POLL)
            self._pause(0.0)
            for name, future in list(futures.items()):
                if future.done():
                    del futures[name]
                elif not self._client(name).service_is_ready():
                    self._client(name).remove_pending_request(future)
                    del futures[name]
                elif time.monotonic() > deadline:
                    raise BagError(f'node {name} has not answered for {PATIENCE:g} s')
