"""What a rig can measure, from its numbers alone (sec. 6), and which numbers a wish needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

from panodepth_ros.geometry import equations as eq


@dataclass(frozen=True, slots=True, kw_only=True)
class RigNumbers:
    """
    A rig with one pair of columns, as it stands on paper.

    Attributes
    ----------
    radius : float
        r, axis to optical centre [m].
    fov : float
        α, horizontal view angle of the camera [rad].
    width : int
        W, width of the image [px].
    offset : float
        Distance of either eye's column from the middle of the image [px].
    step : float
        θ0, angle between panorama columns [rad], a whole fraction of a turn.
    linear : bool
        Find φ by the paper's linear rule (eq. 3) instead of the exact pinhole.

    Raises
    ------
    ValueError
        If there is no such rig; the sentence names the attribute, angles in degrees.
    """

    radius: float
    fov: float
    width: int
    offset: float
    step: float
    linear: bool = False

    def __post_init__(self) -> None:
        turn = 2 * math.pi / self.step if self.step > 0 else math.nan
        whole = turn >= 60 and math.isclose(turn, round(turn), rel_tol=1e-9)
        fov, step = math.degrees(self.fov), math.degrees(self.step)
        for name, value, allowed, fits in (
            ('radius', f'{self.radius:g} m', 'above 0', 0 < self.radius < math.inf),
            ('fov', f'{fov:g}°', 'above 0°, below 180°', 0 < self.fov < math.pi),
            ('width', f'{self.width} px', 'at least 2', self.width >= 2),
            (
                *('offset', f'{self.offset:g} px', f'above 0, at most {self.outermost:g}'),
                0 < self.offset <= self.outermost,
            ),
            ('step', f'{step:g}°', 'a whole fraction of 360°, at most 6°', whole),
        ):
            if not fits:
                raise ValueError(f'{name} is {value}; allowed: {allowed}')
        if self.depths < 2:
            raise ValueError(
                f'offset is {self.offset:g} px, which leaves {self.depths} columns to search at '
                f'a step of {step:g}°; allowed: at least 2'
            )

    @property
    def outermost(self) -> float:
        """Offset of the image's last column [px]."""
        return (self.width - 1) / 2

    @property
    def pinhole_angle(self) -> float:
        """φ of the exact pinhole [rad]."""
        return eq.pinhole_principal_angle(self.fov, self.width, 2 * self.offset)

    @property
    def linear_angle(self) -> float:
        """φ of the paper's linear rule [rad]."""
        return eq.linear_principal_angle(self.fov, self.width, 2 * self.offset)

    @property
    def principal_angle(self) -> float:
        """φ by the rule chosen [rad]."""
        return self.linear_angle if self.linear else self.pinhole_angle

    @property
    def viewing_circle_radius(self) -> float:
        """r0 = r·sin φ [m] (sec. 4)."""
        return self.radius * math.sin(self.principal_angle)

    @property
    def image_columns_of_a_step(self) -> float:
        """W_s, what one step uncovers [px] (sec. 3)."""
        return eq.stripe_width(self.width, self.fov, self.step)

    @property
    def depths(self) -> int:
        """n, columns to search and distances that can be told apart (secs. 6.2, 6.3)."""
        return eq.search_range(self.principal_angle, self.step)

    def distance(self, theta: float) -> float:
        """Return l of θ [m] (eq. 2)."""
        return float(
            eq.radial_distance(theta, arm_radius=self.radius, principal_angle=self.principal_angle)
        )

    def distance_of_columns(self, dx: int) -> float:
        """Return l of a column disparity [m] (eqs. 2 and 4)."""
        return self.distance(dx * self.step / 2)

    def errors_at(self, distance: float) -> tuple[float, float]:
        """
        Return the errors of one column at a distance, too near and too far by [m].

        NaN stands for an error without limit: there is no such distance.

        Raises
        ------
        ValueError
            If the distance lies within the camera's circle.
        """
        rig = {'arm_radius': self.radius, 'principal_angle': self.principal_angle}
        theta = eq.theta_at(distance, **rig)
        return eq.one_column_errors(theta, column_step=self.step, **rig)

    def trusted_distance(self, allowed_error: float, *, relative: bool) -> float:
        """Return the farthest distance that keeps an error [m] (sec. 6.4), or NaN."""
        return eq.trusted_distance(
            allowed_error,
            arm_radius=self.radius,
            principal_angle=self.principal_angle,
            column_step=self.step,
            relative=relative,
        )

    def needed_radius(self, allowed_error: float, distance: float) -> float:
        """
        Smallest arm radius that keeps an error with these columns.

        Parameters
        ----------
        allowed_error : float
            Largest error of one column, too far [m].
        distance : float
            Where [m].

        Returns
        -------
        float
            [m]; NaN if the arm would reach that far itself.
        """
        circle = eq.needed_viewing_circle(allowed_error, distance, self.step)
        radius = circle / math.sin(self.principal_angle)
        return radius if radius < distance else math.nan

    def needed_offset(self, allowed_error: float, distance: float) -> float:
        """
        Smallest column offset that keeps an error with this radius; parameters as above.

        Returns
        -------
        float
            [px]; NaN if not even the outermost columns of the lens suffice.
        """
        share = eq.needed_viewing_circle(allowed_error, distance, self.step) / self.radius
        if share >= 1:
            return math.nan
        separation = eq.linear_separation if self.linear else eq.pinhole_separation
        offset = separation(self.fov, self.width, math.asin(share)) / 2
        return offset if offset <= self.outermost else math.nan
