"""``panodepth_ros calibrate``: a rendered sweep of a turned, distorting camera, through a bag."""

from __future__ import annotations

import json
import math
import sys
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

pytest.importorskip('rosbags', reason='bags need rosbags')

sys.path.insert(0, str(Path(__file__).parents[2] / 'tools'))

import data_to_bag

from panodepth_ros.bag import BagWriter, read
from panodepth_ros.bag.storage import rosbags
from panodepth_ros.bag.sweep import read_sweep
from panodepth_ros.calibration import Given, self_calibrate
from panodepth_ros.camera.calibration import read_calibration
from panodepth_ros.camera.simulated import RealCamera, RoomCamera, furnished_room
from panodepth_ros.cli.main import main
from panodepth_ros.geometry import Mounting, PinholeCamera

IDEAL = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
META = {'W': 160, 'H': 120, 'fx': IDEAL.fx, 'fy': IDEAL.fy, 'cx': IDEAL.cx, 'cy': IDEAL.cy}
GIVEN = PinholeCamera(width=160, height=120, fx=IDEAL.fx, fy=IDEAL.fy, cx=IDEAL.cx, cy=IDEAL.cy)
TRUE = replace(
    GIVEN,
    distortion=(-0.08, 0.0, 0.0, 0.0),
    mounting=Mounting(yaw=math.radians(1.2), roll=math.radians(0.7), tilt=math.radians(-0.8)),
)
AZIMUTHS = np.radians(np.arange(0.0, 100.0, 0.4))


def write_bag(folder: Path, meta: dict[str, float], frames: np.ndarray) -> Path:
    folder.mkdir()
    np.save(folder / 'angles.npy', AZIMUTHS[: len(frames)])
    (folder / 'meta.json').write_text(json.dumps(meta))
    code = cv2.VideoWriter_fourcc(*'FFV1')
    video = cv2.VideoWriter(str(folder / 'frames.mkv'), code, 10.0, (160, 120))
    assert video.isOpened()
    for frame in frames:
        video.write(frame)
    video.release()
    assert data_to_bag.main([str(folder), str(folder / 'bag')]) == 0
    return folder / 'bag'


@pytest.fixture(scope='module')
def frames() -> np.ndarray:
    """Frames of 100° of a room by the turned camera, with noise."""
    room, camera, rng = furnished_room(4), RealCamera(TRUE), np.random.default_rng(4)
    clean = np.stack([camera.render(room, float(gamma), 0.3) for gamma in AZIMUTHS])
    noisy = np.rint(clean + rng.normal(0, 1.5, clean.shape))
    return np.clip(noisy, 0, 255).astype(np.uint8)


@pytest.fixture(scope='module')
def bag(frames: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('calibrate') / 'sweep', META, frames)


