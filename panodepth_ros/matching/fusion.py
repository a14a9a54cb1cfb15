"""
The default matching with all panoramas of a sweep: costs of every view, one aggregation.

Without further panoramas this is the pair's matching (``semiglobal``). With them each candidate
of the pair is looked up in all of them (``fusion_views``, ``fusion_costs``); seam, paths, the
smoothing and the features of the confidence are the pair's, its coefficients are not.
docs/matching.md says what it gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching import refinement, semiglobal
from panodepth_ros.matching.aggregation import (
    Tile,
    Tiling,
    Winners,
    aggregate_costs,
    colour_cut,
    surroundings,
    with_margins,
)
from panodepth_ros.matching.colour_pair import ColourPair, colour_pair, wrapped
from panodepth_ros.matching.evaluation import Block, Estimates, Locate, evaluate, smoothed
from panodepth_ros.matching.exposure import clipped
from panodepth_ros.matching.fusion_costs import (
    AFTER,
    BEFORE,
    CENSUS_FINE_ROWS,
    CENSUS_PLANES,
    HALVES,
    PHASES,
    PLANES,
    SLACK,
    WEIGHTS,
    ViewCosts,
    short_census,
)
from panodepth_ros.matching.fusion_refinement import add_view
from panodepth_ros.matching.fusion_views import (
    View,
    check_further,
    equalised_view,
    helpful,
    shares_of,
    view_of,
)
from panodepth_ros.matching.interface import Correspondence
from panodepth_ros.matching.rough import rough_match
from panodepth_ros.matching.semiglobal import Look, noise_of
from panodepth_ros.matching.semiglobal_costs import CENSUS_COLUMNS, CENSUS_ROWS
from panodepth_ros.matching.semiglobal_paths import LANES
from panodepth_ros.matching.simd import WIDE

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Indices = npt.NDArray[np.int16]
Array = npt.NDArray[np.float64]

#: Larger than the pair's, for a margin costs as much for every view.
TILING = Tiling(reach=192, widest=450, size=9_000_000)
#: Views with a baseline of at least this share of the pair's help in the sub-column step.
SUB_COLUMN_BASELINE = 0.7
#: Coefficients of ``confidence.FEATURES`` for fused costs.
COEFFICIENTS = np.array(
    [-0.9483, 0.1345, -0.0467, -0.0136, 0.2298, 1.4533, 0.0226, 1.0360,
     -0.7717, -0.4251, -0.0654, 0.0948, 3.7171, -1.6743, 0.2949, -1.1839]
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
    check_further(left.geometry, further)
    further = helpful(left.geometry, further)
    if not further:
        return semiglobal.match_semiglobal(left, right, further, threads)
    with ThreadPoolExecutor(threads) as pool:
        pair, views = look(left, right, further, pool)
        winners = aggregate_views(pair, views, noise_of(pair), pool)
        disparity, probability = refine_views(pair, views, winners, pool)
    return semiglobal.kept(disparity, probability, clipped(left))


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
) -> tuple[ColourPair, list[View]]:
    """Make a pair ready and see all panoramas from its left one, the right one last."""
    pair = colour_pair(left, right)
    rough = rough_match(pair, pool)
    pair = Look.of(pair, rough).equalised(pair)
    disparity = pair.first + np.arange(pair.candidates, dtype=np.float64)
    ordered = helpful(left.geometry, further)
    *views, last = [
        view_of(panorama, left.geometry, right.geometry, disparity)
        for panorama in (*ordered, right)
    ]
    return pair, [*(equalised_view(view, rough, pair) for view in views), last]


def aggregate_views(
    pair: ColourPair, views: Sequence[View], noise: float, pool: ThreadPoolExecutor
) -> Winners:
    """
    Aggregate the costs of all candidates over all views and find the winners of both eyes.

    Parameters as in ``aggregation.aggregate``; the pair's right eye is one of the views.
    """
    places = [_places(view, pair) for view in views]
    shares = shares_of([view.baseline for view in views])
    weights = np.floor(WEIGHTS * shares).astype(np.uint16)

    def source(tile: Tile) -> ViewCosts:
        return _view_costs_of(pair, views, places, weights, tile, noise)

    winners = Winners.none(*pair.left_grey.shape)
    aggregate_costs(pair, noise, pool, winners, TILING.sides(pair), source)
    return winners


def _places(view: View, pair: ColourPair) -> tuple[Indices, Indices]:
    """
    Where a view shows the candidates.

    Returns
    -------
    columns : ndarray of int16, shape (K,)
        Shift [1/PHASES columns].
    rows : ndarray of int16, shape (H, K)
        Row [1/HALVES rows].
    """
    height, candidates = pair.left_grey.shape[0], np.arange(pair.candidates)
    rows = np.rint(HALVES * view.rows(np.arange(height)[:, np.newaxis], candidates))
    rows = np.clip(rows, 0, HALVES * (height - 1)).astype(np.int16)
    return np.rint(PHASES * view.shift).astype(np.int16), rows


def _view_costs_of(
    pair: ColourPair,
    views: Sequence[View],
    places: Sequence[tuple[Indices, Indices]],
    weights: npt.NDArray[np.uint16],
    tile: Tile,
    noise: float,
) -> ViewCosts:
    """What the costs of a tile with its margins come from."""
    height = pair.left_grey.shape[0]
    first, last, start, stop = with_margins(tile, height)
    rows = np.stack([of_view[first:last] for _, of_view in places])
    columns = np.stack([of_view for of_view, _ in places])
    whole = columns.min(axis=1) // PHASES
    columns -= PHASES * whole[:, np.newaxis]
    top, bottom = int(rows.min()) // HALVES, int(rows.max()) // HALVES + 2
    rows -= np.int16(HALVES * top)
    around = np.clip(np.arange(top - CENSUS_ROWS, bottom + CENSUS_ROWS), 0, height - 1)
    # The last vector of a row may begin at its last column.
    wide = stop - start + int(columns.max()) // PHASES + WIDE
    wide += -wide % WIDE
    images = np.empty((len(views), 4, around.size, wide + WIDE + BEFORE + AFTER), np.uint8)
    seen = np.empty((len(views), PHASES, wide), np.bool_)
    for number, view in enumerate(views):
        begin = start + int(whole[number])
        edge = begin - CENSUS_COLUMNS - BEFORE
        images[number] = view.part(around, edge, edge + images.shape[3])
        usable = wrapped(view.seen, begin - BEFORE, begin + wide + AFTER)
        seen[number, 0] = usable[BEFORE : BEFORE + wide]
        taps = np.lib.stride_tricks.sliding_window_view(usable, BEFORE + 1 + AFTER)
        seen[number, 1:] = taps.all(axis=1)
    spread = int((rows.max(axis=2) - rows.min(axis=2)).max())
    ring = 1 << spread.bit_length()
    ring_of_greys = 1 << (spread + CENSUS_FINE_ROWS - 1).bit_length()
    cut, doubled = colour_cut(noise)
    part = first, last, start, stop + WIDE + (start - stop) % WIDE  # whole vectors
    left, census, slack = _left_of(pair, part, noise)
    return ViewCosts(
        left=left,
        left_census=census,
        slack=slack,
        left_seen=wrapped(pair.left_seen, start, stop),
        images=images,
        seen=seen,
        columns=columns,
        rows=rows,
        weights=weights,
        noise=round(noise),
        cut=cut,
        doubled=doubled,
        samples=np.empty((len(views), ring, PHASES, PLANES, wide), np.uint8),
        held=np.full((len(views), ring, PHASES), -1, np.int32),
        greys=np.empty((len(views), ring_of_greys, PHASES, wide + WIDE), np.uint8),
        held_greys=np.full((len(views), ring_of_greys, PHASES), -1, np.int32),
    )


def _left_of(pair: ColourPair, part: Tile, noise: float) -> tuple[Bytes, Bytes, Bytes]:
    """Colours, census and slack of a part of the left panorama: see ``ViewCosts``."""
    top, bottom, start, stop = part
    planes = np.empty((CENSUS_PLANES, bottom - top, stop - start), np.uint8)
    short_census(surroundings(pair.left_grey, part), round(noise), planes)
    rows = np.clip(np.arange(top - 1, bottom + 1), 0, pair.left_grey.shape[0] - 1)
    left = wrapped(pair.left, start, stop)[:, rows]
    steps = np.abs(np.diff(left.astype(np.int16), axis=1))
    most = np.maximum(steps[:, 1:], steps[:, :-1]).sum(axis=0)
    slack = np.minimum(SLACK * most // 16, 255).astype(np.uint8)
    return np.ascontiguousarray(left[:, 1:-1]), planes, slack


def refine_views(
    pair: ColourPair, views: Sequence[View], winners: Winners, pool: ThreadPoolExecutor
) -> tuple[Float32Array, Float32Array]:
    """Find sub-column disparities and probabilities, shape (H, W), with all views."""
    estimates = Estimates.none(*winners.best.shape)
    evaluate(
        pair, winners, pool, estimates, TILING.sides(pair),
        locate=locator(views), coefficients=COEFFICIENTS,
    )  # fmt: skip
    return smoothed(pair, winners, estimates, pool), estimates.probability


def locator(views: Sequence[View]) -> Locate:
    """What finds fractions and weights of some rows in all views that tell them."""
    helpers = [view for view in views[:-1] if view.baseline >= SUB_COLUMN_BASELINE]
    # As certain as one view of the pair's baseline: the left eye's noise is in all of them.
    total = 1 + sum(view.baseline**2 for view in helpers)

    def locate(
        block: Block, start: int, stop: int, fraction: Float32Array, weight: Float32Array
    ) -> None:
        refinement.locate(block.left, block.right, block.winners, start, stop, fraction, weight)
        fraction *= weight
        for view in helpers:
            add_view(
                block.left, view.grey, block.start, block.winners, view.shift, view.row_scale,
                *view.principal_rows, start, stop, fraction, weight,
            )  # fmt: skip
        np.divide(fraction, weight, out=fraction, where=weight > 0)
        weight /= np.float32(total)

    return locate
