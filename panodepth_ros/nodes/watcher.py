"""The watcher: follows the running sweep and keeps what a page shows of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import fields
from typing import Any

import cv2
import numpy as np
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState, LaserScan
from std_msgs.msg import Float32

from panodepth_ros.mosaic import ContinuousAssembler, Sweep
from panodepth_ros.mosaic.builder import NEVER, SweepBuilder
from panodepth_ros.nodes.mosaicer_settings import MosaicerParameters
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import decompressed, to_array, to_bgr_or_mono
from panodepth_ros.ros.messages import joint_reading, pinhole_camera, to_nanoseconds

#: Upper end of the depth picture's colours [m].
_FARTHEST = 5.0
#: How often the mosaicer is asked for its parameters until it answers [s].
_ASK_PERIOD = 0.5
#: A sweep of so few columns may be the led one that has just been announced.
_JUST_BEGUN = 3


class Watcher(Node):
    """
    Builds the sweep that the mosaicer builds, from the same topics and with its parameters.

    Its methods may be called from any thread.
    """

    def __init__(self, **node_args: Any) -> None:
        self._resources = ExitStack()  # first: the context may destroy a half-built node
        super().__init__('watch', **node_args)
        self._lock = threading.Lock()
        self._assembler: SweepBuilder[Any] | None = None
        self._parameters: MosaicerParameters | None = None
        self._frames: Subscription | None = None
        self._led = self._resting = False
        self._last: Sweep | None = None
        self._state = 'waiting for the mosaicer'
        self._camera_fault = ''
        self._depth: Image | None = None
        self._scan: LaserScan | None = None
        self._results = 0
        self._asked: Any = None
        self._client = self.create_client(GetParameters, 'mosaicer/get_parameters')
        self._timer = self.create_timer(_ASK_PERIOD, self._ask)
        for kind, topic, callback, profile in (
            (JointState, 'joint_states', self._on_joint_state, qos.JOINT_STATES),
            (CameraInfo, 'camera_info', self._on_camera_info, qos.IMAGES),
            (Float32, 'mosaicer/progress', self._on_progress, 10),
            (ParameterEvent, '/parameter_events', self._on_parameter_event, 100),
            (Image, 'depth/image', self._on_depth, qos.PANORAMAS),
            (LaserScan, 'scan', self._on_scan, qos.SCAN),
        ):
            self.create_subscription(kind, topic, self._locked(callback), profile)

    def at_the_end(self, close: Callable[[], Any]) -> None:
        """Have something closed before the node is destroyed."""
        self._resources.callback(close)

    def destroy_node(self) -> None:
        """Close what hangs on the node, destroy it; may run twice."""
        self._resources.close()
        super().destroy_node()

    # --- what the page asks -------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Return what the page shows in words, with version numbers of the pictures."""
        with self._lock:
            sweep = self._sweep()
            facts: list[tuple[str, str]] = []
            arm, seen, progress = None, 0, 0.0
            if sweep is not None and self._assembler is not None:
                seen, progress = int(sweep.seen.sum()), sweep.progress
                facts += [('columns', f'{seen} of {sweep.rig.sweep_columns}')]
                if sweep.start is not None and sweep.end is not None:
                    facts.append(
                        ('since the first column', f'{(sweep.end - sweep.start) / 1e9:.1f} s')
                    )
                position = self._assembler.track.position
                facts.append(('arm', f'{math.degrees(position):.2f}°'))
                arm = (0.5 - position / (2 * math.pi)) % 1.0
            if self._assembler is not None:
                drops = sorted(self._assembler.drops.items())
                facts += [(f'dropped: {reason}', str(count)) for reason, count in drops]
            return {
                'state': self._camera_fault or self._state,
                'progress': progress,
                'arm': arm,
                'facts': facts,
                'sweep': f'{sweep.start}-{seen}' if sweep is not None else '',
                'results': self._results,
            }

    def picture(self, name: str) -> bytes | None:
        """
        Return one of the pictures as PNG, None if there is nothing to show yet.

        Parameters
        ----------
        name : str
            ``left``, ``right`` or ``center``: the panorama as far as it has grown; ``depth``.
        """
        with self._lock:
            sweep, depth = self._sweep(), self._depth
            if name == 'depth':
                pixels = None if depth is None else _coloured(to_array(depth))
            elif sweep is None or sweep.start is None:
                pixels = None
            else:
                pixels = sweep.panoramas()[name].image
        if pixels is None:
            return None
        _, encoded = cv2.imencode('.png', pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
        return bytes(encoded)

    def scan(self) -> dict[str, Any]:
        """Return the last scan; ``ranges`` holds None where no finite range is known."""
        with self._lock:
            scan = self._scan
        if scan is None:
            return {'angle_min': 0.0, 'angle_increment': 0.0, 'ranges': []}
        return {
            'angle_min': scan.angle_min,
            'angle_increment': scan.angle_increment,
            'ranges': [r if math.isfinite(r) else None for r in scan.ranges],
        }

    def _sweep(self) -> Sweep | None:
        growing = None if self._assembler is None else self._assembler.sweep
        return growing if growing is not None else self._last

    # --- the graph ----------------------------------------------------------------------------

    def _locked(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        def call(message: Any) -> None:
            with self._lock:
                callback(message)

        return call

    def _ask(self) -> None:
        """Ask the mosaicer for its parameters, until it answers."""
        if self._asked is None and self._client.service_is_ready():
            names = [field.name for field in fields(MosaicerParameters)]
            self._asked = self._client.call_async(GetParameters.Request(names=names))
            self._asked.add_done_callback(self._locked(self._on_parameters))
        elif self._asked is not None and not self._client.service_is_ready():
            self._asked = None  # the mosaicer has gone before it answered

    def _on_parameter_event(self, event: ParameterEvent) -> None:
        if f'{event.node}/get_parameters' == self.resolve_service_name(self._client.srv_name):
            self._asked = None  # what is under way may be older
            self._timer.reset()

    def _on_parameters(self, future: Any) -> None:
        if future is not self._asked:
            return
        self._asked = None
        self._timer.cancel()
        names = (field.name for field in fields(MosaicerParameters))
        values = (parameter_value_to_python(value) for value in future.result().values)
        parameters = MosaicerParameters(**dict(zip(names, values, strict=True)))
        before, self._parameters = self._parameters, parameters
        if self._assembler and before and _same_but_live(parameters, before):
            parameters.renew_timing(self._assembler)
            self._assembler.rig = parameters.rig()
            return
        self._state = 'waiting for a sweep'
        self._assembler = parameters.builder()
        self._led = self._resting = False
        if self._frames is not None:
            self.destroy_subscription(self._frames)
        raw = parameters.image_transport == 'raw'
        self._frames = self.create_subscription(
            Image if raw else CompressedImage,
            'image_raw' if raw else 'image_raw/compressed',
            self._locked(self._on_image),
            qos.IMAGES,
        )

    def _on_progress(self, message: Float32) -> None:
        builder, given_up = self._assembler, math.isnan(message.data)
        if builder is None or message.data > 0:
            return
        sweep = builder.sweep
        if given_up or self._resting or (sweep is not None and sweep.seen.sum() > _JUST_BEGUN):
            self._last = sweep or self._last
            self._resting = False
            builder.restart((builder.track.newest or 0) + 1)
        builder.drops.clear()
        if given_up:
            self._state = 'the sweep was given up'
            self._end_led_sweep()
        self._led = not given_up
        self._timer.reset()  # the mosaicer may be another one than it was

    def _end_led_sweep(self) -> None:
        """Take no frame of a turning arm that a led sweep has left, as the mosaicer does."""
        if self._led and isinstance(self._assembler, ContinuousAssembler):
            self._resting = True
            self._assembler.restart(NEVER)
        self._led = False

    def _on_camera_info(self, message: CameraInfo) -> None:
        if self._assembler is None:
            return
        try:
            self._finish(self._assembler.set_camera(pinhole_camera(message)))
            self._camera_fault = ''
        except ValueError as error:
            self._camera_fault = f'camera_info: {error}'

    def _on_image(self, message: Image | CompressedImage) -> None:
        if self._assembler is None:
            return
        if self._camera_fault:
            self._assembler.drops[f'frame: {self._camera_fault}'] += 1
            return
        try:
            image = (
                to_bgr_or_mono(message) if isinstance(message, Image) else decompressed(message)
            )
        except ValueError as error:
            self._assembler.drops[f'frame: {error}'] += 1
            return
        self._finish(self._assembler.add_frame(to_nanoseconds(message.header.stamp), image))

    def _on_joint_state(self, message: JointState) -> None:
        if self._assembler is None or self._parameters is None:
            return
        try:
            reading = joint_reading(message, self._parameters.joint_name)
        except ValueError as error:
            self._assembler.drops[str(error)] += 1
            return
        if reading is not None:
            self._finish(self._assembler.add_joint_state(*reading))

    def _finish(self, sweeps: list[Sweep]) -> None:
        """Keep the last sweep that came to its end, and say how things stand."""
        assert self._assembler is not None
        if sweeps:
            self._last = sweeps[-1]
            self._state = 'the sweep is done'
            if self._parameters is not None and not self._parameters.free_running:
                self._end_led_sweep()
        elif self._assembler.sweep is not None:
            self._state = 'sweeping'

    def _on_depth(self, message: Image) -> None:
        self._depth = message
        self._results += 1

    def _on_scan(self, message: LaserScan) -> None:
        self._scan = message
        self._results += 1


def _same_but_live(ours: MosaicerParameters, theirs: MosaicerParameters) -> bool:
    """Whether two tables differ by what may be set on a running mosaicer only."""
    return all(
        field.metadata['live'] or getattr(ours, field.name) == getattr(theirs, field.name)
        for field in fields(MosaicerParameters)
    )


def _coloured(depth: np.ndarray[Any, np.dtype[Any]]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Picture of distances, near ones red, unknown ones dark."""
    known = np.isfinite(depth)
    level = np.where(known, 255 * (1 - np.where(known, depth, 0) / _FARTHEST), 0).clip(0, 255)
    picture = cv2.applyColorMap(level.astype(np.uint8), cv2.COLORMAP_TURBO)
    picture[~known] = 38
    return np.asarray(picture, np.uint8)
