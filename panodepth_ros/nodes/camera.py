"""The camera: frames of a device, a file, a stream or the simulated room, with calibration."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

from panodepth_ros.camera.calibration import (
    Calibration,
    CalibrationError,
    calibration_path,
    read_calibration,
    store_calibration,
)
from panodepth_ros.camera.capture import PIXEL_FORMATS, StreamSource, V4l2Source, VideoFileSource
from panodepth_ros.camera.images import ImageSequenceSource
from panodepth_ros.camera.simulated import RealCamera, RoomCamera, furnished_room
from panodepth_ros.camera.simulated.source import SimulatedSource
from panodepth_ros.camera.source import (
    Frame,
    FrameSource,
    SourceClosedError,
    SourceError,
    SourceLostError,
)
from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import ERROR, OK, WARN, Report, publish_diagnostics
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.parameters import declare_parameters, parameter
from panodepth_ros.ros.process import run_node

#: First and longest wait between two attempts to reopen a source that was lost [s].
_FIRST_BACKOFF, _LONGEST_BACKOFF = 0.5, 10.0
#: A source slower than this share of its framerate is worth a warning.
_SLOW = 0.9
#: How long the last frames of a file may take to reach their subscribers [s].
_DELIVERY_TIMEOUT = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraParameters:
    """Parameters of the camera; those of usb_cam have its names."""

    source: str = parameter(
        'v4l2',
        'Where frames come from',
        choices=('v4l2', 'video', 'images', 'stream', 'simulated'),
    )
    video_device: str = parameter(
        '/dev/video0',
        'v4l2: number or path, best /dev/v4l/by-id/...; video: file; images: folder or pattern; '
        'stream: URL',
    )
    image_width: int = parameter(
        640, 'Width of the frames; 0: what the source gives', unit='px', bounds=(0, 16384)
    )
    image_height: int = parameter(
        480, 'Height of the frames; 0: what the source gives', unit='px', bounds=(0, 16384)
    )
    framerate: float = parameter(
        30.0,
        "Frames per second; 0: the device's or the video file's own",
        unit='Hz',
        bounds=(0.0, 1000.0),
    )
    pixel_format: str = parameter(
        'auto',
        'Format asked of a V4L2 device; mono8 publishes grey frames, of any source',
        choices=tuple(PIXEL_FORMATS),
    )
    frame_timeout: float = parameter(
        2.0, 'Time without a frame after which a source is lost', unit='s', bounds=(0.1, 60.0)
    )
    camera_name: str = parameter('panodepth_camera', 'Name the calibration should have')
    camera_info_url: str = parameter(
        '',
        'Calibration file, file:///... or package://...; empty: uncalibrated, and exact for the '
        'simulated room',
    )
    frame_id: str = parameter('panodepth_camera_optical_frame', 'Frame of image and camera_info')
    simulated_arm_truth: str = parameter(
        '/tmp/panodepth_arm.truth', 'Where simulated_arm writes its true motion'
    )
    simulated_arm_radius: float = parameter(
        0.30, 'Axis to optical centre in the simulated room', unit='m', bounds=(0.0, 0.5)
    )
    simulated_fov_deg: float = parameter(
        34.0, 'Horizontal field of view in the simulated room', unit='°', bounds=(5.0, 120.0)
    )
    simulated_yaw_deg: float = parameter(
        0.0,
        'Simulated optical axis to the left of the radial direction',
        unit='°',
        bounds=(-45.0, 45.0),
    )
    simulated_roll_deg: float = parameter(
        0.0,
        'Simulated camera turned clockwise, seen from behind',
        unit='°',
        bounds=(-180.0, 180.0),
    )
    simulated_tilt_deg: float = parameter(
        0.0,
        'Simulated optical axis above the plane of rotation',
        unit='°',
        bounds=(-45.0, 45.0),
    )
    simulated_cx_offset: float = parameter(
        0.0,
        'Simulated principal point right of the image centre',
        unit='px',
        bounds=(-1000.0, 1000.0),
    )
    simulated_cy_offset: float = parameter(
        0.0,
        'Simulated principal point below the image centre',
        unit='px',
        bounds=(-1000.0, 1000.0),
    )
    simulated_k1: float = parameter(
        0.0, 'First radial distortion of the simulated lens', bounds=(-1.0, 1.0)
    )
    simulated_k2: float = parameter(
        0.0, 'Second radial distortion of the simulated lens', bounds=(-1.0, 1.0)
    )
    noise_stddev: float = parameter(
        1.5, 'Noise of the simulated sensor in grey levels', bounds=(0.0, 50.0)
    )
    room_seed: int = parameter(0, 'Which simulated room', bounds=(0, 2**31 - 1))

    def __post_init__(self) -> None:
        if self.source == 'simulated':
            for name in ('image_width', 'image_height', 'framerate'):
                if getattr(self, name) == 0:
                    raise ValueError(f'{name} is 0; the simulated room needs one above 0')
        elif self.source == 'images' and self.framerate == 0.0:
            raise ValueError('framerate is 0.0; images need one above 0')

    @property
    def size(self) -> tuple[int, int]:
        """Width and height asked for [px]."""
        return self.image_width, self.image_height

    def simulated_camera(self) -> PinholeCamera:
        """Return the true lens and mounting of the simulated camera."""
        ideal = RoomCamera.from_field_of_view(*self.size, math.radians(self.simulated_fov_deg))
        return PinholeCamera(
            width=ideal.width,
            height=ideal.height,
            fx=ideal.fx,
            fy=ideal.fy,
            cx=ideal.cx + self.simulated_cx_offset,
            cy=ideal.cy + self.simulated_cy_offset,
            distortion=(self.simulated_k1, self.simulated_k2, 0.0, 0.0, 0.0),
            mounting=Mounting(
                yaw=math.radians(self.simulated_yaw_deg),
                roll=math.radians(self.simulated_roll_deg),
                tilt=math.radians(self.simulated_tilt_deg),
            ),
        )


class CameraNode(Node):
    """Publishes frames with their calibration. Topics and parameters: README."""

    def __init__(self, **node_args: Any) -> None:
        self._stop = threading.Event()  # first: the context may destroy a half-built node
        self._source: FrameSource | None = None
        self._worker: threading.Thread | None = None
        super().__init__(
            'camera', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, CameraParameters)
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
        ask = self._settings
        grey = ask.pixel_format == 'mono8'
        if ask.source == 'v4l2':
            return V4l2Source(
                ask.video_device,
                size=ask.size,
                framerate=ask.framerate,
                pixel_format=ask.pixel_format,
                frame_timeout=ask.frame_timeout,
                stop=self._stop,
            )
        if ask.source == 'stream':
            return StreamSource(
                ask.video_device,
                size=ask.size,
                grey=grey,
                frame_timeout=ask.frame_timeout,
                stop=self._stop,
            )
        if self._room is not None and self._room_camera is not None:
            return SimulatedSource(
                self._room,
                self._room_camera,
                arm_radius=ask.simulated_arm_radius,
                arm_truth=ask.simulated_arm_truth,
                framerate=ask.framerate,
                noise_stddev=ask.noise_stddev,
                seed=ask.room_seed,
                grey=grey,
                stop=self._stop,
            )
        kind = VideoFileSource if ask.source == 'video' else ImageSequenceSource
        return kind(
            ask.video_device, size=ask.size, framerate=ask.framerate, grey=grey, stop=self._stop
        )

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

    def _begin(self) -> None:
        self._worker = threading.Thread(target=self._work, name='camera')
        self._worker.start()

    # --- worker thread ------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            while (frame := self._next_frame()) is not None:
                self._publish(frame)
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

    def _report(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self.get_logger().error(trouble)

    def _publish(self, frame: Frame) -> None:
        # The exposure's age is the same on both clocks.
        age = round((time.monotonic() - frame.stamp) * 1e9)
        stamp = Time(nanoseconds=max(self.get_clock().now().nanoseconds - age, 0)).to_msg()
        frame_id = self._settings.frame_id
        encoding = 'mono8' if frame.image.ndim == 2 else 'bgr8'
        image = to_message(frame.image, encoding, stamp=stamp, frame_id=frame_id)
        info = self._camera_info  # the service may replace it
        info.header.stamp = stamp
        info.header.frame_id = frame_id
        self._image_publisher.publish(image)
        self._info_publisher.publish(info)
        self._frames += 1

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
