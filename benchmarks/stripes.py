"""Accuracy and frames of a sweep against the width of its stripes; docs/stripes.md has a run."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.report import table
from benchmarks.scenes import NOISE
from panodepth_ros.analysis.evaluation import (
    DepthScore,
    ScanScore,
    nearest_visible,
    score_depth,
    score_scan,
)
from panodepth_ros.camera.simulated import (
    Room,
    RoomCamera,
    TruthPanorama,
    furnished_room,
    truth_panorama,
)
from panodepth_ros.geometry import Panorama, PanoramaGeometry, PinholeCamera, triangulate
from panodepth_ros.matching import Correspondence, match, window_geometry
from panodepth_ros.mosaic import Rig, Sweep
from panodepth_ros.scan.beams import ScanSettings, laser_ranges

Eyes = tuple[PanoramaGeometry, PanoramaGeometry]
Image = npt.NDArray[np.float32]

FIELD_OF_VIEW = math.radians(34.0)
ARM_RADIUS = 0.30
COLUMNS = 1800


@dataclass(frozen=True, eq=False, slots=True)
class Row:
    """
    One width of stripes: what was needed, and what came out of it.

    Scores are those of each column's own ray, of the mean ray of the matching's window (what the
    depth node uses), and of the principal angle for all columns.
    """

    frames: int
    depths: tuple[DepthScore, ...]
    scans: tuple[ScanScore, ...]


def bands(rig: Rig, camera: PinholeCamera, shear: float = 0.0) -> list[slice]:
    """
    Columns of the frames that a sweep may sample; rendering these alone saves most of the time.

    ``shear`` is how far the arm may turn within a frame to either side [rad].
    """
    reach = rig.reach * rig.column_step
    found = []
    for offset in (rig.column_offset, 0.0, -rig.column_offset):
        angle = camera.ray_angle(offset)
        sides = [rig.ray_angle(angle, reach), rig.ray_angle(angle, -reach)]
        u, _ = camera.project([min(sides) - shear, max(sides) + shear], [0.0, 0.0])
        first, last = math.floor(u.min()) - 1, math.ceil(u.max()) + 1
        found.append(slice(max(first, 0), min(last + 1, camera.width)))
    return found


def look(room: Room, lens: RoomCamera, azimuth: float, seen: list[slice]) -> Image:
    """What the camera sees in some of its columns, without noise; the others are black."""
    image = np.zeros((lens.height, lens.width, 3), np.float32)
    for columns in seen:
        width = columns.stop - columns.start
        part = dataclasses.replace(lens, width=width, cx=lens.cx - columns.start)
        image[:, columns] = room.render(azimuth, part, ARM_RADIUS)
    return image


def noisy(image: Image, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Frame of a sensor with noise."""
    noise = rng.normal(0, NOISE, image.shape).astype(np.float32)
    return np.asarray(np.clip(np.rint(image + noise), 0, 255), np.uint8)


def measure(room: Room, lens: RoomCamera, offset: float, stripe: int, distance: float) -> Row:
    """Sweep a room with stripes that join at a distance, match, and compare with the truth."""
    rig = Rig(
        arm_radius=ARM_RADIUS,
        column_offset=offset,
        columns=COLUMNS,
        sweep_columns=COLUMNS,
        stripe_columns=stripe,
        stripe_distance=distance,
    )
    azimuths = [number * stripe * rig.column_step for number in range(rig.sweep_frames)]
    camera = PinholeCamera(**{name: getattr(lens, name) for name in RoomCamera.__slots__})
    sweep = Sweep(rig, camera, 0.0)
    rng, seen = np.random.default_rng(1), bands(rig, camera)
    for number, azimuth in enumerate(azimuths):
        sweep.add(number + 1, noisy(look(room, lens, azimuth, seen), rng), azimuth)
    eyes = sweep.panoramas()
    matched = match(eyes['left'], eyes['right'])
    exact = eyes['left'].geometry, eyes['right'].geometry
    truths = _truths(room, exact)
    believed = (
        exact,
        (window_geometry(exact[0]), window_geometry(exact[1])),
        (_of_one_angle(exact[0]), _of_one_angle(exact[1])),
    )
    scores = [_scores(matched, eyes, exact, truths) for eyes in believed]
    depths, scans = zip(*scores, strict=True)
    return Row(rig.sweep_frames, depths, scans)


