"""The mosaicer leads a sweep by letting the arm turn steadily."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import SetBool

from panodepth_ros.mosaic import ContinuousAssembler
from panodepth_ros.mosaic.builder import NEVER
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.leading import Leader, TurnWatch
from panodepth_ros.nodes.stepping_settings import SteppingParameters
from panodepth_ros.ros.diagnostics import OK, WARN


class SpinLeader(Leader):
    """
    Lets the arm turn until a sweep is done, or for good.

    An arm that is still braking after the last sweep is awaited; it is told to turn when it has
    answered that it stands.
    """

    kind = SetBool
    service = 'arm_driver/spin'

    def __init__(
        self,
        node: Node,
        builder: ContinuousAssembler,
        settings: Callable[[], SteppingParameters],
        give_up: Callable[[str], None],
        watch: ArmWatch,
    ) -> None:
        super().__init__(node, builder, settings, give_up, watch)
        self._seen = 0
        self._braking: Any = None  # the answer to the last stop, while it is awaited
        self._asked = False
        self._turn = TurnWatch()
        self._newest = 0
        self._fresh_since = self._turned_at = 0.0

    def begin(self) -> str:
        """See :meth:`Leader.begin`."""
        self._seen = 0
        self._asked = False
        self._waiting_since = time.monotonic()
        self._ask_to_turn()
        rig = self._builder.rig
        return f'sweep of {rig.sweep_columns} columns started, the arm turns steadily'

    def advance(self) -> None:
        """See :meth:`Leader.advance`."""
        settings, seen = self._settings(), self._columns_seen()
        if not self._asked:
            self._ask_to_turn()
            if not self._asked and self.waited > settings.step_timeout:
                # Its end tells the arm once more to stop.
                self._give_up(
                    f'the arm did not stop after the last sweep within {settings.step_timeout:g} s'
                )
        elif self._answer is not None:
            if self.waited > settings.step_timeout:
                self._give_up(f'the arm did not begin to turn within {settings.step_timeout:g} s')
        elif self._stands():
            self._give_up(
                f'the arm stopped turning: its joint states have stayed at '
                f'{math.degrees(self._builder.track.position):.2f}° for '
                f'{settings.step_timeout:g} s'
            )
        elif seen != self._seen:
            self._seen = seen
            self._waiting_since = time.monotonic()
        elif self.waited > settings.frame_timeout:
            self._complain(f'column {seen} of {self._builder.rig.sweep_columns}')

    def waits_for(self) -> tuple[bytes, str]:
        """See :meth:`Leader.waits_for`."""
        settings = self._settings()
        on_arm = self._answer is not None or not self._asked
        patience = settings.step_timeout if on_arm else settings.frame_timeout
        what = 'the arm' if self._asked else 'the arm to stop'
        return (
            WARN if self.waited > patience else OK,
            f'column {self._columns_seen()} of {self._builder.rig.sweep_columns}: '
            f'waiting for {what if on_arm else "a frame"} for {self.waited:.1f} s',
        )

    def whereabouts(self) -> tuple[float, float]:
        """See :meth:`Leader.whereabouts`: anywhere, for the arm may turn on."""
        return -math.inf, math.inf

    def go_on(self, azimuth: float, *, restarted: bool) -> str:
        """See :meth:`Leader.go_on`: a new driver has to be told to turn."""
        if not restarted:
            return 'the sweep goes on'
        self._answer = self._braking = None
        self.begin()
        return 'the sweep begins anew'

    def end(self) -> None:
        """See :meth:`Leader.end`; stops the arm and takes no frame of it any more."""
        super().end()
        self._builder.restart(NEVER)
        log = self._node.get_logger()
        if self.missing_service:
            log.error(
                f'the arm could not be told to stop: the service {self.missing_service} is not '
                'there; it may still turn'
            )
            return
        answer = self._braking = self._client.call_async(SetBool.Request(data=False))

        def stopped(future: Any) -> None:
            if self._braking is answer:
                self._braking = None
            result = future.result()
            if not result.success:
                log.error(f'the arm refused to stop: {result.message}; it may still turn')

        answer.add_done_callback(stopped)

    def _ask_to_turn(self) -> None:
        """Let the arm turn, unless it still brakes."""
        newest = self._builder.track.newest or 0
        if self._braking is not None:
            self._builder.restart(NEVER)
            return
        self._asked = True
        self._builder.restart(newest + 1)
        self._turn = TurnWatch()
        self._newest = 0
        self._ask(
            self._client, SetBool.Request(data=True), 'the arm refused to turn', self._watch_turn
        )

    def _watch_turn(self) -> None:
        """Count from now on how long the arm stands."""
        self._newest = self._builder.track.newest or 0
        self._fresh_since = self._turned_at = time.monotonic()

    def _stands(self) -> bool:
        """Whether fresh joint states have told one azimuth for the time of a step."""
        track, settings, now = self._builder.track, self._settings(), time.monotonic()
        if track.newest is None or track.newest == self._newest:
            if now - self._fresh_since > settings.joint_state_gap:
                self._turned_at = now  # silent joint states tell nothing
            return False
        self._newest, self._fresh_since = track.newest, now
        if self._turn.see(track.position, self._builder.rig.column_step):
            self._turned_at = now
        return now - self._turned_at > settings.step_timeout

    def _columns_seen(self) -> int:
        return int(self._builder.sweep.seen.sum()) if self._builder.sweep is not None else 0
