"""
Light that changes while a sweep grows: steps of a gain, and changes in a part of the view.

Neighbouring frames show nearly the same, displaced by what the arm turned in between. Means of
cells of the one frame, displaced like far away points, are compared with those of the next. One
factor per colour for all cells is a gain: a lamp, the camera's exposure or white balance. What
follows the slope of the cells' brightness is parallax, and no gain. The factors of a sweep without
changes scatter, by what comes into view and by near things; so only a factor that stands out of
this scatter is a step, and a gain that drifts by less from frame to frame is none. In a full turn
the last frame shows what the first one has shown, and tells exactly what the light has become: one
factor of just that, which the others do not come near, is the step even where all scatter.

A change in a part of the view leaves, over more than parallax can uncover, the range of grey
levels that the frame before had around there. Between the columns of the two eyes things have been
seen by the one and are still to be seen by the other: what has changed there cannot be matched.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PanoramaGeometry, PinholeCamera

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]
#: Arm azimuth at which a part of the view had changed, least and largest ray angle of it [rad].
Change = tuple[float, float, float]

#: Frames are compared at about this width [px], in cells of so many pixels.
WIDTH, CELL = 160, 8
#: Cells outside of these may be clipped and tell nothing [grey levels].
DARKEST, BRIGHTEST = 12, 235
#: Fewest cells that tell a gain, and their least share of all.
FEWEST_CELLS, LEAST_SHARE = 12, 0.25
#: Frames displaced by more of the width differ too much by near things and what comes into view,
#: to tell what has changed in a part of the view; and to tell a gain.
LARGEST_SHIFT, FARTHEST_SHIFT = 0.04, 0.12
#: A step is larger than this, and than so many median deviations of all factors [log].
LEAST_STEP, STANDING_OUT = 0.04, 20.0
#: A step that does not stand out, but explains what a turn made of the light: what it explains of
#: that at least, and what the next best does at most of what the best does.
EXPLAINED, NEXT_BEST = 0.5, 0.65
#: What the steps of a turn may leave unexplained of it [log]; more if they are large.
UNEXPLAINED = 0.05
#: Grey levels out of the range of the surroundings that are no noise, and the share of the view
#: that must be so.
LEAST_CHANGE, CHANGED_SHARE = 16, 0.01


@dataclass(frozen=True, eq=False, slots=True)
class _Overlap:
    """What two frames both show, the first one displaced; from where, how far [px], if near."""

    before: Image
    after: Image
    origin: tuple[int, int]
    shift: tuple[float, float]
    near: bool

    def ratio(self) -> Floats | None:
        """Logarithm of the gain of the second one, shape (channels,); None if it is not told."""
        rows, columns = (n // CELL for n in self.after.shape[:2])
        if rows < 2 or columns < 2:
            return None
        cells = [
            cv2.resize(
                image.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA
            ).reshape(rows, columns, -1)
            for image in (self.before, self.after)
        ]
        found = [
            _step(*(c[..., k].astype(np.float64) for c in cells)) for k in range(cells[0].shape[2])
        ]
        return None if any(step is None for step in found) else np.array(found, np.float64)

    def changed(self, gain: Floats) -> tuple[Floats, Floats]:
        """Pixels u, v of the frame where its part has changed by more than a gain."""
        brighter = np.rint(self.before * gain.astype(np.float32).squeeze())
        was = _grey(np.clip(brighter, 0, 255).astype(np.uint8))
        now = _grey(self.after).astype(np.int16)
        # Near points are displaced farther than far ones, by parallax.
        across, down = (math.ceil(1.5 * abs(shift)) + 1 for shift in self.shift)
        around = np.ones((2 * down + 1, 2 * across + 1), np.uint8)
        low = cv2.erode(was, around).astype(np.int16) - LEAST_CHANGE
        high = cv2.dilate(was, around).astype(np.int16) + LEAST_CHANGE
        off = ((now < low) | (now > high)).astype(np.uint8)
        # At the sides near things come into view from beyond what both frames show.
        off[:, : across + 1] = off[:, -across - 1 :] = 0
        off[: down + 1] = off[-down - 1 :] = 0
        # Strips as narrow as what parallax uncovers are none.
        off = cv2.morphologyEx(off, cv2.MORPH_OPEN, np.ones((down + 2, across + 2), np.uint8))
        if np.mean(off) < CHANGED_SHARE:
            return np.zeros(0), np.zeros(0)
        v, u = np.nonzero(off)
        at = np.asarray(self.origin, np.float64)
        return u + at[0], v + at[1]


class Light:
    """
    Follows the light of one sweep, frame by frame.

    Parameters
    ----------
    camera : PinholeCamera
        Of the frames, mounted.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera = camera
        self._factor = max(1, round(camera.width / WIDTH))
        self._first: Image | None = None
        self._last: Image | None = None
        self._azimuths: list[float] = []
        self._ratios: list[Floats] = []
        self._changes: list[Change] = []

    def take(self, image: Image, arm_azimuth: float) -> None:
        """Take the next frame and its arm azimuth [rad]."""
        size = image.shape[1] // self._factor, image.shape[0] // self._factor
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        if self._last is None:
            self._first = small
        else:
            both = self._overlap(self._last, small, arm_azimuth - self._azimuths[-1])
            ratio = both.ratio() if both is not None else None
            channels = 1 if small.ndim == 2 else small.shape[2]
            self._ratios.append(np.zeros(channels) if ratio is None else ratio)
            if both is not None and both.near and ratio is not None:
                self._note_change(both, np.exp(ratio), arm_azimuth)
        self._last = small
        self._azimuths.append(arm_azimuth)

    @property
    def frames(self) -> int:
        """How many frames were taken."""
        return len(self._azimuths)

    def steps(self, turn: float = math.nan) -> tuple[Floats, list[Change]]:
        """
        Tell steps of the gain from changes of a part of the view.

        Parameters
        ----------
        turn : float
            Arm azimuth of the first frame a full turn on less that of the last one [rad]; NaN if
            the sweep is no full turn. Then the steps must explain the difference of these two
            frames. What little they do not is spread over them; if they do not, the view alone
            has changed where they were found. If none was found, one may be hidden.

        Returns
        -------
        (ndarray of float64, list of Change)
            Gains of the frames against the first one, shape (frames, channels), 1 up to the first
            step; and changes of parts of the view.
        """
        if not self._ratios:
            return np.ones((self.frames, 1)), []
        ratios = np.array(self._ratios)
        known = ratios[ratios.any(axis=1)] if ratios.any() else ratios
        scatter = 1.4826 * np.median(np.abs(known - np.median(known, axis=0)), axis=0)
        steps = np.any(np.abs(ratios) > np.maximum(LEAST_STEP, STANDING_OUT * scatter), axis=1)
        told, changes = np.where(steps[:, np.newaxis], ratios, 0.0), list(self._changes)
        became = self._became(turn)
        if became is not None and steps.any():
            left = told.sum(axis=0) - became
            largest = max(UNEXPLAINED, 0.5 * float(np.abs(told).max()))
            if np.abs(left).max() > largest:
                told[:] = 0.0
                changes += [
                    (self._azimuths[k + 1], -math.pi, math.pi) for k in np.flatnonzero(steps)
                ]
            else:
                told[steps] -= left / steps.sum()
        elif became is not None and (at := _hidden(ratios, became)) is not None:
            told[at] = became
        return np.exp(np.vstack([np.zeros(told.shape[1]), np.cumsum(told, axis=0)])), changes

    def _became(self, turn: float) -> Floats | None:
        """Logarithm of the last frame's gain against the first one, which it shows again."""
        if not math.isfinite(turn):
            return None
        assert self._first is not None
        assert self._last is not None
        both = self._overlap(self._last, self._first, turn)
        back = both.ratio() if both is not None and both.near else None
        return None if back is None else -back

    def _overlap(self, before: Image, after: Image, turn: float) -> _Overlap | None:
        """What two frames both show, an arm's turn [rad] in between; None for too little."""
        camera, (height, width) = self._camera, after.shape[:2]
        ray_angle, slope = camera.rays(camera.cx, camera.cy)
        u, v = camera.project(ray_angle - turn, slope)
        dx, dy = float(u - camera.cx) / self._factor, float(v - camera.cy) / self._factor
        share = max(abs(dx) / width, abs(dy) / height)
        if not share <= FARTHEST_SHIFT:
            return None
        move = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]])
        moved = np.asarray(cv2.warpAffine(before, move, (width, height)))
        left, right = max(0, math.ceil(dx)), width + min(0, math.floor(dx))
        top, bottom = max(0, math.ceil(dy)), height + min(0, math.floor(dy))
        part = np.s_[top:bottom, left:right]
        near = share <= LARGEST_SHIFT
        return _Overlap(moved[part], after[part], (left, top), (dx, dy), near)

    def _note_change(self, both: _Overlap, gain: Floats, arm_azimuth: float) -> None:
        u, v = both.changed(gain)
        if not u.size:
            return
        ends = [(i, j) for i in (u.min(), u.max()) for j in (v.min(), v.max())]
        # The centre of a pixel that stands for several.
        u, v = (np.array(ends).T + 0.5) * self._factor - 0.5
        ray_angle, _ = self._camera.rays(u, v)
        self._changes.append((arm_azimuth, float(ray_angle.min()), float(ray_angle.max())))

    @property
    def noted(self) -> tuple[int, int]:
        """How many frames were taken, and how many changes of a part of the view were seen."""
        return len(self._azimuths), len(self._changes)

    def arrays(self, frames: int = 0, changes: int = 0) -> dict[str, npt.NDArray[Any]]:
        """
        Return what the frames have left here, for :meth:`restored`.

        Parameters
        ----------
        frames, changes : int
            Leave out what the first so many have left, besides small pictures.
        """
        if self._first is None or self._last is None:
            return {}
        return {
            'light.first': self._first,
            'light.last': self._last,
            'light.azimuths': np.array(self._azimuths[frames:]),
            'light.ratios': np.array(self._ratios[max(0, frames - 1) :]).reshape(
                -1, _channels(self._first)
            ),
            'light.changes': np.array(self._changes[changes:]).reshape(-1, 3),
        }

    @classmethod
    def restored(cls, camera: PinholeCamera, arrays: Mapping[str, npt.NDArray[Any]]) -> Light:
        """
        Make the light whose :meth:`arrays` these are.

        Raises
        ------
        ValueError
            If they are not such.
        """
        light = cls(camera)
        if 'light.first' not in arrays:
            return light
        first, last, ratios, changes, azimuths = (
            arrays.get(f'light.{name}', np.zeros(0))
            for name in ('first', 'last', 'ratios', 'changes', 'azimuths')
        )
        size = camera.height // light._factor, camera.width // light._factor
        if not (
            first.shape in (size, (*size, 3))
            and last.shape == first.shape
            and first.dtype == last.dtype == np.uint8
            and ratios.ndim == changes.ndim == 2
            and ratios.shape[1] == _channels(first)
            and changes.shape[1] == 3
            and azimuths.shape == (len(ratios) + 1,)
            and all(np.isfinite(numbers).all() for numbers in (ratios, changes, azimuths))
        ):
            raise ValueError('its light is not that of such a sweep')
        light._first, light._last, light._azimuths = first, last, azimuths.tolist()
        light._ratios = list(ratios)
        light._changes = [(float(at), float(low), float(high)) for at, low, high in changes]
        return light


