"""A growing sweep: frames of known arm azimuth become columns of panoramas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PinholeCamera
from panodepth_ros.mosaic.closure import Seam, redistributed
from panodepth_ros.mosaic.light import Change, Light, at_frames, changed_columns
from panodepth_ros.mosaic.lookup import snapped, visible_rows
from panodepth_ros.mosaic.rig import Rig, panorama_names
from panodepth_ros.mosaic.view import Mark, View, check_stripes, checked, widest_deviation

#: Frames so close to a column's place have met it [columns].
SAME_PLACE = 1e-6


class Sweep:
    """
    Panoramas of the left eye, the right eye, further pairs and the centre, filled frame by frame.

    Column x belongs to the arm azimuth ``reference + (N/2 − x)·θ0``, so that azimuth 0 is near
    the middle. A frame fills the columns within the rig's reach of its own azimuth, each sampled
    along the ray that the rig gives it, which looks at the column's azimuth exactly, or at its
    point at the stripe distance; of two frames the nearer wins, of two equally near ones the
    earlier.

    Parameters
    ----------
    rig : Rig
        Arm and columns.
    camera : PinholeCamera
        The calibrated camera, to be mounted as the rig says.
    first_azimuth : float
        Arm azimuth of the first frame [rad]; its stripe lies on the column grid: a column in the
        middle of an odd stripe, two beside the middle of an even one.

    Raises
    ------
    ValueError
        If the columns, or the stripes around them, lie outside the image.
    """

    def __init__(self, rig: Rig, camera: PinholeCamera, first_azimuth: float) -> None:
        self.rig = rig
        self.camera = camera = replace(camera, mounting=rig.mounting)
        self._first_azimuth = first_azimuth
        off_middle = 0.5 * rig.column_step if rig.stripe_columns % 2 == 0 else 0.0
        self._reference = math.remainder(first_azimuth + off_middle, rig.column_step)
        # Right of the image centre is what the left eye sees.
        pairs = (rig.column_offset, *rig.further_offsets)
        offsets = (*(side * offset for offset in pairs for side in (1, -1)), 0.0)
        rows = visible_rows(camera, offsets, widest_deviation(rig, camera, offsets))
        self._offsets = offsets
        check_stripes(rig, camera, offsets)
        names = panorama_names(len(rig.further_offsets))
        self._views = {
            name: View(camera, offset, rows, rig.columns)
            for name, offset in zip(names, offsets, strict=True)
        }
        self._deviation = np.full(rig.columns, np.inf)
        self.start: int | None = None
        self.end: int | None = None
        self._last_azimuth = first_azimuth
        self.seam = Seam() if rig.turn_closes else None
        self.light = Light(camera) if rig.mends_light else None
        self._frame: npt.NDArray[Any] = np.zeros(rig.columns, np.int64)

    @property
    def velocity(self) -> float:
        """Mean velocity of the arm [rad/s]; 0 before the second frame."""
        if self.start is None or self.end is None or self.end == self.start:
            return 0.0
        return (self._last_azimuth - self._first_azimuth) * 1e9 / (self.end - self.start)

    @property
    def last_azimuth(self) -> float:
        """Arm azimuth of the last frame [rad]."""
        return self._last_azimuth

    @property
    def direction(self) -> int:
        """1 if the arm turns counter-clockwise, −1 if clockwise; 0 before the second frame."""
        way = self._last_azimuth - self._first_azimuth
        return int(math.copysign(1.0, way)) if way else 0

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Columns that a frame has reached, shape (N,)."""
        return np.asarray(np.isfinite(self._deviation))

    @property
    def settled(self) -> npt.NDArray[np.bool_]:
        """
        Columns that no later frame changes, shape (N,), as long as the arm keeps its direction.

        The arm has passed their places. Those that the first frame filled behind it may be filled
        again by the last one.
        """
        rig, turned = self.rig, self._last_azimuth - self._first_azimuth
        ahead = self._column(self._first_azimuth) - np.arange(rig.columns)
        ahead *= math.copysign(1.0, turned)
        # Rounding must not decide about a column that a frame has met exactly.
        ahead = (ahead + SAME_PLACE) % rig.columns
        passed = ahead <= abs(turned) / rig.column_step + 2 * SAME_PLACE
        return np.asarray(self.seen & passed & (ahead < rig.columns - rig.reach))

    @property
    def progress(self) -> float:
        """Share of the sweep's columns that are seen, in [0, 1]."""
        return min(1.0, int(self.seen.sum()) / self.rig.sweep_columns)

    @property
    def complete(self) -> bool:
        """Whether every column of the sweep is seen."""
        return int(self.seen.sum()) >= self.rig.sweep_columns

    def columns_left(self, arm_azimuth: float) -> int:
        """How many columns the arm has to go to the sweep's last frame; negative beyond it."""
        last = (self.rig.sweep_steps - 1) * self.rig.stripe_columns
        return last - round(self.travelled(arm_azimuth))

    def ends_at(self, arm_azimuth: float) -> bool:
        """Whether the frame of an arm azimuth [rad], which was added, is the sweep's last one."""
        rig = self.rig
        filled = self.complete and rig.sweep_steps == rig.sweep_frames
        return filled or self.columns_left(arm_azimuth) == 0

    def travelled(self, arm_azimuth: float) -> float:
        """How far the arm is from where the sweep began, to either side [columns]."""
        return abs(arm_azimuth - self._first_azimuth) / self.rig.column_step

    def closes_at(self, arm_azimuth: float) -> bool:
        """Whether the arm stands where it stood for the first frame, a full turn on."""
        return round(self.travelled(arm_azimuth)) == self.rig.columns

    def add(
        self,
        stamp: int,
        image: npt.NDArray[np.uint8],
        arm_azimuth: float,
        *,
        row_turn: float = 0.0,
    ) -> int:
        """
        Take the columns that one frame offers.

        Parameters
        ----------
        stamp : int
            Time of exposure [ns].
        image : ndarray of uint8, shape (H, W) or (H, W, 3)
            The frame.
        arm_azimuth : float
            γ [rad], when the middle row was exposed.
        row_turn : float
            How far the arm turns from the exposure of one row to that of the next [rad], 0 for a
            global shutter.

        Returns
        -------
        int
            How many columns it filled or improved; none by the frame at 360°, which only tells
            whether the turn closes.

        Raises
        ------
        ValueError
            If the image has another size than the camera or another kind than the first one, or a
        rolling shutter shears the stripes over its side.
        """
        self._check(image, row_turn)
        if self.rig.sweep_steps > self.rig.sweep_frames and self.columns_left(arm_azimuth) <= 0:
            self._count(stamp, image, arm_azimuth)
            return 0
        return self._take(stamp, image, arm_azimuth, row_turn)

    def _check(self, image: npt.NDArray[np.uint8], row_turn: float) -> None:
        """Raise a ValueError for a frame that does not belong to the sweep."""
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
        if row_turn:
            check_stripes(self.rig, self.camera, self._offsets, row_turn)

    def _take(
        self, stamp: int, image: npt.NDArray[np.uint8], arm_azimuth: float, row_turn: float
    ) -> int:
        """Fill the columns around a frame; return how many."""
        rig, own = self.rig, self._column(arm_azimuth)
        filled = 0
        for column in range(math.ceil(own - rig.reach), math.floor(own + rig.reach) + 1):
            deviation = (own - column) * rig.column_step
            filled += self._fill(column % rig.columns, deviation, image, row_turn)
        if filled:
            self._count(stamp, image, arm_azimuth)
        return filled

    def _column(self, arm_azimuth: float) -> float:
        """Column that belongs to an arm azimuth [rad], not wrapped."""
        return self.rig.columns / 2 - (arm_azimuth - self._reference) / self.rig.column_step

    def _count(self, stamp: int, image: npt.NDArray[np.uint8], arm_azimuth: float) -> None:
        """Let a frame be the last one that was taken."""
        self.start = stamp if self.start is None else self.start
        self.end = stamp
        self._last_azimuth = arm_azimuth
        if self.seam is not None:
            self.seam.take(image, arm_azimuth)
        if self.light is not None:
            self.light.take(image, arm_azimuth)

    def _fill(
        self, x: int, deviation: float, image: npt.NDArray[np.uint8], row_turn: float
    ) -> bool:
        """Fill column x, which belongs to ``deviation`` beyond the frame's arm azimuth."""
        if abs(deviation) >= self._deviation[x]:
            return False
        samples = self._samples(deviation, image, row_turn)
        if samples is None:
            return False
        for view, (angle, column) in zip(self._views.values(), samples, strict=True):
            view.fill(x, angle, column)
        self._deviation[x] = abs(deviation)
        self._frame[x] = self.light.frames if self.light is not None else 0
        return True

    def _samples(
        self, deviation: float, image: npt.NDArray[np.uint8], row_turn: float
    ) -> list[tuple[float, npt.NDArray[np.uint8]]] | None:
        """Ray angle and column of each view, ``deviation`` beyond a frame; None if one is not."""
        samples = []
        for view in self._views.values():
            principal_angle = view.principal_angle
            angle = snapped(self.rig.ray_angle(principal_angle, deviation), principal_angle)
            column = view.lookup.column(image, angle, row_turn)
            if column is None:
                return None
            samples.append((angle, column))
        return samples

    def panoramas(self, *, settled: bool = False, lost: float = 0.0) -> dict[str, Panorama]:
        """
        Return the panoramas as they are, by the names of :func:`panorama_names`.

        Parameters
        ----------
        settled : bool
            Whether only what is :attr:`settled` counts as seen.
        lost : float
            By how much the arm of a full turn turned less than it reported [rad], little by
            little; what it saw is put where it belongs then.

        Raises
        ------
        ValueError
            If no column was seen yet.
        """
        if self.start is None or self.end is None:
            raise ValueError('no column was seen yet')
        duration = (self.end - self.start) / 1e9
        shown = self.settled if settled else self.seen
        order = self._order()
        mends = self.light is not None and not settled
        gains, changes = self.light_steps() if mends else (np.ones((1, 1)), [])
        gains = at_frames(gains, self._frame) if mends else gains
        widest = max(abs(view.principal_angle) for view in self._views.values())
        panoramas = {}
        for name, view in self._views.items():
            assert view.image is not None
            image, ray_angle = view.image.copy(), np.where(shown, view.ray_angle, np.nan)
            if (gains != 1.0).any():
                levels = image.reshape(*image.shape[:2], -1) / gains
                image = np.clip(np.rint(levels), 0, 255).astype(np.uint8).reshape(image.shape)
            if lost:
                image[:, order], ray_angle[order] = redistributed(
                    image[:, order], ray_angle[order], lost / self.rig.column_step
                )
            geometry = view.geometry(self.rig, self._reference, duration, ray_angle)
            if changes:
                margin = self.rig.stripe_columns * self.rig.column_step
                changed = changed_columns(geometry, changes, margin, widest)
                image[:, changed] = 0
                geometry = replace(geometry, ray_angle=np.where(changed, np.nan, ray_angle))
            panoramas[name] = Panorama(image, geometry)
        return panoramas

    def light_steps(self) -> tuple[npt.NDArray[np.float64], list[Change]]:
        """What :meth:`Light.steps` tells of a sweep whose light is looked at."""
        assert self.light is not None
        turn = math.nan
        if self.rig.sweep_columns == self.rig.columns:
            whole = self.direction * 2 * math.pi
            turn = self._first_azimuth + whole - self._last_azimuth
        return self.light.steps(turn)

    def _order(self) -> npt.NDArray[np.int64]:
        """Columns in the order in which the arm came to them, beginning behind the first frame."""
        columns, first = self.rig.columns, round(self._column(self._first_azimuth))
        ahead = np.arange(columns) - (self.rig.stripe_columns - 1) // 2
        return np.asarray((first - self.direction * ahead) % columns)

    def mark(self) -> Mark:
        """Note how far the sweep is, for :meth:`arrays`."""
        light = self.light
        return Mark(self._deviation.copy(), *(light.noted if light is not None else (0, 0)))

    def arrays(self, since: Mark | None = None) -> dict[str, npt.NDArray[Any]]:
        """
        Return all that frames have left here, for :meth:`restored`.

        Parameters
        ----------
        since : Mark or None
            Return only the columns that were filled or improved after it, and which these are,
            ``columns``; and of ``light.azimuths``, ``ratios`` and ``changes`` what was added.
        """
        columns = None
        if since is not None:
            columns = np.flatnonzero(self._deviation != since.deviation)
        part = slice(None) if columns is None else columns
        noted = (0, 0) if since is None else (since.frames, since.changes)
        arrays: dict[str, npt.NDArray[Any]] = {
            'moments': np.array([self.start or 0, self.end or 0], np.int64),
            'azimuths': np.array([self._first_azimuth, self._last_azimuth]),
            'deviation': np.array(self._deviation[part]),
            **(self.seam.arrays() if self.seam is not None else {}),
            **(self.light.arrays(*noted) if self.light is not None else {}),
            'frame': np.array(self._frame[part]),
        }
        if columns is not None:
            arrays['columns'] = columns
        for name, view in self._views.items():
            arrays |= view.arrays(name, columns)
        return arrays

    @classmethod
    def restored(
        cls, rig: Rig, camera: PinholeCamera, arrays: Mapping[str, npt.NDArray[Any]]
    ) -> Sweep:
        """
        Make the sweep whose :meth:`arrays` these are.

        Raises
        ------
        ValueError
            If they are not those of a sweep of this rig and camera.
        """
        azimuths = checked(arrays, 'azimuths', (2,), np.float64)
        sweep = cls(rig, camera, float(azimuths[0]))
        sweep._last_azimuth = float(azimuths[1])
        sweep.start, sweep.end = map(int, checked(arrays, 'moments', (2,), np.int64))
        deviation = checked(arrays, 'deviation', (rig.columns,), np.float64)
        seen = np.isfinite(deviation)
        reach = rig.reach * rig.column_step
        if not np.isfinite(azimuths).all() or not (np.abs(deviation[seen]) <= reach).all():
            raise ValueError('its numbers are not those of a sweep')
        sweep._deviation = deviation
        if sweep.seam is not None:
            sweep.seam = Seam.restored(arrays, (sweep.camera.height, sweep.camera.width))
        if sweep.light is not None:
            sweep.light = Light.restored(sweep.camera, arrays)
            frame = checked(arrays, 'frame', (rig.columns,), np.int64)
            if not ((frame >= 0) & (frame < max(1, sweep.light.frames))).all():
                raise ValueError('its columns are of frames that it does not have')
            sweep._frame = frame
        for name, view in sweep._views.items():
            view.take_up(name, arrays, seen)
        return sweep

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
        ends = [(self.rig.columns / 2 - run[[0, -1]]) * self.rig.column_step for run in runs]
        return [(self._reference + float(a), self._reference + float(b)) for a, b in ends]
