"""How the mosaicer leads: an arm that steps, one that turns steadily, and what goes wrong."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.mosaicer import COLUMNS, Bench, TurningBench
from fixtures.rig import HEIGHT
from rclpy.task import Future
from std_srvs.srv import Trigger

from panodepth_ros.mosaic.state import load_state
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry
from panodepth_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros


def standing_until(bench, condition, what):
    """Let a standing arm report its azimuth until something holds."""
    bench.ros.spin_until(lambda: bench.rig.standing() or condition(), what)


# --- an arm that steps ------------------------------------------------------------------------


def test_live_sweep_deg_acts_on_the_next_sweep_not_on_the_one_that_runs(ros):
    bench = Bench(ros).ready()
    bench.rig.frames = False
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 1, 'the first step')
    assert bench.set(sweep_deg=60.0).successful
    bench.rig.frames = True
    bench.rig.frame()
    bench.rig.standing()
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert geometry.seen.all()
    assert bench.rig.steps == COLUMNS
    bench.start()
    geometry = panorama_geometry(bench.sweeps(2)['left/camera_info'])
    assert int(geometry.seen.sum()) == 10
    assert bench.rig.steps == COLUMNS + 10


def test_answer_that_overtakes_joint_states_after_a_silence_ends_no_sweep(ros):
    bench = Bench(ros).ready()
    bench.rig.answer_early_at = 5
    bench.start()
    leader = bench.mosaicer._leader
    ros.spin_until(
        lambda: (
            bench.rig.answer_early_at is None
            and leader._answer is None
            and not bench.rig_is_ahead()
        ),
        'the answer and the late joint state',
    )
    assert bench.mosaicer._leading
    bench.rig.move()
    bench.rig.frame()
    bench.rig.standing()
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert geometry.seen.all()


def test_joint_states_that_are_lost_cost_no_column(ros):
    """As when the mosaicer is held up just after it has asked for a step."""
    bench = Bench(ros).ready()
    bench.rig.silent_at = 5
    bench.start()
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert geometry.seen.all()


def test_column_is_kept_before_the_next_step_is_asked_for(ros, tmp_path):
    bench = Bench(ros, state_file=str(tmp_path / 'sweep')).ready()
    bench.rig.frames = False
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 1, 'the first step')
    bench.rig.frame()
    ros.spin_until(lambda: bench.rig.steps == 2, 'the second step')
    builder = bench.mosaicer._assembler
    state = load_state(tmp_path / 'sweep', builder.rig, builder.camera)
    assert state.sweep(builder.rig, builder.camera).progress == 1 / COLUMNS


def test_frame_that_cannot_be_used_costs_no_column(ros):
    bench = Bench(ros).ready()
    bench.rig.frames = False
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 1, 'the first step')
    bench.rig.frame(height=5)
    refusal = f'frame is 41 × 5 px; allowed: 41 × {HEIGHT}, as the camera_info says'
    ros.spin_until(
        lambda: bench.mosaicer._assembler.drops[refusal] or bench.rig.steps == 2, 'the refusal'
    )
    bench.rig.frames = True
    bench.rig.frame()
    bench.rig.standing()
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert geometry.seen.all()


class UnwindingBench(Bench):
    """Its arm has a cable: it has turned three columns before it is told to unwind."""

    def __init__(self, ros, **values):
        super().__init__(ros, **values)
        self.asked = []
        self.refuse = ''
        self.rig.create_service(Trigger, 'arm_driver/unwind', self.on_unwind)
        self.rig.steps = 3
        self.ready()
        ros.spin_until(self.mosaicer._leader._unwind_client.service_is_ready, 'unwind')

    def on_unwind(self, _, response):
        self.asked.append(self.rig.steps)
        response.success, response.message = not self.refuse, self.refuse
        while self.rig.steps > 0 and not self.refuse:
            self.rig.joint_state(self.rig.azimuth, -0.5)
            self.rig.steps -= 1
        return response


def test_cable_is_unwound_before_the_first_step(ros):
    bench = UnwindingBench(ros)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    diagnosis.says(DiagnosticStatus.OK, 'waiting for the arm to unwind its cable')
    assert bench.rig.steps == 0, 'the arm was told to step before it stood'
    bench.rig.standing()
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    assert bench.asked == [3]
    assert sorted(row) == list(range(1, COLUMNS + 1))


def test_cable_that_cannot_be_unwound_ends_the_sweep(ros, capfd):
    bench = UnwindingBench(ros)
    bench.refuse = 'the position is uncertain'
    bench.start()
    bench.given_up()
    said = capfd.readouterr().err
    assert 'the arm refused to unwind its cable: the position is uncertain' in said
    assert bench.rig.steps == 3


def test_arm_that_never_stands_after_unwinding_ends_the_sweep(ros, capfd):
    bench = UnwindingBench(ros, step_timeout=0.5)
    bench.start()
    bench.given_up()
    assert 'the arm did not unwind its cable: for 0.5 s it neither' in capfd.readouterr().err


def test_long_unwinding_is_no_timeout(ros):
    bench = UnwindingBench(ros, step_timeout=0.5)
    bench.start()
    ros.spin_until(lambda: bench.asked, 'unwinding')
    begun = bench.rig.now

    def turns_for_long():
        bench.rig.steps -= 1
        bench.rig.joint_state(bench.rig.azimuth, -0.5)
        return bench.mosaicer._leader._steps == 0 and bench.rig.now - begun > 500_000_000

    ros.spin_until(turns_for_long, 'a long turn')
    bench.rig.steps = 0
    bench.rig.standing()
    assert bench.sweeps()


# --- an arm that turns steadily ---------------------------------------------------------------


def test_turning_arm_is_led_for_one_sweep_and_stopped(ros):
    bench = TurningBench(ros)
    bench.start()
    bench.told(True)
    bench.turn(COLUMNS + 2)
    info = bench.sweeps()['left/camera_info']
    geometry = panorama_geometry(info)
    assert geometry.seen.all()
    assert not geometry.uniform
    bench.told(True, False)
    bench.turn(COLUMNS)
    assert bench.mosaicer._assembler.sweep is None, 'a braking arm begins no sweep'


def test_free_running_makes_sweep_after_sweep_until_cancelled(ros):
    bench = TurningBench(ros, free_running=True)
    bench.start()
    bench.told(True)
    bench.turn(2 * COLUMNS + 3)
    bench.sweeps(2)
    bench.told(True)
    assert bench.call('cancel').success
    bench.told(True, False)


def test_arm_that_refuses_to_turn_ends_the_sweep(ros, capfd):
    bench = TurningBench(ros)
    bench.rig.refuse_to_spin = 'the cable is at its limit'
    bench.start()
    bench.given_up()
    assert 'the arm refused to turn: the cable is at its limit' in capfd.readouterr().err


def test_turning_arm_without_frames_is_reported_and_goes_on(ros, capfd):
    bench = TurningBench(ros, frame_timeout=0.1)
    bench.start()
    bench.told(True)
    said = ''
    while 'the sweep waits at column 0 of 60' not in said:
        ros.executor.spin_once(timeout_sec=0.1)
        said += capfd.readouterr().err
    bench.turn(COLUMNS + 2)
    assert panorama_geometry(bench.sweeps()['left/camera_info']).seen.all()


def test_arm_that_stops_turning_ends_the_sweep(ros, capfd):
    bench = TurningBench(ros, step_timeout=0.3)
    bench.start()
    bench.told(True)
    bench.turn(10)
    standing_until(bench, lambda: not bench.mosaicer._leading, 'the end of the sweep')
    bench.given_up()
    said = capfd.readouterr().err
    assert 'the arm stopped turning: its joint states have stayed at 120.00° for 0.3 s' in said
    bench.told(True, False)


def test_silent_joint_states_are_no_standing_arm(ros):
    bench = TurningBench(ros, step_timeout=0.1, joint_state_gap=0.05, frame_timeout=0.2)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    bench.told(True)
    bench.turn(10)
    diagnosis.says(DiagnosticStatus.WARN, 'waiting for a frame')
    assert bench.mosaicer._leading
    assert bench.call('cancel').success


def test_start_waits_for_an_arm_that_still_brakes(ros):
    bench = TurningBench(ros)
    bench.rig.braking = Future(executor=ros.executor)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    bench.told(True)
    assert bench.call('cancel').success
    bench.told(True, False)
    bench.start()
    diagnosis.says(DiagnosticStatus.OK, 'waiting for the arm to stop')
    bench.turn(5)
    bench.told(True, False)
    assert bench.mosaicer._assembler.sweep is None, 'a braking arm begins no sweep'
    bench.rig.braking.set_result(None)
    bench.told(True, False, True)
    bench.turn(COLUMNS + 2)
    assert panorama_geometry(bench.sweeps()['left/camera_info']).seen.all()


def test_arm_that_never_stops_braking_ends_the_sweep_but_not_the_next(ros, capfd):
    bench = TurningBench(ros, step_timeout=0.3)
    bench.rig.braking = Future(executor=ros.executor)
    bench.start()
    bench.told(True)
    assert bench.call('cancel').success
    bench.start()
    bench.given_up()
    assert 'the arm did not stop after the last sweep within 0.3 s' in capfd.readouterr().err
    bench.told(True, False, False)
    bench.rig.braking.set_result(None)
    ros.spin_until(lambda: bench.mosaicer._leader._braking is None, 'the answer')
    bench.start()
    bench.told(True, False, False, True)


def test_stop_that_is_refused_or_cannot_be_asked_for_is_said(ros, capfd):
    bench = TurningBench(ros)
    bench.rig.refuse_to_stop = 'the motor is hot'
    said = ''

    def hears(words):
        nonlocal said
        said += capfd.readouterr().err
        return words in said

    bench.start()
    bench.told(True)
    assert bench.call('cancel').success
    ros.spin_until(lambda: hears('the arm refused to stop: the motor is hot'), 'the complaint')
    bench.start()
    bench.told(True, False, True)
    bench.rig.destroy_service(bench.rig.spin_service)
    ros.spin_until(lambda: bench.mosaicer._leader.missing_service, 'the end of the service')
    assert bench.call('cancel').success
    assert hears('the arm could not be told to stop: the service arm_driver/spin is not there')


def test_free_running_needs_a_turning_arm(ros):
    with pytest.raises(ParameterError, match='free_running is true; allowed: with motion cont'):
        Bench(ros, free_running=True)
