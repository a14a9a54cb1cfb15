"""What a node tells ``/diagnostics``, once a second: how it is, in words, and its numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

#: Time between two reports [s].
PERIOD = 1.0


@dataclass(frozen=True, slots=True)
class Report:
    """
    How one part of a node is.

    Attributes
    ----------
    level : bytes
        ``OK``, ``WARN`` or ``ERROR``.
    message : str
        A few words for people: what it does, what it waits for, what is wrong.
    values : dict
        Named numbers and texts.
    hardware_id : str
        The device, if there is one.
    """

    level: bytes
    message: str
    values: dict[str, object] = field(default_factory=dict)
    hardware_id: str = ''


def publish_diagnostics(node: Node, part: str, report: Callable[[], Report]) -> None:
    """
    Publish on ``/diagnostics`` how a part of a node is, from now on.

    Parameters
    ----------
    node : rclpy.node.Node
        Its name stands before that of the part, as is usual: ``mosaicer: sweep``.
    part : str
        Name of the part.
    report : callable
        Asked once a second in the executor's thread.
    """
    publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def publish() -> None:
        told = report()
        status = DiagnosticStatus(level=told.level, message=told.message)
        status.name = f'{node.get_name()}: {part}'
        status.hardware_id = told.hardware_id
        status.values = [KeyValue(key=key, value=str(text)) for key, text in told.values.items()]
        message = DiagnosticArray(status=[status])
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    node.create_timer(PERIOD, publish)
