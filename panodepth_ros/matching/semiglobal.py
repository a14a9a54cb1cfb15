"""
The default matching: semi-global, both eyes consistent, sub-column, with calibrated confidence.

docs/matching.md says what was tried and why it is this. The panoramas are cut open at a seam that
depends on what they show (``seam``), aggregated tile by tile (``semiglobal_paths``), checked for
what only one eye sees, refined (``refinement``) and given a probability (``confidence``).
"""

from __future__ import annotations

import mmap
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import confidence, refinement
from panodepth_ros.matching.exposure import clipped, level_tables
from panodepth_ros.matching.interface import Correspondence, grey_pair
from panodepth_ros.matching.seam import canonical_seam
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_COLUMNS,
    CENSUS_PLANES,
    CENSUS_ROWS,
    HIGH_NOISE,
    HIGH_NOISE_CUT,
    LOW_NOISE_CUT,
    PairCosts,
    Source,
    census,
    grey_noise,
)
from panodepth_ros.matching.semiglobal_paths import (
    LANES,
    MARGIN_COLUMNS,
    MARGIN_ROWS,
    NOBODY,
    disagreement,
    match_tile,
    tile_memory,
    vertical_penalties,
)

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
#: Rows top … bottom − 1 and columns start … stop − 1, as (top, bottom, start, stop).
Tile = tuple[int, int, int, int]
Scalar = TypeVar('Scalar', bound=np.generic)
Locate = Callable[['Bordered', int, int, Float32Array, Float32Array], None]

#: Disparities that are less probably right than this count as unmatched.
LEAST_CONFIDENCE = 0.3
#: Most rows of a tile, most pixels times candidates, and fewest tiles.
TILE_ROWS, TILE_SIZE, FEWEST_TILES = 128, 9_000_000, 4
#: Memory of a tile up to which it stays with the process [bytes].
KEPT_MEMORY = 20_000_000
#: Columns, and rows, that one call of the other kernels handles.
COLUMN_BAND, ROW_BAND = 64, 8
#: Columns beyond either end along which a row is smoothed.
SMOOTHING_OVERLAP = 64
#: Size of the panoramas in which exposure is compared, as a fraction.
ROUGH_SCALE = 4
#: Candidate of columns that were not seen: far from all others.
UNSEEN_STEP = -30000


@dataclass(frozen=True, eq=False, slots=True)
class ColourPair:
    """
    A pair cut open at its seam.

    Attributes
    ----------
    left, right : ndarray of uint8, shape (3, H, W)
        Blue, green, red; thrice the grey level of a grey panorama.
    left_grey, right_grey : ndarray of uint8, shape (H, W)
        Grey levels, interpolated across columns that were not seen.
    left_seen, right_seen : ndarray of bool, shape (W,)
        Whether a frame saw the column.
    first, candidates : int
        Candidate k of column x is column (x + first + k) mod W.
    """

    left: Bytes
    right: Bytes
    left_grey: Bytes
    right_grey: Bytes
    left_seen: npt.NDArray[np.bool_]
    right_seen: npt.NDArray[np.bool_]
    first: int
    candidates: int

    def partners(self, best: npt.NDArray[np.uint16]) -> npt.NDArray[np.intp]:
        """Right column of each pixel's candidate, shape (H, W)."""
        columns = self.left_seen.size
        return np.asarray((np.arange(columns) + self.first + best) % columns, np.intp)


@dataclass(frozen=True, eq=False, slots=True)
class Winners:
    """
    What the aggregation finds, shape (H, W).

    Attributes
    ----------
    best : ndarray of uint16
        Number of the best candidate.
    margin : ndarray of uint16
        Aggregated cost of the next best one that is not its neighbour, minus its own.
    eyes : ndarray of uint8
        By how many columns the right pixel's best candidate differs, at most 255.
    """

    best: npt.NDArray[np.uint16]
    margin: npt.NDArray[np.uint16]
    eyes: Bytes


