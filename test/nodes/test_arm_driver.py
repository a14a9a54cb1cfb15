"""The arm driver node on a simulated arm: services, joint states, diagnostics, faults, its end."""

import itertools
import math
import signal

import pytest
import serial
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fixtures.arm import ArmServer, ScriptedPort, wait_until
from fixtures.ros import started
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

from panodepth_ros.arm.errors import ArmAlarmError, ArmConnectionError, ArmTimeoutError
from panodepth_ros.nodes.arm_driver import ArmDriver, ArmDriverParameters
from panodepth_ros.ros import qos
from panodepth_ros.ros.messages import to_nanoseconds
from panodepth_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros

DEG = math.pi / 180.0


class Listener:
    """Clients, and all joint states and diagnostics that came."""

    def __init__(self, ros):
        self.ros = ros
        self.node = ros.node('listener')
        self.joint_states = []
        self.diagnostics = []
        self.node.create_subscription(
            JointState, 'joint_states', self.joint_states.append, qos.JOINT_STATES
        )
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append, 10)
        self.clients = {
            name: self.node.create_client(Trigger, f'arm_driver/{name}')
            for name in ('step', 'home', 'stop', 'unwind')
        }
        self.spin_client = self.node.create_client(SetBool, 'arm_driver/spin')

    def connect(self):
        self.ros.spin_until(
            lambda: (
                all(client.service_is_ready() for client in self.clients.values())
                and self.node.count_publishers('joint_states')
                and self.joint_states
            ),
            'the arm driver',
        )

    def begin(self, name):
        return self.clients[name].call_async(Trigger.Request())

    def spin(self, data):
        future = self.spin_client.call_async(SetBool.Request(data=data))
        return self.ros.result(future, 'answer of spin')

    def set(self, **values):
        client = self.node.create_client(SetParameters, 'arm_driver/set_parameters')
        self.ros.spin_until(client.service_is_ready, 'set_parameters')
        parameters = [
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()
        ]
        request = SetParameters.Request(parameters=parameters)
        (result,) = self.ros.result(client.call_async(request)).results
        return result

    def call(self, name):
        return self.ros.result(self.begin(name), f'answer of {name}')

    def wait_for_standstill(self):
        count = len(self.joint_states)
        self.ros.spin_until(
            lambda: any(not m.velocity[0] for m in self.joint_states[count:]), 'a standstill'
        )

    def status(self):
        """Next diagnostic status."""
        count = len(self.diagnostics)
        self.ros.spin_until(lambda: len(self.diagnostics) > count, 'diagnostics')
        (status,) = self.diagnostics[-1].status
        return status


class Bench(Listener):
    """A simulated arm, its driver, and a listener."""

    def __init__(self, ros, link, settings=None, server=None, **parameters):
        self.server = ArmServer(link, settings, **(server or {}))
        try:
            super().__init__(ros)
            self.driver = self.add(str(link), **parameters)
            self.connect()
        except BaseException:
            self.server.unplug()
            raise

    def add(self, link, **parameters):
        parameters = {'port': link, 'settle_time': 0.0, 'response_timeout': 0.5, **parameters}
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        return self.ros.add(ArmDriver(context=self.ros.context, parameter_overrides=overrides))

    def true_degrees(self):
        return self.server.true_azimuth() / DEG

    def wait_until_moving(self, beyond=0.5):
        start = self.true_degrees()
        self.ros.spin_until(lambda: abs(self.true_degrees() - start) > beyond, 'the motion')


@pytest.fixture
def make_bench(ros, tmp_path):
    benches = []

    def make(**arguments):
        benches.append(Bench(ros, tmp_path / 'arm', **arguments))
        return benches[-1]

    yield make
    for bench in benches:
        bench.driver.destroy_node()
        bench.server.unplug()


def make_driver(ros, **parameters):
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    return ArmDriver(context=ros.context, parameter_overrides=overrides)


# --- stepping ---------------------------------------------------------------------------------


