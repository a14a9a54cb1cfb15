"""Calibration files and URLs."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from panodepth_ros.camera.calibration import (
    LARGEST_FILE,
    Calibration,
    CalibrationError,
    calibration_path,
    read_calibration,
    write_calibration,
)
from panodepth_ros.camera.simulated import RoomCamera
from panodepth_ros.geometry import PinholeCamera

ROOT = Path(__file__).parents[2]

# Laid out as camera_info_manager of ROS 2 lays it out, with its line breaks and digits.
WRITTEN_BY_ROS = """\
image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [438.78337,   0.     , 305.59334,
           0.     , 437.30204, 243.73829,
           0.     ,   0.     ,   1.     ]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.11051, 1e-05, 0.000506, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1., 0., 0., 0., 1., 0., 0., 0., 1.]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.65379,   0.     , 322.79794,   0.     ,
           0.     , 427.37064, 241.42764,   0.     ,
           0.     ,   0.     ,   1.     ,   0.     ]
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'head_camera.yaml'
    path.write_text(WRITTEN_BY_ROS)
    return path


def edited(path: Path, **changes: object) -> Path:
    """The file with fields replaced, or left out where the change is None."""
    content = yaml.safe_load(path.read_text()) | changes
    path.write_text(yaml.safe_dump({k: v for k, v in content.items() if v is not None}))
    return path


def test_what_ros_writes_is_read(file: Path) -> None:
    calibration = read_calibration(file)
    assert (calibration.image_width, calibration.image_height) == (640, 480)
    assert calibration.camera_name == 'head_camera'
    assert calibration.camera_matrix[:3] == (438.78337, 0.0, 305.59334)
    assert calibration.distortion_model == 'plumb_bob'
    assert calibration.distortion_coefficients == (-0.361976, 0.11051, 1e-05, 0.000506, 0.0)
    assert calibration.rectification_matrix == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert calibration.projection_matrix[4:8] == (0.0, 427.37064, 241.42764, 0.0)


def test_what_is_written_has_the_fields_of_camera_info_manager_in_its_order(
    file: Path, tmp_path: Path
) -> None:
    copy = tmp_path / 'copy.yaml'
    write_calibration(read_calibration(file), copy)
    ours, theirs = yaml.safe_load(copy.read_text()), yaml.safe_load(WRITTEN_BY_ROS)
    assert list(ours) == list(theirs)
    theirs['distortion_coefficients']['data'][2] = 1e-05  # a string, to YAML 1.1
    assert ours == theirs


numbers = st.floats(allow_nan=False, allow_infinity=False)
focal_lengths = st.floats(1e-3, 1e6)


@given(fx=focal_lengths, fy=focal_lengths, others=st.tuples(*[numbers] * 7), name=st.text())
def test_written_and_read_again_nothing_changes(
    tmp_path_factory: pytest.TempPathFactory,
    fx: float,
    fy: float,
    others: tuple[float, ...],
    name: str,
) -> None:
    path = tmp_path_factory.getbasetemp() / 'round_trip.yaml'
    calibration = Calibration.of_pinhole(
        PinholeCamera(width=7, height=5, fx=fx, fy=fy, cx=others[0], cy=others[1]), name
    )
    # Any numbers would be no lens.
    calibration = dataclasses.replace(calibration, rectification_matrix=(*others[2:], *[0.0] * 4))
    write_calibration(calibration, path)
    assert read_calibration(path) == calibration


def test_the_simulated_cameras_file_is_the_simulated_camera() -> None:
    camera = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
    assert read_calibration(ROOT / 'config' / 'camera_info_simulated.yaml') == (
        Calibration.of_pinhole(
            PinholeCamera(width=160, height=120, fx=camera.fx, fy=camera.fy, cx=79.5, cy=59.5),
            'panodepth_camera',
        )
    )


def test_fields_of_others_are_passed_over_and_the_model_may_be_missing(file: Path) -> None:
    edited(file, calibration_time='Mon Nov 23 2026', distortion_model=None, binning_x=1)
    assert read_calibration(file).distortion_model == 'plumb_bob'


def matrix(rows: object, cols: object, data: object) -> dict[str, object]:
    return {'rows': rows, 'cols': cols, 'data': data}


