"""False alarms and misses of the closure test in simulated rooms; docs/refusals.md has a run."""

from __future__ import annotations

import argparse
import math

import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.scenes import NOISE
from benchmarks.stripes import ARM_RADIUS
from panodepth_ros.camera.simulated import Room, RoomCamera, furnished_room
from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.mosaic.closure import Closure, Seam, refusal

STEP = math.radians(0.2)
#: Turn from the first frame to the one that tells the flow, at least.
REFERENCE = math.radians(1.0)
#: Name, and what is otherwise: lost angle [rad], robot, noise, gain, contrast of the whole room.
CASES: dict[str, dict[str, float]] = {
    'nothing': {},
    'nothing, noise of 5': {'noise': 5.0},
    'nothing, 10 % darker': {'gain': 0.9},
    'nothing, a third of the contrast': {'contrast': 1 / 3},
    'a quarter step lost (0.05°)': {'lost': 0.25 * STEP},
    'half a step lost': {'lost': 0.5 * STEP},
    '1 step lost (0.2°)': {'lost': STEP},
    '5 steps lost': {'lost': 5 * STEP},
    '1 step too many': {'lost': -STEP},
    'robot moved by 1 cm': {'moved': 0.01},
    'robot moved by 3 cm': {'moved': 0.03},
    'robot turned by 1°': {'turned': math.radians(1.0)},
}


def closure(
    room: Room,
    lens: RoomCamera,
    begin: float,
    step: float,
    at_360: bool,
    rng: np.random.Generator,
    *,
    lost: float = 0.0,
    moved: float = 0.0,
    turned: float = 0.0,
    noise: float = NOISE,
    gain: float = 1.0,
    contrast: float = 1.0,
) -> Closure:
    """Closure of one turn, of which only the frames that count are rendered."""

    def exposed(
        azimuth: float, gain: float, robot: tuple[float, float, float]
    ) -> npt.NDArray[np.uint8]:
        image = room.render(azimuth, lens, ARM_RADIUS, robot).astype(np.float64)
        image = gain * (128 + contrast * (image - 128))
        noisy = np.rint(image + rng.normal(0, noise, image.shape))
        return np.clip(noisy, 0, 255).astype(np.uint8)

    seam, way = Seam(), rng.uniform(0, 2 * math.pi)
    for azimuth in (begin, begin + step * math.ceil(REFERENCE / step)):
        seam.take(exposed(azimuth, 1.0, (0.0, 0.0, 0.0)), azimuth)
    end = begin + 2 * math.pi - (0.0 if at_360 else step)
    robot = (moved * math.cos(way), moved * math.sin(way), turned)
    seam.take(exposed(end - lost, gain, robot), end)
    camera = PinholeCamera(
        width=lens.width, height=lens.height, fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy
    )
    return seam.measure(camera)


def rows(
    rooms: int, turns: int, lens: RoomCamera, tolerance: float, step: float, at_360: bool
) -> list[list[str]]:
    """Measure all cases in some rooms, some turns each."""
    furnished = [furnished_room(seed) for seed in range(rooms)]
    found = []
    for name, case in CASES.items():
        rng = np.random.default_rng(7)
        lost, mismatch, refused, unknown = [], [], 0, 0
        for room in furnished:
            for begin in rng.uniform(0, 2 * math.pi, turns):
                try:
                    closed = closure(room, lens, float(begin), step, at_360, rng, **case)
                except ValueError:
                    unknown += 1
                    continue
                lost.append(math.degrees(closed.lost))
                mismatch.append(math.degrees(closed.mismatch))
                refused += bool(refusal(closed, tolerance))
        spread = np.percentile(lost or [np.nan], [2.5, 50, 97.5])
        found.append(
            [
                name,
                str(len(lost)),
                str(refused),
                str(unknown),
                f'{spread[1]:.3f}',
                f'{spread[0]:.3f} to {spread[2]:.3f}',
                f'{np.median(mismatch or [np.nan]):.3f}',
                f'{np.max(mismatch or [np.nan]):.3f}',
            ]
        )
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rooms', type=int, default=20)
    parser.add_argument('--turns', type=int, default=20, help='in each room (%(default)s)')
    parser.add_argument('--width', type=int, default=160)
    parser.add_argument('--tolerance', type=float, default=0.07, help='[°] (%(default)s)')
    parser.add_argument('--step', type=float, default=0.2, help='[°] (%(default)s)')
    parser.add_argument('--field', type=float, default=34.0, help='of view [°] (%(default)s)')
    parser.add_argument(
        '--before-360', action='store_true', help='the last frame is one step before 360°'
    )
    asked = parser.parse_args()
    lens = RoomCamera.from_field_of_view(
        asked.width, asked.width * 3 // 4, math.radians(asked.field)
    )
    head = ['at the end', 'told', 'refused', 'unknown', 'lost °', '95 % of them']
    head += ['mismatch °', 'at most °']
    found = rows(
        asked.rooms,
        asked.turns,
        lens,
        math.radians(asked.tolerance),
        math.radians(asked.step),
        not asked.before_360,
    )
    print(table(head, found))


if __name__ == '__main__':
    main()