@pytest.mark.parametrize('step_deg', [0.2, -0.2])
def test_step_turns_by_one_column_and_says_where_the_arm_stands(make_bench, step_deg):
    bench = make_bench(step_deg=step_deg)
    for k in (1, 2, 3):
        answer = bench.call('step')
        assert answer.success
        assert answer.message == f'the arm stands at {k * step_deg:.3f}°'
        assert bench.true_degrees() == pytest.approx(k * step_deg)


def test_steps_that_motor_steps_do_not_divide_accumulate_nothing(make_bench):
    bench = make_bench(settings={'max_rate': 20000.0, 'acceleration': 5e7}, step_deg=0.05142857)
    for k in range(1, 101):
        assert bench.call('step').success
        assert bench.true_degrees() == pytest.approx(k * 360 / 7000, abs=0.02001)


def test_joint_states_of_a_step_come_in_the_order_that_frames_are_paired_by(make_bench):
    bench = make_bench(settings={'acceleration': 20.0}, step_deg=2.0, status_rate=20.0)
    assert bench.call('step').success
    bench.wait_for_standstill()
    bench.joint_states.clear()
    before = bench.node.get_clock().now().nanoseconds
    assert bench.call('step').success
    answered = bench.node.get_clock().now().nanoseconds
    bench.wait_for_standstill()
    states = bench.joint_states
    moving = [i for i, m in enumerate(states) if m.velocity[0] != 0.0]
    first, last = moving[0], moving[-1]
    assert moving == list(range(first, last + 1))  # no standstill in between
    assert len(moving) > 3
    assert all(m.velocity[0] > 0.0 for m in states[first : last + 1])
    assert states[first - 1].position[0] == pytest.approx(2 * DEG)
    assert states[first].position[0] == states[first - 1].position[0]
    assert states[last + 1].position[0] == pytest.approx(4 * DEG)
    stamps = [to_nanoseconds(m.header.stamp) for m in states]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert before < stamps[first - 1] < stamps[last + 1] < answered
    assert {tuple(m.name) for m in states} == {('panodepth_arm_joint',)}


def test_standing_arm_is_reported_and_its_rate_may_change(make_bench):
    bench = make_bench(joint_name='neck', status_rate=0.5)
    assert bench.set(status_rate=50.0).successful
    assert bench.driver._arm.status_period == 0.02
    bench.joint_states.clear()
    bench.ros.spin_until(lambda: len(bench.joint_states) >= 20, '20 joint states')
    stamps = [to_nanoseconds(m.header.stamp) for m in bench.joint_states[2:]]
    assert min(b - a for a, b in itertools.pairwise(stamps)) < 0.2e9
    assert {(m.name[0], m.position[0], m.velocity[0]) for m in bench.joint_states} == {
        ('neck', 0.0, 0.0)
    }


def test_step_while_a_step_runs_is_refused_at_once(make_bench):
    bench = make_bench(settings={'acceleration': 20.0}, step_deg=5.0)
    first = bench.begin('step')
    bench.wait_until_moving()
    answer = bench.call('step')
    assert not answer.success
    assert answer.message == 'step refused: the arm is executing step'
    assert not first.done()
    assert bench.ros.result(first).success
    assert bench.true_degrees() == pytest.approx(5.0)


def test_arm_with_an_index_steps_only_after_searching_it(make_bench, ros, tmp_path):
    server = ArmServer(tmp_path / 'arm', {'max_rate': 400.0}, index=(40.0, 5.0))
    try:
        listener = Listener(ros)
        given = {'settle_time': 0.0, 'speed_deg_s': 400.0, 'reference': 'probe'}
        ros.add(make_driver(ros, port=server.link, **given))
        assert 'has not searched its index' in ros.result(listener.begin('step')).message
        assert listener.call('home').message == 'the arm is home and stands at 0.000°'
        assert listener.call('step').message == 'the arm stands at 0.200°'
        assert math.degrees(server.true_azimuth()) == pytest.approx(40.2, abs=0.041)
        ros.nodes[-1].destroy_node()
    finally:
        server.unplug()


# --- stop and home ----------------------------------------------------------------------------


