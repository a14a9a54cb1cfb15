"""What becomes of a sweep whose arm or mosaicer was away; docs/reliability.md has the rules."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from panodepth_ros.mosaic import Assembler, Sweep
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.mosaic.continuity import doubt
from panodepth_ros.mosaic.rig import REACH_BEYOND
from panodepth_ros.mosaic.state import State
from panodepth_ros.nodes.arm_watch import Absence, ArmWatch
from panodepth_ros.nodes.keeping import SweepKeeper
from panodepth_ros.nodes.leading import Leader
from panodepth_ros.nodes.stepping import StepLeader

#: How long a mosaicer that was restarted sees the arm standing before it takes a sweep up [ns].
_SEEN_STANDING = 500_000_000
#: How long it waits for somebody who hears the panoramas: without, their sweep would be lost [s].
_PATIENCE = 5.0


class Comeback:
    """
    Lets a sweep go on, begin anew or be given up.

    Parameters
    ----------
    node : rclpy.node.Node
        Logs.
    builder : SweepBuilder
        Has the sweep under way.
    leader : Leader
        Leads it, if one is led.
    watch : ArmWatch
        Tells when the arm was away.
    keeper : SweepKeeper
        Has the sweep of a mosaicer that was killed.
    heard : callable
        Whether somebody subscribes to the panoramas.
    begin : callable
        Begins a led sweep of what comes after a joint state [ns].
    give_up : callable
        Gives the sweep up, for a reason in words.
    """

    def __init__(
        self,
        node: Node,
        builder: SweepBuilder[Any],
        leader: Leader,
        watch: ArmWatch,
        keeper: SweepKeeper,
        heard: Callable[[], bool],
        begin: Callable[[int], str],
        give_up: Callable[[str], None],
    ) -> None:
        self._node = node
        self._builder = builder
        self._leader = leader
        self._watch = watch
        self._keeper = keeper
        self._heard = heard
        self._patience_until = time.monotonic() + _PATIENCE
        self._begin = begin
        self._give_up = give_up
        self._absence: Absence | None = None

    def see(self, stamp: int, azimuth: float, velocity: float | None, *, leading: bool) -> None:
        """Look at a joint state: an arm that was away is judged as soon as it stands."""
        if (absence := self._watch.see(stamp)) is not None:
            known = self._absence is not None and self._absence.restarted
            self._absence = Absence(absence.seconds, absence.restarted or known)
        if self._absence is not None and not velocity:
            absence, self._absence = self._absence, None
            self._of_arm(azimuth, absence, leading=leading)

    def _of_arm(self, azimuth: float, absence: Absence, *, leading: bool) -> None:
        """Go on, or not, with an arm that stands somewhere after it was out of sight."""
        builder, sweep = self._builder, self._builder.sweep
        if leading:
            between = self._leader.whereabouts()
        elif isinstance(builder, Assembler) and sweep is not None:
            step = sweep.rig.stripe_columns * sweep.rig.column_step
            ahead = sweep.last_azimuth + sweep.direction * step
            between = (sweep.last_azimuth - (0.0 if sweep.direction else step), ahead)
        else:
            return
        fault = self._doubt(azimuth, between, restarted=absence.restarted)
        if fault:
            self._give_up(f'after {absence.seconds:.1f} s {fault}; see to the arm, home it')
        elif leading:
            what = self._leader.go_on(azimuth, restarted=absence.restarted)
            who = 'by a new driver ' if absence.restarted else ''
            self._node.get_logger().warning(
                f'the arm is heard of again {who}after {absence.seconds:.1f} s, at '
                f'{math.degrees(azimuth):.2f}°: {what}'
            )

    def of_mosaicer(self) -> bool:
        """
        Go on with the sweep of a mosaicer that was killed, as soon as the arm was seen to stand.

        Returns
        -------
        bool
            Whether that sweep is led from now on.
        """
        builder, newest = self._builder, self._builder.track.newest
        if newest is None or builder.camera is None or not self._ready():
            return False
        state = self._keeper.find(builder.rig, builder.camera)
        if state is None:
            return False
        azimuth, log = builder.track.position, self._node.get_logger()
        try:
            sweep = state.sweep(builder.rig, builder.camera)
        except ValueError as error:
            log.warning(f'the sweep under way is not taken up: {error}; it begins anew')
            self._begin(newest)
            return False
        sources = {gid.hex() for gid in self._watch.sources()}
        fault = self._doubt(
            azimuth,
            self._place_of(state, sweep),
            restarted=not sources <= set(state.sources),
        )
        if fault:
            self._give_up(f'the mosaicer was restarted and {fault}; see to the arm, home it')
            return False
        if sweep is None or not isinstance(builder, Assembler):
            log.warning('the mosaicer was restarted: the sweep under way begins anew')
            self._leader.end()
            self._begin(newest)
            return False
        assert isinstance(self._leader, StepLeader)
        builder.take_up(sweep)
        self._leader.take_up(azimuth)
        log.warning(
            f'the mosaicer was restarted: the sweep under way goes on at '
            f'{math.degrees(azimuth):.2f}° with '
            f'{sweep.seen.sum()} columns'
        )
        return True

    def _ready(self) -> bool:
        """Whether the panoramas are heard, or will not be, and the arm was seen to stand."""
        if not self._heard() and time.monotonic() < self._patience_until:
            return False
        if not isinstance(self._builder, Assembler):
            return True
        standstill = self._builder.track.current
        return standstill is not None and standstill.end - standstill.start >= _SEEN_STANDING

    def _place_of(self, state: State, sweep: Sweep | None) -> tuple[float, float]:
        """Between which azimuths the arm of a state can have gone meanwhile [rad]."""
        if sweep is None:
            return -math.inf, math.inf
        step = sweep.rig.stripe_columns * sweep.rig.column_step
        behind = 0.0 if sweep.direction else step
        return state.azimuth - behind, state.azimuth + (sweep.direction or 1) * step

    def _doubt(self, azimuth: float, between: tuple[float, float], *, restarted: bool) -> str:
        tolerance = REACH_BEYOND * self._builder.rig.column_step
        return doubt(azimuth, between, tolerance, restarted=restarted)
