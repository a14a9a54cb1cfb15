"""What the arm driver needs of an arm: one file per kind of controller provides it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, NoReturn, Protocol


class ArmState(NamedTuple):
    """
    Where the arm is.

    Attributes
    ----------
    stamp : int
        When the arm was there, by the clock given to the driver [ns]; strictly increasing,
        unless that clock is set back.
    azimuth : float
        As the controller counts it, counter-clockwise positive, not wrapped [rad].
    velocity : float
        0.0 only if the arm stands and has settled [rad/s].
    """

    stamp: int
    azimuth: float
    velocity: float


class Arm(Protocol):
    """
    A rotating arm, connected from construction to :meth:`close`.

    All methods may be called from any thread. Commands run one at a time, in the thread that
    calls them, and tell every state they measure to a listener given at construction. They raise
    :class:`~panodepth_ros.arm.errors.ArmError` and leave the arm standing; after an error that
    makes the position uncertain every motion but :meth:`home` is refused.
    """

    #: Time between two measurements during a motion [s]; may be changed at any time.
    status_period: float

    @property
    def port(self) -> str:
        """The serial device."""

    @property
    def doubt(self) -> str:
        """Why the position is uncertain, as a sentence; empty if it is not."""

    @property
    def motor_step(self) -> float:
        """Smallest motion [rad]."""

    @property
    def farthest(self) -> float:
        """Largest azimuth, of either sign, that the controller counts exactly [rad]."""

    @property
    def advice(self) -> str:
        """What the user should change about the controller, as a sentence; empty if nothing."""

    def distrust(self, reason: str) -> None:
        """Declare the position uncertain until the arm is homed; ``reason`` is a sentence."""

    def measure(self) -> ArmState:
        """Where the standing arm is."""

    def move_to(self, azimuth: float) -> ArmState:
        """Turn to an azimuth [rad], not wrapped; return when the arm stands and has settled."""

    def home(self) -> ArmState:
        """Make the position certain and return where the arm stands then."""

    def spin(
        self, speed: Callable[[], float], low: float, high: float, started: Callable[[], None]
    ) -> NoReturn:
        """
        Turn steadily until an error or :meth:`interrupt` ends it.

        Parameters
        ----------
        speed : callable
            The wanted speed [rad/s], positive counter-clockwise first, never 0. When it changes
            the arm brakes and goes on at the new one.
        low, high : float
            Where the arm turns back [rad].
        started : callable
            Called once when the controller has accepted the motion.

        Raises
        ------
        ArmError
            Always, as :meth:`move_to`; ArmStoppedError is the usual end.
        """

    def interrupt(self) -> None:
        """Begin to brake and make the running command raise; :meth:`stop` must follow."""

    def stop(self) -> ArmState | None:
        """Stop the arm, whatever it does; None if its position is uncertain then."""

    def close(self) -> None:
        """Leave the arm stopped and close the port. Idempotent."""
