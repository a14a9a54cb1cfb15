"""From points to a LaserScan's ranges: the nearest surface in a height band, beam by beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import SURFACE_DEPTH, Points

Array = npt.NDArray[np.float64]

#: A surface may find its support within this angle to either side of a beam [rad].
NEIGHBOURHOOD = np.deg2rad(2.0)
#: Nearer than this a surface needs more support, by the cube of how much nearer it is [m].
FULL_SUPPORT = 1.2
#: But not more than this share of all the panorama's pixels within the neighbourhood.
LARGEST_SHARE = 0.25
#: This share of the support makes no surface, but hides what lies behind: the beam is unknown.
DOUBT = 1 / 3
#: It hides only what lies farther behind than this many ``SURFACE_DEPTH``.
DOUBT_DEPTHS = 2
#: Resolution at which support is counted, as a share of the distance.
_DEPTH_STEP = 0.005
#: Support below this is a rounding error of sums.
_NOTHING = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSettings:
    """
    How points become beams.

    Attributes
    ----------
    beams : int
        N, beams of a full turn; beam k points at −π + k·2π/N.
    range_min, range_max : float
        Limits of the ranges [m].
    min_height, max_height : float
        Height band above the optical centre [m], both included.
    min_confidence : float
        Least confidence of a pixel that counts.
    min_support : float
        Least sum of confidences that makes a surface at ``FULL_SUPPORT`` and beyond; from
        ``DOUBT`` of it on a beam that would end farther away is unknown.
    row : int
        Use this single row of the panorama instead of the height band; −1 for the band.

    Raises
    ------
    ValueError
        If the values contradict each other.
    """

    beams: int = 720
    range_min: float = 0.35
    range_max: float = 8.0
    min_height: float = -0.15
    max_height: float = 0.15
    min_confidence: float = 0.3
    min_support: float = 12.0
    row: int = -1

    def __post_init__(self) -> None:
        if self.beams < 60:
            raise ValueError(f'beams is {self.beams}; allowed: at least 60')
        if not 0 < self.range_min < self.range_max < np.inf:
            raise ValueError(
                f'range_min is {self.range_min} m and range_max {self.range_max} m; '
                'allowed: 0 < range_min < range_max'
            )
        if not self.min_height < self.max_height:
            raise ValueError(
                f'min_height is {self.min_height} m and max_height {self.max_height} m; '
                'allowed: min_height < max_height'
            )

    @property
    def angle_increment(self) -> float:
        """Angle between beams [rad]."""
        return 2 * np.pi / self.beams


def laser_ranges(
    points: Points, confidence: npt.NDArray[np.float32], settings: ScanSettings
) -> npt.NDArray[np.float32]:
    """
    Ranges of a LaserScan.

    Parameters
    ----------
    points : Points
        Radial distance, azimuth and height of every pixel, shape (H, W).
    confidence : ndarray of float32, shape (H, W)
        Confidence of every pixel, NaN where unknown.
    settings : ScanSettings
        Band, limits, support.

    Returns
    -------
    ndarray of float32, shape (beams,)
        Range of each beam [m], counter-clockwise from −π (REP-117): NaN where nothing is known,
        +inf where the nearest surface is farther than ``range_max``, −inf where it is nearer
        than ``range_min``.

    Raises
    ------
    ValueError
        If the single row lies outside the panorama or the shapes differ.

    Notes
    -----
    A surface is a group of pixels whose distances lie within ``SURFACE_DEPTH`` of each other and
    whose confidences sum up to ``min_support``. It needs one pixel in the beam itself; the
    others may be in beams within :data:`NEIGHBOURHOOD`: an edge that is a pixel high but a hand
    wide has support, a pole has it from its own rows, a speckle has none. Nearer than
    :data:`FULL_SUPPORT` the support must be larger by the cube of that over the distance: a thing
    has more pixels there, by the square, and so has a patch that one eye alone sees and that
    found a chance partner; but what fills :data:`LARGEST_SHARE` of the view has support in the
    coarsest panorama. The range is the median distance of the pixels in the beam from where the
    nearest surface begins, which may be with a pixel of another beam, to one and a half times
    ``SURFACE_DEPTH`` behind: noise spreads the pixels, and the nearest of them are found first.

    A group that has less support, but :data:`DOUBT` of it, is as often a thin thing as a chance
    match: what lies clearly behind is not reported, for a beam that ends behind an obstacle is
    worse than none. A single row needs no support and knows no doubt.
    """
    distance = points.radial_distance
    if confidence.shape != distance.shape:
        raise ValueError(f'confidence has shape {confidence.shape}; allowed: {distance.shape}')
    if settings.row >= distance.shape[0]:
        raise ValueError(f'row is {settings.row}; allowed: -1 to {distance.shape[0] - 1}')
    use, beam = _pixels_of_beams(points, confidence, settings)
    # Whatever lies beyond range_max is +inf in the end, however far it is.
    found = np.minimum(distance[use], 2 * settings.range_max)
    support = 0.0 if settings.row >= 0 else settings.min_support
    limit = LARGEST_SHARE * distance.size / settings.beams
    nearest = _nearest_surfaces(
        beam, found, confidence[use], settings.beams, support, limit, settings.range_max
    )
    with np.errstate(invalid='ignore'):
        nearest = np.where(nearest > settings.range_max, np.inf, nearest)
        nearest = np.where(nearest < settings.range_min, -np.inf, nearest)
    return nearest.astype(np.float32)


def beam_confidence(
    points: Points,
    confidence: npt.NDArray[np.float32],
    ranges: npt.NDArray[np.float32],
    settings: ScanSettings,
) -> Array:
    """
    Mean confidence of the pixels that a beam's range comes from.

    Parameters
    ----------
    points, confidence, settings
        As for :func:`laser_ranges`.
    ranges : ndarray of float32, shape (beams,)
        What that returned [m].

    Returns
    -------
    ndarray of float64, shape (beams,)
        Of the pixels in the beam whose distance is within ``SURFACE_DEPTH`` of its range;
        NaN where the range is not finite.
    """
    use, beam = _pixels_of_beams(points, confidence, settings)
    with np.errstate(invalid='ignore'):
        near = np.abs(points.radial_distance[use] / ranges[beam] - 1) <= SURFACE_DEPTH
    count = np.bincount(beam[near], minlength=settings.beams)
    total = np.bincount(beam[near], confidence[use][near], settings.beams)
    with np.errstate(invalid='ignore'):
        return np.asarray(total / count)


def _pixels_of_beams(
    points: Points, confidence: npt.NDArray[np.float32], settings: ScanSettings
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Pixels that count, as a mask (H, W), and the beam of each of them."""
    with np.errstate(invalid='ignore'):
        use = np.isfinite(points.radial_distance) & (confidence >= settings.min_confidence)
        if settings.row >= 0:
            use[: settings.row] = use[settings.row + 1 :] = False
        else:
            use &= (points.height >= settings.min_height) & (points.height <= settings.max_height)
    turn = (points.azimuth[use] + np.pi) / settings.angle_increment
    return use, np.rint(turn).astype(np.int64) % settings.beams


