"""The driver against a simulated controller on a real pseudo-terminal, and against its faults."""

import itertools
import math
import re
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
import serial
from fixtures.arm import FAST, ArmBench, ScriptedPort, wait_until

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
from panodepth_ros.arm.telling import StateTeller

DEG = math.pi / 180.0
SPEED = 30.0 * DEG  # of the bench


@pytest.fixture
def bench(tmp_path):
    with ArmBench(tmp_path) as bench:
        yield bench


def scripted(bench, answer):
    port = ScriptedPort(answer)
    bench.closing.append(port.close)
    return port.name


# --- opening ----------------------------------------------------------------------------------


def test_opening_waits_for_the_boot(bench):
    bench.serve(boot_time=0.4)
    assert bench.connect().measure().azimuth == 0.0


def test_controller_that_runs_on_keeps_its_position(bench):
    bench.serve(reset_on_open=False)
    with_first = bench.connect()
    with_first.move_to(10 * DEG)
    with_first.close()
    assert bench.connect().measure().azimuth == pytest.approx(10 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(10 * DEG)


def test_arm_left_moving_by_another_program_is_stopped_without_losing_its_position(bench):
    bench.serve({'acceleration': 200.0}, reset_on_open=False)
    with serial.Serial(str(bench.link), 115200, timeout=10.0) as port:
        port.write(b'G21G90G1X300F1800\n')
        bench.server.wait_until_moving()
    arm = bench.connect()
    assert not bench.server.is_moving()
    assert 0.0 < arm.measure().azimuth == pytest.approx(bench.server.true_azimuth(), abs=1e-5)


def test_missing_port_is_named(bench):
    with pytest.raises(ArmConnectionError, match=r'cannot open port \S+/arm: there is no such'):
        bench.connect()


def test_what_is_no_serial_port_is_named(bench):
    bench.link.write_text('')
    with pytest.raises(ArmConnectionError, match=r'cannot open port \S+/arm: '):
        bench.connect()


def test_port_in_use_is_refused(bench):
    bench.serve()
    arm = bench.connect()
    with pytest.raises(ArmConnectionError, match='in use by another program'):
        bench.connect()
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG)


def test_silent_port_is_named(bench):
    port = scripted(bench, lambda data: b'')
    with pytest.raises(ArmTimeoutError, match=f'{port} stays silent: .* for 0.3 s'):
        bench.connect(port=port, boot_timeout=0.3)


@pytest.mark.parametrize('garbage', [b'\xf8\x00\xe6\x9f', b'hello\r\n', b'<Idle|MPos:1>\r\n'])
def test_port_that_answers_garbage_is_named_with_what_came(bench, garbage):
    port = scripted(bench, lambda data: garbage)
    what = re.escape(repr(garbage.strip())[2:-1])
    with pytest.raises(ArmProtocolError, match=f'{port} is no GRBL.*baud_rate is wrong.*{what}'):
        bench.connect(port=port, boot_timeout=0.3)


def test_old_firmware_is_refused(bench):
    port = scripted(bench, lambda data: b"Grbl 0.9j ['$' for help]\r\n")
    with pytest.raises(ArmProtocolError, match=r'GRBL 0\.9j; version 1\.1 is needed'):
        bench.connect(port=port)


def test_missing_axis_is_named(bench):
    bench.serve()
    with pytest.raises(ArmProtocolError, match='has no axis A'):
        bench.connect(axis='A')


