"""The faults of the campaign: each disturbs a graph in the middle of a sweep, then lets it be."""

from __future__ import annotations

import copy
import math
import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image

from benchmarks.faults.arm import FaultyArm
from benchmarks.faults.graph import STEP_DEG, Graph

#: Disturbs a graph; the generator is seeded.
Disturb = Callable[[Graph, np.random.Generator], None]


@dataclass(frozen=True, slots=True)
class Fault:
    """
    One kind of fault.

    Attributes
    ----------
    name : str
        A few words for the table.
    disturb : callable
        Does it.
    compressed : bool or None
        Whether it is one of graphs that compress their frames, or of those that do not.
    changes_light : bool
        Whether columns are right in whatever light.
    """

    name: str
    disturb: Disturb
    compressed: bool | None = None
    changes_light: bool = False


def _kill(name: str) -> Disturb:
    return lambda graph, _: graph.kill(name)


def _stop(name: str) -> Disturb:
    def disturb(graph: Graph, rng: np.random.Generator) -> None:
        graph.signal(name, signal.SIGSTOP)
        graph.wait(float(rng.uniform(0.2, 3.0)))
        graph.signal(name, signal.SIGCONT)

    return disturb


def _kill_and_power_cycle(graph: Graph, _: np.random.Generator) -> None:
    graph.kill('arm_driver')
    graph.arm.do(lambda controller, now: controller.power_up(now))


def _unplug(graph: Graph, rng: np.random.Generator) -> None:
    graph.arm.unplug()
    graph.wait(float(rng.uniform(0.1, 1.0)))
    graph.arm = FaultyArm(graph.link)


def _unplug_camera(graph: Graph, rng: np.random.Generator) -> None:
    graph.camera.unplug()
    graph.wait(float(rng.uniform(0.1, 3.0)))
    graph.camera.plug_in()


def _alarm(graph: Graph, _: np.random.Generator) -> None:
    graph.arm.do(lambda controller, now: controller.raise_alarm(1, now))


def _reboot(graph: Graph, _: np.random.Generator) -> None:
    graph.arm.do(lambda controller, now: controller.power_up(now))


def _lose_steps(graph: Graph, rng: np.random.Generator) -> None:
    lost = math.radians(STEP_DEG * float(rng.uniform(1.0, 5.0)) * float(rng.choice([-1, 1])))
    graph.arm.do(lambda controller, _: controller.displace(lost))


def _move_robot(graph: Graph, rng: np.random.Generator) -> None:
    """Let odometry tell that the robot turns or drives for a while."""
    speed, turn = (0.2, 0.0) if rng.random() < 0.5 else (0.0, 0.3)
    for _ in range(int(rng.integers(3, 20))):
        graph.publish_odometry(speed, turn)
        graph.wait(0.05)
    graph.publish_odometry(0.0, 0.0)


def _spoil_line(change: Callable[[np.random.Generator, bytes], bytes]) -> Disturb:
    """Pass what the controller says through a change for a while."""

    def disturb(graph: Graph, rng: np.random.Generator) -> None:
        graph.arm.spoil = lambda data: change(rng, data)
        graph.wait(float(rng.uniform(0.1, 1.5)))
        graph.arm.spoil = lambda data: data

    return disturb


def _garble(rng: np.random.Generator, data: bytes) -> bytes:
    """Lose a tenth of the bytes, add as many."""
    kept = [value for value in data if rng.random() > 0.1]
    for place in rng.integers(0, len(kept) + 1, rng.binomial(len(data), 0.1)):
        kept.insert(int(place), int(rng.integers(256)))
    return bytes(kept)


def _lose_ok(graph: Graph, _: np.random.Generator) -> None:
    """Lose one ``ok``."""
    lost = False

    def spoil(data: bytes) -> bytes:
        nonlocal lost
        if lost or b'ok\r\n' not in data:
            return data
        lost = True
        return data.replace(b'ok\r\n', b'', 1)

    graph.arm.spoil = spoil
    graph.until(lambda: lost, 3.0)
    graph.arm.spoil = lambda data: data


def _spoil_frames(
    make: Callable[[np.random.Generator], Callable[[Image], list[Image]]], longest: float
) -> Disturb:
    """Pass the camera's frames through a change for a while."""

    def disturb(graph: Graph, rng: np.random.Generator) -> None:
        graph.spoil_frame = make(rng)
        graph.wait(float(rng.uniform(0.1, longest)))
        graph.spoil_frame = lambda image: [image]

    return disturb


def _drop_most(rng: np.random.Generator) -> Callable[[Image], list[Image]]:
    return lambda image: [image] if rng.random() < 0.2 else []


def _queue(_: np.random.Generator) -> Callable[[Image], list[Image]]:
    """Hand frames out four too late, with their own stamps."""
    waiting: list[Image] = []

    def late(image: Image) -> list[Image]:
        waiting.append(image)
        return [waiting.pop(0)] if len(waiting) > 4 else []

    return late


