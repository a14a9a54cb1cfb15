"""
Calibration files as camera_info_manager writes and reads them, and the URLs that name them.

No ROS here; the camera node makes the message.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import yaml

from panodepth_ros.geometry.camera import DISTORTION_MODELS, PinholeCamera
from panodepth_ros.geometry.lens import check_lens

#: A calibration has 1 kB; what is much longer is something else [bytes].
LARGEST_FILE = 65536

_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class CalibrationError(ValueError):
    """A calibration cannot be found, read, or used: a sentence that says which, where and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """
    What a calibration file says of a camera.

    Attributes
    ----------
    image_width, image_height : int
        Size of the calibrated images [px].
    camera_name : str
        The camera that was calibrated.
    camera_matrix : tuple of 9 float
        K row by row [px].
    distortion_model : str
        A key of :data:`panodepth_ros.geometry.camera.DISTORTION_MODELS`.
    distortion_coefficients : tuple of float
        D in the model's order.
    rectification_matrix : tuple of 9 float
        R row by row.
    projection_matrix : tuple of 12 float
        P row by row [px].
    """

    image_width: int
    image_height: int
    camera_name: str
    camera_matrix: tuple[float, ...]
    distortion_model: str
    distortion_coefficients: tuple[float, ...]
    rectification_matrix: tuple[float, ...]
    projection_matrix: tuple[float, ...]

    @classmethod
    def of_pinhole(cls, camera: PinholeCamera, camera_name: str) -> Calibration:
        """Calibration of a pinhole camera with its lens; the mounting is not part of it."""
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        return cls(
            image_width=camera.width,
            image_height=camera.height,
            camera_name=camera_name,
            camera_matrix=(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
            distortion_model=camera.distortion_model,
            distortion_coefficients=camera.distortion or (0.0,) * 5,
            rectification_matrix=_IDENTITY,
            projection_matrix=(fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
        )

    def pinhole(self) -> PinholeCamera:
        """
        Return the camera that is calibrated, not mounted.

        Raises
        ------
        ValueError
            If the values cannot describe a camera.
        """
        fx, _, cx, _, fy, cy, *_ = self.camera_matrix
        return PinholeCamera(
            width=self.image_width,
            height=self.image_height,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            distortion_model=self.distortion_model,
            distortion=self.distortion_coefficients,
        )


def calibration_path(url: str) -> Path:
    """
    Where the file of a calibration URL is.

    Parameters
    ----------
    url : str
        ``file:///absolute/path`` or ``package://package_name/path``.

    Raises
    ------
    CalibrationError
        If the URL is of another kind, or its package is not installed.
    """
    parts = urlsplit(url)
    path = unquote(parts.path)
    if parts.scheme == 'file' and parts.netloc in ('', 'localhost') and len(path) > 1:
        return Path(path)
    if parts.scheme == 'package' and parts.netloc and len(path) > 1:
        return _share_directory(parts.netloc, url) / path.lstrip('/')
    raise CalibrationError(
        f'camera_info_url is {url!r}; allowed: file:///absolute/path or package://name/path'
    )


def _share_directory(package: str, url: str) -> Path:
    try:
        from ament_index_python.packages import (  # noqa: PLC0415 - ROS is not always there
            PackageNotFoundError,
            get_package_share_directory,
        )
    except ImportError as error:
        raise CalibrationError(
            f'camera_info_url {url} cannot be followed: ament_index_python is not installed; '
            'use file:///absolute/path'
        ) from error
    try:
        return Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError) as error:
        raise CalibrationError(
            f'camera_info_url {url} names package {package!r}, which is not installed here'
        ) from error


def read_calibration(path: Path) -> Calibration:
    """
    Read a calibration file.

    Parameters
    ----------
    path : Path
        YAML file as camera_info_manager writes it. As there, a missing ``distortion_model``
        means ``plumb_bob``, and fields it does not know are passed over.

    Raises
    ------
    CalibrationError
        Names the file, the field, its value and what is allowed.
    """
    try:
        with path.open('rb') as file:
            text = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise CalibrationError(
            f'calibration file {path} cannot be read: {error.strerror}'
        ) from error
    if len(text) > LARGEST_FILE:
        raise CalibrationError(
            f'calibration file {path} is longer than {LARGEST_FILE} bytes; that is not one'
        )
    try:
        content = yaml.safe_load(text)
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        reason = ' '.join(str(error).split())
        raise CalibrationError(f'calibration file {path} is not valid YAML: {reason}') from error
    if not isinstance(content, Mapping):
        raise CalibrationError(f'calibration file {path} holds no fields; allowed: a YAML mapping')
    return _Reader(path, content).calibration()


class _Reader:
    """Takes fields out of one file; every complaint names the file and the field."""

    def __init__(self, path: Path, content: Mapping[Any, Any]) -> None:
        self._path = path
        self._content = content

    def calibration(self) -> Calibration:
        model = self._content.get('distortion_model', 'plumb_bob')
        if model not in DISTORTION_MODELS:
            self._refuse('distortion_model', model, ', '.join(DISTORTION_MODELS))
        coefficients = self._matrix('distortion_coefficients', 1, None)
        lengths = DISTORTION_MODELS[model]
        if len(coefficients) not in lengths:
            allowed = f'{" or ".join(map(str, lengths))} values for {model}'
            self._refuse('distortion_coefficients', coefficients, allowed)
        camera_matrix = self._matrix('camera_matrix', 3, 3)
        if min(camera_matrix[0], camera_matrix[4]) <= 0.0:
            self._refuse('camera_matrix', camera_matrix, 'focal lengths above 0')
        for field in ('binning_x', 'binning_y'):
            if self._content.get(field, 0) not in (0, 1):
                self._refuse(field, self._content[field], '0 or 1')
        name = self._content.get('camera_name', '')
        if not isinstance(name, str):
            self._refuse('camera_name', name, 'a string')
        calibration = Calibration(
            image_width=self._size('image_width'),
            image_height=self._size('image_height'),
            camera_name=name,
            camera_matrix=camera_matrix,
            distortion_model=model,
            distortion_coefficients=coefficients,
            rectification_matrix=self._matrix('rectification_matrix', 3, 3),
            projection_matrix=self._matrix('projection_matrix', 3, 4),
        )
        try:
            check_lens(calibration.pinhole())
        except ValueError as error:
            raise CalibrationError(f'calibration file {self._path}: {error}') from error
        return calibration

    def _refuse(self, field: str, value: object, allowed: str) -> None:
        raise CalibrationError(
            f'calibration file {self._path}: {field} is {value!r}; allowed: {allowed}'
        )

    def _field(self, field: str) -> Any:
        if field not in self._content:
            raise CalibrationError(f'calibration file {self._path}: {field} is missing')
        return self._content[field]

    def _size(self, field: str) -> int:
        value = self._field(field)
        if type(value) is not int or not 0 < value < 2**16:
            self._refuse(field, value, 'a whole number of pixels from 1 to 65535')
        return int(value)

    def _matrix(self, field: str, rows: int, columns: int | None) -> tuple[float, ...]:
        matrix = self._field(field)
        shape = f'rows: {rows}, cols: {columns or "n"}, data: [numbers]'
        if not isinstance(matrix, Mapping) or not isinstance(matrix.get('data'), list):
            self._refuse(field, matrix, shape)
        numbers = tuple(_number(value) for value in matrix['data'])
        wide = columns if columns is not None else len(numbers)
        if (matrix.get('rows'), matrix.get('cols'), len(numbers)) != (rows, wide, rows * wide):
            self._refuse(field, dict(matrix), shape)
        if not all(map(math.isfinite, numbers)):
            self._refuse(f'{field} data', matrix['data'], 'finite numbers')
        return numbers


def _number(value: object) -> float:
    """A number of a YAML list; NaN for what is none. YAML 1.1 calls 1e-05 a string: it is not."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def write_calibration(calibration: Calibration, path: Path) -> None:
    """
    Write a calibration file, field by field in the order of camera_info_manager.

    Numbers are written with all their digits, so that reading gives the same calibration.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    lines = [
        f'image_width: {calibration.image_width}',
        f'image_height: {calibration.image_height}',
        yaml.safe_dump({'camera_name': calibration.camera_name}).rstrip('\n'),
        *_lines('camera_matrix', 3, calibration.camera_matrix),
        f'distortion_model: {calibration.distortion_model}',
        *_lines('distortion_coefficients', 1, calibration.distortion_coefficients),
        *_lines('rectification_matrix', 3, calibration.rectification_matrix),
        *_lines('projection_matrix', 3, calibration.projection_matrix),
    ]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')


def store_calibration(calibration: Calibration, path: Path | None) -> Calibration:
    """
    Check a calibration by writing and reading it, then put it at its place in one move.

    Parameters
    ----------
    calibration : Calibration
        As it came from outside.
    path : Path or None
        File to replace, in an existing folder; None only checks.

    Returns
    -------
    Calibration
        As it was read back.

    Raises
    ------
    CalibrationError
        As :func:`read_calibration`.
    OSError
        If the file cannot be written.
    """
    with tempfile.TemporaryDirectory(dir=path.parent if path is not None else None) as folder:
        draft = Path(folder, path.name if path is not None else 'proposed.yaml')
        write_calibration(calibration, draft)
        checked = read_calibration(draft)
        if path is not None:
            os.replace(draft, path)
    return checked


def _lines(field: str, rows: int, numbers: tuple[float, ...]) -> list[str]:
    # YAML 1.1 wants a point in a number with an exponent.
    texts = [
        text if '.' in text else text.replace('e', '.0e')
        for text in (repr(float(number)) for number in numbers)
    ]
    columns = len(numbers) // rows
    return [f'{field}:', f'  rows: {rows}', f'  cols: {columns}', f'  data: [{", ".join(texts)}]']
