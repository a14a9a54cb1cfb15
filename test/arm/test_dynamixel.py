"""The Dynamixel arm against a simulated servo on a pseudo-terminal, and against its faults."""

import itertools
import math
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from fixtures.arm import DEG, ArmServer, ScriptedPort, wait_until

from panodepth_ros.arm.dynamixel import DynamixelArm
from panodepth_ros.arm.errors import (
    ArmAlarmError,
    ArmBusyError,
    ArmConnectionError,
    ArmError,
    ArmPositionError,
    ArmProtocolError,
    ArmStoppedError,
    ArmTimeoutError,
)
from panodepth_ros.arm.simulated_dynamixel import SimulatedServo, crc16

PULSE = 360.0 / 4096.0 * DEG


class Bench:
    def __init__(self, folder):
        self.server = ArmServer(folder / 'arm', controller_type=SimulatedServo)
        self.states = []
        self.closing = [self.server.unplug]

    def connect(self, **arguments):
        arguments = {
            'speed': 90 * DEG, 'listener': self.states.append, 'response_timeout': 0.3,
            'status_period': 0.02, 'clock': time.monotonic_ns, **arguments,
        }  # fmt: skip
        arm = DynamixelArm(arguments.pop('port', self.server.link), **arguments)
        self.closing.append(arm.close)
        return arm

    def in_thread(self, command, *arguments):
        pool = ThreadPoolExecutor(1)
        self.closing.append(lambda: pool.shutdown(wait=False))
        return pool.submit(command, *arguments)


@pytest.fixture
def bench(tmp_path):
    bench = Bench(tmp_path)
    yield bench
    for close in reversed(bench.closing):
        close()


def test_crc_is_that_of_the_documented_example():
    # A ping of servo 1, as the protocol's description prints it.
    assert crc16(bytes.fromhex('FFFFFD0001030001')) == 0x4E19


@pytest.mark.parametrize('target', [0.2, -33.3, 361.0])
def test_move_ends_at_the_pulse_next_to_the_target(bench, target):
    arm = bench.connect(speed=700 * DEG)
    state = arm.move_to(target * DEG)
    assert state.velocity == 0.0
    assert state.azimuth == pytest.approx(target * DEG, abs=0.5 * PULSE + 1e-9)
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-9)
    stamps = [s.stamp for s in bench.states]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    moving = [s for s in bench.states if s.velocity]
    assert moving
    assert all(s.velocity * target > 0.0 for s in moving)


@pytest.mark.parametrize('speed', [36.0, -36.0])
def test_spin_is_steady_and_stop_ends_it(bench, speed):
    arm = bench.connect()
    started = []
    future = bench.in_thread(arm.spin, lambda: speed * DEG, -1e3, 1e3, lambda: started.append(1))
    wait_until(lambda: len(bench.states) > 40, 'the turn')
    assert started == [1]
    with pytest.raises(ArmBusyError):
        arm.move_to(0.0)
    state = arm.stop()
    with pytest.raises(ArmStoppedError):
        future.result(timeout=10)
    assert not bench.server.is_moving()
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=PULSE)
    assert bench.states[30].velocity == pytest.approx(speed * DEG, rel=0.03)
    truth = bench.server.truth
    for s in bench.states[30:38]:
        assert s.azimuth == pytest.approx(truth.azimuth(s.stamp * 1e-9), abs=1.5 * PULSE)


def test_spin_turns_back_at_its_ends_and_changes_its_speed(bench):
    arm = bench.connect()
    speed = [200 * DEG]
    future = bench.in_thread(arm.spin, lambda: speed[0], -20 * DEG, 30 * DEG, lambda: None)
    seen = []
    wait_until(
        lambda: seen.append(bench.server.true_azimuth() / DEG) or min(seen) < -15, 'the way back'
    )
    assert 25.0 < max(seen) < 30.1
    speed[0] = 20 * DEG
    wait_until(lambda: abs(bench.states[-1].velocity) < 25 * DEG, 'the slower turn')
    arm.stop()
    assert isinstance(future.exception(timeout=10), ArmStoppedError)


