"""
What the whole graph costs while the arm turns without a stop: CPU, memory, lost frames, latency.

All nodes and the simulated arm are processes of their own. The camera plays pictures rendered
before and kept on disk, as many a turn as it gives, so that rendering is not counted.
``docs/continuous.md`` has a run.

    python -m benchmarks.graph_load --framerate 30 --duration 180
"""

from __future__ import annotations

import argparse
import math
import os
import re
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
import yaml
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, LaserScan
from std_srvs.srv import Trigger

from benchmarks.continuous import OFFSET_SHARE, STRIPE_DISTANCE, Case
from benchmarks.report import table, versions
from benchmarks.stripes import ARM_RADIUS, COLUMNS, FIELD_OF_VIEW, noisy
from panodepth_ros.camera.calibration import Calibration, write_calibration
from panodepth_ros.camera.simulated import RoomCamera, furnished_room
from panodepth_ros.cli.demo import PROFILE_VARIABLES, installed_config
from panodepth_ros.cli.domain import claimed_domain
from panodepth_ros.cli.processes import ProcessError, Processes
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig

NODES = ('arm_driver', 'camera', 'mosaicer', 'depth')
_TIMEOUT = 60.0
_TICK = os.sysconf('SC_CLK_TCK')
#: When memory is looked at, in parts of the duration.
_MARKS = (0.1, 0.2, 0.5, 1.0)


@dataclass(frozen=True, slots=True)
class Use:
    """CPU time so far [s], memory of its own and shared memory that it has touched [MB]."""

    cpu: float
    own: float
    shared: float

    @classmethod
    def of(cls, pid: int) -> Use:
        """Ask the kernel."""
        fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
        status = dict(
            line.split(':', 1) for line in Path(f'/proc/{pid}/status').read_text().splitlines()
        )
        own, shared = (int(status[name].split()[0]) / 1024 for name in ('RssAnon', 'RssShmem'))
        return cls((int(fields[11]) + int(fields[12])) / _TICK, own, shared)


def render(folder: Path, lens: RoomCamera, frames: int) -> None:
    """Write one turn of pictures, unless it is there."""
    folder.mkdir(parents=True, exist_ok=True)
    room, rng = furnished_room(1), np.random.default_rng(1)
    for number in range(frames):
        file = folder / f'{number}.bmp'
        if not file.is_file():
            image = room.render(2 * math.pi * number / frames, lens, ARM_RADIUS)
            cv2.imwrite(str(file), noisy(image.astype(np.float32), rng))


def parameters(scratch: Path, rig: Rig, case: Case, camera: PinholeCamera) -> dict[str, Any]:
    """Parameters of the nodes, by node."""
    calibration = scratch / 'camera.yaml'
    write_calibration(
        Calibration.of_pinhole(camera, camera_name='panodepth_camera'),
        calibration,
    )
    return {
        'arm_driver': {
            'port': str(scratch / 'arm'),
            'spin_speed_deg_s': math.degrees(case.velocity),
            'status_rate': 50.0,
        },
        'camera': {
            'source': 'images',
            'video_device': str(scratch / 'frames'),
            'image_width': camera.width,
            'image_height': camera.height,
            'framerate': case.framerate,
            'camera_info_url': calibration.as_uri(),
        },
        'mosaicer': {
            'motion': 'continuous',
            'free_running': True,
            'arm_radius': ARM_RADIUS,
            'column_offset_px': rig.column_offset,
            'column_step_deg': 360.0 / COLUMNS,
            'stripe_columns': rig.stripe_columns,
            'stripe_distance': STRIPE_DISTANCE,
        },
        'depth': {},
    }