@pytest.mark.parametrize('axis', ['Y', 'A', 'C'])
def test_any_axis_may_turn_the_arm(bench, axis):
    number = 'XYZABC'.index(axis)
    own = {'axes': 6, 100: 1.0, 110: 60.0, 120: 1.0, 100 + number: 40.0, 110 + number: 24000.0}
    bench.serve({**own, 120 + number: 4000.0}, axis=axis, index=(30.0, 5.0))
    arm = bench.connect(axis=axis, index_within=190 * DEG, speed=400 * DEG)
    assert arm.motor_step == pytest.approx(DEG / 40)
    arm.home()
    assert bench.server.true_azimuth() == pytest.approx(30 * DEG, abs=0.026 * DEG)
    assert arm.move_to(-3.1 * DEG).azimuth == pytest.approx(-3.1 * DEG, abs=0.013 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(26.9 * DEG, abs=0.026 * DEG)
    future = ThreadPoolExecutor(1).submit(arm.move_to, 3600 * DEG)
    bench.server.wait_until_moving()
    stopped = arm.stop().azimuth
    assert isinstance(future.exception(timeout=10), ArmStoppedError)
    assert stopped + 30 * DEG == pytest.approx(bench.server.true_azimuth(), abs=0.026 * DEG)


def test_unusable_setting_is_named(bench):
    bench.serve({110: 0.0})
    with pytest.raises(ArmProtocolError, match=r'no usable setting \$110'):
        bench.connect()


def test_settings_are_those_of_the_axis(bench):
    bench.serve({111: 0.0})
    with pytest.raises(ArmProtocolError, match=r'no usable setting \$111'):
        bench.connect(axis='Y')


def test_controller_in_alarm_is_refused_with_what_to_do(bench):
    bench.serve(reset_on_open=False)
    bench.server.alarm(3)
    with pytest.raises(ArmAlarmError, match=r'is in alarm.*switch it off and on, or send \$X'):
        bench.connect()


def test_failed_opening_leaves_the_port_free(bench):
    bench.serve()
    for _ in range(2):
        with pytest.raises(ArmProtocolError, match='has no axis'):
            bench.connect(axis='C')


# --- moving -----------------------------------------------------------------------------------


@pytest.mark.parametrize('target', [0.2, -0.2, 33.37, 360.05])
def test_move_ends_at_the_motor_step_next_to_the_target(bench, target):
    bench.serve({'max_rate': 3000.0, 'acceleration': 1e5})
    arm = bench.connect(speed=2000 * DEG)
    state = arm.move_to(target * DEG)
    assert state.azimuth == pytest.approx(target * DEG, abs=0.0201 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-8)
    assert state.velocity == 0.0


def test_states_of_a_motion_come_in_the_order_that_frames_are_paired_by(bench):
    bench.serve({'acceleration': 200.0})
    arm = bench.connect(status_period=0.02, settle_time=0.02)
    for target in (6 * DEG, 0.0):
        bench.states.clear()
        before = arm.measure().azimuth
        bench.states.clear()
        done = arm.move_to(target)
        first, commanded, *moving, arrived, last = bench.states
        sign = 1.0 if target else -1.0
        assert first[1:] == (before, 0.0)
        assert commanded[1:] == (before, pytest.approx(sign * SPEED))
        assert len(moving) > 2
        assert all(0.0 < sign * state.velocity < 1.01 * SPEED for state in moving)
        assert any(before != state.azimuth != target for state in moving)
        assert any(sign * state.velocity < 0.9 * SPEED for state in moving)  # as reported
        assert arrived[1:] == (pytest.approx(target), pytest.approx(sign * SPEED))
        assert last == done
        assert last[1:] == (pytest.approx(target), 0.0)
        assert last.stamp - arrived.stamp >= 20_000_000  # settled in between
        stamps = [state.stamp for state in bench.states]
        assert all(a < b for a, b in itertools.pairwise(stamps))


def test_stamps_increase_when_the_clock_stands(bench):
    bench.serve(FAST)
    arm = bench.connect(clock=lambda: 1000)
    arm.move_to(1 * DEG)
    stamps = [state.stamp for state in bench.states]
    assert len(stamps) > 3
    assert all(a < b for a, b in itertools.pairwise(stamps))


def test_stamps_follow_a_clock_that_is_set_back():
    # Else they would stand still until the clock has caught up, and the arm with them.
    now, told = 100_000_000_000, []
    teller = StateTeller(lambda: now, told.append)
    teller.resolve(0.04 * DEG)
    for back in (0, 5_000_000_000, 0):
        now -= back
        for _ in range(10):
            now += 20_000_000
            teller.turn(now, now * 1e-9 * DEG, DEG, 0.001)
    gaps = [after.stamp - before.stamp for before, after in itertools.pairwise(told)]
    assert gaps == [20_000_000] * 9 + [20_000_000 - 5_000_000_000] + [20_000_000] * 19


def test_state_is_stamped_before_the_position_was_read(bench):
    bench.serve({'acceleration': 200.0})
    arm = bench.connect(clock=time.monotonic_ns, status_period=0.01)
    arm.move_to(6 * DEG)
    moving = [state for state in bench.states[2:] if state.velocity]
    assert len(moving) > 3
    for state in moving:
        stamp = state.stamp * 1e-9
        assert bench.server.truth.azimuth(stamp) < state.azimuth + 0.021 * DEG


def test_many_small_moves_accumulate_nothing(bench):
    bench.serve(FAST)
    arm = bench.connect(speed=20000 * DEG)
    step = 2 * math.pi / 7000
    for k in range(1, 301):
        arm.move_to(k * step)
        assert bench.server.true_azimuth() == pytest.approx(k * step, abs=0.02001 * DEG)


def test_move_to_where_the_arm_stands_only_measures(bench):
    bench.serve()
    arm = bench.connect()
    state = arm.move_to(0.0)
    assert [s.velocity for s in bench.states] == [0.0]
    assert bench.states[-1] == state


@pytest.mark.parametrize('settings', [{13: 1}, {10: 0}, {10: 2, 13: 1}])
def test_inches_and_work_coordinates_are_understood(bench, settings):
    bench.serve({**FAST, **settings}, work_offset=7.0)
    arm = bench.connect()
    for target in (12.0, -3.4):
        assert arm.move_to(target * DEG).azimuth == pytest.approx(target * DEG, abs=0.002 * DEG)
        assert bench.server.true_azimuth() == pytest.approx(target * DEG, abs=1e-8)


def test_work_offset_is_remembered_between_the_reports_that_carry_it(bench):
    bench.serve({**FAST, 10: 0}, work_offset=7.0)
    arm = bench.connect(response_timeout=0.3)
    bench.server.spoil(lambda data: re.sub(rb'\|WCO:[^|>]*', b'', data))
    assert arm.move_to(12 * DEG).azimuth == pytest.approx(12 * DEG)


def test_motor_facts_are_read(bench):
    bench.serve({'steps_per_degree': 40.0, 1: 25})
    arm = bench.connect()
    assert arm.motor_step == pytest.approx(DEG / 40)
    assert 'set $1=255' in arm.advice


def test_speed_is_limited_by_the_controller(bench):
    bench.serve({'max_rate': 20.0})
    arm = bench.connect(speed=100 * DEG)
    arm.move_to(1 * DEG)
    assert bench.states[1].velocity == pytest.approx(20 * DEG)


def test_second_command_is_refused_while_one_runs(bench):
    bench.serve()
    arm, future = bench.connect_moving(30 * DEG)
    for command in (arm.measure, arm.home, lambda: arm.move_to(0.0)):
        with pytest.raises(ArmBusyError):
            command()
    assert future.result(timeout=10).azimuth == pytest.approx(30 * DEG)


# --- stopping ---------------------------------------------------------------------------------


@pytest.mark.parametrize('target', [300 * DEG, -300 * DEG])
def test_stop_ends_a_long_move_and_keeps_the_position(bench, target):
    bench.serve({'acceleration': 200.0})
    arm, future = bench.connect_moving(target)
    state = arm.stop()
    assert not bench.server.is_moving()
    with pytest.raises(ArmStoppedError):
        future.result(timeout=10)
    assert state.velocity == 0.0
    assert 0.0 < state.azimuth / target < 0.5
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-5)
    braking = [s for s in bench.states if s.stamp < state.stamp][1:]
    assert all(s.velocity * target > 0.0 for s in braking)
    assert arm.move_to(state.azimuth + 1 * DEG).azimuth == pytest.approx(
        state.azimuth + 1 * DEG, abs=1e-5
    )


