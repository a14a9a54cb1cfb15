"""
What a camera decides by itself, and how it is kept from it while a panorama grows.

Automatic exposure, white balance and focus make neighbouring columns differ. So they may settle
once; then what they chose is held, and only frames from then on are handed out. A camera that
was unplugged gets the same values again, so that a sweep goes on as it began.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import NamedTuple

from panodepth_ros.camera.v4l2 import ControlError, Controls

#: The parameters' word for "as the camera has it".
LEAVE = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """
    What is asked of the camera.

    Attributes
    ----------
    exposure, gain, white_balance, focus : int
        Values in the device's units; :data:`LEAVE` for what it has or chooses.
    autoexposure, auto_white_balance, autofocus : bool
        Whether the camera may choose until it has settled; of no meaning where a value is given.
    grey : bool
        Whether frames are grey, so that their white balance does not matter.
    settle_time : float
        How long it may choose [s].
    """

    autoexposure: bool = True
    exposure: int = LEAVE
    gain: int = LEAVE
    auto_white_balance: bool = True
    white_balance: int = LEAVE
    autofocus: bool = False
    focus: int = LEAVE
    grey: bool = False
    settle_time: float = 2.0


class _Quantity(NamedTuple):
    """Something that a camera may choose: its switch, its value, as V4L2 numbers them."""

    name: str
    automatic: str  # the wish that lets the camera choose it
    switch: int
    by_hand: int  # the switch's value if the camera may not choose
    chosen: tuple[int, ...]  # those if it may, the best first
    value: int


_QUANTITIES = (
    # Aperture priority is what webcams call automatic: they have no aperture to move.
    _Quantity('exposure', 'autoexposure', 0x009A0901, 1, (3, 0), 0x009A0902),
    _Quantity('gain', 'autoexposure', 0x00980912, 0, (1,), 0x00980913),
    _Quantity('white_balance', 'auto_white_balance', 0x0098090C, 0, (1,), 0x0098091A),
    _Quantity('focus', 'autofocus', 0x009A090C, 0, (1,), 0x009A090A),
)


class Automatics:
    """
    Lets a camera settle and holds what it chose.

    The thread that reads frames calls :meth:`begin` and :meth:`admits`; others may ask to
    :meth:`settle` again and how it is.

    Parameters
    ----------
    wishes : Wishes
        What is asked of the camera.

    Attributes
    ----------
    held : dict
        Values that are held, by quantity; None if the device does not tell the value.
    failures : dict
        Why others are not, by quantity.
    """

    def __init__(self, wishes: Wishes) -> None:
        self._wishes = wishes
        self._asked = threading.Event()
        self._path = ''
        self._settled_at: float | None = None  # when the camera has had its time
        self._since = 0.0  # frames from then on are handed out
        self._settled = False
        self.held: dict[str, int | None] = {}
        self.failures: dict[str, str] = {}

    @property
    def settling(self) -> bool:
        """Whether the camera chooses, so that no frame is handed out."""
        return self._asked.is_set() or not self._settled

    def settle(self) -> None:
        """Have the camera choose again, and hold that."""
        self._asked.set()

    def begin(self, path: str) -> None:
        """
        Tell a device that was opened what to do: what is asked, or what was held before.

        Raises
        ------
        SourceError
            If it cannot do what is asked; a :class:`SourceLostError` if it went away.
        """
        self._path = path
        with Controls(path) as controls:
            if self._settled:
                for quantity in _QUANTITIES:
                    if quantity.name in self.held:
                        self._hold(controls, quantity, self.held[quantity.name])
            else:
                self._start(controls)
        self._settled_at = None
        self._since = time.monotonic()

    def _start(self, controls: Controls) -> None:
        self.held, self.failures = {}, {}
        for quantity in _QUANTITIES:
            value = getattr(self._wishes, quantity.name)
            if value != LEAVE:
                self._check(controls, quantity, value)
                _fix(controls, quantity, value)
            elif getattr(self._wishes, quantity.automatic):
                self._let(controls, quantity)
            else:
                self._hold(controls, quantity, None)

    def _check(self, controls: Controls, quantity: _Quantity, value: int) -> None:
        control = controls.offered.get(quantity.value)
        if control is None:
            raise ControlError(
                f'{quantity.name} is {value}, but video device {self._path} has no such control; '
                f'it offers: {controls.names()}'
            )
        if not control.low <= value <= control.high:
            raise ControlError(
                f'{quantity.name} is {value}; video device {self._path} allows {control.low} to '
                f'{control.high}, or {LEAVE} for what it chooses'
            )

    def _let(self, controls: Controls, quantity: _Quantity) -> None:
        """Let the camera choose, if it can."""
        if quantity.switch not in controls.offered:
            return
        if controls.get(quantity.switch) in quantity.chosen:
            return
        menu = len(quantity.chosen) > 1
        for choice in quantity.chosen:
            if not menu or controls.has_choice(quantity.switch, choice):
                try:
                    controls.set(quantity.switch, choice)
                except ControlError as error:
                    self.failures[quantity.name] = str(error)
                return

    def admits(self, stamp: float) -> bool:
        """
        Whether a frame may be handed out; holds what the camera chose when it has settled.

        Parameters
        ----------
        stamp : float
            When it was exposed [s of ``time.monotonic()``].

        Raises
        ------
        SourceLostError
            If the device went away.
        """
        if self._asked.is_set():
            self._settled = False
            self._asked.clear()
            self.begin(self._path)
        if not self._settled:
            now = time.monotonic()
            if self._settled_at is None:
                self._settled_at = now + self._wishes.settle_time
            if now < self._settled_at:
                return False
            with Controls(self._path) as controls:
                for quantity in _QUANTITIES:
                    self._hold(controls, quantity, None)
            self._since = time.monotonic()
            self._settled = True
        return stamp >= self._since

    def _hold(self, controls: Controls, quantity: _Quantity, value: int | None) -> None:
        """Hold a value, or by default what the camera has; remember it, or why it cannot be."""
        name = quantity.name
        self.held.pop(name, None)
        self.failures.pop(name, None)
        if not {quantity.switch, quantity.value} & set(controls.offered):
            # Without controls a gain follows the exposure, and a focus is fixed.
            if name == 'exposure' or (name == 'white_balance' and not self._wishes.grey):
                self.failures[name] = (
                    f'video device {self._path} has no control for {name}; '
                    f'it offers: {controls.names()}'
                )
            return
        try:
            self.held[name] = _fix(controls, quantity, value)
        except ControlError as error:
            self.failures[name] = str(error)

    def words(self) -> str:
        """What is held and what is not, for people."""
        if self.settling:
            return 'exposure, white balance and focus settle'
        if self.failures:
            reasons = '; '.join(self.failures.values())
            return f'{" and ".join(self.failures)} cannot be held: {reasons}'
        return f'the camera holds {", ".join(self.held) or "still"}'


def _fix(controls: Controls, quantity: _Quantity, value: int | None) -> int | None:
    """Switch the automatic off and set a value, by default the present one; return it."""
    if value is None and quantity.value in controls.offered:
        value = controls.get(quantity.value)
    if quantity.switch in controls.offered and controls.get(quantity.switch) != quantity.by_hand:
        controls.set(quantity.switch, quantity.by_hand)
    if value is None or quantity.value not in controls.offered:
        return None
    if controls.get(quantity.value) != value:
        controls.set(quantity.value, value)
    return value
