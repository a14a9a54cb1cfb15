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
from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.images import to_array, to_bgr_or_mono
from panodepth_ros.ros.messages import panorama_geometry, to_nanoseconds

_PANORAMAS = (
    *('left/image', 'left/camera_info', 'right/image', 'right/camera_info'),
    *('depth/image', 'depth/confidence'),
)
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
    is_demo = (path / 'scan.json').is_file() and (path / 'bag').is_dir()
    bag = path / 'bag' if is_demo else path
    with opened(bag) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    namespace = _namespace(bag, counts)
    names = {f'{namespace}{topic}': topic for topic in (*_PANORAMAS, 'scan')}
    if '/rosout' in counts:
        names['/rosout'] = '/rosout'
    messages, scan, received, log = _last_sweep(bag, names)
    warnings = [line for line in log if _WARNING.search(line)]
    if is_demo:
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
            scan=scan,
            matching_time=(received['scan'] - panoramas) / 1e9,
            counts=counts,
            about=json.loads((path / 'scan.json').read_text()) if is_demo else {},
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
            f'{", ".join((*_PANORAMAS, "scan"))}'
        )
    return found[0]


def _last_sweep(
    bag: Path, names: dict[str, str]
) -> tuple[dict[str, Any], Any, dict[str, int], list[str]]:
    """Return the panoramas' messages, the scan, times of reception, and lines of /rosout."""
    sweeps: dict[int, dict[str, tuple[int, Any]]] = {}
    scans: dict[int, tuple[int, Any]] = {}
    log: list[str] = []
    for full_name, time, message in read(bag, tuple(names)):
        topic = names[full_name]
        if topic == '/rosout':
            level = 'WARN' if message.level == _ROSOUT_WARN else 'ERROR'
            if message.level >= _ROSOUT_WARN:
                log.append(f'[{level}] {message.name}: {message.msg}')
            continue
        stamp = to_nanoseconds(message.header.stamp)
        if topic == 'scan':
            scans.setdefault(stamp, (time, message))
        else:
            sweeps.setdefault(stamp, {})[topic] = (time, message)
    complete = [
        stamp
        for stamp, found in sweeps.items()
        if len(found) == len(_PANORAMAS) and stamp in scans
    ]
    if not complete:
        raise BagError(
            f'{bag} holds no complete sweep: {", ".join(_PANORAMAS)} and scan of one stamp'
        )
    sweep, (time, scan) = sweeps[max(complete)], scans[max(complete)]
    received = {topic: at for topic, (at, _) in sweep.items()} | {'scan': time}
    return {topic: message for topic, (_, message) in sweep.items()}, scan, received, log
