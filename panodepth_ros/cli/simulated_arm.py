"""The ``simulated_arm`` executable: an arm on a pseudo-terminal."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Sequence

from panodepth_ros.arm.simulated_dynamixel import SimulatedServo
from panodepth_ros.arm.simulated_settings import default_settings
from panodepth_ros.arm.terminal import SimulatedArm, TerminalError
from panodepth_ros.arm.truth import TruthError


def _positive(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e9:
        raise argparse.ArgumentTypeError(f'{text} is not a positive number')
    return value


def main(args: Sequence[str] | None = None) -> int:
    """Serve the simulated arm until SIGINT or SIGTERM; return the exit code."""
    parser = argparse.ArgumentParser(
        prog='simulated_arm',
        description='A rotating arm with a GRBL 1.1 controller or a Dynamixel servo on a '
        'pseudo-terminal. Its true motion is in LINK.truth, for the simulated camera.',
    )
    parser.add_argument('--link', required=True, help='path to link the terminal at')
    parser.add_argument(
        '--driver',
        choices=('grbl', 'dynamixel'),
        default='grbl',
        help='what drives it; the options below that concern motion are for grbl',
    )
    parser.add_argument('--steps-per-degree', type=_positive, default=25.0, metavar='N')
    parser.add_argument('--max-rate', type=_positive, default=60.0, metavar='DEG_S')
    parser.add_argument('--acceleration', type=_positive, default=3600.0, metavar='DEG_S2')
    parser.add_argument('--boot-time', type=_positive, default=1.5, metavar='S')
    parser.add_argument(
        '--baud-rate',
        type=_positive,
        default=math.inf,
        metavar='BIT_S',
        help='speed of the serial line; by default bytes take no time',
    )
    parser.add_argument(
        '--homing', action='store_true', help='a home switch at 0° ($22=1): locked until homed'
    )
    parser.add_argument(
        '--index',
        type=float,
        metavar='DEG',
        help='where a mark of 5° begins that a sensor at the probe input sees; by default none',
    )
    parser.add_argument(
        '--no-reset-on-open',
        action='store_true',
        help='the controller runs on when its port is opened, as boards without DTR reset do',
    )
    given = parser.parse_args(args)
    settings = default_settings(
        steps_per_degree=given.steps_per_degree,
        max_rate=given.max_rate,
        acceleration=given.acceleration,
    )
    settings[22] = int(given.homing)
    try:
        if given.driver == 'dynamixel':
            arm = SimulatedArm(
                given.link,
                controller_type=SimulatedServo,
                reset_on_open=False,
                baud_rate=given.baud_rate,
            )
        else:
            arm = SimulatedArm(
                given.link,
                settings=settings,
                index=None if given.index is None else (given.index, 5.0),
                boot_time=given.boot_time,
                reset_on_open=not given.no_reset_on_open,
                baud_rate=given.baud_rate,
            )
    except (TerminalError, TruthError, OSError) as error:
        print(f'simulated_arm: {error}', file=sys.stderr)
        return 1
    with arm:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: arm.stop())
        print(f'simulated arm on {given.link} ({arm.terminal})', flush=True)
        arm.run()
        for number in (signal.SIGINT, signal.SIGTERM):  # `ros2 launch` sends a second one
            signal.signal(number, signal.SIG_IGN)
    return 0


if __name__ == '__main__':
    sys.exit(main())
