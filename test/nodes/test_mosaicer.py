"""The mosaicer node: leading, listening, refusing, giving up."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.mosaicer import COLUMNS, STEP_DEG, Bench, parameters
from fixtures.rig import HEIGHT
from sensor_msgs.msg import Image
from std_msgs.msg import String

from panodepth_ros.nodes.mosaicer import Mosaicer
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry
from panodepth_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros


@pytest.fixture
def bench(ros):
    return Bench(ros).ready()


def test_led_sweep_makes_the_panoramas(bench):
    bench.start()
    got = bench.sweeps()
    for name, u in (('left', 40), ('right', 0), ('center', 20)):
        image, info = got[f'{name}/image'], got[f'{name}/camera_info']
        assert image.header == info.header
        assert image.header.frame_id == 'panodepth'
        pixels = to_array(image)
        assert pixels.shape == (HEIGHT, COLUMNS, 3)
        assert (pixels[:, :, 1] == u).all()
        assert sorted(pixels[0, :, 0].tolist()) == list(range(1, COLUMNS + 1))
        geometry = panorama_geometry(info)
        assert geometry.uniform
        sign = {'left': -1, 'right': 1, 'center': 0}[name]
        assert geometry.principal_angle == pytest.approx(sign * math.atan(20 / 40))
        # Frame 15 was taken at 90 degrees: its column looks at 90 degrees plus the ray's angle.
        (column,) = np.flatnonzero(pixels[0, :, 0] == 15)
        beta = float(geometry.ray_azimuth(column)) - geometry.principal_angle
        assert math.remainder(beta - math.pi / 2, 2 * math.pi) == pytest.approx(0, abs=1e-9)
    assert bench.rig.steps == COLUMNS
    bench.ros.spin_until(lambda: bench.progress and bench.progress[-1] == 1.0, 'progress')
    assert bench.progress == [pytest.approx(k / COLUMNS) for k in range(COLUMNS + 1)]
    bench.rig.standing()
    bench.ros.spin_until(lambda: not bench.rig_is_ahead(), 'the last joint state')
    assert bench.progress[-1] == 1.0, 'a finished sweep stays finished'


def test_stamp_is_the_end_of_the_sweep_and_the_duration_travels(bench):
    bench.start()
    info = bench.sweeps()['left/camera_info']
    duration = panorama_geometry(info).sweep_duration
    assert 0 < duration < 100
    end = info.header.stamp.sec + info.header.stamp.nanosec * 1e-9
    assert end <= bench.rig.now / 1e9
    assert end > bench.rig.now / 1e9 - 0.2


def test_listening_gives_the_same_panoramas_as_leading(ros):
    led = Bench(ros).ready()
    topics = ('image_raw', 'camera_info', 'joint_states')
    remappings = [word for topic in topics for word in ('-r', f'{topic}:=/{topic}')]
    ros.add(
        Mosaicer(
            context=ros.context,
            namespace='listening',
            parameter_overrides=parameters(lead=False),
            cli_args=['--ros-args', *remappings],
        )
    )
    heard = []
    led.listener.create_subscription(Image, 'listening/left/image', heard.append, 10)
    ros.spin_until(
        lambda: (
            led.listener.count_publishers('listening/left/image')
            and all(led.rig.count_subscribers(topic) == 2 for topic in topics)
        ),
        'the listener',
    )
    led.start()
    ours = led.sweeps()['left/image']
    ros.spin_until(lambda: heard, 'the listening mosaicer')
    assert heard[0] == ours


def test_compressed_frames_give_the_same_panoramas(ros):
    raw = Bench(ros).ready()
    topics = ('image_raw/compressed', 'camera_info', 'joint_states')
    remappings = [word for topic in topics for word in ('-r', f'{topic}:=/{topic}')]
    ros.add(
        Mosaicer(
            context=ros.context,
            namespace='compressed',
            parameter_overrides=parameters(lead=False, image_transport='compressed'),
            cli_args=['--ros-args', *remappings],
        )
    )
    heard = []
    raw.listener.create_subscription(Image, 'compressed/left/image', heard.append, 10)
    ros.spin_until(
        lambda: (
            raw.listener.count_publishers('compressed/left/image')
            and all(raw.rig.count_subscribers(topic) for topic in topics)
            and raw.rig.count_subscribers('joint_states') == 2
        ),
        'the mosaicer of compressed frames',
    )
    assert raw.rig.count_subscribers('image_raw') == 1, 'raw frames cross the network, too'
    raw.start()
    ours = raw.sweeps()['left/image']
    ros.spin_until(lambda: heard, 'the panorama of compressed frames')
    assert heard[0] == ours


def test_diagnostics_say_what_the_sweep_waits_for(ros):
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench = Bench(ros, frame_timeout=0.1)
    diagnosis.says(DiagnosticStatus.WARN, 'no camera_info received yet')
    bench.ready()
    assert diagnosis.says(DiagnosticStatus.OK, 'ready')['last_end'] == 'none yet'
    bench.rig.frames = False
    bench.start()
    values = diagnosis.says(DiagnosticStatus.WARN, 'frame 1 of 60: waiting for a frame for')
    assert (values['columns'], values['sweep_columns']) == ('0', '60')
    assert bench.call('cancel').success
    diagnosis.told.clear()
    assert diagnosis.says(DiagnosticStatus.OK, 'ready')['last_end'] == 'given up: cancelled'


def test_status_says_in_words_what_the_graph_waits_for(ros):
    said = []
    bench = Bench(ros, robot_motion='require')
    bench.listener.create_subscription(
        String, 'mosaicer/status', lambda message: said.append(message.data), 10
    )

    def says(words):
        ros.spin_until(lambda: any(words in line for line in said), f'a status with {words!r}')

    says('no camera_info received yet')
    bench.ready()
    says('robot_motion is require')


def test_diagnostics_name_an_unusable_camera(ros):
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench = Bench(ros)
    bench.rig.camera_info(focal_length=0.0)
    diagnosis.says(DiagnosticStatus.ERROR, 'fx is 0.0')


def test_second_sweep_follows_the_first(bench):
    bench.start()
    bench.sweeps()
    bench.start()
    again = bench.sweeps(2)['left/image']
    assert set(to_array(again)[0, :, 0].tolist()) == set(range(COLUMNS + 1, 2 * COLUMNS + 1))


def test_part_of_a_turn(ros):
    bench = Bench(ros, sweep_deg=60.0).ready()
    bench.start()
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert geometry.columns == COLUMNS
    assert int(geometry.seen.sum()) == 10
    assert bench.rig.steps == 10


def test_live_parameter_acts_on_the_next_sweep(bench):
    assert bench.set(column_offset_px=10.0).successful
    bench.start()
    assert (to_array(bench.sweeps()['left/image'])[:, :, 1] == 30).all()


def test_column_outside_the_image_is_refused_live(bench):
    result = bench.set(column_offset_px=21.0)
    assert not result.successful
    assert 'u = 41.0, outside the image; allowed: 0 to 40' in result.reason


def test_camera_that_looks_aside_is_turned_back(bench):
    yaw = 5.0
    assert bench.set(column_offset_px=10.0).successful
    assert bench.set(camera_yaw_deg=yaw).successful
    bench.start()
    got = bench.sweeps()
    for name, offset in (('left', 10.0), ('right', -10.0), ('center', 0.0)):
        u = 20 + 40 * math.tan(math.atan(offset / 40) + math.radians(yaw))
        assert (to_array(got[f'{name}/image'])[4, :, 1] == round(u)).all()
        assert panorama_geometry(got[f'{name}/camera_info']).uniform


def test_mounting_that_turns_the_columns_out_of_the_image_is_refused_live(bench):
    result = bench.set(camera_yaw_deg=10.0)
    assert not result.successful
    assert 'the column +20 px' in result.reason
    assert 'outside the image; allowed: 0 to 40' in result.reason


def test_live_offset_of_a_further_pair_is_refused(ros):
    result = Bench(ros, further_offsets_px=[13.0]).set(column_offset_px=13.0)
    assert not result.successful
    assert 'allowed: distances that differ' in result.reason


def test_read_only_parameter_is_refused_live(bench):
    assert not bench.set(column_step_deg=3.0).successful


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'column_step_deg': 0.7}, 'column_step_deg is 0.7'),
        ({'sweep_deg': 100.0}, 'sweep_deg is 100.0: 16.667 steps'),
        ({'arm_radius': -1.0}, 'arm_radius is -1.0; allowed: 0.01 to 10 m'),
        ({'arm_radius': 'wide'}, "arm_radius is 'wide'; allowed: a floating-point number"),
        ({'stripe_columns': 7}, 'stripe_columns is 7; allowed: divisors of the 60 columns'),
        ({'stripe_distance': 0.5, 'stripe_columns': 2}, 'stripe_distance is 0.5 m; allowed: at'),
        ({'further_offsets_px': [0.0]}, 'further_offsets_px holds 0.0; allowed: 1 to 10000 px'),
        ({'further_offsets_px': [9.0, 20.0]}, 'further_offsets_px is [9.0, 20.0] besides'),
        ({'further_offsets_px': [9, 8]}, 'allowed: a list of floating-point numbers'),
        ({'column_step_dge': 0.2}, 'unknown parameter column_step_dge for mosaicer'),
    ],
)
def test_bad_parameter_stops_the_start_with_a_sentence(ros, values, sentence):
    with pytest.raises(ParameterError) as error:
        Mosaicer(context=ros.context, parameter_overrides=parameters(**values))
    assert sentence in str(error.value)


def test_start_without_a_camera_is_refused(ros):
    bench = Bench(ros)
    answer = bench.call('start')
    assert not answer.success
    assert 'no camera_info received yet' in answer.message


def test_start_without_an_arm_is_refused(ros):
    bench = Bench(ros)
    bench.rig.camera_info()
    ros.spin_until(lambda: bench.mosaicer._assembler.camera, 'camera_info')
    assert 'no joint state of panodepth_arm_joint' in bench.call('start').message


def test_start_with_a_lens_that_folds_inside_of_the_image_is_refused(ros):
    bench = Bench(ros)
    bench.rig.camera_info(k1=-5.0)
    bench.rig.standing()
    ros.spin_until(lambda: 'folds' in bench.mosaicer._camera_fault, 'camera_info')
    assert 'camera distortion (-5.0, 0.0, 0.0, 0.0, 0.0)' in bench.call('start').message


def test_start_with_an_uncalibrated_camera_is_refused(ros):
    bench = Bench(ros)
    bench.rig.camera_info(focal_length=0.0)
    bench.rig.standing()
    ros.spin_until(lambda: 'fx is 0.0' in bench.mosaicer._camera_fault, 'camera_info')
    assert 'fx is 0.0' in bench.call('start').message


def test_start_of_a_listener_is_refused(ros):
    assert 'only listens' in Bench(ros, lead=False).ready().call('start').message


def test_start_during_a_sweep_is_refused(bench):
    bench.rig.frames = False
    bench.start()
    assert 'a sweep is running' in bench.call('start').message


def test_cancel_ends_the_sweep_without_a_result(bench):
    bench.rig.frames = False
    bench.start()
    assert bench.call('cancel').success
    bench.given_up()
    assert not bench.call('cancel').success


def test_cancelled_sweep_leaves_no_column_behind(bench):
    bench.rig.refuse_at = 20
    bench.start()
    bench.given_up()
    bench.rig.refuse_at = None
    bench.start()
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    assert sorted(row) == list(range(21, 21 + COLUMNS))


def test_start_forgets_what_was_heard_before(ros):
    bench = Bench(ros).ready()
    bench.someone_else_steps(range(20))
    assert bench.mosaicer._assembler.sweep is not None
    bench.start()
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    assert sorted(row) == list(range(21, 21 + COLUMNS))


def test_cancel_of_a_followed_sweep(ros):
    bench = Bench(ros, lead=False).ready()
    bench.someone_else_steps(range(20))
    assert bench.call('cancel').success
    assert bench.mosaicer._assembler.sweep is None
    assert not bench.call('cancel').success


def test_changed_calibration_ends_the_sweep_and_says_so(bench, capfd):
    move = bench.rig.move

    def move_and_change():
        move()
        if bench.rig.steps == 20:
            bench.rig.camera_info(focal_length=41.0)

    bench.rig.move = move_and_change
    bench.start()
    bench.given_up()
    assert 'nothing is published: camera_info has changed' in capfd.readouterr().err


def test_settle_time_is_waited_for(ros):
    # The rig exposes 10 ms after the arm stands; with 15 ms that frame is too early.
    bench = Bench(ros, settle_time=0.015).ready()
    bench.rig.frames = False
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 1, 'the first step')
    bench.rig.frame()
    bench.rig.standing()
    ros.spin_until(
        lambda: bench.mosaicer._assembler.drops['frame: arm was settling'] == 1, 'the early frame'
    )
    bench.rig.frame()
    ros.spin_until(lambda: bench.rig.steps == 2, 'the next step')


def test_missing_sector_is_named(ros, capfd):
    bench = Bench(ros, lead=False).ready()
    bench.someone_else_steps(range(10))
    bench.rig.frames = False
    bench.someone_else_steps([10])
    bench.rig.frames = True
    bench.someone_else_steps(range(11, COLUMNS))
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert int(geometry.seen.sum()) == COLUMNS - 1
    said = capfd.readouterr().err
    assert 'no frame reached the columns from 66.0° to 66.0° of arm azimuth' in said


def test_further_pairs_are_published_of_the_same_sweep(ros):
    bench = Bench(ros, further_offsets_px=[13.0, 4.0]).ready()
    bench.start()
    got = bench.sweeps()
    assert len(got) == 14
    assert len({topic.rpartition('/')[0] for topic in got}) == 7
    assert all(message.header == got['left/image'].header for message in got.values())
    for name, u in (('pair_1/left', 33), ('pair_1/right', 7), ('pair_2/left', 24)):
        assert (to_array(got[f'{name}/image'])[:, :, 1] == u).all()
        geometry = panorama_geometry(got[f'{name}/camera_info'])
        assert geometry.principal_angle == pytest.approx(-math.atan((u - 20) / 40))


def test_led_sweep_of_stripes(ros):
    bench = Bench(ros, stripe_columns=5, stripe_distance=1.5, column_offset_px=6.0).ready()
    assert 'sweep of 60 columns in 12 frames started' in bench.call('start').message
    got = bench.sweeps()
    assert bench.rig.steps == 12
    for name in ('left', 'right', 'center'):
        pixels = to_array(got[f'{name}/image'])
        geometry = panorama_geometry(got[f'{name}/camera_info'])
        assert sorted(pixels[0, :, 0].tolist()) == [k for k in range(1, 13) for _ in range(5)]
        assert geometry.seen.all()
        assert geometry.stripe_distance == 1.5
        u = 20 - 40 * np.tan(geometry.ray_angle)
        assert pixels[0, :, 1] == pytest.approx(u, abs=0.51)
        arm = geometry.ray_azimuth(np.arange(COLUMNS)) - geometry.ray_angle
        off = arm - math.radians(5 * STEP_DEG) * pixels[0, :, 0]
        assert np.cos(off) == pytest.approx(1.0)
    bench.ros.spin_until(lambda: bench.progress and bench.progress[-1] == 1.0, 'progress')


def test_stripe_that_no_frame_reached_is_unknown(ros, capfd):
    bench = Bench(ros, lead=False, stripe_columns=5, column_offset_px=6.0).ready()
    bench.someone_else_steps(range(4))
    bench.rig.frames = False
    bench.someone_else_steps([4])
    bench.rig.frames = True
    bench.someone_else_steps(range(5, 12))
    geometry = panorama_geometry(bench.sweeps()['left/camera_info'])
    assert int(geometry.seen.sum()) == COLUMNS - 5
    said = capfd.readouterr().err
    assert 'no frame reached the columns from 162.0° to 138.0° of arm azimuth' in said


@pytest.mark.parametrize('columns', [1, 4, 6])
def test_arm_that_steps_another_stripe_ends_the_sweep(ros, capfd, columns):
    bench = Bench(ros, stripe_columns=5, column_offset_px=6.0).ready()
    bench.rig.travel = columns / 5
    bench.start()
    bench.given_up()
    assert "the arm's step_deg must be the mosaicer's 5 columns of 6°" in capfd.readouterr().err


def test_refused_step_ends_the_sweep_without_a_result(bench):
    bench.rig.refuse_at = 7
    bench.start()
    bench.given_up()


def test_arm_that_takes_another_step_ends_the_sweep(bench):
    bench.rig.travel = 2.0
    bench.start()
    bench.given_up()
    assert bench.rig.steps == 1


def test_arm_that_never_answers_ends_the_sweep(ros):
    bench = Bench(ros, step_timeout=0.5).ready()
    bench.rig.move = lambda: None
    bench.rig.frames = False
    bench.start()
    bench.given_up()


def test_camera_that_stops_makes_the_sweep_wait_and_go_on(ros, capfd):
    bench = Bench(ros, frame_timeout=0.1).ready()
    bench.rig.frames = False
    bench.start()
    ros.spin_until(lambda: bench.rig.steps == 1, 'the first step')
    waiting = bench.mosaicer._leader._waiting_since
    ros.spin_until(lambda: _time_since(waiting) > 0.5, 'the wait')
    assert bench.rig.steps == 1, 'the arm went on without a frame'
    said = capfd.readouterr().err
    assert 'the sweep waits at frame 1 of 60; most frequent: 1 × frame: arm moved' in said
    bench.rig.frames = True
    bench.rig.frame()
    bench.rig.standing()
    assert len(set(to_array(bench.sweeps()['left/image'])[0, :, 0].tolist())) == COLUMNS


def _time_since(moment):
    import time  # noqa: PLC0415

    return time.monotonic() - moment


def test_frame_of_another_size_in_the_middle_is_dropped(bench):
    move = bench.rig.move

    def move_and_show_another_size():
        move()
        if bench.rig.steps == 20:
            bench.rig.frame(height=HEIGHT + 1, mark=200)

    bench.rig.move = move_and_show_another_size
    bench.start()
    row = to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
    assert 200 not in row
    assert 20 in row


def test_frame_of_unknown_encoding_is_dropped(bench):
    move = bench.rig.move

    def move_and_show_an_unknown_encoding():
        move()
        if bench.rig.steps == 20:
            message = Image(height=HEIGHT, width=41, encoding='plasma8', step=41)
            message.data = bytes(41 * HEIGHT)
            message.header.stamp = bench.rig.later(5)
            bench.rig._images.publish(message)

    bench.rig.move = move_and_show_an_unknown_encoding
    bench.start()
    assert 20 in to_array(bench.sweeps()['left/image'])[0, :, 0].tolist()
