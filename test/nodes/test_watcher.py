"""The running sweep over HTTP: a watcher beside a real mosaicer, asked on loopback."""

import http.client
import json
import math
import subprocess
import threading
import urllib.error
import urllib.request

import cv2
import numpy as np
import pytest
from fixtures.browser import browser
from fixtures.rig import MessageRig
from fixtures.ros import started
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, LaserScan
from std_srvs.srv import Trigger

from panodepth_ros.cli.watch_server import WatchServer
from panodepth_ros.mosaic import ContinuousAssembler
from panodepth_ros.nodes.mosaicer import Mosaicer
from panodepth_ros.nodes.watcher import Watcher
from panodepth_ros.ros.images import to_array, to_message

pytestmark = pytest.mark.ros

STEP_DEG, COLUMNS = 6.0, 60


class Bench:
    """A mosaicer, a rig, a watcher and its server."""

    def __init__(self, ros, **values):
        self.ros = ros
        values = {'column_step_deg': STEP_DEG, 'column_offset_px': 20.0, **values}
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.mosaicer = ros.add(Mosaicer(context=ros.context, parameter_overrides=overrides))
        step = math.radians(STEP_DEG) * values.get('stripe_columns', 1)
        self.rig = ros.add(MessageRig(step, context=ros.context))
        self.watcher = ros.add(Watcher(context=ros.context))
        server = WatchServer(self.watcher, '127.0.0.1', 0)
        self.watcher.at_the_end(server.close)
        self.url = server.url
        self.node = ros.node('listener')
        self.left = []
        self.node.create_subscription(Image, 'left/image', self.left.append, 10)
        self.clients = {
            name: self.node.create_client(Trigger, f'mosaicer/{name}')
            for name in ('start', 'cancel')
        }
        compressed = values.get('image_transport') == 'compressed'
        images = 'image_raw/compressed' if compressed else 'image_raw'
        ros.spin_until(
            lambda: (
                self.state() == 'waiting for a sweep'
                and all(client.service_is_ready() for client in self.clients.values())
                and not self.mosaicer._leader.missing_service
                and self.rig.count_subscribers(images) == 2
                and self.rig.count_subscribers('camera_info') == 2
                and self.rig.count_subscribers('joint_states') == 2
                and self.mosaicer.count_subscribers('left/image')
                and self.mosaicer.count_subscribers('mosaicer/progress')
            ),
            'the graph',
        )
        self.rig.camera_info()
        self.rig.standing()
        ros.spin_until(
            lambda: all(
                node._assembler.camera and node._assembler.track.newest
                for node in (self.mosaicer, self.watcher)
            ),
            'camera and arm',
        )

    def state(self):
        return self.watcher.status()['state']

    def call(self, service):
        answer = self.ros.result(self.clients[service].call_async(Trigger.Request()))
        assert answer.success, answer.message

    def steps(self, count):
        for _ in range(count):
            self.rig._on_step(None, Trigger.Response())
            self.ros.spin_until(
                lambda: self.watcher._assembler.track.newest >= self.rig.now, 'the joint states'
            )

    def turn(self, columns):
        for _ in self.rig.turn(columns):
            self.ros.spin_until(
                lambda: all(
                    node._assembler.track.newest >= self.rig.now
                    for node in (self.mosaicer, self.watcher)
                ),
                'the joint states',
            )

    def set(self, **values):
        client = self.node.create_client(SetParameters, 'mosaicer/set_parameters')
        self.ros.spin_until(client.service_is_ready, 'set_parameters')
        messages = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
        answer = self.ros.result(client.call_async(SetParameters.Request(parameters=messages)))
        assert answer.results[0].successful, answer.results[0].reason

    def send_results(self):
        depth = np.array([[0.5, 4.9, np.nan]], np.float32)
        scan = LaserScan(angle_min=-3.0, angle_increment=2.0, ranges=[1.5, math.nan, math.inf])
        messages = {'depth/image': to_message(depth, '32FC1'), 'scan': scan}
        for topic, message in messages.items():
            publisher = self.node.create_publisher(type(message), topic, 10)
            self.ros.spin_until(publisher.get_subscription_count, 'the watcher')
            publisher.publish(message)
        self.ros.spin_until(lambda: self.watcher.status()['results'] == 2, 'the results')

    def get(self, path):
        with urllib.request.urlopen(self.url + path, timeout=10) as answer:
            return answer.headers['Content-Type'], answer.read()

    def picture(self, name):
        kind, body = self.get(f'{name}.png')
        assert kind == 'image/png'
        return cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED)

    def status(self):
        """First event of a new stream."""
        connection = http.client.HTTPConnection(self.url.split('/')[2], timeout=10)
        connection.request('GET', '/events')
        answer = connection.getresponse()
        assert answer.getheader('Content-Type') == 'text/event-stream'
        line = answer.readline().decode()
        connection.close()
        assert line.startswith('data: ')
        return json.loads(line.removeprefix('data: '))