def _jump(rng: np.random.Generator) -> Callable[[Image], list[Image]]:
    """Move stamps to and fro, as a clock that is set."""
    jump = float(rng.choice([-1, 1])) * float(rng.uniform(0.5, 3600.0))

    def moved(image: Image) -> list[Image]:
        stamp = image.header.stamp
        total = stamp.sec * 10**9 + stamp.nanosec + round(jump * 1e9)
        stamp.sec, stamp.nanosec = divmod(total, 10**9)
        return [image]

    return moved


def _corrupt(rng: np.random.Generator) -> Callable[[Image], list[Image]]:
    """Give some frames another size, encoding or length than they claim."""

    def corrupted(image: Image) -> list[Image]:
        kind = rng.integers(4)
        if kind == 0:
            image.encoding = 'unheard_of'
        elif kind == 1:
            image.data = image.data[: int(rng.integers(len(image.data)))]
        elif kind == 2:
            image.height //= 2
        return [image]

    return corrupted


def _corrupt_files(graph: Graph, rng: np.random.Generator) -> None:
    """Cut, damage or replace the files of compressed frames for a while."""

    def corrupted(data: bytes) -> bytes:
        kind = rng.integers(5)
        if kind == 0:
            return data[: int(rng.integers(len(data)))]
        if kind == 1:
            place = int(rng.integers(len(data)))
            return (
                data[:place] + bytes([data[place] ^ 1 << int(rng.integers(8))]) + data[place + 1 :]
            )
        if kind == 2:
            return rng.bytes(len(data))
        return data

    graph.spoil_file = corrupted
    graph.wait(float(rng.uniform(0.1, 1.5)))
    graph.spoil_file = lambda data: data


def _switch_light(graph: Graph, rng: np.random.Generator) -> None:
    """Let everything be darker or brighter until the sweep is over."""
    factor = float(rng.choice([rng.uniform(0.7, 0.9), rng.uniform(1.05, 1.2)]))
    levels = np.clip(np.rint(factor * np.arange(256)), 0, 255).astype(np.uint8)

    def lit(image: Image) -> list[Image]:
        image.data = levels[np.frombuffer(image.data, np.uint8)].tobytes()
        return [image]

    graph.spoil_frame = lit


def _wrong_camera_info(graph: Graph, rng: np.random.Generator) -> None:
    """Another calibration for a while."""
    factor = float(rng.choice([0.0, 0.9, 1.2]))

    def wrong(info: CameraInfo) -> CameraInfo:
        spoilt = copy.deepcopy(info)
        spoilt.k[0] *= factor
        return spoilt

    graph.spoil_info = wrong
    graph.wait(float(rng.uniform(0.1, 1.0)))
    graph.spoil_info = lambda info: info


def _parameter_change(graph: Graph, rng: np.random.Generator) -> None:
    """Set a live parameter of the mosaicer, and set it back after the sweep is over."""
    name, value = [('arm_radius', 0.4), ('column_offset_px', 24.0), ('sweep_deg', 180.0)][
        int(rng.integers(3))
    ]
    graph.set_parameter('mosaicer', Parameter(name, value=value))


FAULTS = (
    Fault('none', lambda _graph, _rng: None),
    *(
        Fault(f'{name} killed', _kill(name))
        for name in ('arm_driver', 'camera', 'mosaicer', 'depth')
    ),
    Fault('arm_driver killed, board restarted', _kill_and_power_cycle),
    *(
        Fault(f'{name} stopped for a while', _stop(name))
        for name in ('arm_driver', 'camera', 'mosaicer', 'depth')
    ),
    Fault('arm unplugged', _unplug),
    Fault('camera unplugged', _unplug_camera),
    Fault('limit alarm', _alarm),
    Fault('controller reboots', _reboot),
    Fault('garbled serial line', _spoil_line(_garble)),
    Fault('silent controller', _spoil_line(lambda _rng, _data: b'')),
    Fault('lost ok', _lose_ok),
    Fault('lost motor steps', _lose_steps),
    Fault('robot moves, by odometry', _move_robot),
    Fault('frames stall', _spoil_frames(lambda _rng: lambda _image: [], 3.0)),
    Fault('most frames dropped', _spoil_frames(_drop_most, 1.5)),
    Fault('frames late by a queue of 4', _spoil_frames(_queue, 1.5)),
    Fault("camera's clock jumps", _spoil_frames(_jump, 1.0)),
    Fault('corrupted frames', _spoil_frames(_corrupt, 1.5), compressed=False),
    Fault('corrupted compressed frames', _corrupt_files, compressed=True),
    Fault('light switched', _switch_light, changes_light=True),
    Fault('wrong camera_info', _wrong_camera_info),
    Fault('parameter changed', _parameter_change),
)