def test_stop_ends_a_move_and_keeps_the_position(bench):
    arm = bench.connect(speed=30 * DEG)
    future = bench.in_thread(arm.move_to, 300 * DEG)
    wait_until(lambda: bench.server.true_azimuth() > 5 * DEG, 'the motion')
    state = arm.stop()
    assert isinstance(future.exception(timeout=10), ArmStoppedError)
    assert 5 * DEG < state.azimuth < 60 * DEG
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=PULSE)
    assert arm.move_to(0.0).azimuth == pytest.approx(0.0, abs=PULSE)


def test_hardware_error_ends_a_move_for_good_until_homed(bench):
    arm = bench.connect(speed=30 * DEG)
    future = bench.in_thread(arm.move_to, 300 * DEG)
    wait_until(lambda: bench.server.true_azimuth() > 5 * DEG, 'the motion')
    bench.server.alarm(0x20)
    with pytest.raises(ArmAlarmError, match='hardware error: overload; remove the cause and home'):
        future.result(timeout=10)
    with pytest.raises(ArmError, match='overload'):
        arm.move_to(0.0)
    assert not bench.server.is_moving()
    assert arm.home().azimuth == pytest.approx(0.0, abs=PULSE)
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG, abs=PULSE)


def test_restart_of_the_servo_is_noticed(bench):
    arm = bench.connect()
    arm.move_to(5 * DEG)
    bench.server.reboot()
    with pytest.raises(ArmPositionError, match=r'restarted by itself or .*; home the arm'):
        arm.move_to(0.0)
    assert arm.home().azimuth == pytest.approx(0.0, abs=PULSE)


def test_target_that_is_not_counted_is_refused(bench):
    arm = bench.connect()
    with pytest.raises(ArmProtocolError, match='is beyond what the servo'):
        arm.move_to(257 * 2 * math.pi)


def test_missing_servo_is_named(bench):
    with pytest.raises(ArmTimeoutError, match=r'servo 7 on port \S+ did not answer a ping'):
        bench.connect(servo_id=7)


def test_missing_port_is_named(bench):
    with pytest.raises(ArmConnectionError, match='cannot open port /nowhere'):
        bench.connect(port='/nowhere')


def test_missing_sdk_is_named_with_what_to_do(bench, monkeypatch):
    monkeypatch.setitem(sys.modules, 'dynamixel_sdk', None)
    with pytest.raises(ArmError, match=r'needs the package dynamixel-sdk; .*\[dynamixel\]'):
        bench.connect()


@pytest.mark.parametrize('noise', [b'\xff\xff\xfd\x00\x01\x00\x00\x55', b'\xff\xff\xfd\xfd' * 9])
def test_noise_instead_of_answers_ends_in_a_timeout(bench, noise):
    port = ScriptedPort(lambda data: noise)
    bench.closing.append(port.close)
    with pytest.raises(ArmTimeoutError, match='did not answer a ping within'):
        bench.connect(port=port.name)


def test_broken_answers_are_asked_for_again(bench):
    arm = bench.connect()
    count = itertools.count()
    bench.server.spoil(
        lambda data: data[:-1] + bytes([data[-1] ^ 1]) if data and next(count) % 3 == 0 else data
    )
    assert arm.move_to(3 * DEG).azimuth == pytest.approx(3 * DEG, abs=PULSE)


def test_unplugging_is_a_connection_error(bench):
    arm = bench.connect(speed=30 * DEG)
    future = bench.in_thread(arm.move_to, 300 * DEG)
    wait_until(bench.server.is_moving, 'the motion')
    bench.server.unplug()
    with pytest.raises(ArmConnectionError, match='is lost'):
        future.result(timeout=10)
    with pytest.raises(ArmConnectionError):
        arm.measure()


def test_slow_motion_below_the_moving_threshold_is_seen(bench):
    arm = bench.connect(speed=5 * DEG)
    future = bench.in_thread(arm.move_to, 300 * DEG)
    wait_until(lambda: bench.server.true_azimuth() > 1 * DEG, 'the motion')
    arm.interrupt()
    with pytest.raises(ArmStoppedError):
        future.result(timeout=10)
    assert bench.server.is_moving()  # an interruption alone does not stop it
    state = arm.stop()
    assert not bench.server.is_moving()
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=PULSE)
