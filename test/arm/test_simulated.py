"""The simulated controller, fed bytes and times: as strict as the firmware."""

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panodepth_ros.arm.motion import state_at
from panodepth_ros.arm.simulated import SimulatedController
from panodepth_ros.arm.simulated_settings import default_settings

BANNER = "\r\nGrbl 1.1h ['$' for help]\r\n"


class Bench:
    """A controller after its start, at time 0."""

    def __init__(self, numbers=None, motor=None, **arguments):
        self.pieces = []
        self.controller = SimulatedController(
            default_settings(**(motor or {})) | (numbers or {}),
            publish=lambda pieces: self.pieces.__setitem__(slice(None), pieces),
            **arguments,
        )
        self.now = 0.0
        self.controller.power_up(0.0)
        self.greeting = self.read()

    def read(self):
        return self.controller.take_output().decode()

    def say(self, text, wait=0.0):
        """Send text, let time pass, return all answers."""
        self.controller.receive(text.encode('latin-1'), self.now)
        self.now += wait
        self.controller.advance(self.now)
        return self.read()

    def status(self):
        return re.match(r'<(.*?)\|[MW]Pos:(-?[\d.]+),', self.say('?')).groups()

    def true_degrees(self):
        return math.degrees(state_at(self.pieces, self.now)[0]) if self.pieces else 0.0


@pytest.mark.parametrize(
    ('line', 'answer'),
    [
        ('', 'ok'),
        ('G21 G90', 'ok'),
        ('g1 x1 f600 ; comment', 'ok'),
        ('(comment) G0 X1', 'ok'),
        ('G4P0', 'ok'),
        ('1', 'error:1'),
        ('X1 ?Y', None),
        ('G', 'error:2'),
        ('G1 X F600', 'error:2'),
        ('$Q', 'error:3'),
        ('$999=1', 'error:3'),
        ('G1 X1 F-5', 'error:4'),
        ('$H', 'error:5'),
        ('G1 X1 (' + 'a' * 40 + ')' + 'F1' + '0' * 80, 'error:11'),
        ('$J=X1F100G4', 'error:16'),
        ('G1 A1 F600', 'error:20'),
        ('G2 X1 F600', 'error:20'),
        ('M3', 'error:20'),
        ('G20 G21', 'error:21'),
        ('G1 X1', 'error:22'),
        ('$J=X1', 'error:22'),
        ('G1.5 X1', 'error:23'),
        ('G1 X1 X2 F600', 'error:25'),
        ('G1 F600', 'error:26'),
        ('G4', 'error:28'),
        ('G4 P0 X1', 'error:31'),
        ('G1 X9999999999 F600', 'error:33'),
        ('G1 X1 S5 F600', 'error:36'),
        ('G38.2 F600', 'error:26'),
        ('G38.2 X5', 'error:22'),
        ('G38.3 X0 F600', 'error:33'),
        ('G53 G38.3 X5 F600', 'error:30'),
        ('G38.6 X5 F600', 'error:20'),
        ('G1 G38.3 X5 F600', 'error:21'),
        ('G38.3 X5 F6000', '[PRB:5.000,0.000,0.000:0]\r\nok'),
        ('G38.2 X5 F6000', 'ALARM:5\r\n[PRB:5.000,0.000,0.000:0]\r\nok'),
        ('G38.4 X5 F6000', 'ALARM:4\r\nok'),
    ],
)
def test_line_is_answered(line, answer):
    if answer is None:  # the status query is taken out of the middle of the line
        answers = Bench().say(line + '\n')
        assert answers.startswith('<Idle|')
        assert answers.endswith('error:2\r\n')
    else:
        assert Bench().say(line + '\n', wait=5.0) == answer + '\r\n'


def test_banner_comes_after_the_boot_time_and_bytes_before_are_lost():
    bench = Bench(boot_time=1.5)
    assert bench.greeting == ''
    assert bench.say('?G1\n', wait=1.4) == ''
    assert bench.say('?', wait=0.2) == BANNER
    assert bench.status() == ('Idle', '0.000')


def test_ok_means_parsed_and_the_barrier_means_moved():
    bench = Bench()
    assert bench.say('G1X10F600\nG4P0\n', wait=0.9) == 'ok\r\n'  # 10° at 10°/s: 1 s and ramps
    assert bench.status()[0] == 'Run'
    assert bench.say('', wait=0.2) == 'ok\r\n'
    assert bench.status() == ('Idle', '10.000')
    assert bench.true_degrees() == pytest.approx(10.0)