def test_stop_is_served_while_a_step_runs_and_the_next_step_ends_where_it_should(make_bench):
    bench = make_bench(settings={'acceleration': 200.0}, step_deg=120.0)
    step = bench.begin('step')
    bench.wait_until_moving()
    stop = bench.call('stop')
    assert stop.success
    assert not bench.server.is_moving()
    stopped_at = bench.true_degrees()
    assert 0.0 < stopped_at < 60.0
    assert stop.message == f'the arm stands at {stopped_at:.3f}°'
    answer = bench.ros.result(step)
    assert not answer.success
    assert 'was stopped' in answer.message
    bench.wait_for_standstill()
    assert bench.joint_states[-1].position[0] == pytest.approx(stopped_at * DEG, abs=1e-5)
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx(120.0)


def test_stop_of_a_standing_arm_succeeds(make_bench):
    bench = make_bench()
    assert bench.call('stop').success
    assert bench.call('step').success


def test_home_returns_to_the_origin(make_bench):
    bench = make_bench(step_deg=1.0)
    for _ in range(3):
        bench.call('step')
    answer = bench.call('home')
    assert answer.success
    assert answer.message == 'the arm is home and stands at 0.000°'
    assert bench.true_degrees() == pytest.approx(0.0)
    assert bench.call('step').message == 'the arm stands at 1.000°'


def test_step_after_an_interrupted_return_goes_on_from_where_the_arm_is(make_bench):
    bench = make_bench(settings={'acceleration': 400.0}, step_deg=60.0, speed_deg_s=60.0)
    for _ in range(2):
        assert bench.call('step').success
    home = bench.begin('home')
    bench.wait_until_moving(beyond=75.0)  # from step 2 to nearer step 1 or 0
    assert bench.call('stop').success
    assert not bench.ros.result(home).success
    nearest = round(bench.true_degrees() / 60.0)
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx((nearest + 1) * 60.0)


def test_arm_with_a_switch_steps_only_after_homing(make_bench, ros, tmp_path):
    server = ArmServer(tmp_path / 'arm', {22: 1}, home_position=10.0)
    try:
        listener = Listener(ros)
        ros.add(make_driver(ros, port=server.link, settle_time=0.0))
        step = ros.result(listener.begin('step'))
        assert not step.success
        assert 'has not been homed' in step.message
        assert not listener.joint_states
        assert listener.status().level == DiagnosticStatus.ERROR
        assert listener.call('home').message == 'the arm is home and stands at -1.000°'
        assert listener.call('step').message == 'the arm stands at -0.800°'
        assert listener.status().level == DiagnosticStatus.OK
        ros.nodes[-1].destroy_node()
    finally:
        server.unplug()


# --- steady turning and the cable --------------------------------------------------------------


def test_spin_turns_until_told_otherwise_and_excludes_steps(make_bench):
    bench = make_bench(step_deg=10.0, status_rate=50.0)
    answer = bench.spin(True)
    assert (answer.success, answer.message) == (True, 'the arm turns')
    bench.wait_until_moving(beyond=20.0)
    for name in ('step', 'home', 'unwind'):
        assert bench.call(name).message == f'{name} refused: the arm is executing spin'
    assert bench.spin(True).message == 'spin refused: the arm is executing spin'
    assert bench.status().message == 'spin'
    answer = bench.spin(False)
    assert answer.success
    assert not bench.server.is_moving()
    assert answer.message == f'the arm stands at {bench.true_degrees():.3f}°'
    assert bench.spin(False).message == 'the arm was not turning'
    turning = [m for m in bench.joint_states if m.velocity[0]]
    assert len(turning) > 10
    assert all(m.velocity[0] > 0.0 for m in turning)
    nearest = round(bench.true_degrees() / 10.0)
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx((nearest + 1) * 10.0)


def test_spin_is_refused_while_a_step_runs(make_bench):
    bench = make_bench(step_deg=120.0)
    step = bench.begin('step')
    bench.wait_until_moving()
    for data in (True, False):
        answer = bench.spin(data)
        assert not answer.success
        assert answer.message == 'spin refused: the arm is executing step'
    bench.call('stop')
    bench.ros.result(step)


