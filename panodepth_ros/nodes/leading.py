"""
How the mosaicer leads a sweep: step by step, or by letting the arm turn.

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
from std_srvs.srv import SetBool, Trigger

from panodepth_ros.mosaic import Assembler, ContinuousAssembler, Standstill
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.mosaicer_settings import MosaicerParameters
from panodepth_ros.ros.diagnostics import OK, WARN

#: A stamp after all others [ns].
NEVER = 2**63
#: A new driver of the arm is given this time to be found before it is asked for anything [s].
DISCOVERY_TIME = 0.5


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
        settings: Callable[[], MosaicerParameters],
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
    ) -> None:
        """Call a service, and go on by ``then``; a refusal gives the sweep up."""
        self._waiting_since = time.monotonic()
        answer = self._answer = client.call_async(request)

        def done(future: Any) -> None:
            if self._answer is not answer:
                return  # of a sweep that has ended meanwhile
            self._answer = None
            self._waiting_since = time.monotonic()
            result = future.result()
            if not result.success:
                self._give_up(f'{refused}: {result.message}')
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


class StepLeader(Leader):
    """
    Steps the arm on, frame by frame.

    Before the first step the arm turns back its cable, if its driver offers that.

    Parameters
    ----------
    keep : callable
        Called with the arm azimuth [rad] before each step is asked for.
    """

    kind = Trigger
    service = 'arm_driver/step'

    def __init__(
        self,
        node: Node,
        builder: Assembler,
        settings: Callable[[], MosaicerParameters],
        give_up: Callable[[str], None],
        watch: ArmWatch,
        keep: Callable[[float], None],
    ) -> None:
        super().__init__(node, builder, settings, give_up, watch)
        self._assembler = builder
        self._keep = keep
        self._rig = builder.rig
        self._unwind_client = node.create_client(Trigger, 'arm_driver/unwind')
        self._progress = TurnWatch()
        self._steps = 0
        self._azimuth = math.nan
        self._after = 0
        self._ask_from = 0.0  # by time.monotonic() [s]
        self._back = False  # whether the arm stands where it was found after an absence

    def begin(self) -> str:
        """See :meth:`Leader.begin`."""
        self._rig = self._assembler.rig  # a live parameter acts on the next sweep
        self._steps = 0
        self._back = False
        self._after = self._assembler.track.newest or 0
        if self._unwind_client.service_is_ready():
            self._progress = TurnWatch()
            self._ask(
                self._unwind_client,
                Trigger.Request(),
                'the arm refused to unwind its cable',
                self._unwound,
            )
        else:
            self._step(self._assembler.track.position)
        rig = self._rig
        return f'sweep of {rig.sweep_columns} columns in {rig.sweep_frames} frames started'

    def advance(self) -> None:
        """See :meth:`Leader.advance`."""
        settings, frames = self._settings(), self._rig.sweep_frames
        standstill = self._assembler.track.current
        if self._steps == 0:
            self._advance_unwinding(standstill)
        elif standstill is None or self._moving(standstill):
            if self._answer is not None and self._watch.silent:
                if self.waited > settings.frame_timeout:
                    self._complain_of_arm(f'frame {self._steps} of {frames}')
            elif self.waited > settings.step_timeout:
                self._give_up(
                    f'the arm did not take a step and report standing still within '
                    f'{settings.step_timeout:g} s'
                )
        elif not self._back and not self._took_one_stripe(standstill):
            stripe, step = settings.stripe_columns, settings.column_step_deg
            columns = f'{stripe} columns of {step:g}' if stripe > 1 else f'{step:g}'
            moved = math.degrees(standstill.azimuth - self._azimuth)
            self._give_up(
                f'the arm moved {moved:.4f}° on a step; '
                f"allowed: the arm's step_deg must be the mosaicer's {columns}°"
            )
        elif not self._assembler.has_frame_of(standstill):
            if self.waited > settings.frame_timeout:
                self._complain(f'frame {self._steps} of {frames}')
        elif self._steps < frames and time.monotonic() >= self._ask_from:
            self._step(standstill.azimuth)

    def whereabouts(self) -> tuple[float, float]:
        """See :meth:`Leader.whereabouts`: where it stood, and a step beyond."""
        if self._steps == 0:
            return -math.inf, math.inf
        sweep, stripe = self._assembler.sweep, self._rig.stripe_columns * self._rig.column_step
        if sweep is None or not sweep.direction:
            return self._azimuth - stripe, self._azimuth + stripe
        return self._azimuth, self._azimuth + sweep.direction * stripe

    def go_on(self, azimuth: float, *, restarted: bool) -> str:
        """See :meth:`Leader.go_on`: the column where the arm stands is the next one."""
        if not restarted:
            self._waiting_since = time.monotonic()
            return 'the sweep goes on'
        self._answer = None
        self._ask_from = time.monotonic() + DISCOVERY_TIME
        if self._steps == 0:
            self.begin()
            return 'the sweep begins anew'
        self.take_up(azimuth)
        return f'the sweep resumes at frame {self._steps} of {self._rig.sweep_frames}'

    def take_up(self, azimuth: float) -> None:
        """Go on with the builder's sweep at an arm azimuth [rad] where the arm stands."""
        self._rig = self._assembler.rig
        rig, sweep = self._rig, self._assembler.sweep
        left = sweep.columns_left(azimuth) if sweep is not None else rig.sweep_columns - 1
        self._steps = max(1, rig.sweep_frames - max(0, -(-left // rig.stripe_columns)))
        self._azimuth, self._after, self._back = azimuth, 0, True
        self._waiting_since = time.monotonic()

    def waits_for(self) -> tuple[bytes, str]:
        """See :meth:`Leader.waits_for`."""
        settings, standstill = self._settings(), self._assembler.track.current
        if self._steps == 0:
            return OK, f'waiting for the arm to unwind its cable for {self.waited:.1f} s'
        moving = standstill is None or self._moving(standstill)
        patience = settings.step_timeout if moving else settings.frame_timeout
        return (
            WARN if self.waited > patience else OK,
            f'frame {self._steps} of {self._rig.sweep_frames}: '
            f'waiting for {"the arm" if moving else "a frame"} for {self.waited:.1f} s',
        )

    def _unwound(self) -> None:
        """Take no joint state from before the answer for where the arm stands now."""
        self._after = self._assembler.track.newest or 0

    def _advance_unwinding(self, standstill: Standstill | None) -> None:
        """Take the first step as soon as the arm is seen to stand with its cable unwound."""
        track, timeout = self._assembler.track, self._settings().step_timeout
        if self._progress.see(track.position, self._rig.column_step):
            self._waiting_since = time.monotonic()
        if self._answer is None and standstill is not None and standstill.end > self._after:
            self._step(standstill.azimuth)
        elif self.waited > timeout:
            self._give_up(
                f'the arm did not unwind its cable: for {timeout:g} s it neither turned nor '
                'reported standing still'
            )

    def _moving(self, standstill: Standstill) -> bool:
        """Whether the arm still has to answer, or to be seen standing after its step."""
        return self._answer is not None or standstill.start <= self._after

    def _took_one_stripe(self, standstill: Standstill) -> bool:
        rig = self._assembler.rig
        columns = abs(standstill.azimuth - self._azimuth) / rig.column_step
        return abs(columns - rig.stripe_columns) < 0.5

    def _step(self, azimuth: float) -> None:
        """Ask for a step from an arm azimuth [rad]."""
        self._steps += 1
        self._back = False
        self._azimuth = azimuth
        self._after = self._assembler.track.newest or 0
        self._keep(azimuth)
        self._ask(self._client, Trigger.Request(), 'the arm refused a step')


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
        settings: Callable[[], MosaicerParameters],
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
