"""The ``panodepth_ros`` command."""

from __future__ import annotations

import argparse
import importlib
import sys
from importlib.metadata import version

COMMANDS = {
    'analyse': 'Tell what a rig can measure, from its numbers alone.',
    'demo': 'Take a panorama of a simulated room and measure it, without hardware.',
    'figures': 'Draw a recorded sweep as the paper draws its own, and measure it by hand.',
    'ply': 'Write the coloured points of a recorded sweep as a PLY file.',
    'record': 'Record topics into a bag.',
    'replay': 'Publish the messages of a bag.',
    'report': 'Write a sweep as one HTML page, from a bag or a folder of the demo.',
    'watch': 'Show the running sweep on a page in the browser.',
    'calibrate': 'Estimate the camera and its mounting from the bag of a sweep, without a target.',
}
"""Subcommand to its help; each is a module here with ``add_arguments`` and ``run``."""


def main(argv: list[str] | None = None) -> int:
    """
    Run a subcommand.

    Parameters
    ----------
    argv : list of str, optional
        Arguments after the program's name, by default those of the process.

    Returns
    -------
    int
        The exit code: 0 for success and for a stop of what runs until it is stopped, 1 for a
        failure that one sentence on standard error explains, 130 for an interrupted command.
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        return _run(argv)
    except KeyboardInterrupt:
        print(f'\n{" ".join(["panodepth_ros", *argv[:1]])}: interrupted', file=sys.stderr)
        return 130


def _run(argv: list[str]) -> int:
    parser = argparse.ArgumentParser(
        prog='panodepth_ros',
        description='Panoramic depth and laser scans from one camera on a rotating arm. '
        'The nodes are programs of their own: arm_driver, camera, mosaicer, depth, views, '
        'calibrator, check_scan.',
    )
    parser.add_argument(
        '--version', action='version', version=f'panodepth_ros {version("panodepth_ros")}'
    )
    commands = parser.add_subparsers(dest='command', required=True, metavar='command')
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=text)
        if argv[:1] == [name]:  # only its module is loaded: most need ROS and take long
            module = importlib.import_module(f'panodepth_ros.cli.{name}')
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    arguments = parser.parse_args(argv)
    code: int = arguments.run(arguments)
    return code
