"""The camera node: what it publishes, what it refuses, faults of its source, its end."""

import math
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fixtures.mjpeg import HEIGHT, WIDTH, network_camera
from fixtures.ros import program, started
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

from panodepth_ros.arm.truth import Piece, TruthWriter
from panodepth_ros.camera.calibration import (
    Calibration,
    CalibrationError,
    read_calibration,
    write_calibration,
)
from panodepth_ros.camera.simulated import RealCamera, RoomCamera, furnished_room
from panodepth_ros.camera.simulated import source as simulated_module
from panodepth_ros.camera.source import SourceError, SourceLostError
from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.nodes import camera as camera_module
from panodepth_ros.nodes.camera import CameraNode
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import to_nanoseconds
from panodepth_ros.ros.parameters import ParameterError

pytestmark = pytest.mark.ros


class Viewer:
    """Everything a camera publishes."""

    def __init__(self, ros):
        self.ros = ros
        self.images, self.infos, self.diagnostics = [], [], []
        self.node = ros.node('viewer')
        self.node.create_subscription(Image, 'image_raw', self.images.append, qos.IMAGES)
        self.node.create_subscription(CameraInfo, 'camera_info', self.infos.append, qos.IMAGES)
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def _on_diagnostics(self, message):
        self.diagnostics += [s for s in message.status if s.name == 'camera: frames']

    def wait_for(self, count):
        """The first images and camera_infos."""
        self.ros.spin_until(lambda: min(len(self.images), len(self.infos)) >= count, 'frames')
        return self.images[:count], self.infos[:count]

    def status(self, level):
        """The next diagnostic status of a level."""
        begin = len(self.diagnostics)
        self.ros.spin_until(
            lambda: any(s.level == level for s in self.diagnostics[begin:]), f'status {level}'
        )
        return next(s for s in self.diagnostics[begin:] if s.level == level)


def make_camera(ros, **parameters):
    return CameraNode(
        context=ros.context,
        parameter_overrides=[Parameter(name, value=value) for name, value in parameters.items()],
    )


def refused(ros, error, **parameters):
    """The sentence with which a camera refuses to start."""
    with pytest.raises(error) as info:
        make_camera(ros, **parameters)
    return str(info.value)


def value(status, key):
    (found,) = [pair.value for pair in status.values if pair.key == key]
    return found


@pytest.fixture
def images(tmp_path):
    """Thirty pictures, brighter by 8 each."""
    folder = tmp_path / 'frames'
    folder.mkdir()
    for k in range(30):
        cv2.imwrite(str(folder / f'{k}.png'), np.full((6, 8, 3), (8 * k, 100, 200), np.uint8))
    return folder


@pytest.fixture
def calibration(tmp_path):
    """URL of a calibration of images of 8 by 6 pixels."""
    path = tmp_path / 'camera.yaml'
    write_calibration(
        Calibration.of_pinhole(
            PinholeCamera(width=8, height=6, fx=9.0, fy=9.5, cx=3.4, cy=2.6), 'mine'
        ),
        path,
    )
    return f'file://{path}'


@pytest.fixture
def truth(tmp_path):
    arm = TruthWriter(tmp_path / 'arm.truth', 0.5)
    yield arm
    arm.close()


def of_images(images, **changes):
    return {
        'source': 'images',
        'video_device': str(images),
        'image_width': 0,
        'image_height': 0,
        'framerate': 20.0,
    } | changes


def simulated(tmp_path, **changes):
    return {
        'source': 'simulated',
        'simulated_arm_truth': str(tmp_path / 'arm.truth'),
        'image_width': 40,
        'image_height': 30,
        'framerate': 50.0,
        'noise_stddev': 0.0,
    } | changes


# --- what is published ------------------------------------------------------------------------


