"""The mosaicer: frames and arm angles in, left, right and centre panoramas out."""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from std_msgs.msg import Float32, Header, String
from std_srvs.srv import Trigger

from panodepth_ros.mosaic import Assembler, ContinuousAssembler, Sweep
from panodepth_ros.mosaic.rig import panorama_names
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.closing import ClosureCheck
from panodepth_ros.nodes.comeback import Comeback
from panodepth_ros.nodes.delay import DelayCorrection
from panodepth_ros.nodes.keeping import SweepKeeper
from panodepth_ros.nodes.leading import Leader
from panodepth_ros.nodes.lighting import LightReport
from panodepth_ros.nodes.mosaicer_settings import MosaicerParameters
from panodepth_ros.nodes.panoramas import PanoramaPublisher, PartialPublisher
from panodepth_ros.nodes.robot_watch import RobotWatch
from panodepth_ros.nodes.spinning import SpinLeader
from panodepth_ros.nodes.stamps import StampCheck
from panodepth_ros.nodes.stepping import StepLeader
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import ERROR, OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.images import decompressed, to_bgr_or_mono
from panodepth_ros.ros.messages import (
    joint_reading,
    pinhole_camera,
    to_nanoseconds,
    to_stamp,
)
from panodepth_ros.ros.parameters import declare_parameters
from panodepth_ros.ros.process import run_node

_NO_CAMERA = 'no camera_info received yet'
#: How often waiting is checked against its timeouts [s].
_WATCH_PERIOD = 0.25


