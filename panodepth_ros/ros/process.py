"""One way to run a node as an operating-system process."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, ClassVar

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import remove_ros_args

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_EMPTY_LIST = 'a parameter is given as [], whose type ROS cannot tell; leave it out instead'


class _Interruption:
    """
    One KeyboardInterrupt for the first signal, none for those that follow.

    Ctrl-C under ``ros2 launch`` reaches a node twice, by the terminal and by the launch process;
    the clean-up must run undisturbed.
    """

    at_once: ClassVar[bool] = False  # whether the process ends on the spot instead

    def __init__(self) -> None:
        self._over = False
        for number in _SIGNALS:
            signal.signal(number, self._handle)  # rclpy's own handlers call it, too

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        if self._over:
            return
        if self.at_once:
            os._exit(0)
        self.end()
        raise KeyboardInterrupt

    def end(self) -> None:
        """Let signals pass without effect from here on, rclpy's handlers included."""
        self._over = True
        for number in _SIGNALS:
            ctypes.pythonapi.PyOS_setsig(number, ctypes.c_void_p(int(signal.SIG_IGN)))

    def forget(self) -> None:
        """
        Let Python know that signals are ignored, which else ends its handlers before the process.

        The system is told first: Python reports a signal with a traceback that comes while it
        exchanges handlers itself.
        """
        self.end()  # rclpy has put the handlers back that it found
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


@contextmanager
def ending_at_once() -> Iterator[None]:
    """
    Let a signal end the process on the spot, with code 0 and without any clean-up.

    For work that nothing can interrupt, such as a compilation, while nothing is open that has to
    be closed.
    """
    _Interruption.at_once = True
    try:
        yield
    finally:
        _Interruption.at_once = False


def _explain(name: str, word: str) -> int:
    """Answer a word that is no ROS argument; return the exit code."""
    usage = f'usage: {name} --ros-args [-p parameter:=value] [--params-file YAML] [-r old:=new]'
    asked = word in ('-h', '--help')
    print(usage if asked else f'{name}: {word!r} is no ROS argument; {usage}', file=sys.stderr)
    return 0 if asked else 2


def run_node(
    name: str,
    make_node: Callable[[], Node],
    args: list[str] | None = None,
    result: Callable[[Any], Any] | None = None,
) -> int:
    """
    Run one node until it is told to stop, or until it has a result.

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
    result : callable, optional
        Gives the node's Future of the exit code, for a node that ends by itself. Interrupted
        before, it ends with code 1.

    Returns
    -------
    int
        The exit code; 2 for words that are no ROS arguments.
    """
    interruption = _Interruption()
    process = _Process(name, make_node, result)
    code = 0 if result is None else 1
    try:
        try:
            code = process.run(args)
        finally:
            interruption.end()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        process.close()
        interruption.forget()
    return code


class _Process:
    """A node, its executor and rclpy's context, as far as they came."""

    def __init__(
        self, name: str, make_node: Callable[[], Node], result: Callable[[Any], Any] | None
    ) -> None:
        self._name = name
        self._make_node = make_node
        self._result = result
        self._executor: SingleThreadedExecutor | None = None
        self._node: Node | None = None

    def run(self, args: list[str] | None) -> int:
        """Start and spin the node; return the exit code."""
        try:
            words = remove_ros_args(args=sys.argv if args is None else [self._name, *args])[1:]
            if words:
                return _explain(self._name, words[0])
            rclpy.init(args=args)
            self._executor = SingleThreadedExecutor()
            self._node = self._make_node()
            self._executor.add_node(self._node)
            if self._result is not None:
                future = self._result(self._node)
                self._executor.spin_until_future_complete(future)
                return int(future.result())
            self._executor.spin()
        except (OSError, RuntimeError, ValueError) as error:
            if self._executor is not None and not rclpy.ok():  # interrupted while starting
                return 0
            empty_list = 'PARAMETER_NOT_SET' in str(error)  # rclpy's word for one
            get_logger(self._name).fatal(_EMPTY_LIST if empty_list else str(error))
            return 1
        return 0

    def close(self) -> None:
        """End what was started."""
        if self._executor is not None:
            self._executor.shutdown()
        if self._node is not None:
            self._node.destroy_node()
        rclpy.try_shutdown()
