"""A mosaicer that was killed: when it goes on, and when it asks the arm again."""

import time
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from fixtures.mosaicer import Bench

from panodepth_ros.nodes import comeback as module
from panodepth_ros.nodes.comeback import Comeback
from panodepth_ros.nodes.panoramas import PanoramaPublisher
from panodepth_ros.nodes.stepping import DISCOVERY_TIME

pytestmark = pytest.mark.ros


def comeback(heard):
    """A mosaicer that was started anew, and knows camera and arm."""
    builder = SimpleNamespace(track=SimpleNamespace(newest=1), camera='camera', rig='rig')
    keeper = Mock()
    keeper.find.return_value = None
    made = Comeback(Mock(), builder, Mock(), Mock(), keeper, lambda: heard, Mock(), Mock())
    return made, keeper.find


def test_sweep_is_taken_up_when_its_panoramas_will_be_heard():
    made, find = comeback(heard=True)
    made.of_mosaicer()
    assert find.called


def test_mosaicer_waits_for_who_hears_the_panoramas_but_not_for_ever(monkeypatch):
    made, find = comeback(heard=False)
    made.of_mosaicer()
    assert not find.called
    now = time.monotonic()
    monkeypatch.setattr(module.time, 'monotonic', lambda: now + 6.0)
    made.of_mosaicer()
    assert find.called


def test_driver_that_a_new_mosaicer_has_just_found_is_not_asked_at_once(ros):
    leader = Bench(ros).ready().mosaicer._leader
    now = time.monotonic()
    leader.take_up(0.0)
    assert leader._ask_from >= now + DISCOVERY_TIME


def test_panoramas_are_heard_by_who_subscribes_to_them(ros):
    panoramas = Bench(ros).mosaicer._panoramas
    assert panoramas['left'].heard
    unheard = PanoramaPublisher(ros.node('lonely'), 'nowhere')
    assert not unheard.heard
