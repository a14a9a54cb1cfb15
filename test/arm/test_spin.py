"""Steady turning of the simulated arm on a real pseudo-terminal."""

import itertools
import math
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fixtures.arm import DEG, ArmBench, wait_until

from panodepth_ros.arm.errors import (
    ArmAlarmError,
    ArmBusyError,
    ArmConnectionError,
    ArmPositionError,
    ArmProtocolError,
    ArmStoppedError,
)

FAR = 1e4 * DEG


@pytest.fixture
def bench(tmp_path):
    with ArmBench(tmp_path) as bench:
        yield bench


class Spin:
    """A turn in a thread of its own."""

    def __init__(self, bench, speed=36.0, low=-FAR, high=FAR, **arguments):
        self.bench = bench
        arguments = {'clock': time.monotonic_ns, 'status_period': 0.02, **arguments}
        self.arm = bench.connect(**arguments)
        self.speed = speed
        self.started = []
        pool = ThreadPoolExecutor(1)
        self.future = pool.submit(
            self.arm.spin, lambda: self.speed * DEG, low, high, lambda: self.started.append(1)
        )
        bench.closing.append(lambda: pool.shutdown(wait=False))

    def until(self, condition, what, timeout=10.0):
        def happened():
            if self.future.done():
                self.future.result()
            return condition()

        wait_until(happened, what, timeout)

    def until_states(self, number):
        first = len(self.bench.states)
        self.until(lambda: len(self.bench.states) >= first + number, f'{number} states')

    def true_degrees(self):
        return self.bench.server.true_azimuth() / DEG

    def true_speed(self):
        now = time.monotonic()
        truth = self.bench.server.truth
        return (truth.azimuth(now + 1e-3) - truth.azimuth(now)) / DEG * 1e3


@pytest.mark.parametrize('speed', [36.0, -36.0])
def test_arm_turns_steadily_until_stopped(bench, speed):
    bench.serve({'acceleration': 400.0})
    spin = Spin(bench, speed)
    spin.until_states(30)
    assert spin.started == [1]
    assert spin.true_speed() == pytest.approx(speed)
    for command in (spin.arm.measure, spin.arm.home, lambda: spin.arm.move_to(0.0)):
        with pytest.raises(ArmBusyError):
            command()
    state = spin.arm.stop()
    assert not bench.server.is_moving()
    with pytest.raises(ArmStoppedError):
        spin.future.result(timeout=10)
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-8)
    assert state.velocity == 0.0
    first, commanded, *turning = [s for s in bench.states if s.stamp < state.stamp]
    assert first.velocity == 0.0
    assert commanded.velocity == pytest.approx(speed * DEG)
    assert all(s.velocity * speed > 0.0 for s in turning)
    stamps = [s.stamp for s in bench.states]
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert spin.arm.move_to(0.0).azimuth == 0.0


def test_planner_never_runs_dry_over_many_moves(bench):
    # At 720 °/s and 400 °/s² braking takes 648°, nearly two turns of 0.5 s each.
    bench.serve({'acceleration': 400.0, 'max_rate': 720.0})
    spin = Spin(bench, 720.0)
    spin.until(lambda: spin.true_degrees() > 700.0, 'the full speed')
    slowest = 1000.0
    while spin.true_degrees() < 2500.0:
        slowest = min(slowest, spin.true_speed())
        time.sleep(0.005)
    assert slowest == pytest.approx(720.0, abs=0.01)


def test_speed_is_limited_by_the_controller(bench):
    bench.serve({'max_rate': 20.0})
    spin = Spin(bench, 100.0)
    spin.until_states(5)
    assert spin.true_speed() == pytest.approx(20.0)


def test_arm_turns_back_at_both_ends(bench):
    bench.serve({'acceleration': 4000.0, 'max_rate': 720.0})
    spin = Spin(bench, 720.0, low=-100 * DEG, high=200 * DEG)
    way = []

    def seen():
        way.append(spin.true_degrees())
        return len(way) > 2 and way[-1] > -90.0 and min(way) < -99.0

    spin.until(seen, 'the way back from the lower end')
    spin.until(lambda: way.append(spin.true_degrees()) or way[-1] > 150.0, 'the way up')
    assert 199.0 < max(way) < 200.03
    assert -100.03 < min(way) < -99.0
    inner = bench.states[2:]
    assert all(s.velocity for s in inner)  # no standstill to take frames at
    assert {math.copysign(1.0, s.velocity) for s in inner} == {1.0, -1.0}


