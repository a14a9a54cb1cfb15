"""Replay a bag: with its own timing, or as fast as its subscribers take it."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from panodepth_ros.bag.flow_control import FlowControl, Interrupted
from panodepth_ros.bag.storage import BagError, chosen_connections, opened, raw_messages
from panodepth_ros.bag.types import check_topic_name, message_class

QUEUE_DEPTH = 1000
"""Messages of a topic that wait for slow acknowledgements in a replay with timing."""

CLOCK_PERIOD = 0.01
"""Longest pause of ``/clock`` in a replay with timing [s]."""

Message = tuple[Publisher, int, bytes]
"""Where to publish, time in the bag in nanoseconds, serialised message."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """
    What to replay, and how.

    Parameters
    ----------
    path : Path
        The bag's folder, or one of its files.
    topics, exclude : collection of str
        Topics of the bag to play, all if empty, and topics to leave out.
    remap : mapping of str to str
        Name in the bag to name to publish under.
    rate : float
        Seconds of the bag per second, > 0.
    as_fast_as_possible : bool
        Ignore the times; send what the subscribers have room for and lose nothing, within the
        limits told in :mod:`panodepth_ros.bag.flow_control`. Messages that follow each other
        in the bag go out together as far as they are of different topics.
    wait_for : mapping of str to int
        Published name to number of subscribers to wait for before the first message. If empty,
        a replay as fast as possible waits for one subscriber of every topic, one with timing
        for none.
    clock : bool
        Publish the bag's time on ``/clock``, for nodes with ``use_sim_time``.
    """

    path: Path
    topics: Collection[str] = ()
    exclude: Collection[str] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    rate: float = 1.0
    as_fast_as_possible: bool = False
    wait_for: Mapping[str, int] = field(default_factory=dict)
    clock: bool = False


def replay(what: Replay, *, stop: threading.Event) -> tuple[int, int]:
    """
    Replay a bag until its end, or until told to stop.

    Parameters
    ----------
    what : Replay
        The bag and the manner.
    stop : threading.Event
        Ends the replay early.

    Returns
    -------
    (sent, total) : (int, int)
        Number of messages sent and number there were to send. If they are equal, every
        reliable subscriber has acknowledged all of them.

    Raises
    ------
    BagError
        If the bag is missing, damaged or empty, a named topic is not in it or no topic is left,
        a name is impossible or two types meet under it, a message type is not installed, or a
        subscriber ceases to acknowledge or answer.
    """
    with opened(what.path) as reader:
        connections = chosen_connections(reader, what.path, what.topics, what.exclude)
        if not connections:
            raise BagError(f'no topic of bag {what.path} is left to replay')
        total = sum(connection.msgcount for connection in connections)
        context = rclpy.Context()
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = Node('player', context=context, start_parameter_services=False)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        player = Player(what, connections, node, FlowControl(node, executor, stop), stop)
        try:
            player.play(raw_messages(reader, what.path, connections))
        except Interrupted:
            pass
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown(context=context)
    return player.sent, total


def _publisher_qos(recorded: Iterable[Any], depth: int) -> QoSProfile:
    """Reliable, which serves every subscriber; latched if the recorded publishers were."""
    durabilities = {profile.durability.name for profile in recorded}
    latched = durabilities == {'TRANSIENT_LOCAL'}
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


class Player:
    """
    Publishers for a bag's topics, and when to use them.

    Parameters
    ----------
    what : Replay
        The manner.
    connections : list of rosbags connections
        The topics to play.
    node : rclpy.node.Node
        Node to publish from.
    flow_control : FlowControl
        Of the same node.
    stop : threading.Event
        Ends a replay with timing.
    """

    def __init__(
        self,
        what: Replay,
        connections: list[Any],
        node: Node,
        flow_control: FlowControl,
        stop: threading.Event,
    ):
        self._what = what
        self._log = node.get_logger()
        self._flow_control = flow_control
        self._stop = stop
        self.sent = 0
        unknown = set(what.remap) - {connection.topic for connection in connections}
        if unknown:
            raise BagError(f'{", ".join(sorted(unknown))} is not replayed, so not remapped')
        # A full history makes Fast DDS ask for the acknowledgement at once instead of once in
        # three seconds; as fast as possible has one message per topic under way.
        depth = 1 if what.as_fast_as_possible else QUEUE_DEPTH
        self._publishers: dict[str, Publisher] = {}
        for connection in connections:
            name = self._published_name(connection.topic)
            kind = message_class(connection.msgtype)
            if name in self._publishers:
                other = self._publishers[name].msg_type
                if other is not kind:
                    raise BagError(
                        f'{connection.topic} cannot be replayed as {name}: its type is '
                        f'{connection.msgtype}, that of another topic {other.__name__}'
                    )
            else:
                check_topic_name(name)
                qos = _publisher_qos(connection.ext.offered_qos_profiles, depth)
                self._publishers[name] = node.create_publisher(kind, name, qos)
        unknown = set(what.wait_for) - set(self._publishers)
        if unknown:
            raise BagError(
                f'{", ".join(sorted(unknown))} is not replayed, so not waited for; '
                f'replayed are {", ".join(sorted(self._publishers))}'
            )
        self._clock = node.create_publisher(Clock, '/clock', 10) if what.clock else None

    def _published_name(self, topic: str) -> str:
        return self._what.remap.get(topic, topic)

    def play(self, stored: Iterator[tuple[Any, int, bytes]]) -> None:
        """
        Wait for subscribers, publish all messages and wait until they are acknowledged.

        Raises
        ------
        Interrupted
            If told to stop.
        BagError
            As :func:`replay`.
        """
        wanted = dict(self._what.wait_for)
        if self._what.as_fast_as_possible and not wanted:
            wanted = dict.fromkeys(self._publishers, 1)
        self._flow_control.wait_for_subscribers(
            {self._publishers[name]: count for name, count in wanted.items()}
        )
        self._log.info(f'replaying {self._what.path} as {", ".join(sorted(self._publishers))}')
        messages = (
            (self._publishers[self._published_name(connection.topic)], stamp, data)
            for connection, stamp, data in stored
        )
        if self._what.as_fast_as_possible:
            for burst in bursts(messages):
                self._send(burst)
                self._flow_control.wait([publisher for publisher, _, _ in burst])
        else:
            for message in self._timed(messages):
                self._send([message])
            self._flow_control.wait_for_acknowledgement(list(self._publishers.values()))

    def _send(self, messages: list[Message]) -> None:
        self._tell_time(messages[-1][1])
        for publisher, _, data in messages:
            publisher.publish(data)
            self.sent += 1

    def _timed(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Each message when it is due."""
        begin, first = 0.0, None
        for message in messages:
            if first is None:
                begin, first = time.monotonic(), message[1]
            due = begin + (message[1] - first) * 1e-9 / self._what.rate
            while (left := due - time.monotonic()) > 0.0 and not self._stop.is_set():
                self._tell_time(message[1] - int(left * 1e9 * self._what.rate))
                self._stop.wait(min(left, CLOCK_PERIOD) if self._clock else left)
            if self._stop.is_set():
                raise Interrupted
            yield message

    def _tell_time(self, stamp: int) -> None:
        if self._clock:
            seconds, nanoseconds = divmod(stamp, 10**9)
            self._clock.publish(Clock(clock=Time(sec=seconds, nanosec=nanoseconds)))


def bursts(messages: Iterable[Message]) -> Iterator[list[Message]]:
    """Longest runs of messages with no publisher twice."""
    burst: list[Message] = []
    for message in messages:
        if any(message[0] is publisher for publisher, _, _ in burst):
            yield burst
            burst = []
        burst.append(message)
    if burst:
        yield burst