def match_semiglobal(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match a pair; ``further`` is not used here, but by :func:`fusion.match_sweep`.

    Parameters and returns as in :func:`panodepth_ros.matching.match`. The confidence is the
    probability that the disparity is right within one column.
    """
    pair, seam = cut_open(left, right)
    with ThreadPoolExecutor(threads) as pool:
        noise = pool.submit(grey_noise, pair.left_grey)
        pair = equalised(pair, rough_match(pair, pool))
        winners = aggregate(pair, noise.result(), pool)
        disparity, probability = refine(pair, winners, pool)
    return kept(disparity, probability, seam, clipped(left))


def kept(
    disparity: Float32Array,
    probability: Float32Array,
    seam: int,
    unknown: npt.NDArray[np.bool_],
) -> Correspondence:
    """What is probable enough and not ``unknown``, on the left panorama's own columns."""
    disparity, probability = (np.roll(a, seam, axis=1) for a in (disparity, probability))
    unmatched = (probability < LEAST_CONFIDENCE) | unknown
    disparity[unmatched] = np.nan
    probability[unmatched] = np.nan
    return Correspondence(disparity, probability)


def prepare() -> None:
    """Compile the kernels."""
    size = 2 * LANES
    image = np.random.default_rng(0).integers(0, 256, (LANES, size)).astype(np.uint8)
    colours, seen = np.stack([image] * 3), np.ones(size, np.bool_)
    pair = ColourPair(colours, colours, image, image, seen, seen, first=0, candidates=LANES)
    with ThreadPoolExecutor(1) as pool:
        refine(pair, aggregate(pair, 1.0, pool), pool)


def cut_open(left: Panorama, right: Panorama) -> tuple[ColourPair, int]:
    """Cut a pair open; return it and the column at which it begins."""
    grey = grey_pair(left, right)
    seen = np.stack([grey.left_seen, grey.right_seen]).astype(np.uint8)
    seam = canonical_seam(seen, grey.left, grey.right)

    def rolled(array: Bytes) -> Bytes:
        return np.ascontiguousarray(np.roll(array, -seam, axis=-1))

    pair = ColourPair(
        left=rolled(colours(left)),
        right=rolled(colours(right)),
        left_grey=rolled(bridged(grey.left, grey.left_seen)),
        right_grey=rolled(bridged(grey.right, grey.right_seen)),
        left_seen=np.roll(grey.left_seen, -seam),
        right_seen=np.roll(grey.right_seen, -seam),
        first=grey.first,
        candidates=grey.last - grey.first + 1,
    )
    return pair, seam


def colours(panorama: Panorama) -> Bytes:
    """Blue, green and red of a panorama, shape (3, H, W); thrice the grey level of a grey one."""
    image = panorama.image
    if image.ndim == 3:
        return np.ascontiguousarray(np.moveaxis(image, 2, 0))
    return np.repeat(image[np.newaxis], 3, axis=0)


def bridged(grey: Bytes, seen: npt.NDArray[np.bool_]) -> Bytes:
    """Grey levels with unseen columns interpolated, so that windows beside them stay usable."""
    if seen.all() or not seen.any():
        return grey
    known = np.flatnonzero(seen)
    known = np.concatenate([[known[-1] - seen.size], known, [known[0] + seen.size]])
    gaps = np.flatnonzero(~seen)
    after = np.searchsorted(known, gaps)
    start, stop = known[after - 1], known[after]
    share = (gaps - start) / (stop - start)
    before = grey[:, start % seen.size].astype(np.float64)
    beyond = grey[:, stop % seen.size]
    bridged = grey.copy()
    bridged[:, gaps] = np.rint(before + share * (beyond - before))
    return bridged


@dataclass(frozen=True, eq=False, slots=True)
class RoughMatch:
    """
    Points that both eyes see, in panoramas of a ``ROUGH_SCALE``-th of the size.

    Attributes
    ----------
    y, x : ndarray of int, shape (M,)
        Their pixels in the left panorama.
    disparity : ndarray of int, shape (M,)
        Their column disparity there.
    left, right : ndarray of uint8, shape (3, M)
        Their colours in both eyes.
    """

    y: npt.NDArray[np.intp]
    x: npt.NDArray[np.intp]
    disparity: npt.NDArray[np.intp]
    left: Bytes
    right: Bytes


def small(image: Bytes) -> Bytes:
    """An image at a ``ROUGH_SCALE``-th of its size."""
    size = image.shape[1] // ROUGH_SCALE, image.shape[0] // ROUGH_SCALE
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def small_seen(seen: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Columns of a small panorama of which all was seen."""
    if seen.all():
        return np.ones(seen.size // ROUGH_SCALE, np.bool_)
    shares = small(np.tile(255 * seen.astype(np.uint8), (ROUGH_SCALE, 1)))
    return np.asarray(shares[0] == 255)


def rough_match(pair: ColourPair, pool: ThreadPoolExecutor) -> RoughMatch | None:
    """Match the census of a small pair; None if it would be too small."""
    rows, columns = pair.left_grey.shape
    candidates = pair.candidates // ROUGH_SCALE
    narrow = columns // ROUGH_SCALE < candidates + 2 * CENSUS_COLUMNS
    if candidates < 2 or rows // ROUGH_SCALE < 2 * CENSUS_ROWS or narrow:
        return None

    rough = ColourPair(
        left=np.stack([small(channel) for channel in pair.left]),
        right=np.stack([small(channel) for channel in pair.right]),
        left_grey=small(pair.left_grey),
        right_grey=small(pair.right_grey),
        left_seen=small_seen(pair.left_seen),
        right_seen=small_seen(pair.right_seen),
        first=round(pair.first / ROUGH_SCALE),
        candidates=candidates,
    )
    winners = aggregate(rough, 1.0, pool, colour=False)
    partners = rough.partners(winners.best)
    agreed = (winners.eyes == 0) & rough.left_seen & rough.right_seen[partners]
    y, x = np.nonzero(agreed)
    return RoughMatch(
        y=y,
        x=x,
        disparity=winners.best[y, x] + np.intp(rough.first),
        left=rough.left[:, y, x],
        right=rough.right[:, y, partners[y, x]],
    )


def equalised(pair: ColourPair, rough: RoughMatch | None) -> ColourPair:
    """Give the left eye the brightness of the right eye, judged by a rough match."""
    tables = None if rough is None else level_tables(rough.left, rough.right)
    if tables is None:
        return pair
    return replace(
        pair, left=np.stack([cv2.LUT(c, t) for t, c in zip(tables, pair.left, strict=True)])
    )


def aggregate(
    pair: ColourPair, noise: float, pool: ThreadPoolExecutor, *, colour: bool = True
) -> Winners:
    """
    Aggregate the costs of all candidates and find the winners of both eyes.

    Parameters
    ----------
    pair : ColourPair
    noise : float
        Noise of the grey levels.
    pool : ThreadPoolExecutor
        The tiles do not depend on how many threads it has.
    colour : bool
        Whether the colour difference counts, or only the census, as in a rough match.
    """

    def source(tile: Tile) -> PairCosts:
        return _pair_costs_of(pair, tile, noise, colour=colour)

    # The memory of a rough match stays beside that of the real one.
    size = TILE_SIZE if colour else TILE_SIZE // ROUGH_SCALE
    return aggregate_costs(pair, noise, pool, source, size)


def aggregate_costs(
    pair: ColourPair,
    noise: float,
    pool: ThreadPoolExecutor,
    source_of: Callable[[Tile], Source],
    size: int = TILE_SIZE,
) -> Winners:
    """Aggregate what a tile's costs come from, tile by tile; otherwise as :func:`aggregate`."""
    rows, columns = pair.left_grey.shape
    lanes = lanes_of(pair)
    penalties = vertical_penalties(noise)
    best, margin = (np.empty((rows, columns), np.uint16) for _ in range(2))
    right_best = np.full((rows, columns), NOBODY, np.uint32)
    merging = threading.Lock()
    memory = threading.local()

    def run(tile: Tile) -> None:
        top, bottom, start, stop = tile
        if not hasattr(memory, 'block'):
            memory.block = _one_piece(tile_memory(height, width, lanes))
        found = np.full((bottom - top, stop - start + lanes), NOBODY, np.uint32)
        source = source_of(tile)
        match_tile(
            source, source.left, source.left_seen, top - max(top - MARGIN_ROWS, 0),
            pair.candidates, penalties, memory.block, best[top:bottom, start:stop],
            margin[top:bottom, start:stop], found,
        )  # fmt: skip
        with merging:
            merge(right_best[top:bottom], found, pair.first + start)

    tiles = tiles_of(rows, columns, lanes, size)
    height = max(bottom - top for top, bottom, _, _ in tiles)
    width = max(stop - start for _, _, start, stop in tiles)
    for _ in pool.map(run, tiles):
        pass
    eyes = np.empty((rows, columns), np.uint8)
    disagreement(best, right_best, pair.first, eyes)
    return Winners(best, margin, eyes)


def _one_piece(size: int) -> Bytes:
    """Memory that malloc keeps for the next match if small, that is given back if large."""
    if size <= KEPT_MEMORY:
        return np.empty(size, np.uint8)
    return np.frombuffer(mmap.mmap(-1, size), np.uint8)


def lanes_of(pair: ColourPair) -> int:
    """Candidates of a pair, padded to whole vectors."""
    return -(-pair.candidates // LANES) * LANES


def colour_cut(noise: float) -> tuple[int, bool]:
    """Where colour differences are cut off, and whether they are doubled."""
    return (HIGH_NOISE_CUT, False) if noise > HIGH_NOISE else (LOW_NOISE_CUT, True)


def _pair_costs_of(pair: ColourPair, tile: Tile, noise: float, *, colour: bool) -> PairCosts:
    """What the costs of a tile with its margins come from."""
    first, last, start, stop = with_margins(tile, pair.left_grey.shape[0])
    right_start, right_stop = start + pair.first, stop + pair.first + lanes_of(pair)
    cut, doubled = colour_cut(noise)
    return PairCosts(
        left=wrapped(pair.left[:, first:last], start, stop),
        right=wrapped(pair.right[:, first:last], right_start, right_stop),
        left_census=_census_of(pair.left_grey, (first, last, start, stop), noise),
        right_census=_census_of(pair.right_grey, (first, last, right_start, right_stop), noise),
        left_seen=wrapped(pair.left_seen, start, stop),
        right_seen=wrapped(pair.right_seen, right_start, right_stop),
        cut=cut if colour else 0,
        doubled=doubled,
    )


def with_margins(tile: Tile, rows: int) -> Tile:
    """Tile with the margins around its core."""
    top, bottom, start, stop = tile
    top, bottom = max(top - MARGIN_ROWS, 0), min(bottom + MARGIN_ROWS, rows)
    return top, bottom, start - MARGIN_COLUMNS, stop + MARGIN_COLUMNS


def surroundings(grey: Bytes, part: Tile) -> Bytes:
    """Grey levels of a part of a panorama, with half a census window more on all sides."""
    top, bottom, start, stop = part
    rows = np.clip(np.arange(top - CENSUS_ROWS, bottom + CENSUS_ROWS), 0, grey.shape[0] - 1)
    return wrapped(grey, start - CENSUS_COLUMNS, stop + CENSUS_COLUMNS)[rows]


def _census_of(grey: Bytes, part: Tile, noise: float) -> Bytes:
    """Census of a part of a panorama, shape (8, h, w)."""
    top, bottom, start, stop = part
    planes = np.empty((CENSUS_PLANES, bottom - top, stop - start), np.uint8)
    census(surroundings(grey, part), round(noise), planes)
    return planes


def tiles_of(rows: int, columns: int, lanes: int, size: int) -> list[Tile]:
    """Cut a panorama into tiles."""
    strips = -(-rows // TILE_ROWS)
    widest = max(size * strips // (rows * lanes), MARGIN_COLUMNS)
    across = max(-(-columns // widest), -(-FEWEST_TILES // strips))
    edges = [round(strip * rows / strips) for strip in range(strips + 1)]
    sides = [round(tile * columns / across) for tile in range(across + 1)]
    return [
        (top, bottom, start, stop)
        for top, bottom in pairwise(edges)
        for start, stop in pairwise(sides)
        if start < stop
    ]


def wrapped(array: npt.NDArray[Scalar], start: int, stop: int) -> npt.NDArray[Scalar]:
    """Columns start … stop − 1 of an array that wraps around."""
    found = np.empty((*array.shape[:-1], stop - start), array.dtype)
    at = 0
    while at < stop - start:  # whole runs of columns: many times faster than one by one
        run = array[..., (start + at) % array.shape[-1] :][..., : stop - start - at]
        found[..., at : at + run.shape[-1]] = run
        at += run.shape[-1]
    return found


def _taller(image: npt.NDArray[Scalar], border: int) -> npt.NDArray[Scalar]:
    """Image with its first and last row repeated."""
    return np.pad(image, ((border, border), (0, 0)), mode='edge')


def merge(right_best: npt.NDArray[np.uint32], found: npt.NDArray[np.uint32], column: int) -> None:
    """Take in the right pixels' best that a tile found from ``column`` on, which wraps around."""
    columns = right_best.shape[1]
    start = 0
    while start < found.shape[1]:
        at = (column + start) % columns
        length = min(columns - at, found.shape[1] - start)
        part = right_best[:, at : at + length]
        np.minimum(part, found[:, start : start + length], out=part)
        start += length


def refine(
    pair: ColourPair,
    winners: Winners,
    pool: ThreadPoolExecutor,
    *,
    locate: Locate | None = None,
    coefficients: npt.NDArray[np.float64] = confidence.COEFFICIENTS,
) -> tuple[Float32Array, Float32Array]:
    """
    Find sub-column disparities and probabilities, shape (H, W), for all pixels.

    The probability is 0 where an eye did not see, or another candidate does as well. The bands
    in which this happens do not show.
    ``locate`` stands in for ``refinement.locate``, from images and rows start … stop − 1 to
    fraction and weight.
    """
    rows, columns = winners.best.shape
    images = bordered(pair, winners)
    everything_seen = bool(pair.right_seen.all())
    estimate, weight, probability = (np.empty((rows, columns), np.float32) for _ in range(3))

    def evaluate(start: int, stop: int) -> None:
        band = slice(start, stop)
        values, fraction, certainty = evidence(images, winners, start, stop, locate)
        promised = confidence.probability(values, coefficients)
        estimate[band] = fraction + winners.best[band] + np.float32(pair.first)
        weight[band] = certainty * promised**2 + np.float32(refinement.LEAST_WEIGHT)
        if not everything_seen:
            promised[~pair.right_seen[pair.partners(winners.best[band])]] = 0
        promised[winners.margin[band] == 0] = 0  # a tie, as in what is overexposed or black
        probability[band] = promised

    steps = images.best
    overlap = min(SMOOTHING_OVERLAP, columns)

    def along_columns(start: int, stop: int) -> None:
        refinement.smooth_columns(estimate, weight, steps, pair.left, start, stop)

    def along_rows(start: int, stop: int) -> None:
        refinement.hold(estimate, steps, pair.first, start, stop)
        refinement.smooth_rows(estimate, weight, steps, pair.left, start, stop, overlap)
        refinement.hold(estimate, steps, pair.first, start, stop)

    _in_bands(pool, evaluate, rows, ROW_BAND)
    _in_bands(pool, along_columns, columns, COLUMN_BAND)
    _in_bands(pool, along_rows, rows, ROW_BAND)
    probability[:, ~pair.left_seen] = 0
    return estimate, probability


@dataclass(frozen=True, eq=False, slots=True)
class Bordered:
    """
    What the kernels of ``refinement`` and ``confidence`` read, with their borders.

    Attributes
    ----------
    left, right : ndarray of uint8
        See ``refinement.locate``.
    best, agreed : ndarray of int16
        See ``confidence.agreement``.
    colours, seen : ndarray of uint8, bool
        See ``confidence.agreement_in_colour``.
    """

    left: Bytes
    right: Bytes
    best: npt.NDArray[np.int16]
    agreed: npt.NDArray[np.int16]
    colours: Bytes
    seen: npt.NDArray[np.bool_]


def bordered(pair: ColourPair, winners: Winners) -> Bordered:
    """Put the borders around."""
    columns = winners.best.shape[1]
    half, wide = refinement.HALF_WINDOW, confidence.ALIKE_COLUMNS
    best = winners.best.astype(np.int16)
    best[:, ~pair.left_seen] = UNSEEN_STEP
    agreed = np.where(winners.eyes <= 1, best, np.int16(confidence.DISAGREES))
    agreed[:, ~pair.left_seen] = confidence.DISAGREES
    last = pair.first + columns + pair.candidates + half
    return Bordered(
        left=wrapped(_taller(pair.left_grey, half), -half, columns + half),
        right=wrapped(_taller(pair.right_grey, half), pair.first - half - 1, last),
        best=best,
        agreed=wrapped(_taller(agreed, confidence.FAR), -wide, columns + wide),
        colours=pair.left,
        seen=wrapped(pair.left_seen, -wide, columns + wide),
    )


def evidence(
    images: Bordered, winners: Winners, start: int, stop: int, locate: Locate | None = None
) -> tuple[list[Float32Array], Float32Array, Float32Array]:
    """Features of ``confidence`` of some rows, and what ``refinement.locate`` finds there."""
    shape = stop - start, images.best.shape[1]
    fraction, weight, near, far, alike = (np.empty(shape, np.float32) for _ in range(5))
    if locate is None:
        refinement.locate(images.left, images.right, winners.best, start, stop, fraction, weight)
    else:
        locate(images, start, stop, fraction, weight)
    for half, stride, out in (
        (confidence.NEAR, confidence.NEAR_STRIDE, near),
        (confidence.FAR, confidence.FAR_STRIDE, far),
    ):
        confidence.agreement(images.best, images.agreed, start, stop, half, stride, out)
    confidence.agreement_in_colour(
        images.best, images.agreed, images.colours, images.seen, start, stop, alike
    )
    margin, eyes = winners.margin[start:stop], winners.eyes[start:stop]
    values = confidence.features(margin, eyes, near, far, alike, fraction, weight)
    return values, fraction, weight


def _in_bands(
    pool: ThreadPoolExecutor, run: Callable[[int, int], None], length: int, band: int
) -> None:
    """Run something for all bands of a length."""
    starts = range(0, length, band)
    for _ in pool.map(lambda start: run(start, min(start + band, length)), starts):
        pass