def test_led_sweep_is_shown_as_it_is_published(ros):
    bench = Bench(ros)
    bench.call('start')
    ros.spin_until(lambda: bench.left and bench.state() == 'the sweep is done', 'the sweep')
    assert np.array_equal(bench.picture('left'), to_array(bench.left[0]))
    status = bench.status()
    assert status['progress'] == 1.0
    assert ['columns', '60 of 60'] in status['facts']


def test_panoramas_grow_while_the_arm_turns(ros):
    bench = Bench(ros, lead=False)
    bench.steps(20)
    ros.spin_until(lambda: bench.state() == 'sweeping', 'the sweep')
    status = bench.status()
    assert 18 / COLUMNS <= status['progress'] <= 21 / COLUMNS
    pixels = bench.picture('center')
    lit = pixels.any(axis=(0, 2))
    assert lit.sum() == round(status['progress'] * COLUMNS)
    # The arm turns counter-clockwise, columns run clockwise: the newest is the leftmost.
    assert np.flatnonzero(lit)[0] == pytest.approx(status['arm'] * COLUMNS, abs=1.5)
    bench.steps(5)
    assert bench.picture('center').any(axis=(0, 2)).sum() == lit.sum() + 5
    assert bench.status()['sweep'] != status['sweep']


def test_compressed_frames_are_shown(ros):
    bench = Bench(ros, image_transport='compressed')
    bench.call('start')
    ros.spin_until(lambda: bench.left and bench.state() == 'the sweep is done', 'the sweep')
    assert np.array_equal(bench.picture('left'), to_array(bench.left[0]))


TURNING = {'motion': 'continuous', 'stripe_columns': 2, 'column_offset_px': 10.0}


def test_led_turn_stays_on_the_page_while_the_arm_brakes(ros):
    bench = Bench(ros, **TURNING)
    bench.call('start')
    ros.spin_until(lambda: bench.watcher._led and bench.rig.spins, 'the start')
    bench.turn(31)
    ros.spin_until(lambda: bench.left and bench.state() == 'the sweep is done', 'the sweep')
    bench.turn(3)
    assert bench.state() == 'the sweep is done'
    assert np.array_equal(bench.picture('left'), to_array(bench.left[0]))
    assert ['columns', '60 of 60'] in bench.status()['facts']
    bench.call('start')
    ros.spin_until(lambda: not bench.watcher._resting, 'the start')
    bench.turn(3)
    assert bench.state() == 'sweeping'


def test_parameters_set_while_it_watches_are_taken(ros):
    bench = Bench(ros, lead=False, **TURNING)
    bench.set(image_delay_ms=12.5, row_time_us=20.0, arm_radius=0.25)
    builder = bench.watcher._assembler
    ros.spin_until(lambda: builder.rig.arm_radius == 0.25, 'the parameters')
    assert builder is bench.watcher._assembler
    assert builder.image_delay == 12_500_000
    assert builder.row_time == pytest.approx(20e-6)


def test_lens_that_folds_is_told_and_no_frame_taken_until_it_is_mended(ros):
    bench = Bench(ros, lead=False)
    bench.steps(3)
    ros.spin_until(lambda: bench.state() == 'sweeping', 'the sweep')
    seen = bench.watcher._assembler.sweep.seen.sum()
    bench.rig.camera_info(k1=-5.0)
    ros.spin_until(lambda: 'folds inside of the image' in bench.state(), 'the fault')
    bench.rig.camera_info = lambda *_: None
    bench.steps(2)
    assert bench.state().startswith('camera_info: camera distortion (-5.0, ')
    del bench.rig.camera_info
    ros.spin_until(lambda: bench.rig.camera_info() or bench.state() == 'sweeping', 'the sweep')
    bench.steps(1)
    assert bench.watcher._assembler.sweep.seen.sum() == seen + 1


