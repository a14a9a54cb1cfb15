"""
Entry points of the nodes: how to end is settled before the long imports begin.

Importing a node takes up to a second. A signal in that time would else end the process with a
traceback; nothing is open yet, so it may simply go. ``ros.process`` takes over from there.
"""

from __future__ import annotations

import importlib
import os
import signal


def _start(name: str) -> int:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    code: int = importlib.import_module(f'panodepth_ros.nodes.{name}').main()
    return code


def arm_driver() -> int:
    """Run the arm driver."""
    return _start('arm_driver')


def camera() -> int:
    """Run the camera."""
    return _start('camera')


def mosaicer() -> int:
    """Run the mosaicer."""
    return _start('mosaicer')


def depth() -> int:
    """Run the depth node."""
    return _start('depth')


def calibrator() -> int:
    """Run the calibrator."""
    return _start('calibrator')


def views() -> int:
    """Run the pinhole views."""
    return _start('views')
