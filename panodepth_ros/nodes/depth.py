"""The depth node: a pair of panoramas in, depth image, confidence, points and laser scan out."""

from __future__ import annotations

import time
import traceback
from collections.abc import Hashable
from contextlib import ExitStack
from typing import Any

import numpy as np
import numpy.typing as npt
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2
from std_msgs.msg import Header

from panodepth_ros.geometry import PanoramaGeometry, Points, check_pair, distance_stddev
from panodepth_ros.matching import (
    Correspondence,
    match,
    prepare,
    triangulate_match,
    window_geometry,
)
from panodepth_ros.mosaic.rig import panorama_names
from panodepth_ros.nodes.depth_settings import DepthParameters
from panodepth_ros.nodes.latecomer import Latecomer
from panodepth_ros.nodes.panoramas import KINDS, read_panorama
from panodepth_ros.nodes.republisher import Republisher
from panodepth_ros.nodes.sectors import Sectors
from panodepth_ros.nodes.worker import Worker
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import ERROR, OK, Report, publish_diagnostics
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.messages import laser_scan, values_of_scan
from panodepth_ros.ros.parameters import declare_parameters
from panodepth_ros.ros.pointcloud import point_cloud
from panodepth_ros.ros.process import ending_at_once, run_node
from panodepth_ros.ros.sync import StampMatcher
from panodepth_ros.scan.beams import beam_confidence, laser_ranges
from panodepth_ros.scan.uncertainty import scan_with_stddev

Ranges = npt.NDArray[np.float32]
#: The worker's kinds of jobs: the panoramas of a finished sweep, and of one that grows.
_SWEEP, _PARTIAL = 'sweep', 'partial'


def _prepare(method: str) -> None:
    with ending_at_once():  # it may take half a minute of a compiler
        prepare(method)


