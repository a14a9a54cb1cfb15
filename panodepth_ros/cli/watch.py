"""``panodepth_ros watch``: the running sweep on a page in the browser."""

from __future__ import annotations

import argparse
import importlib
from typing import Any

from panodepth_ros.cli.bags import ROS_MISSING
from panodepth_ros.cli.failure import failed


def _port(text: str) -> int:
    port = int(text)
    if not 0 <= port <= 65535:
        raise ValueError
    return port


# argparse says "invalid … value" with the name of the function that raised.
_port.__name__ = 'port (0 to 65535)'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        '--host',
        default='127.0.0.1',
        help='address to listen on (%(default)s); 0.0.0.0 lets every machine in the network look',
    )
    parser.add_argument('--port', type=_port, default=8360, help='port (%(default)s); 0 for any')
    parser.add_argument(
        '--ros-args', nargs=argparse.REMAINDER, help='ROS arguments, such as -r __ns:=/robot'
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; return the exit code."""
    try:
        process = importlib.import_module('panodepth_ros.ros.process')
    except ModuleNotFoundError as error:
        if error.name != 'rclpy':
            raise
        return failed('watch', ROS_MISSING)

    def make() -> Any:
        watcher = importlib.import_module('panodepth_ros.nodes.watcher').Watcher()
        server = importlib.import_module('panodepth_ros.cli.watch_server').WatchServer
        serving = server(watcher, arguments.host, arguments.port)
        watcher.at_the_end(serving.close)
        print(f'look at {serving.url}', flush=True)
        return watcher

    words = ['--ros-args', *arguments.ros_args] if arguments.ros_args else []
    code: int = process.run_node('watch', make, words)
    return code