def test_every_image_comes_with_its_calibration(ros, images, calibration):
    viewer = Viewer(ros)
    node = ros.add(
        make_camera(
            ros,
            **of_images(
                images,
                image_width=8,
                image_height=6,
                camera_name='mine',
                camera_info_url=calibration,
                frame_id='my_frame',
            ),
        )
    )
    begin = node.get_clock().now().nanoseconds
    pictures, infos = viewer.wait_for(8)
    shades = [int(to_array(image)[0, 0, 0]) for image in pictures]
    assert shades == list(range(shades[0], shades[0] + 64, 8))
    for image, info in zip(pictures, infos, strict=True):
        assert image.header == info.header
        assert image.header.frame_id == 'my_frame'
        assert (image.encoding, image.width, image.height) == ('bgr8', 8, 6)
        assert to_array(image)[0, 0, 1:].tolist() == [100, 200]
        assert (info.width, info.height) == (8, 6)
        assert info.k.tolist() == [9.0, 0.0, 3.4, 0.0, 9.5, 2.6, 0.0, 0.0, 1.0]
        assert info.d.tolist() == [0.0] * 5
        assert info.distortion_model == 'plumb_bob'
        assert info.r.tolist() == np.eye(3).ravel().tolist()
        assert info.p.tolist()[:4] == [9.0, 0.0, 3.4, 0.0]
    stamps = [to_nanoseconds(image.header.stamp) for image in pictures]
    assert (np.diff(stamps) > 0.04e9).all()
    assert abs(stamps[0] - begin) < 5e9
    assert stamps[-1] <= node.get_clock().now().nanoseconds


def test_publishers_are_reliable_and_volatile(ros, images):
    ros.add(make_camera(ros, **of_images(images, framerate=1.0)))
    viewer = ros.node('viewer')
    for topic in ('image_raw', 'camera_info'):
        ros.spin_until(lambda topic=topic: viewer.count_publishers(topic), topic)
        (info,) = viewer.get_publishers_info_by_topic(topic)
        assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE
        assert info.qos_profile.durability == DurabilityPolicy.VOLATILE


def test_without_calibration_k_is_zero(ros, images):
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **of_images(images, pixel_format='mono8')))
    pictures, infos = viewer.wait_for(2)
    assert pictures[0].encoding == 'mono8'
    assert (infos[0].width, infos[0].height) == (8, 6)
    assert not infos[0].k.any()
    assert not infos[0].p.any()
    assert pictures[0].header == infos[0].header


def test_the_simulated_camera_sees_the_arm_and_knows_its_lens(ros, tmp_path, truth):
    viewer = Viewer(ros)
    node = ros.add(make_camera(ros, **simulated(tmp_path, room_seed=3)))
    lens = RoomCamera.from_field_of_view(40, 30, math.radians(34.0))
    room = furnished_room(3)
    pictures, infos = viewer.wait_for(3)
    np.testing.assert_array_equal(to_array(pictures[0]), room.render(0.5, lens, 0.3))
    assert infos[0].k.tolist() == [lens.fx, 0.0, 19.5, 0.0, lens.fx, 14.5, 0.0, 0.0, 1.0]
    assert infos[0].distortion_model == 'plumb_bob'
    assert infos[0].d.tolist() == [0.0] * 5

    # From now on the arm turns, as fast as a sweep: each stamp is where the arm was then.
    begin, now = time.monotonic(), node.get_clock().now().nanoseconds
    truth.write([Piece(-math.inf, 0.5), Piece(begin, 0.5, 1.0)])

    def moving():
        return [image for image in viewer.images if to_nanoseconds(image.header.stamp) > now]

    ros.spin_until(lambda: len(moving()) >= 5, 'frames of the moving arm')
    for image in moving():
        azimuth = 0.5 + (to_nanoseconds(image.header.stamp) - now) / 1e9
        # ROS time is not monotonic time: it may be slewed by a little.
        wanted = room.render(azimuth, lens, 0.3).astype(int)
        assert np.abs(to_array(image) - wanted).mean() < 1.0
        off = room.render(azimuth + 0.03, lens, 0.3).astype(int)
        assert np.abs(to_array(image) - off).mean() > 3.0


