"""What the mosaicer says of the light in a sweep."""

from __future__ import annotations

import math

import numpy as np
from rclpy.node import Node

from panodepth_ros.mosaic import Sweep


class LightReport:
    """
    Tells of one sweep after the other what changed in it.

    Attributes
    ----------
    told : str
        Of the last sweep, for diagnostics.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.told = 'no sweep yet'

    def tell(self, sweep: Sweep) -> None:
        """Log what changed in a finished sweep, and keep it."""
        if sweep.light is None:
            self.told = 'not looked at'
            return
        gains, places = sweep.light_steps()
        steps = int(np.any(np.diff(gains, axis=0) != 0.0, axis=1).sum())
        changes = ', '.join(f'{math.degrees(at):.1f}°' for at, _, _ in places)
        said = []
        if steps:
            said.append(
                f'the light changed {steps} times, to between {gains.min():.0%} and '
                f'{gains.max():.0%} of the first frame; that was removed'
            )
        if changes:
            said.append(
                f'a part of the view changed at the arm azimuths {changes}; columns that one eye '
                'saw before and the other after it are unknown'
            )
        self.told = '; '.join(said) or 'steady'
        for sentence in said:
            self._node.get_logger().warning(sentence)
