"""The last scan again: while odometry or a promise stands for it, else on request at most."""

import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from panodepth_ros.motion.standstill import StillLimits
from panodepth_ros.nodes.republisher import Republisher
from panodepth_ros.ros import qos
from panodepth_ros.ros.messages import to_nanoseconds

pytestmark = pytest.mark.ros
LIMITS = StillLimits(distance=0.01, turn=0.01, speed=0.01, turn_rate=0.01)


class Bench:
    """A node with a republisher, a robot with odometry, and a listener."""

    def __init__(self, ros, *, promised=False, period=0.05):
        self.ros = ros
        self.node = ros.node('depth')
        self.republisher = Republisher(self.node, period=period, limits=LIMITS, promised=promised)
        self.publisher = self.node.create_publisher(LaserScan, 'scan', qos.SCAN)
        self.robot = ros.node('robot')
        self.odom = self.robot.create_publisher(Odometry, 'odom', 10)
        self.got = []
        self.robot.create_subscription(LaserScan, 'scan', self.got.append, 10)
        self.client = self.robot.create_client(Trigger, 'depth/publish_last')
        ros.spin_until(
            lambda: (
                self.odom.get_subscription_count()
                and self.publisher.get_subscription_count()
                and self.client.service_is_ready()
            ),
            'the graph',
        )

    def now(self):
        return self.node.get_clock().now()

    def drive(self, x=0.0, speed=0.0):
        """Publish odometry and wait until it was taken."""
        before = len(self.republisher._standstill._heard)
        message = Odometry(header=Header(stamp=self.now().to_msg(), frame_id='odom'))
        message.pose.pose.position.x = x
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x = speed
        self.odom.publish(message)
        self.ros.spin_until(
            lambda: len(self.republisher._standstill._heard) > before, 'the odometry'
        )

    def take(self, stamp=None, *ranges):
        header = Header(stamp=stamp or self.now().to_msg(), frame_id='panodepth')
        scan = LaserScan(header=header, ranges=ranges or [1.0, 2.0])
        self.republisher.take([(self.publisher, scan)])

    def standing_until(self, condition):
        self.ros.spin_until(lambda: self.drive() or condition(), 'scans')

    def ask(self):
        return self.ros.result(self.client.call_async(Trigger.Request()))


def test_standing_robot_gets_the_scan_again_with_fresh_stamps(ros):
    bench = Bench(ros)
    bench.drive()
    bench.take()
    bench.standing_until(lambda: len(bench.got) >= 4)
    stamps = [to_nanoseconds(scan.header.stamp) for scan in bench.got]
    assert stamps == sorted(set(stamps))
    assert {tuple(scan.ranges) for scan in bench.got} == {(1.0, 2.0)}
    assert {scan.header.frame_id for scan in bench.got} == {'panodepth'}


def test_promise_replaces_odometry(ros):
    bench = Bench(ros, promised=True)
    bench.take()
    ros.spin_until(lambda: len(bench.got) >= 3, 'scans')


def _nothing_follows(bench, until):
    """Assert that nothing is published while many periods of the timer pass."""
    count = len(bench.got)
    start = bench.now().nanoseconds
    bench.ros.spin_until(
        lambda: until() or bench.now().nanoseconds - start > 0.4e9, 'eight periods'
    )
    assert len(bench.got) == count


def test_nothing_without_proof(ros):
    bench = Bench(ros)
    bench.take()
    ros.spin_until(lambda: bench.got, 'the scan itself')
    _nothing_follows(bench, lambda: False)


def test_moved_robot_gets_nothing_until_the_next_sweep(ros):
    bench = Bench(ros)
    bench.drive()
    bench.take()
    bench.standing_until(lambda: len(bench.got) >= 2)
    bench.drive(x=0.5)
    while bench.got:  # what was under way
        bench.got.clear()
        ros.executor.spin_once(timeout_sec=0.1)
    _nothing_follows(bench, bench.drive)
    answer = bench.ask()
    assert not answer.success
    assert answer.message == (
        'the last scan may no longer be true: the robot moved by 0.500 m; allowed: 0.01 m'
    )
    bench.take()
    bench.standing_until(lambda: len(bench.got) >= 3)


def test_request_without_odometry_is_taken_at_its_word(ros):
    bench = Bench(ros, period=0.0)
    answer = bench.ask()
    assert (answer.success, answer.message) == (False, 'there is no scan yet')
    bench.take()
    ros.spin_until(lambda: len(bench.got) == 1, 'the scan itself')
    assert bench.ask().success
    ros.spin_until(lambda: len(bench.got) == 2, 'the scan again')
    first, second = (to_nanoseconds(scan.header.stamp) for scan in bench.got)
    assert second > first


def test_timer_waits_while_a_newer_scan_is_made(ros):
    bench = Bench(ros, promised=True)
    bench.republisher.pause(True)
    bench.take()
    ros.spin_until(lambda: bench.got, 'the scan itself')
    _nothing_follows(bench, lambda: False)
    bench.republisher.pause(False)
    ros.spin_until(lambda: len(bench.got) >= 2, 'the scan again')


def test_timer_waits_for_every_scan_that_is_made(ros):
    bench = Bench(ros, promised=True)
    bench.republisher.pause(True)
    bench.republisher.pause(True)
    bench.take()
    ros.spin_until(lambda: bench.got, 'the scan itself')
    bench.republisher.pause(False)
    _nothing_follows(bench, lambda: False)
    bench.republisher.pause(False)
    ros.spin_until(lambda: len(bench.got) >= 2, 'the scan again')


@pytest.mark.parametrize('period', [0.05, 0.0], ids=['timer', 'request'])
def test_stamps_never_go_back_when_a_sweep_ended_before_the_last_was_published_again(ros, period):
    bench = Bench(ros, promised=True, period=period)
    ended = bench.now().to_msg()  # while the older scan is published again
    bench.take()
    if not period:
        assert bench.ask().success
    ros.spin_until(lambda: len(bench.got) >= 2, 'the scan again')
    bench.republisher.pause(True)
    bench.take(ended, 3.0)
    ros.spin_until(lambda: list(bench.got[-1].ranges) == [3.0], 'the newer scan')
    bench.republisher.pause(False)
    count = len(bench.got)
    if not period:
        assert bench.ask().success
    ros.spin_until(lambda: len(bench.got) > count, 'the newer scan again')
    stamps = [to_nanoseconds(scan.header.stamp) for scan in bench.got]
    assert stamps == sorted(set(stamps))
    assert list(bench.got[-1].ranges) == [3.0]
