"""The views node: a depth panorama in, pinhole views with true depth out."""

from __future__ import annotations

import importlib
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from panodepth_ros.geometry import Panorama, PanoramaGeometry, Points, locate
from panodepth_ros.geometry.pinhole_views import Face, render, ring_of_faces
from panodepth_ros.ros import qos
from panodepth_ros.ros.diagnostics import ERROR, OK, Report, publish_diagnostics
from panodepth_ros.ros.images import to_array, to_bgr_or_mono, to_message
from panodepth_ros.ros.messages import panorama_geometry
from panodepth_ros.ros.parameters import declare_parameters, parameter
from panodepth_ros.ros.pinhole_views import face_info, face_transform
from panodepth_ros.ros.process import run_node
from panodepth_ros.ros.sync import StampMatcher

_TOPICS = {'left/image': Image, 'depth/image': Image, 'depth/camera_info': CameraInfo}
_OUTPUTS = {'image': Image, 'depth': Image, 'camera_info': CameraInfo}


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewsParameters:
    """Parameters of the views node."""

    faces: int = parameter(4, 'Views that share the full turn', bounds=(4, 36))
    width: int = parameter(
        0,
        'Width of a view; 0 for the resolution of the panorama',
        unit='px',
        bounds=(0, 8192),
        live=True,
    )
    frame_prefix: str = parameter(
        'panodepth_view_', "Frame of view k is this, k and '_optical_frame'"
    )

    def __post_init__(self) -> None:
        if self.width == 1:
            raise ValueError('width of a face is 1 px; allowed: 0 or at least 2')

    def frame(self, k: int) -> str:
        """Return the optical frame of view k."""
        return f'{self.frame_prefix}{k}_optical_frame'


class Views(Node):
    """Publishes pinhole views of each depth panorama. Topics and parameters: docs/nodes.md."""

    def __init__(self, **node_args: Any) -> None:
        super().__init__(
            'views', automatically_declare_parameters_from_overrides=True, **node_args
        )
        self._settings = declare_parameters(self, ViewsParameters, self._on_parameters)
        _compile()
        self._matcher = StampMatcher(tuple(_TOPICS), depth=4)
        self._view_publishers: list[dict[str, Publisher]] = [
            {
                name: self.create_publisher(kind, f'view_{k}/{name}', qos.PANORAMAS)
                for name, kind in _OUTPUTS.items()
            }
            for k in range(self._settings.faces)
        ]
        self._parent_frame = ''
        self._transforms = self._transform_publisher()
        self._outcome = Report(OK, 'no depth panorama received yet')
        publish_diagnostics(self, 'views', lambda: self._outcome)
        for topic, kind in _TOPICS.items():
            self.create_subscription(
                kind, topic, lambda message, topic=topic: self._on(topic, message), qos.PANORAMAS
            )
        self.get_logger().info('ready')

    def _on_parameters(self, parameters: ViewsParameters) -> None:
        self._settings = parameters

    def _transform_publisher(self) -> Publisher | None:
        try:
            message = importlib.import_module('tf2_msgs.msg').TFMessage
        except ModuleNotFoundError:
            self.get_logger().info(
                'tf2_msgs is not installed: no transforms of the views on /tf_static'
            )
            return None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        return self.create_publisher(message, '/tf_static', latched)

    def _on(self, topic: str, message: Any) -> None:
        messages = self._matcher.add(topic, message)
        if messages is None:
            return
        try:
            self._show(messages)
        except ValueError as error:
            self._outcome = Report(ERROR, f'panorama refused: {error}')
            self.get_logger().error(f'panorama refused, no view is published: {error}')

    def _show(self, messages: dict[Any, Any]) -> None:
        start = time.monotonic()
        geometry = panorama_geometry(messages['depth/camera_info'])
        panorama = Panorama(to_bgr_or_mono(messages['left/image']), geometry)
        if messages['depth/image'].encoding != '32FC1':
            encoding = messages['depth/image'].encoding
            raise ValueError(f'depth/image has encoding {encoding!r}; allowed: 32FC1, metres')
        points = locate(to_array(messages['depth/image']), geometry)
        faces = ring_of_faces(geometry, self._settings.faces, self._settings.width)
        header = messages['depth/image'].header
        if header.frame_id != self._parent_frame:
            self._parent_frame = header.frame_id
            self._publish_frames(faces, header)
        shown = 0
        for k, (face, publishers) in enumerate(zip(faces, self._view_publishers, strict=True)):
            if any(publisher.get_subscription_count() for publisher in publishers.values()):
                own = Header(stamp=header.stamp, frame_id=self._settings.frame(k))
                self._publish(publishers, panorama, points, face, own)
                shown += 1
        took = time.monotonic() - start
        summary = f'{shown} views of {face.width} × {face.height} px took {took:.2f} s'
        self._outcome = Report(OK, summary if shown else 'nobody listens to a view')
        if shown:
            self.get_logger().info(summary)

    def _publish(
        self,
        publishers: dict[str, Publisher],
        panorama: Panorama,
        points: Points,
        face: Face,
        header: Header,
    ) -> None:
        view = render(points, panorama.image, panorama.geometry, face)
        encoding = 'bgr8' if view.image.ndim == 3 else 'mono8'
        named = {'stamp': header.stamp, 'frame_id': header.frame_id}
        publishers['camera_info'].publish(face_info(face, header))
        publishers['image'].publish(to_message(view.image, encoding, **named))
        publishers['depth'].publish(to_message(view.depth, '32FC1', **named))

    def _publish_frames(self, faces: list[Face], header: Header) -> None:
        if self._transforms is None:
            return
        message = self._transforms.msg_type()
        message.transforms = [
            face_transform(face, header, self._settings.frame(k)) for k, face in enumerate(faces)
        ]
        self._transforms.publish(message)


def _compile() -> None:
    """Compile the rendering before the first panorama comes."""
    geometry = PanoramaGeometry(
        columns=8,
        rows=1,
        azimuth_column=4.0,
        focal_length_px=1.0,
        principal_row=0.0,
        arm_radius=0.1,
        principal_angle=-0.1,
        sweep_duration=0.0,
        ray_angle=np.full(8, -0.1),
    )
    points = locate(np.ones((1, 8)), geometry)
    render(points, np.zeros((1, 8), np.uint8), geometry, ring_of_faces(geometry, 4, 2)[0])


def main(args: list[str] | None = None) -> int:
    """Run the views node; see :func:`panodepth_ros.ros.process.run_node`."""
    return run_node('views', Views, args)
