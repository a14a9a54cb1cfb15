"""``panodepth_ros calibrate``: the camera and its mounting from the bag of a sweep."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from panodepth_ros.bag import BagError
from panodepth_ros.bag.sweep import RecordedSweep, read_sweep
from panodepth_ros.calibration import (
    Estimate,
    Given,
    SelfCalibration,
    compare_view_angles,
    self_calibrate,
)
from panodepth_ros.calibration.self_calibration import KNOWN_CENTRE, UNKNOWN_CENTRE
from panodepth_ros.camera.calibration import Calibration, write_calibration
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.outputs import check_file

#: Unknown to its name for people, unit, and factor from the core's unit.
_SHOWN = {
    'focal_length': ('fx', 'px', 1.0),
    'yaw': ('yaw', '°', math.degrees(1.0)),
    'roll': ('roll', '°', math.degrees(1.0)),
    'tilt': ('tilt', '°', math.degrees(1.0)),
    'cx': ('cx', 'px', 1.0),
    'cy': ('cy', 'px', 1.0),
    'k1': ('k1', '', 1.0),
}


def _number(least: float, most: float, unit: str) -> Callable[[str], float]:
    def parse(text: str) -> float:
        value = float(text)
        if not least <= value <= most:
            raise ValueError
        return value

    # argparse says "invalid … value" with the name of the function that raised.
    parse.__name__ = f'number ({least:g} to {most:g}{unit})'
    return parse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'bag', type=Path, help='bag with image_raw, camera_info and joint_states of a sweep'
    )
    parser.add_argument(
        '-o', '--output', type=Path, help='calibration file to write, for camera_info_url'
    )
    parser.add_argument(
        '-p', '--parameters', type=Path, help="file for the mosaicer's mounting parameters"
    )
    parser.add_argument(
        '--view-angle',
        action='store_true',
        help="show the view angle by the paper's eq. 1, too, beside that with the parallax "
        'modelled; nothing is given of the focal length then',
    )
    parser.add_argument(
        '--focal-length-sd',
        type=_number(0.0, math.inf, ' %'),
        default=0.1,
        metavar='%',
        help="how well camera_info's focal length is known (0.1); 0 holds it, inf trusts the "
        'sweep alone',
    )
    parser.add_argument(
        '--k1-sd',
        type=_number(0.0, math.inf, ''),
        default=math.inf,
        metavar='σ',
        help="how well camera_info's k1 is known (inf); 0 holds it: a sweep then tells the focal "
        'length, too',
    )
    parser.add_argument(
        '--field-of-view',
        type=_number(5.0, 120.0, '°'),
        metavar='°',
        help='rough horizontal view angle in place of the calibration in camera_info, for a '
        'camera without one; nothing is then given of the focal length',
    )
    parser.add_argument('--camera-name', default='panodepth_camera')
    parser.add_argument('--joint-name', default='panodepth_arm_joint')
    for topic in ('image', 'camera-info', 'joint-states'):
        default = '/image_raw' if topic == 'image' else f'/{topic.replace("-", "_")}'
        parser.add_argument(f'--{topic}-topic', default=default, metavar='topic')


def run(arguments: argparse.Namespace) -> int:
    """Calibrate and print; return the exit code."""
    rough = arguments.field_of_view
    sweep_alone = rough or arguments.view_angle
    given = Given(
        focal_length=math.inf if sweep_alone else arguments.focal_length_sd / 100,
        principal_point=UNKNOWN_CENTRE if rough else KNOWN_CENTRE,
        k1=math.inf if rough else arguments.k1_sd,
    )
    try:
        for path in filter(None, (arguments.output, arguments.parameters)):
            check_file(path)
        sweep = read_sweep(
            arguments.bag,
            joint_name=arguments.joint_name,
            image=arguments.image_topic,
            camera_info=arguments.camera_info_topic,
            joint_states=arguments.joint_states_topic,
            view_angle=math.radians(rough) if rough else None,
        )
        found = self_calibrate(sweep.frames, sweep.arm_azimuth, sweep.camera, given)
        print(report(sweep, found, view_angle=arguments.view_angle))
        if arguments.output:
            calibration = Calibration.of_pinhole(found.camera, arguments.camera_name)
            write_calibration(calibration, arguments.output)
            print(f'wrote {arguments.output}: camera_info_url file://{arguments.output.resolve()}')
        if arguments.parameters:
            arguments.parameters.write_text(mounting_parameters(found))
            print(f'wrote {arguments.parameters}')
    except (BagError, OSError, ValueError) as error:
        return failed('calibrate', error)
    return 0


def report(sweep: RecordedSweep, found: SelfCalibration, *, view_angle: bool) -> str:
    """Return what was found, line by line, for people."""
    turn = math.degrees(abs(sweep.arm_azimuth[-1] - sweep.arm_azimuth[0]))
    lines = [
        f'{sweep.arm_azimuth.size} frames over {turn:.1f}°, {len(found.tracks)} points followed, '
        f'residual {found.residual_px:.3f} px',
        'estimate ± standard deviation of its random error',
    ]
    for name, estimate in found.estimates.items():
        shown, unit, factor = _SHOWN[name]
        note = '' if estimate.observed else '   not observed: mostly what was given'
        lines.append(f'  {shown:5s}{_text(estimate, factor, unit)}{note}')
    if limits := found.focal_length_limits():
        lines.append(
            f'  fx would be known to ± {100 * limits[0]:.2f} % if all errors were white noise, to '
            f'± {100 * limits[1]:.2f} % if k1 were known exactly'
        )
    lines.append('determined together')
    lines.append(f'  column that looks along the arm (yaw, cx)  {_text(found.radial_column)}')
    lines.append(f'  row that looks along the arm (tilt, cy)    {_text(found.radial_row)}')
    degrees = math.degrees(1.0)
    lines.append(
        f'  view angle (fx, k1)                        {_text(found.view_angle, degrees, "°")}'
    )
    if view_angle:
        by = compare_view_angles(found)
        lines += [
            'view angle by eq. 1, as if the camera turned about its optical centre',
            f'  all points           {_text(by.equation_1, degrees, "°")}',
            f'  nearest third        {_text(by.nearest, degrees, "°")}',
            f'  farthest third       {_text(by.farthest, degrees, "°")}',
            f'  parallax modelled    {_text(by.with_parallax, degrees, "°")}',
        ]
    return '\n'.join(lines)


def _text(estimate: Estimate, factor: float = 1.0, unit: str = 'px') -> str:
    return f'{factor * estimate.value:10.4f} ± {factor * estimate.deviation:.4f} {unit}'.rstrip()


def mounting_parameters(found: SelfCalibration) -> str:
    """Return the mosaicer's mounting parameters as a parameter file."""
    mounting = found.camera.mounting
    lines = [
        f'    camera_{name}_deg: {math.degrees(getattr(mounting, name)):.5f}'
        for name in ('yaw', 'roll', 'tilt')
    ]
    return '\n'.join(['/**/mosaicer:', '  ros__parameters:', *lines]) + '\n'