def test_stop_of_a_standing_arm_tells_where_it_is(bench):
    bench.serve()
    arm = bench.connect()
    arm.move_to(2 * DEG)
    assert arm.stop().azimuth == pytest.approx(2 * DEG)
    assert arm.move_to(0.0).azimuth == 0.0


def test_stop_resends_a_lost_hold(bench):
    bench.serve()
    arm, future = bench.connect_moving(300 * DEG)
    receive = bench.server.controller.receive
    lost = []

    def lose_first_hold(data, now):
        if b'!' in data and not lost:
            lost.append(data)
            data = data.replace(b'!', b'')
        receive(data, now)

    bench.server.arm.controller.receive = lose_first_hold
    state = arm.stop()
    assert lost
    assert bench.server.true_azimuth() == pytest.approx(state.azimuth, abs=1e-5)
    assert future.exception(timeout=10)


def test_stop_while_homing_leaves_a_standing_arm_of_uncertain_position(bench):
    bench.serve({22: 1, 'max_rate': 200.0}, home_position=0.0)
    arm = bench.connect(speed=200 * DEG)
    arm.home()
    arm.move_to(90 * DEG)
    future = ThreadPoolExecutor(1).submit(arm.home)
    bench.server.wait_until_moving()
    assert arm.stop() is None
    assert not bench.server.is_moving()
    assert isinstance(future.exception(timeout=10), ArmError)
    assert arm.doubt
    with pytest.raises(ArmPositionError):
        arm.move_to(0.0)