class Depth(Node):
    """Matches panoramas and publishes depth and scan. Topics and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        self._resources = ExitStack()  # first: the context may destroy a half-built node
        super().__init__(
            'depth', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(
            self, DepthParameters, self._on_parameters, lambda proposed: _prepare(proposed.method)
        )
        start = time.monotonic()
        _prepare(self._settings.method)
        self._panoramas = panorama_names(
            self._settings.further_pairs, center=self._settings.use_center
        )
        topics = tuple(f'{name}/{kind}' for name in self._panoramas for kind in KINDS)
        self._matcher = StampMatcher(topics, depth=4, report=self._on_incomplete)
        self._depth_publisher = self.create_publisher(Image, 'depth/image', qos.PANORAMAS)
        self._confidence_publisher = self.create_publisher(
            Image, 'depth/confidence', qos.PANORAMAS
        )
        self._info_publisher = self.create_publisher(
            CameraInfo, 'depth/camera_info', qos.PANORAMAS
        )
        self._points_publisher = self.create_publisher(PointCloud2, 'points', qos.PANORAMAS)
        self._scan_publisher = self.create_publisher(LaserScan, 'scan', qos.SCAN)
        self._stddev_publisher = self.create_publisher(LaserScan, 'scan_stddev', qos.SCAN)
        self._outcome = Report(OK, 'no panoramas received yet')
        publish_diagnostics(self, 'matching', lambda: self._outcome)
        self._republisher = Republisher(
            self,
            period=self._settings.republish_period,
            limits=self._settings.still_limits(),
            promised=self._settings.robot_stands_still,
        )
        self._passed_over = 0
        self._worker = Worker('matching', self._run, self._on_failure, (_SWEEP, _PARTIAL))
        self._resources.callback(self._worker.close)
        self._latecomer = Latecomer(self, self._scan_publisher)
        self._sectors = Sectors(
            self,
            beams=self._settings.beams,
            earliest=self._republisher.earliest,
            offer=lambda messages: self._worker.put(_PARTIAL, messages),
        )
        for topic in topics:
            kind = KINDS[topic.rpartition('/')[2]]
            self.create_subscription(
                kind,
                topic,
                lambda message, topic=topic: self._on(topic, message),
                qos.PANORAMAS,
                event_callbacks=SubscriptionEventCallbacks(
                    matched=lambda status: self._latecomer.heard(status.current_count_change)
                ),
            )
        self.get_logger().info(
            f'ready; matching by {self._settings.method}, '
            f'prepared in {time.monotonic() - start:.1f} s'
        )

    def _on_parameters(self, parameters: DepthParameters) -> None:
        self._settings = parameters
        self._republisher.configure(parameters.still_limits(), parameters.robot_stands_still)

    def _on_incomplete(self, missing: list[Hashable]) -> None:
        self.get_logger().warning(
            f'a later sweep has come, but not yet {", ".join(map(str, missing))} of the last one; '
            'nothing is published of an incomplete sweep'
        )

    def _on(self, topic: str, message: Any) -> None:
        messages = self._matcher.add(topic, message)
        if messages is None:
            return
        self._latecomer.served()
        self._republisher.pause(True)
        if self._worker.put(_SWEEP, messages):
            self._republisher.pause(False)  # for the sweep that gives its place up
            self._passed_over += 1
            self.get_logger().warning(
                'matching takes longer than sweeps do: only the newest is matched, '
                f'{self._passed_over} passed over so far'
            )

    def _run(self, kind: Hashable, messages: dict[Any, Any]) -> None:
        """Do the worker's jobs, in a thread of their own, so that services stay answered."""
        parameters = self._settings
        self._sectors.measure_by(parameters.way_of_measuring())
        if kind == _PARTIAL:
            self._sectors.match(
                messages,
                lambda matched, left, right: _scan_of(matched, left, right, parameters)[1],
                parameters.scan_settings(),
                threads=parameters.threads,
            )
            return
        try:
            self._match(messages, parameters)
        finally:
            self._republisher.pause(False)

    def _on_failure(self, error: Exception) -> None:
        """Tell of panoramas that came to nothing; the next ones are matched all the same."""
        if not self.context.ok():
            return  # shut down meanwhile
        if isinstance(error, ValueError):
            what = f'panoramas refused: {error}'
            self.get_logger().error(f'panoramas refused, nothing is published: {error}')
        else:
            what = f'matching failed: {type(error).__name__}: {error}'
            trace = ''.join(traceback.format_exception(error))
            self.get_logger().error(f'matching failed, nothing is published: {trace}')
        self._outcome = Report(ERROR, what)

    def _match(self, messages: dict[Any, Any], parameters: DepthParameters) -> None:
        start = time.monotonic()
        header = messages['left/image'].header
        left, right, *further = (read_panorama(messages, name) for name in self._panoramas)
        check_pair(left.geometry, right.geometry)
        matched = None
        if parameters.method == 'semiglobal' and not further:
            matched = self._sectors.whole_match(left, right, header, threads=parameters.threads)
        if matched is None:
            matched = match(
                left,
                right,
                further=further,
                method=parameters.method,
                threads=parameters.threads,
            )
        points, ranges, beam_stddev = _scan_of(matched, left.geometry, right.geometry, parameters)
        settings = parameters.scan_settings()
        self._tell_of_gaps(settings.beams, left.geometry.columns)
        scan = laser_scan(ranges, settings, header, left.geometry.sweep_duration)
        stddev_scan = values_of_scan(beam_stddev, scan)
        self._republisher.take(
            [(self._scan_publisher, scan), (self._stddev_publisher, stddev_scan)]
        )
        self._sectors.finish(left, right, ranges, header, settings)
        with np.errstate(invalid='ignore'):
            trusted = matched.confidence >= parameters.min_confidence
        depth = np.where(trusted, points.radial_distance, np.nan).astype(np.float32)
        self._info_publisher.publish(messages['left/camera_info'])
        self._depth_publisher.publish(_image(depth, header))
        self._confidence_publisher.publish(_image(matched.confidence, header))
        if self._points_publisher.get_subscription_count():
            xyz = np.where(trusted[..., np.newaxis], points.xyz(), np.nan)
            noise = parameters.uncertainty().of_disparity(matched.confidence)
            stddev = distance_stddev(depth, left.geometry, noise)
            self._points_publisher.publish(
                point_cloud(xyz, left.image, matched.confidence, stddev, header)
            )
        summary = (
            f'{np.isfinite(depth).mean():.0%} of the pixels and '
            f'{np.isfinite(ranges).mean():.0%} of the beams hold a distance; '
            f'took {time.monotonic() - start:.2f} s'
        )
        self._outcome = Report(OK, summary)
        self.get_logger().info(summary)

    def _tell_of_gaps(self, beams: int, columns: int) -> None:
        if beams > columns:
            self.get_logger().warning(
                f'the scan has {beams} beams and the panoramas {columns} columns: beams that lie '
                f'between columns stay unknown; set beams to {columns} or fewer, or sweep in '
                'smaller steps',
                once=True,
            )

    def destroy_node(self) -> None:
        """Finish the pair being matched, end the thread, destroy the node; may run twice."""
        self._resources.close()
        super().destroy_node()


def _scan_of(
    matched: Correspondence,
    left: PanoramaGeometry,
    right: PanoramaGeometry,
    parameters: DepthParameters,
) -> tuple[Points, Ranges, Ranges]:
    """Points of a match, ranges of the scan, and their standard deviations."""
    settings = parameters.scan_settings()
    points = triangulate_match(matched, left, right, threads=parameters.threads)
    ranges = laser_ranges(points, matched.confidence, settings)
    ranges, stddev = scan_with_stddev(
        ranges,
        beam_confidence(points, matched.confidence, ranges, settings),
        (window_geometry(left), window_geometry(right)),
        parameters.uncertainty(),
        range_max=settings.range_max,
        allowed=parameters.allowed_stddev,
    )
    return points, ranges, stddev


def _image(values: np.ndarray[Any, np.dtype[np.float32]], header: Header) -> Image:
    return to_message(values, '32FC1', stamp=header.stamp, frame_id=header.frame_id)


def main(args: list[str] | None = None) -> int:
    """Run the depth node; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('depth', Depth, args)
