"""The views node: a wall of known distance in, views that stock nodes can read out."""

import importlib.util
import math
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from panodepth_ros.geometry import PanoramaGeometry, locate
from panodepth_ros.geometry.pinhole_views import ring_of_faces
from panodepth_ros.nodes.views import Views, ViewsParameters
from panodepth_ros.ros.images import to_array, to_message
from panodepth_ros.ros.messages import panorama_info, pinhole_camera, to_stamp
from panodepth_ros.ros.parameters import ParameterError
from panodepth_ros.ros.pinhole_views import face_transform

pytestmark = pytest.mark.ros

COLUMNS, ROWS = 360, 24
STEP = 2 * math.pi / COLUMNS
R, PHI, WALL = 0.3, math.radians(15.2), 2.5


def geometry():
    return PanoramaGeometry(
        columns=COLUMNS,
        rows=ROWS,
        azimuth_column=COLUMNS / 2 - PHI / STEP,
        focal_length_px=57.0,
        principal_row=11.5,
        arm_radius=R,
        principal_angle=-PHI,
        sweep_duration=1.0,
        ray_angle=np.full(COLUMNS, -PHI),
    )


class Bench:
    """A views node, a publisher of depth panoramas, and a listener to some views."""

    def __init__(self, ros, listen=(0, 1, 2, 3), **values):
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.ros = ros
        self.views = ros.add(Views(context=ros.context, parameter_overrides=overrides))
        self.node = ros.node('depth_panoramas')
        self.got = {
            f'view_{k}/{name}': [] for k in listen for name in ('image', 'depth', 'camera_info')
        }
        for topic, messages in self.got.items():
            kind = CameraInfo if topic.endswith('camera_info') else Image
            self.node.create_subscription(kind, topic, messages.append, 10)
        kinds = {'left/image': Image, 'depth/image': Image, 'depth/camera_info': CameraInfo}
        self.out = {
            topic: self.node.create_publisher(kind, topic, 10) for topic, kind in kinds.items()
        }
        ros.spin_until(
            lambda: (
                all(publisher.get_subscription_count() for publisher in self.out.values())
                and all(self.views.count_subscribers(topic) for topic in self.got)
            ),
            'the graph',
        )

    def send(self, stamp=1, **change):
        header = Header(stamp=to_stamp(stamp * 10**9), frame_id='panodepth')
        left = np.full((ROWS, COLUMNS, 3), (10, 20, 30), np.uint8)
        depth = np.full((ROWS, COLUMNS), WALL, np.float32)
        depth[5, 100] = np.nan
        named = {'stamp': header.stamp, 'frame_id': header.frame_id}
        messages = {
            'left/image': to_message(left, 'bgr8', **named),
            'depth/image': to_message(depth, '32FC1', **named),
            'depth/camera_info': panorama_info(geometry(), header),
        }
        for topic, message in (messages | change).items():
            message.header = header
            self.out[topic].publish(message)

    def results(self, count=1):
        self.ros.spin_until(
            lambda: all(len(messages) >= count for messages in self.got.values()), 'the views'
        )
        return {topic: messages[count - 1] for topic, messages in self.got.items()}


def test_wall_around_the_axis_is_a_wall_in_every_view(ros):
    bench = Bench(ros)
    bench.send()
    got = bench.results()
    for k in range(4):
        info, depth = got[f'view_{k}/camera_info'], to_array(got[f'view_{k}/depth'])
        image = to_array(got[f'view_{k}/image'])
        for name in ('image', 'depth', 'camera_info'):
            header = got[f'view_{k}/{name}'].header
            assert header.frame_id == f'panodepth_view_{k}_optical_frame'
            assert header.stamp == to_stamp(10**9)
        camera = pinhole_camera(info)
        assert info.distortion_model == 'plumb_bob'
        assert not camera.distorted
        assert depth.shape == image.shape[:2] == (camera.height, camera.width)
        # What depth_image_proc uses: P alone.
        assert list(info.p) == [
            *(camera.fx, 0.0, camera.cx, 0.0),
            *(0.0, camera.fy, camera.cy, 0.0),
            *(0.0, 0.0, 1.0, 0.0),
        ]
        x = (np.arange(camera.width) - info.p[2]) / info.p[0]
        row = depth[round(info.p[6])]
        assert np.hypot(x * row, row) == pytest.approx(np.full(camera.width, WALL), rel=1e-6)
        assert (image[np.isfinite(depth)] == (10, 20, 30)).all()
        assert got[f'view_{k}/depth'].encoding == '32FC1'
        assert got[f'view_{k}/image'].encoding == 'bgr8'


