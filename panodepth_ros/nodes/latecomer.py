"""Asks the mosaicer for its last panoramas, which a depth node that was restarted has missed."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

#: Time between two requests [s], and how many are made until panoramas come.
_PERIOD, _REQUESTS = 1.0, 30
#: Periods to wait for somebody who hears the scan: what is published before that is lost.
_PATIENCE = 5


class Latecomer:
    """
    Calls ``mosaicer/publish_last`` once it is there, until panoramas come or there are none.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscribes to the panoramas.
    result : rclpy.publisher.Publisher
        What is made of them.
    """

    def __init__(self, node: Node, result: Publisher) -> None:
        self._result = result
        self._left, self._patience = _REQUESTS, _PATIENCE
        self._client = node.create_client(Trigger, 'mosaicer/publish_last')
        self._timer = node.create_timer(_PERIOD, self._ask)

    def served(self) -> None:
        """Ask no more: panoramas have come, or there are none."""
        self._timer.cancel()

    def _ask(self) -> None:
        if not self._client.service_is_ready():
            return
        if self._patience and not self._result.get_subscription_count():
            self._patience -= 1
            return
        self._left -= 1
        if self._left == 0:
            self.served()
        self._client.call_async(Trigger.Request()).add_done_callback(self._on_answer)

    def _on_answer(self, future: Any) -> None:
        if not future.result().success:
            self.served()
