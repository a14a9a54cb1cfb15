"""Nodes killed in the middle of a sweep: the sweep goes on by itself and is true."""

import os
import signal
from unittest.mock import patch

import pytest

from benchmarks.faults.graph import Graph
from benchmarks.faults.judge import Judge

pytestmark = [pytest.mark.ros, pytest.mark.launch, pytest.mark.timeout(180)]


@pytest.fixture(scope='module')
def judge():
    return Judge(0)


@pytest.fixture
def graph(ros_domain, tmp_path, judge, v4l2_library):
    with patch.dict(os.environ):  # the graph sets what its nodes and its client need
        graph = Graph(tmp_path, ros_domain, judge.look)
        try:
            yield graph
        finally:
            graph.close()


def wait(graph, condition, what):
    came = graph.until(condition, 60.0)
    said = '\n'.join(graph.log(name) for name in ('mosaicer', 'depth'))
    assert came, f'{what} did not come; {said}'


def test_sweep_survives_the_death_of_each_node(graph, judge):
    wait(graph, lambda: 'ready' in graph.log('depth'), 'the depth node')
    assert graph.begin_sweep(60.0) == ''
    for share, name in ((0.2, 'arm_driver'), (0.4, 'mosaicer'), (0.6, 'camera')):
        wait(graph, lambda share=share: graph.share > share, f'{share:.0%} of the sweep')
        graph.kill(name)
    wait(graph, lambda: graph.share > 0.7, '70% of the sweep')
    graph.camera.unplug()
    wait(graph, lambda: 'trying to open it again' in graph.log('camera'), 'the loss of the camera')
    graph.camera.plug_in()
    wait(graph, lambda: graph.share > 0.8, '80% of the sweep')
    graph.signal('depth', signal.SIGSTOP)  # it takes nothing more, and does not come back
    wait(graph, lambda: graph.share == 1.0, 'the panoramas')
    graph.kill('depth')
    wait(graph, lambda: graph.scans, 'the scan')
    result = graph.scans[0]
    for eye in ('left', 'right'):
        wrong, unknown = judge.wrong_columns(
            result[f'{eye}/image'], result[f'{eye}/camera_info'], in_any_light=False
        )
        assert (wrong, unknown) == (0, 0)
    assert judge.scan_error(result['scan']) < 0.15
    said = graph.log('mosaicer')
    assert 'heard of again by a new driver' in said
    assert 'the sweep resumes at frame' in said
    assert 'the mosaicer was restarted: the sweep under way goes on' in said
    assert not (graph.folder / 'sweep').exists()


def test_driver_that_comes_back_with_another_count_ends_the_sweep(graph):
    assert graph.begin_sweep(60.0) == ''
    wait(graph, lambda: graph.share > 0.3, '30% of the sweep')
    graph.kill('arm_driver')
    graph.arm.do(lambda controller, now: controller.power_up(now))
    wait(graph, lambda: graph.given_up, 'the end of the sweep')
    reason = 'heard of again at 0.00°; allowed:'
    wait(graph, lambda: reason in graph.log('mosaicer'), 'the reason')
    assert graph.scans == []
