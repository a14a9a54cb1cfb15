"""Pinhole views as messages: CameraInfo, the place of their optical frame."""

from __future__ import annotations

import math

from geometry_msgs.msg import Quaternion, Transform, TransformStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from panodepth_ros.geometry.pinhole_views import Face


def face_info(face: Face, header: Header) -> CameraInfo:
    """Write a face as an ordinary, undistorted camera, ``header`` naming its optical frame."""
    f, cx, cy = float(face.focal_length_px), float(face.cx), float(face.cy)
    return CameraInfo(
        header=header,
        width=face.width,
        height=face.height,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=[f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[f, 0.0, cx, 0.0, 0.0, f, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def face_transform(face: Face, header: Header, child_frame_id: str) -> TransformStamped:
    """
    Say where a face's optical frame (z forward, x right, y down) is in the scan frame.

    Parameters
    ----------
    face : Face
        On the axis, as all faces are.
    header : std_msgs/Header
        Names the scan frame.
    child_frame_id : str
        The optical frame.

    Notes
    -----
    The quaternion turns the frame of a camera that looks along x, (−½, ½, −½, ½), about z.
    """
    c, s = math.cos(face.azimuth / 2) / 2, math.sin(face.azimuth / 2) / 2
    rotation = Quaternion(x=-c - s, y=c - s, z=s - c, w=c + s)
    return TransformStamped(
        header=header, child_frame_id=child_frame_id, transform=Transform(rotation=rotation)
    )
