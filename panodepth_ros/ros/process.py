"""One way to run a node as an operating-system process."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    _ignore_signals()
    raise KeyboardInterrupt


def _ignore_signals() -> None:
    """
    Let the clean-up run undisturbed.

    Ctrl-C under ``ros2 launch`` reaches a node twice, by the terminal and by the launch process.
    """
    for number in _SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _explain(name: str, word: str) -> int:
    """Answer a word that is no ROS argument; return the exit code."""
    usage = f'usage: {name} --ros-args [-p parameter:=value] [--params-file YAML] [-r old:=new]'
    asked = word in ('-h', '--help')
    print(usage if asked else f'{name}: {word!r} is no ROS argument; {usage}', file=sys.stderr)
    return 0 if asked else 2


def run_node(name: str, make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """
    Run one node until it is told to stop.

    SIGINT and SIGTERM end the process with code 0 after ``destroy_node`` has closed what the
    node holds. A node that cannot start (a bad parameter, a device that is not there) logs one
    FATAL sentence and the code is 1.

    Parameters
    ----------
    name : str
        Name of the logger that reports a failed start.
    make_node : callable
        Makes the node. Raises OSError, RuntimeError or ValueError with a sentence for the user.
    args : list of str, optional
        Command line, by default that of the process.

    Returns
    -------
    int
        The exit code; 2 for words that are no ROS arguments.
    """
    node: Node | None = None
    executor: SingleThreadedExecutor | None = None
    try:
        for number in _SIGNALS:
            signal.signal(number, _interrupt)  # rclpy's own handlers call it, too
        words = remove_ros_args(args=sys.argv if args is None else [name, *args])[1:]
        if words:
            return _explain(name, words[0])
        rclpy.init(args=args)
        executor = SingleThreadedExecutor()
        node = make_node()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except (OSError, RuntimeError, ValueError) as error:
        if executor is not None and not rclpy.ok():  # interrupted while starting or stopping
            return 0
        get_logger(name).fatal(str(error))
        return 1
    finally:
        _ignore_signals()
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        _ignore_signals()  # rclpy has put the handlers back that it found
    return 0