def test_close_stops_a_moving_arm_and_frees_the_port(bench):
    bench.serve({'acceleration': 200.0}, reset_on_open=False)
    arm, future = bench.connect_moving(300 * DEG)
    arm.close()
    arm.close()
    assert not bench.server.is_moving()
    assert isinstance(future.exception(timeout=10), ArmError)
    again = bench.connect()
    assert again.measure().azimuth == pytest.approx(bench.server.true_azimuth(), abs=1e-5)
    with pytest.raises(ArmConnectionError, match='was closed'):
        arm.measure()


def test_close_stops_an_arm_that_does_not_answer(bench):
    bench.serve()
    arm, future = bench.connect_moving(3000 * DEG, response_timeout=0.3)
    bench.server.spoil(lambda data: b'')
    receive = bench.server.controller.receive
    bench.server.arm.controller.receive = lambda data, now: receive(data.replace(b'!', b''), now)
    arm.close()
    wait_until(lambda: not bench.server.is_moving(), 'the end of the motion')
    assert isinstance(future.exception(timeout=10), ArmError)


# --- homing -----------------------------------------------------------------------------------


def test_controller_with_a_switch_must_be_homed_first(bench):
    bench.serve({22: 1}, home_position=20.0)
    arm = bench.connect()
    assert 'has not been homed' in arm.doubt
    with pytest.raises(ArmPositionError, match=r'has not been homed .*; home the arm'):
        arm.move_to(1 * DEG)
    state = arm.home()
    assert state.azimuth == pytest.approx(-1 * DEG)  # its pull-off
    assert arm.doubt == ''
    arm.move_to(-2 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(19 * DEG)
    assert arm.home().azimuth == pytest.approx(-1 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(20 * DEG)


def test_homing_without_a_switch_returns_to_zero(bench):
    bench.serve()
    arm = bench.connect()
    arm.move_to(5 * DEG)
    assert arm.home().azimuth == 0.0
    assert bench.server.true_azimuth() == pytest.approx(0.0)


@pytest.mark.parametrize(
    ('mark', 'limit'), [(100.0, 0.0), (-2.0, 190.0), (-90.0, 0.0), (-90.0, 190.0)]
)
def test_index_is_where_azimuth_0_is_from_then_on(bench, mark, limit):
    bench.serve({'max_rate': 400.0, 10: 0}, index=(mark, 5.0), work_offset=7.0)
    arm = bench.connect(speed=400 * DEG, index_within=limit * DEG)
    assert 'has not searched its index' in arm.doubt
    with pytest.raises(ArmPositionError, match='home the arm'):
        arm.move_to(1 * DEG)
    turn = 360.0 if mark < 0.0 and not limit and mark + 5.0 < 0.0 else 0.0  # forward round to it
    for _ in range(2):
        assert arm.home().azimuth == pytest.approx(0.0, abs=1e-9)
        assert bench.server.true_azimuth() == pytest.approx((mark + turn) * DEG, abs=0.041 * DEG)
        assert arm.doubt == ''
        arm.move_to(-25 * DEG)
        expected = mark + turn - 25.0
        assert bench.server.true_azimuth() == pytest.approx(expected * DEG, abs=0.041 * DEG)
    bench.server.reboot()
    wait_until(lambda: arm.doubt)
    arm.home()
    true = math.remainder(bench.server.true_azimuth() - mark * DEG, 2 * math.pi)
    assert true == pytest.approx(0.0, abs=0.041 * DEG)


def test_lost_motor_steps_are_found_by_the_index(bench):
    bench.serve({'max_rate': 400.0}, index=(100.0, 5.0))
    arm = bench.connect(speed=400 * DEG, index_within=0.0)
    arm.home()
    arm.move_to(40 * DEG)
    bench.server.slip(-3.0)
    assert arm.measure().azimuth == pytest.approx(40 * DEG)  # the controller does not see it
    assert arm.home().azimuth == pytest.approx(0.0, abs=1e-9)
    true = math.remainder(bench.server.true_azimuth() - 100 * DEG, 2 * math.pi)
    assert true == pytest.approx(0.0, abs=0.041 * DEG)


def test_missing_index_is_named_and_the_arm_stays_uncertain(bench):
    bench.serve({'max_rate': 4000.0})
    arm = bench.connect(speed=4000 * DEG, index_within=0.0)
    for _ in range(2):
        with pytest.raises(ArmProtocolError, match='found no index; is its sensor connected'):
            arm.home()
        assert arm.doubt


def test_sensor_that_is_always_active_is_named(bench):
    bench.serve({'max_rate': 4000.0}, index=(0.0, 360.0))
    arm = bench.connect(speed=4000 * DEG, index_within=0.0)
    with pytest.raises(ArmProtocolError, match=r'is active wherever the arm stands; \$6'):
        arm.home()


def test_search_keeps_within_the_cable(bench):
    bench.serve({'max_rate': 4000.0}, index=(250.0, 5.0))
    arm = bench.connect(speed=4000 * DEG, index_within=100 * DEG)
    with pytest.raises(ArmProtocolError, match='found no index'):
        arm.home()
    assert bench.server.true_azimuth() == pytest.approx(-100 * DEG)
    assert max(state.azimuth for state in bench.states) <= 100.1 * DEG


def test_stop_ends_the_search(bench):
    bench.serve({'acceleration': 200.0}, index=(-90.0, 5.0))
    arm = bench.connect(index_within=0.0)
    future = ThreadPoolExecutor(1).submit(arm.home)
    bench.server.wait_until_moving()
    assert arm.stop() is None
    assert not bench.server.is_moving()
    assert isinstance(future.exception(timeout=10), ArmStoppedError)
    assert arm.doubt


def test_failed_homing_says_why_and_can_be_repeated(bench):
    bench.serve({22: 1, 25: 99999.0, 'max_rate': 2000.0}, home_position=None)
    arm = bench.connect()
    for _ in range(2):
        with pytest.raises(ArmAlarmError, match=r'ALARM:9 \(homing did not find'):
            arm.home()
        assert arm.doubt


# --- faults -----------------------------------------------------------------------------------


def test_reboot_of_a_standing_arm_is_noticed_and_homing_makes_a_new_origin(bench):
    bench.serve()
    arm = bench.connect()
    arm.move_to(5 * DEG)
    bench.server.reboot()
    wait_until(lambda: arm.doubt, 'the banner')
    for command in (arm.measure, lambda: arm.move_to(0.0)):
        with pytest.raises(ArmPositionError, match='restarted by itself; home the arm'):
            command()
    assert arm.home().azimuth == 0.0
    arm.move_to(1 * DEG)
    assert bench.server.true_azimuth() == pytest.approx(6 * DEG)


def test_reboot_of_a_moving_arm_fails_the_move(bench):
    bench.serve()
    arm, future = bench.connect_moving(300 * DEG)
    bench.server.reboot()
    with pytest.raises(ArmPositionError, match=r'position is lost: .* restarted by itself'):
        future.result(timeout=10)
    with pytest.raises(ArmPositionError):
        arm.move_to(0.0)
    assert not bench.server.is_moving()


def test_hard_limit_fails_the_move_and_homing_recovers(bench):
    bench.serve()
    arm, future = bench.connect_moving(300 * DEG, response_timeout=0.3)
    bench.server.alarm(1)
    with pytest.raises(ArmAlarmError, match=r'ALARM:1 \(a limit switch was hit'):
        future.result(timeout=10)
    with pytest.raises(ArmPositionError, match='ALARM:1'):
        arm.move_to(0.0)
    assert arm.home().azimuth == 0.0
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG)


def test_soft_limit_fails_the_move(bench):
    bench.serve({20: 1})
    arm = bench.connect(response_timeout=0.3)
    with pytest.raises(ArmAlarmError, match=r'ALARM:2 \(the target lies outside'):
        arm.move_to(5 * DEG)
    assert arm.doubt


def test_refused_line_is_told_in_words_and_leaves_the_arm_usable(bench):
    bench.serve()
    arm = bench.connect()
    with pytest.raises(ArmProtocolError, match=r'refused G53\S+ with error:33 \(the target is'):
        arm.move_to(3e6 * DEG)
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG)


