"""A growing sweep: frames of known arm azimuth become columns of panoramas."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import ALIGNED, Mounting, Panorama, PanoramaGeometry, PinholeCamera
from panodepth_ros.mosaic.lookup import ColumnLookup, focal_length, snapped, visible_rows

#: A frame serves the columns whose arm azimuth is closer to its own than this [columns].
REACH = 0.75
#: 360° may differ by this much from a whole number of column steps [columns].
WHOLE_TURN_TOLERANCE = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """
    What the sweep assumes about the arm and takes from each frame.

    Attributes
    ----------
    arm_radius : float
        r, axis to optical centre [m].
    column_offset : float
        Distance of the left and right eye's columns from the principal point [px].
    columns : int
        N, columns of a full turn.
    sweep_columns : int
        Columns that a sweep covers, N for a full turn.
    mounting : Mounting
        The camera's rotation against the arm, by default none.
    """

    arm_radius: float
    column_offset: float
    columns: int
    sweep_columns: int
    mounting: Mounting = ALIGNED

    @property
    def column_step(self) -> float:
        """θ0 [rad]."""
        return 2 * math.pi / self.columns


def columns_per_turn(column_step_deg: float) -> int:
    """
    Columns of a full turn for a column step.

    Raises
    ------
    ValueError
        If a full turn is not a whole number of steps.
    """
    columns = 360 / abs(column_step_deg)
    whole = round(columns)
    if abs(columns - whole) > WHOLE_TURN_TOLERANCE:
        raise ValueError(
            f'column_step_deg is {column_step_deg}: a turn of 360° would take {columns:.3f} '
            f'columns; allowed: whole fractions of 360°, such as {360 / whole:.7g}'
        )
    return whole


class _View:
    """One of the panoramas under construction."""

    def __init__(
        self, camera: PinholeCamera, offset_px: float, rows: tuple[int, int], columns: int
    ) -> None:
        first_row, self.rows = rows
        self.principal_angle = camera.ray_angle(offset_px)
        self.focal_length_px = focal_length(camera, offset_px)
        self.principal_row = camera.cy - first_row
        rows_down = np.arange(self.rows, dtype=np.float64)
        slope = (self.principal_row - rows_down) / self.focal_length_px
        self.lookup = ColumnLookup(camera, slope)
        self.ray_angle = np.full(columns, np.nan)
        self.image: npt.NDArray[np.uint8] | None = None


class Sweep:
    """
    Panoramas of the left eye, the right eye and the centre, filled frame by frame.

    Column x belongs to the arm azimuth ``reference + (N/2 − x)·θ0``, so that azimuth 0 is near
    the middle. A frame fills the columns within :data:`REACH` of its own azimuth, each sampled
    along the ray that looks at the column's azimuth exactly; of two frames the nearer wins, of
    two equally near ones the earlier.

    Parameters
    ----------
    rig : Rig
        Arm and columns.
    camera : PinholeCamera
        The calibrated camera, to be mounted as the rig says.
    first_azimuth : float
        Arm azimuth of the first frame [rad]; it lies on the column grid.

    Raises
    ------
    ValueError
        If the columns lie outside the image.
    """

    def __init__(self, rig: Rig, camera: PinholeCamera, first_azimuth: float) -> None:
        self.rig = rig
        self.camera = camera = replace(camera, mounting=rig.mounting)
        self._first_azimuth = first_azimuth
        self._reference = math.remainder(first_azimuth, rig.column_step)
        # Right of the image centre is what the left eye sees.
        offsets = {'left': rig.column_offset, 'right': -rig.column_offset, 'center': 0.0}
        rows = visible_rows(camera, tuple(offsets.values()), REACH * rig.column_step)
        self._views = {
            name: _View(camera, offset, rows, rig.columns) for name, offset in offsets.items()
        }
        self._deviation = np.full(rig.columns, np.inf)
        self.start: int | None = None
        self.end: int | None = None

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Columns that a frame has reached, shape (N,)."""
        return np.asarray(np.isfinite(self._deviation))

    @property
    def progress(self) -> float:
        """Share of the sweep's columns that are seen, in [0, 1]."""
        return min(1.0, int(self.seen.sum()) / self.rig.sweep_columns)

    @property
    def complete(self) -> bool:
        """Whether every column of the sweep is seen."""
        return int(self.seen.sum()) >= self.rig.sweep_columns

    def columns_left(self, arm_azimuth: float) -> int:
        """How many columns the arm has to go to the sweep's last one; negative beyond it."""
        travelled = abs(arm_azimuth - self._first_azimuth) / self.rig.column_step
        return self.rig.sweep_columns - 1 - round(travelled)

    def add(self, stamp: int, image: npt.NDArray[np.uint8], arm_azimuth: float) -> int:
        """
        Take the columns that one frame offers.

        Parameters
        ----------
        stamp : int
            Time of exposure [ns].
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
            The frame.
        arm_azimuth : float
            γ [rad].

        Returns
        -------
        int
            How many columns it filled or improved.

        Raises
        ------
        ValueError
            If the image has another size than the camera or another kind than the first one.
        """
        expected = (self.camera.height, self.camera.width)
        if image.shape[:2] != expected:
            raise ValueError(
                f'frame is {image.shape[1]} × {image.shape[0]} px; '
                f'allowed: {expected[1]} × {expected[0]}, as the camera_info says'
            )
        first = self._views['left'].image
        if first is not None and first.shape[2:] != image.shape[2:]:
            raise ValueError(
                f'frame has {image.shape[2] if image.ndim == 3 else 1} channels, '
                f'the sweep began with {first.shape[2] if first.ndim == 3 else 1}'
            )
        rig = self.rig
        own = rig.columns / 2 - (arm_azimuth - self._reference) / rig.column_step
        filled = 0
        for column in range(math.ceil(own - REACH), math.floor(own + REACH) + 1):
            filled += self._fill(column % rig.columns, (own - column) * rig.column_step, image)
        if filled:
            self.start = stamp if self.start is None else self.start
            self.end = stamp
        return filled

    def _fill(self, x: int, deviation: float, image: npt.NDArray[np.uint8]) -> bool:
        """Fill column x, whose ray azimuths lie ``deviation`` from the frame's principal rays."""
        if abs(deviation) >= self._deviation[x]:
            return False
        samples = {}
        for name, view in self._views.items():
            angle = snapped(view.principal_angle + deviation, view.principal_angle)
            column = view.lookup.column(image, angle)
            if column is None:
                return False
            samples[name] = (angle, column)
        for name, (angle, column) in samples.items():
            view = self._views[name]
            if view.image is None:
                shape = (view.rows, self.rig.columns, *image.shape[2:])
                view.image = np.zeros(shape, np.uint8)
            view.image[:, x] = column
            view.ray_angle[x] = angle
        self._deviation[x] = abs(deviation)
        return True

    def panoramas(self) -> dict[str, Panorama]:
        """
        Return the panoramas as they are: ``left``, ``right`` and ``center``.

        Raises
        ------
        ValueError
            If no column was seen yet.
        """
        if self.start is None or self.end is None:
            raise ValueError('no column was seen yet')
        duration = (self.end - self.start) / 1e9
        panoramas = {}
        for name, view in self._views.items():
            assert view.image is not None
            azimuth_column = (
                self.rig.columns / 2
                + (self._reference + view.principal_angle) / self.rig.column_step
            )
            geometry = PanoramaGeometry(
                columns=self.rig.columns,
                rows=view.rows,
                azimuth_column=azimuth_column,
                focal_length_px=view.focal_length_px,
                principal_row=view.principal_row,
                arm_radius=self.rig.arm_radius,
                principal_angle=view.principal_angle,
                sweep_duration=duration,
                ray_angle=view.ray_angle.copy(),
            )
            panoramas[name] = Panorama(view.image.copy(), geometry)
        return panoramas

    def missing_sectors(self) -> list[tuple[float, float]]:
        """
        Arm azimuths of the stretches that no frame reached.

        Returns
        -------
        list of (float, float)
            First and last arm azimuth of each stretch [rad], in [−π, π], clockwise as columns run.
        """
        lost = np.flatnonzero(~self.seen)
        runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1) if lost.size else []
        step, half = self.rig.column_step, self.rig.columns / 2
        return [
            (
                self._reference + (half - float(run[0])) * step,
                self._reference + (half - float(run[-1])) * step,
            )
            for run in runs
        ]
