"""
How a node leads a sweep: what stepping and steady turning share.

A leader asks the arm's services and watches that what it asked for comes about; the frames go
their own way, through the assembler.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.node import Node

from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.stepping_settings import SteppingParameters


class Leader(ABC):
    """
    Leads one sweep after the other, each from :meth:`begin` to :meth:`end`.

    Parameters
    ----------
    node : rclpy.node.Node
        Owns the client and logs.
    builder : SweepBuilder
        Knows the arm and the frames.
    settings : callable
        The parameters in force.
    give_up : callable
        Called with a sentence when a sweep cannot go on.
    watch : ArmWatch
        Whether the arm is out of sight.
    """

    kind: type
    service: str

    def __init__(
        self,
        node: Node,
        builder: SweepBuilder[Any],
        settings: Callable[[], SteppingParameters],
        give_up: Callable[[str], None],
        watch: ArmWatch,
    ) -> None:
        self._node = node
        self._builder = builder
        self._settings = settings
        self._give_up = give_up
        self._watch = watch
        self._client = node.create_client(self.kind, self.service)
        self._waiting_since = 0.0
        self._answer: Any = None

    @property
    def missing_service(self) -> str:
        """Name of the service that is not there, empty if it is."""
        return '' if self._client.service_is_ready() else str(self._client.srv_name)

    @property
    def waited(self) -> float:
        """How long the leader has waited for what comes next [s]."""
        return time.monotonic() - self._waiting_since

    @abstractmethod
    def begin(self) -> str:
        """Begin a sweep and describe it."""

    @abstractmethod
    def whereabouts(self) -> tuple[float, float]:
        """Between which azimuths an arm that was out of sight can have gone by itself [rad]."""

    @abstractmethod
    def go_on(self, azimuth: float, *, restarted: bool) -> str:
        """
        Go on after the arm was out of sight.

        Parameters
        ----------
        azimuth : float
            Where it stands now [rad].
        restarted : bool
            Whether its driver, who knows nothing of what he was asked for, is a new one.

        Returns
        -------
        str
            What comes of the sweep, in words.
        """

    @abstractmethod
    def advance(self) -> None:
        """Take the sweep as far as what has arrived allows."""

    @abstractmethod
    def waits_for(self) -> tuple[bytes, str]:
        """Diagnostic level, and in words what the sweep does or waits for."""

    def end(self) -> None:
        """Let the arm be: the sweep is finished or given up."""
        self._answer = None

    def _ask(
        self,
        client: Client,
        request: Any,
        refused: str,
        then: Callable[[], None] | None = None,
        refusal: Callable[[str], None] | None = None,
    ) -> None:
        """Call a service, and go on by ``then``; ``refusal``, by default, gives the sweep up."""
        self._waiting_since = time.monotonic()
        answer = self._answer = client.call_async(request)

        def done(future: Any) -> None:
            if self._answer is not answer:
                return  # of a sweep that has ended meanwhile
            self._answer = None
            self._waiting_since = time.monotonic()
            result = future.result()
            if not result.success:
                (refusal or self._give_up)(f'{refused}: {result.message}')
                return
            if then is not None:
                then()
            self.advance()

        answer.add_done_callback(done)

    def _complain(self, what: str) -> None:
        drops = self._builder.drops.most_common(1)
        most = f'; most frequent: {drops[0][1]} × {drops[0][0]}' if drops else ''
        self._node.get_logger().error(
            f'no frame for {self.waited:.1f} s: the sweep waits at {what}{most}',
            throttle_duration_sec=self._settings().frame_timeout,
        )

    def _complain_of_arm(self, what: str) -> None:
        self._node.get_logger().error(
            f'no joint state and no answer of the arm for {self.waited:.1f} s: the sweep waits at '
            f'{what} for its driver',
            throttle_duration_sec=self._settings().frame_timeout,
        )


class TurnWatch:
    """Tells whether an arm turns on, by its azimuth; an encoder that trembles is no turn."""

    def __init__(self) -> None:
        self._azimuth = math.nan

    def see(self, azimuth: float, least: float) -> bool:
        """Take an azimuth [rad]; return whether it is new by at least so much [rad]."""
        turned = not abs(azimuth - self._azimuth) < least
        if turned:
            self._azimuth = azimuth
        return turned