@pytest.mark.parametrize(
    ('field', 'value', 'allowed'),
    [
        ('image_width', 640.0, 'a whole number of pixels from 1 to 65535'),
        ('image_width', True, 'a whole number'),
        ('image_height', 0, 'from 1 to 65535'),
        ('image_height', '480', 'a whole number'),
        ('camera_name', 7, 'a string'),
        ('distortion_model', 'fisheye', 'plumb_bob, rational_polynomial, equidistant'),
        ('distortion_coefficients', matrix(1, 3, [0, 0, 0]), '0 or 4 or 5 values for plumb_bob'),
        ('distortion_coefficients', matrix(2, 2, [0, 0, 0, 0]), 'rows: 1, cols: n'),
        ('camera_matrix', [1, 0, 0, 0, 1, 0, 0, 0, 1], 'rows: 3, cols: 3'),
        ('camera_matrix', matrix(3, 3, [1.0] * 8), 'rows: 3, cols: 3'),
        ('camera_matrix', matrix(3, 3, [0.0] * 9), 'focal lengths above 0'),
        ('camera_matrix', matrix(3, 3, [1.0] * 8 + ['one']), 'finite numbers'),
        ('camera_matrix', matrix(3, 3, [1.0] * 8 + [True]), 'finite numbers'),
        ('camera_matrix', matrix(3, 3, [1.0] * 8 + [math.inf]), 'finite numbers'),
        ('rectification_matrix', 'none', 'rows: 3, cols: 3'),
        ('projection_matrix', matrix(3, 3, [1.0] * 9), 'rows: 3, cols: 4'),
        ('binning_x', 2, '0 or 1'),
    ],
)
def test_a_bad_field_is_named(file: Path, field: str, value: object, allowed: str) -> None:
    edited(file, **{field: value})
    with pytest.raises(CalibrationError) as refused:
        read_calibration(file)
    message = str(refused.value)
    assert message.startswith(f'calibration file {file}: {field}')
    assert allowed in message


@pytest.mark.parametrize('field', ['image_width', 'camera_matrix', 'projection_matrix'])
def test_a_missing_field_is_named(file: Path, field: str) -> None:
    edited(file, **{field: None})
    with pytest.raises(CalibrationError, match=f'{file}: {field} is missing'):
        read_calibration(file)


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (b'image_width: [640', 'is not valid YAML'),
        (b'\xff\xfe\x00\x00', 'is not valid YAML'),
        (b'', 'holds no fields'),
        (b'- 640\n', 'holds no fields'),
        (b'!!python/object/apply:os.system ["true"]', 'is not valid YAML'),
        (b'[' * 20000, 'is not valid YAML'),
        (b'#' * (LARGEST_FILE + 1), 'is longer than 65536 bytes'),
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / 'camera.yaml'
    path.write_bytes(content)
    with pytest.raises(CalibrationError, match=reason):
        read_calibration(path)


def test_a_lens_that_folds_inside_of_the_image_is_refused(file: Path) -> None:
    edited(file, distortion_coefficients=matrix(1, 5, [-5.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(
        CalibrationError, match=r'head_camera.yaml: camera distortion \(-5.0, .* folds inside'
    ):
        read_calibration(file)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r'none.yaml cannot be read: No such file'):
        read_calibration(tmp_path / 'none.yaml')
    with pytest.raises(CalibrationError, match='cannot be read: Is a directory'):
        read_calibration(tmp_path)


def test_file_urls() -> None:
    assert calibration_path('file:///etc/my%20camera.yaml') == Path('/etc/my camera.yaml')
    assert calibration_path('file://localhost/etc/camera.yaml') == Path('/etc/camera.yaml')


@pytest.mark.parametrize(
    'url',
    ['/etc/camera.yaml', 'http://host/a.yaml', 'file://host/a.yaml', 'file://', 'package://a'],
)
def test_other_urls_are_refused(url: str) -> None:
    with pytest.raises(CalibrationError, match='allowed: file:///absolute/path or package://'):
        calibration_path(url)


@pytest.mark.skipif(
    importlib.util.find_spec('ament_index_python') is None, reason='ament_index_python is not here'
)
def test_package_urls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marker = tmp_path / 'share' / 'ament_index' / 'resource_index' / 'packages' / 'my_robot'
    marker.parent.mkdir(parents=True)
    marker.touch()
    (tmp_path / 'share' / 'my_robot').mkdir()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    expected = tmp_path / 'share' / 'my_robot' / 'config' / 'camera.yaml'
    assert calibration_path('package://my_robot/config/camera.yaml') == expected
    with pytest.raises(CalibrationError, match="'other_robot', which is not installed"):
        calibration_path('package://other_robot/config/camera.yaml')


def test_package_urls_without_ament(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__('sys').modules, 'ament_index_python.packages', None)
    with pytest.raises(CalibrationError, match='ament_index_python is not installed; use file:'):
        calibration_path('package://my_robot/camera.yaml')
