"""Messages of one stamp, brought together."""

import pytest
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from panodepth_ros.ros.messages import to_stamp
from panodepth_ros.ros.sync import StampMatcher

pytestmark = pytest.mark.ros


def message(stamp):
    return Image(header=Header(stamp=to_stamp(stamp)))


def test_set_is_complete_with_its_last_topic():
    matcher = StampMatcher(('a', 'b'), depth=4)
    first, second = message(1), message(1)
    assert matcher.add('b', first) is None
    assert matcher.add('a', second) == {'a': second, 'b': first}


def test_stamps_are_not_mixed():
    matcher = StampMatcher(('a', 'b'), depth=4)
    assert matcher.add('a', message(1)) is None
    assert matcher.add('b', message(2)) is None
    assert matcher.add('a', message(2)) is not None


def test_same_topic_twice_does_not_complete_a_set():
    matcher = StampMatcher(('a', 'b'), depth=4)
    assert matcher.add('a', message(1)) is None
    assert matcher.add('a', message(1)) is None


def test_what_a_set_lacks_is_reported_once_when_the_next_begins():
    lacking = []
    matcher = StampMatcher(('a', 'b', 'c'), depth=4, report=lacking.append)
    for stamp, topics in ((1, 'abc'), (2, 'b'), (3, 'abc'), (2, 'a')):
        for topic in topics:
            matcher.add(topic, message(stamp))
    assert lacking == [['a', 'c']]


def test_oldest_incomplete_set_is_given_up():
    matcher = StampMatcher(('a', 'b'), depth=2)
    for stamp in (1, 2, 3):
        matcher.add('a', message(stamp))
    assert matcher.add('b', message(1)) is None, 'it was given up'
    assert matcher.add('b', message(3)) is not None


def test_incomplete_set_is_forgotten_once_a_later_one_is_complete():
    lacking = []
    matcher = StampMatcher(('a', 'b'), depth=4, report=lacking.append)
    matcher.add('a', message(1))
    for stamp in (2, 3, 4):
        matcher.add('a', message(stamp))
        assert matcher.add('b', message(stamp)) is not None
    assert lacking == [['b']]
    assert matcher.add('b', message(1)) is None


def test_complete_set_leaves_later_ones_alone():
    matcher = StampMatcher(('a', 'b'), depth=4)
    for topic, stamp in (('a', 1), ('a', 2), ('b', 1)):
        matcher.add(topic, message(stamp))
    assert matcher.add('b', message(2)) is not None
