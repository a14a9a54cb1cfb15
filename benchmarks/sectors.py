"""
How near the sectors of a growing sweep are to the scan of the whole turn.

    python -m benchmarks.sectors --rooms 1 2 3
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.scenes import Scene, own_room
from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import Correspondence, match, triangulate_match
from panodepth_ros.matching.progressive import GrowingMatch
from panodepth_ros.scan.beams import ScanSettings, laser_ranges
from panodepth_ros.scan.sectors import columns_of_beams


def grown(scene: Scene, portion: int) -> GrowingMatch:
    """Match of a sweep that grows by so many columns at a time, without its end."""
    rows, columns = scene.left.image.shape[:2]
    growing = GrowingMatch(rows, columns)
    for count in range(portion, columns, portion):
        seen = np.arange(columns) >= columns - count

        def partial(eye: Panorama, seen: npt.NDArray[np.bool_] = seen) -> Panorama:
            rays = np.where(seen, eye.geometry.ray_angle, np.nan)
            return Panorama(eye.image, replace(eye.geometry, ray_angle=rays))

        growing.add(partial(scene.left), partial(scene.right), threads=2)
    return growing


def line(scene: Scene, portion: int) -> list[str]:
    """One row of the table."""
    whole, growing = match(scene.left, scene.right, threads=2), grown(scene, portion)
    meanwhile, settings = growing.so_far(threads=2), ScanSettings()
    ready = growing.ready
    finished = growing.finish(scene.left, scene.right, threads=2)

    def ranges(matched: Correspondence) -> npt.NDArray[np.float32]:
        points = triangulate_match(matched, scene.left.geometry, scene.right.geometry)
        return laser_ranges(points, matched.confidence, settings)

    def wrong(matched: Correspondence) -> float:
        off = np.abs(matched.column_disparity - scene.disparity)[:, ready]
        return float((off[np.isfinite(off)] > 1).mean())

    off = np.abs(meanwhile.column_disparity - whole.column_disparity)
    off = off[np.isfinite(off)]
    decided = ready[columns_of_beams(scene.left.geometry, settings)].all(axis=1)
    sector, beam = ranges(meanwhile)[decided], ranges(whole)[decided]
    same = (sector == beam) | (np.isnan(sector) & np.isnan(beam))
    with np.errstate(invalid='ignore'):
        near = same | (np.abs(sector / beam - 1) <= 0.05)
    differing = np.count_nonzero(
        ~np.isclose(
            finished.column_disparity, whole.column_disparity, rtol=0, atol=0, equal_nan=True
        )
    )
    shares = (decided.mean(), (off == 0).mean(), (off <= 0.1).mean(), wrong(meanwhile))
    words = [f'{100 * s:.1f}' for s in (*shares, wrong(whole), near.mean())]
    return [scene.name, *words, f'{100 * growing.reused / ready.size:.1f}', str(differing)]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n', maxsplit=1)[0].strip())
    parser.add_argument('--rooms', type=int, nargs='+', default=[1, 2, 3], help='seeds')
    parser.add_argument('--portion', type=int, default=50, help='columns at a time')
    chosen = parser.parse_args()
    head = [
        '%',
        'beams decided',
        'pixels equal',
        'within 0.1 column',
        'wrong',
        'wrong, whole turn',
    ]
    rows = [line(own_room(seed), chosen.portion) for seed in chosen.rooms]
    head += ['beams within 5 % of the whole turn', 'columns taken over in the end']
    print(table([*head, 'pixels that differ then'], rows))


if __name__ == '__main__':
    main()
