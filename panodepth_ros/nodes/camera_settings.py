"""Parameters of the camera, and the source of frames that they describe."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

from panodepth_ros.camera.automatics import LEAVE, Automatics, Wishes
from panodepth_ros.camera.capture import PIXEL_FORMATS, StreamSource, V4l2Source, VideoFileSource
from panodepth_ros.camera.images import ImageSequenceSource
from panodepth_ros.camera.simulated import Room, RoomCamera
from panodepth_ros.camera.simulated.source import SimulatedSource
from panodepth_ros.camera.source import FrameSource
from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.ros.parameters import parameter


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
    autoexposure: bool = parameter(
        True, 'Let a V4L2 device choose its exposure, and its gain, until they are held'
    )
    exposure: int = parameter(
        LEAVE,
        'Exposure of a V4L2 device; -1: what it has or chooses',
        unit='100 µs',
        bounds=(LEAVE, 10**6),
    )
    gain: int = parameter(
        LEAVE,
        'Gain of a V4L2 device in its own unit; -1: what it has or chooses',
        bounds=(LEAVE, 10**6),
    )
    auto_white_balance: bool = parameter(
        True, 'Let a V4L2 device choose its white balance until it is held'
    )
    white_balance: int = parameter(
        LEAVE,
        'White balance of a V4L2 device; -1: what it has or chooses',
        unit='K',
        bounds=(LEAVE, 10**6),
    )
    autofocus: bool = parameter(False, 'Let a V4L2 device choose its focus until it is held')
    focus: int = parameter(
        LEAVE,
        'Focus of a V4L2 device in its own unit; -1: what it has or chooses',
        bounds=(LEAVE, 10**6),
    )
    auto_settle_time: float = parameter(
        2.0,
        'How long a V4L2 device may choose before it is held to it; no frames until then',
        unit='s',
        bounds=(0.0, 60.0),
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
    simulated_exposure_ms: float = parameter(
        0.0,
        'How long the simulated camera exposes a frame, whose stamp is the middle of it',
        unit='ms',
        bounds=(0.0, 100.0),
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
        for automatic, name in (
            ('autoexposure', 'exposure'),
            ('auto_white_balance', 'white_balance'),
            ('autofocus', 'focus'),
        ):
            value = getattr(self, name)
            if value != LEAVE and getattr(self, automatic):
                raise ValueError(
                    f'{name} is {value} while {automatic} is true; allowed: {automatic} false '
                    f'or {name} {LEAVE}'
                )
        for name in ('exposure', 'gain', 'white_balance', 'focus'):
            value = getattr(self, name)
            if value != LEAVE and self.source != 'v4l2':
                raise ValueError(f'{name} is {value}; allowed with source {self.source}: {LEAVE}')

    @property
    def size(self) -> tuple[int, int]:
        """Width and height asked for [px]."""
        return self.image_width, self.image_height

    @property
    def grey(self) -> bool:
        """Whether frames are grey."""
        return self.pixel_format == 'mono8'

    def wishes(self) -> Wishes:
        """Return what is asked of a V4L2 device."""
        return Wishes(
            autoexposure=self.autoexposure,
            exposure=self.exposure,
            gain=self.gain,
            auto_white_balance=self.auto_white_balance,
            white_balance=self.white_balance,
            autofocus=self.autofocus,
            focus=self.focus,
            grey=self.grey,
            settle_time=self.auto_settle_time,
        )

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


def open_source(
    settings: CameraParameters, automatics: Automatics, room: Room | None, stop: threading.Event
) -> FrameSource:
    """
    Open the source that the parameters describe.

    Parameters
    ----------
    settings : CameraParameters
        The parameters.
    automatics : Automatics
        What a V4L2 device may decide by itself.
    room : Room or None
        What a simulated camera sees.
    stop : threading.Event
        Ends a read.

    Raises
    ------
    SourceError
        If it cannot be opened so; a :class:`SourceLostError` if it may come.
    """
    if settings.source == 'v4l2':
        return V4l2Source(
            settings.video_device,
            size=settings.size,
            framerate=settings.framerate,
            pixel_format=settings.pixel_format,
            automatics=automatics,
            frame_timeout=settings.frame_timeout,
            stop=stop,
        )
    if settings.source == 'stream':
        return StreamSource(
            settings.video_device,
            size=settings.size,
            grey=settings.grey,
            frame_timeout=settings.frame_timeout,
            stop=stop,
        )
    if room is not None:
        return SimulatedSource(
            room,
            settings.simulated_camera(),
            arm_radius=settings.simulated_arm_radius,
            arm_truth=settings.simulated_arm_truth,
            framerate=settings.framerate,
            exposure=settings.simulated_exposure_ms * 1e-3,
            noise_stddev=settings.noise_stddev,
            seed=settings.room_seed,
            grey=settings.grey,
            stop=stop,
        )
    kind = VideoFileSource if settings.source == 'video' else ImageSequenceSource
    return kind(
        settings.video_device,
        size=settings.size,
        framerate=settings.framerate,
        grey=settings.grey,
        stop=stop,
    )