def test_the_simulated_camera_has_the_lens_and_the_mount_it_is_given(ros, tmp_path, truth):
    viewer = Viewer(ros)
    given = {'simulated_yaw_deg': 3.0, 'simulated_k1': -0.1, 'simulated_cx_offset': 2.0}
    ros.add(make_camera(ros, **simulated(tmp_path, room_seed=3, **given)))
    pictures, infos = viewer.wait_for(1)
    ideal = RoomCamera.from_field_of_view(40, 30, math.radians(34.0))
    lens = PinholeCamera(
        width=40,
        height=30,
        fx=ideal.fx,
        fy=ideal.fy,
        cx=21.5,
        cy=14.5,
        distortion=(-0.1, 0.0, 0.0, 0.0, 0.0),
        mounting=Mounting(yaw=math.radians(3.0)),
    )
    wanted = RealCamera(lens).render(furnished_room(3), 0.5, 0.3)
    np.testing.assert_array_equal(to_array(pictures[0]), wanted)
    assert infos[0].k.tolist() == [lens.fx, 0.0, 21.5, 0.0, lens.fx, 14.5, 0.0, 0.0, 1.0]
    assert infos[0].d.tolist() == [-0.1, 0.0, 0.0, 0.0, 0.0]


def test_diagnostics_tell_the_measured_rate(ros, tmp_path, truth):
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **simulated(tmp_path, framerate=20.0)))
    viewer.wait_for(25)
    status = viewer.status(DiagnosticStatus.OK)
    assert 18.0 <= float(value(status, 'rate_hz')) <= 22.0
    assert value(status, 'size') == '40x30'
    assert int(value(status, 'frames')) >= 20
    assert status.hardware_id == 'simulated room'


def test_a_camera_that_is_too_slow_says_so(ros, tmp_path, truth):
    viewer = Viewer(ros)
    ros.add(
        make_camera(
            ros, **simulated(tmp_path, framerate=1000.0, image_width=320, image_height=240)
        )
    )
    status = viewer.status(DiagnosticStatus.WARN)
    assert 'Hz instead of 1000 Hz' in status.message
    assert int(value(status, 'skipped')) > 100


# --- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ('parameters', 'error', 'sentence'),
    [
        ({'source': 'webcam'}, ParameterError, "source is 'webcam'; allowed: v4l2, video"),
        ({'framerate': -1.0}, ParameterError, 'framerate is -1.0; allowed: 0 to 1000 Hz'),
        ({'width': 640}, ParameterError, 'unknown parameter width for camera'),
        ({'pixel_format': 'h264'}, ParameterError, "pixel_format is 'h264'; allowed: auto"),
        (
            {'source': 'simulated', 'image_width': 0},
            ParameterError,
            'image_width is 0; the simulated room needs one above 0',
        ),
        (
            {'exposure': 100},
            ParameterError,
            'exposure is 100 while autoexposure is true; allowed: autoexposure false or exp',
        ),
        (
            {'source': 'video', 'gain': 5},
            ParameterError,
            'gain is 5; allowed with source video: -1',
        ),
        ({'source': 'images', 'framerate': 0.0}, ParameterError, 'framerate is 0.0; images need'),
        (
            {'video_device': '/dev/video97'},
            SourceLostError,
            'video device /dev/video97 does not exist; there',
        ),
        ({'video_device': '/dev/null'}, SourceError, '/dev/null is not a V4L2 video device'),
        (
            {'source': 'video', 'video_device': '/none.avi'},
            SourceError,
            '/none.avi does not exist',
        ),
        ({'source': 'stream'}, SourceError, "'/dev/video0' is not a URL"),
        (
            {'camera_info_url': 'camera.yaml'},
            CalibrationError,
            "camera_info_url is 'camera.yaml'; allowed: file:///",
        ),
        (
            {'camera_info_url': 'file:///none.yaml'},
            CalibrationError,
            'calibration file /none.yaml cannot be read: No such file',
        ),
    ],
)
def test_a_bad_parameter_is_refused(ros, parameters, error, sentence):
    assert sentence in refused(ros, error, **parameters)


def test_a_calibration_of_another_size_is_refused(ros, images, calibration):
    cv2.imwrite(str(images / '0.png'), np.zeros((12, 16, 3), np.uint8))
    sentence = refused(ros, CalibrationError, **of_images(images, camera_info_url=calibration))
    assert f'{calibration} is a calibration of 8 by 6 pixels; {images} gives 16 by 12' in sentence


