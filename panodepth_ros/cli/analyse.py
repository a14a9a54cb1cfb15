"""``panodepth_ros analyse``: what a rig can measure, from its numbers alone (sec. 6)."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from panodepth_ros.analysis.capture_time import (
    Capture,
    Motor,
    continuous,
    safe_speed,
    stop_and_go,
    widest_stripe,
)
from panodepth_ros.analysis.rig import RigNumbers
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.outputs import check_folder
from panodepth_ros.cli.plotting import PlottingError, plotting

#: Distances whose error is told if none are asked for [m].
_DISTANCES = (0.5, 1.0, 2.0, 3.0, 4.0)
#: The rig's numbers where they are not given.
_DEFAULTS = MappingProxyType(
    {
        'radius': 0.30,
        'fov': 34.0,
        'width': 160,
        'offset': [70.5],
        'step': 0.2,
        'linear': False,
        'sweep': 360.0,
    }
)
#: The same with ``--paper``: the columns and the rule of Tables 1 and 2, and its 1501 images.
_PAPER = MappingProxyType({**_DEFAULTS, 'offset': [70.5, 8.5], 'linear': True, 'sweep': 300.2})


@dataclass(frozen=True, slots=True)
class _Allowed:
    """A bound of the one-column error: metres, or a share of the distance."""

    value: float
    relative: bool

    def __str__(self) -> str:
        return f'{100 * self.value:g} %' if self.relative else f'{self.value:g} m'

    def at(self, distance: float) -> float:
        """Return the bound at a distance [m]."""
        return self.value * distance if self.relative else self.value


def _allowed(text: str) -> _Allowed:
    relative = text.endswith('%')
    value = float(text.removesuffix('%')) / (100 if relative else 1)
    if not 0 < value < math.inf:
        raise ValueError
    return _Allowed(value, relative)


_allowed.__name__ = 'error (metres such as 0.2, or a share such as 5%)'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add = parser.add_argument
    add('--paper', action='store_true', help="the paper's rig where nothing else is given")
    rig = parser.add_argument_group('rig')
    add = rig.add_argument
    add('--radius', type=float, metavar='M', help='arm (0.3 m)')
    add('--fov', type=float, metavar='DEG', help='horizontal view (34°)')
    add('--width', type=int, metavar='PX', help='image width (160 px)')
    add(
        *('--offset',),
        type=float,
        nargs='+',
        metavar='PX',
        help="the eyes' columns, from the middle of the image; several to compare (70.5 px)",
    )
    add('--step', type=float, metavar='DEG', help='column step (0.2°)')
    add(
        *('--linear',),
        action='store_const',
        const=True,
        help="φ by the paper's linear rule (eq. 3)",
    )
    question = parser.add_argument_group('questions')
    add = question.add_argument
    add(
        *('--at',),
        type=float,
        nargs='+',
        metavar='M',
        help='distances to tell the error of (those of 0.5 1 2 3 4 m outside of the arm)',
    )
    add(
        *('--allow',),
        type=_allowed,
        default=_Allowed(0.05, relative=True),
        metavar='ERROR',
        help='allowed error of one column: up to where is it kept, which radius and which '
        'columns keep it at the distances of --at; metres or per cent (5%%)',
    )
    capture = parser.add_argument_group('capture')
    add = capture.add_argument
    add('--sweep', type=float, metavar='DEG', help='sweep (360°)')
    add('--motor-steps', type=int, metavar='N', help='motor steps of a full turn of the arm')
    add('--speed', type=float, default=30.0, metavar='DEG_S', help='motor (%(default)s °/s)')
    add('--acceleration', type=float, default=3600.0, metavar='DEG_S2', help='(%(default)s °/s²)')
    add('--settle', type=float, default=0.1, metavar='S', help='after a step (%(default)s s)')
    add('--frame-rate', type=float, default=30.0, metavar='HZ', help='camera (%(default)s Hz)')
    add('--exposure', type=float, metavar='MS', help='of a frame: which speed is safe for it')
    add(
        *('--stripe',),
        type=int,
        nargs='+',
        metavar='COLUMNS',
        help='columns of one frame (1, and as many as divide a turn and lie within the image)',
    )
    parser.add_argument(
        '--figures', type=Path, metavar='DIR', help="draw the paper's Figs. 4 and 5 into a folder"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the analysis; return the exit code."""
    for name, value in (_PAPER if arguments.paper else _DEFAULTS).items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, value)
    try:
        if arguments.figures is not None:
            check_folder(arguments.figures)
        rigs = [_rig(arguments, offset) for offset in arguments.offset]
        lines = [*_limits(rigs, arguments.allow), *_table_1(rigs), *_table_2(rigs)]
        for rig in rigs:
            outside = [distance for distance in _DISTANCES if distance > rig.radius]
            lines += _at_distances(rig, arguments.at or outside, arguments.allow)
        lines += _capture(rigs[0], arguments)
        print('\n'.join(lines))
        if arguments.figures is not None:
            print(f'\nwrote {_draw(rigs, arguments.figures)} to {arguments.figures}')
    except (ValueError, OSError, PlottingError) as error:
        return failed('analyse', error)
    return 0


