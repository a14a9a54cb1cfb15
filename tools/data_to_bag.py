"""
Make a bag of a folder with a rendered or recorded sweep.

The folder holds ``frames.mkv``, ``angles.npy`` (arm azimuth of each frame, radians) and
``meta.json`` (W, H, fx, fy, cx, cy, and k1, k2 if the lens distorts). The bag holds
``/image_raw``, ``/camera_info`` and ``/joint_states`` of a robot that took these frames step by
step, as docs/conventions.md wants joint states. ROS is not needed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.bag import STORAGES, BagError, BagWriter
from panodepth_ros.bag.storage import rosbags

JOINT_NAME = 'panodepth_arm_joint'
OPTICAL_FRAME = 'panodepth_camera_optical_frame'
TOPICS = {
    '/image_raw': 'sensor_msgs/msg/Image',
    '/camera_info': 'sensor_msgs/msg/CameraInfo',
    '/joint_states': 'sensor_msgs/msg/JointState',
}
START = 1_700_000_000 * 10**9
"""Time of the first column's beginning [ns]; fixed, so that the same data make the same bag."""

# Within the period of one column, as shares of it: the arm turns until it stands, settles, the
# frame is exposed, and it still stands when it is looked at again.
TURNING, STANDING, EXPOSED, STILL_STANDING = 0.2, 0.5, 0.7, 0.9


@dataclass(frozen=True)
class Data:
    """A folder's calibration and angles; frames are read one by one."""

    folder: Path
    meta: dict[str, Any]
    arm_azimuths: npt.NDArray[np.float64]

    @classmethod
    def load(cls, folder: Path) -> Data:
        """Read what says how the frames were taken; the angles are made continuous."""
        meta = json.loads((folder / 'meta.json').read_text())
        angles = np.unwrap(np.load(folder / 'angles.npy').astype(np.float64))
        if angles.ndim != 1 or angles.size < 2 or not np.isfinite(angles).all():
            raise ValueError(f'{folder / "angles.npy"} holds no row of two or more finite angles')
        return cls(folder, meta, angles)

    def frames(self) -> Iterator[npt.NDArray[np.uint8]]:
        """
        Frames as (H, W, 3) arrays in bgr order.

        Raises
        ------
        ValueError
            If the video has another number of frames than there are angles, or another size.
        """
        path = self.folder / 'frames.mkv'
        video = cv2.VideoCapture(str(path))
        size = (int(self.meta['H']), int(self.meta['W']), 3)
        for count in range(self.arm_azimuths.size):
            ok, frame = video.read()
            if not ok:
                raise ValueError(f'{path} has {count} frames for {self.arm_azimuths.size} angles')
            if frame.shape != size:
                raise ValueError(f'{path} has frames of shape {frame.shape}; meta.json: {size}')
            yield frame
        if video.read()[0]:
            raise ValueError(f'{path} has more frames than {self.arm_azimuths.size} angles')


