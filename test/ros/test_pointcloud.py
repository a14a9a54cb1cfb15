"""A cloud as PCL and RViz read it: fields by name and offset, colour in a float's bits."""

import struct

import numpy as np
import pytest
from sensor_msgs.msg import PointField
from std_msgs.msg import Header

from panodepth_ros.ros.messages import to_stamp
from panodepth_ros.ros.pointcloud import point_cloud

pytestmark = pytest.mark.ros
H, W = 3, 5


def made(image):
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(H, W, 3))
    xyz[1, 2] = np.nan
    confidence = rng.uniform(size=(H, W)).astype(np.float32)
    stddev = rng.uniform(size=(H, W))
    header = Header(stamp=to_stamp(7), frame_id='panodepth')
    return xyz, confidence, stddev, point_cloud(xyz, image, confidence, stddev, header)


def value(cloud, row, column, name):
    """One field of one point by the message's own description, little-endian floats."""
    (field,) = (field for field in cloud.fields if field.name == name)
    assert (field.datatype, field.count) == (PointField.FLOAT32, 1)
    at = row * cloud.row_step + column * cloud.point_step + field.offset
    return bytes(cloud.data[at : at + 4])


def test_organised_cloud_reads_back_field_by_field():
    image = np.random.default_rng(2).integers(0, 256, (H, W, 3), dtype=np.uint8)
    xyz, confidence, stddev, cloud = made(image)
    assert (cloud.height, cloud.width, cloud.is_dense, cloud.is_bigendian) == (H, W, False, False)
    assert len(cloud.data) == H * cloud.row_step == H * W * cloud.point_step
    assert cloud.header == Header(stamp=to_stamp(7), frame_id='panodepth')
    for row, column in np.ndindex(H, W):
        found = [
            struct.unpack('<f', value(cloud, row, column, name))[0]
            for name in ('x', 'y', 'z', 'confidence', 'stddev')
        ]
        expected = [*xyz[row, column], confidence[row, column], stddev[row, column]]
        assert found == pytest.approx(np.float32(expected).tolist(), nan_ok=True)
        blue, green, red, zero = value(cloud, row, column, 'rgb')
        assert [blue, green, red] == image[row, column].tolist()
        assert zero == 0


def test_grey_panorama_gives_grey_points():
    image = np.arange(H * W, dtype=np.uint8).reshape(H, W)
    *_, cloud = made(image)
    assert value(cloud, 2, 3, 'rgb') == bytes([13, 13, 13, 0])


def test_other_sizes_are_refused_by_name():
    with pytest.raises(ValueError, match=r'image has shape \(2, 5\); the points have \(3, 5, 3\)'):
        made(np.zeros((2, 5), np.uint8))
