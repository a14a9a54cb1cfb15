"""Scans of sweeps that grow: sectors, their ages, and the finished scan that they do not touch."""

import math

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.matching.progressive import GrowingMatch
from panodepth_ros.nodes.depth import Depth
from panodepth_ros.nodes.panoramas import KINDS, PARTIAL
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.messages import panorama_info, to_nanoseconds, to_stamp

pytestmark = pytest.mark.ros

#: Too few rows to compare the eyes' exposure, which noise has nothing to tell of.
COLUMNS, ROWS, BEAMS = 360, 20, 180
STEP = 2 * math.pi / COLUMNS
R, PHI, DISPARITY = 0.3, math.radians(15.2), 26
DISTANCE = R * math.sin(PHI) / math.sin(PHI - DISPARITY * STEP / 2)
SCANS = ('scan', 'scan_partial', 'scan_partial_age')
START = 1000.0
#: Seconds that a column takes.
PACE = 0.01


class Bench:
    """A depth node between a publisher of growing panoramas and a listener."""

    def __init__(self, ros, topics=SCANS, **values):
        self.ros = ros
        overrides = [
            Parameter(name, value=value) for name, value in {'beams': BEAMS, **values}.items()
        ]
        self.depth = ros.add(Depth(context=ros.context, parameter_overrides=overrides))
        self.node = ros.node('panoramas')
        self.got = {topic: [] for topic in topics}
        for topic, messages in self.got.items():
            self.node.create_subscription(LaserScan, topic, messages.append, 100)
        self.out = {
            f'{name}/{kind}': self.node.create_publisher(KINDS[kind], f'{name}/{kind}', 10)
            for name in ('left', 'right', *PARTIAL)
            for kind in KINDS
        }
        ros.spin_until(
            lambda: (
                all(publisher.get_subscription_count() for publisher in self.out.values())
                and all(self.depth.count_subscribers(topic) for topic in self.got)
            ),
            'the graph',
        )
        rng = np.random.default_rng(3)
        self.wall = rng.integers(0, 255, (ROWS, COLUMNS), dtype=np.uint8)

    def send(self, count, *, start=START, whole=False, shift=DISPARITY):
        """Publish the pair of which the arm has passed so many columns, or the finished pair."""
        seen = np.arange(COLUMNS) >= COLUMNS - count
        header = Header(stamp=to_stamp(round((start + count * PACE) * 1e9)), frame_id='panodepth')
        for eye, sign in (('left', -1), ('right', 1)):
            image = self.wall if eye == 'left' else np.roll(self.wall, shift, axis=1)
            geometry = PanoramaGeometry(
                columns=COLUMNS,
                rows=ROWS,
                azimuth_column=COLUMNS / 2 + sign * PHI / STEP,
                focal_length_px=100.0,
                principal_row=11.5,
                arm_radius=R,
                principal_angle=sign * PHI,
                sweep_duration=count * PACE,
                ray_angle=np.where(seen, sign * PHI, np.nan),
            )
            name = eye if whole else f'partial/{eye}'
            self.out[f'{name}/camera_info'].publish(panorama_info(geometry, header))
            self.out[f'{name}/image'].publish(
                to_message(image, 'mono8', stamp=header.stamp, frame_id=header.frame_id)
            )

    def partial(self, count, **values):
        """Send a partial pair; return the sectors and their ages."""
        before = len(self.got['scan_partial_age'])
        self.send(count, **values)
        return self.sectors(before)

    def sectors(self, before):
        self.ros.spin_until(
            lambda: all(len(self.got[topic]) > before for topic in SCANS[1:]), 'sectors'
        )
        scan, age = (self.got[topic][before] for topic in SCANS[1:])
        assert scan.header == age.header
        return np.array(scan.ranges), np.array(age.ranges), scan

    def finish(self, **values):
        before = len(self.got['scan_partial_age']), len(self.got['scan'])
        self.send(COLUMNS, whole=True, **values)
        self.ros.spin_until(lambda: len(self.got['scan']) > before[1], 'the scan')
        return self.got['scan'][before[1]], self.sectors(before[0])


