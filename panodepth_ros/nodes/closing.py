"""What the mosaicer makes of the closure of a full turn: publish, correct or refuse it."""

from __future__ import annotations

import math

from rclpy.node import Node

from panodepth_ros.mosaic import Sweep
from panodepth_ros.mosaic.closure import refusal
from panodepth_ros.nodes.mosaicer_settings import MosaicerParameters

#: More than this is not corrected [rad]: it was hardly lost little by little.
CORRECTABLE = math.radians(2.0)


class ClosureCheck:
    """
    Judges one sweep after the other.

    Attributes
    ----------
    told : str
        What was measured of the last sweep, for diagnostics.
    lost : float
        What its panoramas are to be corrected by [rad].
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self.told = 'no turn yet'
        self.lost = 0.0

    def refusal(self, sweep: Sweep, settings: MosaicerParameters) -> str:
        """Measure how a sweep closes; return why it must not be published, empty if it may."""
        self.lost = 0.0
        if sweep.seam is None:
            self.told = 'not measured'
            return ''
        try:
            closure = sweep.seam.measure(sweep.camera)
        except ValueError as error:
            self.told = f'unknown: {error}'
            return f'whether the turn closes cannot be told: {error}'
        self.told = (
            f'lost {math.degrees(closure.lost):.3f}° ± {math.degrees(closure.stddev):.3f}°, '
            f'mismatch {math.degrees(closure.mismatch):.3f}°, {closure.points} points'
        )
        self._node.get_logger().info(f'closure of the turn: {self.told}')
        tolerance = math.radians(settings.closure_tolerance_deg)
        corrects = settings.closure == 'correct'
        reason = refusal(closure, tolerance, CORRECTABLE if corrects else 0.0)
        if not reason and corrects and abs(closure.lost) > tolerance:
            self.lost = closure.lost
            self.told += ', corrected'
        return reason