def test_status_in_the_same_write_as_a_move_shows_the_old_idle():
    assert Bench().say('G1X10F600\n?').startswith('<Idle|MPos:0.000,')


def test_status_during_a_motion_tells_speed_and_place():
    bench = Bench()
    bench.say('G1X10F600\n', wait=0.5)
    report = bench.say('?')
    assert re.match(r'<Run\|MPos:(4\.9\d\d|5\.0\d\d),0\.000,0\.000\|FS:600,0', report)


def test_positions_are_motor_steps_and_report_rounds_them():
    bench = Bench()
    bench.say('G1X0.0514286F600\n', wait=1.0)  # 1.29 of 25 steps per degree: 1 step
    assert bench.status() == ('Idle', '0.040')
    assert bench.true_degrees() == pytest.approx(0.04)
    bench.say('G1X-0.06F600\n', wait=1.0)  # −1.5 steps, rounded away from 0
    assert bench.status() == ('Idle', '-0.080')


def test_move_without_a_step_never_shows_run():
    bench = Bench()
    bench.say('G1X0.01F1\n')
    assert bench.status()[0] == 'Idle'


def test_relative_moves_in_32_bit_floats_drift_from_exact_ones():
    bench = Bench(motor={'max_rate': 1e6, 'acceleration': 1e9})
    bench.say('G1X3600F99999999\n', wait=1.0)
    for _ in range(700):
        bench.say('G91X0.0514286\n', wait=0.1)
    assert bench.status()[1] != '3636.000'
    bench.say('G90X3636\n', wait=0.1)
    assert bench.status()[1] == '3636.000'


def test_modes_persist_until_a_reset():
    bench = Bench()
    bench.say('G20G91G1X1F100\n', wait=20.0)
    assert bench.status() == ('Idle', '25.400')
    bench.say('X1\n', wait=20.0)
    assert bench.status() == ('Idle', '50.800')
    assert bench.say('\x18') == BANNER
    assert bench.status() == ('Idle', '50.800')
    assert bench.say('G1X1\n') == 'error:22\r\n'
    bench.say('G1X1F6000\n', wait=20.0)
    assert bench.status() == ('Idle', '1.000')


def test_hold_brakes_and_resume_goes_on():
    bench = Bench(motor={'acceleration': 100.0})
    bench.say('G1X10F600\n', wait=0.5)
    bench.say('!', wait=0.05)  # 10°/s at 100°/s²: 0.1 s
    assert bench.status()[0] == 'Hold:1'
    bench.now += 0.1
    state, position = bench.status()
    assert state == 'Hold:0'
    assert float(position) == pytest.approx(bench.true_degrees(), abs=1e-3)
    assert 4.0 < float(position) < 7.0
    assert bench.say('G1X0\n', wait=1.0) == ''  # waits in the buffer
    assert bench.say('~', wait=5.0) == 'ok\r\n'
    assert bench.status() == ('Idle', '0.000')


def test_reset_of_a_held_arm_keeps_its_count_and_drops_the_motion():
    bench = Bench()
    bench.say('G1X10F600\nG4P0\n', wait=0.5)
    bench.say('!', wait=0.1)
    assert bench.say('\x18') == 'ok\r\n' + BANNER  # the barrier's line was cut off
    state, position = bench.status()
    assert state == 'Idle'
    assert float(position) == pytest.approx(bench.true_degrees(), abs=1e-3)
    bench.now += 10.0
    assert bench.status() == ('Idle', position)


def test_reset_of_a_moving_arm_is_an_alarm_and_loses_the_count():
    bench = Bench(motor={'acceleration': 100.0})
    bench.say('G1X10F600\n', wait=0.5)
    assert bench.say('\x18') == 'ALARM:3\r\n' + BANNER + "[MSG:'$H'|'$X' to unlock]\r\n"
    state, position = bench.status()
    assert state == 'Alarm'
    assert abs(float(position) - bench.true_degrees()) > 0.1
    assert bench.say('G1X0F600\n') == 'error:9\r\n'
    assert bench.say('\x18').endswith('unlock]\r\n')
    assert bench.say('$X\n') == '[MSG:Caution: Unlocked]\r\nok\r\n'
    assert bench.say('G1X0F600\n', wait=5.0) == 'ok\r\n'


