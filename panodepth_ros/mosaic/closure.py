"""
Does a full turn close? The last frame against the first, without odometry.

The last frame E is either the one at 360°, which must show what the first one F0 shows, or the
last one before, a neighbour of F0 like any two, if the step is small. What a step does to the
picture is known from the frames that follow F0: points move by a flow G from F0 to a frame Fm a
little farther on. Whatever lies near or far, the flow from E to F0 must be the same flow, in
proportion to the angle: parallax is in both alike. So the factor ρ of the flow tells by how much
the arm truly turned from E to F0; what is more than measured was lost on the way. And what no ρ
explains tells that the robot was moved or the room has changed: a robot that moves by t shifts
near points by t/d, those at the side otherwise than those ahead.

Where steps are so large that few points are seen in both F0 and Fm, E at 360° is enough: the flow
of far away points, which the camera's geometry tells, takes the place of G. It is too small for
near points, so the lost angle is then at most what is measured, and is not corrected.

Shifts are taken along what the picture tells well: across an edge, not along it. A robot that is
turned on the spot looks exactly like an arm that lost as much.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import PinholeCamera

Image = npt.NDArray[np.uint8]
Points = npt.NDArray[np.float64]

#: How far beyond the first frame the one is that tells the flow [rad].
REFERENCE_TURN = math.radians(0.999)
#: A turn that ends farther from 360° is none [rad]: perspective bends a longer flow.
LARGEST_GAP = math.radians(2.1)
#: Points looked for, and the least distance between them [px].
MOST_POINTS, SPACING = 400, 5
#: The fewest that tell how far a picture has moved, and whether it has moved at all.
FEWEST_POINTS, FEWEST_AT_REST = 20, 8
#: Window of the tracking [px], halvings of the image before.
WINDOW, PYRAMID = 15, 3
#: Points of weaker texture are not tracked, as OpenCV counts it.
LEAST_EDGE = 1e-3
#: Points that do not come back when tracked there and back are none [px].
LARGEST_RETURN = 0.5
#: Points farther from the fit than so many median distances have moved by themselves.
OUTLIER = 4.0


@dataclass(frozen=True, slots=True)
class Closure:
    """
    How a turn closes.

    Attributes
    ----------
    lost : float
        By how much the arm turned less than it reported, over the whole turn [rad]; negative if
        it turned farther.
    stddev : float
        Standard deviation of ``lost``, from the scatter of the points [rad].
    mismatch : float
        Median distance of the points from where any turn of the arm puts them [rad].
    points : int
        How many tell this.
    exact : bool
        Whether parallax is accounted for; without, ``lost`` is too large, the more the nearer
        the points are.
    """

    lost: float
    stddev: float
    mismatch: float
    points: int
    exact: bool = True


def refusal(closure: Closure, tolerance: float, correctable: float = 0.0) -> str:
    """
    Say why a turn must not be used.

    Parameters
    ----------
    closure : Closure
        As measured.
    tolerance : float
        Largest lost angle and largest mismatch that are none [rad].
    correctable : float
        Largest lost angle that will be corrected [rad].

    Returns
    -------
    str
        A sentence with the numbers; empty if the turn may be used.
    """
    degrees, allowed = math.degrees, f'allowed: {math.degrees(tolerance):g}°'
    if closure.mismatch > tolerance:
        return (
            f'the turn does not close: points of the first frame are '
            f'{degrees(closure.mismatch):.3f}° from where any turn of the arm puts them, '
            f'{allowed}; the robot was moved or the room has changed'
        )
    if abs(closure.lost) > max(tolerance, correctable if closure.exact else 0.0):
        verb = 'less' if closure.lost > 0 else 'more'
        return (
            f'the turn does not close: the arm turned {degrees(abs(closure.lost)):.3f}° {verb} '
            f'than it reported, {allowed}; steps were lost or the robot was turned'
        )
    return ''


def redistributed(
    image: Image, ray_angle: npt.NDArray[np.float64], lost: float
) -> tuple[Image, npt.NDArray[np.float64]]:
    """
    Put columns where they belong if an angle was lost little by little.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, N) or (H, N, 3)
        Columns of a full turn in the order in which the arm saw them.
    ray_angle : ndarray of float64, shape (N,)
        Their ψ [rad], NaN for columns that were not seen.
    lost : float
        Lost over the turn [columns]; negative if the arm turned farther.

    Returns
    -------
    (ndarray, ndarray)
        The same, interpolated between neighbours. Columns that the arm did not reach are black and
        NaN.
    """
    columns = ray_angle.size
    at = np.arange(columns) / (1.0 - lost / columns)
    # The last column reaches half a column on, as every other does.
    reached = at < columns - 0.5
    low = np.minimum(np.floor(at).astype(int), columns - 1)
    high = np.minimum(low + 1, columns - 1)
    share = np.where(high > low, at - low, 0.0)
    between = share > 0
    angle = ray_angle[low]
    angle[between] += (share * (ray_angle[high] - ray_angle[low]))[between]
    angle[~reached] = np.nan
    wide = share.reshape(1, -1, *(1,) * (image.ndim - 2))
    mixed = np.rint(image[:, low] * (1 - wide) + image[:, high] * wide).astype(np.uint8)
    mixed[:, np.isnan(angle)] = 0
    return mixed, angle


class Seam:
    """The frames at the beginning and at the end of a turn."""

    def __init__(self) -> None:
        self._first: tuple[Image, float] | None = None
        self._reference: tuple[Image, float] | None = None
        self._last: tuple[Image, float] | None = None

    def take(self, image: Image, arm_azimuth: float) -> None:
        """Take the next frame, which must not change any more, and its arm azimuth [rad]."""
        frame = (image, arm_azimuth)
        if self._first is None:
            self._first = frame
        elif self._reference is None and abs(arm_azimuth - self._first[1]) >= REFERENCE_TURN:
            self._reference = frame
        self._last = frame

    def measure(self, camera: PinholeCamera) -> Closure:
        """
        Measure how the turn closes.

        Parameters
        ----------
        camera : PinholeCamera
            Of the frames, mounted.

        Returns
        -------
        Closure

        Raises
        ------
        ValueError
            If that cannot be told, as a sentence.
        """
        if self._first is None or self._reference is None or self._last is None:
            raise ValueError('the turn has too few frames')
        (first, begin), (reference, at), (last, end) = self._first, self._reference, self._last
        missing, asked = 2 * math.pi - abs(end - begin), abs(at - begin)
        if abs(missing) > LARGEST_GAP:
            raise ValueError(
                f'the last frame is {math.degrees(missing):.1f}° before 360°; allowed: '
                f'{math.degrees(LARGEST_GAP):.1f}°, or a mosaicer that leads and takes one at 360°'
            )
        here = _features(first)
        there, tracked = _track(first, reference, here)
        back, also = _track(first, last, here)
        at_rest = abs(missing) < 0.1 * asked
        fewest = FEWEST_AT_REST if at_rest else FEWEST_POINTS
        use = tracked & also
        exact = bool(use.sum() >= fewest)
        if not exact and at_rest:
            use = also
            there = _turned(camera, here, begin - at)
        if use.sum() < fewest:
            raise ValueError(
                f'only {use.sum()} points are seen in the first and the last frame; allowed: '
                f'{fewest}; begin the sweep where the camera sees more than a plain wall'
            )
        flow, seam = (there - here)[use], (here - back)[use]
        share, stddev, apart = _fit(flow, seam, _structure(first, here[use]))
        return Closure(
            lost=share * asked - missing,
            stddev=stddev * asked,
            mismatch=apart / camera.fx,
            points=int(use.sum()),
            exact=exact,
        )

    def arrays(self) -> dict[str, npt.NDArray[Any]]:
        """Return what the first frames have left here, for :meth:`restored`."""
        frames = {'first': self._first, 'reference': self._reference}
        return {
            f'seam.{name}.{kind}': np.asarray(part)
            for name, frame in frames.items()
            if frame is not None
            for kind, part in zip(('image', 'azimuth'), frame, strict=True)
        }

    @classmethod
    def restored(cls, arrays: Mapping[str, npt.NDArray[Any]], shape: tuple[int, int]) -> Seam:
        """
        Make the seam whose :meth:`arrays` these are, of frames of a shape.

        Raises
        ------
        ValueError
            If they are not such.
        """
        seam = cls()
        for name in ('first', 'reference'):
            if (image := arrays.get(f'seam.{name}.image')) is None:
                continue
            azimuth = arrays.get(f'seam.{name}.azimuth', np.zeros(0))
            if image.dtype != np.uint8 or image.shape not in (shape, (*shape, 3)):
                raise ValueError(f'seam.{name} is {image.dtype} {image.shape}; allowed: a frame')
            if azimuth.shape != () or not np.isfinite(azimuth):
                raise ValueError(f'seam.{name} has no azimuth')
            setattr(seam, f'_{name}', (image, float(azimuth)))
        return seam


def _turned(camera: PinholeCamera, points: Points, turn: float) -> Points:
    """Where far away points are after the camera has turned [rad], clockwise if positive."""
    ray_angle, slope = camera.rays(*points.T) if points.size else (np.zeros(0), np.zeros(0))
    return np.stack(camera.project(ray_angle + turn, slope), axis=-1)


def _features(image: Image) -> Points:
    found = cv2.goodFeaturesToTrack(_grey(image), MOST_POINTS, 0.01, SPACING)
    return np.zeros((0, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2)


def _grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)) if image.ndim == 3 else image


def _track(image: Image, other: Image, points: Points) -> tuple[Points, npt.NDArray[np.bool_]]:
    """Where points of one image are in another, and which were found there and back."""
    if not points.size:
        return points, np.zeros(0, bool)
    one, two = _grey(image), _level(_grey(other), _grey(image))
    start = points.reshape(-1, 1, 2).astype(np.float32)
    settings: dict[str, Any] = {
        'winSize': (WINDOW, WINDOW),
        'maxLevel': PYRAMID,
        'minEigThreshold': LEAST_EDGE,
    }
    there, found, _ = cv2.calcOpticalFlowPyrLK(one, two, start, None, **settings)
    back, again, _ = cv2.calcOpticalFlowPyrLK(two, one, there, None, **settings)
    off = np.linalg.norm((back - start).reshape(-1, 2), axis=1)
    good = (found.ravel() > 0) & (again.ravel() > 0) & (off < LARGEST_RETURN)
    return there.reshape(-1, 2).astype(np.float64), good


def _level(image: Image, like: Image) -> Image:
    """Give an image brightness and contrast of another, for exposure may have changed."""
    (mean, spread), (wanted, contrast) = ((i.mean(), i.std()) for i in (image, like))
    gain = contrast / spread if spread > 0 else 1.0
    levels = np.clip(np.rint(wanted + gain * (np.arange(256) - mean)), 0, 255)
    return np.asarray(levels.astype(np.uint8)[image])


def _structure(image: Image, points: Points) -> npt.NDArray[np.float64]:
    """
    How well an image tells motions in x and y around points, shape (M, 2, 2).

    A point on an edge tells nothing along the edge: what it seems to do there is chance.
    """
    grey = _grey(image).astype(np.float32)
    x, y = (cv2.Sobel(grey, cv2.CV_32F, dx, 1 - dx) for dx in (1, 0))
    products = [cv2.blur(product, (WINDOW, WINDOW)) for product in (x * x, x * y, y * y)]
    u, v = np.rint(points).astype(int).T
    xx, xy, yy = (product[v, u].astype(np.float64) for product in products)
    return np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2)


def _fit(
    flow: Points, seam: Points, structure: npt.NDArray[np.float64]
) -> tuple[float, float, float]:
    """Share of the flow that explains the seam, its standard deviation, median distance [px]."""

    def told(one: Points, other: Points) -> npt.NDArray[np.float64]:
        return np.asarray(np.einsum('ni,nij,nj->n', one, structure, other))

    size, both = told(flow, flow), told(flow, seam)
    strength = np.asarray(np.linalg.eigvalsh(structure)[:, 1], np.float64)
    share = _weighted_median(both / size, size)
    for _ in range(5):
        off = seam - share * flow
        apart = np.sqrt(told(off, off) / strength)
        middle = _weighted_median(apart, strength)
        near = apart <= OUTLIER * max(middle, 0.02)
        share = float(both[near].sum() / size[near].sum())
    along = told(flow, seam - share * flow)[near]
    stddev = float(np.sqrt((along**2).sum()) / size[near].sum())
    return share, stddev, middle


def _weighted_median(values: npt.NDArray[np.float64], weights: npt.NDArray[np.float64]) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