def at_frames(gains: Floats, frame: Floats) -> Floats:
    """Gains (frames, channels) at numbers of frames (N,): between two, or beyond the last."""
    frame = np.minimum(frame, len(gains) - 1)
    before = np.floor(frame).astype(np.intp)
    after = np.minimum(before + 1, len(gains) - 1)
    share = (frame - before)[:, np.newaxis]
    return np.asarray(gains[before] + share * (gains[after] - gains[before]))


def changed_columns(
    geometry: PanoramaGeometry, changes: list[Change], margin: float, widest: float
) -> npt.NDArray[np.bool_]:
    """
    Columns where one eye has seen what was before a change, the other what came after.

    Parameters
    ----------
    geometry : PanoramaGeometry
    changes : list of Change
    margin : float
        Added to either side [rad].
    widest : float
        Largest principal angle of the sweep's panoramas [rad].

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    changed = np.zeros(geometry.columns, bool)
    azimuth = geometry.ray_azimuth(np.arange(geometry.columns))
    for arm_azimuth, least, largest in changes:
        low, high = max(least - margin, -widest), min(largest + margin, widest)
        off = np.remainder(azimuth - arm_azimuth + math.pi, 2 * math.pi) - math.pi
        changed |= (off >= low) & (off <= high)
    return changed


def _channels(image: Image) -> int:
    return 1 if image.ndim == 2 else 3


def _grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image


def _hidden(ratios: Floats, became: Floats) -> int | None:
    """Which of the ratios (N, channels) alone is what the light became; None if none is."""
    if np.abs(became).max() <= LEAST_STEP or len(ratios) < 2:
        return None
    explained = ratios @ became / (became @ became)
    best = int(np.argmax(explained))
    clear = np.delete(explained, best).max() <= NEXT_BEST * explained[best]
    return best if clear and explained[best] >= EXPLAINED else None


def _step(before: Floats, after: Floats) -> float | None:
    """Logarithm of the factor between cells, shape (rows, columns); None for too few."""
    told = (before > DARKEST) & (before < BRIGHTEST) & (after > DARKEST) & (after < BRIGHTEST)
    if told.sum() < max(FEWEST_CELLS, LEAST_SHARE * told.size):
        return None
    levels = np.log(np.maximum(before, 1.0))
    down, across = (slope[told] for slope in np.gradient(levels))
    ratio = (np.log(np.maximum(after, 1.0)) - levels)[told]
    causes = np.stack([np.ones_like(ratio), across, down], axis=-1)
    fits = np.abs(ratio - np.median(ratio)) <= 3 * max(
        float(np.median(np.abs(ratio - np.median(ratio)))), 1e-3
    )
    for _ in range(3):
        told_by, *_ = np.linalg.lstsq(causes[fits], ratio[fits], rcond=None)
        off = np.abs(ratio - causes @ told_by)
        fits = off <= 3 * max(float(np.median(off)), 1e-3)
    return float(told_by[0])
