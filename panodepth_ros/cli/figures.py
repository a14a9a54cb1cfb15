"""``panodepth_ros figures``: a recorded sweep as in the paper's Figs. 6 and 7."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.bag import BagError
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.features import Comparison, compare, load_features, table
from panodepth_ros.cli.outputs import check_folder
from panodepth_ros.cli.plotting import PlottingError, plotting
from panodepth_ros.cli.sweeps import add_sweep_arguments, read_pair, share
from panodepth_ros.geometry import Panorama, Points
from panodepth_ros.matching import Correspondence, match, prepare, triangulate_match
from panodepth_ros.matching.ncc import match_ncc
from panodepth_ros.scan.beams import ScanSettings, laser_ranges

#: Share of the known distances in b) beyond which everything known is drawn equally dark.
_FARTHEST_SHOWN = 0.95
#: Fig. 6: the paper's times on a Pentium II at 350 MHz.
_PAPER_TIMES = {'dense': '6 h 42 min 20 s', 'weighted': '3 h 21 min 56 s', 'sparse': '38 s'}
#: Times are medians of this many matches.
_RUNS = 5

Array = npt.NDArray[np.float64]
Matching = Callable[[], Correspondence]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_sweep_arguments(parser)
    parser.add_argument(
        '--output', type=Path, default=Path('figures'), help='folder to write (%(default)s)'
    )
    parser.add_argument(
        '--min-correlation',
        type=share,
        default=0.8,
        metavar='C',
        help='the weighted picture keeps what correlates at least so well (%(default)s)',
    )
    parser.add_argument(
        '--row', type=int, default=-1, help='ground plan of one row; -1 for the height band'
    )
    parser.add_argument(
        '--band',
        type=float,
        nargs=2,
        default=[-0.15, 0.15],
        metavar='M',
        help="height band of the ground plan, from the camera's height (-0.15 0.15 m)",
    )
    parser.add_argument(
        '--features', type=Path, metavar='YAML', help='features measured by hand (docs/paper.md)'
    )


def run(arguments: argparse.Namespace) -> int:
    """Draw the figures; return the exit code."""
    output: Path = arguments.output
    try:
        plots = plotting('export.paper_figures')
        check_folder(output)
        features = load_features(arguments.features) if arguments.features else []
        settings = ScanSettings(
            min_confidence=arguments.min_confidence,
            min_height=arguments.band[0],
            max_height=arguments.band[1],
            row=arguments.row,
        )
        left, right = read_pair(arguments.bag, arguments.namespace)
        matched = match(left, right, method=arguments.method, threads=arguments.threads)
        points = triangulate_match(matched, left.geometry, right.geometry)
        azimuth, distance = _ground_plan(points, matched, settings)
        compared = compare(features, _trusted(points, matched, settings), azimuth, distance)
        output.mkdir(parents=True, exist_ok=True)
        _draw_matching(plots, left, right, arguments)
        plots.save_measured_plan(
            distance * np.cos(azimuth),
            distance * np.sin(azimuth),
            output / 'figure_7.png',
            arm_radius=left.geometry.arm_radius,
            features=_places(compared),
            title=_plan_title(arguments),
        )
    except (BagError, PlottingError, OSError, ValueError) as error:
        return failed('figures', error)
    if compared:
        print(f'\n{table(compared)}')
    print(
        f'\nwrote figure_6.png, its pictures figure_6a.png to 6e.png and figure_7.png to {output}'
    )
    return 0


def _ground_plan(
    points: Points, matched: Correspondence, settings: ScanSettings
) -> tuple[Array, Array]:
    """Azimuth and distance of the reconstructed points, counter-clockwise."""
    rows = points.radial_distance.shape[0]
    if not -1 <= settings.row < rows:
        raise ValueError(f'--row is {settings.row}; allowed: -1 to {rows - 1}')
    if settings.row == -1:
        ranges = laser_ranges(points, matched.confidence, settings).astype(np.float64)
        beams = -math.pi + settings.angle_increment * np.arange(settings.beams, dtype=np.float64)
        found = np.isfinite(ranges)
        return beams[found], ranges[found]
    azimuth, distance = (
        points.azimuth[settings.row, ::-1],
        points.radial_distance[settings.row, ::-1],
    )
    confidence = matched.confidence[settings.row, ::-1]
    with np.errstate(invalid='ignore'):
        found = (confidence >= settings.min_confidence) & (distance <= settings.range_max)
    return azimuth[found], distance[found]


def _trusted(points: Points, matched: Correspondence, settings: ScanSettings) -> Points:
    """Forget the points of too little confidence."""
    with np.errstate(invalid='ignore'):
        keep = matched.confidence >= settings.min_confidence
    return Points(
        *(
            np.where(keep, values, np.nan)
            for values in (points.radial_distance, points.azimuth, points.height)
        )
    )


def _plan_title(arguments: argparse.Namespace) -> str:
    low, high = arguments.band
    where = f'row {arguments.row}' if arguments.row >= 0 else f'heights {low:g} to {high:g} m'
    return f'{where}, by {arguments.method}'


def _places(compared: Sequence[Comparison]) -> list[tuple[float, float]]:
    """Where the features are as measured; features at an unknown azimuth are not drawn (NaN)."""
    return [
        (
            item.feature.distance * math.cos(item.azimuth),
            item.feature.distance * math.sin(item.azimuth),
        )
        for item in compared
    ]


def _draw_matching(
    plots: Any, left: Panorama, right: Panorama, arguments: argparse.Namespace
) -> None:
    """Draw Fig. 6 a to e, and print the times beside the paper's."""
    threads, output = arguments.threads, arguments.output
    pair = (left, right, (), threads)
    prepare('ncc')
    prepare('sparse')
    dense, dense_time = _timed(partial(match_ncc, *pair))
    one_way, one_way_time = _timed(partial(match_ncc, *pair, back_correlation=False))
    sparse, sparse_time = _timed(partial(match, left, right, method='sparse', threads=threads))
    with np.errstate(invalid='ignore'):
        sure = one_way.confidence >= arguments.min_correlation

    distances = [
        triangulate_match(matched, left.geometry, right.geometry).radial_distance
        for matched in (dense, one_way, sparse)
    ]
    distances[1][~sure] = np.nan
    nearest = left.geometry.arm_radius
    known = distances[0][np.isfinite(distances[0])]
    farthest = float(np.quantile(known, _FARTHEST_SHOWN)) if known.size else 2 * nearest
    shown = [nearer_is_lighter(distance, nearest, farthest) for distance in distances]
    confidence = np.nan_to_num(dense.confidence).clip(0, 1)
    pictures = [
        ('a) left eye panorama', left.image),
        (f'b) dense, back-correlation, {dense_time:.1f} ms', shown[0]),
        ('c) confidence of b)', np.rint(255 * confidence).astype(np.uint8)),
        (
            f'd) weighted, correlation ≥ {arguments.min_correlation:g}, no back-correlation, '
            f'{one_way_time:.1f} ms',
            shown[1],
        ),
        (f'e) sparse, no back-correlation, {sparse_time:.1f} ms', shown[2]),
    ]
    for letter, (_, picture) in zip('abcde', pictures, strict=True):
        path = output / f'figure_6{letter}.png'
        if not cv2.imwrite(str(path), picture):
            raise OSError(f'{path} cannot be written')
    plots.save_stack(pictures, output / 'figure_6.png')
    print(f'matching {left.geometry.columns} × {left.geometry.rows} pixels, {threads} thread(s)')
    print(f'{"":<34}{"known pixels":>13}{"time":>12}{"the paper’s":>18}')
    for name, took, distance, theirs in (
        ('b) dense, back-correlation', dense_time, distances[0], 'dense'),
        ('d) weighted, no back-correlation', one_way_time, distances[1], 'weighted'),
        ('e) sparse, no back-correlation', sparse_time, distances[2], 'sparse'),
    ):
        share_known = np.isfinite(distance).mean()
        print(f'{name:<34}{share_known:>13.1%}{took:>9.1f} ms{_PAPER_TIMES[theirs]:>18}')


def nearer_is_lighter(distance: Array, nearest: float, farthest: float) -> npt.NDArray[np.uint8]:
    """
    Grey levels of distances as the paper has them: near is light, unknown is black.

    Parameters
    ----------
    distance : ndarray of float64, shape (H, W)
        [m], NaN unknown.
    nearest, farthest : float
        Distances of the lightest and the darkest level [m]; beyond them all levels are theirs.

    Returns
    -------
    ndarray of uint8, shape (H, W)
        40 to 255, 0 where unknown.
    """
    share_far = (distance - nearest) / (farthest - nearest)
    grey = 255 - 215 * np.clip(share_far, 0, 1)
    return np.rint(np.nan_to_num(grey)).astype(np.uint8)


def _timed(run: Matching) -> tuple[Correspondence, float]:
    """Match several times; return what came of it and the median time [ms]."""
    times = []
    for _ in range(_RUNS):
        start = time.perf_counter()
        matched = run()
        times.append(1000 * (time.perf_counter() - start))
    return matched, float(np.median(times))
