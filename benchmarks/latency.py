"""
How long after the last frame of a turn its scan comes, and what the nodes cost meanwhile.

Mosaicer and depth are processes of their own; frames and joint states of a simulated room are
published here, in real time, as a camera and an arm would. A latency is the time from the stamp
of the newest frame in a scan to its arrival here.

    python -m benchmarks.latency --motion continuous --partial-deg 10
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image, JointState, LaserScan

from benchmarks.report import table
from benchmarks.scenes import NOISE
from benchmarks.stripes import ARM_RADIUS, FIELD_OF_VIEW
from panodepth_ros.camera.simulated import RoomCamera, furnished_room
from panodepth_ros.cli.domain import claimed_domain
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.messages import to_nanoseconds, to_stamp

#: Joint states per second of the turning arm, and columns of a turn.
JOINT_RATE, COLUMNS = 50.0, 1800
JOINT = 'panodepth_arm_joint'
SCANS = ('scan', 'scan_partial')
_PROFILE = Path(__file__).parents[1] / 'config' / 'fastdds.xml'


@dataclass(frozen=True, slots=True)
class Event:
    """
    Something that is published.

    Attributes
    ----------
    time : float
        When, from the begin [s].
    azimuth, velocity : float
        Of the arm then [rad], [rad/s].
    frame : int
        Number of the frame within the turn; −1 for a joint state.
    """

    time: float
    azimuth: float
    velocity: float
    frame: int = -1


def turning(turns: int, turn_time: float, framerate: float) -> list[Event]:
    """Events of an arm that turns steadily, a little beyond the last turn."""
    speed, frames = 2 * math.pi / turn_time, round(turn_time * framerate)
    duration = turns * turn_time + 0.5
    events = [
        Event(k / JOINT_RATE, speed * k / JOINT_RATE, speed)
        for k in range(round(duration * JOINT_RATE))
    ]
    events += [
        Event(k / framerate, speed * k / framerate, speed, k % frames)
        for k in range(round(duration * framerate))
    ]
    return sorted(events, key=lambda event: event.time)


def stepping(turns: int, framerate: float) -> list[Event]:
    """Events of an arm that stops for every column."""
    events, part = [], 0.25 / framerate
    for k in range(turns * COLUMNS):
        begin, azimuth = k / framerate, 2 * math.pi * k / COLUMNS
        events += [
            Event(begin, azimuth - math.pi / COLUMNS, 1.0),
            Event(begin + part, azimuth, 0.0),
            Event(begin + 2 * part, azimuth, 0.0, k % COLUMNS),
            Event(begin + 3 * part, azimuth, 0.0),
        ]
    return events


class Rig(Node):  # type: ignore[misc]
    """Publishes what camera and arm would, and notes when scans arrive."""

    def __init__(self, lens: RoomCamera, frames: list[npt.NDArray[np.uint8]]) -> None:
        super().__init__('rig')
        self._lens, self._frames = lens, frames
        self.latencies: dict[str, list[float]] = {topic: [] for topic in SCANS}
        self.images = self.create_publisher(Image, 'image_raw', qos.IMAGES)
        self._infos = self.create_publisher(CameraInfo, 'camera_info', qos.IMAGES)
        self.joints = self.create_publisher(JointState, 'joint_states', qos.JOINT_STATES)
        for topic in SCANS:
            self.create_subscription(
                LaserScan, topic, lambda scan, topic=topic: self._on_scan(topic, scan), qos.SCAN
            )

    def _on_scan(self, topic: str, scan: LaserScan) -> None:
        late = time.time_ns() - to_nanoseconds(scan.header.stamp)
        self.latencies[topic].append(late * 1e-9)

    def publish(self, event: Event, begin: float) -> None:
        """Publish an event, stamped with the time at which it is due."""
        stamp = to_stamp(round((begin + event.time) * 1e9))
        if event.frame < 0:
            message = JointState(name=[JOINT], position=[event.azimuth])
            message.velocity = [event.velocity]
            message.header.stamp = stamp
            self.joints.publish(message)
            return
        lens = self._lens
        info = CameraInfo(width=lens.width, height=lens.height, distortion_model='plumb_bob')
        info.header.stamp = stamp
        info.k = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
        info.d = [0.0] * 5
        self._infos.publish(info)
        image = self._frames[event.frame]
        self.images.publish(to_message(image, 'bgr8', stamp=stamp, frame_id='camera'))


def rendered(lens: RoomCamera, seed: int, count: int) -> list[npt.NDArray[np.uint8]]:
    """Frames of a turn, with noise."""
    room, rng = furnished_room(seed), np.random.default_rng(1)
    frames = []
    for k in range(count):
        image = room.render(2 * math.pi * k / count, lens, ARM_RADIUS).astype(np.float32)
        image += rng.normal(0, NOISE, image.shape).astype(np.float32)
        frames.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return frames


def started(stack: ExitStack, name: str, *parameters: str) -> subprocess.Popen[bytes]:
    """Start a node as a process for the time of the stack."""
    module = f'panodepth_ros.nodes.{name}'
    code = f'import sys; from {module} import main; sys.exit(main())'
    words = [word for parameter in parameters for word in ('-p', parameter)]
    process = subprocess.Popen([sys.executable, '-c', code, '--ros-args', *words])
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def usage(process: subprocess.Popen[bytes]) -> tuple[float, float]:
    """Processor time [s] and peak memory [MB] of a process."""
    words = Path(f'/proc/{process.pid}/stat').read_text().rpartition(')')[2].split()
    ticks = int(words[11]) + int(words[12])
    status = Path(f'/proc/{process.pid}/status').read_text()
    peak = int(status.partition('VmHWM:')[2].split()[0]) / 1024
    return ticks / os.sysconf('SC_CLK_TCK'), peak


def spin_until(executor: SingleThreadedExecutor, end: float) -> None:
    """Spin until a moment."""
    while (left := end - time.time()) > 0:
        executor.spin_once(timeout_sec=left)


def run(chosen: argparse.Namespace) -> Iterator[list[str]]:
    """Play the turns; yield rows of the table."""
    lens = RoomCamera.from_field_of_view(chosen.width, chosen.width * 3 // 4, FIELD_OF_VIEW)
    steady = chosen.motion == 'continuous'
    framerate = chosen.framerate
    stripe = next(
        n for n in range(1, COLUMNS)
        if COLUMNS % n == 0 and n >= 2 * COLUMNS / (chosen.turn_time * framerate)
    ) if steady else 1  # fmt: skip
    count = round(chosen.turn_time * framerate) if steady else COLUMNS
    events = (
        turning(chosen.turns, chosen.turn_time, framerate)
        if steady
        else stepping(chosen.turns, framerate)
    )
    frames = rendered(lens, chosen.seed, count)
    with ExitStack() as stack:
        os.environ['ROS_DOMAIN_ID'] = str(stack.enter_context(claimed_domain()))
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        for variable in ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE'):
            os.environ[variable] = str(_PROFILE)
        nodes = {
            'mosaicer': started(
                stack, 'mosaicer', 'lead:=false', f'motion:={chosen.motion}',
                f'partial_deg:={float(chosen.partial_deg)}', f'arm_radius:={ARM_RADIUS}',
                f'column_offset_px:={66.0 * chosen.width / 160}', f'stripe_columns:={stripe}',
            ),
            'depth': started(stack, 'depth', 'republish_period:=0.0', 'beams:=720'),
        }  # fmt: skip
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        rig = Rig(lens, frames)
        executor = SingleThreadedExecutor()
        executor.add_node(rig)
        while not (
            rig.images.get_subscription_count()
            and rig.joints.get_subscription_count()
            and all(rig.count_publishers(topic) for topic in SCANS)
        ):
            executor.spin_once(timeout_sec=0.05)
        spin_until(executor, time.time() + 1.0)
        before = {name: usage(process)[0] for name, process in nodes.items()}
        begin = time.time() + 0.1
        for event in events:
            spin_until(executor, begin + event.time)
            rig.publish(event, begin)
        spin_until(executor, time.time() + 2.0)
        duration = events[-1].time
        for topic, late in rig.latencies.items():
            if late:
                shown = ' / '.join(f'{1e3 * q:.0f}' for q in np.quantile(late, (0.0, 0.5, 1.0)))
                yield [f'`{topic}` after its newest frame', f'{shown} ms ({len(late)} scans)']
        for name, process in nodes.items():
            spent, peak = usage(process)
            yield [
                name,
                f'{100 * (spent - before[name]) / duration:.0f} % of a core, {peak:.0f} MB',
            ]
        executor.shutdown()
        rig.destroy_node()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0].strip())
    parser.add_argument('--motion', choices=('continuous', 'stop_and_go'), default='continuous')
    parser.add_argument('--partial-deg', type=float, default=0.0, help='0 for no sectors')
    parser.add_argument('--turns', type=int, default=4)
    parser.add_argument('--turn-time', type=float, default=10.0, help='of a steady turn, s')
    parser.add_argument('--framerate', type=float, default=30.0)
    parser.add_argument('--width', type=int, default=160, help='of the frames, in pixels')
    parser.add_argument('--seed', type=int, default=1, help='which room')
    chosen = parser.parse_args()
    rows = list(run(chosen))
    load = os.getloadavg()[0]
    print(
        table([f'load {load:.1f} of {os.cpu_count()} cores', 'smallest / median / largest'], rows)
    )


if __name__ == '__main__':
    main()
