"""Bag files, without ROS: what is written comes back, damage is told in a sentence."""

import gc
import json
import re
import resource
import shutil
import sqlite3
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rosbags', reason='bags need rosbags')

from fixtures.bags import BEGIN, joint_states, write_joint_states

from panodepth_ros.bag import STORAGES, BagError, BagWriter, read

storages = pytest.mark.parametrize('storage', STORAGES)
SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}


def data_file(bag: Path, storage: str) -> Path:
    return bag / f'{bag.name}{SUFFIX[storage]}'


@storages
def test_written_messages_are_read_back(tmp_path: Path, storage: str) -> None:
    messages = joint_states('/a', 5, 0.1) + joint_states('/b', 3, 0.1, BEGIN + 50_000_000)
    bag = write_joint_states(tmp_path / 'bag', messages, storage)
    got = list(read(bag))
    assert [(topic, time) for topic, time, _ in got] == [
        (topic, time) for topic, time, _ in sorted(messages, key=lambda message: message[1])
    ]
    for topic, time, message in got:
        position = float((time - BEGIN) // 100_000_000)
        assert topic in ('/a', '/b')
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
        assert message.header.frame_id == 'base'
        assert message.name == ['arm', 'näxt']
        np.testing.assert_array_equal(message.position, [position, -position])
        assert message.velocity.size == 0
        np.testing.assert_array_equal(message.effort, [np.nan])


@storages
def test_one_file_and_chosen_topics_can_be_read(tmp_path: Path, storage: str) -> None:
    messages = joint_states('/a', 5, 0.1) + joint_states('/b', 3, 0.1)
    bag = write_joint_states(tmp_path / 'bag', messages, storage)
    assert len(list(read(data_file(bag, storage)))) == 8
    assert [topic for topic, _, _ in read(bag, ['/b'])] == ['/b'] * 3


@storages
def test_messages_come_in_order_of_time(tmp_path: Path, storage: str) -> None:
    messages = joint_states('/a', 20, 0.1)
    bag = write_joint_states(tmp_path / 'bag', messages[::-1], storage)
    assert [message.position[0] for _, _, message in read(bag)] == list(range(20))


def test_mcap_is_what_an_independent_reader_expects(tmp_path: Path) -> None:
    mcap_ros2 = pytest.importorskip('mcap_ros2.reader', reason='needs mcap-ros2-support')
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    got = list(mcap_ros2.read_ros2_messages(str(data_file(bag, 'mcap'))))
    assert [message.ros_msg.position for message in got] == [[k, -k] for k in range(5)]
    assert [message.log_time_ns for message in got] == [BEGIN + k * 10**8 for k in range(5)]
    assert {message.ros_msg.name[1] for message in got} == {'näxt'}
    assert {message.schema.name for message in got} == {'sensor_msgs/msg/JointState'}


def test_sqlite_has_the_tables_of_rosbag2(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1), 'sqlite3')
    connection = sqlite3.connect(data_file(bag, 'sqlite3'))
    rows = connection.execute(
        'SELECT name, type, timestamp FROM messages JOIN topics ON topic_id = topics.id'
    ).fetchall()
    connection.close()
    kind = 'sensor_msgs/msg/JointState'
    assert rows == [('/a', kind, BEGIN + k * 10**8) for k in range(5)]


# Damage: one sentence that names the bag.


def assert_unreadable(bag: Path, says: str) -> None:
    with pytest.raises(BagError, match=says) as caught:
        list(read(bag))
    assert str(bag) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_missing_bag_is_named(tmp_path: Path) -> None:
    assert_unreadable(tmp_path / 'nowhere', 'does not exist')


def test_folder_without_metadata_is_no_bag(tmp_path: Path) -> None:
    assert_unreadable(tmp_path, r'is no bag: it has no metadata\.yaml')


@pytest.mark.parametrize('name', ['notes.txt', 'x.mcap', 'x.db3', 'metadata'])
@pytest.mark.parametrize('content', [b'', b'no bag at all\n' * 50], ids=['empty', 'text'])
def test_file_that_is_no_bag_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert_unreadable(path, 'cannot be read as a bag: .')


@pytest.mark.parametrize('text', ['', '\t{', 'rosbag2_bagfile_information: 3', 'a: [1'])
def test_bag_with_broken_metadata_is_named(tmp_path: Path, text: str) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    (bag / 'metadata.yaml').write_text(text)
    assert_unreadable(bag, 'cannot be read as a bag: .')


@storages
def test_bag_without_its_data_file_is_named(tmp_path: Path, storage: str) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1), storage)
    data_file(bag, storage).unlink()
    assert_unreadable(bag, 'cannot be read as a bag: .')