def test_spin_speed_is_live_and_its_sign_the_direction(make_bench):
    bench = make_bench(spin_speed_deg_s=-50.0)
    assert bench.spin(True).success
    bench.ros.spin_until(lambda: bench.true_degrees() < -5.0, 'the turn clockwise')
    assert bench.set(spin_speed_deg_s=50.0).successful
    bench.ros.spin_until(lambda: bench.true_degrees() > 0.0, 'the turn back')
    result = bench.set(spin_speed_deg_s=0.0)
    assert not result.successful
    assert 'spin_speed_deg_s is 0.0; allowed: 0.1 to 720' in result.reason
    assert bench.call('stop').success


def test_trouble_ends_a_spin_that_stays_ended(make_bench, capfd):
    bench = make_bench()
    assert bench.spin(True).success
    bench.wait_until_moving()
    bench.server.alarm(1)
    bench.ros.spin_until(lambda: 'ALARM:1' in bench.driver._last_error, 'the alarm')
    assert 'spin failed: controller on port' in capfd.readouterr().err
    answer = bench.spin(True)
    assert not answer.success
    assert 'ALARM:1' in answer.message
    assert not bench.server.is_moving()


def test_cable_limits_steps_until_unwound(make_bench):
    bench = make_bench(
        settings={'max_rate': 20000.0, 'acceleration': 5e7},
        speed_deg_s=720.0,
        step_deg=180.0,
        cable_limit_deg=360.0,
    )
    for sweep in range(2):
        assert bench.call('unwind').message == 'the arm stands at -360.000°', sweep
        for k in (1, 2, 3, 4):  # a turn and one step, and what is left of the cable
            assert bench.call('step').success
            assert bench.true_degrees() == pytest.approx(180.0 * k - 360.0)
        answer = bench.call('step')
        assert not answer.success
        assert 'beyond cable_limit_deg, ±360°; call ~/unwind or ~/home' in answer.message
    for _ in range(2):
        assert bench.call('unwind').success
        assert bench.true_degrees() == pytest.approx(-360.0)


def test_spin_turns_back_at_the_cable_limit(make_bench):
    bench = make_bench(
        settings={'max_rate': 7200.0, 'acceleration': 20000.0},
        spin_speed_deg_s=720.0,
        cable_limit_deg=180.0,
    )
    seen = []
    assert bench.spin(True).success
    bench.ros.spin_until(
        lambda: seen.append(bench.true_degrees()) or min(seen) < -150.0, 'the way back'
    )
    assert bench.spin(False).success
    assert 150.0 < max(seen) < 180.03


# --- faults -----------------------------------------------------------------------------------


def test_reboot_makes_steps_fail_until_homed(make_bench, capfd):
    bench = make_bench(step_deg=1.0)
    bench.call('step')
    bench.server.reboot()
    bench.ros.spin_until(lambda: bench.driver._arm.doubt, 'the doubt')
    count = len(bench.joint_states)
    answer = bench.call('step')
    assert not answer.success
    assert 'restarted by itself' in answer.message
    assert bench.status().level == DiagnosticStatus.ERROR
    assert capfd.readouterr().err.count('[ERROR]') == 1  # logged once, not at each measurement
    assert all(m.position[0] != 0.0 for m in bench.joint_states[count:])
    assert bench.call('home').success
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx(2.0)
    assert bench.status().level == DiagnosticStatus.OK


def test_alarm_fails_the_step(make_bench):
    bench = make_bench(step_deg=120.0)
    step = bench.begin('step')
    bench.wait_until_moving()
    bench.server.alarm(1)
    answer = bench.ros.result(step)
    assert not answer.success
    assert 'ALARM:1 (a limit switch was hit' in answer.message
    assert 'ALARM:1' in bench.status().message


def test_lost_answer_fails_the_step_and_the_next_one_ends_where_it_should(make_bench):
    bench = make_bench(step_deg=1.0)
    replies = []

    def lose_the_barrier(data):
        if b'ok' in data:
            replies.append(data)
        return b'' if b'ok' in data and len(replies) == 2 else data

    bench.server.spoil(lose_the_barrier)
    answer = bench.call('step')
    assert not answer.success
    assert 'did not answer G4P0' in answer.message
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx(1.0)


