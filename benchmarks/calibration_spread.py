"""
Whether self-calibration errs by as much as it says: many simulated sweeps, each of another rig.

    python -m benchmarks.calibration_spread 20 21 22
    python -m benchmarks.calibration_spread 20 21 22 --turn 180
    python -m benchmarks.calibration_spread 20 21 22 --k1-known

Each seed is a furnished room, a lens (true principal point, k1), a mounting and where the fit
begins, all drawn at random: yaw, roll and tilt up to 2°, k1 from −0.1 to 0, the principal point
off the middle by the standard deviation that is given of it (0.2 % or, at odd seeds, 1 % of the
width), the focal length up to 6 % wrong and not trusted. 160 × 120 pixels, 34°, r = 0.3 m, a frame
every 0.8° of a full turn, noise of 1.5 grey levels. Printed are the errors over the standard
deviations that the estimates state, and their mean and spread, which should be 0 and 1; of fx also
the errors in per cent.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.scenes import NOISE
from panodepth_ros.calibration import Given, SelfCalibration, self_calibrate
from panodepth_ros.calibration.self_calibration import KNOWN_CENTRE, UNKNOWN_CENTRE, view_angle_of
from panodepth_ros.camera.simulated import RealCamera, RoomCamera, furnished_room
from panodepth_ros.geometry import Mounting, PinholeCamera

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

RADIUS, FRAMES = 0.3, 450
IDEAL = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
AZIMUTH = np.arange(FRAMES) * 2 * math.pi / FRAMES
#: Of the columns of what all rigs gave.
SUMMARIES: dict[str, Callable[[Array], Array]] = {
    'mean': lambda values: values.mean(axis=0),
    'root mean square': lambda values: np.sqrt(np.square(values).mean(axis=0)),
    'largest': lambda values: np.abs(values).max(axis=0),
}


@dataclass(frozen=True, slots=True)
class Trial:
    """A simulated rig, and what its calibration is given."""

    true: PinholeCamera
    assumed: PinholeCamera
    given: Given


def trial(seed: int) -> Trial:
    """Draw a rig."""
    rng = np.random.default_rng([seed, 1])
    centre = UNKNOWN_CENTRE if seed % 2 else KNOWN_CENTRE
    yaw, roll, tilt = np.radians(rng.uniform(-2.0, 2.0, 3)).tolist()
    assumed = PinholeCamera(
        width=IDEAL.width,
        height=IDEAL.height,
        fx=IDEAL.fx,
        fy=IDEAL.fy,
        cx=IDEAL.cx,
        cy=IDEAL.cy,
    )
    off = centre * IDEAL.width * rng.standard_normal(2)
    true = replace(
        assumed,
        cx=IDEAL.cx + float(off[0]),
        cy=IDEAL.cy + float(off[1]),
        distortion=(float(rng.uniform(-0.1, 0.0)), 0.0, 0.0, 0.0, 0.0),
        mounting=Mounting(yaw=yaw, roll=roll, tilt=tilt),
    )
    scale = 1.0 + float(rng.uniform(-0.06, 0.06))
    assumed = replace(assumed, fx=scale * IDEAL.fx, fy=scale * IDEAL.fy)
    return Trial(true, assumed, Given(focal_length=math.inf, principal_point=centre))


def frames_of(seed: int, camera: PinholeCamera, arm_azimuth: Array) -> list[Image]:
    """Frames of a room at these azimuths of the arm."""
    room, real, rng = furnished_room(seed), RealCamera(camera), np.random.default_rng(seed)
    frames = []
    for azimuth in arm_azimuth.tolist():
        picture = real.render(room, azimuth, RADIUS)
        noisy = np.rint(picture + rng.normal(0, NOISE, picture.shape))
        frames.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return frames


def errors(found: SelfCalibration, true: PinholeCamera) -> dict[str, tuple[float, float]]:
    """Error and stated standard deviation of what is shown; of fx as shares of it."""
    known = found.estimates
    fx = known['focal_length']
    column = float(true.project(0.0, 0.0)[0])
    pairs = {
        'fx': (fx.value / true.fx - 1, fx.deviation / true.fx),
        'view angle': (found.view_angle.value - view_angle_of(true), found.view_angle.deviation),
        'yaw': (known['yaw'].value - true.mounting.yaw, known['yaw'].deviation),
        'roll': (known['roll'].value - true.mounting.roll, known['roll'].deviation),
        'radial column': (found.radial_column.value - column, found.radial_column.deviation),
    }
    if 'k1' in known:
        pairs['k1'] = (known['k1'].value - true.distortion[0], known['k1'].deviation)
    return pairs


def main() -> None:
    """Print a row a seed, and the mean and spread of the columns."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('seeds', type=int, nargs='+')
    parser.add_argument(
        '--turn', type=float, default=360.0, metavar='°', help='how far the arm turns'
    )
    parser.add_argument('--k1-known', action='store_true', help='hold k1 at its true value')
    arguments = parser.parse_args()
    azimuth = AZIMUTH[: round(FRAMES * arguments.turn / 360)]
    rows, normalised, focal = [], [], []
    for seed in arguments.seeds:
        rig = trial(seed)
        frames = frames_of(seed, rig.true, azimuth)
        assumed, given = rig.assumed, rig.given
        if arguments.k1_known:
            assumed = replace(assumed, distortion=rig.true.distortion)
            given = replace(given, k1=0.0)
        found = self_calibrate(frames, azimuth, assumed, given)
        by = errors(found, rig.true)
        focal.append(100 * np.array(by['fx']))
        normalised.append([error / stated for error, stated in by.values()])
        rows.append(
            [
                f'{seed}',
                '{:.2f} ± {:.2f}'.format(*focal[-1]),
                *(f'{ratio:.2f}' for ratio in normalised[-1]),
            ]
        )
        print(' '.join(rows[-1]), flush=True)
    for name, summary in SUMMARIES.items():
        of_fx = '{:.2f} ± {:.2f}'.format(*summary(np.array(focal)))
        rows.append([name, of_fx, *(f'{value:.2f}' for value in summary(np.array(normalised)))])
    print(table(['room', 'fx off %', *(f'{name} / sd' for name in by)], rows))


if __name__ == '__main__':
    main()
