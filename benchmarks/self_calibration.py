"""
What self-calibration is worth: a turned camera with a distorting lens against an aligned one.

    python -m benchmarks.self_calibration 0 1 2

Sweeps furnished rooms of the given seeds with the demo's camera (160 × 120, 34°, r = 0.3 m, noise
of 1.5 grey levels), aligned and ideal, and with yaw 1.2°, roll 0.7°, tilt −0.8° and k1 −0.08.
Distances are compared with the rays that the true camera's pixels see.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.scenes import NOISE
from panodepth_ros.calibration import Given, compare_view_angles, self_calibrate
from panodepth_ros.camera.simulated import RealCamera, Room, RoomCamera, furnished_room
from panodepth_ros.geometry import Mounting, PinholeCamera, triangulate
from panodepth_ros.geometry.mounting import ALIGNED
from panodepth_ros.matching import match
from panodepth_ros.mosaic import Rig, Sweep

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

RADIUS, COLUMNS, OFFSET = 0.3, 1800, 70.5
#: What a sensible threshold keeps, as the depth node's default does.
LEAST_CONFIDENCE = 0.3
IDEAL = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
CAMERA = PinholeCamera(width=160, height=120, fx=IDEAL.fx, fy=IDEAL.fy, cx=79.5, cy=59.5)
TURNED = replace(
    CAMERA,
    distortion=(-0.08, 0.0, 0.0, 0.0, 0.0),
    mounting=Mounting(yaw=math.radians(1.2), roll=math.radians(0.7), tilt=math.radians(-0.8)),
)
AZIMUTH = np.arange(COLUMNS) * 2 * math.pi / COLUMNS


def frames_of(room: Room, camera: PinholeCamera, seed: int) -> list[Image]:
    """One turn, a frame a column."""
    real, rng = RealCamera(camera), np.random.default_rng(seed)
    frames = []
    for azimuth in AZIMUTH:
        picture = real.render(room, float(azimuth), RADIUS)
        noisy = np.rint(picture + rng.normal(0, NOISE, picture.shape))
        frames.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return frames


def depth_error(
    room: Room, frames: list[Image], assumed: PinholeCamera, true: PinholeCamera
) -> tuple[float, float, float]:
    """
    Median relative error of the distance, its signed median, and share of pixels with a distance.

    The truth of a pixel of the left panorama is where the ray of the true camera ends that the
    assumed camera took for the pixel's.
    """
    rig = Rig(
        arm_radius=RADIUS,
        column_offset=OFFSET,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        mounting=assumed.mounting,
    )
    sweep = Sweep(rig, assumed, 0.0)
    for k, frame in enumerate(frames):
        sweep.add(k + 1, frame, float(AZIMUTH[k]))
    eyes = sweep.panoramas()
    matched = match(eyes['left'], eyes['right'])
    left = eyes['left'].geometry
    points = triangulate(matched.column_disparity, left, eyes['right'].geometry)
    u, v = assumed.project(left.principal_angle, left.slope(np.arange(left.rows)))
    angle, slope = true.rays(u, v)
    arm = left.ray_azimuth(np.arange(left.columns)) - left.principal_angle
    beta = arm[np.newaxis, :] + angle[:, np.newaxis]
    centre = RADIUS * np.stack([np.cos(arm), np.sin(arm), np.zeros_like(arm)], axis=-1)
    origins = np.broadcast_to(centre, (*beta.shape, 3)).reshape(-1, 3)
    rise = np.broadcast_to(slope[:, np.newaxis], beta.shape)
    rays = np.stack([np.cos(beta), np.sin(beta), rise], axis=-1).reshape(-1, 3)
    ends = origins + room.cast(origins, rays)[:, np.newaxis] * rays
    truth = np.hypot(ends[:, 0], ends[:, 1]).reshape(beta.shape)
    sure = matched.confidence >= LEAST_CONFIDENCE
    relative = (points.radial_distance / truth - 1)[sure & np.isfinite(points.radial_distance)]
    share = relative.size / truth.size
    return float(np.median(np.abs(relative))), float(np.median(relative)), share


def eyes_disagree(assumed: PinholeCamera, true: PinholeCamera) -> tuple[float, float]:
    """Relative error of the angle between the eyes' rays, and rows between the eyes [px]."""
    phi = math.atan(OFFSET / assumed.fx)
    slope = np.linspace(-0.2, 0.2, 9)
    (left, left_rise), (right, right_rise) = (
        true.rays(*assumed.project(sign * phi, slope)) for sign in (-1, 1)
    )
    angle = (right - left) / (2 * phi) - 1
    rows = (right_rise - left_rise) * true.fy
    return float(angle[np.abs(angle).argmax()]), float(np.abs(rows).max())


