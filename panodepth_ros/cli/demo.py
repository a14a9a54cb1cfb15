"""``panodepth_ros demo``: a full turn of a simulated rig, from the motor to the scan."""

from __future__ import annotations

import argparse
import math
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

from panodepth_ros.cli.demo_report import film, report
from panodepth_ros.cli.domain import claimed_domain
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.outputs import check_folder
from panodepth_ros.cli.processes import ProcessError, Processes
from panodepth_ros.ros.messages import JointReading, joint_reading

#: Topics that make the bag of the run.
TOPICS = (
    'image_raw',
    'camera_info',
    'joint_states',
    'left/image',
    'left/camera_info',
    'right/image',
    'right/camera_info',
    'center/image',
    'center/camera_info',
    'depth/image',
    'depth/confidence',
    'depth/camera_info',
    'scan',
)
_RESULTS = {
    'left/image': Image,
    'left/camera_info': CameraInfo,
    'right/image': Image,
    'right/camera_info': CameraInfo,
    'depth/image': Image,
    'depth/confidence': Image,
    'scan': LaserScan,
}
#: What Fast DDS of Jazzy, and of Kilted and later, reads its profile from.
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
#: How the arm turns, and the parameters of that.
MODES = {'step': 'simulated.yaml', 'spin': 'simulated_spin.yaml'}
#: A slow machine compiles for minutes; a process that ends meanwhile is noticed at once [s].
_START_TIMEOUT = 300.0
_STALL_TIMEOUT = 30.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    parser.add_argument(
        '--params-file',
        type=Path,
        metavar='YAML',
        help='parameters of the four nodes (default: those of config/ for the mode)',
    )
    parser.add_argument(
        '--mode',
        choices=tuple(MODES),
        default='step',
        help='an arm that stops for every column, or one that turns steadily (%(default)s)',
    )
    parser.add_argument(
        '--output', type=Path, default=Path('demo_output'), help='folder to write (%(default)s)'
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the demo; return the exit code."""
    parameters = arguments.params_file or installed_config(MODES[arguments.mode])
    if not parameters.is_file():
        return failed('demo', f'{parameters} is not a file')
    output: Path = arguments.output
    try:
        check_folder(output)
    except OSError as error:
        return failed('demo', error)
    output.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(output / 'bag', ignore_errors=True)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)
    try:
        with claimed_domain() as domain, tempfile.TemporaryDirectory() as scratch:
            # Whatever robot the environment belongs to is none of the demo's business.
            os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            os.environ['ROS_LOG_DIR'] = str(Path(scratch, 'ros_log'))
            for name in PROFILE_VARIABLES:
                os.environ.setdefault(name, str(installed_config('fastdds.xml')))
            sweep = _sweep(parameters.resolve(), output, Path(scratch))
        report(
            sweep.results,
            output,
            room_seed=sweep.parameters['room_seed'],
            band=(sweep.parameters['min_height'], sweep.parameters['max_height']),
        )
        if arguments.mode == 'spin':
            film(sweep.results, sweep.arm, output, room_seed=sweep.parameters['room_seed'])
    except ProcessError as error:
        print(file=sys.stderr)
        return failed('demo', error)
    return 0


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """End the demo once; let nothing disturb the end of its processes."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def installed_config(name: str) -> Path:
    """Return a shipped parameter file: of the source tree, or of the installation."""
    here = Path(__file__).resolve()
    source_tree = here.parents[2] / 'config' / name
    if source_tree.is_file():
        return source_tree
    for prefix in (*here.parents, Path(sys.prefix)):
        installed = prefix / 'share' / 'panodepth_ros' / 'config' / name
        if installed.is_file():
            return installed
    return source_tree


def _sweep(parameters: Path, output: Path, scratch: Path) -> _Sweep:
    """Run the graph for one sweep and return what came of it."""
    logs = output / 'log'
    logs.mkdir(exist_ok=True)
    processes = Processes(logs)
    link = str(scratch / 'arm')
    ros_arguments = ['--ros-args', '--params-file', str(parameters)]
    try:
        # Begun first it ends last: a result may be on its way to it when this process has it.
        processes.start(
            'record',
            'panodepth_ros.cli.main',
            ['record', '--output', str(output / 'bag'), *(f'/{topic}' for topic in TOPICS)],
        )
        processes.start('simulated_arm', 'panodepth_ros.cli.simulated_arm', ['--link', link])
        _wait(Path(link).exists, processes, 'the simulated arm')
        for node, own in (
            ('arm_driver', ['-p', f'port:={link}']),
            ('camera', ['-p', f'simulated_arm_truth:={link}.truth']),
            ('mosaicer', []),
            ('depth', []),
        ):
            processes.start(node, f'panodepth_ros.nodes.{node}', [*ros_arguments, *own])
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            sweep = _Sweep(processes)
            sweep.run()
        finally:
            rclpy.try_shutdown()
    except BaseException:
        with suppress(ProcessError):  # what matters is on its way up already
            processes.stop()
        raise
    processes.stop()
    return sweep


def _wait(condition: Callable[[], Any], processes: Processes, what: str) -> None:
    """Wait for something outside of ROS."""
    deadline = time.monotonic() + _START_TIMEOUT
    while not condition():
        processes.check()
        if time.monotonic() > deadline:
            raise ProcessError(f'{what} did not come within {_START_TIMEOUT:g} s')
        time.sleep(0.02)


class _Sweep:
    """
    One sweep as a client of the graph sees it.

    Attributes
    ----------
    results : dict
        The last message of each topic of a result.
    parameters : dict
        What the report needs to know of the nodes' parameters.
    arm : list of JointReading
        Where the arm was.
    """

    def __init__(self, processes: Processes) -> None:
        self.results: dict[str, Any] = {}
        self.parameters: dict[str, Any] = {}
        self.arm: list[JointReading] = []
        self._processes = processes
        self._node: Node = rclpy.create_node('demo')
        self._progress = 0.0
        for topic, kind in _RESULTS.items():
            self._node.create_subscription(
                kind, topic, lambda message, topic=topic: self.results.update({topic: message}), 10
            )
        self._node.create_subscription(Float32, 'mosaicer/progress', self._on_progress, 100)
        self._node.create_subscription(JointState, 'joint_states', self._on_joint_state, 100)

    def _on_joint_state(self, message: JointState) -> None:
        reading = joint_reading(message, self.parameters.get('joint_name', ''))
        if reading is not None:
            self.arm.append(reading)

    def _on_progress(self, message: Float32) -> None:
        self._progress = message.data

    def run(self) -> None:
        """
        Start the sweep, show its progress, collect the results.

        Raises
        ------
        ProcessError
            If the graph does not come up, a process ends or the sweep is given up.
        """
        print('starting the nodes; the first time they compile, for half a minute', flush=True)
        # The recorder listens to all of these, this node to the results, the graph to the rest.
        listeners = {'image_raw': 2, 'joint_states': 3, 'left/image': 3, 'scan': 2}
        self._until(
            lambda: all(self._node.count_subscribers(name) >= n for name, n in listeners.items()),
            'the graph',
        )
        self._ask_parameters('arm_driver', ['joint_name'])
        self._ask_parameters('camera', ['room_seed'])
        self._ask_parameters('depth', ['min_height', 'max_height'])
        self._start()
        began = time.monotonic()
        shown, moved = -1.0, began
        while len(self.results) < len(_RESULTS):
            self._spin()
            now = time.monotonic()
            if math.isnan(self._progress):
                said = self._processes.output('mosaicer')
                raise ProcessError(f'the mosaicer gave the sweep up:\n{said}')
            if self._progress > shown:
                _show_progress(shown, self._progress, now - began)
                shown, moved = self._progress, now
            elif now - moved > _STALL_TIMEOUT:
                raise ProcessError(f'nothing came for {_STALL_TIMEOUT:g} s; the logs say why')
        print(f'\nsweep, matching and scan took {time.monotonic() - began:.1f} s', flush=True)

    def _start(self) -> None:
        client = self._node.create_client(Trigger, 'mosaicer/start')
        self._until(client.service_is_ready, 'the service mosaicer/start')
        deadline = time.monotonic() + _START_TIMEOUT
        while not (answer := self._call(client, Trigger.Request())).success:
            if time.monotonic() > deadline:
                raise ProcessError(f'the mosaicer does not start: {answer.message}')
            self._spin()

    def _ask_parameters(self, node: str, names: list[str]) -> None:
        client = self._node.create_client(GetParameters, f'{node}/get_parameters')
        self._until(client.service_is_ready, f'the parameters of {node}')
        values = self._call(client, GetParameters.Request(names=names)).values
        found = (parameter_value_to_python(value) for value in values)
        self.parameters.update(zip(names, found, strict=True))

    def _call(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        self._until(future.done, f'the answer of {client.srv_name}')
        return future.result()

    def _until(self, condition: Callable[[], Any], what: str) -> None:
        deadline = time.monotonic() + _START_TIMEOUT
        while not condition():
            if time.monotonic() > deadline:
                raise ProcessError(f'{what} did not come within {_START_TIMEOUT:g} s')
            self._spin()

    def _spin(self) -> None:
        self._processes.check()
        rclpy.spin_once(self._node, timeout_sec=0.05)


def _show_progress(before: float, share: float, elapsed: float) -> None:
    """Print a bar with the time left; on a pipe, a line each tenth."""
    left = f'{elapsed / share * (1 - share):4.0f} s left' if share > 0 else ''
    width = 40
    bar = '█' * round(share * width) + '░' * (width - round(share * width))
    if sys.stdout.isatty():
        print(f'\r{bar} {share:4.0%} {left} ', end='', flush=True)
    elif math.floor(share * 10) > math.floor(before * 10):
        print(f'{bar} {share:4.0%} {left}', flush=True)