def _rig(arguments: argparse.Namespace, offset: float) -> RigNumbers:
    return RigNumbers(
        radius=arguments.radius,
        fov=math.radians(arguments.fov),
        width=arguments.width,
        offset=offset,
        step=math.radians(arguments.step),
        linear=arguments.linear,
    )


def _row(label: str, cells: Iterable[str]) -> str:
    return f'{label:<40}' + ''.join(f'{cell:>14}' for cell in cells)


def _millimetres(metres: float, digits: int = 0) -> str:
    """Return as the paper prints them: rounded, without a trailing .0."""
    return f'{round(1000 * metres, digits):.{digits}f}'.removesuffix('.0')


def _limits(rigs: list[RigNumbers], allowed: _Allowed) -> list[str]:
    first = rigs[0]
    rule = "paper's linear rule" if first.linear else 'exact pinhole'

    def row(label: str, value: Callable[[RigNumbers], str]) -> str:
        return _row(label, map(value, rigs))

    def trusted(rig: RigNumbers) -> str:
        distance = rig.trusted_distance(allowed.value, relative=allowed.relative)
        return 'none' if math.isnan(distance) else f'{_millimetres(distance)} mm'

    return [
        f'rig: r = {_millimetres(first.radius)} mm, {first.width} px over '
        f'{math.degrees(first.fov):g}°, {round(2 * math.pi / first.step)} columns of '
        f'{math.degrees(first.step):g}° a turn; φ by the {rule}',
        '',
        row('columns at ±', lambda rig: f'{rig.offset:g} px'),
        row('2φ, exact pinhole', lambda rig: _degrees(2 * rig.pinhole_angle)),
        row("2φ, paper's linear rule (eq. 3)", lambda rig: _degrees(2 * rig.linear_angle)),
        row(
            'viewing circle r0 = r·sin φ (sec. 4)',
            lambda rig: f'{_millimetres(rig.viewing_circle_radius, 1)} mm',
        ),
        row(
            'image columns of a step, W_s (sec. 3)',
            lambda rig: f'{rig.image_columns_of_a_step:.3f} px',
        ),
        row('n, columns to search = depths (sec. 6.2)', lambda rig: f'{rig.depths}'),
        row(
            'nearest distance l_min', lambda rig: f'{_millimetres(rig.distance_of_columns(1))} mm'
        ),
        row(
            'farthest distance l_max',
            lambda rig: f'{_millimetres(rig.distance_of_columns(rig.depths))} mm',
        ),
        row(f'trusted for {allowed} a column (sec. 6.4)', trusted),
    ]


def _degrees(angle: float) -> str:
    return f'{math.degrees(angle):.4f}°'


def _table_1(rigs: list[RigNumbers]) -> list[str]:
    """Write Table 1; as in the paper, errors are differences of the printed distances."""
    cells = ('l(θ − θ0/2)', 'l(θ)', 'l(θ + θ0/2)', 'error −', 'error +')
    lines = ['', _row('one column off, in mm (Table 1)', cells)]
    for share, name in ((1 / 4, 'φ/4'), (7 / 8, '7φ/8')):
        for rig in rigs:
            theta, half = share * rig.principal_angle, rig.step / 2
            near, at, far = (round(rig.distance(theta + side), 4) for side in (-half, 0.0, half))
            values = (near, at, far, at - near, far - at)
            lines.append(
                _row(
                    f'  2φ = {_degrees(2 * rig.principal_angle)}, θ = {name}',
                    (_millimetres(value, 1) for value in values),
                )
            )
    return lines


def _table_2(rigs: list[RigNumbers]) -> list[str]:
    """Write Table 2 as it is, and as the paper has it: of distances in whole millimetres."""
    lines = ['', _row('one column off, in mm (Table 2)', ('exact', 'as printed'))]
    for name, choose in (
        ('Δl_min', lambda rig: (1, 2)),
        ('Δl_max', lambda rig: (rig.depths - 1, rig.depths)),
    ):
        for rig in rigs:
            near, far = (rig.distance_of_columns(dx) for dx in choose(rig))
            printed = round(1000 * far) - round(1000 * near)
            lines.append(
                _row(
                    f'  2φ = {_degrees(2 * rig.principal_angle)}, {name}',
                    (f'{1000 * (far - near):.2f}', f'{printed}'),
                )
            )
    return lines


def _at_distances(rig: RigNumbers, distances: list[float], allowed: _Allowed) -> list[str]:
    lines = [
        '',
        _row(
            f'one column off at ±{rig.offset:g} px',
            ('too near by', 'too far by', 'share'),
        )
        + f'   {allowed} takes',
    ]
    for distance in distances:
        near, far = rig.errors_at(distance)
        costs = '∞' if math.isnan(far) else f'{far:.3f} m'
        lines.append(
            _row(
                f'  at {distance:g} m',
                (
                    '–' if math.isnan(near) else f'{near:.3f} m',
                    costs,
                    '∞' if math.isnan(far) else f'{far / distance:.1%}',
                ),
            )
            + f'   {_needed(rig, distance, allowed.at(distance))}'
        )
    return lines


