"""
Measure the default matching against OpenCV's SGBM on rooms that are made harder.

    python -m benchmarks.harder --data DIR --data DIR --rooms 1 2 3 7 8

``DIR`` is as for ``benchmarks.matching``; each of those rooms is matched as it is, in grey, with
more noise, with another exposure of one eye and with little contrast, the simulated rooms as
they are. Prints Markdown.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks import accuracy, report, scenes
from benchmarks.methods import peer_method, product_method
from benchmarks.scenes import Image, Scene
from panodepth_ros.matching import prepare

#: What is kept of the default's pixels when it is compared.
KEPT = 0.90


def grey(image: Image, right: bool) -> Image:
    """Grey instead of colour."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def noisy(image: Image, right: bool) -> Image:
    """Noise of 4 more grey levels."""
    rng = np.random.default_rng(int(right))
    return _levels(image + rng.normal(0, 4, image.shape))


def exposed(image: Image, right: bool) -> Image:
    """Right eye 1.06 times brighter, plus 4."""
    return _levels(1.06 * image + 4) if right else image


def pale(image: Image, right: bool) -> Image:
    """Contrast of 0.3, the noise as it was."""
    rng = np.random.default_rng(int(right))
    # What is left of the noise, 0.3 · NOISE, is filled up to NOISE.
    missing = scenes.NOISE * np.sqrt(1 - 0.3**2)
    return _levels(128 + 0.3 * (image - 128.0) + rng.normal(0, missing, image.shape))


def _levels(image: npt.NDArray[np.floating]) -> Image:
    levels: Image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return levels


CHANGES: Mapping[str, Callable[[Image, bool], Image] | None] = {
    'as they are': None,
    'grey instead of colour': grey,
    'noise of 4 more grey levels': noisy,
    'right eye 1.06 times brighter, plus 4': exposed,
    'contrast of 0.3': pale,
}


def changed(scene: Scene, change: Callable[[Image, bool], Image] | None) -> Scene:
    """The scene with other images of both eyes."""
    if change is None:
        return scene
    return replace(
        scene,
        left=replace(scene.left, image=change(scene.left.image, False)),
        right=replace(scene.right, image=change(scene.right.image, True)),
    )


def compared(scene: Scene) -> str:
    """Wrong pixels of the default at ``KEPT``, or all it keeps, and of SGBM at what it keeps."""
    own = accuracy.measure(product_method('semiglobal').run(scene, 1), scene)
    peer = accuracy.measure(peer_method('SGBM').run(scene, 1), scene)
    kept = min(KEPT, own.kept)
    wrong = own.wrong_at(KEPT) if kept == KEPT else own.wrong
    return f'{100 * wrong:.1f} % at {kept:.2f}, {100 * peer.wrong:.1f} % at {peer.kept:.2f}'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().partition('\n')[0])
    parser.add_argument('--data', type=Path, action='append', default=[], metavar='DIR')
    parser.add_argument('--rooms', type=int, nargs='*', default=[], help='seeds of own rooms')
    options = parser.parse_args(arguments)
    prepare('semiglobal')
    print(f'{report.versions()}\n\nWrong pixels of the default and of SGBM\n')
    rooms = [scenes.rendered_room(folder) for folder in options.data]
    rows = [
        [name, *(compared(changed(room, change)) for room in rooms)]
        for name, change in CHANGES.items()
    ]
    if rooms:
        print(report.table(['', *(room.name for room in rooms)], rows) + '\n', flush=True)
    rows = [[str(seed), compared(scenes.own_room(seed, further=False))] for seed in options.rooms]
    if rows:
        print(report.table(['furnished room', ''], rows))
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
