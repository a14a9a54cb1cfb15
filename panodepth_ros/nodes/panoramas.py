"""Panoramas as messages: of a finished sweep, and of the one under construction."""

from __future__ import annotations

import math
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from panodepth_ros.geometry import Panorama
from panodepth_ros.mosaic import Sweep
from panodepth_ros.ros import qos
from panodepth_ros.ros.images import to_bgr_or_mono, to_message
from panodepth_ros.ros.messages import panorama_geometry, panorama_info, to_stamp

#: The panoramas that are published before they are finished.
PARTIAL = ('partial/left', 'partial/right')
#: What a panorama consists of, by the last part of the topic.
KINDS = {'image': Image, 'camera_info': CameraInfo}


def read_panorama(messages: dict[Any, Any], name: str) -> Panorama:
    """
    Put a panorama together from messages by topic.

    Raises
    ------
    ValueError
        If they do not describe one.
    """
    image, info = messages[f'{name}/image'], messages[f'{name}/camera_info']
    return Panorama(to_bgr_or_mono(image), panorama_geometry(info))


class PanoramaPublisher:
    """Publishes image and camera_info of one panorama."""

    def __init__(self, node: Node, name: str) -> None:
        self._image = node.create_publisher(Image, f'{name}/image', qos.PANORAMAS)
        self._info = node.create_publisher(CameraInfo, f'{name}/camera_info', qos.PANORAMAS)

    @property
    def heard(self) -> bool:
        """Whether somebody subscribes to both."""
        return bool(self._image.get_subscription_count() and self._info.get_subscription_count())

    def messages(self, panorama: Panorama, header: Header) -> list[tuple[Publisher, Any]]:
        """Messages of a panorama with this header, each with its publisher."""
        encoding = 'bgr8' if panorama.image.ndim == 3 else 'mono8'
        named = {'stamp': header.stamp, 'frame_id': header.frame_id}
        image = to_message(panorama.image, encoding, **named)
        return [(self._info, panorama_info(panorama.geometry, header)), (self._image, image)]


class PartialPublisher:
    """
    Publishes the pair under construction, as far as it is settled, under ``partial/``.

    Parameters
    ----------
    node : rclpy.node.Node
    step_deg : float
        Angle that must be added before the pair is published again [°].
    frame_id : str
        Frame of the panoramas.
    """

    def __init__(self, node: Node, *, step_deg: float, frame_id: str) -> None:
        self._step = math.radians(step_deg)
        self._frame_id = frame_id
        self._publishers = {name: PanoramaPublisher(node, name) for name in PARTIAL}
        self._sweep: Sweep | None = None
        self._published = 0

    def update(self, sweep: Sweep | None) -> None:
        """Publish the sweep under construction if enough has been added."""
        if sweep is not self._sweep:
            self._sweep, self._published = sweep, 0
        if sweep is None or sweep.end is None:
            return
        portions = int(sweep.settled.sum() * sweep.rig.column_step / self._step)
        if portions <= self._published:
            return
        self._published = portions
        panoramas = sweep.panoramas(settled=True)
        header = Header(stamp=to_stamp(sweep.end), frame_id=self._frame_id)
        for name, publisher in self._publishers.items():
            panorama = panoramas[name.rpartition('/')[2]]
            for topic, message in publisher.messages(panorama, header):
                topic.publish(message)
