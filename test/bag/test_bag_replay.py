"""Replaying between processes: when, what, and that nothing is lost."""

import signal
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rosbags', reason='bags need rosbags')

from fixtures.bags import (
    BEGIN,
    joint_states,
    panorama_pair,
    write_joint_states,
    write_panoramas,
)
from fixtures.ros import started
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

from panodepth_ros.bag import STORAGES, BagWriter
from panodepth_ros.bag.player import bursts
from panodepth_ros.bag.storage import rosbags
from panodepth_ros.cli.main import main

pytestmark = pytest.mark.ros

launch = pytest.mark.launch


def replay(bag: Path, *arguments: str, **how):
    return started('panodepth_ros', 'replay', str(bag), *arguments, **how)


class Listener:
    """Positions of the joint states that a node gets on a topic."""

    def __init__(self, node: Node, topic: str, depth: QoSProfile | int = 100, delay: float = 0.0):
        self.positions: list[float] = []
        self._delay = delay
        node.create_subscription(JointState, topic, self._take, depth)

    def _take(self, message: JointState) -> None:
        self.positions.append(message.position[0])
        time.sleep(self._delay)  # stands for the work of a slow callback


# As fast as possible


@launch
@pytest.mark.parametrize('storage', STORAGES)
def test_asap_loses_nothing_on_slow_subscribers_with_the_shortest_queue(
    ros, tmp_path: Path, storage: str
) -> None:
    messages = joint_states('/slow', 300, 0.001) + joint_states('/quick', 300, 0.001)
    messages.sort(key=lambda message: message[1])
    bag = write_joint_states(tmp_path / 'bag', messages, storage)
    node = ros.node('taker')
    slow = Listener(node, 'slow', depth=1, delay=0.01)
    quick = Listener(node, 'quick', depth=1)
    other = Listener(ros.node('other', namespace='/deep/down'), '/quick', depth=1)
    with replay(bag, '--asap') as player:
        ros.spin_until(lambda: not player.running(), 'the end of the replay', timeout=60)
        assert 'sent 600 of 600 messages' in player.output
        assert 'may lose' not in player.output
    for listener in (slow, quick, other):
        assert listener.positions == list(range(300))


@launch
def test_asap_loses_no_large_message(ros, tmp_path: Path) -> None:
    typesys = rosbags('typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kind = 'std_msgs/msg/UInt8MultiArray'
    layout = store.types['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=0)
    count, size = 40, 4_000_000  # many times the shared memory of Fast DDS
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/large', kind, store)
        for k in range(count):
            message = store.types[kind](layout=layout, data=np.full(size, k, np.uint8))
            bag.write('/large', BEGIN + k, store.serialize_cdr(message, kind))
    got: list[tuple[int, int]] = []
    ros.node().create_subscription(
        UInt8MultiArray, 'large', lambda m: got.append((len(m.data), m.data[-1])), 1
    )
    with replay(tmp_path / 'bag', '--asap') as player:
        ros.spin_until(lambda: not player.running(), 'the end of the replay', timeout=60)
    assert got == [(size, k) for k in range(count)]


@launch
def test_asap_loses_nothing_on_a_recorder(ros_domain: int, tmp_path: Path) -> None:
    messages = joint_states('/states', 500, 0.001)
    bag = write_joint_states(tmp_path / 'bag', messages)
    copy = tmp_path / 'copy'
    with started('panodepth_ros', 'record', '-o', str(copy), '/states') as recorder:
        with replay(bag, '--asap') as player:
            player.wait()
        assert recorder.stop() == 0
        assert f'{copy}: 500 messages' in recorder.output


@launch
def test_asap_waits_for_a_subscriber_of_every_topic(ros, tmp_path: Path) -> None:
    messages = joint_states('/early', 20, 0.001) + joint_states('/late', 20, 0.001)
    bag = write_joint_states(tmp_path / 'bag', messages)
    early = Listener(ros.node('early_node'), 'early')
    with replay(bag, '--asap') as player:
        ros.spin_until(lambda: 'waiting for subscribers of' in player.output, 'the notice')
        assert early.positions == []
        late = Listener(ros.node('late_node'), 'late')
        ros.spin_until(lambda: not player.running(), 'the end of the replay')
    assert early.positions == late.positions == list(range(20))


@launch
def test_asap_goes_on_when_a_subscriber_leaves(ros, tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 300, 0.001))
    stays = Listener(ros.node('stays'), 'states', depth=1)
    leaver = ros.node('leaver')
    leaves = Listener(leaver, 'states', depth=1)
    with replay(bag, '--asap', '--wait-for', '/states=2') as player:
        ros.spin_until(lambda: len(leaves.positions) >= 50, 'fifty messages')
        assert player.running()
        ros.executor.remove_node(leaver)
        leaver.destroy_node()
        ros.spin_until(lambda: not player.running(), 'the end of the replay', timeout=60)
        assert 'sent 300 of 300' in player.output
    assert stays.positions == list(range(300))
    assert leaves.positions == list(range(len(leaves.positions)))


@launch
def test_asap_says_who_cannot_be_asked(ros, tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 5, 0.001))
    silent = Listener(ros.node('silent', start_parameter_services=False), 'states')
    best_effort = Listener(ros.node('hasty'), 'states', depth=qos_profile_sensor_data)
    with replay(bag, '--asap', '--wait-for', '/states=2') as player:
        ros.spin_until(lambda: not player.running(), 'the end of the replay')
        assert '/silent takes /states but has no parameter services' in player.output
        assert '/hasty takes' not in player.output
        assert '/states has a best-effort subscriber' in player.output
    assert silent.positions == list(range(5))
    assert set(best_effort.positions) <= set(range(5))


