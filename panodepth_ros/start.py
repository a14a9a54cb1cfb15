"""
Entry points of the nodes and the simulated arm: how to end is settled before the long imports.

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
    code: int = importlib.import_module(f'panodepth_ros.{name}').main()
    return code


def arm_driver() -> int:
    """Run the arm driver."""
    return _start('nodes.arm_driver')


def camera() -> int:
    """Run the camera."""
    return _start('nodes.camera')


def mosaicer() -> int:
    """Run the mosaicer."""
    return _start('nodes.mosaicer')


def depth() -> int:
    """Run the depth node."""
    return _start('nodes.depth')


def calibrator() -> int:
    """Run the calibrator."""
    return _start('nodes.calibrator')


def views() -> int:
    """Run the pinhole views."""
    return _start('nodes.views')


def check_scan() -> int:
    """Run the check of a scan."""
    return _start('nodes.check_scan')


def simulated_arm() -> int:
    """Run the simulated arm."""
    return _start('cli.simulated_arm')
