"""Record topics into a bag, as serialised messages with the time at which they came in."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection
from functools import partial
from pathlib import Path

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

from panodepth_ros.bag.storage import BagError, BagWriter, rosbags
from panodepth_ros.bag.types import check_topic_name, message_class, register, stored_qos

DISCOVERY_PERIOD = 0.1
"""Seconds between two looks for topics that were asked for and are not there yet."""

QUEUE_DEPTH = 5000
"""Messages a topic may run ahead of the disk: ten seconds at 500 Hz."""

UNASKED = ('/rosout', '/parameter_events')
"""Topics that are recorded only if they are named."""


def subscription_qos(publishers: Collection[TopicEndpointInfo]) -> QoSProfile:
    """
    The strictest quality of service that every one of the publishers can serve.

    Reliable and transient local if all offer it; a deep history, so that a pause of this
    process loses nothing.
    """
    offers = [publisher.qos_profile for publisher in publishers]
    reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=QUEUE_DEPTH,
    )


class Recorder:
    """
    Subscribes to topics as they appear and writes what comes.

    Parameters
    ----------
    node : rclpy.node.Node
        Node to subscribe with.
    writer : BagWriter
        Open bag; stays open.
    topics : collection of str
        Names to record, resolved as the node's own; empty records every topic that is not
        hidden, but those of :data:`UNASKED`.
    """

    def __init__(self, node: Node, writer: BagWriter, topics: Collection[str]):
        self._node = node
        self._writer = writer
        self._wanted = {node.resolve_topic_name(topic) for topic in topics}
        typesys = rosbags('typesys')
        self._typestore = typesys.get_typestore(typesys.Stores.EMPTY)
        self._seen: set[str] = set()
        self.last_received = 0
        self._timer = self._node.create_timer(DISCOVERY_PERIOD, self._discover)
        self._discover()

    def _discover(self) -> None:
        for topic, types in self._node.get_topic_names_and_types():
            hidden = '/_' in topic or topic in UNASKED
            if topic in self._seen or (topic not in self._wanted if self._wanted else hidden):
                continue
            publishers = self._node.get_publishers_info_by_topic(topic)
            if publishers:
                self._seen.add(topic)
                self._subscribe(topic, types, publishers)
        if self._wanted and self._wanted == self._seen:
            self._node.destroy_timer(self._timer)

    def _subscribe(
        self, topic: str, types: list[str], publishers: list[TopicEndpointInfo]
    ) -> None:
        try:
            if len(types) > 1:
                raise BagError(f'publishers disagree about its type: {", ".join(types)}')
            register(types[0], self._typestore)
        except BagError as error:
            self._node.get_logger().error(f'{topic} is not recorded: {error}')
            return
        offered = [stored_qos(publisher.qos_profile) for publisher in publishers]
        self._writer.add_topic(topic, types[0], self._typestore, offered)
        self._node.create_subscription(
            message_class(types[0]),
            topic,
            partial(self._write, topic),
            subscription_qos(publishers),
            raw=True,
        )
        self._node.get_logger().info(f'recording {topic} ({types[0]})')

    def _write(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        self.last_received = info['received_timestamp']
        self._writer.write(topic, self.last_received, data)


def record(
    path: Path | str,
    topics: Collection[str] = (),
    *,
    stop: threading.Event,
    storage: str = 'mcap',
) -> int:
    """
    Record until told to stop; then the bag is complete.

    Messages count from the moment the recorder's subscription is matched, which takes up to a
    few seconds after a topic appears. What had come in before ``stop`` is written.

    Parameters
    ----------
    path : Path or str
        Bag to make; must not exist.
    topics : collection of str
        Topics; empty for all, see :class:`Recorder`.
    stop : threading.Event
        Ends the recording, within a tenth of a second.
    storage : str
        ``mcap`` or ``sqlite3``.

    Returns
    -------
    int
        Number of messages written.

    Raises
    ------
    BagError
        If a topic's name is impossible, or the bag exists, cannot be made or cannot be written.
    """
    for topic in topics:
        check_topic_name(topic)
    context = rclpy.Context()
    with BagWriter(path, storage) as writer:
        rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
        executor = SingleThreadedExecutor(context=context)
        node = Node('recorder', context=context, enable_rosout=False)
        executor.add_node(node)
        try:
            recorder = Recorder(node, writer, topics)
            while not stop.is_set():
                executor.spin_once(timeout_sec=DISCOVERY_PERIOD)
            drain(executor, recorder, writer)
        finally:
            executor.shutdown()
            node.destroy_node()
            rclpy.shutdown(context=context)
    return writer.message_count


def drain(executor: SingleThreadedExecutor, recorder: Recorder, writer: BagWriter) -> None:
    """Write what waits in the subscriptions' queues; a publisher may go on meanwhile."""
    told = time.time_ns()
    idle = 0
    while idle < 3 and recorder.last_received < told:  # a timer may take one of the turns
        before = writer.message_count
        executor.spin_once(timeout_sec=0.0)
        idle = idle + 1 if writer.message_count == before else 0
