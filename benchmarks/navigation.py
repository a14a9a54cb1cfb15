"""
What a scan is worth to a robot: calibration of its standard deviations, and paths planned on it.

    python -m benchmarks.navigation --seeds 11 12 13 14 --data DIR

Sweeps simulated rooms, reads rendered ones, matches by the default method, prints Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks import occupancy, report, scenes
from panodepth_ros.camera.simulated import furnished_room
from panodepth_ros.geometry import triangulate
from panodepth_ros.matching import match, prepare
from panodepth_ros.scan.beams import ScanSettings, beam_confidence, laser_ranges
from panodepth_ros.scan.uncertainty import Uncertainty, range_stddev

Array = npt.NDArray[np.float64]

#: As the depth node's defaults; calibration and arm are exact here.
UNCERTAINTY = Uncertainty(
    certain_disparity=0.05, doubtful_disparity=3.5, focal_length=0.0, arm_radius=0.0
)
#: Robot, its margin beside it [m], goals a room, noise of the lidar as a share of the range.
RADIUS, MARGIN, GOALS, LIDAR_NOISE = 0.2, 0.1, 200, 0.05


@dataclass(frozen=True, eq=False, slots=True)
class Swept:
    """
    A scan of a room and what is true there.

    Attributes
    ----------
    ranges, stddev : ndarray of float, shape (N,)
        The scan and its standard deviations [m].
    perfect : ndarray of float, shape (N,)
        The same scan made of the true disparities [m].
    truth : ndarray of float, shape (N,)
        Nearest surface in the band, seen from the axis [m].
    edges : ndarray of float, shape (M, 2, 2)
        Outlines of all that reaches into the band [m].
    """

    ranges: Array
    stddev: Array
    perfect: Array
    truth: Array
    edges: Array


def simulated(seed: int, settings: ScanSettings) -> Swept:
    """Sweep a furnished room and make its scan."""
    room, band = furnished_room(seed), (settings.min_height, settings.max_height)
    truth = occupancy.true_ranges(room, band, settings.beams)
    scene = scenes.own_room(seed, further=False)
    return _swept(scene, truth, occupancy.outlines(room, band), settings)


def rendered(folder: Path, settings: ScanSettings) -> Swept:
    """Scan of a rendered room: as :func:`scenes.rendered_room`, and ``scan.npz``, ``map.npz``."""
    scan, plan = np.load(folder / 'scan.npz'), np.load(folder / 'map.npz')
    band = (scan['heights'] >= settings.min_height) & (scan['heights'] <= settings.max_height)
    azimuth = -np.pi + np.arange(settings.beams) * settings.angle_increment
    turn = np.abs((scan['az'] - azimuth[:, np.newaxis] + np.pi) % (2 * np.pi) - np.pi)
    truth = scan['range_z'][np.argmin(turn, axis=1)][:, band].min(axis=1)
    names = [name for name in plan.files if name.startswith('seg_z')]
    heights = [float(name.removeprefix('seg_z')) for name in names]
    edges = np.concatenate(
        [
            plan[name]
            for name, height in zip(names, heights, strict=True)
            if settings.min_height <= height <= settings.max_height
        ]
    )
    return _swept(scenes.rendered_room(folder), truth.astype(np.float64), edges, settings)


def _swept(scene: scenes.Scene, truth: Array, edges: Array, settings: ScanSettings) -> Swept:
    pair = scene.left.geometry, scene.right.geometry
    matched = match(scene.left, scene.right, threads=2)
    points = triangulate(matched.column_disparity, *pair)
    ranges = laser_ranges(points, matched.confidence, settings)
    confidence = beam_confidence(points, matched.confidence, ranges, settings)
    visible = np.where(scene.views[0].visible, scene.disparity, np.nan)
    perfect = laser_ranges(triangulate(visible, *pair), np.ones_like(matched.confidence), settings)
    return Swept(
        ranges=ranges.astype(np.float64),
        stddev=range_stddev(ranges, confidence, *pair, UNCERTAINTY),
        perfect=perfect.astype(np.float64),
        truth=truth,
        edges=edges,
    )


def calibration_row(name: str, scans: Sequence[Swept]) -> list[str]:
    """How the errors of beams, divided by their standard deviations, spread."""
    errors = np.concatenate([(scan.ranges - scan.perfect) / scan.stddev for scan in scans])
    stddevs = np.concatenate([scan.stddev for scan in scans])
    have = np.isfinite(errors)
    size = np.abs(errors[have])
    low, middle, high = np.percentile(errors[have], [15.87, 50, 84.13])
    within = [f'{100 * np.mean(size <= limit):.1f}' for limit in (1, 2, 3, 5)]
    spread = f'{(high - low) / 2:.2f}'
    typical = f'{100 * np.median(stddevs[have]):.1f}'
    return [name, str(have.sum()), typical, f'{middle:+.2f}', spread, *within]


def print_calibration(scans: dict[str, Swept]) -> None:
    """Print a row a room and one for all."""
    head = ['room', 'beams', 'median σ cm', 'median', 'half of the middle 68 %']
    head += [f'within {limit} σ %' for limit in (1, 2, 3, 5)]
    rows = [calibration_row(name, [scan]) for name, scan in scans.items()]
    rows.append(calibration_row('all', list(scans.values())))
    print(f'## Errors over standard deviations\n\n{report.table(head, rows)}\n', flush=True)


def navigate(
    edges: Array, scans: dict[str, Array], settings: ScanSettings, rng: np.random.Generator
) -> dict[str, occupancy.Outcome]:
    """Plan paths on each scan of one room and hold them against its true edges."""
    clearance = occupancy.true_clearance(edges)
    goals = occupancy.reachable_goals(clearance, RADIUS + MARGIN, GOALS, rng)
    outcomes = {}
    for name, ranges in scans.items():
        grid = occupancy.occupancy(
            ranges, range_min=settings.range_min, range_max=settings.range_max
        )
        paths = occupancy.plan(grid, goals, RADIUS + MARGIN)
        outcomes[name] = occupancy.judge(paths, clearance, RADIUS)
    return outcomes


def print_navigation(
    title: str, scans: Sequence[Swept], settings: ScanSettings, rng: np.random.Generator
) -> None:
    """Print a row a kind of scan, over all rooms."""
    outcomes: dict[str, list[occupancy.Outcome]] = {}
    for scan in scans:
        kinds = {
            'panodepth': scan.ranges,
            'panodepth, σ at most 0.1 m': np.where(scan.stddev > 0.1, np.nan, scan.ranges),
            'truth, seen from the axis': scan.truth,
            'lidar of 5 % noise': scan.truth * rng.normal(1, LIDAR_NOISE, scan.truth.size),
        }
        for name, outcome in navigate(scan.edges, kinds, settings, rng).items():
            outcomes.setdefault(name, []).append(outcome)
    rows = []
    for name, of_rooms in outcomes.items():
        found = sum(round(o.found * o.goals) for o in of_rooms)
        free = sum(round(o.free * o.found * o.goals) for o in of_rooms if o.found)
        goals = sum(o.goals for o in of_rooms)
        rows.append(
            [name, str(goals), f'{100 * found / goals:.1f}', f'{100 * free / max(found, 1):.1f}']
        )
    head = ['scan', 'goals', 'found %', 'paths without collision %']
    print(f'## Paths, {title}\n\n{report.table(head, rows)}\n', flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--seeds', type=int, nargs='+', default=[], metavar='N')
    parser.add_argument('--data', type=Path, action='append', default=[], metavar='DIR')
    options = parser.parse_args(arguments)
    if not options.seeds and not options.data:
        parser.error('name rooms by --seeds or --data')
    prepare('semiglobal')
    print(f'{report.versions()}\n')
    settings = ScanSettings()
    scans = {str(seed): simulated(seed, settings) for seed in options.seeds}
    files = {folder.name: rendered(folder, settings) for folder in options.data}
    print_calibration(scans | files)
    rng = np.random.default_rng(0)
    if scans:
        print_navigation('simulated rooms', list(scans.values()), settings, rng)
    for name, scan in files.items():
        print_navigation(name, [scan], settings, rng)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
