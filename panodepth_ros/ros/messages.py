"""
Geometry to and from sensor_msgs/CameraInfo (docs/conventions.md, "Panoramas").

Reading needs no ROS: any object with the fields of the message will do, such as one out of a bag.
"""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from panodepth_ros.geometry import PanoramaGeometry, PinholeCamera
from panodepth_ros.geometry.lens import check_lens
from panodepth_ros.motion.standstill import Odometry
from panodepth_ros.scan.beams import ScanSettings

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from nav_msgs.msg import Odometry as OdometryMessage
    from sensor_msgs.msg import CameraInfo, JointState, LaserScan
    from std_msgs.msg import Header

#: ``distortion_model`` of a panorama.
CYLINDRICAL = 'cylindrical'


def to_nanoseconds(stamp: Time) -> int:
    """Return a stamp as nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def to_stamp(nanoseconds: int) -> Time:
    """Return nanoseconds as a stamp."""
    from builtin_interfaces.msg import Time  # noqa: PLC0415 - reading works without ROS

    sec, nanosec = divmod(nanoseconds, 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)


def odometry(message: OdometryMessage) -> Odometry:
    """Return pose and velocities of a robot on the ground."""
    pose, twist, stamp = message.pose.pose, message.twist.twist, message.header.stamp
    q = pose.orientation
    return Odometry(
        time=stamp.sec + 1e-9 * stamp.nanosec,
        frame=message.header.frame_id,
        x=pose.position.x,
        y=pose.position.y,
        yaw=math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2)),
        speed=math.hypot(twist.linear.x, twist.linear.y),
        turn_rate=abs(twist.angular.z),
    )


def pinhole_camera(info: CameraInfo, view_angle: float | None = None) -> PinholeCamera:
    """
    Read the intrinsics of an ordinary camera.

    Parameters
    ----------
    info : CameraInfo
    view_angle : float, optional
        Rough horizontal view angle [rad] in place of the calibration, of an ideal camera.

    Raises
    ------
    ValueError
        If the camera is uncalibrated, its model unknown, or its lens folds inside of the image.
    """
    if view_angle is not None:
        focal_length = 0.5 * info.width / math.tan(0.5 * view_angle)
        return PinholeCamera(
            width=info.width,
            height=info.height,
            fx=focal_length,
            fy=focal_length,
            cx=0.5 * (info.width - 1),
            cy=0.5 * (info.height - 1),
        )
    k = info.k
    camera = PinholeCamera(
        width=info.width,
        height=info.height,
        fx=float(k[0]),
        fy=float(k[4]),
        cx=float(k[2]),
        cy=float(k[5]),
        distortion_model=info.distortion_model or 'plumb_bob',
        distortion=tuple(float(value) for value in info.d),
    )
    check_lens(camera)
    return camera


class JointReading(NamedTuple):
    """
    What a joint state tells of one joint.

    Attributes
    ----------
    stamp : int
        When the position was read [ns].
    position : float
        [rad]
    velocity : float or None
        [rad/s]; None if the message does not tell it.
    """

    stamp: int
    position: float
    velocity: float | None


def joint_reading(message: JointState, name: str) -> JointReading | None:
    """
    Read one joint of a joint state, None if the message is of other joints.

    Raises
    ------
    ValueError
        If the message names the joint, but has no position for it.
    """
    if name not in message.name:
        return None
    index = list(message.name).index(name)
    if index >= len(message.position):
        raise ValueError('joint state without a position')
    velocity = float(message.velocity[index]) if index < len(message.velocity) else None
    return JointReading(
        to_nanoseconds(message.header.stamp), float(message.position[index]), velocity
    )


def panorama_info(geometry: PanoramaGeometry, header: Header) -> CameraInfo:
    """Write a panorama's geometry as a CameraInfo."""
    from sensor_msgs.msg import CameraInfo  # noqa: PLC0415 - reading works without ROS

    info = CameraInfo(header=header, width=geometry.columns, height=geometry.rows)
    info.distortion_model = CYLINDRICAL
    info.k = [
        *(1 / geometry.column_step, 0.0, float(geometry.azimuth_column)),
        *(0.0, float(geometry.focal_length_px), float(geometry.principal_row)),
        *(0.0, 0.0, 1.0),
    ]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    rays = [] if geometry.uniform else [float(angle) for angle in geometry.ray_angle]
    if rays and math.isfinite(geometry.stripe_distance):
        rays.insert(0, float(geometry.stripe_distance))
    info.d = [
        float(geometry.arm_radius),
        float(geometry.principal_angle),
        float(geometry.sweep_duration),
        *rays,
    ]
    return info


