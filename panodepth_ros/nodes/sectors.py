"""Scans of sweeps that still grow: the newest measurement of each sector, with its age."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import numpy.typing as npt
from rclpy.node import Node
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching import Correspondence
from panodepth_ros.matching.interface import candidate_range
from panodepth_ros.matching.progressive import MARGIN, GrowingMatch
from panodepth_ros.nodes.panoramas import KINDS, PARTIAL, read_panorama
from panodepth_ros.ros import qos
from panodepth_ros.ros.messages import laser_scan, to_nanoseconds, values_of_scan
from panodepth_ros.ros.sync import StampMatcher
from panodepth_ros.scan.beams import ScanSettings
from panodepth_ros.scan.sectors import SectorScan, columns_of_beams, oldest_of_columns

Ranges = npt.NDArray[np.float32]
Measure = Callable[[Correspondence, PanoramaGeometry, PanoramaGeometry], Ranges]
#: Sweeps whose starts are closer than this are one: a duration in seconds is rounded [ns].
_SAME_START = 1_000_000


class _Growing:
    """The sweep under construction: what is matched of it, and when its columns were exposed."""

    def __init__(self, start: int, rows: int, columns: int) -> None:
        self.start = self._newest = start
        self.shape = rows, columns
        self.match = GrowingMatch(rows, columns)
        self.time = np.zeros(columns, np.int64)
        self.finished = False

    def is_of(self, left: Panorama, stamp: int) -> bool:
        """Whether a left panorama whose newest frame has this stamp [ns] is of this sweep."""
        begun = abs(_start_of(left, stamp) - self.start) <= _SAME_START
        return begun and left.image.shape[:2] == self.shape

    def see(self, seen: npt.NDArray[np.bool_], stamp: int) -> None:
        """Note the columns that have come since the last time, as old as they may be."""
        self.time[seen & (self.time == 0)] = self._newest
        self._newest = stamp


def _start_of(left: Panorama, stamp: int) -> int:
    """When the sweep began whose newest frame has this stamp [ns]."""
    return stamp - round(left.geometry.sweep_duration * 1e9)


class Sectors:
    """
    Matches partial panoramas as they come and publishes ``scan_partial`` and its ages.

    Parameters
    ----------
    node : rclpy.node.Node
    beams : int
        Beams of the scan.
    earliest : callable
        Gives, from the start of the current sweep [ns], the time before which measurements no
        longer count [ns].
    offer : callable
        Called with the messages of a partial pair; to be handed to :meth:`match` in time.
    """

    def __init__(
        self,
        node: Node,
        *,
        beams: int,
        earliest: Callable[[int], int],
        offer: Callable[[dict[Hashable, Any]], object],
    ) -> None:
        self._earliest = earliest
        self._offer = offer
        self._scan = SectorScan(beams)
        self._way: Hashable = None
        self._growing: _Growing | None = None
        self._heard = False
        self._publisher = node.create_publisher(LaserScan, 'scan_partial', qos.SCAN)
        self._age_publisher = node.create_publisher(LaserScan, 'scan_partial_age', qos.SCAN)
        topics = tuple(f'{name}/{kind}' for name in PARTIAL for kind in KINDS)
        self._matcher = StampMatcher(topics, depth=2)
        for topic in topics:
            node.create_subscription(
                KINDS[topic.rpartition('/')[2]],
                topic,
                lambda message, topic=topic: self._on(topic, message),
                qos.PANORAMAS,
            )

    def _on(self, topic: str, message: Any) -> None:
        messages = self._matcher.add(topic, message)
        if messages is not None:
            self._heard = True
            self._offer(messages)

    def measure_by(self, way: Hashable) -> None:
        """Forget what was measured in another way, as with another least confidence."""
        if way != self._way:
            self._way = way
            self._scan = SectorScan(self._scan.ranges.size)

    def match(
        self,
        messages: dict[Hashable, Any],
        measure: Measure,
        settings: ScanSettings,
        *,
        threads: int,
    ) -> None:
        """
        Match what a partial pair has more than the last one, and publish.

        Parameters
        ----------
        messages : dict
            By topic.
        measure : callable
            Makes ranges of a match.
        settings : ScanSettings
        threads : int
            Threads that match.

        Raises
        ------
        ValueError
            If the messages do not make a pair.
        """
        left, right = (read_panorama(messages, name) for name in PARTIAL)
        header = messages[f'{PARTIAL[0]}/image'].header
        stamp = to_nanoseconds(header.stamp)
        growing = self._sweep_of(left, stamp)
        if growing.finished:
            return  # while this pair waited
        growing.match.add(left, right, threads=threads)
        growing.see(left.geometry.seen, stamp)
        if not self._is_heard():
            return
        matched, pair = growing.match, (left.geometry, right.geometry)
        if matched.ready.any():
            columns = columns_of_beams(left.geometry, settings)
            decided = np.all(matched.ready[columns], axis=1)
            ranges = measure(matched.so_far(threads=threads), *pair)
            self._take(decided, ranges, growing, pair, settings)
        self._publish(header, growing.start, left.geometry.sweep_duration, settings)

    def _is_heard(self) -> bool:
        """Whether anybody listens to what is published here."""
        publishers = self._publisher, self._age_publisher
        return any(publisher.get_subscription_count() for publisher in publishers)

    def whole_match(
        self, left: Panorama, right: Panorama, header: Header, *, threads: int
    ) -> Correspondence | None:
        """
        Match the pair of a finished sweep, with what was matched while it grew.

        Parameters
        ----------
        left, right : Panorama
            The pair.
        header : std_msgs.msg.Header
            Of its messages.
        threads : int
            Threads that match.

        Returns
        -------
        Correspondence or None
            Bit by bit that of :func:`panodepth_ros.matching.match`; None if nothing was.

        Raises
        ------
        ValueError
            If the panoramas are not a pair or too small.
        """
        growing = self._growing
        if growing is None or not growing.is_of(left, to_nanoseconds(header.stamp)):
            return None
        return growing.match.finish(left, right, threads=threads)

    def finish(
        self,
        left: Panorama,
        right: Panorama,
        ranges: Ranges,
        header: Header,
        settings: ScanSettings,
    ) -> None:
        """Take the scan of a whole sweep, if there ever were partial panoramas."""
        if not self._heard:
            return
        stamp = to_nanoseconds(header.stamp)
        growing = self._sweep_of(left, stamp)
        growing.finished = True
        seen = left.geometry.seen
        growing.see(seen, stamp)
        decided = np.any(seen[columns_of_beams(left.geometry, settings)], axis=1)
        self._take(decided, ranges, growing, (left.geometry, right.geometry), settings)
        self._publish(header, growing.start, left.geometry.sweep_duration, settings)

    def _sweep_of(self, left: Panorama, stamp: int) -> _Growing:
        if self._growing is None or not self._growing.is_of(left, stamp):
            self._growing = _Growing(_start_of(left, stamp), *left.image.shape[:2])
        return self._growing

    def _take(
        self,
        decided: npt.NDArray[np.bool_],
        ranges: Ranges,
        growing: _Growing,
        pair: tuple[PanoramaGeometry, PanoramaGeometry],
        settings: ScanSettings,
    ) -> None:
        columns = columns_of_beams(pair[0], settings)
        # A column that was not seen has no part in anything: it is as new as can be.
        time = np.where(pair[0].seen, growing.time, np.iinfo(np.int64).max)
        first, last = candidate_range(*pair)
        oldest = oldest_of_columns(time, min(first, 0) - MARGIN, max(last, 0) + MARGIN)
        self._scan.take(decided, ranges, oldest[columns].min(axis=1))

    def _publish(
        self, header: Header, start: int, duration: float, settings: ScanSettings
    ) -> None:
        self._scan.forget_before(self._earliest(start))
        scan = laser_scan(self._scan.ranges, settings, header, duration)
        self._publisher.publish(scan)
        age = self._scan.age(to_nanoseconds(header.stamp))
        self._age_publisher.publish(values_of_scan(age, scan))
