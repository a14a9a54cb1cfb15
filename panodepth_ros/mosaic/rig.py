"""What a sweep assumes: the arm, its columns and how many of them a frame fills."""

from __future__ import annotations

import math
from dataclasses import dataclass

from panodepth_ros.geometry import ALIGNED, Mounting

#: A frame serves columns this far beyond half its stripe, so that an arm may stop off the grid
#: [columns].
REACH_BEYOND = 0.25
#: 360° may differ by this much from a whole number of column steps [columns].
WHOLE_TURN_TOLERANCE = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """
    What the sweep assumes about the arm and takes from each frame.

    Attributes
    ----------
    arm_radius : float
        r, axis to optical centre [m].
    column_offset : float
        Distance of the left and right eye's columns from the principal point [px].
    columns : int
        N, columns of a full turn.
    sweep_columns : int
        Columns that a sweep covers, N for a full turn.
    mounting : Mounting
        The camera's rotation against the arm, by default none.
    further_offsets : tuple of float
        Such distances of further pairs [px].
    stripe_columns : int
        Columns that one frame fills in each panorama, and that one step of the arm takes.
    stripe_distance : float
        Distance from the axis at which stripes of neighbouring frames join [m]; +inf lets them
        join at the horizon, and hides nearer what lies between them.
    closes : bool
        Whether a sweep of a full turn keeps the frames that tell whether it closes.
    mends_light : bool
        Whether steps of the frames' gain are removed, and columns unknown where a part of the view
        has changed between the sightings of the two eyes.
    closing_frame : bool
        Whether such a sweep takes one more frame, at 360°, which shows what the first one shows.
    """

    arm_radius: float
    column_offset: float
    columns: int
    sweep_columns: int
    mounting: Mounting = ALIGNED
    further_offsets: tuple[float, ...] = ()
    stripe_columns: int = 1
    stripe_distance: float = math.inf
    closes: bool = False
    mends_light: bool = False
    closing_frame: bool = False

    def __post_init__(self) -> None:
        if not self.stripe_distance >= 2 * self.arm_radius:
            raise ValueError(
                f'stripe_distance is {self.stripe_distance} m; allowed: at least '
                f'{2 * self.arm_radius:g}, twice the arm_radius'
            )

    @property
    def column_step(self) -> float:
        """θ0 [rad]."""
        return 2 * math.pi / self.columns

    @property
    def sweep_frames(self) -> int:
        """Frames that fill a sweep, one every ``stripe_columns``."""
        return -(-self.sweep_columns // self.stripe_columns)

    @property
    def turn_closes(self) -> bool:
        """Whether a sweep is a full turn that is to close."""
        return self.closes and self.sweep_columns == self.columns

    @property
    def sweep_steps(self) -> int:
        """Frames that a sweep takes, the one at 360° included."""
        return self.sweep_frames + (self.turn_closes and self.closing_frame)

    @property
    def reach(self) -> float:
        """A frame serves the columns whose arm azimuth is closer to its own [columns]."""
        return self.stripe_columns / 2 + REACH_BEYOND

    def ray_angle(self, principal_angle: float, deviation: float) -> float:
        """
        Ray angle of a column that belongs to another arm azimuth than the frame's.

        Parameters
        ----------
        principal_angle : float
            φ of the panorama, with its sign [rad].
        deviation : float
            Arm azimuth of the column less that of the frame [rad].

        Returns
        -------
        float
            ψ [rad], towards the point at ``stripe_distance`` on the column's principal ray.
        """
        if math.isinf(self.stripe_distance) or deviation == 0.0:
            return principal_angle + deviation
        distance, radius = self.stripe_distance, self.arm_radius
        ahead = (
            principal_angle + deviation - math.asin(radius * math.sin(principal_angle) / distance)
        )
        return math.atan2(distance * math.sin(ahead), distance * math.cos(ahead) - radius)


def panorama_names(further_pairs: int, *, center: bool = True) -> tuple[str, ...]:
    """
    Names of a sweep's panoramas, which are those of their topics.

    Parameters
    ----------
    further_pairs : int
        Pairs besides the first.
    center : bool
        Whether the centre is among them.

    Returns
    -------
    tuple of str
        ``left``, ``right``, ``pair_1/left``, ``pair_1/right``, …, ``center``.
    """
    pairs = ('', *(f'pair_{number}/' for number in range(1, further_pairs + 1)))
    eyes = tuple(f'{pair}{eye}' for pair in pairs for eye in ('left', 'right'))
    return (*eyes, 'center') if center else eyes


def columns_per_turn(column_step_deg: float) -> int:
    """
    Columns of a full turn for a column step.

    Raises
    ------
    ValueError
        If a full turn is not a whole number of steps.
    """
    columns = 360 / abs(column_step_deg)
    whole = round(columns)
    if abs(columns - whole) > WHOLE_TURN_TOLERANCE:
        raise ValueError(
            f'column_step_deg is {column_step_deg}: a turn of 360° would take {columns:.3f} '
            f'columns; allowed: whole fractions of 360°, such as {360 / whole:.7g}'
        )
    return whole