def panorama_geometry(info: CameraInfo) -> PanoramaGeometry:
    """
    Read a panorama's geometry.

    Raises
    ------
    ValueError
        If the message does not describe a full cylindrical panorama.
    """
    if info.distortion_model != CYLINDRICAL:
        raise ValueError(
            f'camera_info has distortion_model {info.distortion_model!r}; allowed: '
            f'{CYLINDRICAL!r}, as the mosaicer publishes it'
        )
    if len(info.d) not in (3, 3 + info.width, 4 + info.width):
        raise ValueError(
            f'camera_info has {len(info.d)} values in d; allowed: 3, 3 + width = '
            f'{3 + info.width} (arm_radius, principal_angle, sweep_duration, ray angles) or '
            f'{4 + info.width} (with a stripe_distance before the ray angles)'
        )
    arm_radius, principal_angle, sweep_duration = (float(value) for value in info.d[:3])
    columns = int(info.width)
    if not math.isclose(info.k[0] * 2 * math.pi, columns, rel_tol=1e-6):
        raise ValueError(
            f'camera_info is {columns} columns wide at {info.k[0]:.6g} columns per radian; '
            'allowed: a full turn'
        )
    joined = len(info.d) == 4 + info.width
    rays = np.array(info.d[4:] if joined else info.d[3:], dtype=np.float64)
    return PanoramaGeometry(
        columns=columns,
        rows=int(info.height),
        azimuth_column=float(info.k[2]),
        focal_length_px=float(info.k[4]),
        principal_row=float(info.k[5]),
        arm_radius=arm_radius,
        principal_angle=principal_angle,
        sweep_duration=sweep_duration,
        ray_angle=rays if rays.size else np.full(columns, principal_angle),
        stripe_distance=float(info.d[3]) if joined else math.inf,
    )


def laser_scan(
    ranges: np.ndarray[tuple[int], np.dtype[np.float32]],
    settings: ScanSettings,
    header: Header,
    sweep_duration: float,
) -> LaserScan:
    """
    Write ranges as a LaserScan.

    Parameters
    ----------
    ranges : ndarray of float32, shape (beams,)
        Counter-clockwise from −π [m].
    settings : ScanSettings
        Angles and limits.
    header : std_msgs/Header
        Stamp of the end of the sweep; a frame that does not turn with the arm.
    sweep_duration : float
        [s], becomes ``scan_time``.

    Returns
    -------
    sensor_msgs/LaserScan
        angle_min = −π, angle_max = angle_min + (N − 1)·angle_increment: no doubled last ray, the
        one form that every consumer takes; time_increment = 0, for the robot stands still.
    """
    from sensor_msgs.msg import LaserScan  # noqa: PLC0415 - reading works without ROS

    return LaserScan(
        header=header,
        angle_min=-math.pi,
        angle_max=-math.pi + (settings.beams - 1) * settings.angle_increment,
        angle_increment=settings.angle_increment,
        time_increment=0.0,
        scan_time=float(sweep_duration),
        range_min=settings.range_min,
        range_max=settings.range_max,
        ranges=ranges.tolist(),
    )


def values_of_scan(
    values: np.ndarray[tuple[int], np.dtype[np.float32]], scan: LaserScan
) -> LaserScan:
    """
    Write other values of a scan's beams, such as standard deviations or ages, as a LaserScan.

    Returns
    -------
    sensor_msgs/LaserScan
        Header, angles and times of the scan; beam k of ``ranges`` is the value of beam k of the
        scan; ``range_min`` is 0.
    """
    message = copy.copy(scan)
    message.range_min = 0.0
    message.ranges = values.tolist()
    return message
