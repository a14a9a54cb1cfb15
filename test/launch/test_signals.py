"""SIGINT and SIGTERM of every node at any time: exit code 0, no traceback."""

import signal
import subprocess
import sys

import pytest
from fixtures.ros import Program, program

pytestmark = [pytest.mark.ros, pytest.mark.launch]

READY = {'mosaicer': 'ready', 'depth': 'ready'}


@pytest.fixture
def node(ros_domain, tmp_path):
    running = []

    def start(name, *arguments):
        running.append(Program([*program(name), *arguments], str(tmp_path)))
        return running[-1]

    yield start
    for started in running:
        if started.running():
            started.process.kill()
            started.process.wait()


def assert_clean(running, code=0):
    assert running.wait() == code, running.output
    assert 'Traceback' not in running.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('name', READY)
def test_signal_ends_the_running_node(node, name, number):
    running = node(name)
    running.wait_for_output(READY[name])
    running.process.send_signal(number)
    assert_clean(running)


#: A signal comes while a thread that cannot be interrupted compiles.
COMPILING = """
import os, signal, sys, threading
from concurrent.futures import ThreadPoolExecutor
from panodepth_ros.nodes import depth
def compile():
    os.kill(os.getpid(), signal.SIGINT)
    threading.Event().wait()
def prepare(method):
    with ThreadPoolExecutor(1) as pool:
        pool.submit(compile)
depth.prepare = prepare
sys.exit(depth.main())
"""


def test_signal_ends_the_compilation_of_kernels(ros_domain):
    words = [sys.executable, '-c', COMPILING]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


@pytest.mark.parametrize('name', READY)
def test_further_signals_do_not_disturb_the_end(node, name):
    # `ros2 launch` and the terminal both pass Ctrl-C on.
    running = node(name)
    running.wait_for_output(READY[name])
    while running.running():
        running.process.send_signal(signal.SIGINT)
    assert_clean(running)


@pytest.mark.parametrize('name', READY)
def test_bad_parameter_is_one_sentence_and_exit_code_1(node, name):
    running = node(name, '--ros-args', '-p', 'unheard_of:=1')
    assert_clean(running, code=1)
    assert f'unknown parameter unheard_of for {name}' in running.output
    assert len(running.output.strip().splitlines()) == 1


def test_words_that_are_no_ros_arguments_are_refused(node):
    running = node('mosaicer', '-p', 'lead:=false')
    assert_clean(running, code=2)
    assert "mosaicer: '-p' is no ROS argument; usage: mosaicer --ros-args" in running.output


def test_help_is_given(node):
    running = node('depth', '--help')
    assert_clean(running)
    assert running.output.startswith('usage: depth --ros-args')


def test_bad_ros_argument_is_one_sentence_and_exit_code_1(node):
    running = node('mosaicer', '--ros-args', '--no-such-thing')
    assert_clean(running, code=1)
    assert 'no-such-thing' in running.output
