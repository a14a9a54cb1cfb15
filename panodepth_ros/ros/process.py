"""One way to run a node as an operating-system process."""

from __future__ import annotations

from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node


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
        The exit code.
    """
    try:
        rclpy.init(args=args)
    except Exception as error:  # rclpy raises bare RCLError subclasses of RuntimeError
        get_logger(name).fatal(str(error))
        return 1
    node: Node | None = None
    executor = SingleThreadedExecutor()
    try:
        node = make_node()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except (OSError, RuntimeError, ValueError) as error:
        if not rclpy.ok():  # interrupted while starting or stopping
            return 0
        get_logger(name).fatal(str(error))
        return 1
    finally:
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