def main() -> None:
    """Print one table a room, and what was estimated."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('seeds', type=int, nargs='+')
    parser.add_argument(
        '--given',
        type=float,
        nargs='+',
        default=[0.0, 0.1, 0.2, math.inf],
        metavar='%',
        help='how well fx is given; inf begins 2 %% off',
    )
    parser.add_argument(
        '--centre',
        type=float,
        default=0.2,
        metavar='%',
        help="how well the principal point is given, of the image's width",
    )
    parser.add_argument(
        '--part',
        type=float,
        nargs=2,
        default=[0.0, 360.0],
        metavar='°',
        help='which part of the turn is calibrated by',
    )
    arguments = parser.parse_args()
    part = slice(*(round(COLUMNS * degrees / 360) for degrees in arguments.part))
    for seed in arguments.seeds:
        room = furnished_room(seed)
        rows: list[list[str]] = []

        def add(
            name: str,
            frames: list[Image],
            assumed: PinholeCamera,
            true: PinholeCamera,
            room: Room = room,
            rows: list[list[str]] = rows,
        ) -> None:
            error, bias, share = depth_error(room, frames, assumed, true)
            angle, off_rows = eyes_disagree(assumed, true)
            figures = (100 * error, 100 * bias, 100 * share, 100 * angle)
            rows.append([name, *(f'{figure:.2f}' for figure in figures), f'{off_rows:.2f}'])

        aligned = frames_of(room, CAMERA, seed)
        add('aligned, ideal', aligned, CAMERA, CAMERA)
        turned = frames_of(room, TURNED, seed)
        add('turned, known', turned, TURNED, TURNED)
        add('turned, taken as aligned', turned, CAMERA, TURNED)
        for percent in arguments.given:
            deviation, scale = percent / 100, 1.0 if math.isfinite(percent) else 1.02
            name = f'self-calibrated, fx given ± {percent:g} %'
            if not math.isfinite(percent):
                name = 'self-calibrated, fx given 2 % wrong and not trusted'
            began = time.monotonic()
            given = Given(focal_length=deviation, principal_point=arguments.centre / 100)
            start = replace(CAMERA, fx=scale * CAMERA.fx, fy=scale * CAMERA.fy, mounting=ALIGNED)
            found = self_calibrate(turned[part], AZIMUTH[part], start, given)
            add(name, turned, found.camera, TURNED)
            took = time.monotonic() - began
            print(f'room {seed}, {name}: {len(found.tracks)} points, {took:.0f} s with matching')
            for unknown, estimate in found.estimates.items():
                angle = unknown in ('yaw', 'roll', 'tilt')
                unit = math.degrees(1.0) if angle else 1.0
                value, off = unit * estimate.value, unit * estimate.deviation
                seen = '' if estimate.observed else ' (not observed)'
                print(f'  {unknown} {value:.4f} ± {off:.4f}{seen}')
            if limits := found.focal_length_limits():
                print(
                    f'  fx ± {100 * limits[0]:.2f} % if all errors were white noise, '
                    f'± {100 * limits[1]:.2f} % if k1 were known'
                )
            by = compare_view_angles(found)
            for which in ('equation_1', 'nearest', 'farthest', 'with_parallax'):
                estimate = getattr(by, which)
                value, off = math.degrees(estimate.value), math.degrees(estimate.deviation)
                print(f'  view angle, {which}: {value:.3f}° ± {off:.3f}°')
        head = [
            f'room {seed}',
            'median distance error %',
            'bias %',
            'pixels with a distance %',
            "eyes' angle off %",
            'rows off',
        ]
        print(table(head, rows), flush=True)


if __name__ == '__main__':
    main()
