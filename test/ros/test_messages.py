"""Panorama geometry as CameraInfo, ranges as LaserScan."""

import dataclasses
import math

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import Header

from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.messages import (
    joint_reading,
    laser_scan,
    panorama_geometry,
    panorama_info,
    pinhole_camera,
    to_nanoseconds,
    to_stamp,
)
from panodepth_ros.scan.beams import ScanSettings

pytestmark = pytest.mark.ros


def geometry(ray_angle=None):
    return PanoramaGeometry(
        columns=1800,
        rows=120,
        azimuth_column=824.6,
        focal_length_px=271.0,
        principal_row=59.5,
        arm_radius=0.3,
        principal_angle=-0.26,
        sweep_duration=71.5,
        ray_angle=np.full(1800, -0.26) if ray_angle is None else ray_angle,
    )


def header():
    return Header(stamp=to_stamp(1_234_567_890_123), frame_id='panodepth')


def test_stamps_survive():
    assert to_nanoseconds(to_stamp(1_999_999_999)) == 1_999_999_999


def test_uniform_panorama_needs_three_values():
    info = panorama_info(geometry(), header())
    assert list(info.d) == [0.3, -0.26, 71.5]
    assert info.k[0] == pytest.approx(1800 / (2 * math.pi))
    assert (info.k[2], info.k[4], info.k[5]) == (824.6, 271.0, 59.5)
    assert not info.p.any(), 'a pinhole consumer must fail'
    assert info.distortion_model == 'cylindrical'


def test_rays_of_their_own_travel_column_by_column():
    rays = np.full(1800, -0.26)
    rays[7], rays[8] = np.nan, -0.261
    read = panorama_geometry(panorama_info(geometry(rays), header()))
    assert np.array_equal(read.ray_angle, rays, equal_nan=True)
    assert read.stripe_distance == math.inf


def test_stripe_distance_travels_with_the_rays():
    rays = np.linspace(-0.27, -0.25, 1800)
    ours = dataclasses.replace(geometry(rays), stripe_distance=2.0)
    read = panorama_geometry(panorama_info(ours, header()))
    assert read.stripe_distance == 2.0
    assert np.array_equal(read.ray_angle, rays)
    assert np.array_equal(read.ray_azimuth(np.arange(1800)), ours.ray_azimuth(np.arange(1800)))


def test_geometry_survives_the_message():
    ours, read = geometry(), panorama_geometry(panorama_info(geometry(), header()))
    for name in (
        'columns',
        'rows',
        'azimuth_column',
        'focal_length_px',
        'principal_row',
        'arm_radius',
        'principal_angle',
        'sweep_duration',
    ):
        assert getattr(read, name) == getattr(ours, name)
    assert np.array_equal(read.ray_angle, ours.ray_angle)


@pytest.mark.parametrize(
    ('field', 'value', 'named'),
    [
        ('distortion_model', 'plumb_bob', 'plumb_bob'),
        ('d', [0.3], '1 values in d'),
        ('d', [], '0 values in d'),
        ('d', [-0.3, -0.26, 1.0], 'arm_radius is -0.3'),
        ('width', 900, '900 columns wide'),
    ],
)
def test_message_without_a_panoramas_geometry_is_refused(field, value, named):
    info = panorama_info(geometry(), header())
    setattr(info, field, value)
    with pytest.raises(ValueError, match=named):
        panorama_geometry(info)


def test_ordinary_camera_is_read():
    info = CameraInfo(width=160, height=120, distortion_model='plumb_bob', d=[0.1, 0, 0, 0, 0.0])
    info.k = [200.0, 0.0, 80.0, 0.0, 201.0, 60.0, 0.0, 0.0, 1.0]
    camera = pinhole_camera(info)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (200.0, 201.0, 80.0, 60.0)
    assert camera.distortion == (0.1, 0, 0, 0, 0)


def test_uncalibrated_camera_is_refused():
    with pytest.raises(ValueError, match='fx is 0'):
        pinhole_camera(CameraInfo(width=160, height=120))


def test_camera_whose_lens_folds_inside_of_the_image_is_refused():
    info = CameraInfo(width=160, height=120, distortion_model='plumb_bob', d=[-5.0, 0, 0, 0, 0.0])
    info.k = [262.0, 0.0, 79.5, 0.0, 262.0, 59.5, 0.0, 0.0, 1.0]
    with pytest.raises(ValueError, match='folds inside of the image of 160 by 120 pixels'):
        pinhole_camera(info)
    # A rough view angle stands in for the whole calibration.
    assert not pinhole_camera(info, math.radians(34.0)).distorted


@pytest.mark.parametrize('beams', [60, 360, 719, 720, 1800, 3600, 7200])
def test_scan_has_the_form_that_every_consumer_takes(beams):
    settings = ScanSettings(beams=beams)
    ranges = np.full(beams, np.nan, np.float32)
    ranges[:3] = [1.5, np.inf, -np.inf]
    scan = laser_scan(ranges, settings, header(), 71.5)
    assert scan.header.frame_id == 'panodepth'
    assert len(scan.ranges) == beams
    assert list(scan.ranges[:3]) == [1.5, np.inf, -np.inf]
    assert np.isnan(scan.ranges[3])
    assert len(scan.intensities) == 0
    assert (scan.time_increment, scan.scan_time) == (0.0, 71.5)
    # slam_toolbox and others compute the count from the angles, which travel as float32.
    low, high, step = (
        np.float32(a) for a in (scan.angle_min, scan.angle_max, scan.angle_increment)
    )
    assert low == np.float32(-math.pi)
    assert step == np.float32(2 * math.pi / beams)
    assert round(float((high - low) / step)) + 1 == beams
    assert high < math.pi


def test_joint_is_found_by_its_name():
    message = JointState(name=['wheel', 'arm'], position=[1.0, 2.0], velocity=[3.0, 4.0])
    message.header.stamp = to_stamp(5_000_000_006)
    assert joint_reading(message, 'arm') == (5_000_000_006, 2.0, 4.0)
    assert joint_reading(message, 'leg') is None
    message.velocity = [3.0]
    assert joint_reading(message, 'arm') == (5_000_000_006, 2.0, None)
    message.position = [1.0]
    with pytest.raises(ValueError, match='joint state without a position'):
        joint_reading(message, 'arm')
