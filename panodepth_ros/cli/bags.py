"""What ``record`` and ``replay`` share."""

from __future__ import annotations

import importlib
import signal
import threading
from collections.abc import Callable
from typing import Any

from panodepth_ros.bag import BagError
from panodepth_ros.cli.failure import failed

ROS_MISSING = (
    'ROS 2 is missing (rclpy cannot be imported); source your installation, or '
    'pip install "panodepth_ros[jazzy]" or "[kilted]"'
)


def run_until_stopped(
    command: str, module: str, work: Callable[[Any, threading.Event], str]
) -> int:
    """
    Do work that SIGINT and SIGTERM stop; say how it ended.

    Parameters
    ----------
    command : str
        The subcommand.
    module : str
        Module of :mod:`panodepth_ros.bag` that the work needs; it needs ROS.
    work : callable
        Takes the module and the event that the signals set; returns a sentence to print.

    Returns
    -------
    int
        0, or 1 if the work failed; then one sentence on standard error says why.
    """
    stop = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    handlers = [signal.signal(number, lambda *_: stop.set()) for number in numbers]
    try:
        print(work(importlib.import_module(f'panodepth_ros.bag.{module}'), stop), flush=True)
    except BagError as error:
        return failed(command, error)
    except ModuleNotFoundError as error:
        if error.name != 'rclpy':
            raise
        return failed(command, ROS_MISSING)
    finally:
        for number, handler in zip(numbers, handlers, strict=True):
            signal.signal(number, handler)
    return 0
