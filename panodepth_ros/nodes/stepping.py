"""A node leads a sweep step by step, a frame at each standstill."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger

from panodepth_ros.mosaic import Assembler, Standstill, Sweep
from panodepth_ros.nodes.arm_watch import ArmWatch
from panodepth_ros.nodes.leading import Leader, TurnWatch
from panodepth_ros.nodes.stepping_settings import SteppingParameters
from panodepth_ros.ros.diagnostics import OK, WARN

#: A new driver, or one that a new mosaicer has just found, is asked for nothing so long [s].
DISCOVERY_TIME = 0.5


class StepLeader(Leader):
    """
    Steps the arm on, frame by frame.

    Before the first step the arm turns back its cable, if its driver offers that.

    Parameters
    ----------
    keep : callable
        Called with the arm azimuth [rad] before each step is asked for.
    publish : callable
        Called with sweeps that came to their end.
    """

    kind = Trigger
    service = 'arm_driver/step'

    def __init__(
        self,
        node: Node,
        builder: Assembler,
        settings: Callable[[], SteppingParameters],
        give_up: Callable[[str], None],
        watch: ArmWatch,
        keep: Callable[[float], None],
        publish: Callable[[list[Sweep]], None],
    ) -> None:
        super().__init__(node, builder, settings, give_up, watch)
        self._assembler = builder
        self._keep = keep
        self._publish = publish
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
        return f'sweep of {rig.sweep_columns} columns in {rig.sweep_steps} frames started'

    def advance(self) -> None:
        """See :meth:`Leader.advance`."""
        settings, frames = self._settings(), self._rig.sweep_steps
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
            stripe, step = self._rig.stripe_columns, math.degrees(self._rig.column_step)
            columns = f'{stripe} columns of {step:g}' if stripe > 1 else f'{step:g}'
            moved = math.degrees(standstill.azimuth - self._azimuth)
            self._give_up(
                f'the arm moved {moved:.4f}° on a step; '
                f"allowed: the arm's step_deg must be the {self._node.get_name()}'s {columns}°"
            )
        elif ended := self._assembler.stands_on(standstill):
            self._publish(ended)
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
        if self._steps == 0:
            self.begin()
            return 'the sweep begins anew'
        self.take_up(azimuth)
        return f'the sweep resumes at frame {self._steps} of {self._rig.sweep_steps}'

    def take_up(self, azimuth: float) -> None:
        """Go on with the builder's sweep at an arm azimuth [rad] where the arm stands."""
        self._rig = self._assembler.rig
        rig, sweep = self._rig, self._assembler.sweep
        left = sweep.columns_left(azimuth) if sweep is not None else rig.columns
        self._steps = max(1, rig.sweep_steps - max(0, -(-left // rig.stripe_columns)))
        self._azimuth, self._after, self._back = azimuth, 0, True
        self._ask_from = time.monotonic() + DISCOVERY_TIME
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
            f'frame {self._steps} of {self._rig.sweep_steps}: '
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
        if self._answer is not None or standstill.start <= self._after:
            return True
        # Joint states that waited while this process was held up are of before the step, and the
        # first of them after a silence begins a standstill; the answer may overtake them.
        turned = math.degrees(abs(standstill.azimuth - self._azimuth))
        return not self._back and turned <= self._settings().standstill_tolerance_deg

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
        closes = self._steps > self._rig.sweep_frames
        self._ask(
            self._client,
            Trigger.Request(),
            'the arm refused a step',
            refusal=self._do_without_closing_frame if closes else None,
        )

    def _do_without_closing_frame(self, reason: str) -> None:
        """End the sweep, which has all its columns, with an arm whose cable ends before 360°."""
        self._node.get_logger().warning(f'{reason}; there is no frame at 360°')
        self._publish(self._assembler.finish())