def test_sectors_come_while_the_sweep_grows_and_the_finished_scan_is_as_ever(ros):
    bench = Bench(ros)
    known = []
    for count in (100, 180, 220, 260, 300):
        ranges, age, scan = bench.partial(count)
        assert to_nanoseconds(scan.header.stamp) == round((START + count * PACE) * 1e9)
        assert len(ranges) == BEAMS
        assert np.array_equal(np.isnan(ranges), np.isnan(age))
        known.append(np.isfinite(ranges))
        assert ranges[known[-1]] == pytest.approx(DISTANCE, rel=0.02)
    assert not known[0].any(), 'nothing can be decided yet'
    counts = [int(beams.sum()) for beams in known]
    assert counts[3] > 0
    assert counts == sorted(counts)
    assert counts[-1] < BEAMS
    assert not (known[-2] & ~known[-1]).any(), 'sectors stay'
    assert not bench.got['scan'], 'a partial scan is not a scan'
    # Margins and farthest candidate come after the oldest frame of a match.
    ages = age[known[-1]]
    assert ages.min() >= (2 * 64 + 30) * PACE
    assert ages.max() <= 300 * PACE + 1e-3
    finished, (ranges, age, _) = bench.finish()
    assert bench.depth._sectors._growing.match.reused > 0
    assert np.array_equal(ranges, np.array(finished.ranges), equal_nan=True)
    assert np.isfinite(ranges).mean() > 0.95
    assert np.nanmax(age) <= COLUMNS * PACE + 1e-3

    alone = Bench(ros_again(ros, bench))
    alone.send(COLUMNS, whole=True)
    ros.spin_until(lambda: alone.got['scan'], 'the scan without partial panoramas')
    assert alone.got['scan'][0] == finished
    assert not alone.got['scan_partial'], 'nobody sent partial panoramas'


def ros_again(ros, bench):
    """Take a bench's nodes away, so that another one has the topics to itself."""
    for node in (bench.depth, bench.node):
        ros.executor.remove_node(node)
        ros.nodes.remove(node)
        node.destroy_node()
    return ros


def test_sectors_that_nobody_hears_are_matched_for_the_finished_scan_but_not_measured(
    ros, monkeypatch
):
    measured = []
    monkeypatch.setattr(GrowingMatch, 'so_far', lambda *_, **__: measured.append(True))
    bench = Bench(ros, topics=('scan',))
    bench.send(300)
    sectors = bench.depth._sectors
    ros.spin_until(lambda: sectors._growing and sectors._growing.match.ready.any(), 'a match')
    bench.send(COLUMNS, whole=True)
    ros.spin_until(lambda: bench.got['scan'], 'the scan')
    assert sectors._growing.match.reused > 0
    assert not measured


def test_finished_sweep_that_began_at_another_time_is_matched_by_itself(ros):
    bench = Bench(ros)
    bench.partial(300)
    growing = bench.depth._sectors._growing.match
    finished, _ = bench.finish(start=START + 10, shift=16)
    assert growing.ready.any()
    nearer = R * math.sin(PHI) / math.sin(PHI - 16 * STEP / 2)
    assert np.nanmedian(finished.ranges) == pytest.approx(nearer, rel=0.02)


def test_next_sweep_begins_without_the_sectors_of_the_last_one(ros):
    bench = Bench(ros)
    bench.partial(300)
    _, (ranges, _, _) = bench.finish()
    assert np.isfinite(ranges).mean() > 0.95
    ranges, _, _ = bench.partial(100, start=START + 10)
    assert np.isnan(ranges).all()


def test_pair_that_comes_after_its_sweep_is_finished_changes_nothing(ros):
    bench = Bench(ros)
    bench.partial(300)
    bench.finish()
    published = len(bench.got['scan_partial'])
    match, done = bench.depth._sectors.match, []
    bench.depth._sectors.match = lambda *job, **values: done.append(match(*job, **values))
    bench.send(320)
    ros.spin_until(lambda: done, 'the late pair')
    bench.partial(340, start=START + 10)
    assert len(bench.got['scan_partial']) == published + 1


