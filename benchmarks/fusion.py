"""
What the further panoramas of a sweep give beside its best pair and SGBM: wrong pixels and scan.

    python -m benchmarks.fusion [--data DIR] [--rooms 1 2 3 4 5 6 7 8] [--noise 0]

``DIR`` holds a rendered room with truth and frames (see ``benchmarks.matching``). Prints one table
in Markdown: every room, and the mean of the product's own rooms.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks import accuracy, report, scenes
from benchmarks.matching import KEPT
from benchmarks.methods import Method, peer_method, product_method
from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import prepare

METHODS = (
    peer_method('SGBM'), product_method('semiglobal'), product_method('semiglobal', further=True)
)  # fmt: skip
#: What is measured, in per cent; all but what is kept and the scan's hits had better be small.
HEAD = ('wrong at 0.90 kept', 'wrong', 'kept', 'distance error, median', 'scan: within 5 %',
        'too far', 'too near')  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--data', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--rooms', type=int, nargs='*', default=list(range(1, 9)), help='seeds')
    parser.add_argument(
        '--noise', type=float, default=0.0, help='standard deviation of more noise, grey levels'
    )
    options = parser.parse_args(arguments)
    prepare('semiglobal')
    rng = np.random.default_rng(0)
    print(f'{report.versions()}\n')
    rows: list[list[str]] = []
    of_rooms = []
    for place in (*options.data, *options.rooms):
        own = isinstance(place, int)
        scene = noisier(
            scenes.own_room(place) if own else scenes.rendered_room(place), options.noise, rng
        )
        measured = [of_scene(scene, method) for method in METHODS]
        rows += lines(scene.name, measured)
        if own:
            of_rooms.append(measured)
    if of_rooms:
        rows += lines(f'mean of {len(of_rooms)} furnished rooms', np.mean(of_rooms, axis=0))
    print(report.table(['', 'method', *HEAD], rows))
    return 0


def noisier(scene: scenes.Scene, noise: float, rng: np.random.Generator) -> scenes.Scene:
    """Scene with more noise in all its panoramas [grey levels]."""

    def noisy(panorama: Panorama) -> Panorama:
        levels = panorama.image + rng.normal(0, noise, panorama.image.shape)
        image = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        return Panorama(image, panorama.geometry)

    return replace(
        scene,
        left=noisy(scene.left),
        right=noisy(scene.right),
        further=[noisy(panorama) for panorama in scene.further],
    )


def of_scene(scene: scenes.Scene, method: Method) -> list[float]:
    """Figures of ``HEAD`` of a scene, as shares."""
    found = method.run(scene, 2)
    pixels, scan = accuracy.measure(found, scene), accuracy.scan_score(found, scene)
    return [
        pixels.wrong_at(KEPT), pixels.wrong, pixels.kept, pixels.median_distance_error,
        scan.within_5_percent, scan.too_far, scan.too_near,
    ]  # fmt: skip


def lines(name: str, measured: Sequence[Sequence[float]]) -> list[list[str]]:
    """Rows of the table, a method each."""
    return [
        [
            name if method is METHODS[0] else '',
            method.name,
            *(f'{100 * value:.{2 if value < 0.01 else 1}f}' for value in values),
        ]
        for method, values in zip(METHODS, measured, strict=True)
    ]


if __name__ == '__main__':
    raise SystemExit(main())
