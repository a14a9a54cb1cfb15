"""Messages of several topics that carry the same stamp, brought together."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

from panodepth_ros.ros.messages import to_nanoseconds


class StampMatcher:
    """
    Collects one message a topic until all of one stamp are there.

    Parameters
    ----------
    topics : tuple of hashable
        What makes a set complete.
    depth : int
        Incomplete sets that are kept; the oldest beyond that are given up, and all that are older
        than a complete one.
    report : callable
        Called with the topics that the newest incomplete set lacks when a later one begins.
    """

    def __init__(
        self,
        topics: tuple[Hashable, ...],
        depth: int,
        report: Callable[[list[Hashable]], None] = lambda _: None,
    ) -> None:
        self._topics = topics
        self._depth = depth
        self._report = report
        self._sets: dict[int, dict[Hashable, Any]] = {}

    def add(self, topic: Hashable, message: Any) -> dict[Hashable, Any] | None:
        """Take one stamped message; return the set it completes, by topic, or None."""
        stamp = to_nanoseconds(message.header.stamp)
        newest = max(self._sets, default=stamp)
        if newest < stamp:
            self._report([name for name in self._topics if name not in self._sets[newest]])
        messages = self._sets.setdefault(stamp, {})
        messages[topic] = message
        if len(messages) == len(self._topics):
            self._sets = {key: kept for key, kept in self._sets.items() if key > stamp}
            return messages
        while len(self._sets) > self._depth:
            del self._sets[min(self._sets)]
        return None