class Robot:
    """Odometry of a robot, as it comes in a bag: the clock is that of the stamps."""

    def __init__(self, bench):
        self.bench = bench
        self.odom = bench.node.create_publisher(Odometry, 'odom', 100)
        bench.ros.spin_until(self.odom.get_subscription_count, 'the subscription')

    def drive(self, first, last, x=0.0):
        """Publish odometry from a time to another, and wait until it was taken."""
        standing = self.bench.depth._republisher._standing
        for time in np.arange(first, last, 0.5):
            message = Odometry(header=Header(stamp=to_stamp(round(time * 1e9)), frame_id='odom'))
            message.pose.pose.position.x = x
            message.pose.pose.orientation.w = 1.0
            self.odom.publish(message)
            self.bench.ros.spin_until(
                lambda time=time: standing._previous and standing._previous.time >= time - 1e-6,
                'the odometry',
            )


def finished_and_begun_anew(bench, count, turn):
    """Let a turn end and the next one begin; return the sectors of the new one."""
    start = START + turn * COLUMNS * PACE
    bench.finish(start=start - COLUMNS * PACE)
    return bench.partial(count, start=start)


def test_sectors_of_the_last_turn_stay_with_their_age_while_the_robot_is_promised_to_stand(ros):
    bench = Bench(ros, robot_stands_still=True, republish_period=0.0)
    bench.partial(100)
    ranges, age, _ = finished_and_begun_anew(bench, 100, 1)
    assert np.isfinite(ranges).mean() > 0.95
    assert age[np.isfinite(age)].min() > 100 * PACE, 'all of them are of the last turn'
    ranges, age, _ = bench.partial(260, start=START + COLUMNS * PACE)
    young = age <= 260 * PACE + 1e-3
    assert 0 < young.sum() < BEAMS
    assert np.isfinite(ranges).mean() > 0.95
    # What the new turn measures takes the place of the old: the wall has come nearer.
    bench.finish(start=START + COLUMNS * PACE)
    nearer = R * math.sin(PHI) / math.sin(PHI - 16 * STEP / 2)
    start = START + 2 * COLUMNS * PACE
    for count in (220, 260):
        ranges, age, _ = bench.partial(count, start=start, shift=16)
    young = age <= 260 * PACE + 1e-3
    assert np.median(ranges[young]) == pytest.approx(nearer, rel=0.02)
    assert np.nanmedian(ranges[~young]) == pytest.approx(DISTANCE, rel=0.02)


def test_sectors_measured_with_another_least_confidence_are_forgotten(ros):
    bench = Bench(ros, robot_stands_still=True, republish_period=0.0)
    bench.partial(100)
    bench.finish()
    bench.depth.set_parameters([Parameter('robot_stands_still', value=True)])
    ranges, _, _ = bench.partial(100, start=START + COLUMNS * PACE)
    assert np.isfinite(ranges).mean() > 0.95, 'measured in the same way'
    result = bench.depth.set_parameters([Parameter('min_confidence', value=0.4)])
    assert result[0].successful
    ranges, _, _ = bench.partial(120, start=START + COLUMNS * PACE)
    assert np.isnan(ranges).all(), 'all of them are of the last turn'


def test_sectors_of_the_last_turn_stay_as_far_as_odometry_proves_that_the_robot_stood(ros):
    bench = Bench(ros, republish_period=0.0, use_sim_time=True)
    clock = bench.node.create_publisher(Clock, 'clock', 10)
    robot = Robot(bench)

    def tick(time):
        clock.publish(Clock(clock=to_stamp(round(time * 1e9))))
        bench.ros.spin_until(
            lambda: bench.depth.get_clock().now().nanoseconds >= time * 1e9 - 1, 'the clock'
        )

    turn = COLUMNS * PACE
    bench.partial(100)
    robot.drive(START - 1, START + turn + 0.2)
    tick(START + turn + 0.2)
    ranges, _, _ = finished_and_begun_anew(bench, 100, 1)
    assert np.isfinite(ranges).mean() > 0.95, 'it stood all the time'
    robot.drive(START + turn + 0.3, START + turn + 0.4, x=0.5)
    robot.drive(START + turn + 0.5, START + turn + 3, x=0.5)
    tick(START + turn + 3)
    ranges, _, _ = bench.partial(260, start=START + turn)
    assert np.isnan(ranges).all(), 'all was measured, in part, before it moved'
    ranges, age, _ = bench.partial(358, start=START + turn)
    assert np.isfinite(ranges).any()
    assert np.nanmax(age) <= 358 * PACE - 0.5, 'measured since it stands'
