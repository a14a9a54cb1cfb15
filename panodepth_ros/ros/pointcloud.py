"""Points to sensor_msgs/PointCloud2, organised as the panorama is."""

from __future__ import annotations

import array as arrays
import sys

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

#: One point in the message. ``rgb`` is the float whose bits are 0x00RRGGBB, as PCL and RViz read
#: it; ``stddev`` is the standard deviation of the horizontal distance from the axis [m].
POINT = np.dtype(
    [
        ('x', np.float32),
        ('y', np.float32),
        ('z', np.float32),
        ('rgb', np.uint32),
        ('confidence', np.float32),
        ('stddev', np.float32),
    ]
)


def point_cloud(
    xyz: npt.NDArray[np.floating],
    image: npt.NDArray[np.uint8],
    confidence: npt.NDArray[np.float32],
    stddev: npt.NDArray[np.floating],
    header: Header,
) -> PointCloud2:
    """
    Write an organised point cloud.

    Parameters
    ----------
    xyz : ndarray of float, shape (H, W, 3)
        Points in the header's frame [m]; NaN where unknown.
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        Their colours, grey or BGR.
    confidence : ndarray of float32, shape (H, W)
        In [0, 1], NaN where unknown.
    stddev : ndarray of float, shape (H, W)
        Standard deviation of the distance from the axis [m].
    header : std_msgs/Header
        Stamp and frame.

    Returns
    -------
    sensor_msgs/PointCloud2
        H by W points with the fields of :data:`POINT`, ``is_dense`` false.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    height, width = xyz.shape[:2]
    for name, values in (('image', image), ('confidence', confidence), ('stddev', stddev)):
        if values.shape[:2] != (height, width):
            raise ValueError(f'{name} has shape {values.shape}; the points have {xyz.shape}')
    points = np.empty((height, width), POINT)
    for index, name in enumerate('xyz'):
        points[name] = xyz[..., index]
    blue, green, red = np.moveaxis(
        np.broadcast_to(image.reshape(height, width, -1), (height, width, 3)), -1, 0
    ).astype(np.uint32)
    points['rgb'] = red << 16 | green << 8 | blue
    points['confidence'] = confidence
    points['stddev'] = stddev
    data = arrays.array('B')
    data.frombytes(points.view(np.uint8).data.cast('B'))
    return PointCloud2(
        header=header,
        height=height,
        width=width,
        fields=[
            PointField(name=name, offset=offset, datatype=PointField.FLOAT32, count=1)
            for name, (_, offset, *_) in (POINT.fields or {}).items()
        ],
        is_bigendian=sys.byteorder == 'big',
        point_step=POINT.itemsize,
        row_step=POINT.itemsize * width,
        data=data,
        is_dense=False,
    )
