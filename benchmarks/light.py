"""What light that changes in a sweep does to depth and scan; docs/refusals.md has a run."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.stripes import ARM_RADIUS, COLUMNS, noisy, panorama_scores
from panodepth_ros.camera.simulated import RoomCamera, furnished_room
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep

Image = npt.NDArray[np.float32]
#: Columns of a frame, and their distance from the middle [px].
STRIPE, OFFSET = 4, 70.5
FRAMES = COLUMNS // STRIPE


def _exposure(share: float, _: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Seven exposures one after the other, by up to 20 %."""
    steps = np.random.default_rng(5).uniform(0.8, 1.2, 7)
    return np.full(3, 1.0 if share < 0.1 else steps[int(7 * share)])


def _corner(share: float, bearing: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """A lamp in a corner, from half of the sweep on; where it is lit then, seen half a turn on."""
    off = np.remainder(bearing, 2 * math.pi) - math.pi
    lit = 0.4 * np.exp(-((off / 0.25) ** 2)) if share >= 0.5 else np.zeros_like(off)
    return np.asarray(1.0 + lit[np.newaxis, :, np.newaxis])


#: Factors of a frame's pixels by its share of the sweep and the bearings of its columns.
CASES: dict[str, Callable[[float, npt.NDArray[np.float64]], npt.NDArray[np.float64]]] = {
    'nothing': lambda share, _: np.ones(3),
    'a lamp goes out, −20 %': lambda share, _: np.full(3, 1.0 if share < 0.45 else 0.8),
    'six steps of exposure, up to 20 %': _exposure,
    'white balance, +8 % and −8 %': lambda share, _: (
        np.array([1.0, 1.0, 1.0]) if share < 0.45 else np.array([0.92, 1.0, 1.08])
    ),
    'drift by ±10 %': lambda share, _: np.full(3, 1.0 + 0.1 * math.sin(2 * math.pi * share)),
    'a lamp lights a corner, +40 %': _corner,
}


def sweep_of(frames: list[Image], lens: RoomCamera, case: str, *, mends: bool) -> Sweep:
    """Sweep through frames of which the light is changed."""
    rig = Rig(
        arm_radius=ARM_RADIUS,
        column_offset=OFFSET,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        stripe_columns=STRIPE,
        stripe_distance=2.0,
        mends_light=mends,
    )
    camera = PinholeCamera(**{name: getattr(lens, name) for name in RoomCamera.__slots__})
    sweep, rng = Sweep(rig, camera, 0.0), np.random.default_rng(1)
    ray = -np.arctan((np.arange(lens.width) - lens.cx) / lens.fx)
    for number, frame in enumerate(frames):
        azimuth = number * STRIPE * rig.column_step
        factor = CASES[case](number / FRAMES, azimuth + ray)
        sweep.add(number + 1, noisy((frame * factor).astype(np.float32), rng), azimuth)
    return sweep


def main() -> None:
    """Print the table; write the panoramas if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rooms', type=int, default=2)
    parser.add_argument('--pictures', type=Path, help='folder for the left panoramas')
    asked = parser.parse_args()
    lens = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
    found = []
    scores: dict[tuple[str, bool], list[list[float]]] = {}
    told: dict[str, list[str]] = {}
    for seed in range(asked.rooms):
        room = furnished_room(seed)
        turn = 2 * math.pi / FRAMES
        frames = [
            room.render(turn * k, lens, ARM_RADIUS).astype(np.float32) for k in range(FRAMES)
        ]
        for case in CASES:
            for mends in (False, True):
                sweep = sweep_of(frames, lens, case, mends=mends)
                eyes = sweep.panoramas()
                depth, scan = panorama_scores(room, eyes)
                numbers = [depth.wrong, scan.coverage, scan.median_error, scan.within_5_percent]
                numbers += [scan.too_far, scan.too_near]
                scores.setdefault((case, mends), []).append(numbers)
                if asked.pictures:
                    name = f'{seed}_{list(CASES).index(case)}_{"mended" if mends else "as_is"}'
                    cv2.imwrite(str(asked.pictures / f'{name}.png'), eyes['left'].image)
            steps = np.ptp(np.log(sweep.light_steps()[0]), axis=0).max()
            unknown = COLUMNS - int(eyes['left'].geometry.seen.sum())
            told.setdefault(case, []).append(f'{100 * steps:.1f} %, {unknown}')
    for (case, mends), rows in scores.items():
        means = [f'{100 * value:.2f}' for value in np.mean(rows, axis=0)]
        found.append([case, 'yes' if mends else 'no', *means, '; '.join(told[case]) * mends])
    head = ['light', 'mended', 'depth wrong %', 'scan: coverage %', 'median error %']
    head += ['within 5 %', 'too far %', 'too near %', 'gain told, columns unknown']
    print(table(head, found))


if __name__ == '__main__':
    main()
