"""``panodepth_ros record``: topics into a bag."""

from __future__ import annotations

import argparse
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

from panodepth_ros.bag import STORAGES
from panodepth_ros.cli.bags import run_until_stopped


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument(
        'topics',
        nargs='*',
        default=[],
        help='topics, also such that appear later',
        metavar='topic',
    )
    which.add_argument(
        '-a',
        '--all',
        action='store_true',
        help='every topic but hidden ones, /rosout and /parameter_events',
    )
    parser.add_argument(
        '-o',
        '--output',
        type=Path,
        help='folder to make; by default bag_ and the time of day',
    )
    parser.add_argument('-s', '--storage', choices=STORAGES, default=STORAGES[0])


def run(arguments: argparse.Namespace) -> int:
    """Record until SIGINT or SIGTERM; return the exit code."""
    path = arguments.output or Path(f'bag_{datetime.now():%Y_%m_%d-%H_%M_%S}')

    def work(recorder: Any, stop: threading.Event) -> str:
        count = recorder.record(path, arguments.topics, stop=stop, storage=arguments.storage)
        return f'{path}: {count} messages'

    return run_until_stopped('record', 'recorder', work)
