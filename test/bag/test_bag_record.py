"""Recording between processes: everything arrives, and the bag is complete."""

import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rosbags', reason='bags need rosbags')

from diagnostic_msgs.msg import DiagnosticArray
from fixtures.ros import started
from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    qos_profile_sensor_data,
)
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan, PointCloud2
from std_msgs.msg import Empty, Float32, String
from std_srvs.srv import Trigger

from panodepth_ros.bag import STORAGES, BagWriter, read
from panodepth_ros.bag.recorder import Recorder, drain
from panodepth_ros.bag.storage import opened, rosbags
from panodepth_ros.bag.types import message_class, register
from panodepth_ros.cli.main import main
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_array, to_message

pytestmark = [pytest.mark.ros, pytest.mark.launch]


def record(bag: Path, *arguments: str, **how):
    return started('panodepth_ros', 'record', '-o', str(bag), *arguments, **how)


def matched(*publishers) -> bool:
    return all(publisher.get_subscription_count() == 1 for publisher in publishers)


def acknowledged(*publishers) -> bool:
    return all(p.wait_for_all_acked(Duration(seconds=20)) for p in publishers)


@pytest.mark.parametrize('storage', STORAGES)
def test_recording_at_500_hz_loses_nothing(ros, tmp_path: Path, storage: str) -> None:
    node = ros.node()
    images = node.create_publisher(Image, 'image_raw', qos.IMAGES)
    states = node.create_publisher(JointState, 'joint_states', qos.JOINT_STATES)
    generator = np.random.default_rng(7)
    frames = generator.integers(0, 256, (50, 120, 160, 3), np.uint8)
    messages = [to_message(frame, 'bgr8', frame_id='camera') for frame in frames]
    count = 1000
    bag = tmp_path / 'bag'
    with record(bag, '/image_raw', '/joint_states', '--storage', storage) as recorder:
        ros.spin_until(lambda: matched(images, states), 'the recorder')
        before = time.time_ns()
        due = time.monotonic()
        for k in range(count):
            time.sleep(max(0.0, due - time.monotonic()))
            due += 1 / 500
            images.publish(messages[k % 50])
            states.publish(JointState(name=['arm'], position=[float(k)]))
        assert acknowledged(images, states)
        after = time.time_ns()
        assert recorder.stop() == 0
        assert f'{bag}: {2 * count} messages' in recorder.output
    got: dict[str, list] = {'/image_raw': [], '/joint_states': []}
    for topic, received, message in read(bag):
        assert before <= received <= after
        got[topic].append(message)
    assert [message.position[0] for message in got['/joint_states']] == list(range(count))
    assert len(got['/image_raw']) == count
    for k, message in enumerate(got['/image_raw']):
        np.testing.assert_array_equal(to_array(message), frames[k % 50])
        assert message.header.frame_id == 'camera'


@pytest.mark.parametrize('stop_signal', [signal.SIGINT, signal.SIGTERM])
def test_either_signal_leaves_a_complete_bag(ros, tmp_path: Path, stop_signal) -> None:
    publisher = ros.node().create_publisher(Float32, 'number', 100)
    with record(tmp_path / 'bag', '/number', stop_signal=stop_signal):
        ros.spin_until(lambda: matched(publisher), 'the recorder')
        for k in range(20):
            publisher.publish(Float32(data=float(k)))
        assert acknowledged(publisher)
    assert [message.data for _, _, message in read(tmp_path / 'bag')] == list(range(20))


def test_what_waits_in_the_queues_at_the_end_is_written(ros, tmp_path: Path) -> None:
    publisher = ros.node().create_publisher(Float32, 'number', 100)
    with BagWriter(tmp_path / 'bag') as writer:
        recorder = Recorder(ros.node('recorder'), writer, ['number'])
        ros.spin_until(lambda: matched(publisher), 'the recorder')
        for k in range(50):
            publisher.publish(Float32(data=float(k)))
        assert acknowledged(publisher)
        assert writer.message_count == 0
        drain(ros.executor, recorder, writer)
    assert [message.data for _, _, message in read(tmp_path / 'bag')] == list(range(50))


def test_topic_that_appears_later_is_recorded(ros, tmp_path: Path) -> None:
    node = ros.node()
    early = node.create_publisher(Float32, 'early', 10)
    with record(tmp_path / 'bag', '/early', 'late') as recorder:  # relative names are the root's
        ros.spin_until(lambda: matched(early), 'the recorder')
        assert '/late' not in recorder.output
        late = node.create_publisher(String, 'late', 10)
        ros.spin_until(lambda: matched(late), 'the recorder')
        late.publish(String(data='at last'))
        assert acknowledged(late)
    assert [(topic, message.data) for topic, _, message in read(tmp_path / 'bag')] == [
        ('/late', 'at last')
    ]