def test_jog_is_cancelled_by_one_byte_and_locks_lines():
    bench = Bench()
    assert bench.say('$J=G91X10F600\n', wait=0.5) == 'ok\r\n'
    assert bench.status()[0] == 'Jog'
    assert bench.say('G4P0\n') == 'error:9\r\n'
    bench.say('\x85', wait=0.1)
    state, position = bench.status()
    assert state == 'Idle'
    assert float(position) == pytest.approx(bench.true_degrees(), abs=1e-3)
    bench.say('G91G1X1F600\n', wait=1.0)
    assert float(bench.status()[1]) == pytest.approx(float(position) + 1.0, abs=1e-3)


def test_planner_takes_15_moves_and_then_ok_waits():
    bench = Bench()
    lines = ''.join(f'X{i}\n' for i in range(1, 19))
    assert bench.say('F60\n') == 'ok\r\n'
    assert bench.say('G1' + lines, wait=0.01) == 'ok\r\n' * 15
    assert bench.say('', wait=1.0) == 'ok\r\n'
    assert bench.say('', wait=100.0) == 'ok\r\n' * 2
    assert bench.status() == ('Idle', '18.000')


def test_dwell_waits():
    bench = Bench()
    assert bench.say('G4P0.5\n', wait=0.4) == ''
    assert bench.say('', wait=0.2) == 'ok\r\n'


def test_receive_buffer_overflows():
    bench = Bench()
    bench.say('!')
    bench.say('\n' * 500)
    assert bench.say('~') == 'ok\r\n' * 127


def test_inches_and_work_coordinates_are_reported():
    bench = Bench({13: 1, 10: 0}, work_offset=25.4)
    bench.say('G53G21G1X50.8F99999\n', wait=5.0)
    report = bench.say('?')
    assert report.startswith('<Idle|WPos:1.0000,0.0000,0.0000|FS:0.0,0|WCO:1.0000,0.0000,0.0000>')
    bench.say('G21G1X0\n', wait=5.0)
    assert bench.true_degrees() == pytest.approx(25.4, abs=0.02)


def test_settings_are_listed_and_set():
    bench = Bench()
    listing = bench.say('$$\n')
    assert '$100=25.000\r\n' in listing
    assert '$13=0\r\n' in listing
    assert listing.endswith('$132=360.000\r\nok\r\n')
    assert bench.say('$100=50\n') == 'ok\r\n'
    assert '$100=50.000\r\n' in bench.say('$$\n')
    bench.say('G1X10F600\n', wait=0.1)
    assert bench.say('$$\n') == 'error:8\r\n'


def test_soft_limit_is_critical_until_a_reset():
    bench = Bench({20: 1})
    assert bench.say('$J=X1F100\n') == 'error:15\r\n'
    assert bench.say('G1X1F600\n') == 'ALARM:2\r\n[MSG:Reset to continue]\r\n'
    assert bench.say('?') == ''
    assert BANNER in bench.say('\x18')
    assert bench.status()[0] == 'Alarm'


def test_homing_locks_at_start_and_finds_the_switch():
    bench = Bench({22: 1}, home_position=-30.0)
    assert bench.greeting == BANNER + "[MSG:'$H'|'$X' to unlock]\r\n"
    assert bench.say('G1X1F600\n') == 'error:9\r\n'
    assert bench.say('$H\n', wait=0.5) == ''
    assert bench.say('?') == ''  # no status while it homes
    assert bench.say('', wait=2.0) == 'ok\r\n'
    assert bench.status() == ('Idle', '-1.000')
    assert bench.true_degrees() == pytest.approx(-30.0)


def test_homing_without_a_working_switch_is_an_alarm():
    bench = Bench({22: 1}, home_position=None)
    assert bench.say('$H\n', wait=60.0) == (
        'ALARM:9\r\nok\r\n' + BANNER + "[MSG:'$H'|'$X' to unlock]\r\n"
    )
    assert bench.status()[0] == 'Alarm'


def test_reset_interrupts_homing():
    bench = Bench({22: 1}, home_position=100.0)
    bench.say('$H\n', wait=0.5)
    assert bench.say('\x18').startswith('ALARM:6\r\nok\r\n' + BANNER)


