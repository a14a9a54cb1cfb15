"""The camera node and a V4L2 device: what the camera may decide, and what holds it."""

import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.ros import started
from fixtures.v4l2_device import REFUSES
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger

from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import to_nanoseconds

pytestmark = [pytest.mark.ros, pytest.mark.launch]


def to_seconds(stamp):
    return to_nanoseconds(stamp) / 1e9


def arguments(device, **changes):
    parameters = {
        'video_device': device.path,
        'image_width': 64,
        'image_height': 48,
        'framerate': 50.0,
        'auto_settle_time': 0.5,
    } | changes
    pairs = [('-p', f'{name}:={setting}') for name, setting in parameters.items()]
    return ['--ros-args', *(argument for pair in pairs for argument in pair)]


def luminance(image):
    """Undo what OpenCV makes of the limited range, 16 to 235, of a device's luminance."""
    return float(to_array(image)[:, :, 1].mean()) * 219 / 255 + 16


class Pictures:
    """What a camera shows."""

    def __init__(self, ros):
        self.ros, self.seen = ros, []
        ros.node('viewer').create_subscription(Image, 'image_raw', self.seen.append, qos.IMAGES)

    def shade(self):
        """Luminance of the next picture, as the device had it."""
        count = len(self.seen)
        self.ros.spin_until(lambda: len(self.seen) > count, 'a frame')
        return luminance(self.seen[-1])


def settle(ros):
    client = ros.node('photographer').create_client(Trigger, 'camera/settle')
    ros.spin_until(client.service_is_ready, 'the service')
    return ros.result(client.call_async(Trigger.Request()))


def test_the_camera_settles_once_and_holds_what_it_chose(ros, device):
    pictures, diagnosis = Pictures(ros), Diagnosis(ros, 'camera: exposure')
    with started('camera', *arguments(device, autofocus='true')):
        assert pictures.shade() == pytest.approx(128.0, abs=4.0)
        chosen = device['exposure']
        assert chosen == pytest.approx(320, abs=2)
        assert [device[name] for name in ('auto_exposure', 'auto_white_balance', 'autofocus')] == [
            1,
            0,
            0,
        ]
        values = diagnosis.says(DiagnosticStatus.OK, 'holds exposure, gain, white_balance, focus')
        assert (values['exposure'], values['white_balance']) == (str(chosen), '4000')
        device['light'] = 200  # half of it: who adapts shows the same shade again
        frames = device['frames']
        ros.spin_until(lambda: device['frames'] > frames + 20, 'frames of the dark room')
        assert pictures.shade() == pytest.approx(64.0, abs=4.0)
        assert device['exposure'] == chosen

        answer = settle(ros)
        assert answer.success
        assert answer.message == 'the camera holds exposure, gain, white_balance, focus'
        assert device['exposure'] == pytest.approx(640, abs=2)
        assert device['auto_exposure'] == 1
        assert pictures.shade() == pytest.approx(128.0, abs=4.0)
    shades = {round(luminance(image)) for image in pictures.seen}
    assert all(min(abs(shade - held) for held in (64, 128)) <= 4 for shade in shades), shades


def test_a_camera_that_cannot_be_held_says_so_and_delivers(ros, device):
    pictures, diagnosis = Pictures(ros), Diagnosis(ros, 'camera: exposure')
    device.behave('auto_exposure', REFUSES)
    sentence = (
        f'exposure cannot be held: Auto Exposure of video device {device.path} cannot be set to 1'
    )
    with started('camera', *arguments(device)) as running:
        pictures.shade()
        diagnosis.says(DiagnosticStatus.WARN, sentence)
        running.wait_for_output(sentence)
        answer = settle(ros)
        assert not answer.success
        assert sentence in answer.message


def exposures(device, node):
    """When the last frames were exposed, by the node's clock [s]."""
    offset = node.get_clock().now().nanoseconds / 1e9 - time.monotonic()
    return np.array(device.stamps()) + offset


def test_stamps_are_when_the_driver_had_the_frame_not_when_it_was_read(ros, device):
    device['latency_us'] = 150_000
    pictures, node = Pictures(ros), ros.node('clock')
    with started('camera', *arguments(device, auto_settle_time=0.1)):
        for _ in range(10):
            pictures.shade()
        seen = [to_seconds(image.header.stamp) for image in pictures.seen[-10:]]
        known = exposures(device, node)
    assert all(np.abs(known - stamp).min() < 2e-3 for stamp in seen)


def test_an_unplugged_camera_that_comes_back_gets_the_same_values(ros, device):
    pictures = Pictures(ros)
    diagnosis = Diagnosis(ros, 'camera: frames')
    with started('camera', *arguments(device)) as running:
        shade, chosen = pictures.shade(), device['exposure']
        device.unplug()
        running.wait_for_output('trying to open it again')
        diagnosis.says(DiagnosticStatus.ERROR, str(device.path))
        device['light'] = 200  # who would let it settle again would see the same shade as before
        count = len(pictures.seen)
        device.plug_in()
        ros.spin_until(lambda: len(pictures.seen) > count + 5, 'frames of the camera again')
        running.wait_for_output('delivers again')
        assert device['exposure'] == chosen
        assert device['auto_exposure'] == 1
        assert all(
            luminance(image) == pytest.approx(shade / 2, abs=3.0)
            for image in pictures.seen[count:]
        )
