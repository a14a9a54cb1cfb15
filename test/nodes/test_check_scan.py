"""check_scan: a scan published over DDS in, verdicts and an exit code out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from fixtures.ros import started
from geometry_msgs.msg import TransformStamped
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Header

from panodepth_ros.nodes import check_scan
from panodepth_ros.nodes.check_scan import CheckScan
from panodepth_ros.ros import qos
from panodepth_ros.ros.messages import laser_scan
from panodepth_ros.scan.beams import ScanSettings

pytestmark = pytest.mark.ros


class Bench:
    """A checker and a publisher of scans."""

    def __init__(self, ros, *, profile=qos.SCAN, **values):
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.ros = ros
        self.checker = ros.add(CheckScan(context=ros.context, parameter_overrides=overrides))
        self.node = ros.node('scanner')
        self.publisher = self.node.create_publisher(LaserScan, 'scan', profile)
        ros.spin_until(self.publisher.get_subscription_count, 'the checker')

    def send(self, **change):
        now = self.node.get_clock().now().to_msg()
        ranges = np.full(720, 2.0, np.float32)
        scan = laser_scan(ranges, ScanSettings(), Header(stamp=now, frame_id='panodepth'), 12.5)
        for name, value in change.items():
            setattr(scan, name, value)
        self.publisher.publish(scan)

    def code(self, **change):
        """Send until there is a result: best effort may lose one."""
        self.ros.spin_until(lambda: self.send(**change) or self.checker.done.done(), 'the verdict')
        return self.checker.done.result()


def test_our_scan_passes(ros, capsys, monkeypatch):
    monkeypatch.setattr(check_scan, 'TFMessage', None)  # as on PyPI, wherever this runs
    assert Bench(ros).code() == 0
    out = capsys.readouterr().out
    assert 'FAIL' not in out
    assert 'PASS     rays: 720 rays' in out
    assert 'PASS     constant: N, angles' in out
    assert 'PASS     qos: reliable' in out
    assert 'UNKNOWN  frame: whether panodepth turns is not known: tf2_msgs' in out
    assert 'PASS     laser_geometry' in out


def test_doubled_last_ray_fails(ros, capsys):
    assert Bench(ros, scans=1).code(angle_max=math.pi, ranges=[2.0] * 721) == 1
    out = capsys.readouterr().out
    assert 'FAIL     rays: 721 rays are more than a turn' in out
    assert 'FAIL     slam_toolbox (rays)' in out


def test_best_effort_fails(ros, capsys):
    assert Bench(ros, scans=1, profile=qos_profile_sensor_data).code() == 1
    assert 'scanner publishes with best effort' in capsys.readouterr().out


def test_frame_of_a_turning_joint_fails(ros, capsys):
    bench = Bench(ros, scans=1)
    joints = bench.node.create_publisher(JointState, 'joint_states', 10)
    ros.spin_until(joints.get_subscription_count, 'the checker')
    for position in (0.0, 0.1):
        joints.publish(JointState(name=['panodepth_joint'], position=[position]))
    ros.spin_until(
        lambda: 'turns with the joint' in bench.checker._motion.judge('panodepth')[0], 'the joints'
    )
    assert bench.code() == 1
    assert 'turns with the joint panodepth_joint' in capsys.readouterr().out


def test_transforms_of_a_message_are_taken(ros, capsys):
    # tf2_msgs has no wheels: its message is a list of these.
    bench = Bench(ros, scans=1)
    for w, z in ((1.0, 0.0), (0.8, 0.6)):
        transform = TransformStamped(child_frame_id='panodepth')
        transform.header.frame_id = 'base_link'
        transform.transform.rotation.w, transform.transform.rotation.z = w, z
        bench.checker.on_transforms(SimpleNamespace(transforms=[transform]))
    assert bench.code() == 1
    assert 'turns by 73.7° with panodepth' in capsys.readouterr().out


def test_silence_fails_and_says_who_should_speak(ros, capsys):
    bench = Bench(ros, timeout=0.5)
    ros.spin_until(bench.checker.done.done, 'the end')
    assert bench.checker.done.result() == 1
    assert 'no scan on /scan within 0.5 s; scanner publishes it' in capsys.readouterr().out


def test_time_ends_it_with_what_came(ros, capsys):
    bench = Bench(ros, timeout=2.0, scans=1000)
    bench.send()
    ros.spin_until(bench.checker.done.done, 'the end')
    assert bench.checker.done.result() == 0
    assert 'UNKNOWN  constant: one scan only' in capsys.readouterr().out


@pytest.mark.launch
def test_as_a_process_on_a_remapped_topic(ros):
    node = ros.node('scanner')
    publisher = node.create_publisher(LaserScan, 'front/scan', qos.SCAN)
    with started(
        *('check_scan', '--ros-args', '-r', 'scan:=/front/scan', '-p', 'scans:=1'),
        exit_code=1,
    ) as running:
        ros.spin_until(publisher.get_subscription_count, 'the checker')
        ros.spin_until(  # best effort: what is sent before both sides know each other is lost
            lambda: publisher.publish(LaserScan()) or not running.running(), 'the verdict'
        )
        assert 'listening to /front/scan for 1 scans' in running.output
        assert "frame: frame_id is ''" in running.output


@pytest.mark.launch
def test_interrupted_it_has_not_passed(ros_domain):
    with started('check_scan', exit_code=1) as running:
        running.wait_for_output('listening')
