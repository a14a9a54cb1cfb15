"""
The search for an index mark with a sensor at the probe input of a GRBL controller.

Probing is relative, so that it does not matter which work coordinates are in force, and of the
kind that does not end in alarm if there is no mark. The controller notes where it was when the
input changed and brakes after that; so the mark is first passed at speed, then approached slowly,
always counter-clockwise, whichever way it was found.
"""

from __future__ import annotations

import math

from panodepth_ros.arm import grbl
from panodepth_ros.arm.errors import ArmProtocolError
from panodepth_ros.arm.link import GrblLink
from panodepth_ros.arm.moving import Mover
from panodepth_ros.arm.reports import Report, Reports

#: Speed of the last approach [rad/s].
_SLOW = math.radians(5.0)
#: How far before and behind the mark's edge the last approach begins and ends [rad].
_MARGIN = math.radians(2.0)
#: What a search of an endless axis does beyond a turn [rad].
_OVERLAP = math.radians(10.0)


class IndexSearch:
    """
    One search.

    Parameters
    ----------
    link, reports
        The controller; the arm stands and no other command runs.
    axis : str
        Letter of the axis.
    limit : float
        How far the cable lets the arm turn from 0 to each side [rad]; 0 for an endless axis.
    mover : Mover
        Moves the arm, at its speed.
    """

    def __init__(
        self,
        link: GrblLink,
        reports: Reports,
        axis: str,
        limit: float,
        mover: Mover,
    ) -> None:
        self._link = link
        self._reports = reports
        self._axis = axis
        self._limit = limit
        self._mover = mover

    def run(self) -> float:
        """
        Search the mark.

        Returns
        -------
        float
            Azimuth of its edge as the arm counts now [rad].

        Raises
        ------
        ArmProtocolError
            If there is none, or not where it was a moment ago.
        ArmError
            Whatever else breaks a motion.
        """
        edge = self._roughly()
        begin = min(self._reports.ask_standing().azimuth, edge - _MARGIN)
        self._mover.move(begin)
        if self._active(self._reports.ask_standing()):
            raise ArmProtocolError(
                f'index sensor of the arm on port {self._link.port} is active '
                f'{math.degrees(_MARGIN):.0f}° before the edge of its mark'
            )
        found = self._probe(edge + _MARGIN - begin, min(_SLOW, self._mover.speed))
        if found is None:
            raise ArmProtocolError(
                f'index of the arm on port {self._link.port} was seen at '
                f'{math.degrees(edge):.3f}°, but not again'
            )
        return found

    def _roughly(self) -> float:
        """Find the edge at speed."""
        here = self._reports.ask_standing()
        if self._active(here):
            return self._leave(here)
        high = self._limit or here.azimuth + 2.0 * math.pi + _OVERLAP
        edge = self._probe(high - here.azimuth, self._mover.speed)
        if edge is None and self._limit:
            here = self._reports.ask_standing()
            edge = self._probe(-self._limit - here.azimuth, self._mover.speed)
            here = self._reports.ask_standing()
            if edge is not None and self._active(here):
                return self._leave(here)
        if edge is None:
            raise ArmProtocolError(
                f'arm on port {self._link.port} turned to {math.degrees(here.azimuth):.0f}° and '
                'found no index; is its sensor connected to the probe input?'
            )
        return edge

    def _leave(self, here: Report) -> float:
        """Turn clockwise out of the mark; return where it ends."""
        low = -self._limit or here.azimuth - 2.0 * math.pi
        edge = self._probe(low - here.azimuth, self._mover.speed, away=True)
        if edge is None:
            raise ArmProtocolError(
                f'index sensor of the arm on port {self._link.port} is active wherever the arm '
                'stands; $6 of the controller inverts its input'
            )
        return edge

    @staticmethod
    def _active(report: Report) -> bool:
        return 'P' in report.status.pins

    def _probe(self, way: float, speed: float, *, away: bool = False) -> float | None:
        """Turn until the input changes; return where that was, or None if it did not."""
        if abs(way) <= self._reports.motor_step:
            return None
        start = self._reports.ask_standing()
        self._reports.begin(start, math.copysign(speed, way))
        line = grbl.encode_probe(
            self._axis, math.degrees(way), math.degrees(speed) * 60.0, away=away
        )
        duration = abs(way) / speed + speed / math.radians(self._reports.setting(120))
        patience = 1.5 * duration + self._link.response_timeout
        self._mover.follow(self._link.send(line, moves=True), patience)
        self._link.moving = False
        if self._link.probe is None:
            raise ArmProtocolError(
                f'controller on port {self._link.port} did not tell what probing found'
            )
        return self._reports.probed(self._link.probe)
