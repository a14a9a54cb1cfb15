"""The whole graph as processes: a turn of the simulated rig, and its replay."""

import json
import signal
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
import yaml
from fixtures.demo import COLUMNS
from fixtures.ros import started
from std_srvs.srv import Trigger

from panodepth_ros.bag import read
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry

pytestmark = [pytest.mark.ros, pytest.mark.launch, pytest.mark.timeout(300)]
ROOT = Path(__file__).resolve().parents[2]
RESULTS = ('/left/image', '/right/image', '/depth/image', '/depth/confidence', '/scan')
FURTHER = ('/pair_1/left/image', '/pair_1/right/image', '/pair_1/right/camera_info')


def test_demo_writes_and_prints_what_it_promises(demo):
    output, _, printed = demo
    for eye in ('left', 'right'):
        assert cv2.imread(str(output / f'{eye}.png')).shape == (120, COLUMNS, 3)
    for name in ('depth.png', 'confidence.png', 'ground_plan.png'):
        assert cv2.imread(str(output / name)) is not None
    scan = json.loads((output / 'scan.json').read_text())
    assert len(scan['ranges']) == 120
    assert f'{scan["accuracy"]["scan"]["coverage"]:.1%} of the beams hold a range' in printed
    assert '100%' in printed


def test_coarse_scan_lies_on_the_room(demo):
    # One column of 1.5 degrees is l*step/(2 r0) = 34 % of the distance at 2 m. Left and right
    # swapped, a mirrored panorama or a wrong turn would leave nothing near that.
    output, _, _ = demo
    accuracy = json.loads((output / 'scan.json').read_text())['accuracy']['scan']
    assert accuracy['coverage'] > 0.6
    assert accuracy['median_error'] < 0.34 / 3


def test_replay_gives_the_same_values(ros, demo, tmp_path):
    output, parameters, _ = demo
    live = {topic: message for topic, _, message in read(output / 'bag') if topic in RESULTS}
    files = ['--ros-args', '--params-file', str(parameters)]
    with (
        started('mosaicer', *files, '-p', 'lead:=false'),
        started('depth', *files) as depth,
        started(
            'panodepth_ros', 'record', '-o', str(tmp_path / 'out'), *RESULTS, *FURTHER
        ) as recorder,
    ):
        depth.wait_for_output('ready')
        ros.spin_until_recorded((*RESULTS, *FURTHER))
        topics = ['/image_raw', '/camera_info', '/joint_states']
        with started(
            'panodepth_ros', 'replay', '--asap', str(output / 'bag'), '--topics', *topics
        ) as replay:
            assert replay.wait(200) == 0
        depth.wait_for_output('beams hold a distance')
        recorder.stop()
    replayed = {topic: message for topic, _, message in read(tmp_path / 'out')}
    assert set(live) == set(RESULTS)
    assert set(replayed) == {*RESULTS, *FURTHER}
    assert len({_stamp(message) for message in replayed.values()}) == 1
    geometry = panorama_geometry(replayed['/pair_1/right/camera_info'])
    assert geometry.principal_angle == pytest.approx(np.arctan(40.5 / 261.6682), rel=1e-6)
    pair = [to_array(replayed[topic]) for topic in FURTHER[:2]]
    assert pair[0].shape == pair[1].shape == (geometry.rows, COLUMNS, 3)
    assert not np.array_equal(*pair)
    for topic in RESULTS:
        assert _stamp(replayed[topic]) == _stamp(live[topic])
        if topic == '/scan':
            ours, theirs = (np.array(m.ranges) for m in (live[topic], replayed[topic]))
        else:
            ours, theirs = to_array(live[topic]), to_array(replayed[topic])
        assert np.array_equal(ours, theirs, equal_nan=ours.dtype.kind == 'f'), topic


def _stamp(message):
    return message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id


def test_shared_memory_of_the_shipped_profile_holds_a_sweep():
    profile = ElementTree.parse(ROOT / 'config' / 'fastdds.xml').getroot()
    (size,) = (int(element.text) for element in profile.iter() if 'segment_size' in element.tag)
    colours, panoramas, columns, rows = 3, 3, 7000, 480
    assert size >= colours * panoramas * columns * rows


def test_demo_of_a_turning_arm_takes_ten_seconds_a_turn(tmp_path):
    output = tmp_path / 'spin'
    with started('panodepth_ros', 'demo', '--mode', 'spin', '--output', str(output)) as running:
        assert running.wait(200) == 0
    scan = json.loads((output / 'scan.json').read_text())
    assert 9.0 < scan['scan_time'] < 11.0
    assert scan['accuracy']['scan']['coverage'] > 0.9
    assert scan['accuracy']['scan']['within_5_percent'] > 0.8
    film = (output / 'ground_plan.gif').read_bytes()
    assert film.startswith(b'GIF89a')
    assert len(film) < 2**20


def test_demo_without_a_parameter_file_says_so(tmp_path):
    with started(
        'panodepth_ros', 'demo', '--params-file', str(tmp_path / 'none.yaml'), exit_code=1
    ) as running:
        assert running.wait() == 1
        assert 'none.yaml is not a file' in running.output


@pytest.mark.parametrize(
    ('when', 'number'),
    [
        ('starting the nodes', signal.SIGINT),
        ('10%', signal.SIGINT),
        ('10%', signal.SIGTERM),
        ('10%', signal.SIGHUP),
        ('comparing', signal.SIGINT),
    ],
)
def test_interrupted_demo_leaves_nothing_running(demo, tmp_path, when, number):
    _, parameters, _ = demo
    with started(
        *('panodepth_ros', 'demo', '--params-file', str(parameters)),
        *('--output', str(tmp_path / 'out')),
        exit_code=130,
    ) as running:
        running.wait_for_output(when, 100)
        ours = f'{tmp_path / "out"}'.encode(), b'panodepth_ros'
        assert running.stop(number) == 130
        assert 'Traceback' not in running.output
        assert 'interrupted' in running.output
    left = [
        path
        for path in Path('/proc').glob('[0-9]*/cmdline')
        if all(word in _content(path) for word in ours)
    ]
    assert left == []


def _content(path):
    try:
        return path.read_bytes()
    except OSError:  # the process has ended
        return b''


def test_demo_stays_away_from_the_robot_of_the_environment(ros, demo, monkeypatch, tmp_path):
    # A mosaicer in the domain of the environment would call this arm.
    _, parameters, _ = demo
    called = []
    node = ros.node()
    node.create_service(
        Trigger, 'arm_driver/step', lambda _, response: called.append(1) or response
    )
    with started(
        *('panodepth_ros', 'demo', '--params-file', str(parameters)),
        *('--output', str(tmp_path / 'out')),
        exit_code=130,
    ) as running:
        ros.spin_until(lambda: '10%' in running.output, 'the sweep', 100)
        running.stop()
    assert called == []


def test_demo_with_a_bad_parameter_shows_the_nodes_sentence(demo, tmp_path):
    _, parameters, _ = demo
    content = yaml.safe_load(parameters.read_text())
    content['/**/mosaicer']['ros__parameters']['column_step_deg'] = 0.7
    bad = tmp_path / 'bad.yaml'
    bad.write_text(yaml.safe_dump(content))
    with started(
        'panodepth_ros',
        'demo',
        '--params-file',
        str(bad),
        '--output',
        str(tmp_path / 'out'),
        exit_code=1,
    ) as running:
        assert running.wait(100) == 1
        assert 'column_step_deg is 0.7' in running.output
