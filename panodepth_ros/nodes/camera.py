"""The camera: frames of a device, a file, a stream or the simulated room, with calibration."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger

from panodepth_ros.camera.automatics import Automatics
from panodepth_ros.camera.calibration import (
    Calibration,
    CalibrationError,
    calibration_path,
    read_calibration,
    store_calibration,
)
from panodepth_ros.camera.simulated import RealCamera, furnished_room
from panodepth_ros.camera.source import (
    Frame,
    FrameSource,
    SourceClosedError,
    SourceError,
    SourceLostError,
)
from panodepth_ros.nodes.camera_settings import CameraParameters, open_source
from panodepth_ros.ros import answers, qos
from panodepth_ros.ros.diagnostics import ERROR, OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.parameters import declare_parameters
from panodepth_ros.ros.process import run_node

#: First and longest wait between two attempts to reopen a source that was lost [s].
_FIRST_BACKOFF, _LONGEST_BACKOFF = 0.5, 10.0
#: A source slower than this share of its framerate is worth a warning.
_SLOW = 0.9
#: Two clocks that are read within this time are read at once [s]; how often that is tried.
_ONE_MOMENT, _CLOCK_READINGS = 2e-4, 20
#: How long the last frames of a file may take to reach their subscribers [s].
_DELIVERY_TIMEOUT = 2.0


class CameraNode(Node):
    """Publishes frames with their calibration. Topics and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        self._stop = threading.Event()  # first: the context may destroy a half-built node
        self._source: FrameSource | None = None
        self._worker: threading.Thread | None = None
        super().__init__(
            'camera', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, CameraParameters)
        self._automatics = Automatics(self._settings.wishes())
        self._told = ''  # of the automatics
        self._settling: list[Future] = []  # who waits for them
        self._frames = 0
        self._counted = (0, time.monotonic())  # frames and time of the last diagnostics
        self._trouble = ''
        self._failure: SourceError | None = None
        try:
            self._room_camera, self._room = None, None
            if self._settings.source == 'simulated':
                self._room_camera = self._settings.simulated_camera()
                self._room = furnished_room(self._settings.room_seed)
                RealCamera(self._room_camera).render(
                    self._room, 0.0, self._settings.simulated_arm_radius
                )
            calibration = self._calibration()
            source = self._source = self._open()
            self._camera_info = self._checked_camera_info(calibration, source)
            self._image_publisher = self.create_publisher(Image, 'image_raw', qos.IMAGES)
            self._info_publisher = self.create_publisher(CameraInfo, 'camera_info', qos.IMAGES)
            self.create_service(SetCameraInfo, '~/set_camera_info', self._on_set_camera_info)
            publish_diagnostics(self, 'frames', self._diagnose)
            if self._settings.source == 'v4l2':
                self.create_service(
                    Trigger, '~/settle', self._on_settle, callback_group=ReentrantCallbackGroup()
                )
                publish_diagnostics(self, 'exposure', self._diagnose_automatics)
            self._over = self.create_guard_condition(self._on_over)
            self.get_logger().info(
                f'{source.name} delivers {source.size[0]} by {source.size[1]} pixels'
            )
            # The first callback starts the worker: a signal that comes before the node is in
            # the hands of its executor must not leave a thread that nobody ends.
            self.create_guard_condition(self._begin).trigger()
        except BaseException:
            self._close()
            raise

    def destroy_node(self) -> None:
        """End the worker, close the device, end the node. Idempotent."""
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        self._stop.set()
        if self._worker is not None and self._worker.ident is not None:
            self._worker.join()
        if self._source is not None:
            self._source.close()

    # --- source and calibration ---------------------------------------------------------------

    def _open(self) -> FrameSource:
        return open_source(self._settings, self._automatics, self._room, self._stop)

    def _calibration(self) -> Calibration | None:
        ask = self._settings
        if ask.camera_info_url:
            calibration = read_calibration(calibration_path(ask.camera_info_url))
            if calibration.camera_name not in ('', ask.camera_name):
                self.get_logger().warning(
                    f'camera_name is {ask.camera_name}, but {ask.camera_info_url} '
                    f'is a calibration of {calibration.camera_name}'
                )
            return calibration
        camera = self._room_camera
        if camera is None:
            self.get_logger().warning(
                'camera_info_url is empty: the camera is uncalibrated, so no distances can come '
                'of its frames'
            )
            return None
        return Calibration.of_pinhole(camera, ask.camera_name)

    def _checked_camera_info(
        self, calibration: Calibration | None, source: FrameSource
    ) -> CameraInfo:
        width, height = source.size
        if calibration is None:
            return CameraInfo(width=width, height=height)
        if (calibration.image_width, calibration.image_height) != (width, height):
            raise CalibrationError(
                f'camera_info_url {self._settings.camera_info_url} is a calibration of '
                f'{calibration.image_width} by {calibration.image_height} pixels; '
                f'{source.name} gives {width} by {height}'
            )
        return _to_camera_info(calibration)

    def _on_set_camera_info(
        self, request: SetCameraInfo.Request, response: SetCameraInfo.Response
    ) -> SetCameraInfo.Response:
        """Use a calibration from the next frame on, and keep it where camera_info_url says."""
        url, name = self._settings.camera_info_url, self._settings.camera_name
        proposed, present = request.camera_info, self._camera_info
        try:
            if (proposed.width, proposed.height) != (present.width, present.height):
                raise CalibrationError(
                    f'calibration is of {proposed.width} by {proposed.height} pixels; allowed: '
                    f'{present.width} by {present.height}, the size of the frames'
                )
            path = calibration_path(url) if url else None
            calibration = store_calibration(_to_calibration(proposed, name), path)
        except (CalibrationError, OSError) as error:
            response.status_message = f'calibration refused: {error}'
            self.get_logger().error(response.status_message)
            return response
        self._camera_info = _to_camera_info(calibration)
        response.success = True
        kept = f'stored at {url}' if url else 'not stored, for camera_info_url is empty'
        response.status_message = f'calibration in use, {kept}'
        self.get_logger().info(response.status_message)
        return response

    async def _on_settle(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Let the camera choose again; answer when that is held."""
        done: Future = Future(executor=self.executor)
        self._automatics.settle()
        self._settling.append(done)
        response.success, response.message = await done
        return response

    def _begin(self) -> None:
        self._worker = threading.Thread(target=self._work, name='camera')
        self._worker.start()

    # --- worker thread ------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            while (frame := self._next_frame()) is not None:
                self._publish(frame)
                self._tell_automatics()
        except SourceClosedError:
            return
        except SourceError as error:
            self._failure = error
        except (rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle):
            if self.context.ok():  # else the process is ending
                raise
            return
        with suppress(rclpy_implementation.InvalidHandle):
            self._over.trigger()

    def _next_frame(self) -> Frame | None:
        """Read a frame; a source that was lost is opened again as often as it takes."""
        while True:
            try:
                source = self._source or self._reopened()
                frame = source.read()
            except SourceLostError as error:
                self._report(f'{error}; trying to open it again')
                self._answer_settling(False, str(error))
                if self._source is not None:
                    self._source.close()
                    self._source = None
            else:
                if self._trouble:
                    self._trouble = ''
                    self.get_logger().info(f'{source.name} delivers again')
                return frame

    def _reopened(self) -> FrameSource:
        backoff = _FIRST_BACKOFF
        while not self._stop.wait(backoff):
            backoff = min(2.0 * backoff, _LONGEST_BACKOFF)
            try:
                self._source = self._open()
            except SourceLostError as error:
                self.get_logger().debug(f'opening failed: {error}')
                continue
            size = self._camera_info.width, self._camera_info.height
            if self._source.size != size:
                raise SourceError(
                    f'{self._source.name} came back with {self._source.size[0]} by '
                    f'{self._source.size[1]} pixels; it had {size[0]} by {size[1]}'
                )
            return self._source
        raise SourceClosedError('the camera node ends')

    def _tell_automatics(self) -> None:
        """Say once what the camera holds, and to those who asked it to settle."""
        automatics = self._automatics
        if self._settings.source != 'v4l2' or automatics.settling:
            return
        words = automatics.words()
        if words != self._told:
            self._told = words
            log = self.get_logger()
            (log.warning if automatics.failures else log.info)(words)
        self._answer_settling(not automatics.failures, words)

    def _answer_settling(self, success: bool, words: str) -> None:
        while self._settling:
            answers.give(self, self._settling.pop(), (success, words))

    def _report(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self.get_logger().error(trouble)

    def _publish(self, frame: Frame) -> None:
        # The exposure's age is the same on both clocks.
        monotonic, now = self._both_clocks()
        age = round((monotonic - frame.stamp) * 1e9)
        stamp = Time(nanoseconds=max(now - age, 0)).to_msg()
        frame_id = self._settings.frame_id
        encoding = 'mono8' if frame.image.ndim == 2 else 'bgr8'
        image = to_message(frame.image, encoding, stamp=stamp, frame_id=frame_id)
        info = self._camera_info  # the service may replace it
        info.header.stamp = stamp
        info.header.frame_id = frame_id
        self._image_publisher.publish(image)
        self._info_publisher.publish(info)
        self._frames += 1

    def _both_clocks(self) -> tuple[float, int]:
        """Read ``time.monotonic()`` [s] and the node's clock [ns] in one moment, undisturbed."""
        best = math.inf, 0.0, 0
        for _ in range(_CLOCK_READINGS):
            before = time.monotonic()
            now = self.get_clock().now().nanoseconds
            after = time.monotonic()
            best = min(best, (after - before, 0.5 * (before + after), now))
            if best[0] < _ONE_MOMENT:
                break
        return best[1:]

    # --- executor's thread --------------------------------------------------------------------

    def _on_over(self) -> None:
        """End the process: with code 0 at the end of a file, with 1 if the source broke."""
        if self._failure is not None:
            raise self._failure
        self.get_logger().info(f'{self._settings.video_device} ended after {self._frames} frames')
        for publisher in (self._image_publisher, self._info_publisher):
            publisher.wait_for_all_acked(Duration(seconds=_DELIVERY_TIMEOUT))
        self.context.try_shutdown()

    def _diagnose(self) -> Report:
        frames, now = self._frames, time.monotonic()
        before, since = self._counted
        self._counted = (frames, now)
        rate = (frames - before) / (now - since)
        source, wanted = self._source, self._settings.framerate
        size = source.size if source else self._settings.size
        if self._trouble:
            level, summary = ERROR, self._trouble
        elif frames and rate < _SLOW * wanted:
            level, summary = WARN, f'{rate:.1f} Hz instead of {wanted:g} Hz'
        else:
            level, summary = OK, f'{rate:.1f} Hz'
        values: dict[str, object] = {
            'rate_hz': f'{rate:.2f}',
            'frames': frames,
            'skipped': source.skipped if source else 0,
            'size': f'{size[0]}x{size[1]}',
            'last_error': self._trouble,
        }
        return Report(
            level, summary, values, source.name if source else self._settings.video_device
        )

    def _diagnose_automatics(self) -> Report:
        automatics = self._automatics
        level = WARN if automatics.failures and not automatics.settling else OK
        values: dict[str, object] = {
            name: 'held' if value is None else value for name, value in automatics.held.items()
        }
        return Report(
            level, automatics.words(), values | automatics.failures, self._settings.video_device
        )


def _to_camera_info(calibration: Calibration) -> CameraInfo:
    return CameraInfo(
        width=calibration.image_width,
        height=calibration.image_height,
        distortion_model=calibration.distortion_model,
        d=list(calibration.distortion_coefficients),
        k=calibration.camera_matrix,
        r=calibration.rectification_matrix,
        p=calibration.projection_matrix,
    )


def _to_calibration(info: CameraInfo, camera_name: str) -> Calibration:
    return Calibration(
        image_width=info.width,
        image_height=info.height,
        camera_name=camera_name,
        camera_matrix=tuple(map(float, info.k)),
        distortion_model=info.distortion_model,
        distortion_coefficients=tuple(map(float, info.d)),
        rectification_matrix=tuple(map(float, info.r)),
        projection_matrix=tuple(map(float, info.p)),
    )


def main(args: list[str] | None = None) -> int:
    """Run the camera; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('camera', CameraNode, args)