def _needed(rig: RigNumbers, distance: float, allowed_error: float) -> str:
    """Say which radius, and which columns, keep an error at a distance."""
    radius = rig.needed_radius(allowed_error, distance)
    offset = rig.needed_offset(allowed_error, distance)
    by_radius = (
        'no radius (it would reach there)'
        if math.isnan(radius)
        else f'r ≥ {math.ceil(1000 * radius - 1e-6)} mm'
    )
    by_offset = (
        f'no column of this lens (±{rig.outermost:g} px)'
        if math.isnan(offset)
        else f'columns ≥ ±{math.ceil(10 * offset - 1e-6) / 10:g} px'
    )
    return f'{by_radius}, or {by_offset}'


def _capture(rig: RigNumbers, arguments: argparse.Namespace) -> list[str]:
    for name, unit in (('speed', '°/s'), ('acceleration', '°/s²')):
        value = getattr(arguments, name)
        if not 0 < value < math.inf:
            raise ValueError(f'{name} is {value:g} {unit}; allowed: finite and above 0')
    motor = Motor(
        speed=math.radians(arguments.speed),
        acceleration=math.radians(arguments.acceleration),
        settle_time=arguments.settle,
    )
    if not 0 < arguments.sweep <= 360:
        raise ValueError(f'sweep is {arguments.sweep:g}°; allowed: above 0°, at most 360°')
    columns = round(arguments.sweep / arguments.step)
    widest = widest_stripe(rig.principal_angle, rig.fov, rig.step)
    turn = round(2 * math.pi / rig.step)
    fitting = [k for k in range(1, widest + 1) if turn % k == 0]  # as the mosaicer wants them
    stripes = arguments.stripe or sorted({1, fitting[-1]})
    for stripe in stripes:
        if not 1 <= stripe <= widest:
            raise ValueError(
                f'stripe is {stripe}; allowed: 1 to {widest} columns, what the image holds '
                f'about ±{rig.offset:g} px'
            )
        if turn % stripe:
            raise ValueError(
                f'stripe is {stripe}; allowed: a divisor of the {turn} columns of a turn, as '
                'the mosaicer wants it'
            )
    lines = [
        '',
        _row(
            f'sweep of {columns} columns (sec. 6.1)',
            ('frames', 'time', 'arm', 'exposure ≤'),
        ),
    ]
    for name, mode in (('stop and go', stop_and_go), ('turning steadily', continuous)):
        for stripe in stripes:
            took = mode(columns, rig.step, motor, arguments.frame_rate, stripe=stripe)
            lines.append(_capture_row(f'  {name}, {stripe} column{"s"[: stripe > 1]}', took))
    if arguments.exposure is not None:
        lines += ['', _safe_speed(arguments.exposure * 1e-3, rig.step)]
    if arguments.motor_steps is not None:
        lines += ['', _motor_steps(arguments.motor_steps, arguments.step)]
    return lines


def _capture_row(label: str, took: Capture) -> str:
    steady = took.arm_speed > 0
    return _row(
        label,
        (
            f'{took.frames}',
            f'{took.duration:.1f} s',
            f'{math.degrees(took.arm_speed):.1f} °/s' if steady else 'stands',
            f'{1000 * took.longest_exposure:.1f} ms' if steady else 'any',
        ),
    )


def _safe_speed(exposure: float, step: float) -> str:
    """Say how fast the arm may turn for an exposure."""
    speed = math.degrees(safe_speed(exposure, step))
    return (
        f'an exposure of {1e3 * exposure:g} ms blurs by half a column at {speed:.1f} °/s, a turn '
        f'of {360 / speed:.1f} s; turn no faster'
    )


def _motor_steps(motor_steps: int, step: float) -> str:
    """Say how well whole motor steps make column steps."""
    if motor_steps < 1:
        raise ValueError(f'motor-steps is {motor_steps}; allowed: at least 1')
    steps = step / 360 * motor_steps
    text = f'a column step is {steps:.3f} motor steps of {360 / motor_steps:.7f}°'
    if math.isclose(steps, round(steps), abs_tol=1e-6):
        return text
    return f'{text}: columns lie up to {180 / motor_steps:.4f}° off'


def _draw(rigs: list[RigNumbers], folder: Path) -> str:
    plots = plotting('export.paper_figures')
    folder.mkdir(parents=True, exist_ok=True)
    curves = [plots.Curve(rig.radius, rig.principal_angle, rig.step) for rig in rigs]
    plots.save_depth_curves(curves, folder / 'figure_4.png')
    plots.save_depth_circles(curves, folder / 'figure_5.png')
    return 'figure_4.png and figure_5.png'