def test_all_means_all_but_hidden_and_housekeeping_topics(ros, tmp_path: Path) -> None:
    node = ros.node()
    node.create_service(Trigger, 'something', lambda request, response: response)
    names = ['a', 'b/c', '_hidden', 'b/_hidden']
    publishers = {name: node.create_publisher(Float32, name, 10) for name in names}
    node.get_logger().info('this goes to /rosout')
    with record(tmp_path / 'bag', '--all'):
        ros.spin_until(lambda: matched(publishers['a'], publishers['b/c']), 'the recorder')
        for publisher in publishers.values():
            publisher.publish(Float32(data=1.0))
        assert acknowledged(publishers['a'], publishers['b/c'])
    assert {topic for topic, _, _ in read(tmp_path / 'bag')} == {'/a', '/b/c'}
    with opened(tmp_path / 'bag') as reader:
        assert {connection.topic for connection in reader.connections} == {'/a', '/b/c'}


LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_every_kind_of_publisher_is_recorded_with_its_qos(ros, tmp_path: Path) -> None:
    node = ros.node()
    best_effort = node.create_publisher(Float32, 'best_effort', qos_profile_sensor_data)
    latched = node.create_publisher(Float32, 'latched', LATCHED)
    latched.publish(Float32(data=5.0))  # before anyone listens
    mixed = [
        node.create_publisher(Float32, 'mixed', profile)
        for profile in (LATCHED, qos_profile_sensor_data)
    ]
    publishers = [best_effort, latched, *mixed]
    bag = tmp_path / 'bag'
    with record(bag, 'best_effort', 'latched', 'mixed') as recorder:
        ros.spin_until(lambda: matched(*publishers), 'the recorder')
        for publisher in (best_effort, *mixed):
            publisher.publish(Float32(data=1.0))
        assert acknowledged(latched)
        assert recorder.stop() == 0
    topics = [topic for topic, _, _ in read(bag)]
    assert sorted(topics) == ['/best_effort', '/latched', '/mixed', '/mixed']
    with opened(bag) as reader:
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    reliability = {name: sorted(q.reliability.name for q in o) for name, o in offered.items()}
    assert reliability == {
        '/best_effort': ['BEST_EFFORT'],
        '/latched': ['RELIABLE'],
        '/mixed': ['BEST_EFFORT', 'RELIABLE'],
    }
    assert [profile.durability.name for profile in offered['/latched']] == ['TRANSIENT_LOCAL']
    assert offered['/latched'][0].deadline == (9223372036, 854775807)  # infinite, as rmw has it


def test_existing_path_is_refused(ros_domain: int, tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    bag.mkdir()
    with record(bag, '/number', exit_code=1) as recorder:
        recorder.wait()
        assert (
            recorder.output
            == f'panodepth_ros record: {bag} exists already and is not overwritten\n'
        )


@pytest.mark.parametrize('name', ['', '/a b', '/a//b', '/{robot}/a', '/1a'])
def test_impossible_name_of_a_topic_is_told(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert main(['record', '-o', str(tmp_path / 'bag'), name]) == 1
    told = capsys.readouterr().err
    assert told.startswith(f'panodepth_ros record: {name!r} is no name of a topic: ')
    assert told.count('\n') == 1
    assert not (tmp_path / 'bag').exists()


def test_topic_of_a_type_that_is_not_installed_is_named(ros, tmp_path: Path) -> None:
    publisher = ros.node().create_publisher(Float32, 'number', 10)
    code = (
        'import sys; sys.modules["std_msgs.msg"] = None\n'
        'from panodepth_ros.cli.main import main; sys.exit(main())'
    )
    arguments = ['record', '-o', str(tmp_path / 'bag'), '/number']
    with started(sys.executable, '-c', code, *arguments) as recorder:
        ros.spin_until(lambda: '/number is not recorded' in recorder.output, 'the message')
        assert 'message type std_msgs/msg/Float32 is not installed' in recorder.output
    assert publisher.get_subscription_count() == 0


# Definitions: the hash of what the bag stores must be the hash that DDS announces.


@pytest.mark.parametrize(
    'kind',
    [
        CameraInfo,
        DiagnosticArray,
        Empty,
        Image,
        JointState,
        LaserScan,
        ParameterDescriptor,  # bounded sequences
        ParameterEvent,
        PointCloud2,
        String,
    ],
    ids=lambda kind: kind.__name__,
)
def test_stored_definition_has_the_hash_of_the_running_type(ros, kind) -> None:
    node = ros.node()
    node.create_publisher(kind, 'typed', 1)
    ros.spin_until(lambda: node.get_publishers_info_by_topic('/typed'), 'the graph')
    (info,) = node.get_publishers_info_by_topic('/typed')
    typesys = rosbags('typesys')
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    register(info.topic_type, store)
    digest = store.hash_rihs01(info.topic_type)
    version, value = info.topic_type_hash.version, bytes(info.topic_type_hash.value)
    assert digest == f'RIHS{version:02d}_{value.hex()}'
    assert message_class(info.topic_type) is kind
