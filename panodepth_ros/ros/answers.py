"""Answers that a worker thread gives to a service which awaits them."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future


def give(node: Node, future: Future, result: Any) -> None:
    """Give a future its result, from any thread, and wake the executor where it is awaited."""
    future.set_result(result)
    executor = node.executor
    if executor is not None:
        with suppress(rclpy_implementation.InvalidHandle):  # it was shut down meanwhile
            executor.wake()
