"""What comes as files or compressed frames, for :mod:`benchmarks.fuzz`: read, or refused."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from panodepth_ros.bag import BagWriter
from panodepth_ros.bag.storage import BagError, read, rosbags
from panodepth_ros.camera.calibration import (
    Calibration,
    CalibrationError,
    read_calibration,
    write_calibration,
)
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.mosaic.state import HEADER, MAGIC, SweepJournal, load_state, sealed
from panodepth_ros.ros.images import decompressed

CAMERA = PinholeCamera(width=21, height=9, fx=30.0, fy=30.0, cx=10.0, cy=4.0)
RIG = Rig(arm_radius=0.3, column_offset=8.0, columns=60, sweep_columns=60)


def calibration(folder: Path) -> bytes:
    """Return a calibration file as we write it."""
    write_calibration(Calibration.of_pinhole(CAMERA, 'a camera'), folder / 'seed.yaml')
    return (folder / 'seed.yaml').read_bytes()


def check_calibration(folder: Path, data: bytes) -> None:
    """Read a calibration file of some bytes."""
    file = folder / 'camera.yaml'
    file.write_bytes(data)
    with suppress(CalibrationError):
        read_calibration(file)


def state(folder: Path) -> bytes:
    """Return the file of a sweep under way."""
    sweep, journal = Sweep(RIG, CAMERA, 0.0), SweepJournal(folder / 'seed.state')
    for k in range(3):
        sweep.add(1000 + k, np.full((9, 21), k, np.uint8), k * RIG.column_step)
        journal.write(sweep, 0.1, ('a driver',))
    return (folder / 'seed.state').read_bytes()


def records(whole: bytes) -> list[tuple[int, bytes]]:
    """Return the records of a state: how long the text of each is, text and arrays."""
    found, at = [], len(MAGIC)
    while at < len(whole):
        length, text, *_ = HEADER.unpack_from(whole, at)
        at += HEADER.size
        found.append((text, whole[at : at + length]))
        at += length
    return found


def with_record(whole: bytes, number: int, data: bytes) -> bytes:
    """Return a state with other bytes in one record, and the checksums that they ask for."""
    made = MAGIC
    for k, (text, body) in enumerate(records(whole)):
        fresh = data if k == number else body
        made += sealed(fresh, text)
    return made


def check_state(folder: Path, data: bytes) -> None:
    """Take up the sweep of a file of some bytes."""
    file = folder / 'sweep.state'
    file.write_bytes(data)
    with suppress(ValueError, OSError):
        loaded = load_state(file, RIG, CAMERA)
        assert loaded is not None
        loaded.sweep(RIG, CAMERA)


def frames() -> tuple[bytes, ...]:
    """Return small compressed pictures."""
    image = np.random.default_rng(1).integers(0, 255, (9, 21, 3), np.uint8)
    return tuple(cv2.imencode(kind, image)[1].tobytes() for kind in ('.png', '.jpg'))


def check_frame(data: bytes) -> None:
    """Decompress a frame of some bytes."""
    with suppress(ValueError):
        decompressed(SimpleNamespace(format='jpeg', data=data))


def bag(folder: Path, storage: str) -> bytes:
    """Return the data file of a bag of joint states."""
    typesys = rosbags('typesys')
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    kind = 'sensor_msgs/msg/JointState'
    time = store.types['builtin_interfaces/msg/Time'](1, 2)
    header = store.types['std_msgs/msg/Header'](stamp=time, frame_id='')
    numbers = np.array([0.5])
    message = store.types[kind](
        header=header, name=['arm'], position=numbers, velocity=numbers, effort=numbers
    )
    with BagWriter(folder / storage, storage) as writer:
        writer.add_topic('/joint_states', kind, store)
        for k in range(3):
            writer.write('/joint_states', k, store.serialize_cdr(message, kind))
    (file,) = (file for file in (folder / storage).iterdir() if file.name != 'metadata.yaml')
    return file.read_bytes()


def check_bag(file: Path, data: bytes) -> None:
    """Read all messages of a bag whose data file has some bytes."""
    file.write_bytes(data)
    with suppress(BagError):
        for _ in read(file):
            pass
