"""
How long a sweep takes (sec. 6.1): stop and go, wider stripes, and a steady turn.

A motor with limited speed and acceleration turns the arm; a free-running camera exposes a frame
every 1/rate seconds and delivers it when the next one begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

#: How far the arm may turn while a frame is exposed without that blur shows [columns].
BLUR = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Motor:
    """
    What turns the arm.

    Attributes
    ----------
    speed : float
        Largest speed [rad/s], > 0.
    acceleration : float
        [rad/s²], > 0.
    settle_time : float
        How long the arm swings after a motion [s], >= 0.

    Raises
    ------
    ValueError
        If a value is outside of its interval.
    """

    speed: float
    acceleration: float
    settle_time: float = 0.0

    def __post_init__(self) -> None:
        for name in ('speed', 'acceleration'):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise ValueError(f'motor {name} is {value}; allowed: finite and above 0')
        if not 0 <= self.settle_time < math.inf:
            raise ValueError(f'motor settle_time is {self.settle_time} s; allowed: 0 or more')

    def moving_time(self, way: float) -> float:
        """Return how long the arm takes from rest to rest over a way [rad], without settling."""
        if way * self.acceleration <= self.speed**2:  # the speed is not reached
            return 2 * math.sqrt(way / self.acceleration)
        return way / self.speed + self.speed / self.acceleration


@dataclass(frozen=True, slots=True)
class Capture:
    """
    One way to take a sweep.

    Attributes
    ----------
    duration : float
        [s].
    frames : int
        Frames that are used.
    arm_speed : float
        While the frames are exposed [rad/s]; 0 for stop and go.
    longest_exposure : float
        Exposure in which the arm turns by half a column [s]; +inf for stop and go.
    """

    duration: float
    frames: int
    arm_speed: float
    longest_exposure: float


def stop_and_go(
    columns: int, column_step: float, motor: Motor, frame_rate: float, *, stripe: int = 1
) -> Capture:
    """
    Sweep that stands still for every frame.

    Parameters
    ----------
    columns : int
        Columns of the sweep.
    column_step : float
        θ0 [rad].
    motor : Motor
    frame_rate : float
        [Hz], > 0.
    stripe : int
        Columns taken from one frame, >= 1.

    Returns
    -------
    Capture

    Notes
    -----
    From the beginning of one exposure to the next that may be used pass a frame until the image
    is there, the motion and the settling. The camera does not wait: it takes a whole number of
    frames. The time that programs and the serial line need is not counted.
    """
    frames = _frames(columns, frame_rate, stripe)
    way = stripe * column_step
    pause = motor.moving_time(way) + motor.settle_time
    periods = math.ceil(1 + pause * frame_rate - 1e-9)
    return Capture(frames * periods / frame_rate, frames, 0.0, math.inf)


def continuous(
    columns: int, column_step: float, motor: Motor, frame_rate: float, *, stripe: int = 1
) -> Capture:
    """
    Sweep of an arm that turns steadily, a frame for every stripe.

    Parameters and returns as of :func:`stop_and_go`.

    Notes
    -----
    The camera's rate sets the speed, stripe·θ0·rate, unless that is more than the motor's.
    Speeding up and braking come on top.
    """
    frames = _frames(columns, frame_rate, stripe)
    speed = min(stripe * column_step * frame_rate, motor.speed)
    duration = columns * column_step / speed + 2 * speed / motor.acceleration
    return Capture(duration, frames, speed, BLUR * column_step / speed)


def safe_speed(exposure: float, column_step: float) -> float:
    """
    Speed at which the arm turns by half a column while a frame is exposed.

    Parameters
    ----------
    exposure : float
        [s], > 0.
    column_step : float
        θ0 [rad].

    Returns
    -------
    float
        [rad/s]; a slower arm blurs less.

    Raises
    ------
    ValueError
        If there is no such exposure.
    """
    if not 0 < exposure < math.inf:
        raise ValueError(f'exposure is {1e3 * exposure:g} ms; allowed: finite and above 0')
    return BLUR * column_step / exposure


def widest_stripe(principal_angle: float, angle_of_view: float, column_step: float) -> int:
    """
    Columns of the widest stripe about ±φ that lies within the image.

    Parameters
    ----------
    principal_angle : float
        φ, at the middle of the stripe [rad].
    angle_of_view : float
        Horizontal view angle α of the camera [rad].
    column_step : float
        θ0 [rad].

    Returns
    -------
    int
        At least 1. A stripe neither leaves the image nor crosses its middle.
    """
    half = min(angle_of_view / 2 - principal_angle, principal_angle)
    return max(1, math.floor(2 * half / column_step + 1e-9))


def _frames(columns: int, frame_rate: float, stripe: int) -> int:
    if not (frame_rate > 0 and math.isfinite(frame_rate)):
        raise ValueError(f'frame_rate is {frame_rate} Hz; allowed: finite and above 0')
    if stripe < 1 or columns < 1:
        raise ValueError(f'stripe is {stripe} and columns {columns}; allowed: at least 1')
    return -(-columns // stripe)
