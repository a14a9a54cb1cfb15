"""
Measure how much the scan depends on where the tiles of the matching begin.

    python -m benchmarks.tiles --data DIR --rooms 1 2 --varied 40 41

``DIR`` is as for ``benchmarks.matching``. Between columns with as many edges a checksum decides
where a tile begins; every room is matched with several kinds of checksums, and once more with
each of them if edges do not count. Prints Markdown.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
import numpy.typing as npt

from benchmarks import accuracy, report, scenes
from benchmarks.scenes import Scene
from panodepth_ros.matching import colour_pair, match, prepare, seam

#: Kinds of checksums.
KINDS = 4
Keys = npt.NDArray[np.int64]


def within_5_percent(scene: Scene, kind: int, *, edges: bool) -> float:
    """Beams within 5 % of the truth [%], with one kind of checksums."""
    checksum = partial(_checksums, seam.column_keys, kind)
    with (
        patch.object(colour_pair, 'column_keys', checksum),
        patch.object(seam, 'EDGE_STEPS', seam.EDGE_STEPS if edges else 0),
    ):
        found = match(scene.left, scene.right)
    return 100 * accuracy.scan_score(found, scene).within_5_percent


def _checksums(
    column_keys: Callable[..., Keys], kind: int, *layers: npt.NDArray[np.uint8]
) -> Keys:
    keys = column_keys(*layers)
    return keys if kind == 0 else np.array([zlib.crc32(k, kind) for k in keys], np.int64)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--data', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--rooms', type=int, nargs='*', default=[], help='seeds of own rooms')
    parser.add_argument(
        '--varied', type=int, nargs='*', default=[], help='seeds of rooms that differ in more'
    )
    options = parser.parse_args(arguments)
    prepare('semiglobal')
    print(f'{report.versions()}\n\nBeams within 5 %, worst and best of {KINDS} checksums\n')
    rooms: list[Callable[[], Scene]] = [partial(scenes.rendered_room, d) for d in options.data]
    rooms += [partial(scenes.own_room, seed, further=False) for seed in options.rooms]
    rooms += [partial(scenes.varied_room, seed) for seed in options.varied]
    rows, worst = [], []
    for make in rooms:
        scene = make()
        found = np.array(
            [
                [within_5_percent(scene, kind, edges=edges) for kind in range(KINDS)]
                for edges in (True, False)
            ]
        )
        worst.append(np.concatenate([found.min(axis=1), found.mean(axis=1)]))
        limits = (f'{one.min():.1f} to {one.max():.1f}' for one in found)
        rows.append([scene.name, *limits])
    print(report.table(['room', 'cut beside edges', 'by checksums alone'], rows))
    means = np.mean(worst, axis=0)
    print(
        f'\nMean of the worst {means[0]:.2f} and {means[1]:.2f}, of all {means[2]:.2f} and '
        f'{means[3]:.2f}'
    )
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
