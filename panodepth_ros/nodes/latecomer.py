"""Asks the mosaicer for its last panoramas, which are missed if either node was restarted."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

#: Time between two requests [s], and how many are made until panoramas come.
_PERIOD, _REQUESTS = 1.0, 30
#: Periods to wait for somebody who hears the scan: what is published before that is lost.
_PATIENCE = 5


class Latecomer:
    """
    Calls ``mosaicer/publish_last`` until panoramas come, for half a minute.

    It does so from its start on, and whenever a mosaicer begins to be heard: one that was
    restarted may have published before that. Panoramas that come before anybody hears the scan
    made of them are asked for once more.

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

    def heard(self, change: int) -> None:
        """Ask anew if there are more publishers of panoramas than before."""
        if change > 0:
            self._left, self._patience = _REQUESTS, _PATIENCE
            self._timer.reset()

    def served(self) -> None:
        """Ask no more: panoramas have come, and what is made of them is heard or will not be."""
        if self._result.get_subscription_count() or not self._patience:
            self._timer.cancel()

    def _ask(self) -> None:
        if not self._client.service_is_ready():
            return
        if self._patience and not self._result.get_subscription_count():
            self._patience -= 1
            return
        self._left -= 1
        if self._left == 0:
            self._timer.cancel()
        self._client.call_async(Trigger.Request())