def test_hold_by_somebody_else_refuses_to_move_until_stopped(bench):
    bench.serve()
    arm = bench.connect()
    bench.server.controller.receive(b'!', time.monotonic())
    with pytest.raises(ArmProtocolError, match='in state Hold, not Idle'):
        arm.move_to(1 * DEG)
    arm.stop()
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG)


def test_arm_moved_by_somebody_else_is_not_reported_as_standing(bench):
    bench.serve({'max_rate': 1.0})
    arm = bench.connect(response_timeout=0.3)
    bench.states.clear()
    bench.server.controller.receive(b'$J=G91X10F6\n', time.monotonic())
    with pytest.raises(ArmProtocolError, match='do not agree that the arm stands: Jog'):
        arm.measure()
    assert not bench.states
    arm.stop()
    assert not bench.server.is_moving()
    assert arm.measure().azimuth == pytest.approx(bench.server.true_azimuth(), abs=1e-5)


def test_lost_answer_times_out_with_a_stopped_arm_that_can_go_on(bench):
    bench.serve()
    arm = bench.connect(response_timeout=0.3)
    count = itertools.count()

    def lose_the_barrier(data):
        return data.replace(b'ok\r\n', b'') if b'ok' in data and next(count) == 1 else data

    bench.server.spoil(lose_the_barrier)
    with pytest.raises(ArmTimeoutError, match='did not answer G4P0 within'):
        arm.move_to(1 * DEG)
    assert not bench.server.is_moving()
    assert arm.move_to(2 * DEG).azimuth == pytest.approx(2 * DEG)