def test_images_of_another_size_are_refused(ros, images):
    sentence = refused(ros, SourceError, source='images', video_device=str(images))
    assert 'gives frames of 8 by 6 pixels; image_width and image_height ask for 640' in sentence


# --- set_camera_info --------------------------------------------------------------------------


def proposal(**changes):
    info = CameraInfo(width=40, height=30, distortion_model='plumb_bob')
    info.k = [50.0, 0.0, 19.0, 0.0, 51.0, 14.0, 0.0, 0.0, 1.0]
    info.d = [-0.1, 0.01, 0.0, 0.0, 0.0]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    info.p = [50.0, 0.0, 19.0, 0.0, 0.0, 51.0, 14.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    for name, value in changes.items():
        setattr(info, name, value)
    return info


def set_camera_info(ros, info):
    client = ros.node('calibrator').create_client(SetCameraInfo, 'camera/set_camera_info')
    ros.spin_until(client.service_is_ready, 'the service')
    return ros.result(client.call_async(SetCameraInfo.Request(camera_info=info)))


def test_a_new_calibration_is_used_and_stored(ros, tmp_path, truth):
    path = tmp_path / 'lens.yaml'
    first = Calibration.of_pinhole(
        PinholeCamera(width=40, height=30, fx=60.0, fy=60.0, cx=19.5, cy=14.5), 'mine'
    )
    write_calibration(first, path)
    viewer = Viewer(ros)
    url = f'file://{path}'
    ros.add(make_camera(ros, **simulated(tmp_path, camera_info_url=url, camera_name='mine')))
    viewer.wait_for(1)
    assert viewer.infos[0].k[0] == 60.0
    answer = set_camera_info(ros, proposal())
    assert answer.success
    assert answer.status_message == f'calibration in use, stored at {url}'
    ros.spin_until(lambda: viewer.infos[-1].k[0] == 50.0, 'the new calibration')
    assert viewer.infos[-1].d.tolist() == [-0.1, 0.01, 0.0, 0.0, 0.0]
    stored = read_calibration(path)
    assert (stored.camera_name, stored.camera_matrix[4]) == ('mine', 51.0)
    assert [file.name for file in tmp_path.iterdir() if file.name.startswith('tmp')] == []


def test_a_new_calibration_without_a_file_says_that_it_will_be_lost(ros, tmp_path, truth):
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **simulated(tmp_path)))
    answer = set_camera_info(ros, proposal())
    assert answer.success
    assert 'not stored, for camera_info_url is empty' in answer.status_message
    ros.spin_until(lambda: viewer.infos and viewer.infos[-1].k[0] == 50.0, 'the calibration')


@pytest.mark.parametrize(
    ('changes', 'sentence'),
    [
        ({'width': 80}, 'is of 80 by 30 pixels; allowed: 40 by 30'),
        ({'distortion_model': 'fisheye'}, "distortion_model is 'fisheye'; allowed: plumb_bob"),
        ({'d': [0.0, math.nan, 0.0, 0.0, 0.0]}, 'allowed: finite numbers'),
        ({'k': [0.0] * 9}, 'allowed: focal lengths above 0'),
        ({'d': [-20.0, 0.0, 0.0, 0.0, 0.0]}, 'folds inside of the image'),
    ],
)
def test_a_bad_calibration_is_refused_and_the_old_one_stays(
    ros, tmp_path, truth, changes, sentence
):
    path = tmp_path / 'lens.yaml'
    camera = make_camera(ros, **simulated(tmp_path))
    viewer = Viewer(ros)
    ros.add(camera)
    answer = set_camera_info(ros, proposal(**changes))
    assert not answer.success
    assert sentence in answer.status_message
    viewer.wait_for(2)
    assert viewer.infos[-1].k[0] == viewer.infos[0].k[0] > 60.0
    assert not path.exists()