def panorama_scores(room: Room, eyes: dict[str, Panorama]) -> tuple[DepthScore, ScanScore]:
    """Scores of panoramas of a room, triangulated as the depth node does."""
    exact = eyes['left'].geometry, eyes['right'].geometry
    matched = match(eyes['left'], eyes['right'])
    believed = window_geometry(exact[0]), window_geometry(exact[1])
    return _scores(matched, believed, exact, _truths(room, exact))


def _truths(room: Room, exact: Eyes) -> list[TruthPanorama]:
    """True distances along the rays of both panoramas."""
    return [
        truth_panorama(
            room,
            arm_radius=ARM_RADIUS,
            ray_angle=eye.ray_angle,
            ray_azimuth=eye.ray_azimuth(np.arange(COLUMNS)),
            slope=eye.slope(np.arange(eye.rows)),
        )
        for eye in exact
    ]


def _of_one_angle(geometry: PanoramaGeometry) -> PanoramaGeometry:
    angles = np.full(geometry.columns, geometry.principal_angle)
    return dataclasses.replace(geometry, ray_angle=angles)


def _scores(
    matched: Correspondence, believed: Eyes, exact: Eyes, truths: list[TruthPanorama]
) -> tuple[DepthScore, ScanScore]:
    """Scores of a match triangulated with the geometry that is believed."""
    settings = ScanSettings()
    points = triangulate(matched.column_disparity, *believed)
    radius = ARM_RADIUS * math.sin(exact[1].principal_angle)
    depth = score_depth(
        points.radial_distance,
        truths[0].radial_distance,
        truths[0].occluded,
        viewing_circle_radius=radius,
        column_step=exact[0].column_step,
    )
    nearest = [
        nearest_visible(
            truth.radial_distance,
            eye.ray_azimuth(np.arange(COLUMNS)),
            truth.height,
            ~truth.occluded,
            signed_radius=ARM_RADIUS * np.sin(eye.ray_angle),
            band=(settings.min_height, settings.max_height),
            beams=settings.beams,
        )
        for truth, eye in zip(truths, exact, strict=True)
    ]
    ranges = laser_ranges(points, matched.confidence, settings).astype(np.float64)
    return depth, score_scan(ranges, np.fmin.reduce(nearest))


def markdown(rows: dict[tuple[int, float], Row]) -> str:
    """All widths as a Markdown table, own rays / those of the window / one angle for all."""
    head = [
        *('stripe [columns]', 'joins at [m]', 'frames', 'kept %', 'median error %', 'wrong %'),
        *('scan: coverage %', 'median error %', 'within 5 %', 'too far %', 'too near %'),
    ]

    def percent(values: Iterable[float], digits: int = 1) -> str:
        return ' / '.join(f'{100 * value:.{digits}f}' for value in values)

    lines = []
    for (stripe, distance), row in rows.items():
        lines.append(
            [
                str(stripe),
                '–' if stripe == 1 else f'{distance:g}'.replace('inf', '∞'),
                str(row.frames),
                percent([row.depths[0].kept]),
                percent((score.median_error for score in row.depths), 2),
                percent(score.wrong for score in row.depths),
                percent([row.scans[0].coverage]),
                percent((score.median_error for score in row.scans), 2),
                percent(score.within_5_percent for score in row.scans),
                percent(score.too_far for score in row.scans),
                percent(score.too_near for score in row.scans),
            ]
        )
    return table(head, lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--stripes', type=int, nargs='+', default=[1, 2, 4, 8, 16])
    parser.add_argument('--distances', type=float, nargs='+', default=[math.inf, 2.0])
    parser.add_argument('--width', type=int, default=160, help='of the frames, in pixels')
    parser.add_argument('--offset', type=float, help='of the columns; default 0.44 of the width')
    parser.add_argument('--seed', type=int, default=1, help='which room')
    chosen = parser.parse_args()
    lens = RoomCamera.from_field_of_view(chosen.width, chosen.width * 3 // 4, FIELD_OF_VIEW)
    offset = chosen.offset or 70.5 / 160 * chosen.width
    room = furnished_room(chosen.seed)
    rows = {}
    for stripe in chosen.stripes:
        for distance in chosen.distances if stripe > 1 else [math.inf]:
            rows[stripe, distance] = measure(room, lens, offset, stripe, distance)
    print(markdown(rows))


if __name__ == '__main__':
    main()