@pytest.mark.parametrize('moving', [False, True])
def test_unplugged_arm_is_reported_and_reopened_but_not_moved_until_homed(
    make_bench, tmp_path, capfd, moving
):
    bench = make_bench(step_deg=120.0)
    if moving:
        step = bench.begin('step')
        bench.wait_until_moving()
    bench.server.unplug()
    if moving:
        answer = bench.ros.result(step)
        assert not answer.success
        assert 'is lost' in answer.message
    bench.ros.spin_until(lambda: bench.driver._arm is None, 'the loss')
    status = bench.status()
    assert status.level == DiagnosticStatus.ERROR
    assert status.message == 'disconnected'
    for name in ('step', 'home', 'stop'):
        answer = bench.call(name)
        assert not answer.success
        assert answer.message.startswith(f'{name} failed: connection on port')
    bench.server = ArmServer(tmp_path / 'arm')
    bench.ros.spin_until(lambda: bench.driver._arm is not None, 'the reopening')
    count = len(bench.joint_states)
    answer = bench.call('step')
    assert not answer.success
    assert 'was lost meanwhile; home the arm' in answer.message
    assert len(bench.joint_states) == count
    assert bench.call('home').success
    assert bench.call('step').success
    assert bench.true_degrees() == pytest.approx(120.0)
    assert capfd.readouterr().err.count('is lost') == 1


def test_diagnostics_tell_state_port_and_position(make_bench):
    bench = make_bench(step_deg=1.0)
    bench.call('step')
    status = bench.status()
    assert (status.level, status.name, status.message) == (
        DiagnosticStatus.OK, 'arm_driver: arm', 'standing',
    )  # fmt: skip
    assert {value.key: value.value for value in status.values} == {
        'port': bench.server.link,
        'position_deg': '1.000',
        'last_error': '',
    }
    assert bench.diagnostics[-1].header.stamp.sec > 0


# --- start ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('parameters', 'message'),
    [
        ({'step_deg': 0.7}, r'step_deg is 0\.7: a turn of 360° would take 514\.286 steps'),
        ({'step_deg': 0.0}, r'step_deg is 0\.0.*allowed: whole fractions of 360°'),
        ({'step_deg': 500.0}, r'step_deg is 500\.0; allowed: -180 to 180 °'),
        (
            {'reference': 'probe', 'cable_limit_deg': 360.0},
            r'cable_limit_deg is 360\.0 while reference is probe; allowed: 0 .*, or less than 360',
        ),
        (
            {'reference': 'probe', 'driver': 'dynamixel'},
            'reference is probe; allowed with driver dynamixel: controller',
        ),
        ({'cable_limit_deg': 90.0}, r'cable_limit_deg is 90\.0; allowed: 0 .* or 180 and more'),
        ({'spin_speed_deg_s': 0.05}, r'spin_speed_deg_s is 0\.05; allowed: 0\.1 to 720'),
        ({'axis': 'Q'}, "axis is 'Q'; allowed: X, Y, Z, A, B, C"),
        ({'speed_deg_s': 0.0}, r'speed_deg_s is 0\.0; allowed'),
        ({'baud_rate': 115200.0}, 'baud_rate is 115200.0; allowed: a whole number'),
        ({'step': 0.2}, 'unknown parameter step for arm_driver'),
    ],
)
def test_bad_parameter_is_refused_with_a_sentence(ros, parameters, message):
    with pytest.raises(ParameterError, match=message):
        make_driver(ros, **parameters)


@pytest.mark.parametrize('sign', [1, -1])
def test_step_is_exactly_a_whole_fraction_of_a_turn(sign):
    step = ArmDriverParameters(step_deg=sign * 0.0514286).step
    assert 7000 * step == pytest.approx(sign * 2 * math.pi, abs=1e-12)