def test_a_calibration_that_cannot_be_stored_is_not_used(ros, tmp_path, truth):
    folder = tmp_path / 'calibrations'
    folder.mkdir()
    path = folder / 'lens.yaml'
    write_calibration(
        Calibration.of_pinhole(
            PinholeCamera(width=40, height=30, fx=60.0, fy=60.0, cx=19.5, cy=14.5), ''
        ),
        path,
    )
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **simulated(tmp_path, camera_info_url=f'file://{path}')))
    path.unlink()
    folder.rmdir()
    answer = set_camera_info(ros, proposal())
    assert not answer.success
    assert 'No such file or directory' in answer.status_message
    viewer.wait_for(2)
    assert viewer.infos[-1].k[0] == 60.0


# --- faults while running ---------------------------------------------------------------------


def test_a_stream_that_falls_silent_is_reported_once_and_opened_again(ros, monkeypatch, capfd):
    monkeypatch.setattr(camera_module, '_FIRST_BACKOFF', 0.05)
    with network_camera() as network:
        viewer = Viewer(ros)
        ros.add(
            make_camera(
                ros,
                source='stream',
                video_device=network.url,
                image_width=WIDTH,
                image_height=HEIGHT,
                frame_timeout=1.5,
            )
        )
        viewer.wait_for(5)
        network.silent.set()
        status = viewer.status(DiagnosticStatus.ERROR)
        assert 'gave no frame for 1.5 s; trying to open it again' in status.message
        assert value(status, 'last_error') == status.message
        tries = network.connections
        ros.spin_until(lambda: network.connections >= tries + 2, 'attempts to open it again')
        network.silent.clear()
        count = len(viewer.images)
        ros.spin_until(lambda: len(viewer.images) >= count + 5, 'frames again')
        assert value(viewer.status(DiagnosticStatus.OK), 'last_error') == ''
        assert capfd.readouterr().err.count('trying to open it again') == 1


def test_an_arm_whose_truth_is_damaged_is_reported(ros, tmp_path, truth):
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **simulated(tmp_path)))
    viewer.wait_for(2)
    path = tmp_path / 'arm.truth'
    data = bytearray(path.read_bytes())
    with path.open('r+b') as file:
        file.seek(30)
        file.write(bytes(byte ^ 0xFF for byte in data[30:40]))
    status = viewer.status(DiagnosticStatus.ERROR)
    assert 'is damaged' in status.message
    with path.open('r+b') as file:
        file.write(data)
    count = len(viewer.images)
    ros.spin_until(lambda: len(viewer.images) >= count + 3, 'frames again')