def test_arm_beyond_its_end_turns_back_at_once(bench):
    bench.serve({'max_rate': 720.0})
    arm = bench.connect(speed=720 * DEG)
    arm.move_to(30 * DEG)
    pool = ThreadPoolExecutor(1)
    pool.submit(arm.spin, lambda: 36 * DEG, -10 * DEG, 10 * DEG, lambda: None)
    wait_until(lambda: bench.server.true_azimuth() < 29 * DEG, 'the way back')
    arm.stop()
    pool.shutdown()


def test_speed_and_direction_may_change(bench):
    bench.serve({'acceleration': 400.0})
    spin = Spin(bench, 36.0)
    spin.until(lambda: spin.true_speed() == pytest.approx(36.0), 'the first speed')
    spin.speed = 10.0
    spin.until(lambda: spin.true_speed() == pytest.approx(10.0), 'the second speed')
    spin.speed = -20.0
    spin.until(lambda: spin.true_speed() == pytest.approx(-20.0), 'the third speed')
    assert spin.started == [1]
    state = spin.arm.stop()
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-8)
    assert all(s.velocity for s in bench.states[1:-1])


def test_alarm_reboot_and_unplugging_end_the_turn_for_good(bench):
    bench.serve({'acceleration': 400.0})
    spin = Spin(bench, response_timeout=0.3)
    spin.until_states(5)
    bench.server.alarm(1)
    with pytest.raises(ArmAlarmError, match='ALARM:1'):
        spin.future.result(timeout=10)
    with pytest.raises(ArmPositionError):
        spin.arm.spin(lambda: 1.0, -FAR, FAR, lambda: None)
    assert not bench.server.is_moving()


def test_reboot_ends_the_turn(bench):
    bench.serve()
    spin = Spin(bench)
    spin.until_states(5)
    bench.server.reboot()
    with pytest.raises(ArmPositionError, match='restarted by itself'):
        spin.future.result(timeout=10)
    assert not bench.server.is_moving()


def test_unplugging_ends_the_turn(bench):
    bench.serve()
    spin = Spin(bench)
    spin.until_states(5)
    bench.server.unplug()
    with pytest.raises(ArmConnectionError, match='is lost'):
        spin.future.result(timeout=10)


def test_hold_by_somebody_else_is_an_error_and_drops_the_turn(bench):
    bench.serve()
    spin = Spin(bench, response_timeout=0.3)
    spin.until_states(5)
    bench.server.controller.receive(b'!', time.monotonic())
    with pytest.raises(ArmProtocolError, match=r'should turn, but the controller reports Hold'):
        spin.future.result(timeout=10)
    bench.server.controller.receive(b'~', time.monotonic())
    assert spin.arm.measure().azimuth == pytest.approx(bench.server.true_azimuth())


def test_refused_move_is_an_error_with_a_standing_arm(bench):
    bench.serve({20: 1}, home_position=0.0)
    spin = Spin(bench, response_timeout=0.3)
    with pytest.raises(ArmAlarmError, match='ALARM:2'):
        spin.future.result(timeout=10)
    assert spin.started == []


def interpolation_errors(bench, states):
    """Linear interpolation between joint states against the truth, at steady speed [°]."""
    times = np.array([s.stamp * 1e-9 for s in states])
    azimuths = np.array([s.azimuth for s in states])
    at = np.linspace(times[0], times[-1], 20 * len(states))
    truth = np.array([bench.server.truth.azimuth(t) for t in at])
    return (np.interp(at, times, azimuths) - truth) / DEG


def test_interpolated_azimuth_is_better_than_the_motor_step(bench):
    # Motor steps of 0.04° alone put single reports off by up to 0.02°.
    bench.serve({'acceleration': 3600.0})
    spin = Spin(bench, 36.0)
    spin.until_states(100)
    spin.arm.stop()
    steady = bench.states[40:95]
    assert all(s.velocity == pytest.approx(36 * DEG, rel=0.01) for s in steady)
    errors = interpolation_errors(bench, steady)
    assert math.sqrt(np.mean(errors**2)) < 0.02