def test_controller_that_falls_silent_times_out(bench):
    bench.serve()
    arm, future = bench.connect_moving(300 * DEG, response_timeout=0.3)
    bench.server.spoil(lambda data: b'')
    with pytest.raises(ArmTimeoutError, match=r'did not answer a status query within 0\.3 s'):
        future.result(timeout=10)
    with pytest.raises(ArmTimeoutError):
        arm.measure()
    bench.server.spoil(lambda data: data)
    assert arm.move_to(2 * DEG).azimuth == pytest.approx(2 * DEG), 'it is held for ever'


@pytest.mark.parametrize('command', ['home', 'spin'])
def test_arm_that_was_left_held_can_be_told_anything(bench, command):
    bench.serve()
    arm, future = bench.connect_moving(300 * DEG, response_timeout=0.3)
    bench.server.spoil(lambda data: b'')
    assert isinstance(future.exception(timeout=10), ArmTimeoutError)
    bench.server.spoil(lambda data: data)
    if command == 'home':
        assert arm.home().azimuth == 0.0
        return
    turning = ThreadPoolExecutor(1).submit(
        arm.spin, lambda: 30 * DEG, -math.inf, math.inf, lambda: None
    )
    bench.server.wait_until_moving()
    arm.stop()
    assert isinstance(turning.exception(timeout=10), ArmStoppedError)


