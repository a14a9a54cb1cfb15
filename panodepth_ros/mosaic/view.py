"""One of the panoramas under construction, and the part of the frames that it needs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PanoramaGeometry, PinholeCamera
from panodepth_ros.mosaic.lookup import ColumnLookup, focal_length
from panodepth_ros.mosaic.rig import Rig

#: A pixel reaches half a pixel beyond its centre.
_HALF_PIXEL = 0.5 + 1e-6


class Mark(NamedTuple):
    """
    How far a sweep was.

    Attributes
    ----------
    deviation : ndarray of float64, shape (N,)
        Of each column's frame from the column [rad]; +inf where none was seen.
    frames, changes : int
        Frames whose light was looked at, and changes of a part of the view that were noted.
    """

    deviation: npt.NDArray[np.float64]
    frames: int
    changes: int


class View:
    """
    A panorama under construction.

    Parameters
    ----------
    camera : PinholeCamera
        The calibrated camera, mounted.
    offset_px : float
        Ideal column of the panorama, relative to the principal point [px].
    rows : (int, int)
        First row and number of rows, of :func:`visible_rows`.
    columns : int
        Columns of a full turn, N.

    Attributes
    ----------
    principal_angle : float
        ψ of the ideal column [rad].
    image : ndarray of uint8, shape (H, N) or (H, N, 3), or None
        None before the first column.
    ray_angle : ndarray of float64, shape (N,)
        ψ of each column [rad]; NaN where none was seen.
    """

    def __init__(
        self, camera: PinholeCamera, offset_px: float, rows: tuple[int, int], columns: int
    ) -> None:
        first_row, self._rows = rows
        self.principal_angle = camera.ray_angle(offset_px)
        self._focal_length_px = focal_length(camera, offset_px)
        self._principal_row = camera.cy - first_row
        rows_down = np.arange(self._rows, dtype=np.float64)
        slope = (self._principal_row - rows_down) / self._focal_length_px
        self.lookup = ColumnLookup(camera, slope, 2 * math.pi / columns)
        self.ray_angle = np.full(columns, np.nan)
        self.image: npt.NDArray[np.uint8] | None = None

    def fill(self, x: int, ray_angle: float, column: npt.NDArray[np.uint8]) -> None:
        """Let a column, shape (H,) or (H, 3), be column x, along a ray angle [rad]."""
        if self.image is None:
            shape = (self._rows, self.ray_angle.size, *column.shape[1:])
            self.image = np.zeros(shape, np.uint8)
        self.image[:, x] = column
        self.ray_angle[x] = ray_angle

    def geometry(
        self, rig: Rig, reference: float, duration: float, ray_angle: npt.NDArray[np.float64]
    ) -> PanoramaGeometry:
        """
        Return the geometry of the panorama.

        Parameters
        ----------
        rig : Rig
        reference : float
            Arm azimuth that belongs to column N/2 [rad].
        duration : float
            From the first frame to the last one [s].
        ray_angle : ndarray of float64, shape (N,)
            ψ of the columns that count as seen [rad], NaN of the others.
        """
        return PanoramaGeometry(
            columns=rig.columns,
            rows=self._rows,
            azimuth_column=rig.columns / 2 + (reference + self.principal_angle) / rig.column_step,
            focal_length_px=self._focal_length_px,
            principal_row=self._principal_row,
            arm_radius=rig.arm_radius,
            principal_angle=self.principal_angle,
            sweep_duration=duration,
            ray_angle=ray_angle,
            stripe_distance=rig.stripe_distance,
        )

    def arrays(
        self, name: str, columns: npt.NDArray[np.int64] | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """
        Return what frames have left here, for :meth:`take_up`.

        Parameters
        ----------
        name : str
            With which the names begin.
        columns : ndarray of int64, or None
            Only these; None for all.
        """
        assert self.image is not None
        part = slice(None) if columns is None else columns
        return {
            f'{name}.image': np.array(self.image[:, part]),
            f'{name}.ray_angle': np.array(self.ray_angle[part]),
        }

    def take_up(
        self, name: str, arrays: Mapping[str, npt.NDArray[Any]], seen: npt.NDArray[np.bool_]
    ) -> None:
        """
        Go on from :meth:`arrays` of another one, of which the columns ``seen`` were seen.

        Raises
        ------
        ValueError
            If they are of another size or of other columns.
        """
        columns = self.ray_angle.size
        colours = arrays.get(f'{name}.image', np.empty(0)).shape[2:]
        shape = (self._rows, columns, *((3,) if colours else ()))
        self.image = checked(arrays, f'{name}.image', shape, np.uint8)
        self.ray_angle = checked(arrays, f'{name}.ray_angle', (columns,), np.float64)
        if not np.array_equal(np.isfinite(self.ray_angle), seen):
            raise ValueError(f'{name} has other columns than the sweep')


def by_column(name: str) -> bool:
    """Whether the array of a sweep that has this name has an entry for every column."""
    first, _, last = name.rpartition('.')
    return last in ('deviation', 'frame', 'ray_angle') or (last == 'image' and 'seam' not in first)


def checked(
    arrays: Mapping[str, npt.NDArray[Any]], name: str, shape: tuple[int, ...], kind: type
) -> npt.NDArray[Any]:
    """
    Return a copy of an array if it has the shape and kind that it should have.

    Raises
    ------
    ValueError
        If it has not, or is missing.
    """
    array = arrays.get(name)
    if array is None or array.shape != shape or array.dtype != kind:
        found = 'nothing' if array is None else f'{array.dtype} {array.shape}'
        raise ValueError(f'{name} is {found}; allowed: {np.dtype(kind)} {shape}')
    return np.array(array)


def widest_deviation(rig: Rig, camera: PinholeCamera, offsets_px: tuple[float, ...]) -> float:
    """Return the largest deviation of a ray from its principal angle [rad]."""
    reach = rig.reach * rig.column_step
    middles = [camera.ray_angle(offset) for offset in offsets_px]
    return max(
        abs(rig.ray_angle(middle, side * reach) - middle) for middle in middles for side in (1, -1)
    )


def check_stripes(
    rig: Rig, camera: PinholeCamera, offsets_px: tuple[float, ...], row_turn: float = 0.0
) -> None:
    """
    Refuse stripes that reach over the image's side, also by a rolling shutter's shear.

    Parameters
    ----------
    rig : Rig
    camera : PinholeCamera
        The calibrated camera, mounted.
    offsets_px : tuple of float
        Ideal columns of the panoramas, relative to the principal point [px].
    row_turn : float
        How far the arm turns from the exposure of one row to that of the next [rad].

    Raises
    ------
    ValueError
        If one does.
    """
    half = (rig.stripe_columns - 1) / 2 * rig.column_step
    shear = 0.5 * (camera.height - 1) * abs(row_turn)
    for offset in offsets_px:
        middle = camera.ray_angle(offset)
        angles = [rig.ray_angle(middle, side * half) + side * shear for side in (1, 0, -1)]
        u, _ = camera.project(angles, [math.tan(camera.mounting.tilt)])
        if not (u >= -_HALF_PIXEL).all() or not (u <= camera.width - 1 + _HALF_PIXEL).all():
            rolling = f', with {math.degrees(shear):.1f}° of turn within half a frame, reaches'
            digits = 0 if shear else 1  # the speed of an arm varies, the sentence should not
            raise ValueError(
                f'the stripe of {rig.stripe_columns} columns around {offset:+g} px from the '
                f'principal point{rolling if shear else " reaches"} from u = {u[0]:.{digits}f} to '
                f'{u[2]:.{digits}f}, over the side of the image; allowed: 0 to {camera.width - 1}'
            )
