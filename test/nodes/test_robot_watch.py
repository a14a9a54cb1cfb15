"""Of a sweep during which the robot moved, by odometry or command, nothing is published."""

import math

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.mosaicer import COLUMNS, Bench, TurningBench
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry

from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import to_stamp

pytestmark = pytest.mark.ros


class Robot:
    """Publishes odometry, stamped as the rig of a bench is, and commands."""

    def __init__(self, bench, command=Twist):
        self.bench = bench
        node = bench.ros.node('robot')
        self.odom = node.create_publisher(Odometry, 'odom', 10)
        self.cmd_vel = node.create_publisher(command, 'cmd_vel', 10)
        bench.ros.spin_until(
            lambda: self.odom.get_subscription_count() and self.cmd_vel.get_subscription_count(),
            'the mosaicer',
        )

    def is_at(self, x=0.0, yaw=0.0, speed=0.0, later=0):
        message = Odometry()
        message.header.frame_id = 'odom'
        message.header.stamp = to_stamp(self.bench.rig.now + later * 10**6)
        message.pose.pose.position.x = x
        message.pose.pose.orientation.z = math.sin(yaw / 2)
        message.pose.pose.orientation.w = math.cos(yaw / 2)
        message.twist.twist.linear.x = speed
        self.odom.publish(message)
        standstill = self.bench.mosaicer._robot._standstill
        time = self.bench.rig.now * 1e-9 + later * 1e-3
        self.bench.ros.spin_until(
            lambda: standstill.newest == pytest.approx(time, abs=1e-5), 'odometry'
        )

    def told(self, speed):
        self.cmd_vel.publish(_twist(speed))


def _twist(speed):
    message = Twist()
    message.linear.x = speed
    return message


def at_step(bench, number, action):
    """Let something happen in the middle of a led sweep."""
    move = bench.rig.move

    def move_and_act():
        move()
        if bench.rig.steps == number:
            action()

    bench.rig.move = move_and_act


def moved(x=0.0, yaw=0.0):
    message = Odometry()
    message.header.frame_id = 'odom'
    message.pose.pose.position.x = x
    message.pose.pose.orientation.z = math.sin(yaw / 2)
    message.pose.pose.orientation.w = math.cos(yaw / 2)
    return message


@pytest.mark.parametrize(
    ('message', 'reason'),
    [
        (moved(x=0.03), 'the robot moved by 0.030 m; allowed: 0.01 m'),
        (moved(yaw=math.radians(1.0)), 'the robot turned by 1.000°; allowed: 0.3°'),
        (_twist(0.2), 'by cmd_vel the robot went at 0.200 m/s; allowed: 0.01 m/s'),
        (TwistStamped(twist=_twist(0.2)), 'by cmd_vel the robot went at 0.200 m/s'),
    ],
    ids=['moved', 'turned', 'cmd_vel', 'stamped cmd_vel'],
)
def test_robot_that_moves_ends_a_led_sweep(ros, message, reason):
    stamped = isinstance(message, TwistStamped)
    bench = Bench(ros, stamped_cmd_vel=stamped).ready()
    robot = Robot(bench, TwistStamped if stamped else Twist)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    robot.is_at()

    def act():
        if isinstance(message, Odometry):
            message.header.stamp = to_stamp(bench.rig.now)
            robot.odom.publish(message)
        else:
            robot.cmd_vel.publish(message)

    at_step(bench, 20, act)
    bench.start()
    bench.given_up()
    assert bench.rig.steps < COLUMNS
    ros.spin_until(
        lambda: any(
            pair.key == 'last_end' and pair.value.startswith(f'given up: {reason}')
            for status in diagnosis.told
            for pair in status.values
        ),
        'the reason',
    )


def test_robot_that_stands_is_no_reason(ros):
    bench = Bench(ros).ready()
    robot = Robot(bench)
    robot.is_at(x=5.0, speed=0.005)
    robot.told(0.0)
    at_step(bench, 20, lambda: robot.odom.publish(moved(x=5.0)))
    bench.start()
    ros.spin_until(lambda: bench.mosaicer._robot._held, 'the end of the sweep')
    robot.is_at(x=5.005)
    assert bench.sweeps()