class Client:
    """Watches the graph's sweeps."""

    def __init__(self, processes: Processes) -> None:
        self.node: Node = rclpy.create_node('graph_load')
        self.frames: list[int] = []
        self.latencies: list[float] = []
        self.shares: list[float] = []
        self._processes = processes
        self.node.create_subscription(CameraInfo, 'camera_info', self._on_frame, 100)
        self.node.create_subscription(LaserScan, 'scan', self._on_scan, 10)

    def _on_frame(self, message: CameraInfo) -> None:
        self.frames.append(_nanoseconds(message.header.stamp))

    def _on_scan(self, message: LaserScan) -> None:
        now = self.node.get_clock().now().nanoseconds
        self.latencies.append((now - _nanoseconds(message.header.stamp)) / 1e9)
        self.shares.append(float(np.isfinite(message.ranges).mean()))

    def until(self, condition: Callable[[], Any], what: str, timeout: float = _TIMEOUT) -> None:
        """Wait, and see that all processes live."""
        deadline = time.monotonic() + timeout
        while not condition():
            self._processes.check()
            if time.monotonic() > deadline:
                raise ProcessError(f'{what} did not come within {timeout:g} s')
            rclpy.spin_once(self.node, timeout_sec=0.1)

    def start(self) -> None:
        """Let the arm turn as soon as the graph is ready."""
        client = self.node.create_client(Trigger, 'mosaicer/start')
        self.until(client.service_is_ready, 'the mosaicer')
        deadline = time.monotonic() + _TIMEOUT
        while True:
            future = client.call_async(Trigger.Request())
            self.until(future.done, 'the answer of the mosaicer')
            answer = future.result()
            if answer is not None and answer.success:
                return
            if time.monotonic() > deadline:
                raise ProcessError(f'the mosaicer does not start: {answer and answer.message}')
            rclpy.spin_once(self.node, timeout_sec=0.2)


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def measure(processes: Processes, scratch: Path, duration: float, turn: float) -> None:
    """Run the graph and print what it used after its first turn."""
    processes.start(
        'simulated_arm', 'panodepth_ros.cli.simulated_arm', ['--link', str(scratch / 'arm')]
    )
    client = Client(processes)
    client.until((scratch / 'arm').exists, 'the simulated arm')
    for node in ('arm_driver', 'mosaicer', 'depth', 'camera'):
        if node == 'camera':  # its pictures are played once: all else is to be ready
            client.until(lambda: client.node.count_publishers('scan'), 'the depth node')
        processes.start(
            node,
            f'panodepth_ros.nodes.{node}',
            ['--ros-args', '--params-file', str(scratch / 'parameters.yaml')],
        )
    client.start()
    client.until(lambda: client.latencies, 'the first scan', 2 * turn + _TIMEOUT)
    pids = {node: processes.pid(node) for node in NODES}
    begin, first_frame, first_scan = time.monotonic(), len(client.frames), len(client.latencies)
    uses = [{node: Use.of(pid) for node, pid in pids.items()}]
    for mark in _MARKS:
        client.until(lambda: time.monotonic() - begin > mark * duration, 'the end', duration + 1)  # noqa: B023
        uses.append({node: Use.of(pid) for node, pid in pids.items()})
    took = time.monotonic() - begin
    cpu = {node: 100 * (uses[-1][node].cpu - uses[0][node].cpu) / took for node in NODES}
    rows = [
        [node, f'{cpu[node]:.1f}']
        + [f'{use[node].own:.1f}' for use in uses]
        + [f'{uses[-1][node].shared:.0f}']
        for node in NODES
    ]
    rows.append(['all', f'{sum(cpu.values()):.1f}', *[''] * (len(uses) + 1)])
    times = [f'after {mark * duration:.0f} s' for mark in _MARKS]
    heads = ['', 'CPU, % of a core', 'own memory MB after a turn', *times, 'shared']
    print(table(heads, rows))
    stamps, latencies = client.frames[first_frame:], client.latencies[first_scan:]
    said = processes.text('mosaicer')
    matched = re.findall(r'took ([0-9.]+) s', processes.text('depth'))
    print(
        f'\n{took:.0f} s; {len(stamps)} frames published, '
        f'{(len(stamps) - 1) / (stamps[-1] - stamps[0]) * 1e9:.2f} Hz; '
        f'{said.count("no frame reached")} gaps in panoramas, '
        f'{said.count("given up")} sweeps given up; {len(latencies)} scans, '
        f'{100 * np.median(client.shares):.1f} % of their beams with a range; '
        f'from the last frame of a turn to its scan {1e3 * np.median(latencies):.0f} ms '
        f'(median), {1e3 * max(latencies):.0f} ms (longest), of which matching and scan take '
        f'{1e3 * np.median([float(text) for text in matched]):.0f} ms'
    )


def main() -> None:
    """Render, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--width', type=int, default=640, help='of the frames, in pixels')
    parser.add_argument('--framerate', type=float, default=30.0, help='[Hz]')
    parser.add_argument('--turn', type=float, default=10.0, help='time of a turn [s]')
    parser.add_argument('--duration', type=float, default=180.0, help='measured [s]')
    parser.add_argument(
        '--frames', type=Path, default=Path(tempfile.gettempdir(), 'panodepth_frames')
    )
    chosen = parser.parse_args()
    lens = RoomCamera.from_field_of_view(chosen.width, chosen.width * 3 // 4, FIELD_OF_VIEW)
    case = Case(turn_time=chosen.turn, framerate=chosen.framerate)
    rig = Rig(
        arm_radius=ARM_RADIUS,
        column_offset=OFFSET_SHARE * chosen.width,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        stripe_columns=case.stripe,
        stripe_distance=STRIPE_DISTANCE,
    )
    frames = round(case.turn_time * case.framerate)
    folder = chosen.frames.resolve() / f'{lens.width}x{lens.height}_{frames}'
    camera = PinholeCamera(**{n: getattr(lens, n) for n in RoomCamera.__slots__})
    render(folder, lens, frames)
    with tempfile.TemporaryDirectory() as scratch_folder, claimed_domain() as domain:
        scratch = Path(scratch_folder)
        (scratch / 'frames').mkdir()
        for number in range(round((chosen.duration + 2 * case.turn_time + 60) * case.framerate)):
            link = scratch / 'frames' / f'{number}.bmp'
            link.symlink_to(folder / f'{number % frames}.bmp')
        by_node = parameters(scratch, rig, case, camera)
        told = {f'/{node}': {'ros__parameters': own} for node, own in by_node.items() if own}
        (scratch / 'parameters.yaml').write_text(yaml.safe_dump(told))
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        os.environ['ROS_LOG_DIR'] = str(scratch / 'ros_log')
        for name in PROFILE_VARIABLES:
            os.environ.setdefault(name, str(installed_config('fastdds.xml')))
        processes = Processes(scratch)
        rclpy.init(args=[])
        print(f'{versions()}; {os.cpu_count()} cores\n')
        try:
            measure(processes, scratch, chosen.duration, case.turn_time)
        except BaseException:
            with suppress(ProcessError):
                processes.stop()
            raise
        finally:
            rclpy.try_shutdown()
        processes.stop()


if __name__ == '__main__':
    main()
