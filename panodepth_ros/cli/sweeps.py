"""What the commands that work on a recorded sweep share: its panoramas, out of a bag."""

from __future__ import annotations

import argparse
from collections.abc import Collection
from pathlib import Path
from typing import Any

from panodepth_ros.bag import BagError, read
from panodepth_ros.geometry import Panorama, check_pair
from panodepth_ros.matching import METHODS
from panodepth_ros.ros.images import to_bgr_or_mono
from panodepth_ros.ros.messages import panorama_geometry, to_nanoseconds

#: Topics of a pair.
PAIR = ('left/image', 'left/camera_info', 'right/image', 'right/camera_info')
#: Type by the last part of a topic's name; images else.
_TYPES = {'camera_info': 'sensor_msgs/msg/CameraInfo', 'scan': 'sensor_msgs/msg/LaserScan'}


def share(text: str) -> float:
    """Read a number from 0 to 1 for argparse."""
    value = float(text)
    if not 0 <= value <= 1:
        raise ValueError
    return value


share.__name__ = 'share (0 to 1)'


def add_sweep_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that say which sweep, and how it is matched."""
    parser.add_argument(
        'bag', type=Path, help="bag with panoramas (folder or file), or the demo's output folder"
    )
    parser.add_argument(
        '--namespace', default='', metavar='NAME', help='namespace of left/image and the others'
    )
    parser.add_argument(
        '--method', choices=METHODS, default=METHODS[0], help='matching (%(default)s)'
    )
    parser.add_argument(
        '--min-confidence',
        type=share,
        default=0.3,
        metavar='C',
        help='pixels of less confidence are left out (%(default)s)',
    )
    parser.add_argument('--threads', type=int, default=1, metavar='N', help='(%(default)s)')


def bag_of(path: Path) -> Path:
    """Return the bag in the folder of a demo; any other path is the bag."""
    return path / 'bag' if (path / 'bag' / 'metadata.yaml').is_file() else path


def last_sweep(
    bag: Path, topics: Collection[str], namespace: str = ''
) -> dict[str, tuple[int, Any]]:
    """
    Read the last messages of one stamp.

    Parameters
    ----------
    bag : Path
        The bag.
    topics : collection of str
        Topics of which there must be a message of that stamp.
    namespace : str
        Of these topics.

    Returns
    -------
    dict
        Topic, as given, to the time of reception [ns] and the message.

    Raises
    ------
    BagError
        If the bag cannot be read or holds no such messages.
    """
    prefix = f'/{namespace.strip("/")}' if namespace.strip('/') else ''
    names = {f'{prefix}/{topic}': topic for topic in topics}
    incomplete: dict[int, dict[str, tuple[int, Any]]] = {}
    sweep: dict[str, tuple[int, Any]] | None = None
    types = {name: _TYPES.get(name.rpartition('/')[2], 'sensor_msgs/msg/Image') for name in names}
    for topic, received, message in read(bag, types):
        stamp = to_nanoseconds(message.header.stamp)
        messages = incomplete.setdefault(stamp, {})
        messages[names[topic]] = (received, message)
        if len(messages) == len(names):
            sweep = incomplete.pop(stamp)
    if sweep is None:
        raise BagError(f'bag {bag} holds no complete sweep: no {", ".join(names)} of one stamp')
    return sweep


def read_pair(path: Path, namespace: str = '') -> tuple[Panorama, Panorama]:
    """
    Read the last sweep of a bag.

    Parameters
    ----------
    path : Path
        Bag, or a folder with a bag of the name ``bag``.
    namespace : str
        Of the topics left/image, left/camera_info and those of the right eye.

    Returns
    -------
    (Panorama, Panorama)
        Left and right eye, of one stamp.

    Raises
    ------
    BagError
        If the bag cannot be read or holds no complete pair.
    ValueError
        If the messages are no pair of panoramas.
    """
    found = last_sweep(bag_of(path), PAIR, namespace)
    left, right = (
        Panorama(
            to_bgr_or_mono(found[f'{eye}/image'][1]),
            panorama_geometry(found[f'{eye}/camera_info'][1]),
        )
        for eye in ('left', 'right')
    )
    check_pair(left.geometry, right.geometry)
    return left, right