def test_finished_sweep_waits_for_odometry_from_after_its_end(ros):
    bench = Bench(ros).ready()
    robot = Robot(bench)
    robot.is_at()
    bench.start()
    ros.spin_until(lambda: bench.mosaicer._robot._held, 'the end of the sweep')
    assert not any(bench.got.values())
    robot.is_at(x=0.03)
    bench.given_up()


def test_odometry_that_ended_holds_a_sweep_back_for_a_while_only(ros):
    bench = Bench(ros).ready()
    Robot(bench).is_at()
    bench.start()
    assert bench.sweeps()


def test_followed_sweep_of_a_moving_robot_is_dropped_and_the_next_begins_when_it_stands(ros):
    bench = Bench(ros, lead=False).ready()
    robot = Robot(bench)
    bench.someone_else_steps(range(20))
    robot.is_at()
    bench.someone_else_steps(range(10))
    robot.is_at(x=0.02)
    bench.given_up()
    robot.is_at(x=0.1, speed=0.2)
    bench.someone_else_steps(range(5))
    robot.is_at(x=0.2, speed=0.2)
    assert bench.mosaicer._assembler.sweep is None
    while bench.mosaicer._robot.state != 'no odometry':  # it has stood for a second
        ros.executor.spin_once(timeout_sec=0.05)
    bench.someone_else_steps(range(COLUMNS + 40))
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    assert min(row) > 35 + 10, 'a frame from before the standstill was used'


def test_turning_arm_is_stopped_when_the_robot_moves(ros):
    bench = TurningBench(ros)
    robot = Robot(bench)
    bench.start()
    bench.told(True)
    bench.turn(10)
    robot.told(0.3)
    bench.told(True, False)
    bench.given_up()


def test_start_is_refused_while_the_robot_moves(ros):
    bench = Bench(ros).ready()
    Robot(bench).is_at(speed=0.5)
    answer = bench.call('start')
    assert not answer.success
    assert answer.message == (
        'the robot went at 0.500 m/s; allowed: 0.01 m/s; a sweep needs a robot that stands'
    )


def test_command_of_just_before_counts_unless_it_was_taken_back(ros):
    bench = Bench(ros, lead=False).ready()
    robot = Robot(bench)
    watch = bench.mosaicer._robot
    robot.told(0.5)
    ros.spin_until(lambda: watch._commanded, 'the command')
    watch._follow(type('Sweep', (), {'start': 0, 'end': 0})())
    assert 'by cmd_vel' in watch._doubt()
    robot.told(0.0)
    ros.spin_until(lambda: not watch._commanded, 'the command')
    watch._follow(type('Sweep', (), {'start': 0, 'end': 0})())
    assert watch._doubt() == ''


def test_required_proof_must_be_there(ros):
    bench = Bench(ros, robot_motion='require').ready()
    assert bench.call('start').message == 'robot_motion is require, and there is no odometry'
    robot = Robot(bench)
    robot.is_at()
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    assert diagnosis.says(DiagnosticStatus.OK, 'ready')['robot'] == 'stands, by odometry'
    robot.is_at()
    at_step(bench, 20, lambda: setattr(bench.rig, 'frames', False))
    bench.start()
    bench.given_up()
    assert 'odometry has been silent for 1.' in bench.mosaicer._last_end


def test_required_proof_lets_a_sweep_pass(ros):
    bench = Bench(ros, robot_motion='require').ready()
    robot = Robot(bench)
    robot.is_at()
    for number in range(5, COLUMNS, 5):
        at_step(bench, number, lambda: robot.odom.publish(_here(bench)))
    bench.start()
    ros.spin_until(lambda: bench.mosaicer._robot._held, 'the end of the sweep')
    robot.is_at()
    assert bench.sweeps()


def _here(bench):
    message = moved()
    message.header.stamp = to_stamp(bench.rig.now)
    return message


def test_robot_is_not_watched_if_it_shall_be_ignored(ros):
    bench = Bench(ros, robot_motion='ignore')
    assert bench.mosaicer.count_subscribers('odom') == 0
    assert bench.mosaicer.count_subscribers('cmd_vel') == 0