def test_step_smaller_than_a_motor_step_is_refused_and_the_port_left_free(ros, tmp_path):
    server = ArmServer(tmp_path / 'arm')
    try:
        with pytest.raises(ValueError, match=r'step_deg is 0\.02: smaller .*allowed: 0\.04 and'):
            make_driver(ros, port=server.link, step_deg=0.02)
        with serial.Serial(server.link, 115200, exclusive=True):
            pass
    finally:
        server.unplug()


def test_missing_port_is_a_connection_error(ros, tmp_path):
    with pytest.raises(ArmConnectionError, match='cannot open port'):
        make_driver(ros, port=str(tmp_path / 'nowhere'))


def test_controller_in_alarm_is_an_alarm_error(ros, tmp_path):
    server = ArmServer(tmp_path / 'arm', reset_on_open=False)
    try:
        server.alarm(3)
        with pytest.raises(ArmAlarmError, match='is in alarm'):
            make_driver(ros, port=server.link)
    finally:
        server.unplug()


def test_silent_port_is_a_timeout_error(ros):
    port = ScriptedPort(lambda data: b'')
    try:
        with pytest.raises(ArmTimeoutError, match='stays silent'):
            make_driver(ros, port=port.name)
    finally:
        port.close()


def test_port_is_closed_when_ros_ends_before_the_node(make_bench):
    bench = make_bench()
    bench.ros.context.shutdown()
    wait_until(lambda: not bench.driver._worker.is_alive(), 'the end of the worker')
    wait_until(lambda: not bench.server.arm._open, 'the closing of the port')


# --- the process ------------------------------------------------------------------------------

pytest_launch = pytest.mark.launch


def driver_arguments(link, **parameters):
    pairs = {'port': link, **parameters}.items()
    return [part for name, value in pairs for part in ('-p', f'{name}:={value}')]


@pytest_launch
@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (('-p', 'port:=/dev/nowhere'), 'cannot open port /dev/nowhere'),
        (('-p', 'step_deg:=0.7'), 'step_deg is 0.7'),
        (('-p', 'stepdeg:=0.2'), 'unknown parameter stepdeg'),
    ],
)
def test_failed_start_is_one_fatal_sentence_and_exit_code_1(ros_domain, arguments, message):
    with started('arm_driver', '--ros-args', *arguments, exit_code=1) as program:
        assert program.wait() == 1
        fatal = [line for line in program.output.splitlines() if 'FATAL' in line]
        assert len(fatal) == 1
        assert message in fatal[0]
        assert 'Traceback' not in program.output


@pytest_launch
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('moving', [True, False])
def test_signal_ends_the_process_with_the_arm_stopped_and_the_port_closed(
    ros, tmp_path, number, moving
):
    server = ArmServer(tmp_path / 'arm', {'acceleration': 200.0}, reset_on_open=False)
    try:
        listener = Listener(ros)
        arguments = driver_arguments(server.link, step_deg=120.0, settle_time=0.0)
        with started('arm_driver', '--ros-args', *arguments, stop_signal=number) as program:
            listener.connect()
            if moving:
                listener.begin('step')
                ros.spin_until(lambda: server.true_azimuth() > 1 * DEG, 'the motion')
            assert program.stop(number) == 0
            assert 'Traceback' not in program.output, program.output
            assert 'may not have stopped' not in program.output
        assert not server.is_moving()
        resting = server.true_azimuth()
        assert (0.0 < resting < 60 * DEG) == moving
        with serial.Serial(server.link, 115200, timeout=5.0, exclusive=True) as port:
            port.write(b'?')
            report = port.readline()
            assert report.startswith(b'<Idle|MPos:%.3f,' % (resting / DEG)), report
    finally:
        server.unplug()


@pytest_launch
def test_signal_while_the_controller_boots_ends_the_process(ros_domain, tmp_path):
    server = ArmServer(tmp_path / 'arm', boot_time=3.0)
    try:
        arguments = driver_arguments(server.link)
        with started('arm_driver', '--ros-args', *arguments) as program:
            wait_until(lambda: server.arm._open, 'the opening of the port', timeout=30.0)
            assert program.stop(signal.SIGINT) == 0
            assert 'Traceback' not in program.output, program.output
    finally:
        server.unplug()
