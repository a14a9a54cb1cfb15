"""The node graph as processes that may be killed, and what a campaign sees and disturbs."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import rclpy
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, LaserScan
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

from benchmarks.faults.arm import MAX_RATE, FaultyArm
from benchmarks.faults.camera import FaultyCamera
from panodepth_ros.arm.truth import truth_path
from panodepth_ros.camera.simulated import RoomCamera
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_bgr_or_mono

#: The rig: few columns and small frames, so that a sweep takes seconds.
STEP_DEG, COLUMNS, WIDTH, HEIGHT, FOV_DEG = 5.0, 72, 64, 48, 70.0
ARM_RADIUS, COLUMN_OFFSET, BEAMS = 0.5, 28.0, 90
NODES = ('arm_driver', 'camera', 'mosaicer', 'depth')
#: Time after which a node that died is started again, as by the launch file [s].
RESPAWN_DELAY = 1.0
_ROOT = Path(__file__).resolve().parents[2]
_PROFILES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')

#: Parameters of the nodes.
OWN: dict[str, dict[str, object]] = {
    'arm_driver': {
        'step_deg': STEP_DEG,
        'speed_deg_s': MAX_RATE,
        'settle_time': 0.0,
        'status_rate': 50.0,
        'response_timeout': 1.0,
    },
    'camera': {},
    'mosaicer': {
        'arm_radius': ARM_RADIUS,
        'column_offset_px': COLUMN_OFFSET,
        'column_step_deg': STEP_DEG,
        'frame_timeout': 1.0,
        'closure': 'refuse',
        'closure_tolerance_deg': 0.5,
    },
    'depth': {'beams': BEAMS, 'threads': 1, 'range_min': ARM_RADIUS, 'min_support': 2.0},
}
#: Defaults that are set back.
DEFAULTS = {'sweep_deg': 360.0}
_RESULTS = {
    'left/image': Image,
    'left/camera_info': CameraInfo,
    'right/image': Image,
    'right/camera_info': CameraInfo,
    'scan': LaserScan,
}


class Graph:
    """
    Arm, four nodes and a client of theirs, in a domain of their own.

    The camera's frames pass through this process (:class:`FaultyCamera`, :attr:`spoil_frame`,
    :attr:`spoil_info` and, of a graph that compresses them, :attr:`spoil_file`), the bytes of the
    controller, too (:class:`FaultyArm`).

    Parameters
    ----------
    folder : Path
        For links, logs and states.
    domain : int
        ROS domain.
    look : callable
        What the camera sees from an arm azimuth [rad], shape (H, W, 3).
    seed : int
        Of the camera's noise.
    compresses : bool
        Whether the mosaicer is given the frames as PNG files.
    """

    def __init__(
        self,
        folder: Path,
        domain: int,
        look: Callable[[float], npt.NDArray[np.uint8]],
        seed: int = 0,
        *,
        compresses: bool = False,
    ) -> None:
        self.folder = folder
        self.link = folder / 'arm'
        self.arm = FaultyArm(self.link)
        lens = RoomCamera.from_field_of_view(WIDTH, HEIGHT, math.radians(FOV_DEG))
        self.camera = FaultyCamera(folder, lens, look, truth_path(self.link), seed)
        self.compresses = compresses
        self.results: dict[int, dict[str, Any]] = {}
        self.progress: list[float] = []
        self._begun = 0  # when the sweep did [ns]
        self.spoil_frame: Callable[[Image], list[Image]]
        self.spoil_file: Callable[[bytes], bytes]
        self.spoil_info: Callable[[CameraInfo], CameraInfo]
        self._pass_all()
        self._environment = {
            **os.environ,
            'ROS_DOMAIN_ID': str(domain),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_LOG_DIR': str(folder / 'ros_log'),
            'PYTHONPATH': str(_ROOT),
            **dict.fromkeys(_PROFILES, str(_ROOT / 'config' / 'fastdds.xml')),
        }
        os.environ.update(self._environment)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._respawn_at: dict[str, float] = {}
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=domain)
        self._executor = SingleThreadedExecutor(context=self._context)
        self.node = Node('campaign', context=self._context)
        self._executor.add_node(self.node)
        self._relay()
        for topic, kind in _RESULTS.items():
            self.node.create_subscription(
                kind, topic, lambda message, topic=topic: self._on_result(topic, message), 20
            )
        self.node.create_subscription(
            Float32, 'mosaicer/progress', lambda message: self.progress.append(message.data), 100
        )
        self._clients = {
            name: self.node.create_client(Trigger, name)
            for name in ('mosaicer/start', 'mosaicer/cancel', 'arm_driver/stop', 'arm_driver/home')
        }
        self._parameter_client = self.node.create_client(SetParameters, 'mosaicer/set_parameters')
        self._changed: dict[tuple[str, str], Parameter[Any]] = {}
        self._odometry = self.node.create_publisher(Odometry, 'odom', 10)
        self._joint_states = 0
        self.node.create_subscription(JointState, 'joint_states', self._on_joint_state, 10)
        for name in NODES:
            self.start(name)

    # --- processes ----------------------------------------------------------------------------

    def start(self, name: str) -> None:
        """Start a node."""
        own = dict(OWN[name])
        if name == 'arm_driver':
            own['port'] = self.link
        elif name == 'camera':
            own |= self.camera.parameters
        elif name == 'mosaicer':
            own['state_file'] = self.folder / 'sweep'
            own['image_transport'] = 'compressed' if self.compresses else 'raw'
        words = [word for item in own.items() for word in ('-p', '{}:={}'.format(*item))]
        if name == 'camera':
            for topic in ('image_raw', 'camera_info'):
                words += ['-r', f'{topic}:=source/{topic}']
        code = (
            f'import sys; from benchmarks.faults.lifetime import die_with_parent; '
            f'die_with_parent({signal.SIGKILL:d}); '
            f'from panodepth_ros.start import {name}; sys.exit({name}())'
        )
        with (self.folder / f'{name}.log').open('ab') as log:
            self._processes[name] = subprocess.Popen(
                [sys.executable, '-c', code, '--ros-args', *words],
                env=self._environment | (self.camera.environment if name == 'camera' else {}),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a node."""
        self._processes[name].send_signal(number)

    def kill(self, name: str) -> None:
        """Kill a node; it is started again as the launch file does."""
        self.signal(name, signal.SIGKILL)
        self._processes[name].wait()

    def log(self, name: str) -> str:
        """All that a node has printed, over all its lives."""
        return (self.folder / f'{name}.log').read_text(errors='replace')

    def spin(self, seconds: float = 0.02) -> None:
        """Let messages pass for a moment, and start again what has died."""
        self._executor.spin_once(timeout_sec=seconds)
        for name, process in self._processes.items():
            if process.poll() is None:
                continue
            at = self._respawn_at.setdefault(name, time.monotonic() + RESPAWN_DELAY)
            if time.monotonic() > at:
                del self._respawn_at[name]
                self.start(name)
                return

    def until(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Spin until a condition holds; return whether it came in time [s]."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin()
        return True

    def wait(self, seconds: float) -> None:
        """Spin for a time."""
        self.until(lambda: False, seconds)

    def close(self) -> None:
        """End everything."""
        for process in self._processes.values():
            process.send_signal(signal.SIGCONT)
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self.arm.unplug()
        self.camera.close()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    # --- messages -----------------------------------------------------------------------------

    def _pass_all(self) -> None:
        """Let frames and calibrations pass as they are."""
        self.spoil_frame = lambda image: [image]
        self.spoil_file = lambda data: data
        self.spoil_info = lambda info: info

    def _relay(self) -> None:
        images = self.node.create_publisher(Image, 'image_raw', qos.IMAGES)
        files = self.node.create_publisher(CompressedImage, 'image_raw/compressed', qos.IMAGES)
        infos = self.node.create_publisher(CameraInfo, 'camera_info', qos.IMAGES)

        def on_image(message: Image) -> None:
            for image in self.spoil_frame(message) if self.camera.expose(message) else []:
                if self.compresses:
                    data = cv2.imencode('.png', to_bgr_or_mono(image))[1].tobytes()
                    files.publish(
                        CompressedImage(
                            header=image.header,
                            format='bgr8; png compressed bgr8',
                            data=self.spoil_file(data),
                        )
                    )
                else:
                    images.publish(image)

        self.node.create_subscription(Image, 'source/image_raw', on_image, qos.IMAGES)
        self.node.create_subscription(
            CameraInfo,
            'source/camera_info',
            lambda info: infos.publish(self.spoil_info(info)),
            qos.IMAGES,
        )

    def _on_joint_state(self, _: JointState) -> None:
        self._joint_states += 1

    def _on_result(self, topic: str, message: Any) -> None:
        stamp = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.results.setdefault(stamp, {})[topic] = message

    def call(self, service: str, timeout: float = 10.0) -> Trigger.Response:
        """Call a service; a call that is not answered gives a response without success."""
        client = self._clients[service]
        if not self.until(client.service_is_ready, timeout):
            return Trigger.Response(message=f'{service} is not there')
        future = client.call_async(Trigger.Request())
        if not self.until(future.done, timeout):
            return Trigger.Response(message=f'{service} does not answer')
        response: Trigger.Response = future.result()
        return response

    def set_parameter(self, node: str, parameter: Parameter[Any]) -> None:
        """Set a live parameter of a node until :meth:`restore`."""
        if self._set_parameter(node, parameter):
            old = OWN[node].get(parameter.name, DEFAULTS.get(parameter.name))
            self._changed[node, parameter.name] = Parameter(parameter.name, value=old)

    def restore(self) -> None:
        """Set back the parameters that were set, and let all frames pass."""
        self._pass_all()
        for (node, _), parameter in self._changed.items():
            self._set_parameter(node, parameter)
        self._changed.clear()

    def _set_parameter(self, node: str, parameter: Parameter[Any]) -> bool:
        client = self._parameter_client
        request = SetParameters.Request(parameters=[parameter.to_parameter_msg()])
        if not self.until(client.service_is_ready, 10.0):
            return False
        future = client.call_async(request)
        return self.until(future.done, 10.0)

    def publish_odometry(self, speed: float, turn_rate: float) -> None:
        """Tell how fast the robot drives [m/s] and turns [rad/s]."""
        message = Odometry()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.header.frame_id = 'odom'
        message.pose.pose.orientation.w = 1.0
        message.twist.twist.linear.x, message.twist.twist.angular.z = speed, turn_rate
        self._odometry.publish(message)

    def arm_is_ready(self) -> bool:
        """Whether the arm's driver tells a certain position."""
        heard = self._joint_states
        return self.until(lambda: self._joint_states > heard, 3.0)

    # --- sweeps -------------------------------------------------------------------------------

    def begin_sweep(self, timeout: float) -> str:
        """Start a sweep as soon as the graph allows it; return why not, empty if it runs."""
        deadline = time.monotonic() + timeout
        answer = Trigger.Response()
        while time.monotonic() < deadline:
            self.results.clear()
            self.progress.clear()
            self._begun = time.time_ns()
            answer = self.call('mosaicer/start')
            if answer.success:
                return ''
            self.wait(0.1)
        return str(answer.message)

    @property
    def share(self) -> float:
        """Progress of the sweep."""
        return self.progress[-1] if self.progress else 0.0

    @property
    def given_up(self) -> bool:
        """Whether the sweep was given up for good."""
        return any(map(math.isnan, self.progress))

    @property
    def scans(self) -> list[dict[str, Any]]:
        """Complete results of the sweep, oldest first; those of the one before may come again."""
        return [
            self.results[stamp]
            for stamp in sorted(self.results)
            if stamp > self._begun and len(self.results[stamp]) == len(_RESULTS)
        ]
