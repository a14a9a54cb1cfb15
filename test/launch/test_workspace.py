"""The package as a robot has it: built by colcon, its installed executables started."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from fixtures.arm import wait_until
from fixtures.ros import Program, started
from std_srvs.srv import Trigger

pytestmark = [pytest.mark.ros, pytest.mark.launch, pytest.mark.timeout(300)]
ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
NODES = ('arm_driver', 'camera', 'mosaicer', 'depth')


def colcon(workspace, *arguments, **change):
    environment = {**os.environ, 'PATH': f'{BIN}{os.pathsep}{os.environ["PATH"]}', **change}
    return subprocess.run(
        [str(BIN / 'colcon'), '--log-base', 'log', *arguments],
        cwd=workspace,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Build a workspace of a copy of the sources, as a clone has them."""
    directory = tmp_path_factory.mktemp('workspace')
    source = directory / 'src' / 'panodepth_ros'
    shutil.copytree(
        ROOT,
        source,
        ignore=shutil.ignore_patterns(
            '.*', 'build', 'install', 'log', 'demo_output', '__pycache__'
        ),
    )
    built = colcon(directory, 'build')
    assert built.returncode == 0, built.stdout + built.stderr
    return directory


@pytest.fixture
def installed(workspace, monkeypatch):
    """Folder of the installed executables, and the environment of ``setup.bash``."""
    prefix = workspace / 'install' / 'panodepth_ros'
    (site_packages,) = prefix.glob('lib/python3*/site-packages')
    paths = [str(site_packages), *filter(None, [os.environ.get('PYTHONPATH')])]
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(paths))
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(prefix))
    monkeypatch.setenv('PATH', f'{BIN}{os.pathsep}{os.environ["PATH"]}')
    return prefix / 'lib' / 'panodepth_ros'


def test_every_executable_is_installed_where_ros2_run_looks(installed):
    assert {path.name for path in installed.iterdir()} == {
        *NODES,
        'simulated_arm',
        'calibrator',
        'views',
        'check_scan',
        'panodepth_ros',
    }


def test_configuration_and_launch_file_are_installed(workspace):
    share = workspace / 'install' / 'panodepth_ros' / 'share' / 'panodepth_ros'
    assert {path.name for path in (ROOT / 'config').iterdir()} == {
        path.name for path in (share / 'config').iterdir()
    }
    assert (share / 'launch' / 'panodepth.launch.py').is_file()
    assert (share / 'package.xml').is_file()
    index = share.parent / 'ament_index' / 'resource_index' / 'packages' / 'panodepth_ros'
    assert index.is_file()


def test_installed_nodes_answer(ros, installed, tmp_path):
    link = str(tmp_path / 'arm')
    parameters = str(
        installed.parents[1] / 'share' / 'panodepth_ros' / 'config' / 'simulated.yaml'
    )
    files = ['--ros-args', '--params-file', parameters]
    node = ros.node()
    with started(str(installed / 'simulated_arm'), '--link', link) as arm:
        arm.wait_for_output('simulated arm on')
        own = {
            'arm_driver': ['-p', f'port:={link}'],
            'camera': ['-p', f'simulated_arm_truth:={link}.truth'],
        }
        services = {
            'arm_driver': 'arm_driver/stop',
            'camera': 'camera/get_parameters',
            'mosaicer': 'mosaicer/start',
            'depth': 'depth/get_parameters',
        }
        for name in NODES:
            with started(str(installed / name), *files, *own.get(name, [])):
                ros.spin_until(
                    lambda name=name: (
                        services[name]
                        in [
                            service.lstrip('/')
                            for service, _ in node.get_service_names_and_types()
                        ]
                    ),
                    f'the service {services[name]}',
                )
                if name == 'mosaicer':
                    client = node.create_client(Trigger, 'mosaicer/start')
                    ros.spin_until(client.service_is_ready, 'mosaicer/start')
                    answer = ros.result(client.call_async(Trigger.Request()))
                    assert 'no camera_info' in answer.message


LAUNCH = """
import sys
from launch import LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource

service = LaunchService()
file, parameters = sys.argv[1:]
arguments = {'simulated': 'false', 'params_file': parameters}.items()
service.include_launch_description(
    IncludeLaunchDescription(AnyLaunchDescriptionSource(file), launch_arguments=arguments)
)
sys.exit(service.run())
"""


def test_launch_file_starts_a_killed_node_again_but_none_that_ends_by_itself(
    ros_domain, installed, tmp_path
):
    pytest.importorskip('launch_ros', reason='needs ROS 2 launch, which PyPI does not have')
    share = installed.parents[1] / 'share' / 'panodepth_ros'
    parameters = tmp_path / 'parameters.yaml'
    port = tmp_path / 'no_such_port'
    parameters.write_text(f"/arm_driver: {{ros__parameters: {{port: '{port}'}}}}\n")
    command = [sys.executable, '-c', LAUNCH, str(share / 'launch' / 'panodepth.launch.py')]
    graph = Program([*command, str(parameters)], str(tmp_path))
    try:
        for times in (1, 2):
            wait_until(
                lambda times=times: graph.output.count('[mosaicer]: ready') == times,
                'readiness',
                60.0,
            )
            pids = re.findall(
                r'\[mosaicer-\d+\]: process started with pid \[(\d+)\]', graph.output
            )
            assert len(pids) == times
            if times == 1:
                wait_until(
                    lambda: '[arm_driver-1]: process has died' in graph.output, 'the end', 60.0
                )
                os.kill(int(pids[0]), signal.SIGKILL)
        assert re.findall(r'\[arm_driver-\d+\]: process started', graph.output) == [
            '[arm_driver-1]: process started'
        ]
        assert graph.stop(timeout=60.0) == 0
    finally:
        graph.close()


def test_colcon_test_runs_the_tests(workspace):
    # The file has more tests than one; a runner that found none would end with 0 as well.
    ran = colcon(
        workspace,
        'test',
        '--event-handlers',
        'console_direct+',
        '--pytest-args',
        'test/geometry/test_equations.py',
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    passed = re.search(r'(\d+) passed', ran.stdout)
    assert passed, ran.stdout + ran.stderr
    assert int(passed[1]) >= 10
