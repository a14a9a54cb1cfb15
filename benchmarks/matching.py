"""
Measure the matching methods against OpenCV's: accuracy, scan, time, memory.

    python -m benchmarks.matching --data DIR --data DIR --output OUT [--large]

``DIR`` holds a rendered room with truth (``meta.json``, ``angles.npy``, ``mosaics.npz``,
``gt_pano.npz``). Prints Markdown and writes plots to ``OUT``.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import accuracy, cost, report, scenes
from benchmarks.methods import ALL_COLUMNS, PEERS, Method, peer_method, product_method
from panodepth_ros.matching import METHODS, Correspondence, prepare

#: The paper's size and one of today's cameras: rows, columns, candidates.
PAPER, LARGE = (120, 1800, 149), (480, 7000, 560)
#: What is kept when methods are compared at an equal share.
KEPT = 0.90


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--data', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--rooms', type=int, nargs='+', default=[0], help='seeds of own rooms')
    parser.add_argument('--output', type=Path, required=True, metavar='OUT')
    own = [name for name in METHODS if name not in ('sgbm', 'bm')]  # those are OpenCV's, see PEERS
    parser.add_argument('--methods', nargs='+', choices=METHODS, default=own)
    parser.add_argument('--repeat', type=int, default=9, help='runs behind each median time')
    parser.add_argument(
        '--large', action='store_true', help='times and memory at 7000 × 480 × 560, too'
    )
    parser.add_argument('--only', choices=('accuracy', 'cost', 'processor'), help='a part of it')
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    for method in options.methods:
        prepare(method)
    print(f'{report.versions()}\n')
    if options.only in (None, 'accuracy'):
        measure_accuracy(options.data, options.rooms, options.methods, options.output)
    if options.only != 'accuracy':
        measure_processor(options.methods, options.repeat)
    if options.only in (None, 'cost'):
        measure_cost(options.methods, options.repeat, large=options.large)
    return 0


def measure_accuracy(
    data: Sequence[Path], seeds: Sequence[int], names: Sequence[str], output: Path
) -> None:
    """Print the accuracy of every method on every scene; write the curves."""
    rooms = [scenes.rendered_room(folder) for folder in data]
    rooms += [scenes.own_room(seed) for seed in seeds]
    for scene in [*rooms, scenes.weak_texture()]:
        methods: list[Method] = []
        for name in names:
            methods += [product_method(name), product_method(name, further=True)]
        methods += [peer_method(name) for name in PEERS]
        results = {}
        previous = None
        for method in methods:
            found = method.run(scene, 1)
            if previous is not None and _same(found, previous):
                continue  # a method that uses the pair alone, given all columns
            previous = found
            results[method.name] = (
                accuracy.measure(found, scene),
                accuracy.scan_score(found, scene),
            )
        print(f'## {scene.name}\n\n{report.accuracy_table(results, kept=KEPT)}\n', flush=True)
        file = scene.name.replace(' ', '_')
        measured = {name: result for name, (result, _) in results.items()}
        report.plot_curves(measured, scene.name, output / f'curves_{file}.png')
        own = {name: result for name, result in measured.items() if 'OpenCV' not in name}
        report.plot_reliability(own, scene.name, output / f'reliability_{file}.png')


def _same(one: Correspondence, other: Correspondence) -> bool:
    return np.array_equal(one.column_disparity, other.column_disparity, equal_nan=True)


def measure_processor(names: Sequence[str], repeat: int) -> None:
    """Print the processor time of one thread, which a busy machine changes less than the time."""
    scene = scenes.weak_texture()
    seconds = cost.compare(
        (scene.left, scene.right), names, PEERS,
        threads=1, repeat=repeat, clock=time.process_time,
    )  # fmt: skip
    rows = [
        [name, f'{1e3 * taken:.1f}', f'{taken / seconds["OpenCV SGBM"]:.2f}']
        for name, taken in seconds.items()
    ]
    head = ['method', 'processor time ms', 'of SGBM']
    print(f'## Processor time, one thread\n\n{report.table(head, rows)}\n', flush=True)


def measure_cost(names: Sequence[str], repeat: int, *, large: bool) -> None:
    """Print times, memory and how the time grows."""
    scene = scenes.weak_texture()
    if 'semiglobal' in names:
        names = [*names, f'semiglobal{ALL_COLUMNS}']
    for size in (PAPER, LARGE) if large else (PAPER,):
        pair = (scene.left, scene.right) if size == PAPER else scenes.noise_pair(*size)
        # OpenCV's two-pass matchers hold all candidates of all pixels: 3.5 GB at the large size.
        peers = PEERS if size == PAPER else ('SGBM', 'SGBM_3WAY', 'BM')
        one, two = (
            cost.compare(pair, names, peers, threads=threads, repeat=repeat) for threads in (1, 2)
        )
        shown = '{1} × {0} × {2}'.format(*size)
        print(f'## Time, {shown}\n\n{report.time_table(one, two)}\n', flush=True)
        rows = []
        for name in (*names, *(f'OpenCV {peer}' for peer in peers)):
            peaks = [cost.peak_memory(name, size, threads) for threads in (1, 2)]
            rows.append([name, *(f'{peak:.0f}' for peak in peaks)])
        head = ['method', '1 thread MB', '2 threads MB']
        print(f'## Memory above the process, {shown}\n\n{report.table(head, rows)}\n', flush=True)
    rows = []
    for name in names:
        work, seconds, spread = cost.linearity(name, repeat=repeat)
        slope = np.polyfit(work, seconds, 1)[0]
        rows.append([name, f'{1e9 * slope:.3f}', f'{spread:.2f}'])
    head = ['method', 'ns per pixel and candidate', 'largest over smallest of the sizes']
    sizes = ', '.join('{1} × {0} × {2}'.format(*size) for size in cost.SIZES)
    print(f'## Growth over {sizes}\n\n{report.table(head, rows)}\n')


if __name__ == '__main__':
    raise SystemExit(main())
