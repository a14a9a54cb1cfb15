"""What the demo shows of its results: pictures, accuracy, the scan as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.analysis.evaluation import (
    DepthScore,
    ScanScore,
    nearest_visible,
    score_depth,
    score_scan,
)
from panodepth_ros.camera.simulated import (
    Room,
    TruthPanorama,
    furnished_room,
    truth_panorama,
)
from panodepth_ros.export import pictures as plots
from panodepth_ros.export.film import save_film
from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import JointReading, panorama_geometry, to_nanoseconds

#: Upper end of the depth picture's colour scale [m].
_FARTHEST_SHOWN = 5.0


def report(
    results: dict[str, Any], output: Path, *, room_seed: int, band: tuple[float, float]
) -> None:
    """
    Write the pictures and ``scan.json``, and print the accuracy.

    Parameters
    ----------
    results : dict
        Messages of one sweep by topic: images and camera_info of both eyes, depth/image,
        depth/confidence, scan.
    output : Path
        Folder to write to.
    room_seed : int
        Seed of the simulated room.
    band : (float, float)
        Height band of the scan [m].
    """
    print('comparing with the true room', flush=True)
    for eye in ('left', 'right'):
        cv2.imwrite(str(output / f'{eye}.png'), to_array(results[f'{eye}/image']))
    depth = to_array(results['depth/image'])
    scan = results['scan']
    ranges = np.array(scan.ranges, dtype=np.float64)
    left, right = (panorama_geometry(results[f'{eye}/camera_info']) for eye in ('left', 'right'))
    unseen = left.columns - int(left.seen.sum())
    if unseen:
        print(
            f'{unseen} of {left.columns} columns are unknown, for no frame reached them: this '
            'machine was too busy',
            flush=True,
        )
    room = furnished_room(room_seed)
    truth = {eye: _truth(room, eye) for eye in (left, right)}
    depth_score = score_depth(
        depth.astype(np.float64),
        np.where(np.isfinite(truth[left].radial_distance), truth[left].radial_distance, np.nan),
        truth[left].occluded,
        viewing_circle_radius=left.arm_radius * math.sin(-left.principal_angle),
        column_step=left.column_step,
    )
    true_ranges = [_true_ranges(truth[eye], eye, band, ranges.size) for eye in (left, right)]
    scan_score = score_scan(ranges, np.fmin(*true_ranges))
    plots.save_depth(depth, output / 'depth.png', farthest=_FARTHEST_SHOWN)
    plots.save_confidence(to_array(results['depth/confidence']), output / 'confidence.png')
    plots.save_ground_plan(
        ranges,
        output / 'ground_plan.png',
        arm_radius=left.arm_radius,
        outline=[np.array(segment) for segment in room.outline(0.0)],
        band_outline=[np.array(segment) for edge in band for segment in room.outline(edge)],
        title=f'{scan_score.within_5_percent:.1%} of the beams within 5 % of the true room',
    )
    (output / 'scan.json').write_text(
        json.dumps(
            {
                **_as_json(scan, depth_score, scan_score),
                'height_band': band,
                'room_seed': room_seed,
            },
            indent=1,
        )
    )
    _print_accuracy(depth_score, scan_score)
    names = 'left.png, right.png, depth.png, confidence.png, ground_plan.png, scan.json and bag'
    print(f'wrote {names} to {output}', flush=True)


def film(
    results: dict[str, Any], arm: Sequence[JointReading], output: Path, *, room_seed: int
) -> None:
    """Write ``ground_plan.gif``; parameters as of :func:`report`, and where the arm was."""
    left, scan = panorama_geometry(results['left/camera_info']), results['scan']
    end = to_nanoseconds(results['left/camera_info'].header.stamp)
    stamps = np.array([reading.stamp - end for reading in arm]) * 1e-9
    positions = [reading.position for reading in arm]
    begin_azimuth, end_azimuth = np.interp([-left.sweep_duration, 0.0], stamps, positions)
    save_film(
        np.array(scan.ranges, dtype=np.float64),
        output / 'ground_plan.gif',
        arm_radius=left.arm_radius,
        principal_angle=-left.principal_angle,
        begin=float(begin_azimuth),
        end=float(end_azimuth),
        duration=left.sweep_duration,
        outline=[np.array(segment) for segment in furnished_room(room_seed).outline(0.0)],
    )
    print(f'wrote ground_plan.gif to {output}', flush=True)


def _truth(room: Room, geometry: PanoramaGeometry) -> TruthPanorama:
    """What the rays of a panorama meet in the true room."""
    return truth_panorama(
        room,
        arm_radius=geometry.arm_radius,
        ray_angle=_ray_angle(geometry),
        ray_azimuth=geometry.ray_azimuth(np.arange(geometry.columns)),
        slope=geometry.slope(np.arange(geometry.rows)),
    )


def _ray_angle(geometry: PanoramaGeometry) -> npt.NDArray[np.float64]:
    return np.where(geometry.seen, geometry.ray_angle, geometry.principal_angle)


def _true_ranges(
    truth: TruthPanorama, geometry: PanoramaGeometry, band: tuple[float, float], beams: int
) -> npt.NDArray[np.float64]:
    return nearest_visible(
        truth.radial_distance,
        geometry.ray_azimuth(np.arange(geometry.columns)),
        truth.height,
        ~truth.occluded,
        signed_radius=geometry.arm_radius * np.sin(_ray_angle(geometry)),
        band=band,
        beams=beams,
    )


def _print_accuracy(depth: DepthScore, scan: ScanScore) -> None:
    print(
        f"""
accuracy against the room's truth
  depth   {depth.kept:6.1%} of the pixels both eyes see hold a distance
          {depth.median_error:6.2%} median error of the distance
          {depth.wrong:6.1%} are off by more than one column
  scan    {scan.coverage:6.1%} of the beams hold a range
          {scan.median_error:6.2%} median error
          {scan.within_5_percent:6.1%} within 5 %
          {scan.too_far:6.1%} more than 10 % too far
          {scan.too_near:6.1%} more than 10 % too near
""",
        flush=True,
    )


def _as_json(scan: Any, depth_score: DepthScore, scan_score: ScanScore) -> dict[str, Any]:
    """LaserScan as JSON, which knows neither NaN nor infinity: null, "inf" and "-inf"."""

    def value(number: float) -> float | str | None:
        if math.isnan(number):
            return None
        return number if math.isfinite(number) else f'{number}'

    names = ('angle_min', 'angle_max', 'angle_increment', 'scan_time', 'range_min', 'range_max')
    return {
        'frame_id': scan.header.frame_id,
        **{name: getattr(scan, name) for name in names},
        'ranges': [value(number) for number in scan.ranges],
        'accuracy': {
            'scan': dataclasses.asdict(scan_score),
            'depth': dataclasses.asdict(depth_score),
        },
    }
