"""Where the steps of the arm lead: to whole steps from an origin, so that no error accumulates."""

from __future__ import annotations


class StepGrid:
    """
    The steps from an origin.

    Parameters
    ----------
    step : float
        One step [rad], negative for clockwise.
    """

    def __init__(self, step: float) -> None:
        self._step = step
        self._origin = 0.0
        self._index: int | None = 0

    def begin(self, azimuth: float) -> None:
        """Let the steps count from an azimuth [rad]."""
        self._origin = azimuth
        self._index = 0

    def lose(self) -> None:
        """Forget the step; the next one is counted from the nearest."""
        self._index = None

    def next(self, azimuth: float) -> tuple[int, float]:
        """Index and azimuth [rad] of the step that follows the arm's place."""
        if self._index is None:
            self._index = round((azimuth - self._origin) / self._step)
        return self._index + 1, self._origin + (self._index + 1) * self._step

    def reached(self, index: int) -> None:
        """Note that the arm stands at a step."""
        self._index = index
