"""
The default matching with all panoramas of a sweep: costs of every view, one aggregation.

Without further panoramas this is the pair's matching (``semiglobal``). With them each candidate
of the pair is looked up in all of them (``fusion_views``, ``fusion_costs``); seam, paths, the
smoothing and the features of the confidence are the pair's, its coefficients are not.
docs/matching.md says what it gives.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching import refinement, semiglobal
from panodepth_ros.matching.fusion_costs import (
    AFTER,
    BEFORE,
    HALVES,
    PHASES,
    WEIGHTS,
    fused_costs,
)
from panodepth_ros.matching.fusion_paths import aggregate_costs
from panodepth_ros.matching.fusion_refinement import add_view
from panodepth_ros.matching.fusion_views import View, check_further, equalised_view, view_of
from panodepth_ros.matching.interface import Correspondence
from panodepth_ros.matching.semiglobal import (
    Bordered,
    ColourPair,
    Winners,
    merge,
    tiles_of,
    wrapped,
)
from panodepth_ros.matching.semiglobal_costs import (
    CENSUS_COLUMNS,
    CENSUS_PLANES,
    CENSUS_ROWS,
    HIGH_NOISE,
    HIGH_NOISE_CUT,
    LOW_NOISE_CUT,
    census,
    grey_noise,
)
from panodepth_ros.matching.semiglobal_paths import (
    FILLER_COST,
    LANES,
    MARGIN_COLUMNS,
    MARGIN_ROWS,
    NOBODY,
    disagreement,
    vertical_penalties,
)

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int16]
Array = npt.NDArray[np.float64]

#: Views with a baseline of at least this share of the pair's help in the sub-column step.
SUB_COLUMN_BASELINE = 0.7
#: Most pixels times candidates of a tile.
TILE_SIZE = 6_000_000
#: Coefficients of ``confidence.FEATURES`` for fused costs.
COEFFICIENTS = np.array(
    [-0.8893, 0.1414, -0.0087, 0.0264, 0.2980, 0.5812, 0.2574, -0.0998,
     0.6809, -0.4347, -0.0440, 0.0017, 4.6899, -2.0795, 0.2001, -1.0163]
)  # fmt: skip


def match_sweep(
    left: Panorama, right: Panorama, further: Sequence[Panorama], threads: int
) -> Correspondence:
    """
    Match a pair with all else that its sweep gives.

    Parameters and returns as in :func:`panodepth_ros.matching.match`. The confidence is the
    probability that the disparity is right within one column.

    Raises
    ------
    ValueError
        If a further panorama has another size or arm radius than the pair, the left one's
        principal angle or rays far from its own.
    """
    if not further:
        return semiglobal.match_semiglobal(left, right, further, threads)
    with ThreadPoolExecutor(threads) as pool:
        pair, views, seam = look(left, right, further, pool)
        winners = aggregate_views(pair, views, grey_noise(pair.left_grey), pool)
        disparity, probability = refine_views(pair, views, winners, pool)
    return semiglobal.kept(disparity, probability, seam)


def prepare() -> None:
    """Compile the kernels."""
    semiglobal.prepare()
    size = 4 * LANES
    image = np.random.default_rng(0).integers(0, 256, (LANES, size, 3)).astype(np.uint8)
    left, right, centre = (
        Panorama(
            image,
            PanoramaGeometry(
                columns=size,
                rows=LANES,
                azimuth_column=0.0,
                focal_length_px=100.0,
                principal_row=LANES / 2,
                arm_radius=1.0,
                principal_angle=angle,
                sweep_duration=0.0,
                ray_angle=np.full(size, angle),
            ),
        )
        for angle in (-0.5, 0.5, 0.0)
    )
    match_sweep(left, right, [centre], 1)


def look(
    left: Panorama, right: Panorama, further: Sequence[Panorama], pool: ThreadPoolExecutor
) -> tuple[ColourPair, list[View], int]:
    """Cut a pair open and see all panoramas from its left one, the right one last; the seam."""
    check_further(left.geometry, further)
    pair, seam = semiglobal.cut_open(left, right)
    rough = semiglobal.rough_match(pair, pool)
    pair = semiglobal.equalised(pair, rough)
    disparity = pair.first + np.arange(pair.candidates, dtype=np.float64)
    ordered = sorted(further, key=lambda panorama: panorama.geometry.principal_angle)
    *views, last = [
        view_of(panorama, left.geometry, right.geometry, disparity, seam)
        for panorama in (*ordered, right)
    ]
    return pair, [*(equalised_view(view, rough, pair.first) for view in views), last], seam


def aggregate_views(
    pair: ColourPair, views: Sequence[View], noise: float, pool: ThreadPoolExecutor
) -> Winners:
    """
    Aggregate the costs of all candidates over all views and find the winners of both eyes.

    Parameters as in ``semiglobal.aggregate``; the pair's right eye is one of the views.
    """
    rows, columns = pair.left_grey.shape
    lanes = -(-pair.candidates // LANES) * LANES
    shares = np.array([view.baseline**2 for view in views])
    weights = np.floor(WEIGHTS * shares / shares.sum()).astype(np.uint16)
    cut = HIGH_NOISE_CUT if noise > HIGH_NOISE else LOW_NOISE_CUT
    penalties = vertical_penalties(noise)
    best, margin = (np.empty((rows, columns), np.uint16) for _ in range(2))
    right_best = np.full((rows, columns), NOBODY, np.uint32)
    merging = threading.Lock()
    memory = threading.local()
    tiles = tiles_of(rows, columns, lanes, TILE_SIZE)
    height = max(bottom - top for top, bottom, _, _ in tiles)
    width = max(stop - start for _, _, start, stop in tiles)
    most_totals = height * width * lanes
    most_costs = (height + 2 * MARGIN_ROWS) * (width + 2 * MARGIN_COLUMNS) * lanes

    def run(tile: tuple[int, int, int, int]) -> None:
        top, bottom, start, stop = tile
        if not hasattr(memory, 'block'):
            memory.block = np.empty(most_costs + 2 * most_totals, np.uint8)
        first, last = max(top - MARGIN_ROWS, 0), min(bottom + MARGIN_ROWS, rows)
        left, left_census, left_seen = _left_of_tile(pair, first, last, start, stop, round(noise))
        shape = (last - first, left_seen.size, lanes)
        costs = memory.block[: np.prod(shape)].reshape(shape)
        sampled = _samples(views, first, last, start - MARGIN_COLUMNS, stop + MARGIN_COLUMNS)
        fused_costs(
            left, left_census, left_seen, *sampled, weights, round(noise), cut,
            cut == LOW_NOISE_CUT, FILLER_COST, costs,
        )  # fmt: skip
        shape = (bottom - top, stop - start, lanes)
        totals = memory.block[most_costs : most_costs + 2 * np.prod(shape)].view(np.uint16)
        found = np.full((bottom - top, stop - start + lanes), NOBODY, np.uint32)
        aggregate_costs(
            left, costs, left_seen, top - first, pair.candidates, penalties,
            totals.reshape(shape), best[top:bottom, start:stop], margin[top:bottom, start:stop],
            found,
        )  # fmt: skip
        with merging:
            merge(right_best[top:bottom], found, pair.first + start)

    for _ in pool.map(run, tiles):
        pass
    eyes = np.empty((rows, columns), np.uint8)
    disagreement(best, right_best, pair.first, eyes)
    return Winners(best, margin, eyes)


def _left_of_tile(
    pair: ColourPair, first: int, last: int, start: int, stop: int, noise: int
) -> tuple[Bytes, Bytes, npt.NDArray[np.bool_]]:
    """Colours, census and seen columns of a tile with its margins."""
    start, stop = start - MARGIN_COLUMNS, stop + MARGIN_COLUMNS
    around = np.arange(first - CENSUS_ROWS, last + CENSUS_ROWS)
    rows = np.clip(around, 0, pair.left_grey.shape[0] - 1)
    grey = wrapped(pair.left_grey[rows], start - CENSUS_COLUMNS, stop + CENSUS_COLUMNS)
    planes = np.empty((CENSUS_PLANES, last - first, stop - start), np.uint8)
    census(grey, noise, planes)
    return (
        wrapped(pair.left[:, first:last], start, stop),
        planes,
        wrapped(pair.left_seen, start, stop),
    )


def _samples(
    views: Sequence[View], first: int, last: int, start: int, stop: int
) -> tuple[Bytes, Bytes, npt.NDArray[np.bool_], Indices, Indices, int]:
    """
    What a tile may ask of the views, and where: see ``fusion_costs.fused_costs``.

    Returns
    -------
    images, greys, seen, columns, rows, ring
    """
    height, candidates = views[0].grey.shape[0], np.arange(views[0].shift.size)
    tile_rows = np.arange(first, last)[:, np.newaxis]
    rows = np.empty((len(views), last - first, candidates.size), np.int16)
    columns = np.empty((len(views), candidates.size), np.int16)
    whole = []
    for number, view in enumerate(views):
        fine = np.rint(HALVES * view.rows(tile_rows, candidates))
        rows[number] = np.clip(fine, 0, HALVES * (height - 1))
        shifts = np.rint(PHASES * view.shift)
        whole.append(int(shifts.min() // PHASES))
        columns[number] = shifts - PHASES * whole[-1]
    spread = int((rows.max(axis=2) - rows.min(axis=2)).max())
    top, bottom = int(rows.min()) // HALVES, int(rows.max()) // HALVES + 2
    rows -= np.int16(HALVES * top)
    wide = stop - start + int(columns.max()) // PHASES + 1
    around = np.clip(np.arange(top - CENSUS_ROWS, bottom + CENSUS_ROWS), 0, height - 1)
    border, taps = CENSUS_COLUMNS + BEFORE, BEFORE + 1 + AFTER
    size = around.size, wide + 2 * CENSUS_COLUMNS + BEFORE + AFTER
    images = np.empty((len(views), 3, *size), np.uint8)
    greys = np.empty((len(views), *size), np.uint8)
    seen = np.empty((len(views), PHASES, wide), np.bool_)
    for number, view in enumerate(views):
        begin = start + whole[number] + view.seam
        across = np.arange(begin - border, begin - border + size[1]) % view.seen.size
        part = np.ix_(around, across)
        colours = view.image[part]
        images[number] = np.moveaxis(colours, 2, 0) if colours.ndim == 3 else colours
        greys[number] = view.grey[part]
        usable = wrapped(view.seen, begin - BEFORE, begin + wide + AFTER)
        seen[number, 0] = usable[BEFORE : BEFORE + wide]
        seen[number, 1:] = np.lib.stride_tricks.sliding_window_view(usable, taps).all(axis=1)
    return images, greys, seen, columns, rows, 1 << spread.bit_length()


def refine_views(
    pair: ColourPair, views: Sequence[View], winners: Winners, pool: ThreadPoolExecutor
) -> tuple[Float32Array, Float32Array]:
    """Find sub-column disparities and probabilities as ``semiglobal.refine``, with all views."""
    return semiglobal.refine(
        pair, winners, pool, locate=locator(views, winners), coefficients=COEFFICIENTS
    )


def locator(views: Sequence[View], winners: Winners) -> semiglobal.Locate:
    """What finds fractions and weights of some rows in all views that tell them."""
    helpers = [view for view in views[:-1] if view.baseline >= SUB_COLUMN_BASELINE]
    # As certain as one view of the pair's baseline: the left eye's noise is in all of them.
    total = 1 + sum(view.baseline**2 for view in helpers)

    def locate(
        images: Bordered, start: int, stop: int, fraction: Float32Array, weight: Float32Array
    ) -> None:
        refinement.locate(images.left, images.right, winners.best, start, stop, fraction, weight)
        fraction *= weight
        for view in helpers:
            add_view(
                images.left, view.grey, view.seam, winners.best, view.shift, view.row_scale,
                *view.principal_rows, start, stop, fraction, weight,
            )  # fmt: skip
        np.divide(fraction, weight, out=fraction, where=weight > 0)
        weight /= np.float32(total)

    return locate
