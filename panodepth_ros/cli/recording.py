"""What a bag, or the folder of a demo, holds of one sweep: the material of a report."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panodepth_ros.bag import BagError, read
from panodepth_ros.bag.storage import opened
from panodepth_ros.cli.sweeps import PAIR, bag_of, last_sweep
from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.images import to_array, to_bgr_or_mono
from panodepth_ros.ros.messages import panorama_geometry

_TOPICS = (*PAIR, 'depth/image', 'depth/confidence', 'scan')
_WARNING = re.compile(r'\[(WARN|ERROR|FATAL)\]')
#: From this level on, an entry of /rosout is a warning.
_ROSOUT_WARN = 30


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Recording:
    """
    One sweep and what is known about it.

    Attributes
    ----------
    left, right : ndarray of uint8, shape (H, W) or (H, W, 3)
        Panoramas, grey or BGR.
    geometry : PanoramaGeometry
        Of the left panorama.
    depth, confidence : ndarray of float32, shape (H, W)
        Radial distance [m] and confidence, NaN where unknown.
    scan : LaserScan
        As stored.
    matching_time : float
        From the second panorama to the scan, as the recorder received them [s].
    counts : dict
        Messages of each topic in the bag.
    about : dict
        What the demo wrote into ``scan.json``; empty for a bag.
    film : bytes
        The GIF that the demo made of a steady turn; empty if there is none.
    warnings, log : list of str
        Lines of the nodes' logs; ``warnings`` those of level warning and above.
    """

    left: npt.NDArray[np.uint8]
    right: npt.NDArray[np.uint8]
    geometry: PanoramaGeometry
    depth: npt.NDArray[np.float32]
    confidence: npt.NDArray[np.float32]
    scan: Any
    matching_time: float
    counts: dict[str, int]
    about: dict[str, Any]
    film: bytes
    warnings: list[str]
    log: list[str]


def load(path: Path) -> Recording:
    """
    Read the last complete sweep of a bag, or of the bag in a demo's folder.

    Raises
    ------
    BagError
        If there is no bag, it is damaged, or it holds no complete sweep.
    """
    bag = bag_of(path)
    with opened(bag) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    sweep = last_sweep(bag, _TOPICS, _namespace(bag, counts))
    messages = {topic: message for topic, (_, message) in sweep.items()}
    received = {topic: time for topic, (time, _) in sweep.items()}
    log = _rosout(bag) if '/rosout' in counts else []
    warnings = log.copy()
    about, film = path / 'scan.json', path / 'ground_plan.gif'
    if bag != path:
        for file in sorted((path / 'log').glob('*.log')):
            lines = file.read_text(errors='replace').splitlines()
            log += [f'{file.stem}: {line}' for line in lines]
            warnings += [f'{file.stem}: {line}' for line in lines if _WARNING.search(line)]
    panoramas = max(received['left/image'], received['right/image'])
    try:
        return Recording(
            left=to_bgr_or_mono(messages['left/image']),
            right=to_bgr_or_mono(messages['right/image']),
            geometry=panorama_geometry(messages['left/camera_info']),
            depth=to_array(messages['depth/image']),
            confidence=to_array(messages['depth/confidence']),
            scan=messages['scan'],
            matching_time=(received['scan'] - panoramas) / 1e9,
            counts=counts,
            about=json.loads(about.read_text()) if bag != path and about.is_file() else {},
            film=film.read_bytes() if bag != path and film.is_file() else b'',
            warnings=warnings,
            log=log,
        )
    except ValueError as error:
        raise BagError(f'{path} cannot be reported: {error}') from error


def _namespace(bag: Path, topics: dict[str, int]) -> str:
    """Return what stands before ``depth/image`` in the bag's topics."""
    found = [
        topic.removesuffix('depth/image') for topic in topics if topic.endswith('/depth/image')
    ]
    if len(found) != 1:
        raise BagError(
            f'{bag} has {len(found)} topics that end with /depth/image; allowed: 1, recorded with '
            f'{", ".join(_TOPICS)}'
        )
    return found[0]


def _rosout(bag: Path) -> list[str]:
    """Warnings and errors that the nodes logged."""
    return [
        f'[{"WARN" if message.level == _ROSOUT_WARN else "ERROR"}] {message.name}: {message.msg}'
        for _, _, message in read(bag, ['/rosout'])
        if message.level >= _ROSOUT_WARN
    ]
