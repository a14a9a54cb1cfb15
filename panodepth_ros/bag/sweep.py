"""The frames of a sweep out of a bag, each with the arm azimuth it was taken at."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.bag.storage import BagError, read
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import ArmTrack, Assembler, Rig, Sweep
from panodepth_ros.ros.images import to_bgr_or_mono
from panodepth_ros.ros.messages import joint_reading, pinhole_camera, to_nanoseconds

Grey = npt.NDArray[np.uint8]

#: As the mosaicer's defaults.
_TOLERANCE, _LONGEST_GAP = math.radians(0.002), 1_000_000_000
#: Any rig tells when the arm has gone round; its columns are not used.
_RIG = Rig(arm_radius=1.0, column_offset=0.0, columns=1800, sweep_columns=1800)


@dataclass(frozen=True, eq=False, slots=True)
class RecordedSweep:
    """
    Frames of one sweep.

    Attributes
    ----------
    frames : iterable of ndarray of uint8, shape (H, W)
        Grey, N of them; read from the bag each time anew, so that one at a time is in memory.
    arm_azimuth : ndarray of float64, shape (N,)
        γ of each [rad], not wrapped.
    camera : PinholeCamera
        As camera_info says, or with the given view angle.
    """

    frames: Iterable[Grey]
    arm_azimuth: npt.NDArray[np.float64]
    camera: PinholeCamera


def read_sweep(
    path: Path,
    *,
    joint_name: str,
    image: str = '/image_raw',
    camera_info: str = '/camera_info',
    joint_states: str = '/joint_states',
    view_angle: float | None = None,
) -> RecordedSweep:
    """
    Read the first sweep of a bag, up to a full turn.

    Parameters
    ----------
    path : Path
        The bag.
    joint_name : str
        The arm's joint.
    image, camera_info, joint_states : str
        Topics.
    view_angle : float, optional
        Rough horizontal view angle [rad] in place of the calibration in camera_info.

    Raises
    ------
    BagError
        If the bag cannot be read, or holds no frame of a standing arm.
    ValueError
        If the camera is uncalibrated and no view angle is given.
    """
    camera = _camera(path, camera_info, view_angle)
    placed = partial(_placed, path, camera, joint_name, image, joint_states)
    azimuths = np.array([azimuth for _, azimuth in placed()])
    return RecordedSweep(_Frames(placed), azimuths, camera)


class _Frames:
    def __init__(self, placed: Callable[[], Iterator[tuple[Grey, float]]]) -> None:
        self._placed = placed

    def __iter__(self) -> Iterator[Grey]:
        return (frame for frame, _ in self._placed())


def _placed(
    path: Path, camera: PinholeCamera, joint_name: str, image: str, joint_states: str
) -> Iterator[tuple[Grey, float]]:
    """Read the frames of the first sweep, each with its arm azimuth."""
    assembler = Assembler(_RIG, ArmTrack(_TOLERANCE, _LONGEST_GAP), 0)
    assembler.set_camera(camera)
    taken: list[tuple[Grey, float]] = []

    def take(frame: npt.NDArray[np.uint8], azimuth: float) -> None:
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        taken.append((np.asarray(grey, np.uint8), azimuth))

    assembler.taken = take
    count = 0
    kinds = {image: 'sensor_msgs/msg/Image', joint_states: 'sensor_msgs/msg/JointState'}
    for topic, _, message in read(path, kinds):
        finished: list[Sweep] = []
        try:
            if topic == image:
                stamp = to_nanoseconds(message.header.stamp)
                finished = assembler.add_frame(stamp, to_bgr_or_mono(message))
            elif (reading := joint_reading(message, joint_name)) is not None:
                finished = assembler.add_joint_state(*reading)
        except ValueError as error:
            assembler.drops[str(error)] += 1
        count += len(taken)
        yield from taken
        taken.clear()
        if finished:
            return
    if not count:
        reasons = '; '.join(f'{count} × {reason}' for reason, count in assembler.drops.items())
        raise BagError(
            f'bag {path} holds no frame of a standing arm, joint {joint_name}'
            f'{": " + reasons if reasons else ""}'
        )


def _camera(path: Path, topic: str, view_angle: float | None) -> PinholeCamera:
    kinds = {topic: 'sensor_msgs/msg/CameraInfo'}
    info: Any = next((message for _, _, message in read(path, kinds)), None)
    if info is None:
        raise BagError(f'bag {path} holds no message of {topic}')
    return pinhole_camera(info, view_angle)
