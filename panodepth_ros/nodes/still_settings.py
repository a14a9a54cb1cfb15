"""Parameters that say when a robot stands, for every node that asks."""

from __future__ import annotations

import math
from dataclasses import dataclass

from panodepth_ros.motion.standstill import StillLimits
from panodepth_ros.ros.parameters import parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class StillParameters:
    """What counts as standing."""

    still_distance: float = parameter(
        0.01,
        'Change of position in odom that counts as standing',
        unit='m',
        bounds=(0.0, 1.0),
        live=True,
    )
    still_turn_deg: float = parameter(
        0.3, 'The same for the heading', unit='°', bounds=(0.0, 10.0), live=True
    )
    still_speed: float = parameter(
        0.01,
        'Speed in odom or cmd_vel that counts as standing',
        unit='m/s',
        bounds=(0.0, 1.0),
        live=True,
    )
    still_turn_rate_deg: float = parameter(
        1.0, 'The same for turning', unit='°/s', bounds=(0.0, 90.0), live=True
    )

    def still_limits(self) -> StillLimits:
        """Return what counts as standing."""
        return StillLimits(
            distance=self.still_distance,
            turn=math.radians(self.still_turn_deg),
            speed=self.still_speed,
            turn_rate=math.radians(self.still_turn_rate_deg),
        )