def spoil_reports(bench, change, which):
    """Change the reports whose numbers from now on are in ``which``."""
    count = itertools.count()

    def spoil(data):
        return change(data) if b'<' in data and next(count) in which else data

    bench.server.spoil(spoil)


@pytest.mark.parametrize('which', [{0}, {1}, {2}, {3}, {4}, {5}, {0, 2, 4}])
@pytest.mark.parametrize(
    'change',
    [
        lambda data: data.replace(b'<', b''),
        lambda data: data.replace(b'MPos:41.7', b'MPos:41.'),  # malformed
        lambda data: data.replace(b'MPos:41.', b'MPos:1.'),  # valid, but wrong
        lambda data: data.replace(b'\r\n', b''),
        lambda data: b'',
    ],
)
def test_lost_bytes_of_a_report_do_no_harm(bench, change, which):
    bench.serve(FAST)
    arm = bench.connect(response_timeout=0.8, speed=20000 * DEG)
    arm.move_to(41.72 * DEG)
    bench.states.clear()
    spoil_reports(bench, change, which)
    arm.move_to(41.76 * DEG)
    standing = [state.azimuth / DEG for state in bench.states if state.velocity == 0.0]
    assert standing == pytest.approx([41.72, 41.76])


def test_reports_that_never_agree_are_an_error(bench):
    bench.serve()
    arm = bench.connect(response_timeout=0.3)
    count = itertools.count()
    bench.server.spoil(lambda data: data.replace(b':0.000', b':%d.000' % next(count)))
    with pytest.raises(ArmProtocolError, match='do not agree'):
        arm.measure()


def test_arm_that_is_not_where_it_was_sent_is_an_error(bench):
    bench.serve()
    arm = bench.connect()
    bench.server.spoil(lambda data: data.replace(b'MPos:1.000', b'MPos:0.920'))
    with pytest.raises(ArmProtocolError, match=r'sent to 1\.000° but .* Idle at 0\.920°'):
        arm.move_to(1 * DEG)


def test_noise_between_answers_does_no_harm(bench):
    bench.serve()
    arm = bench.connect()
    bench.server.spoil(lambda data: b'\xff\x00\r\n' + data + b'[MSG:hello]\r\n')
    assert arm.move_to(1 * DEG).azimuth == pytest.approx(1 * DEG)


@pytest.mark.parametrize('moving', [True, False])
def test_unplugging_is_a_connection_error(bench, moving):
    bench.serve()
    if moving:
        arm, future = bench.connect_moving(300 * DEG)
        bench.server.unplug()
        with pytest.raises(ArmConnectionError, match=r'connection on port \S+/arm is lost'):
            future.result(timeout=10)
    else:
        arm = bench.connect()
        bench.server.unplug()
    for command in (arm.measure, arm.home, arm.stop, lambda: arm.move_to(0.0)):
        with pytest.raises(ArmConnectionError, match=r'connection on port \S+/arm is lost'):
            command()
    arm.close()


def test_distrust_lasts_until_homed(bench):
    bench.serve()
    arm = bench.connect()
    arm.distrust('the cat sat on it')
    with pytest.raises(ArmPositionError, match='the cat sat on it; home the arm'):
        arm.measure()
    arm.home()
    assert arm.measure().azimuth == 0.0


def test_no_thread_is_left(bench):
    bench.serve()
    before = threading.active_count()
    arm = bench.connect()
    assert threading.active_count() == before + 1
    arm.close()
    assert threading.active_count() == before