class Mosaicer(Node):
    """Leads or follows sweeps, publishes panoramas. Topics and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        self._leading = False  # first: the context may destroy a half-built node
        super().__init__(
            'mosaicer', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(
            self, MosaicerParameters, self._on_parameters, self._check_parameters
        )
        self._assembler = self._settings.builder()
        self._assembler.clock_set = self._on_clock_set
        self._stamps = StampCheck(
            self, live=self._settings.lead, longest_gap=self._settings.joint_state_gap
        )
        self._delay = DelayCorrection(self, self._assembler)
        self._camera_fault = _NO_CAMERA
        self._reported = -1.0
        self._last_end = 'none yet'
        names = panorama_names(len(self._settings.further_offsets_px))
        self._panoramas = {name: PanoramaPublisher(self, name) for name in names}
        self._partial: PartialPublisher | None = None
        if self._settings.partial_deg:
            self._partial = PartialPublisher(
                self, step_deg=self._settings.partial_deg, frame_id=self._settings.frame_id
            )
        self._progress_publisher = self.create_publisher(Float32, '~/progress', 10)
        self._status_publisher = self.create_publisher(String, '~/status', 10)
        self._last_panoramas: list[tuple[Publisher, Any]] = []
        self._keeper = SweepKeeper(self, self._settings.state_file)
        self._arm_watch = ArmWatch(self, self._settings.joint_state_gap)
        self._leader = self._make_leader()
        self._comeback = Comeback(
            self,
            self._assembler,
            self._leader,
            self._arm_watch,
            self._keeper,
            lambda: self._panoramas['left'].heard and self._panoramas['right'].heard,
            self._begin,
            self._give_up,
        )
        self._closure = ClosureCheck(self)
        self._light = LightReport(self)
        self._robot = RobotWatch(
            self, self._assembler, self._settings, lambda: self._publish([]), self._give_up
        )
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
        self.create_service(Trigger, '~/publish_last', self._on_publish_last)
        self.create_timer(_WATCH_PERIOD, self._advance)
        publish_diagnostics(self, 'sweep', self._diagnose)
        self.get_logger().info(
            'ready; a sweep begins with ~/start' if self._settings.lead else 'ready; listening'
        )

    # --- parameters ---------------------------------------------------------------------------

    def _check_parameters(self, proposed: MosaicerParameters) -> None:
        camera = self._assembler.camera
        if camera is not None:
            Sweep(proposed.rig(), camera, 0.0)

    def _on_parameters(self, parameters: MosaicerParameters) -> None:
        builder = self._assembler
        parameters.renew_timing(builder)
        if not self._leading or builder.sweep is not None:
            builder.rig = parameters.rig()  # else a led sweep waits for its first frame
        self._delay.forget()
        self._robot.configure(parameters)
        self._settings = parameters

    # --- data ---------------------------------------------------------------------------------

    def _on_camera_info(self, message: CameraInfo) -> None:
        under_way = self._assembler.sweep is not None
        try:
            camera = pinhole_camera(message)
            if camera != self._assembler.camera:
                self._delay.forget()
            self._publish(self._assembler.set_camera(camera))
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
        stamp = to_nanoseconds(message.header.stamp)
        if objection := self._stamps.against_frame(stamp, self._assembler.track):
            self._assembler.drops[f'frame: {objection}'] += 1
        else:
            self._publish(self._assembler.add_frame(stamp, image))
        self._advance()

    def _on_joint_state(self, message: JointState) -> None:
        try:
            reading = joint_reading(message, self._settings.joint_name)
        except ValueError as error:
            self._assembler.drops[str(error)] += 1
            return
        if reading is None:
            return
        stamp, azimuth, velocity = reading
        if ahead := self._stamps.ahead(stamp):
            self._assembler.drops["joint state: stamped ahead of this computer's clock"] += 1
            self._on_clock_set(
                f"the joint states are stamped {ahead:.1f} s ahead of this computer's clock",
                self._assembler.sweep is not None,
            )
            return
        self._comeback.see(stamp, azimuth, velocity, leading=self._leading)
        self._publish(self._assembler.add_joint_state(stamp, azimuth, velocity))
        self._advance()

    def _on_clock_set(self, what: str, under_way: bool) -> None:
        if self._leading or under_way:
            self._give_up(f'{what}; let all computers have one time')
        else:
            self.get_logger().warning(what, throttle_duration_sec=5.0)

    # --- services -----------------------------------------------------------------------------

    def _on_start(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.message = self._why_not_start()
        response.success = not response.message
        newest = self._assembler.track.newest
        if response.message or newest is None:
            return response
        response.message = self._begin(newest)
        return response

    def _begin(self, newest: int) -> str:
        """Begin a led sweep of what comes after a joint state; describe it."""
        self._assembler.restart(newest + 1)
        self._assembler.rig = self._settings.rig()
        self._delay.forget()
        self._assembler.drops.clear()
        self._leading = True
        self._keep_sweep(self._assembler.track.position)
        message = self._leader.begin()
        self._publish_progress(0.0)
        self.get_logger().info(message)
        return message

    def _why_not_start(self) -> str:
        """Return a sentence for the user, empty if nothing is in the way."""
        if not self._settings.lead:
            return 'lead is false: this mosaicer only listens'
        if self._leading:
            return 'a sweep is running; cancel it first'
        if self._camera_fault:
            return f'the camera cannot be used: {self._camera_fault}'
        if self._assembler.track.newest is None:
            return f'no joint state of {self._settings.joint_name} received yet'
        if self._leader.missing_service:
            return f'the service {self._leader.missing_service} is not there'
        return self._robot.why_not_start()

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = (
            self._leading or self._keeper.pending or self._assembler.sweep is not None
        )
        response.message = 'sweep cancelled' if response.success else 'no sweep is running'
        if response.success:
            self._give_up('cancelled')
        return response

    def _on_publish_last(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Publish the last panoramas again, for who was not there."""
        for publisher, message in self._last_panoramas:
            publisher.publish(message)
        response.success = bool(self._last_panoramas)
        response.message = 'published' if response.success else 'there are no panoramas yet'
        return response

    # --- leading ------------------------------------------------------------------------------

    def _make_leader(self) -> Leader:
        builder, in_force = self._assembler, lambda: self._settings
        if isinstance(builder, ContinuousAssembler):
            return SpinLeader(self, builder, in_force, self._give_up, self._arm_watch)
        assert isinstance(builder, Assembler)
        return StepLeader(
            self,
            builder,
            in_force,
            self._give_up,
            self._arm_watch,
            self._keep_sweep,
            self._publish,
        )

    def _advance(self) -> None:
        """Take the led sweep as far as what has arrived allows."""
        self._report_progress()
        if self._partial is not None:
            self._partial.update(self._assembler.sweep)
        if self._leading:
            self._leader.advance()
            self._keeper.update(self._assembler.sweep)
        elif self._keeper.pending and not self._why_not_start() and self._comeback.of_mosaicer():
            self._leading = True

    def _stop_leading(self) -> None:
        self._keeper.forget()
        if self._leading:
            self._leading = False
            self._leader.end()

    def _keep_sweep(self, azimuth: float) -> None:
        self._keeper.keep(self._assembler.sweep, azimuth, self._arm_watch.sources())

    def _give_up(self, reason: str) -> None:
        self._delay.forget()
        self._robot.forget()
        self._assembler.restart((self._assembler.track.newest or 0) + 1)
        self._stop_leading()
        self._publish_progress(math.nan)
        self._last_end = f'given up: {reason}'
        self.get_logger().error(f'sweep given up, nothing is published: {reason}')
        self._report_drops()

    def _diagnose(self) -> Report:
        """Say in words what the sweep does or waits for, here and on a topic of its own."""
        level, text = self._waits_for()
        self._status_publisher.publish(String(data=text))
        sweep = self._assembler.sweep
        values: dict[str, object] = {
            'columns': int(sweep.seen.sum()) if sweep is not None else 0,
            'sweep_columns': self._assembler.rig.sweep_columns,
            'last_end': self._last_end,
            'robot': self._robot.state,
            'closure': self._closure.told,
            'light': self._light.told,
        }
        values |= {f'dropped, {why}': count for why, count in self._assembler.drops.items()}
        return Report(level, text, values)

    def _waits_for(self) -> tuple[bytes, str]:
        sweep, track = self._assembler.sweep, self._assembler.track
        if self._camera_fault:
            return (WARN if self._camera_fault == _NO_CAMERA else ERROR), self._camera_fault
        if track.newest is None:
            return WARN, f'no joint state of {self._settings.joint_name} received yet'
        if self._leading:
            return self._leader.waits_for()
        if sweep is not None:
            seen = int(sweep.seen.sum())
            return OK, f'{seen} of {sweep.rig.sweep_columns} columns, as frames come'
        if not self._settings.lead:
            return OK, 'listening'
        why_not = self._why_not_start()
        return (WARN, why_not) if why_not else (OK, 'ready; a sweep begins with ~/start')

    def destroy_node(self) -> None:
        """Forget the sweep under way, for the end is wanted; destroy the node. May run twice."""
        if self._leading:
            self._keeper.forget()
        super().destroy_node()

    # --- results ------------------------------------------------------------------------------

    def _publish(self, sweeps: list[Sweep]) -> None:
        for sweep in self._robot.passed(sweeps, self._leading):
            refusal = self._closure.refusal(sweep, self._settings)
            if refusal:
                self._give_up(refusal)
                continue
            if not self._settings.free_running:
                self._stop_leading()
            self._publish_progress(1.0)
            self._publish_panoramas(sweep)

    def _publish_panoramas(self, sweep: Sweep) -> None:
        panoramas = sweep.panoramas(lost=self._closure.lost)
        self._light.tell(sweep)
        self._delay.tell(panoramas['center'], sweep, correct=self._settings.correct_delay)
        header = Header(stamp=to_stamp(sweep.end or 0), frame_id=self._settings.frame_id)
        self._last_panoramas = []
        for name, panorama in panoramas.items():
            self._last_panoramas += self._panoramas[name].messages(panorama, header)
        for publisher, message in self._last_panoramas:
            publisher.publish(message)
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
