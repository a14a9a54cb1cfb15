"""The ``check_scan`` executable: what a navigation stack would do with a LaserScan topic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from rclpy.task import Future
from sensor_msgs.msg import JointState, LaserScan

from panodepth_ros.motion.frames import FrameMotion
from panodepth_ros.ros.parameters import declare_parameters, parameter
from panodepth_ros.ros.process import run_node
from panodepth_ros.scan.consumers import by_consumer, check
from panodepth_ros.scan.findings import Finding, ReceivedScan, ScanStream, Verdict

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # not among the wheels on PyPI
    TFMessage = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckScanParameters:
    """Parameters of check_scan."""

    scans: int = parameter(3, 'Scans after which it ends', bounds=(1, 1000))
    timeout: float = parameter(
        60.0, 'Time after which it ends with what came', unit='s', bounds=(0.1, 86400.0)
    )
    base_frame: str = parameter('base_link', "The robot's frame, in which the scan must not turn")
    obstacle_max_range: float = parameter(
        2.5, "The costmap's obstacle_max_range", unit='m', bounds=(0.0, 1000.0)
    )


class CheckScan(Node):
    """Listens to ``scan`` and judges it; ``done`` becomes the exit code."""

    def __init__(self, **node_args: Any) -> None:
        super().__init__(
            'check_scan', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, CheckScanParameters)
        self.done = Future()
        self._scans: list[ReceivedScan] = []
        self._reliable: dict[str, bool] = {}
        self._motion = FrameMotion(
            base_frame=self._settings.base_frame, transforms_readable=TFMessage is not None
        )
        scan = self.create_subscription(LaserScan, 'scan', self._on_scan, qos_profile_sensor_data)
        self._topic = scan.topic_name
        self.create_subscription(
            JointState, 'joint_states', self._on_joints, qos_profile_sensor_data
        )
        if TFMessage is not None:
            latched = QoSProfile(
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
                history=HistoryPolicy.KEEP_LAST,
                depth=100,
            )
            self.create_subscription(TFMessage, '/tf', self.on_transforms, 100)
            self.create_subscription(TFMessage, '/tf_static', self.on_transforms, latched)
        self._timer = self.create_timer(self._settings.timeout, self._end)
        print(f'listening to {self._topic} for {self._settings.scans} scans', flush=True)

    def _on_scan(self, message: LaserScan) -> None:
        if self.done.done():
            return
        self._reliable |= {
            end.node_name: end.qos_profile.reliability == ReliabilityPolicy.RELIABLE
            for end in self.get_publishers_info_by_topic(self._topic)
        }
        stamp = message.header.stamp
        self._scans.append(
            ReceivedScan(
                stamp=stamp.sec + 1e-9 * stamp.nanosec,
                received=self.get_clock().now().nanoseconds * 1e-9,
                frame_id=message.header.frame_id,
                angle_min=message.angle_min,
                angle_max=message.angle_max,
                angle_increment=message.angle_increment,
                time_increment=message.time_increment,
                scan_time=message.scan_time,
                range_min=message.range_min,
                range_max=message.range_max,
                ranges=np.array(message.ranges, np.float32),
                intensities=len(message.intensities),
            )
        )
        if len(self._scans) >= self._settings.scans:
            self._end()

    def _on_joints(self, message: JointState) -> None:
        for name, position in zip(message.name, message.position, strict=False):
            self._motion.add_joint(name, position)

    def on_transforms(self, message: Any) -> None:
        """Take the transforms of a tf2_msgs/TFMessage."""
        for stamped in message.transforms:
            q = stamped.transform.rotation
            self._motion.add_transform(
                stamped.header.frame_id, stamped.child_frame_id, (q.x, q.y, q.z, q.w)
            )

    def _end(self) -> None:
        """Judge what came, print it, and be done."""
        self._timer.cancel()
        if not self._scans:
            publishers = [end.node_name for end in self.get_publishers_info_by_topic(self._topic)]
            names = ', '.join(publishers) or 'nobody'
            print(
                f'FAIL     no scan on {self._topic} within {self._settings.timeout:g} s; '
                f'{names} publishes it',
                flush=True,
            )
            self.done.set_result(1)
            return
        findings = check(
            ScanStream(
                scans=self._scans,
                reliable=self._reliable,
                motion=self._motion,
                obstacle_max_range=self._settings.obstacle_max_range,
            )
        )
        print(as_text(findings), flush=True)
        self.done.set_result(int(any(f.verdict is Verdict.FAIL for f in findings)))


def as_text(findings: list[Finding]) -> str:
    """Findings as lines for people: one a rule, then one a consumer."""
    lines = [f'{f.verdict.value:8} {f.rule}: {f.reason}' for f in findings]
    lines.append('')
    for consumer, (verdict, rules) in by_consumer(findings).items():
        why = '' if verdict is Verdict.PASS else f' ({", ".join(rules)})'
        lines.append(f'{verdict.value:8} {consumer}{why}')
    return '\n'.join(lines)


def main(args: list[str] | None = None) -> int:
    """Run the check; the exit code is 0 if nothing failed."""
    return run_node('check_scan', CheckScan, args, result=lambda node: node.done)