class Messages:
    """Makes and serialises the messages."""

    def __init__(self, meta: dict[str, Any]):
        typesys = rosbags('typesys')
        self.typestore = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
        self._meta = meta

    def _serialised(self, topic: str, stamp: int, frame_id: str, **fields: Any) -> memoryview:
        types = self.typestore.types
        seconds, nanoseconds = divmod(stamp, 10**9)
        header = types['std_msgs/msg/Header'](
            stamp=types['builtin_interfaces/msg/Time'](sec=seconds, nanosec=nanoseconds),
            frame_id=frame_id,
        )
        message = types[TOPICS[topic]](header=header, **fields)
        data: memoryview = self.typestore.serialize_cdr(message, TOPICS[topic])
        return data

    def image(self, stamp: int, frame: npt.NDArray[np.uint8]) -> memoryview:
        """One frame as ``bgr8``."""
        height, width, channels = frame.shape
        return self._serialised(
            '/image_raw',
            stamp,
            OPTICAL_FRAME,
            height=height,
            width=width,
            encoding='bgr8',
            is_bigendian=0,
            step=width * channels,
            data=frame.reshape(-1),
        )

    def camera_info(self, stamp: int) -> memoryview:
        """The pinhole camera with the radial distortion of ``meta.json``."""
        fx, fy, cx, cy = (float(self._meta[key]) for key in ('fx', 'fy', 'cx', 'cy'))
        k1, k2 = (float(self._meta.get(key, 0.0)) for key in ('k1', 'k2'))
        region = self.typestore.types['sensor_msgs/msg/RegionOfInterest']
        return self._serialised(
            '/camera_info',
            stamp,
            OPTICAL_FRAME,
            height=int(self._meta['H']),
            width=int(self._meta['W']),
            distortion_model='plumb_bob',
            d=np.array([k1, k2, 0.0, 0.0, 0.0]),
            k=np.array([fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]),
            r=np.eye(3).reshape(-1),
            p=np.array([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
            binning_x=0,
            binning_y=0,
            roi=region(x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
        )

    def joint_state(self, stamp: int, position: float, velocity: float) -> memoryview:
        """Arm azimuth [rad] and its velocity [rad/s]."""
        return self._serialised(
            '/joint_states',
            stamp,
            '',
            name=[JOINT_NAME],
            position=np.array([position]),
            velocity=np.array([velocity]),
            effort=np.array([]),
        )


def write_bag(data: Data, path: Path, *, storage: str = 'mcap', period: float = 0.1) -> int:
    """
    Write the bag.

    Parameters
    ----------
    data : Data
        The sweep.
    path : Path
        Bag to make.
    storage : str
        ``mcap`` or ``sqlite3``.
    period : float
        Seconds per column.

    Returns
    -------
    int
        Number of frames.

    Raises
    ------
    BagError
        If the bag exists or cannot be written.
    ValueError
        If the folder's files do not fit together.
    """
    bag = BagWriter(path, storage)
    try:
        with bag:
            return _write(data, bag, period)
    except BaseException:
        shutil.rmtree(path)  # half a sweep that looks like a whole one
        raise


def _write(data: Data, bag: BagWriter, period: float) -> int:
    messages = Messages(data.meta)
    for topic, message_type in TOPICS.items():
        bag.add_topic(topic, message_type, messages.typestore)

    def write_joint_state(stamp: int, position: float, velocity: float) -> None:
        bag.write('/joint_states', stamp, messages.joint_state(stamp, position, velocity))

    azimuths = data.arm_azimuths
    came_from = 2.0 * azimuths[0] - azimuths[1]  # one step away
    for k, frame in enumerate(data.frames()):
        turning, standing, exposed, still_standing = (
            START + round((k + share) * period * 1e9)
            for share in (TURNING, STANDING, EXPOSED, STILL_STANDING)
        )
        # The arm left when it was last seen standing, in the period before.
        velocity = (azimuths[k] - came_from) / ((1.0 - STILL_STANDING + STANDING) * period)
        to_go = velocity * (STANDING - TURNING) * period
        write_joint_state(turning, azimuths[k] - to_go, velocity)
        write_joint_state(standing, azimuths[k], 0.0)
        bag.write('/image_raw', exposed, messages.image(exposed, frame))
        bag.write('/camera_info', exposed, messages.camera_info(exposed))
        write_joint_state(still_standing, azimuths[k], 0.0)
        came_from = azimuths[k]
    return azimuths.size


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('folder', type=Path, help='folder with frames.mkv and the like')
    parser.add_argument('bag', type=Path, help='bag to make')
    parser.add_argument('-s', '--storage', choices=STORAGES, default=STORAGES[0])
    parser.add_argument('--period', type=float, default=0.1, help='seconds per column (0.1)')
    arguments = parser.parse_args(argv)
    try:
        count = write_bag(
            Data.load(arguments.folder),
            arguments.bag,
            storage=arguments.storage,
            period=arguments.period,
        )
    except (BagError, OSError, ValueError) as error:
        print(f'data_to_bag: {error}', file=sys.stderr)
        return 1
    print(f'{arguments.bag}: {count} frames')
    return 0


if __name__ == '__main__':
    sys.exit(main())