def test_another_mosaicer_is_followed_by_its_parameters(ros):
    bench = Bench(ros, lead=False)
    ros.executor.remove_node(bench.mosaicer)
    ros.nodes.remove(bench.mosaicer)
    bench.mosaicer.destroy_node()
    values = {'column_step_deg': STEP_DEG, **TURNING, 'image_transport': 'compressed'}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    another = ros.add(Mosaicer(context=ros.context, parameter_overrides=overrides))
    ros.spin_until(
        lambda: (
            not another._leader.missing_service
            and another.count_subscribers('mosaicer/progress')
            and bench.rig.count_subscribers('joint_states') == 2
            and bench.rig.count_subscribers('camera_info') == 2
            and bench.clients['start'].service_is_ready()
        ),
        'the graph',
    )
    bench.rig.camera_info()
    bench.rig.standing()
    ros.spin_until(
        lambda: another._assembler.camera and another._assembler.track.newest, 'camera and arm'
    )
    bench.call('start')
    ros.spin_until(
        lambda: isinstance(bench.watcher._assembler, ContinuousAssembler), 'the parameters'
    )
    ros.spin_until(lambda: not bench.rig.count_subscribers('image_raw'), 'the subscription')
    assert bench.rig.count_subscribers('image_raw/compressed') == 2


def test_cancelled_sweep_is_told_and_the_next_one_shown(ros):
    bench = Bench(ros)
    bench.rig.frames = False
    bench.call('start')
    bench.call('cancel')
    ros.spin_until(lambda: bench.state() == 'the sweep was given up', 'the end')
    bench.rig.frames = True
    bench.call('start')
    ros.spin_until(lambda: bench.left and bench.state() == 'the sweep is done', 'the sweep')
    assert np.array_equal(bench.picture('left'), to_array(bench.left[0]))


def test_depth_and_scan_are_shown_when_they_come(ros):
    bench = Bench(ros)
    assert json.loads(bench.get('scan.json')[1])['ranges'] == []
    bench.send_results()
    near, far, unknown = bench.picture('depth')[0].astype(int)
    assert near[2] > near[0]  # red
    assert far[0] > far[2]  # blue
    assert unknown.tolist() == [38, 38, 38]
    assert json.loads(bench.get('scan.json')[1])['ranges'] == [1.5, None, None]


@pytest.mark.parametrize('path', ['left.png', 'nothing', 'other.png', '../setup.py', 'events/x'])
def test_what_is_not_there_is_not_found(ros, path):
    bench = Bench(ros)
    with pytest.raises(urllib.error.HTTPError) as error:
        bench.get(path)
    with error.value:
        assert error.value.code == 404


def test_page_loads_nothing_from_elsewhere(ros):
    kind, body = Bench(ros).get('')
    assert kind == 'text/html; charset=utf-8'
    assert b'EventSource' in body
    assert b'://' not in body


def test_open_streams_end_with_the_server(ros):
    bench = Bench(ros)
    ended = threading.Event()

    def read():
        with urllib.request.urlopen(bench.url + 'events', timeout=30) as stream:
            stream.read()
        ended.set()

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    ros.spin_until(lambda: threading.active_count() > 3, 'the stream')
    bench.watcher.destroy_node()
    assert ended.wait(20)
    reader.join(20)


@pytest.mark.launch
def test_command_serves_a_namespace_and_ends_cleanly(ros):
    with started(
        'panodepth_ros', 'watch', '--port', '0', '--ros-args', '-r', '__ns:=/robot'
    ) as running:
        running.wait_for_output('look at http://127.0.0.1:')
        url = running.output.split('look at ')[1].split()[0]
        with urllib.request.urlopen(url, timeout=10) as answer:
            assert b'The running sweep' in answer.read()
        node = ros.node()
        ros.spin_until(lambda: node.count_subscribers('/robot/joint_states'), 'the watcher')
        port = url.rsplit(':', 1)[1].strip('/')
        with started('panodepth_ros', 'watch', '--port', port, exit_code=1) as second:
            assert second.wait() == 1
            assert f'cannot listen on 127.0.0.1:{port}: Address already in use' in second.output


@pytest.mark.launch
def test_browser_fetches_all_there_is_and_what_is_new(ros, tmp_path, monkeypatch):
    command = browser(tmp_path / 'profile')
    bench = Bench(ros, lead=False)
    asked = []
    picture, scan = bench.watcher.picture, bench.watcher.scan
    monkeypatch.setattr(bench.watcher, 'picture', lambda name: asked.append(name) or picture(name))
    monkeypatch.setattr(bench.watcher, 'scan', lambda: asked.append('scan') or scan())
    bench.steps(5)
    bench.send_results()
    # With a debugging port it stays until it is told to end.
    process = subprocess.Popen(
        [*command, '--remote-debugging-port=0', bench.url],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        everything = {'left', 'right', 'center', 'depth', 'scan'}
        ros.spin_until(lambda: everything <= set(asked), 'the requests of the browser', 60)
        before = asked.count('left')
        bench.steps(3)
        ros.spin_until(lambda: asked.count('left') > before, 'a request for the new columns')
    finally:
        process.terminate()
        process.wait(20)