def test_bag_of_a_turned_camera_gives_calibration_and_mounting(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera_file, mounting_file = tmp_path / 'camera.yaml', tmp_path / 'mounting.yaml'
    options = ['-o', str(camera_file), '-p', str(mounting_file), '--focal-length-sd', '0.05']
    assert main(['calibrate', str(bag), *options]) == 0
    said = capsys.readouterr().out
    assert '250 frames over 99.6°' in said
    assert 'cy   ' in said
    assert 'not observed' in said
    assert 'if all errors were white noise' in said
    calibration = read_calibration(camera_file)
    assert calibration.camera_name == 'panodepth_camera'
    assert calibration.camera_matrix[0] == pytest.approx(IDEAL.fx, rel=2e-3)
    assert calibration.distortion_coefficients[0] == pytest.approx(-0.08, abs=0.008)
    parameters = yaml.safe_load(mounting_file.read_text())['/**/mosaicer']['ros__parameters']
    assert parameters['camera_roll_deg'] == pytest.approx(0.7, abs=0.03)
    assert parameters['camera_yaw_deg'] == pytest.approx(1.2, abs=0.4)
    # Tilt and the principal row trade for each other; together they put the eyes' rows level.
    found = replace(
        TRUE,
        fx=calibration.camera_matrix[0],
        fy=calibration.camera_matrix[4],
        cx=calibration.camera_matrix[2],
        cy=calibration.camera_matrix[5],
        distortion=calibration.distortion_coefficients,
        mounting=Mounting(
            **{
                name: math.radians(parameters[f'camera_{name}_deg'])
                for name in ('yaw', 'roll', 'tilt')
            }
        ),
    )
    for slope in (-0.15, 0.0, 0.15):
        angle, rise = TRUE.rays(*found.project([0.25, -0.25], slope))
        assert angle[0] - angle[1] == pytest.approx(0.5, rel=5e-3)
        assert (rise[0] - rise[1]) * IDEAL.fy == pytest.approx(0.0, abs=0.15)


def test_focal_length_is_told_by_the_sweep_where_k1_is_given(
    frames: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = 1.02 * META['fx']
    bag = write_bag(tmp_path / 'wrong', META | {'fx': wrong, 'fy': wrong, 'k1': -0.08}, frames)

    def found(*options: str) -> tuple[float, float]:
        """Focal length and its standard deviation, as printed."""
        assert main(['calibrate', str(bag), '--focal-length-sd', 'inf', *options]) == 0
        line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith('  fx'))
        value, deviation = line.split()[1], line.split()[3]
        return float(value), float(deviation)

    value, deviation = found('--k1-sd', '0.0002')
    assert value == pytest.approx(IDEAL.fx, rel=0.01)
    assert deviation < 0.5 * found()[1]


def test_equation_1_is_shown_to_be_biased(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['calibrate', str(bag), '--view-angle']) == 0
    lines = capsys.readouterr().out.splitlines()
    angle = {
        name: float(line.split('±')[0].split()[-1])
        for name in ('nearest third', 'farthest third', 'parallax modelled')
        for line in lines
        if name in line
    }
    assert angle['nearest third'] < angle['farthest third'] < 32.5
    assert angle['parallax modelled'] == pytest.approx(34.0, abs=1.5)


def test_lens_that_folds_inside_of_the_image_is_refused(
    frames: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_bag(tmp_path / 'folded', META | {'k1': -5.0}, frames[:3])
    assert main(['calibrate', str(bag)]) == 1
    said = capsys.readouterr().err
    assert said.startswith('panodepth_ros calibrate: camera distortion (-5.0,')
    assert 'folds inside of the image of 160 by 120 pixels' in said


def test_uncalibrated_camera_needs_a_rough_field_of_view(
    frames: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = write_bag(tmp_path / 'bare', META | {'fx': 0.0, 'fy': 0.0}, frames[:3])
    assert main(['calibrate', str(bare)]) == 1
    assert capsys.readouterr().err.startswith('panodepth_ros calibrate: camera fx is 0.0')
    assert main(['calibrate', str(bare), '--field-of-view', '36']) == 1
    assert 'the frames cover 0.8° of arm azimuth; allowed: 20° or more' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('options', 'sentence'),
    [
        (['--joint-name', 'wheel'], 'holds no frame of a standing arm, joint wheel'),
        (['--image-topic', '/left'], 'has no topic /left; it has /camera_info'),
        (['--image-topic', '/camera_info'], 'CameraInfo; allowed: sensor_msgs/msg/Image'),
        (['--camera-info-topic', '/image_raw'], 'Image; allowed: sensor_msgs/msg/CameraInfo'),
    ],
)
def test_bag_without_a_sweep_is_refused(
    bag: Path, options: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['calibrate', str(bag), *options]) == 1
    assert sentence in capsys.readouterr().err


def rewritten(bag: Path, path: Path, change: Callable[[str, Any], Any]) -> Path:
    """The bag with changed messages, and without those that change to None."""
    store = rosbags('typesys').get_typestore(rosbags('typesys').Stores.ROS2_JAZZY)
    with BagWriter(path) as writer:
        for topic, kind in data_to_bag.TOPICS.items():
            writer.add_topic(topic, kind, store)
        for topic, time, message in read(bag):
            changed = change(topic, message)
            if changed is not None:
                kind = data_to_bag.TOPICS[topic]
                writer.write(topic, time, store.serialize_cdr(changed, kind))
    return path


def test_topic_without_messages_is_told(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = rewritten(bag, tmp_path / 'bag', lambda t, m: None if t == '/camera_info' else m)
    assert main(['calibrate', str(path)]) == 1
    assert 'bag holds no message of /camera_info' in capsys.readouterr().err


def test_frames_of_a_bag_are_not_kept_in_memory(bag: Path) -> None:
    sweep = read_sweep(bag, joint_name='panodepth_arm_joint')
    for _ in range(2):
        frames = [weakref.ref(frame) for frame in sweep.frames]
        assert len(frames) == sweep.arm_azimuth.size == AZIMUTHS.size
        assert not any(frame() is not None for frame in frames)


def test_joint_states_without_a_position_are_counted(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def shortened(topic: str, message: Any) -> Any:
        if topic == '/joint_states':
            message.position = message.position[:0]
        return message

    assert main(['calibrate', str(rewritten(bag, tmp_path / 'bag', shortened))]) == 1
    said = capsys.readouterr().err
    assert 'holds no frame of a standing arm' in said
    assert '750 × joint state without a position' in said


def test_impossible_options_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(['calibrate', 'bag', '--focal-length-sd', '-1'])
    assert 'invalid number (0 to inf %) value' in capsys.readouterr().err


def test_scene_without_texture_is_refused() -> None:
    blank = [np.full((120, 160), 90, np.uint8)] * 100
    with pytest.raises(ValueError, match='only 0 points could be followed'):
        self_calibrate(blank, AZIMUTHS[:100], GIVEN, Given())


def test_negative_uncertainty_is_refused() -> None:
    with pytest.raises(ValueError, match=r'k1 is given to ±-1\.0; allowed: 0 or more'):
        Given(k1=-1.0)
