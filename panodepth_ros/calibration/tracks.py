"""
Scene points followed through the frames of a sweep, to a fraction of a pixel.

Frames are unrolled onto a cylinder first, where a turn of the arm shifts a patch without
stretching it. A point keeps the patch of the frame that saw it in the middle and is sought with
that patch in every other frame, so that no error adds up along the way. Unrolling takes an
assumed camera, but positions are handed out as pixels of the frames themselves.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.geometry.sampling import sampling_maps

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

#: Pixels of the cylinder to a pixel of the frames, so that its own interpolation does no harm.
_FINER = 2
#: Side of a patch on the cylinder [px].
PATCH = 23
#: Least distance between points of one frame, on the cylinder [px].
_SPACING = 10
#: A corner counts if it is this strong beside the strongest of its frame.
_QUALITY = 0.01
#: Turn of a point's ray over that of the arm, before it is known.
_FIRST_RATE = 1.2
#: Frames of a track are at least so far apart, on the cylinder [px].
_STRIDE = 7.0
#: The shift to the next frame is the last one up to this, or the track ends [px].
_JUMP = 2.0
#: Mean difference of a patch that is not found again [grey levels].
_LARGEST_DIFFERENCE = 12.0
#: A track is kept if it covers this share of the image's width.
_SHORTEST = 0.4


@dataclass(frozen=True, eq=False, slots=True)
class Tracks:
    """
    T points, each seen in up to K frames; NaN where a point is not seen.

    Attributes
    ----------
    arm_azimuth : ndarray of float64, shape (T, K)
        γ of the frame [rad].
    u, v : ndarray of float64, shape (T, K)
        Where the point is in it [px].
    """

    arm_azimuth: Array
    u: Array
    v: Array

    def __len__(self) -> int:
        return len(self.u)

    def chosen(self, index: npt.NDArray[np.generic]) -> Tracks:
        """Some of the tracks."""
        return Tracks(self.arm_azimuth[index], self.u[index], self.v[index])


class _Cylinder:
    """Unrolls frames: column to ray angle, row to slope."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera = camera
        #: Pixels per radian.
        self.scale = _FINER * camera.fx
        edge_v, edge_u = np.mgrid[0 : camera.height : camera.height - 1, 0 : camera.width]
        angle, slope = camera.rays(edge_u, edge_v)
        columns = math.ceil(np.ptp(angle) * self.scale)
        rows = math.ceil(np.ptp(slope) * self.scale)
        self._left, self._top = angle.max(), slope.max()
        i, j = np.mgrid[0:rows, 0:columns]
        u, v = self.pixels(j, i)
        self._map = sampling_maps(u, v)
        half = PATCH // 2 + 1
        inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
        kernel = np.ones((2 * half + 1, 2 * half + 1), np.uint8)
        padded = cv2.copyMakeBorder(inside.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT)
        #: Where whole patches lie inside of the frame.
        self.usable = cv2.erode(padded, kernel)[1:-1, 1:-1].astype(bool)

    def pixels(self, column: npt.ArrayLike, row: npt.ArrayLike) -> tuple[Array, Array]:
        """Pixels of the frame at positions on the cylinder."""
        return self._camera.project(
            self._left - np.asarray(column, np.float64) / self.scale,
            self._top - np.asarray(row, np.float64) / self.scale,
        )

    def unroll(self, frame: Image) -> Image:
        """Grey picture on the cylinder."""
        grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY) if frame.ndim == 3 else frame
        return np.asarray(
            cv2.remap(grey, *self._map, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
        )


class Tracker:
    """
    Follows points through a sweep while its frames come.

    Only the frames that a point between them can be seen in are kept, some 37° of arm azimuth.

    Parameters
    ----------
    camera : PinholeCamera
        What is known of the camera; need not be right.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera = camera
        self._cylinder = cylinder = _Cylinder(camera)
        usable = cylinder.usable
        columns = usable.shape[1]
        self._middle = np.zeros(usable.shape, np.uint8)
        self._middle[:, columns // 2 - columns // 20 : columns // 2 + columns // 20] = 255
        self._middle[~usable] = 0
        #: Least turn between frames that are kept, and between those whose points are sought.
        self._stride, self._apart = _STRIDE / cylinder.scale, columns / 16 / cylinder.scale
        #: Turn after which no point of the middle is in the picture any more.
        self._reach = (0.5 + 1 / 20) * columns / cylinder.scale
        self._kept: deque[tuple[float, Image]] = deque()
        self._waiting: deque[float] = deque()
        self._found: list[tuple[Array, Array, Array]] = []
        self._rng = np.random.default_rng(0)

    def add(self, frame: Image, arm_azimuth: float) -> None:
        """
        Take the next frame.

        Parameters
        ----------
        frame : ndarray of uint8, shape (H, W) or (H, W, 3)
            Each turned on in the direction of those before.
        arm_azimuth : float
            γ, not wrapped [rad].
        """
        if self._kept and abs(arm_azimuth - self._kept[-1][0]) < self._stride:
            return
        self._kept.append((arm_azimuth, self._cylinder.unroll(frame)))
        if not self._waiting or abs(arm_azimuth - self._waiting[-1]) >= self._apart:
            self._waiting.append(arm_azimuth)
        while len(self._waiting) > 1 and abs(arm_azimuth - self._waiting[0]) > self._reach:
            self._seek(self._waiting.popleft())

    def tracks(self) -> Tracks:
        """Return the points followed through all frames; there may come no more."""
        while self._waiting:
            self._seek(self._waiting.popleft())
        longest = max((len(u) for _, u, _ in self._found), default=0)
        packed = np.full((3, len(self._found), longest), np.nan)
        for n, sighting in enumerate(self._found):
            packed[:, n, : len(sighting[0])] = sighting
        return Tracks(packed[0], packed[1], packed[2])

    def _seek(self, reference_azimuth: float) -> None:
        """Follow the points in the middle of a kept frame to both sides."""
        while abs(self._kept[0][0] - reference_azimuth) > self._reach:
            self._kept.popleft()
        azimuths, pictures = zip(*self._kept, strict=True)
        reference = azimuths.index(reference_azimuth)
        corners = cv2.goodFeaturesToTrack(
            pictures[reference], 1000, _QUALITY, _SPACING, mask=self._middle, blockSize=9
        )
        if corners is None:
            return
        # Interpolation errs by where between the pixels it is: let that be all over the place.
        start = corners.reshape(-1, 2) + self._rng.uniform(-0.5, 0.5, (len(corners), 2))
        start = start.astype(np.float32)
        sightings = {reference: start}
        for ahead in (range(reference + 1, len(pictures)), range(reference - 1, -1, -1)):
            sightings |= _follow(pictures, reference, start, ahead, azimuths, self._cylinder)
        order = sorted(sightings)
        place = np.stack([sightings[k] for k in order], axis=1).astype(np.float64)
        u, v = self._cylinder.pixels(place[..., 0], place[..., 1])
        azimuth = np.broadcast_to([azimuths[k] for k in order], u.shape)
        long = np.nanmax(u, axis=1) - np.nanmin(u, axis=1) > _SHORTEST * self._camera.width
        self._found += [
            (azimuth[n][seen], u[n][seen], v[n][seen])
            for n, seen in enumerate(np.isfinite(u))
            if long[n]
        ]


def track(frames: Iterable[Image], arm_azimuth: Array, camera: PinholeCamera) -> Tracks:
    """Follow points through all frames of a sweep; parameters as of :class:`Tracker`."""
    tracker = Tracker(camera)
    for frame, azimuth in zip(frames, arm_azimuth.tolist(), strict=True):
        tracker.add(frame, azimuth)
    return tracker.tracks()


def _follow(
    pictures: Sequence[Image],
    reference: int,
    start: npt.NDArray[np.float32],
    ahead: range,
    arm_azimuth: Sequence[float],
    cylinder: _Cylinder,
) -> dict[int, npt.NDArray[np.float32]]:
    """Positions of the reference's patches in frames ahead until none is left; NaN once lost."""
    sightings: dict[int, npt.NDArray[np.float32]] = {}
    last, place, rate = reference, start.copy(), None
    alive = np.ones(len(start), bool)
    rows, columns = cylinder.usable.shape
    scale = cylinder.scale
    for k in ahead:
        turn = scale * (arm_azimuth[k] - arm_azimuth[last])
        if abs(turn) > 0.25 * columns:
            break  # frames are missing
        if rate is None:
            rate = np.tile(np.array([_FIRST_RATE, 0.0], np.float32), (len(start), 1))
        guess = place + rate * np.float32(turn)
        guess[~alive] = 0.0
        moved, status, difference = cv2.calcOpticalFlowPyrLK(
            pictures[reference],
            pictures[k],
            start,
            guess.copy(),
            winSize=(PATCH, PATCH),
            maxLevel=0,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.002),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        jump = np.abs(moved - guess).max(axis=1)
        allowed = _JUMP if last != reference else 2.0 * _JUMP
        alive &= (status[:, 0] == 1) & (jump < allowed) & (difference[:, 0] < _LARGEST_DIFFERENCE)
        column, row = np.rint(moved.T).astype(np.int64)
        within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        alive &= within
        alive[alive] = cylinder.usable[row[alive], column[alive]]
        if not alive.any():
            break
        rate = (moved - place) / np.float32(turn)
        place = np.where(alive[:, np.newaxis], moved, np.float32(np.nan))
        sightings[k], last = place, k
    return sightings
