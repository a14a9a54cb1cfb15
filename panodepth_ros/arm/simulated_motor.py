"""The simulated arm and what drives it: planned blocks in, pieces of true motion out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence

from panodepth_ros.arm.motion import brake, chain, state_at
from panodepth_ros.arm.simulated_index import IndexMark
from panodepth_ros.arm.truth import CAPACITY, Piece

_NEVER = math.inf


class SimulatedMotor:
    """
    The motor, its planner, and the arm that it turns.

    Parameters
    ----------
    settings : dict
        ``$N`` values of the controller, of which motor steps per degree ($100 for X) and
        acceleration ($120) count; may change at any time.
    axis : int
        Which axis of the controller it is, 0 for X.
    publish : callable
        Called with the pieces of the true motion whenever they change.
    mark : IndexMark or None
        What a sensor sees.

    Attributes
    ----------
    zero : float
        True azimuth at which the count is 0 [rad].
    blocks : deque of (float, float)
        Target [rad] and speed [rad/s] of the moves that are not over.
    watching : bool
        Whether the next motion looks for a change of what the sensor sees.
    contact_at : float
        When that will change [s]; +inf if it will not.
    """

    def __init__(
        self,
        settings: dict[int, float],
        axis: int,
        publish: Callable[[Sequence[Piece]], None],
        mark: IndexMark | None,
    ) -> None:
        self._settings = settings
        self._axis = axis
        self._publish = publish
        self._mark = mark
        self._pieces = [Piece(-math.inf, 0.0)]
        self.zero = 0.0
        self.clear()

    def clear(self) -> None:
        """Forget all blocks, and that the arm moves or looks for a contact."""
        self.blocks: deque[tuple[float, float]] = deque()
        self._block_ends: deque[float] = deque()  # when each block is over, unless braked
        self._motion_end = _NEVER
        self.watching = False
        self.contact_at = _NEVER

    @property
    def end(self) -> float:
        """True azimuth at which the arm stands, or will when its motion is over [rad]."""
        return self._pieces[-1].azimuth

    @property
    def planned(self) -> bool:
        """Whether the arm moves through blocks, and not to brake."""
        return bool(self._block_ends)

    def state(self, now: float) -> tuple[float, float]:
        """True azimuth [rad] and velocity [rad/s]."""
        return state_at(self._pieces, now)

    def steps(self, azimuth: float | None = None) -> int:
        """Count of motor steps at a true azimuth [rad], by default at :attr:`end`."""
        azimuth = self.end if azimuth is None else azimuth
        return round(math.degrees(azimuth - self.zero) * self._settings[100 + self._axis])

    def azimuth_of(self, steps: int) -> float:
        """True azimuth [rad] of a count of motor steps."""
        return self.zero + math.radians(steps / self._settings[100 + self._axis])

    def moving(self, now: float) -> bool:
        """Whether the arm moves."""
        return now < self._motion_end < _NEVER

    def contact(self, now: float) -> bool:
        """Whether the sensor sees its mark."""
        return self._mark is not None and self._mark.active(self.state(now)[0])

    def next_event(self) -> float:
        """When a block, the motion or the way to a contact is over [s]; +inf if nothing is."""
        block_end = self._block_ends[0] if self._block_ends else _NEVER
        return min(block_end, self._motion_end, self.contact_at)

    def end_block(self, now: float) -> bool:
        """Drop the block that is over; return whether the motion is."""
        if self._block_ends and self._block_ends[0] <= now:
            self._block_ends.popleft()
            self.blocks.popleft()
        over = now >= self._motion_end
        if over:
            self._motion_end = _NEVER
        return over

    def plan(self, now: float) -> None:
        """Move through all blocks, from how the arm moves now."""
        azimuth, velocity = self.state(now)
        acceleration = math.radians(self._settings[120 + self._axis])
        pieces, ends = chain(now, azimuth, velocity, self.blocks, acceleration)
        self.follow(pieces)
        self._block_ends.extend(ends)

    def brake(self, now: float) -> None:
        """Come to rest on a motor step."""
        azimuth, velocity = self.state(now)
        grid = math.radians(1.0 / self._settings[100 + self._axis])
        acceleration = math.radians(self._settings[120 + self._axis])
        self.follow(brake(now, azimuth, velocity, acceleration, grid, self.zero))

    def kill(self, now: float) -> None:
        """Stop the pulses at once: the count stays, the arm slips on by its momentum."""
        azimuth, velocity = self.state(now)
        counted = self.azimuth_of(self.steps(azimuth))
        way = velocity * abs(velocity) / (4.0 * math.radians(self._settings[120 + self._axis]))
        self.zero += way
        self._stand(now, counted + way)

    def slip(self, way: float, now: float) -> None:
        """Turn the standing arm by an angle [rad] that is not counted."""
        self.zero += way
        self._stand(now, self.end + way)

    def displace(self, way: float) -> None:
        """Turn the arm, standing or moving, by an angle [rad] that is not counted."""
        self.zero += way
        self.blocks = deque((end + way, speed) for end, speed in self.blocks)
        self._pieces = [piece._replace(azimuth=piece.azimuth + way) for piece in self._pieces]
        self._publish(self._pieces)

    def follow(self, pieces: list[Piece]) -> None:
        """Move along pieces from the first one's begin on."""
        past = [piece for piece in self._pieces if piece.begin < pieces[0].begin]
        self._pieces = (past + pieces)[-CAPACITY:]
        self._motion_end = pieces[-1].begin
        self._block_ends.clear()
        self.contact_at = _NEVER
        if self.watching and self._mark is not None:
            begin = pieces[0].begin
            self.contact_at = self._mark.changes_at(self._pieces, begin, self._motion_end)
        self._publish(self._pieces)

    def _stand(self, now: float, azimuth: float) -> None:
        self.follow([Piece(now, azimuth)])
        self._motion_end = _NEVER