def test_stripes_show_things_where_each_column_saw_them(ros):
    # Of a striped panorama a column looks along a ray of its own. A wall striped like a zebra then
    # is what it is in the views, too, though far from where the stripes of frames join.
    stripe = 9
    turned = (np.arange(COLUMNS) % stripe - (stripe - 1) / 2) * STEP
    striped = replace(geometry(), ray_angle=turned - PHI)
    wall = np.full((ROWS, COLUMNS), 0.8)

    def shade(azimuth):
        return 128 + 100 * np.sin(10 * azimuth)

    bench = Bench(ros)
    bench.send(
        **{
            'left/image': to_message(
                np.rint(shade(locate(wall, striped).azimuth)).astype(np.uint8), 'mono8'
            ),
            'depth/image': to_message(wall.astype(np.float32), '32FC1'),
            'depth/camera_info': panorama_info(striped, Header()),
        }
    )
    got = bench.results()
    off = []
    for k in range(4):
        camera = pinhole_camera(got[f'view_{k}/camera_info'])
        row = to_array(got[f'view_{k}/image'])[round(camera.cy)]
        seen = np.isfinite(to_array(got[f'view_{k}/depth'])[round(camera.cy)])
        azimuth = k * math.pi / 2 - np.arctan((np.arange(camera.width) - camera.cx) / camera.fx)
        off += list(np.abs(row - shade(azimuth))[seen])
    assert len(off) > 300
    assert np.mean(off) < 5.0  # half a column is 9, at most


def test_faces_width_and_frames_are_parameters(ros):
    bench = Bench(ros, listen=(4,), faces=5, width=64, frame_prefix='mast_')
    bench.send()
    got = bench.results()
    info = got['view_4/camera_info']
    assert info.width == 64
    assert info.k[0] == pytest.approx(32 / math.tan(math.pi / 5))
    assert info.header.frame_id == 'mast_4_optical_frame'


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [({'faces': 3}, 'faces is 3; allowed: 4 to 36'), ({'width': 1}, 'width of a face is 1 px')],
)
def test_bad_parameter_stops_the_start_with_a_sentence(ros, values, sentence):
    with pytest.raises(ParameterError) as error:
        Bench(ros, **values)
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ('topic', 'message', 'sentence'),
    [
        ('depth/camera_info', CameraInfo(distortion_model='plumb_bob'), "model 'plumb_bob'"),
        (
            'depth/image',
            to_message(np.ones((ROWS, COLUMNS), np.uint16), '16UC1'),
            "depth/image has encoding '16UC1'; allowed: 32FC1",
        ),
        (
            'depth/image',
            to_message(np.ones((ROWS, 7), np.float32), '32FC1'),
            'radial_distance has shape (24, 7)',
        ),
        (
            'left/image',
            to_message(np.ones((ROWS, 7), np.uint8), 'mono8'),
            'panorama image is uint8 of shape (24, 7)',
        ),
    ],
)
def test_bad_panorama_is_refused_and_the_next_good_one_served(
    ros, capfd, topic, message, sentence
):
    diagnosis = Diagnosis(ros, 'views: views')
    bench = Bench(ros, listen=(0,))
    diagnosis.says(DiagnosticStatus.OK, 'no depth panorama received yet')
    bench.send(stamp=1, **{topic: message})
    diagnosis.says(DiagnosticStatus.ERROR, sentence)
    bench.send(stamp=2)
    diagnosis.says(DiagnosticStatus.OK, '1 views of')
    assert bench.results()['view_0/image'].header.stamp.sec == 2
    assert sentence in capfd.readouterr().err


def test_views_nobody_listens_to_are_not_drawn(ros, capfd):
    bench = Bench(ros, listen=(2,))
    bench.send()
    bench.results()
    assert '1 views of' in capfd.readouterr().err


def test_optical_frames_look_where_the_faces_do():
    for face in ring_of_faces(geometry(), 5, 64):
        q = face_transform(face, Header(frame_id='panodepth'), 'x').transform.rotation
        x, y, z, w = q.x, q.y, q.z, q.w
        matrix = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        c, s = math.cos(face.azimuth), math.sin(face.azimuth)
        right, down, forward = (s, -c, 0), (0, 0, -1), (c, s, 0)
        assert matrix == pytest.approx(np.array([right, down, forward]).T, abs=1e-12)


@pytest.mark.skipif(
    importlib.util.find_spec('tf2_msgs') is None, reason='needs tf2_msgs, which PyPI has not'
)
def test_frames_are_on_tf_static(ros):
    from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: PLC0415
    from tf2_msgs.msg import TFMessage  # noqa: PLC0415

    bench = Bench(ros)
    frames = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bench.node.create_subscription(TFMessage, '/tf_static', frames.append, latched)
    bench.send()
    ros.spin_until(lambda: frames, 'the frames')
    assert [t.child_frame_id for t in frames[0].transforms] == [
        ViewsParameters().frame(k) for k in range(4)
    ]
