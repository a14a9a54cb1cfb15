"""``panodepth_ros report``: a sweep as one HTML file that needs nothing else."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from panodepth_ros.bag import BagError
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.outputs import check_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        'recording',
        type=Path,
        help='folder that the demo wrote, or a bag with the panoramas, depth/image, '
        'depth/confidence and scan',
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        default=Path('report.html'),
        help='file to write (%(default)s)',
    )
    parser.add_argument(
        '--band',
        nargs=2,
        type=float,
        metavar=('LOW', 'HIGH'),
        help="height band of the scan [m] (default: the demo's own, else that of the depth node)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the report; return the exit code."""
    try:
        check_file(arguments.output)
        # Both need packages that not everyone has.
        recording = importlib.import_module('panodepth_ros.cli.recording')
        report_page = importlib.import_module('panodepth_ros.cli.report_page')
        found = recording.load(arguments.recording)
        band = tuple(arguments.band) if arguments.band else None
        text = report_page.html(found, name=arguments.recording.resolve().name, band=band)
        arguments.output.write_text(text, encoding='utf-8')
    except (BagError, OSError, ValueError) as error:
        return failed('report', error)
    except ModuleNotFoundError as error:
        missing = (error.name or '').partition('.')[0]
        remedy = {
            'plotly': 'pip install plotly, or "panodepth_ros[report]"',
            'sensor_msgs': 'source your ROS 2 installation, or pip install "panodepth_ros[jazzy]"',
        }.get(missing)
        if remedy is None:
            raise
        return failed('report', f'{missing} is missing; {remedy}')
    print(f'wrote {arguments.output}, {len(text) / 1e6:.1f} MB')
    return 0