@pytest.mark.parametrize('share', [0.0, 0.01, 0.3, 0.5, 0.7, 0.9, 0.99])
@storages
def test_truncated_bag_is_named(tmp_path: Path, storage: str, share: float) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 3000, 0.1), storage)
    file = data_file(bag, storage)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    assert_unreadable(bag, 'cannot be read as a bag: .')
    assert_unreadable(file, 'cannot be read as a bag: .')


def test_bag_that_lacks_messages_is_damaged(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1), 'sqlite3')
    connection = sqlite3.connect(data_file(bag, 'sqlite3'))
    connection.execute('DELETE FROM messages WHERE id > 3')
    connection.commit()
    connection.close()
    assert_unreadable(bag, 'is damaged: it holds 3 of its 5 messages')


@storages
def test_bag_without_messages_is_named(tmp_path: Path, storage: str) -> None:
    BagWriter(tmp_path / 'bag', storage).close()
    assert_unreadable(tmp_path / 'bag', 'holds no messages')


def test_unknown_topic_is_named(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    with pytest.raises(BagError, match=r'has no topic /c; it has /a$'):
        list(read(bag, ['/a', '/c']))


def test_topic_of_another_type_is_named(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/states', 5, 0.1))
    with pytest.raises(BagError, match=r'/states of bag .* is of type sensor_msgs/msg/Joint'):
        list(read(bag, {'/states': 'sensor_msgs/msg/Image'}))
    assert len(list(read(bag, {'/states': 'sensor_msgs/msg/JointState'}))) == 5


def test_reading_can_end_early(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    messages = read(bag)
    assert next(messages)[1] == BEGIN
    messages.close()
    shutil.rmtree(bag)


# Writing


@pytest.mark.parametrize('there', ['file', 'folder'])
def test_nothing_is_overwritten(tmp_path: Path, there: str) -> None:
    path = tmp_path / 'bag'
    path.mkdir() if there == 'folder' else path.write_text('mine')
    with pytest.raises(BagError, match='exists already') as caught:
        BagWriter(path)
    assert str(path) in str(caught.value)
    assert path.is_dir() if there == 'folder' else path.read_text() == 'mine'


def test_path_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('mine')
    path = tmp_path / 'file' / 'bag'
    with pytest.raises(BagError, match='cannot be made: Not a directory'):
        BagWriter(path)


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file may grow beyond a number of bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@storages
@pytest.mark.parametrize('size', [0, 100, 20_000, 300_000])
def test_full_disk_is_told_in_a_sentence(tmp_path: Path, storage: str, size: int) -> None:
    path = tmp_path / 'bag'
    messages = joint_states('/a', 3000, 0.1)
    with pytest.raises(BagError) as caught, full_disk(size):
        write_joint_states(path, messages, storage)
    told = str(caught.value)
    del caught
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', ResourceWarning)  # rosbags leaves the file open
        gc.collect()
    reason = 'File too large' if storage == 'mcap' else 'disk I/O error'
    said = f'bag {path} cannot be (made|written|completed): {reason}'
    assert re.fullmatch(said, told)


def test_unknown_storage_is_named(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="storage is 'zip'; allowed: mcap, sqlite3"):
        BagWriter(tmp_path / 'bag', 'zip')
    assert not (tmp_path / 'bag').exists()


WITHOUT_ROSBAGS = """
import json, sys
sys.modules['rosbags'] = None  # as if it were not installed
from panodepth_ros.bag import BagError, BagWriter, read
said = []
for use in (lambda: BagWriter(sys.argv[2]), lambda: list(read(sys.argv[1]))):
    try:
        use()
    except BagError as error:
        said.append(str(error))
print(json.dumps(said))
"""


@pytest.mark.launch
def test_missing_rosbags_is_told_with_the_remedy(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    command = [sys.executable, '-c', WITHOUT_ROSBAGS, str(bag), str(tmp_path / 'new')]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    said = json.loads(done.stdout)
    assert len(said) == 2
    for sentence in said:
        assert 'pip install rosbags' in sentence
        assert 'ros2 bag' in sentence
    assert not (tmp_path / 'new').exists()


@pytest.mark.launch
def test_reading_needs_no_ros(tmp_path: Path) -> None:
    bag = write_joint_states(tmp_path / 'bag', joint_states('/a', 5, 0.1))
    code = (
        'import sys; from panodepth_ros.bag import read; n = len(list(read(sys.argv[1])))\n'
        'assert "rclpy" not in sys.modules; print(n)'
    )
    command = [sys.executable, '-c', code, str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == '5'
