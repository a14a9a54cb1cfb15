"""What the mosaicer makes of the delay between the clocks of camera and arm."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from panodepth_ros.geometry import Panorama
from panodepth_ros.mosaic import ContinuousAssembler, Sweep
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.mosaic.clock import DelayCheck

#: What is longer, or less certain, is not taken for a delay between clocks [s].
LONGEST_DELAY, LARGEST_DELAY_STDDEV = 0.2, 0.005


class DelayCorrection:
    """
    Measures the delay by two sweeps to either side, and corrects ``image_delay_ms``.

    Parameters
    ----------
    node : rclpy.node.Node
        Logs, and has that parameter; setting it changes the builder's delay.
    builder : SweepBuilder
        Makes the sweeps; nothing is measured of an arm that stands for each frame.
    """

    def __init__(self, node: Node, builder: SweepBuilder[Any]) -> None:
        self._node = node
        self._builder = builder
        self._check = DelayCheck()

    def forget(self) -> None:
        """Compare what comes with no sweep from before."""
        self._check = DelayCheck()

    def tell(self, center: Panorama, sweep: Sweep, *, correct: bool) -> None:
        """
        Take a finished sweep; log the delay if it is known then.

        Parameters
        ----------
        center : Panorama
            The sweep's centre panorama.
        sweep : Sweep
            The sweep.
        correct : bool
            Whether the parameter is set to the delay.
        """
        builder, log = self._builder, self._node.get_logger()
        if not isinstance(builder, ContinuousAssembler):
            return
        found = self._check.add(center, sweep.velocity, sweep.end or 0)
        if found is None:
            return
        in_use = builder.image_delay * 1e-6
        log.info(
            f'image_delay_ms should be {in_use + found.delay * 1e3:.2f}, {in_use:.2f} is in use; '
            f'standard deviation {found.stddev * 1e3:.2f}'
        )
        total = in_use * 1e-3 + found.delay
        if abs(total) > LONGEST_DELAY or found.stddev > LARGEST_DELAY_STDDEV:
            log.warning('that is no delay of clocks: it is not corrected')
        elif correct:
            self._node.set_parameters([Parameter('image_delay_ms', value=total * 1e3)])
