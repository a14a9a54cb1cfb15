"""``panodepth_ros ply``: the coloured points of a recorded sweep."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from panodepth_ros.bag import BagError
from panodepth_ros.cli.failure import failed
from panodepth_ros.cli.outputs import check_file
from panodepth_ros.cli.sweeps import add_sweep_arguments, read_pair
from panodepth_ros.export.ply import vertices, write_ply
from panodepth_ros.matching import match, triangulate_match


def _distance(text: str) -> float:
    distance = float(text)
    if not distance > 0:
        raise ValueError
    return distance


# argparse says "invalid … value" with the name of the function that raised.
_distance.__name__ = 'distance (metres, above 0)'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this command's arguments."""
    add_sweep_arguments(parser)
    parser.add_argument(
        '-o', '--output', type=Path, default=Path('points.ply'), help='file (%(default)s)'
    )
    parser.add_argument(
        '--farthest',
        type=_distance,
        default=8.0,
        metavar='M',
        help='points farther from the axis are left out (%(default)s m)',
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the file; return the exit code."""
    try:
        check_file(arguments.output)
        left, right = read_pair(arguments.bag, arguments.namespace)
        matched = match(left, right, method=arguments.method, threads=arguments.threads)
        points = triangulate_match(matched, left.geometry, right.geometry)
        xyz = points.xyz()
        xyz[points.radial_distance > arguments.farthest] = np.nan
        found = vertices(xyz, left.image, matched.confidence, arguments.min_confidence)
        write_ply(arguments.output, found)
    except (BagError, OSError, ValueError) as error:
        return failed('ply', error)
    print(f'{arguments.output}: {found.size} points')
    return 0
