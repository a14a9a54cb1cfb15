"""The calibrator: turns the arm by known angles and writes what they tell of the camera."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Future as Job
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_srvs.srv import Trigger

from panodepth_ros.calibration import Given, SelfCalibration, calibrate_by
from panodepth_ros.calibration.self_calibration import KNOWN_CENTRE, UNKNOWN_CENTRE
from panodepth_ros.calibration.tracks import Tracker
from panodepth_ros.camera.calibration import Calibration, store_calibration
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Sweep
from panodepth_ros.mosaic.builder import NEVER
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.calibrator_settings import CalibratorParameters
from panodepth_ros.nodes.robot_watch import RobotWatch
from panodepth_ros.nodes.stepping import StepLeader
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.images import to_bgr_or_mono
from panodepth_ros.ros.messages import joint_reading, pinhole_camera, to_nanoseconds
from panodepth_ros.ros.parameters import declare_parameters
from panodepth_ros.ros.process import run_node

#: How often waiting is checked against its timeouts [s].
_WATCH_PERIOD = 0.25
#: The first turn tells the lens well enough for the patches that are followed in the second.
_TURNS = 2


class Calibrator(Node):
    """Calibrates the camera by a sweep of its own. Topics and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        # First: the context may destroy a half-built node.
        self._worker = ThreadPoolExecutor(1, 'calibrator')
        super().__init__(
            'calibrator', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, CalibratorParameters, self._on_parameters)
        self._assembler = self._settings.assembler()
        self._assembler.taken = self._on_taken
        self._assembler.restart(NEVER)
        self._camera_fault = 'no camera_info received yet'
        self._answer: Future | None = None  # of the calibration under way
        self._tracker: Tracker | None = None  # while the arm is led
        self._turns = 0  # that the arm has made for it
        self._found: SelfCalibration | None = None  # by the last of them
        self._job: Job[Any] | None = None  # what the worker does
        self._last_end = 'none yet'
        self._worker_is_done = self.create_guard_condition(self._advance)
        self._arm_watch = ArmWatch(self, self._settings.joint_state_gap)
        self._leader = StepLeader(
            self,
            self._assembler,
            lambda: self._settings,
            self._give_up,
            self._arm_watch,
            lambda _: None,
            self._turned,
        )
        self._robot = RobotWatch(
            self, self._assembler, self._settings, lambda: self._turned([]), self._give_up
        )
        self.create_subscription(
            JointState, 'joint_states', self._on_joint_state, qos.JOINT_STATES
        )
        self.create_subscription(CameraInfo, 'camera_info', self._on_camera_info, qos.IMAGES)
        self.create_subscription(Image, 'image_raw', self._on_image, qos.IMAGES)
        group = ReentrantCallbackGroup()
        self.create_service(Trigger, '~/calibrate', self._on_calibrate, callback_group=group)
        self.create_service(Trigger, '~/cancel', self._on_cancel)
        self.create_timer(_WATCH_PERIOD, self._advance)
        publish_diagnostics(self, 'calibration', self._diagnose)
        self.get_logger().info('ready; ~/calibrate turns the arm')

    def destroy_node(self) -> None:
        """End the worker, end the node. May run twice."""
        self._worker.shutdown(cancel_futures=True)
        super().destroy_node()

    def _on_parameters(self, parameters: CalibratorParameters) -> None:
        self._robot.configure(parameters)
        self._settings = parameters

    # --- data ---------------------------------------------------------------------------------

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            camera = pinhole_camera(message, self._settings.view_angle)
            before = self._assembler.camera
            self._turned(self._assembler.set_camera(camera))
        except ValueError as error:
            self._camera_fault = str(error)
            return
        self._camera_fault = ''
        if before is not None and camera != before and self._tracker is not None:
            self._give_up('camera_info has changed')

    def _on_image(self, message: Image) -> None:
        if self._tracker is None:
            return
        try:
            image = to_bgr_or_mono(message)
        except ValueError as error:
            self._assembler.drops[f'frame: {error}'] += 1
            return
        self._turned(self._assembler.add_frame(to_nanoseconds(message.header.stamp), image))
        self._advance()

    def _on_joint_state(self, message: JointState) -> None:
        try:
            reading = joint_reading(message, self._settings.joint_name)
        except ValueError as error:
            self._assembler.drops[str(error)] += 1
            return
        if reading is None:
            return
        absence = self._arm_watch.see(reading.stamp)
        if absence is not None and self._tracker is not None:
            self._give_up(f'the arm was out of sight for {absence.seconds:.1f} s')
        self._turned(self._assembler.add_joint_state(*reading))
        self._advance()

    # --- services -----------------------------------------------------------------------------

    async def _on_calibrate(
        self, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Turn the arm, estimate, write; answer when all is done."""
        response.message = self._why_not()
        if response.message:
            return response
        assert self._assembler.camera is not None
        self._answer = answer = Future(executor=self.executor)
        self._turns, self._found = 0, None
        self._assembler.drops.clear()
        self._turn(self._assembler.camera)
        response.success, response.message = await answer
        return response

    def _why_not(self) -> str:
        """Return a sentence for the user, empty if nothing is in the way."""
        if self._answer is not None:
            return 'a calibration is running; cancel it first'
        if self._camera_fault:
            return f'the camera cannot be used: {self._camera_fault}'
        if self._assembler.track.newest is None:
            return f'no joint state of {self._settings.joint_name} received yet'
        if self._leader.missing_service:
            return f'the service {self._leader.missing_service} is not there'
        folder = self._output().parent
        if not folder.is_dir():
            return f'output is in the folder {folder}, which does not exist'
        return self._robot.why_not_start()

    def _on_cancel(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._answer is not None
        response.message = 'cancelled' if response.success else 'no calibration is running'
        if response.success:
            self._give_up('cancelled')
        return response

    # --- the calibration under way ------------------------------------------------------------

    def _turn(self, camera: PinholeCamera) -> None:
        """Follow points through another turn, with patches as this camera sees them."""
        self._turns += 1
        self._tracker = Tracker(camera)
        self._assembler.restart((self._assembler.track.newest or 0) + 1)
        self.get_logger().info(f'turn {self._turns} of {_TURNS}: {self._leader.begin()}')

    def _on_taken(self, image: Any, azimuth: float) -> None:
        if self._tracker is not None:
            self._let_work(self._tracker.add, image, azimuth)

    def _let_work(self, what: Callable[..., Any], *arguments: Any) -> None:
        self._job = self._worker.submit(what, *arguments)
        self._job.add_done_callback(lambda _: self._worker_is_done.trigger())

    def _turned(self, sweeps: list[Sweep]) -> None:
        """Estimate when the arm has come round."""
        if not self._robot.passed(sweeps, self._tracker is not None) or self._tracker is None:
            return
        self._leader.end()
        self._let_work(
            _estimate, self._tracker, self._assembler.camera, self._settings, self._found
        )
        self._tracker = None

    def _advance(self) -> None:
        """Lead the arm on as soon as the last frame is dealt with; end when the estimate is."""
        if self._answer is None or (self._job is not None and not self._job.done()):
            return
        try:
            done = self._job.result() if self._job is not None else None
            if self._tracker is not None:
                self._leader.advance()
                self._check_patience()
            elif done is not None:
                self._found, self._job = done, None
                if self._turns < _TURNS:
                    self._turn(done.camera)
                else:
                    self._end(True, self._write(done))
        except (ValueError, OSError) as error:
            self._give_up(str(error))

    def _check_patience(self) -> None:
        """Give up where a mosaicer would wait on: who called awaits an answer."""
        level, text = self._leader.waits_for()
        if level != OK and self._tracker is not None:
            self._give_up(text)

    def _output(self) -> Path:
        return Path(self._settings.output).expanduser().absolute()

    def _write(self, found: SelfCalibration) -> str:
        """Write the calibration file; return what it says, for people."""
        fx, mounting = found.estimates['focal_length'], found.camera.mounting
        share = fx.deviation / fx.value
        if not share <= self._settings.largest_stddev:
            raise ValueError(
                f'fx {fx.value:.1f} px is known to ± {100 * share:.2f} % only; allowed: '
                f'{100 * self._settings.largest_stddev:g} % (largest_stddev). More texture, '
                'nearer things and a full turn tell more'
            )
        path = self._output()
        store_calibration(Calibration.of_pinhole(found.camera, self._settings.camera_name), path)
        angle, spread = map(math.degrees, (found.view_angle.value, found.view_angle.deviation))
        unobserved = [name for name, estimate in found.estimates.items() if not estimate.observed]
        yaw, roll, tilt = (math.degrees(x) for x in (mounting.yaw, mounting.roll, mounting.tilt))
        return (
            f'fx is {fx.value:.2f} px ± {100 * share:.2f} %, view angle {angle:.2f}° ± '
            f'{spread:.2f}°, from {len(found.tracks)} points; not observed: '
            f'{", ".join([*unobserved, "arm_radius"])}; written to camera_info_url file://{path}; '
            f'the depth node takes focal_length_stddev {share:.4f}, the mosaicer '
            f'camera_yaw_deg {yaw:.3f}, camera_roll_deg {roll:.3f}, camera_tilt_deg {tilt:.3f}'
        )

    def _give_up(self, reason: str) -> None:
        drops = ''.join(f'; {n} × {why}' for why, n in self._assembler.drops.most_common(1))
        self._end(False, f'nothing is written: {reason}{drops}')

    def _end(self, success: bool, message: str) -> None:
        self._robot.forget()
        self._assembler.restart(NEVER)
        if self._tracker is not None:
            self._tracker = None
            self._leader.end()
        self._job = None
        self._last_end = message
        if success:
            self.get_logger().info(message)
        else:
            self.get_logger().error(message)
        answer, self._answer = self._answer, None
        if answer is not None:
            answer.set_result((success, message))

    def _diagnose(self) -> Report:
        level, text = OK, 'ready'
        if self._tracker is not None:
            level, text = self._leader.waits_for()
        elif self._answer is not None:
            text = 'estimating'
        elif why_not := self._why_not():
            level, text = WARN, why_not
        values: dict[str, object] = {'last_end': self._last_end, 'robot': self._robot.state}
        values |= {f'dropped, {why}': count for why, count in self._assembler.drops.items()}
        return Report(level, text, values)


def _estimate(
    tracker: Tracker,
    camera: PinholeCamera,
    settings: CalibratorParameters,
    before: SelfCalibration | None,
) -> SelfCalibration:
    """Estimate the camera from the sweep alone; runs in the worker's thread."""
    centre = KNOWN_CENTRE if settings.view_angle is None else UNKNOWN_CENTRE
    given = Given(focal_length=math.inf, principal_point=centre)
    return calibrate_by(
        tracker.tracks(), camera, given, before.camera if before is not None else None
    )


def main(args: list[str] | None = None) -> int:
    """Run the calibrator; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('calibrator', Calibrator, args)