def test_bursts_hold_no_topic_twice_and_keep_the_order() -> None:
    a, b, c = object(), object(), object()
    messages = [(p, k, b'') for k, p in enumerate([a, b, c, a, a, c, b, c])]
    assert [[k for _, k, _ in burst] for burst in bursts(messages)] == [
        [0, 1, 2],
        [3],
        [4, 5, 6],
        [7],
    ]
    assert list(bursts([])) == []


# With timing. Nothing comes before it is due; how much later depends on the machine.


@launch
@pytest.mark.parametrize(('rate', 'duration'), [(1.0, 3.0), (0.5, 1.5), (4.0, 12.0)])
def test_no_message_comes_early(ros, tmp_path: Path, rate: float, duration: float) -> None:
    messages = joint_states('/states', 4, duration / 3)
    bag = write_joint_states(tmp_path / 'bag', messages)
    arrivals: list[float] = []
    ros.node().create_subscription(
        JointState, 'states', lambda _: arrivals.append(time.monotonic()), 10
    )
    began = time.monotonic()
    with replay(bag, '--rate', str(rate), '--wait-for', '/states') as player:
        ros.spin_until(lambda: not player.running(), 'the end of the replay')
    assert len(arrivals) == 4
    for k, arrival in enumerate(arrivals):
        assert arrival - began > k / 3 * duration / rate


@launch
def test_rate_shortens_an_hour_to_seconds(ros, tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 10, 400.0))
    listener = Listener(ros.node(), 'states')
    with replay(bag, '--rate', '3600', '--wait-for', '/states') as player:
        ros.spin_until(lambda: not player.running(), 'the end of the hour', timeout=60)
        assert 'sent 10 of 10' in player.output
    assert listener.positions == list(range(10))


@launch
@pytest.mark.parametrize('pace', [['--rate', '10'], ['--asap']])
def test_clock_tells_the_time_of_the_bag(ros, tmp_path: Path, pace: list[str]) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 5, 1.0))
    times: list[int] = []
    node = ros.node()
    node.create_subscription(
        Clock, '/clock', lambda m: times.append(m.clock.sec * 10**9 + m.clock.nanosec), 1000
    )
    Listener(node, 'states')
    with replay(bag, '--clock', '--wait-for', '/states', *pace) as player:
        ros.spin_until(lambda: times and times[-1] == BEGIN + 4 * 10**9, 'the last time')
        ros.spin_until(lambda: not player.running(), 'the end of the replay')
    assert all(BEGIN <= stamp <= BEGIN + 4 * 10**9 for stamp in times)
    assert all(earlier <= later for earlier, later in pairwise(times))
    if pace != ['--asap']:
        assert len(times) > 10  # it runs on between the five messages


@launch
def test_latched_topic_reaches_a_late_subscriber(ros, tmp_path: Path) -> None:
    interfaces = rosbags('interfaces')
    time_zero = interfaces.QosTime(0, 0)
    latched = interfaces.Qos(
        interfaces.QosHistory.KEEP_LAST,
        1,
        interfaces.QosReliability.RELIABLE,
        interfaces.QosDurability.TRANSIENT_LOCAL,
        time_zero,
        time_zero,
        interfaces.QosLiveliness.AUTOMATIC,
        time_zero,
        False,
    )
    messages = joint_states('/latched', 1, 1.0) + joint_states('/states', 100, 0.1)
    qos = {'/latched': [latched]}
    bag = write_joint_states(tmp_path / 'bag', messages, qos=qos)
    node = ros.node()
    states = Listener(node, 'states')
    with replay(bag, '--wait-for', '/states') as player:
        ros.spin_until(lambda: len(states.positions) > 1, 'the replay')
        late = Listener(
            node, 'latched', QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        )
        ros.spin_until(lambda: late.positions, 'the latched message')
        assert player.stop() == 0
    assert late.positions == [0.0]