def test_probing_tells_where_the_mark_begins_and_brakes_after_it():
    bench = Bench(motor={'acceleration': 100.0}, index=(20.0, 30.0))
    assert bench.say('G38.2X90F1200\n', wait=0.5) == ''
    assert bench.status()[0] == 'Run'
    assert bench.say('', wait=3.0) == '[PRB:20.000,0.000,0.000:1]\r\nok\r\n'
    assert bench.status() == ('Idle', '22.000')  # v²/2a behind
    assert '|Pn:P' in bench.say('?')
    assert bench.say('G38.2X90F1200\n') == 'ALARM:4\r\nok\r\n'  # it is there already
    assert bench.say('G1X0F1200\n') == 'error:9\r\n'
    bench.say('$X\n')
    assert bench.say('G91G38.5X-90F1200\n', wait=4.0) == '[PRB:20.000,0.000,0.000:1]\r\nok\r\n'
    assert bench.status() == ('Idle', '18.000')
    assert '|Pn' not in bench.say('?')
    assert bench.say('G1X1F1200\nG4P0\n', wait=1.0) == 'ok\r\nok\r\n'
    assert bench.status() == ('Idle', '19.000')  # the rest of the way is forgotten


def test_probing_that_is_held_goes_on_and_one_that_is_reset_ends():
    bench = Bench(motor={'acceleration': 100.0}, index=(50.0, 5.0))
    bench.say('G38.2X90F1200\n', wait=0.5)
    bench.say('!', wait=1.0)
    assert bench.status()[0] == 'Hold:0'
    assert bench.say('~', wait=4.0) == '[PRB:50.000,0.000,0.000:1]\r\nok\r\n'
    bench.say('G90G1X0F3000\n', wait=9.0)
    bench.say('G38.2X40F1200\n', wait=0.5)
    bench.say('!', wait=1.0)
    assert bench.say('\x18') == 'ok\r\n' + BANNER
    assert bench.status()[0] == 'Idle'
    assert bench.say('G1X60F1200\n', wait=5.0) == 'ok\r\n'


def test_power_up_forgets_the_count_but_the_arm_stays():
    bench = Bench()
    bench.say('G1X10F6000\n', wait=2.0)
    bench.controller.power_up(bench.now)
    assert bench.read() == BANNER
    assert bench.status() == ('Idle', '0.000')
    assert bench.true_degrees() == pytest.approx(10.0)
    bench.say('G1X1F6000\n', wait=2.0)
    assert bench.true_degrees() == pytest.approx(11.0)


LINES = st.text(st.sampled_from('GXYFPA$HJ=0123456789.- ;()/\t'), max_size=30)


@settings(max_examples=200)
@given(st.lists(LINES, max_size=10))
def test_every_line_is_answered_once(lines):
    bench = Bench({}, motor={'max_rate': 1e6, 'acceleration': 1e9})
    for line in lines:
        answers = re.findall(r'^(?:ok|error:\d+)\r$', bench.say(line + '\n', wait=1e9), re.M)
        assert len(answers) == 1, (line, answers)


@settings(max_examples=200)
@given(st.lists(st.binary(max_size=30), max_size=10))
def test_any_bytes_leave_a_controller_that_works_after_a_reset(portions):
    bench = Bench()
    for portion in portions:
        bench.say(portion.decode('latin-1'), wait=1.0)
    assert BANNER in bench.say('\x18')
    bench.say('$X\n')
    assert bench.say('G53G21G90G94G1X1F6000\nG4P0\n', wait=1e9).endswith('ok\r\nok\r\n')
    assert bench.status() == ('Idle', '1.000')


def test_queued_moves_of_one_direction_do_not_stop_in_between():
    bench = Bench(motor={'acceleration': 100.0})
    bench.say('G1X10F600\nG1X20F600\n', wait=1.0)
    bench.say('G1X30F600\n', wait=1.06)  # at 20.1°, less than a stop's way into the last one
    assert re.match(r'<Run\|MPos:20\.\d+,0\.000,0\.000\|FS:600,0', bench.say('?'))
    bench.say('', wait=1.1)
    assert bench.status() == ('Idle', '30.000')


def test_line_beyond_the_planner_is_answered_when_a_block_is_over():
    bench = Bench()
    lines = ''.join(f'G1X{k}F600\n' for k in range(1, 17))
    assert bench.say(lines[:120]).count('ok') == 12
    assert bench.say(lines[120:]).count('ok') == 3
    assert bench.say('', wait=0.05) == ''
    assert bench.say('', wait=0.1) == 'ok\r\n'


def test_hold_brakes_within_the_queue_and_resuming_ends_it():
    bench = Bench(motor={'acceleration': 100.0})
    bench.say('G1X10F600\nG1X20F600\n', wait=0.97)
    bench.say('!', wait=0.2)
    state, place = bench.status()
    assert state == 'Hold:0'
    assert 9.0 < float(place) < 11.0
    bench.say('~', wait=2.0)
    assert bench.status() == ('Idle', '20.000')
