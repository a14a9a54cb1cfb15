"""Notices that the arm was out of sight: its joint states were silent, or have another source."""

from __future__ import annotations

import time
from dataclasses import dataclass

from rclpy.node import Node

#: A process cannot die and be there again within this time [s].
_FASTEST_RESTART = 0.25


@dataclass(frozen=True, slots=True)
class Absence:
    """
    What went before a joint state.

    Attributes
    ----------
    seconds : float
        How long the arm was out of sight.
    restarted : bool
        Whether its driver has been started anew meanwhile.
    """

    seconds: float
    restarted: bool


class ArmWatch:
    """
    Watches who publishes the arm's joint states, and when.

    Parameters
    ----------
    node : rclpy.node.Node
        Subscribes to ``joint_states``.
    longest_gap : float
        A longer time between the stamps of two joint states is an absence [s].
    """

    def __init__(self, node: Node, longest_gap: float) -> None:
        self._node = node
        self._longest_gap = longest_gap
        self._sources: set[bytes] = set()
        self._heard: float | None = None
        self._newest = 0

    @property
    def silent(self) -> bool:
        """Whether the arm is out of sight now."""
        return self._heard is not None and time.monotonic() - self._heard > self._longest_gap

    def see(self, stamp: int) -> Absence | None:
        """
        Take note of a joint state of the arm.

        Parameters
        ----------
        stamp : int
            When its position was read [ns].

        Returns
        -------
        Absence or None
            The absence that it ends, if there was one.
        """
        heard, newest, now = self._heard, self._newest, time.monotonic()
        self._heard, self._newest = now, stamp
        if heard is not None and now - heard < _FASTEST_RESTART:
            return None
        sources = self.sources()
        restarted = heard is not None and not sources <= self._sources
        self._sources |= sources
        silence = (stamp - newest) * 1e-9 if heard is not None else 0.0
        if restarted or silence > self._longest_gap:
            return Absence(silence, restarted)
        return None

    def sources(self) -> set[bytes]:
        """Return who publishes joint states, as far as discovered."""
        publishers = self._node.get_publishers_info_by_topic('joint_states')
        return {bytes(publisher.endpoint_gid) for publisher in publishers}