# What is played


@launch
def test_topics_are_chosen_and_renamed(ros, tmp_path: Path) -> None:
    messages = [message for name in ('/a', '/b', '/c') for message in joint_states(name, 5, 0.001)]
    bag = write_joint_states(tmp_path / 'bag', messages)
    node = ros.node()
    listeners = {name: Listener(node, name) for name in ('a', 'b', 'c', 'x/new')}
    arguments = ['--topics', '/a', '/b', '--exclude', '/b', '--remap', '/a:=/x/new']
    with replay(bag, '--asap', *arguments) as player:
        ros.spin_until(lambda: not player.running(), 'the end of the replay')
        assert 'sent 5 of 5 messages' in player.output
    assert {name: len(listener.positions) for name, listener in listeners.items()} == {
        'a': 0,
        'b': 0,
        'c': 0,
        'x/new': 5,
    }


@launch
@pytest.mark.parametrize('stop_signal', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('pace', [['--wait-for', '/nobody'], ['--rate', '0.001'], ['--asap']])
def test_signal_ends_a_replay_that_waits(
    ros_domain: int, tmp_path: Path, stop_signal: signal.Signals, pace: list[str]
) -> None:
    messages = joint_states('/states', 5, 1.0) + joint_states('/nobody', 5, 1.0)
    bag = write_joint_states(tmp_path / 'bag', messages)
    with replay(bag, *pace, '--clock', stop_signal=stop_signal) as player:
        player.wait_for_output('replaying' if '--rate' in pace else 'waiting for subscribers')
    assert f' of {len(messages)} messages' in player.output


# What goes wrong: a sentence and exit code 1.


def says(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(['replay', *map(str, arguments)]) == 1
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.startswith('panodepth_ros replay: ')
    assert captured.err.count('\n') == 1
    return captured.err


@pytest.mark.parametrize('storage', STORAGES)
def test_damaged_bag_is_a_sentence_and_exit_code_1(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str], storage: str
) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 500, 0.001), storage)
    (file,) = (path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    assert f'{bag} cannot be read as a bag: ' in says(capsys, bag)
    file.write_bytes(b'')
    assert f'{bag} cannot be read as a bag: ' in says(capsys, bag)
    assert f'bag {tmp_path / "none"} does not exist' in says(capsys, tmp_path / 'none')
    assert f'{tmp_path} is no bag' in says(capsys, tmp_path)


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['--topics', '/none'], 'has no topic /none; it has /states'),
        (['--exclude', '/none'], 'has no topic /none; it has /states'),
        (['--remap', '/none:=/x'], '/none is not replayed, so not remapped'),
        (['--wait-for', '/none'], '/none is not replayed, so not waited for'),
        (
            ['--remap', '/states:=/x', '--wait-for', '/states'],
            '/states is not replayed, so not waited for; replayed are /x',
        ),
        (['--topics', '/states', '--exclude', '/states'], 'is left to replay'),
        (['--remap', '/states:=/a b'], "'/a b' is no name of a topic: "),
        (['--remap', '/states:=/a//b'], "'/a//b' is no name of a topic: "),
    ],
)
def test_unknown_topic_is_a_sentence_and_exit_code_1(
    ros_domain: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    sentence: str,
) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 5, 0.001))
    assert sentence in says(capsys, bag, *arguments)


def test_two_types_do_not_meet_under_one_name(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flat = np.zeros((4, 360), np.uint8)
    bag = write_panoramas(tmp_path / 'bag', [panorama_pair(flat, 4)])
    complaint = says(capsys, bag, '--remap', '/left/image:=/x', '/right/camera_info:=/x')
    assert 'cannot be replayed as /x: its type is sensor_msgs/msg/' in complaint


@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        (['--rate', '0'], 'number above 0'),
        (['--rate', '-1'], 'number above 0'),
        (['--rate', 'nan'], 'number above 0'),
        (['--rate', 'inf'], 'number above 0'),
        (['--remap', '/a'], 'old:=new'),
        (['--remap', '/a:='], 'old:=new'),
        (['--wait-for', '/a=0'], 'name=number'),
        (['--wait-for', '/a=x'], 'name=number'),
        (['--asap', '--rate', '2'], 'not allowed with'),
    ],
)
def test_bad_argument_is_refused(
    capsys: pytest.CaptureFixture[str], arguments: list[str], complaint: str
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(['replay', 'bag', *arguments])
    assert caught.value.code == 2
    assert complaint in capsys.readouterr().err
