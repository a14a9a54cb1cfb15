"""The mosaicer: frames and arm angles in, left, right and centre panoramas out."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import Float32, Header
from std_srvs.srv import Trigger

from panodepth_ros.geometry import Mounting
from panodepth_ros.mosaic import ArmTrack, Assembler, Rig, Standstill, Sweep
from panodepth_ros.mosaic.sweep import columns_per_turn, panorama_names
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import ERROR, OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.images import decompressed, to_bgr_or_mono, to_message
from panodepth_ros.ros.messages import panorama_info, pinhole_camera, to_nanoseconds, to_stamp
from panodepth_ros.ros.parameters import declare_parameters, parameter
from panodepth_ros.ros.process import run_node

_NO_CAMERA = 'no camera_info received yet'
#: How often waiting is checked against its timeouts [s].
_WATCH_PERIOD = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class MosaicerParameters:
    """Parameters of the mosaicer."""

    lead: bool = parameter(
        True, "Lead the sweep by the arm's step service; false only listens, live or to a bag"
    )
    image_transport: str = parameter(
        'raw',
        'Take frames from image_raw, or from image_raw/compressed',
        choices=('raw', 'compressed'),
    )
    arm_radius: float = parameter(
        0.30, 'Axis of rotation to optical centre', unit='m', bounds=(0.01, 10.0), live=True
    )
    column_offset_px: float = parameter(
        70.5,
        "Distance of the left and right eye's columns from the principal point",
        unit='px',
        bounds=(1.0, 10000.0),
        live=True,
    )
    camera_yaw_deg: float = parameter(
        0.0,
        'Optical axis to the left of the radial direction, counter-clockwise seen from above',
        unit='°',
        bounds=(-45.0, 45.0),
        live=True,
    )
    camera_roll_deg: float = parameter(
        0.0,
        'Camera turned clockwise about its optical axis, seen from behind',
        unit='°',
        bounds=(-180.0, 180.0),
        live=True,
    )
    camera_tilt_deg: float = parameter(
        0.0,
        'Optical axis above the plane of rotation',
        unit='°',
        bounds=(-45.0, 45.0),
        live=True,
    )
    further_offsets_px: tuple[float, ...] = parameter(
        (),
        'Such distances of further pairs, published under pair_1, pair_2, …; left out for none',
        unit='px',
        bounds=(1.0, 10000.0),
    )
    column_step_deg: float = parameter(
        0.2,
        'Angle between panorama columns, a whole fraction of 360',
        unit='°',
        bounds=(0.01, 6.0),
    )
    stripe_columns: int = parameter(
        1,
        "Columns that one frame fills, a divisor of those of a turn; the arm's step must be as "
        'many column steps',
        bounds=(1, 360),
    )
    stripe_distance: float = parameter(
        2.0,
        'Distance from the axis at which neighbouring stripes join, at least twice the arm_radius',
        unit='m',
        bounds=(0.02, 1000.0),
    )
    sweep_deg: float = parameter(
        360.0,
        'Angle that a sweep covers, a whole number of column steps',
        unit='°',
        bounds=(1.0, 360.0),
        live=True,
    )
    frame_id: str = parameter(
        'panodepth', 'Frame of the panoramas: on the axis, z up, x forward, not turning'
    )
    joint_name: str = parameter('panodepth_arm_joint', "The arm's joint in joint_states")
    settle_time: float = parameter(
        0.0,
        'Time a frame must come after the start of a standstill, for arms that report standing '
        'before they have settled',
        unit='s',
        bounds=(0.0, 10.0),
    )
    standstill_tolerance_deg: float = parameter(
        0.002, 'Largest change of position that counts as standing', unit='°', bounds=(0.0, 1.0)
    )
    joint_state_gap: float = parameter(
        1.0, 'Longest time between joint states around a frame', unit='s', bounds=(0.01, 10.0)
    )
    step_timeout: float = parameter(
        10.0, 'Longest time for a step of the arm', unit='s', bounds=(0.1, 600.0)
    )
    frame_timeout: float = parameter(
        5.0,
        'Time without a frame after which the camera is reported',
        unit='s',
        bounds=(0.1, 60.0),
    )

    def __post_init__(self) -> None:
        turn = columns_per_turn(self.column_step_deg)
        if turn % self.stripe_columns:
            divisors = [str(n) for n in range(1, 361) if turn % n == 0]
            raise ValueError(
                f'stripe_columns is {self.stripe_columns}; allowed: divisors of the {turn} '
                f'columns of a turn, {", ".join(divisors)}'
            )
        offsets = (self.column_offset_px, *self.further_offsets_px)
        if len(set(offsets)) < len(offsets):
            raise ValueError(
                f'further_offsets_px is {list(self.further_offsets_px)} besides column_offset_px '
                f'{self.column_offset_px}; allowed: distances that differ'
            )
        self.rig()
        columns = self.sweep_deg / self.column_step_deg
        if abs(columns - round(columns)) > 0.02:
            raise ValueError(
                f'sweep_deg is {self.sweep_deg}: {columns:.3f} steps of column_step_deg '
                f'{self.column_step_deg}; allowed: a whole number of them'
            )

    def rig(self) -> Rig:
        """Return what the core needs."""
        columns = columns_per_turn(self.column_step_deg)
        return Rig(
            arm_radius=self.arm_radius,
            column_offset=self.column_offset_px,
            columns=columns,
            sweep_columns=min(columns, round(self.sweep_deg / self.column_step_deg)),
            mounting=Mounting(
                yaw=math.radians(self.camera_yaw_deg),
                roll=math.radians(self.camera_roll_deg),
                tilt=math.radians(self.camera_tilt_deg),
            ),
            further_offsets=self.further_offsets_px,
            stripe_columns=self.stripe_columns,
            stripe_distance=self.stripe_distance if self.stripe_columns > 1 else math.inf,
        )


@dataclass(slots=True)
class _Lead:
    """A sweep that this node leads: what it waits for."""

    steps: int
    azimuth: float
    after: int
    waiting_since: float
    step: Any = None


class Mosaicer(Node):
    """Leads or follows sweeps and publishes their panoramas. Topics and parameters: README."""

    def __init__(self, **node_args: Any) -> None:
        super().__init__(
            'mosaicer', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(
            self, MosaicerParameters, self._on_parameters, self._check_parameters
        )
        self._assembler = Assembler(
            self._settings.rig(),
            ArmTrack(
                math.radians(self._settings.standstill_tolerance_deg),
                round(self._settings.joint_state_gap * 1e9),
            ),
            round(self._settings.settle_time * 1e9),
        )
        self._lead: _Lead | None = None
        self._camera_fault = _NO_CAMERA
        self._reported = -1.0
        self._last_end = 'none yet'
        self._image_publishers: dict[str, Publisher] = {}
        self._info_publishers: dict[str, Publisher] = {}
        for name in panorama_names(len(self._settings.further_offsets_px)):
            self._image_publishers[name] = self.create_publisher(
                Image, f'{name}/image', qos.PANORAMAS
            )
            self._info_publishers[name] = self.create_publisher(
                CameraInfo, f'{name}/camera_info', qos.PANORAMAS
            )
        self._progress_publisher = self.create_publisher(Float32, '~/progress', 10)
        self._step_client = self.create_client(Trigger, 'arm_driver/step')
        self.create_subscription(
            JointState, 'joint_states', self._on_joint_state, qos.JOINT_STATES
        )
        self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, qos.IMAGES)
        if self._settings.image_transport == 'raw':
            self.create_subscription(Image, 'image_raw', self._on_image, qos.IMAGES)
        else:
            self.create_subscription(
                CompressedImage, 'image_raw/compressed', self._on_image, qos.IMAGES
            )
        self.create_service(Trigger, '~/start', self._on_start)
        self.create_service(Trigger, '~/cancel', self._on_cancel)
        self.create_timer(_WATCH_PERIOD, self._advance)
        publish_diagnostics(self, 'sweep', self._diagnose)
        self.get_logger().info(
            'ready; sweeps begin with ~/start' if self._settings.lead else 'ready; listening'
        )

    # --- parameters ---------------------------------------------------------------------------

    def _check_parameters(self, proposed: MosaicerParameters) -> None:
        camera = self._assembler.camera
        if camera is not None:
            Sweep(proposed.rig(), camera, 0.0)

    def _on_parameters(self, parameters: MosaicerParameters) -> None:
        self._settings = parameters
        self._assembler.rig = parameters.rig()

    # --- data ---------------------------------------------------------------------------------

    def _on_camera_info(self, message: CameraInfo) -> None:
        under_way = self._assembler.sweep is not None
        try:
            self._publish(self._assembler.set_camera(pinhole_camera(message)))
        except ValueError as error:
            self._camera_fault = str(error)
            self.get_logger().error(f'camera_info: {error}', throttle_duration_sec=5.0)
        else:
            self._camera_fault = ''
            if under_way and self._assembler.sweep is None:
                self._give_up('camera_info has changed')

    def _on_image(self, message: Image | CompressedImage) -> None:
        if self._camera_fault and self._camera_fault != _NO_CAMERA:
            self._assembler.drops[f'frame: {self._camera_fault}'] += 1
            return
        try:
            image = (
                to_bgr_or_mono(message) if isinstance(message, Image) else decompressed(message)
            )
        except ValueError as error:
            self._assembler.drops[f'frame: {error}'] += 1
            self.get_logger().warning(f'frame dropped: {error}', throttle_duration_sec=5.0)
            return
        self._publish(self._assembler.add_frame(to_nanoseconds(message.header.stamp), image))
        self._advance()

    def _on_joint_state(self, message: JointState) -> None:
        if self._settings.joint_name not in message.name:
            return
        index = list(message.name).index(self._settings.joint_name)
        if index >= len(message.position):
            self._assembler.drops['joint state without a position'] += 1
            return
        velocity = message.velocity[index] if index < len(message.velocity) else None
        stamp = to_nanoseconds(message.header.stamp)
        self._publish(self._assembler.add_joint_state(stamp, message.position[index], velocity))
        self._advance()

    # --- services -----------------------------------------------------------------------------

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = self._why_not_start()
        response.success = not response.message
        newest = self._assembler.track.newest
        if response.message or newest is None:
            return response
        self._assembler.restart(newest + 1)
        self._assembler.drops.clear()
        self._lead = _Lead(0, self._assembler.track.position, newest, time.monotonic())
        self._request_step(self._lead)
        self._publish_progress(0.0)
        rig = self._assembler.rig
        response.message = (
            f'sweep of {rig.sweep_columns} columns in {rig.sweep_frames} frames started'
        )
        self.get_logger().info(response.message)
        return response

    def _why_not_start(self) -> str:
        """Return a sentence for the user, empty if nothing is in the way."""
        if not self._settings.lead:
            return 'lead is false: this mosaicer only listens'
        if self._lead is not None:
            return 'a sweep is running; cancel it first'
        if self._camera_fault:
            return f'the camera cannot be used: {self._camera_fault}'
        if self._assembler.track.newest is None:
            return f'no joint state of {self._settings.joint_name} received yet'
        if not self._step_client.service_is_ready():
            return f'the service {self._step_client.srv_name} is not there'
        return ''

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._lead is not None or self._assembler.sweep is not None
        response.message = 'sweep cancelled' if response.success else 'no sweep is running'
        if response.success:
            self._give_up('cancelled')
        return response

    # --- leading ------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Take the led sweep as far as what has arrived allows."""
        self._report_progress()
        lead = self._lead
        if lead is None:
            return
        waited = time.monotonic() - lead.waiting_since
        standstill = self._assembler.track.current
        if self._moving(lead, standstill) or standstill is None:
            if waited > self._settings.step_timeout:
                self._give_up(
                    f'the arm did not take a step and report standing still within '
                    f'{self._settings.step_timeout:g} s'
                )
        elif not self._took_one_stripe(lead, standstill):
            stripe, step = self._settings.stripe_columns, self._settings.column_step_deg
            columns = f'{stripe} columns of {step:g}' if stripe > 1 else f'{step:g}'
            self._give_up(
                f'the arm moved {math.degrees(standstill.azimuth - lead.azimuth):.4f}° on a step; '
                f"allowed: the arm's step_deg must be the mosaicer's {columns}°"
            )
        elif not self._assembler.has_frame_of(standstill):
            if waited > self._settings.frame_timeout:
                self.get_logger().error(
                    f'no frame for {waited:.1f} s: the sweep waits at frame {lead.steps} of '
                    f'{self._assembler.rig.sweep_frames}{self._most_dropped()}',
                    throttle_duration_sec=self._settings.frame_timeout,
                )
        elif lead.steps < self._assembler.rig.sweep_frames:
            lead.azimuth = standstill.azimuth
            self._request_step(lead)

    @staticmethod
    def _moving(lead: _Lead, standstill: Standstill | None) -> bool:
        """Whether the arm still has to answer, or to be seen standing after its step."""
        return lead.step is not None or standstill is None or standstill.start <= lead.after

    def _most_dropped(self) -> str:
        reasons = self._assembler.drops.most_common(1)
        return f'; most frequent: {reasons[0][1]} × {reasons[0][0]}' if reasons else ''

    def _took_one_stripe(self, lead: _Lead, standstill: Standstill) -> bool:
        rig = self._assembler.rig
        columns = abs(standstill.azimuth - lead.azimuth) / rig.column_step
        return abs(columns - rig.stripe_columns) < 0.5

    def _request_step(self, lead: _Lead) -> None:
        lead.steps += 1
        lead.after = self._assembler.track.newest or 0
        lead.waiting_since = time.monotonic()
        lead.step = self._step_client.call_async(Trigger.Request())
        lead.step.add_done_callback(lambda future: self._on_step(lead, future))

    def _on_step(self, lead: _Lead, future: Any) -> None:
        if self._lead is not lead:
            return
        lead.step = None
        answer = future.result()
        if not answer.success:
            self._give_up(f'the arm refused a step: {answer.message}')
            return
        lead.waiting_since = time.monotonic()
        self._advance()

    def _give_up(self, reason: str) -> None:
        self._lead = None
        self._assembler.restart((self._assembler.track.newest or 0) + 1)
        self._publish_progress(math.nan)
        self._last_end = f'given up: {reason}'
        self.get_logger().error(f'sweep given up, nothing is published: {reason}')
        self._report_drops()

    def _diagnose(self) -> Report:
        """Say in words what the sweep does or waits for."""
        level, text = self._waits_for()
        sweep = self._assembler.sweep
        values: dict[str, object] = {
            'columns': int(sweep.seen.sum()) if sweep is not None else 0,
            'sweep_columns': self._assembler.rig.sweep_columns,
            'last_end': self._last_end,
        }
        values |= {f'dropped, {why}': count for why, count in self._assembler.drops.items()}
        return Report(level, text, values)

    def _waits_for(self) -> tuple[bytes, str]:
        sweep, track = self._assembler.sweep, self._assembler.track
        if self._camera_fault:
            return (WARN if self._camera_fault == _NO_CAMERA else ERROR), self._camera_fault
        if track.newest is None:
            return WARN, f'no joint state of {self._settings.joint_name} received yet'
        if self._lead is not None:
            return self._leading_waits_for(self._lead)
        if sweep is not None:
            seen = int(sweep.seen.sum())
            return OK, f'{seen} of {sweep.rig.sweep_columns} columns, as frames come'
        return OK, 'ready' if self._settings.lead else 'listening'

    def _leading_waits_for(self, lead: _Lead) -> tuple[bytes, str]:
        waited = time.monotonic() - lead.waiting_since
        moving = self._moving(lead, self._assembler.track.current)
        patience = self._settings.step_timeout if moving else self._settings.frame_timeout
        return (
            WARN if waited > patience else OK,
            f'column {lead.steps} of {self._assembler.rig.sweep_columns}: '
            f'waiting for {"the arm" if moving else "a frame"} for {waited:.1f} s',
        )

    # --- results ------------------------------------------------------------------------------

    def _publish(self, sweeps: list[Sweep]) -> None:
        for sweep in sweeps:
            self._lead = None
            self._publish_progress(1.0)
            self._publish_panoramas(sweep)

    def _publish_panoramas(self, sweep: Sweep) -> None:
        panoramas = sweep.panoramas()
        header = Header(stamp=to_stamp(sweep.end or 0), frame_id=self._settings.frame_id)
        for name, panorama in panoramas.items():
            encoding = 'bgr8' if panorama.image.ndim == 3 else 'mono8'
            self._info_publishers[name].publish(panorama_info(panorama.geometry, header))
            self._image_publishers[name].publish(
                to_message(panorama.image, encoding, stamp=header.stamp, frame_id=header.frame_id)
            )
        for first, last in sweep.missing_sectors() if not sweep.complete else []:
            self.get_logger().warning(
                f'no frame reached the columns from {math.degrees(first):.1f}° to '
                f'{math.degrees(last):.1f}° of arm azimuth; they are unknown'
            )
        duration = panoramas['left'].geometry.sweep_duration
        self._last_end = f'sweep of {sweep.seen.sum()} columns done in {duration:.1f} s'
        self.get_logger().info(self._last_end)
        self._report_drops()

    def _report_drops(self) -> None:
        for reason, count in sorted(self._assembler.drops.items()):
            self.get_logger().info(f'dropped {count} × {reason}')
        self._assembler.drops.clear()

    def _report_progress(self) -> None:
        if self._assembler.sweep is not None:
            self._publish_progress(self._assembler.sweep.progress)

    def _publish_progress(self, progress: float) -> None:
        if progress != self._reported:
            self._reported = progress
            self._progress_publisher.publish(Float32(data=progress))


def main(args: list[str] | None = None) -> int:
    """Run the mosaicer; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('mosaicer', Mosaicer, args)