def test_a_source_that_comes_back_with_another_size_ends_the_node(ros, monkeypatch):
    monkeypatch.setattr(camera_module, '_FIRST_BACKOFF', 0.05)
    with network_camera() as network:
        viewer = Viewer(ros)
        parameters = {'image_width': 0, 'image_height': 0, 'frame_timeout': 1.0}
        ros.add(make_camera(ros, source='stream', video_device=network.url, **parameters))
        viewer.wait_for(2)
        network.silent.set()
        viewer.status(DiagnosticStatus.ERROR)
        network.size = (WIDTH // 2, HEIGHT)
        network.silent.clear()
        with pytest.raises(SourceError, match='came back with 32 by 48 pixels; it had 64 by 48'):
            ros.spin_until(lambda: False, 'the failure')


def test_a_broken_file_in_the_middle_ends_the_node_with_its_sentence(ros, images):
    (images / '3.png').write_bytes(b'none')
    ros.add(make_camera(ros, **of_images(images, image_width=8, image_height=6, framerate=50.0)))
    with pytest.raises(SourceError, match=r'3\.png cannot be decoded'):
        ros.spin_until(lambda: False, 'the failure')


def test_the_device_is_let_go_when_the_node_is_destroyed(ros, tmp_path, truth):
    def held():
        """Whether this process has the truth file mapped for reading."""
        maps = Path('/proc/self/maps').read_text().splitlines()
        return any('r--s' in line and str(tmp_path) in line for line in maps)

    def working():
        return any(thread.name == 'camera' for thread in threading.enumerate())

    node = ros.add(make_camera(ros, **simulated(tmp_path)))
    assert not working()  # a signal that comes before it is spun must not leave a thread behind
    ros.spin_until(held, 'the open truth file')
    assert working()
    node.destroy_node()
    node.destroy_node()
    assert not held()
    assert not working()


# --- as a process -----------------------------------------------------------------------------


def command_line(**parameters):
    """ROS arguments that set parameters."""
    pairs = [('-p', f'{name}:={setting}') for name, setting in parameters.items()]
    return ['--ros-args', *(argument for pair in pairs for argument in pair)]


def fatal(*arguments):
    """Run the camera to its end; what it said."""
    ended = subprocess.run(
        [*program('camera'), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=60,
        text=True,
        check=False,
    )
    assert ended.returncode == 1, ended.stdout
    return ended.stdout


@pytest.mark.launch
@pytest.mark.parametrize('stop_signal', [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_with_code_0(ros, images, stop_signal):
    viewer = Viewer(ros)
    arguments = command_line(**of_images(images, image_width=8, image_height=6, framerate=1.0))
    with started('camera', *arguments, stop_signal=stop_signal):
        viewer.wait_for(1)


@pytest.mark.launch
@pytest.mark.parametrize('stop_signal', [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_while_its_stream_is_silent(ros, stop_signal):
    viewer = Viewer(ros)
    with network_camera() as network:
        arguments = command_line(
            source='stream', video_device=network.url, image_width=0, image_height=0
        )
        with started('camera', *arguments, stop_signal=stop_signal) as running:
            viewer.wait_for(1)
            network.silent.set()
            running.wait_for_output('trying to open it again')


@pytest.mark.launch
@pytest.mark.parametrize('stop_signal', [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_while_it_waits_for_the_arm(ros_domain, tmp_path, stop_signal):
    arguments = command_line(**simulated(tmp_path))
    with started('camera', *arguments, stop_signal=stop_signal) as running:
        running.wait_for_output('simulated room delivers')


def test_an_arm_that_comes_late_is_found(ros, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(simulated_module, '_ARM_START_TIMEOUT', 0.2)
    monkeypatch.setattr(camera_module, '_FIRST_BACKOFF', 0.05)
    viewer = Viewer(ros)
    ros.add(make_camera(ros, **simulated(tmp_path)))
    for _ in range(2):  # a second each: many attempts
        status = viewer.status(DiagnosticStatus.ERROR)
        assert 'is simulated_arm running?' in status.message
    arm = TruthWriter(tmp_path / 'arm.truth', 0.5)
    viewer.wait_for(2)
    arm.close()
    said = capfd.readouterr().err
    assert said.count('is simulated_arm running?') == 1
    assert said.count('delivers again') == 1


@pytest.mark.launch
def test_the_last_frames_of_a_video_arrive_and_it_ends_with_code_0(ros, tmp_path):
    path = tmp_path / 'sweep.avi'
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 25.0, (64, 48))
    expected = list(range(0, 240, 6))
    for shade in expected:
        writer.write(np.full((48, 64, 3), shade, np.uint8))
    writer.release()
    viewer = Viewer(ros)
    arguments = command_line(
        source='video', video_device=str(path), image_width=64, image_height=48, framerate=4.0
    )
    with started('camera', *arguments) as running:
        viewer.wait_for(1)  # discovery may cost the first frames, never the last
        ros.spin_until(lambda: not running.running(), 'the end of the video', timeout=60.0)
        assert f'{path} ended after 40 frames' in running.output
    ros.spin_until(
        lambda: viewer.images and viewer.images[-1].header == viewer.infos[-1].header,
        'the last camera_info',
    )
    shades = [int(to_array(image).mean()) for image in viewer.images]
    assert shades == pytest.approx(expected[-len(shades) :], abs=3)


@pytest.mark.launch
@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({}, 'video device /dev/video0 does not exist'),
        ({'video_device': '/dev/null'}, '/dev/null is not a V4L2 video device'),
        ({'source': 'video', 'video_device': '/none.avi'}, '/none.avi does not exist'),
    ],
)
def test_a_missing_device_is_one_sentence_and_code_1(ros_domain, parameters, sentence):
    if not parameters and os.path.exists('/dev/video0'):
        pytest.skip('this machine has a camera')
    output = fatal(*command_line(**parameters))
    (line,) = [line for line in output.splitlines() if '[FATAL]' in line]
    assert sentence in line
    assert 'Traceback' not in output
