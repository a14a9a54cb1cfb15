"""The tutorials' commands, one after the other in an empty folder, as a reader types them."""

import os
import re
import shlex
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from documents import ROOT, commands
from fixtures.ros import Program
from std_srvs.srv import Trigger
from test_commands import not_run

from panodepth_ros.bag import read
from panodepth_ros.camera.calibration import Calibration, write_calibration
from panodepth_ros.geometry import PinholeCamera

pytestmark = [pytest.mark.ros, pytest.mark.launch, pytest.mark.timeout(300)]
TUTORIALS = ROOT / 'docs' / 'tutorials'
#: What a program says when it is ready for what comes next.
READY = {
    'arm_driver': 'is ready',
    'camera': 'delivers',
    'depth': 'ready',
    'mosaicer': 'ready',
    'python': 'ready',
    'simulated_arm': 'my_arm',
}


class Terminal:
    """Runs commands; those with an & until the end of the block that it is used in."""

    def __init__(self, ros, folder):
        self.ros = ros
        self.folder = folder
        self.jobs: dict[str, Program] = {}

    def type(self, command, *more):
        """Run a command; one without an & to its end, which must be good."""
        words = shlex.split(os.path.expandvars(command.removesuffix(' &'))) + list(more)
        if words[:3] == ['ros2', 'service', 'call']:
            self._call(words[3])
            return ''
        folder = self.folder / f'output_{len(list(self.folder.iterdir()))}'
        folder.mkdir()
        program = Program(words, str(folder))
        if not command.endswith(' &'):
            assert program.wait(200) == 0, program.output
            return program.output
        name = words[1] if words[0] == 'panodepth_ros' else words[0]
        self.jobs[name] = program
        if name == 'record':
            self.ros.spin_until_recorded(word for word in words if word.startswith('/'))
        elif name == 'check_scan':
            node = self.ros.node('waits')
            self.ros.spin_until(lambda: node.count_subscribers('scan'), 'check_scan')
        else:
            program.wait_for_output(READY[name], 100)
        return ''

    def _call(self, service):
        client = self.ros.node('caller').create_client(Trigger, service)
        self.ros.spin_until(client.service_is_ready, service)
        answers = []
        self.ros.spin_until(lambda: self._answered(client, answers), f'a good answer of {service}')

    def _answered(self, client, answers):
        answer = self.ros.result(client.call_async(Trigger.Request()))
        answers.append(answer.message)
        return answer.success

    def kill(self):
        """End all jobs, newest first."""
        codes = {name: job.stop() for name, job in reversed(self.jobs.items()) if job.running()}
        self.jobs.clear()
        assert not any(codes.values()), codes


@pytest.fixture
def terminal(ros, tmp_path, monkeypatch):
    """A terminal in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('PWD', str(tmp_path))
    monkeypatch.setenv('PATH', f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}')
    terminal = Terminal(ros, tmp_path)
    try:
        yield terminal
    finally:
        for job in terminal.jobs.values():
            job.close()
            sys.stderr.write(f'--- output of {job}\n{job.output}\n')


def typed(tutorial):
    """The commands of a tutorial that run here."""
    path = TUTORIALS / tutorial
    lines = re.findall(r'^ *\$ (.*)$', path.read_text(), re.MULTILINE)
    assert [line for line in lines if line not in commands(path)] == []
    return [line for line in lines if not not_run(path, line)]


def test_replay_a_bag(terminal, demo, tmp_path):
    output, parameters, _ = demo
    (tmp_path / 'demo_output').symlink_to(output)
    lines = typed('replay_a_bag.md')
    assert len(lines) == 4
    for line in lines:
        coarse = ['--params-file', str(parameters)] if line.startswith('mosaicer') else []
        terminal.type(line, *coarse)
    terminal.jobs['depth'].wait_for_output('beams hold a distance', 200)
    terminal.kill()
    scans = [message for topic, _, message in read(tmp_path / 'replayed') if topic == '/scan']
    assert [len(scan.ranges) for scan in scans] == [360]


def test_own_arm(terminal, tmp_path):
    shutil.copy(TUTORIALS / 'own_arm.py', tmp_path)
    *lines, look = typed('own_arm.md')
    assert len(lines) == 6
    for line in lines:
        terminal.type(line)
    terminal.jobs['depth'].wait_for_output('beams hold a distance', 200)
    mosaicer = terminal.jobs['mosaicer']
    terminal.kill()
    assert 'sweep of 90 columns done' in mosaicer.output, mosaicer.output
    points = int(terminal.type(look).split()[-2])
    # 90 columns of 120 pixels, without those at both ends that one eye alone saw.
    assert points > 0.4 * 90 * 120


def test_own_camera(terminal, tmp_path):
    code = cv2.VideoWriter_fourcc(*'FFV1')
    video = cv2.VideoWriter(str(tmp_path / 'my_video.mkv'), code, 50.0, (64, 48))
    for level in range(10):
        video.write(np.full((48, 64, 3), 20 * level, np.uint8))
    video.release()
    pinhole = PinholeCamera(width=64, height=48, fx=80.0, fy=80.0, cx=31.5, cy=23.5)
    write_calibration(Calibration.of_pinhole(pinhole, ''), tmp_path / 'camera.yaml')
    first, second, other = typed('own_camera.md')
    said = terminal.type(first)
    assert 'delivers 64 by 48 pixels' in said
    assert 'uncalibrated' in said
    assert 'uncalibrated' not in terminal.type(second)
    terminal.type(other)
    node = terminal.ros.node()
    terminal.ros.spin_until(
        lambda: node.count_subscribers('/my_camera/image_raw') == 1, 'the remapped topic'
    )
    terminal.kill()


def test_nav2(terminal):
    lines = typed('nav2.md')
    assert len(lines) == 7
    for line in lines:
        terminal.type(line)
    check = terminal.jobs['check_scan']
    assert check.wait(200) == 0, check.output
    assert 'PASS' in check.output
    assert 'FAIL' not in check.output
    terminal.kill()