def _nearest_surfaces(
    beam: npt.NDArray[np.int64],
    distance: Array,
    confidence: npt.NDArray[np.float32],
    beams: int,
    support: float,
    limit: float,
    farthest: float,
) -> Array:
    """
    Distance of the nearest supported surface of each beam, NaN where there is none or doubt.

    No surface beyond the least support needs more than ``limit`` for each beam of its
    neighbourhood. What is farther away than ``farthest`` casts no doubt.
    """
    nearest = np.full(beams, np.nan)
    if not beam.size:
        return nearest
    level = (np.log(distance / distance.min()) / _DEPTH_STEP).astype(np.int64)
    levels = int(level.max()) + 1
    of_level = distance.min() * np.exp(np.arange(levels) * _DEPTH_STEP)
    depth = int(np.log1p(SURFACE_DEPTH) / _DEPTH_STEP) + 1
    # Weighted counts of what the pixels hold: np.add.at takes many times as long.
    size = levels + depth
    sums = np.bincount(beam * size + level, confidence, beams * size)
    own: Array = sums.reshape(beams, size).astype(np.float64, copy=False)
    pooled = _sums(own.T, depth)[:levels].T
    reach = round(NEIGHBOURHOOD / (2 * np.pi) * beams)
    needed = support * np.maximum(FULL_SUPPORT / of_level, 1.0) ** 3
    needed = np.minimum(needed, max(support, limit * (2 * reach + 1)))
    around = np.concatenate([pooled[beams - reach :], pooled, pooled[:reach]])
    found = np.where(pooled > _NOTHING, _sums(around, 2 * reach + 1), -1.0)
    first = _first(found >= needed, size)
    doubtful = _first((found >= DOUBT * needed) & (of_level <= farthest), size)
    first[doubtful < first - DOUBT_DEPTHS * depth] = size
    # The first group is the near end of what noise spreads: the middle lies farther behind.
    inside = (level >= first[beam]) & (level < first[beam] + depth + depth // 2)
    of_beam, of_distance = _sorted(beam[inside], distance[inside])
    start = np.flatnonzero(np.diff(of_beam, prepend=-1))
    count = np.diff(start, append=of_beam.size)
    # The median: the middle one, or the mean of both.
    low, high = of_distance[start + (count - 1) // 2], of_distance[start + count // 2]
    nearest[of_beam[start]] = (low + high) / 2
    return nearest


def _first(levels: npt.NDArray[np.bool_], none: int) -> npt.NDArray[np.int64]:
    """First true level of each beam, ``none`` where there is none."""
    return np.where(levels.any(axis=1), levels.argmax(axis=1), none)


def _sums(values: Array, width: int) -> Array:
    """Sums of ``width`` neighbours along the first axis; the first at index 0."""
    total = np.zeros((values.shape[0] + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    return total[width:] - total[:-width]


def _sorted(beam: npt.NDArray[np.int64], distance: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """
    Beams and distances, at the precision of float32, in the order of both.

    The bits of positive numbers are ordered as these are, so that one sort of integers does.
    """
    bits = distance.astype(np.float32).view(np.uint32)
    keys = np.sort((beam.astype(np.uint64) << np.uint64(32)) | bits)
    ordered = keys.astype(np.uint32).view(np.float32)
    return (keys >> np.uint64(32)).astype(np.int64), ordered.astype(np.float64)
