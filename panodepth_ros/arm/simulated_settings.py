"""What a simulated GRBL controller keeps: stored settings, and the modes of its G-code parser."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


def default_settings(
    *,
    steps_per_degree: float = 25.0,
    max_rate: float = 60.0,
    acceleration: float = 3600.0,
    axes: int = 3,
) -> dict[int, float]:
    """
    The stored settings ``$N``.

    Parameters
    ----------
    steps_per_degree : float
        Motor steps per degree; 25 are 9000 per turn.
    max_rate : float
        Largest speed [°/s].
    acceleration : float
        Acceleration [°/s²]; with 3600 a step of 0.2° takes 15 ms.
    axes : int
        How many the controller has.
    """
    settings: dict[int, float] = {0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1}
    settings |= {11: 0.01, 12: 0.002, 13: 0, 20: 0, 21: 0, 22: 0, 23: 0, 24: 300.0}
    settings |= {25: 1800.0, 26: 250, 27: 1.0, 30: 1000, 31: 0, 32: 0}
    for axis in range(axes):
        settings |= {100 + axis: steps_per_degree, 110 + axis: 60.0 * max_rate}
        settings |= {120 + axis: acceleration, 130 + axis: 360.0}
    return settings


@dataclass
class Modes:
    """What the G-code parser remembers between lines, and a reset forgets."""

    motion: int = 0
    inches: bool = False
    relative: bool = False
    feed: np.float32 = field(default_factory=lambda: np.float32(0.0))
    position: np.float32 = field(default_factory=lambda: np.float32(0.0))
