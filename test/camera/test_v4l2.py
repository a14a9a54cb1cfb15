"""A V4L2 device through OpenCV and its controls; each test's own process sees the device."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest
from fixtures.v4l2_device import (
    ABSENT,
    IGNORES,
    MONOTONIC,
    NO_CLOCK,
    REALTIME,
    REFUSES,
    Device,
)

pytestmark = pytest.mark.launch

#: Opens the device, reads frames, tells what came of it.
_PROGRAM = """
import json, sys, threading, time
from panodepth_ros.camera.automatics import Automatics, Wishes
from panodepth_ros.camera.capture import V4l2Source
from panodepth_ros.camera.source import SourceError

path, wishes = sys.argv[1], json.loads(sys.argv[2])
pause = wishes.pop('pause', 0.0)
automatics = Automatics(Wishes(**wishes))
try:
    source = V4l2Source(path, size=(64, 48), framerate=50.0, pixel_format='auto',
        automatics=automatics, frame_timeout=2.0, stop=threading.Event())
    shades = [int(source.read().image[20, 20, 1]) for _ in range(5)]
    begin = time.monotonic()
    if pause:  # the driver fills its buffers meanwhile
        time.sleep(pause)
    later = [source.read().stamp - begin for _ in range(8)]
    source.close()
    told = {'held': automatics.held, 'failures': automatics.failures, 'shades': shades,
        'words': automatics.words(), 'later': later, 'begin': begin, 'skipped': source.skipped}
except SourceError as error:
    told = {'error': str(error)}
print(json.dumps(told))
"""


def read(device: Device, **wishes: Any) -> Any:
    """What a program that reads frames of the device tells."""
    ended = subprocess.run(
        [sys.executable, '-c', _PROGRAM, str(device.path), json.dumps(wishes)],
        stdout=subprocess.PIPE,
        timeout=60,
        text=True,
        check=True,
    )
    return json.loads(ended.stdout)


def now(device: Device, *names: str) -> list[int]:
    return [device[name] for name in names]


def test_values_that_are_given_are_set_before_the_first_frame(device: Device) -> None:
    wishes = {'autoexposure': False, 'exposure': 120, 'gain': 64, 'focus': 35}
    wishes |= {'auto_white_balance': False, 'white_balance': 5000, 'settle_time': 0.0}
    told = read(device, **wishes)
    held = {'exposure': 120, 'gain': 64, 'white_balance': 5000, 'focus': 35}
    assert told['held'] == held
    assert {name: device[name] for name in held} == held
    assert now(device, 'auto_exposure', 'auto_white_balance', 'autofocus') == [1, 0, 0]
    assert len(set(told['shades'])) == 1
    assert told['failures'] == {}


def test_what_is_not_automatic_keeps_the_value_that_it_has(device: Device) -> None:
    told = read(device, autoexposure=False, settle_time=0.3)
    assert told['held'] == {'exposure': 30, 'gain': 0, 'white_balance': 4000, 'focus': 100}
    assert now(device, 'auto_exposure', 'exposure', 'autofocus') == [1, 30, 0]


def test_a_camera_that_was_left_in_manual_settles_all_the_same(device: Device) -> None:
    device['auto_exposure'], device['exposure'] = 1, 2000
    told = read(device, settle_time=0.5)
    assert told['held']['exposure'] == pytest.approx(320, abs=2)
    assert device['auto_exposure'] == 1


@pytest.mark.parametrize(
    ('control', 'kind', 'name', 'sentence'),
    [
        (
            'auto_exposure',
            REFUSES,
            'exposure',
            'Auto Exposure of video device {} cannot be set to 1: Device or resource busy',
        ),
        (
            'auto_white_balance',
            IGNORES,
            'white_balance',
            'White Balance, Automatic of video device {} is 1 after it was set to 0',
        ),
    ],
)
def test_what_cannot_be_held_is_told(
    device: Device, control: str, kind: int, name: str, sentence: str
) -> None:
    device.behave(control, kind)
    told = read(device, settle_time=0.1)
    assert told['failures'] == {name: sentence.format(device.path)}
    assert name not in told['held']
    assert f'{name} cannot be held: ' in told['words']


def test_a_camera_without_controls_is_not_taken_for_one_that_holds(device: Device) -> None:
    for control in ('auto_exposure', 'exposure', 'auto_white_balance', 'white_balance'):
        device.behave(control, ABSENT)
    told = read(device, settle_time=0.1)
    assert told['words'].startswith(
        f'exposure and white_balance cannot be held: video device {device.path} has no control '
        'for exposure; it offers: Gain, Focus, Absolute, Focus, Automatic Continuous'
    )
    assert list(read(device, settle_time=0.1, grey=True)['failures']) == ['exposure']


def test_what_the_device_does_not_have_is_refused(device: Device) -> None:
    allowed = f'exposure is 5000; video device {device.path} allows 3 to 2047, or -1 for what it'
    assert allowed in read(device, autoexposure=False, exposure=5000)['error']
    device.behave('gain', ABSENT)
    missing = f'gain is 5, but video device {device.path} has no such control; it offers: White'
    assert missing in read(device, gain=5)['error']


@pytest.mark.parametrize('clock', [MONOTONIC, REALTIME])
def test_frames_that_waited_in_the_driver_keep_their_age(device: Device, clock: int) -> None:
    device['clock'] = clock
    told = read(device, settle_time=0.1, pause=2.2)
    old, new = told['later'][:4], told['later'][5:]  # four buffers, and one when they are free
    assert all(-0.05 < stamp < 0.2 for stamp in old)
    assert all(stamp > 2.1 for stamp in new)
    known = [stamp - told['begin'] for stamp in device.stamps()]
    assert all(min(abs(stamp - moment) for moment in known) < 2e-3 for stamp in old + new)


def test_frames_of_unknown_age_are_dropped(device: Device) -> None:
    device['clock'] = NO_CLOCK
    told = read(device, settle_time=0.1, pause=0.5)
    assert told['skipped'] >= 4
    known = [stamp - told['begin'] for stamp in device.stamps()]
    assert all(stamp > 0.5 for stamp in told['later'])
    fresh = [min(stamp - moment for moment in known if moment <= stamp) for stamp in told['later']]
    assert sorted(fresh)[len(fresh) // 2] < 0.01
