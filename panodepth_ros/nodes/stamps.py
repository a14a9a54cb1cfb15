"""Whether stamps of frames and joint states can be of clocks that agree with each other."""

from __future__ import annotations

from rclpy.node import Node

from panodepth_ros.mosaic.builder import Track

#: A message cannot come before its stamp; clocks of several computers agree this well [ns].
_TOLERANCE = 100_000_000


class StampCheck:
    """
    Doubts stamps by the clock of this computer, and those of frames by the joint states, too.

    Parameters
    ----------
    node : rclpy.node.Node
        Has the clock. The time of ``use_sim_time`` may come later than what it stamps, so it
        tells nothing.
    live : bool
        Whether frames and joint states come at once, not out of a bag as fast as it can be read.
    longest_gap : float
        How far frames may be ahead of the joint states [s].
    """

    def __init__(self, node: Node, *, live: bool, longest_gap: float) -> None:
        self._node = node
        self._live = live
        self._longest_gap = round(longest_gap * 1e9)

    def ahead(self, stamp: int) -> float:
        """By how much a stamp [ns] is ahead of this computer's clock [s]; 0 if it may be true."""
        clock = self._node.get_clock()
        if clock.ros_time_is_active:
            return 0.0
        ahead = stamp - clock.now().nanoseconds
        return ahead * 1e-9 if ahead > _TOLERANCE else 0.0

    def against_frame(self, stamp: int, track: Track) -> str:
        """Why a frame of a stamp [ns] is not used; empty if nothing is against it."""
        if self.ahead(stamp):
            return "stamped ahead of this computer's clock"
        newest = track.newest
        if self._live and newest is not None and stamp > newest + self._longest_gap:
            return 'stamped ahead of all joint states, by more than joint_state_gap'
        return ''
