"""
A panorama and what its columns mean: column to ray azimuth, row to slope.

Columns run clockwise, ``ray_azimuth(x) = (azimuth_column − x)·column_step``; a panorama always
has all the columns of a turn and wraps around (docs/conventions.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

#: Rays that differ from the principal angle by less than this count as equal to it [rad].
RAY_ANGLE_TOLERANCE = 1e-7


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PanoramaGeometry:
    """
    Geometry of one panorama: everything that turns a pixel into a ray.

    Attributes
    ----------
    columns, rows : int
        Size W × H; W columns are a full turn.
    azimuth_column : float
        Column whose ray looks along azimuth 0; any real number.
    focal_length_px : float
        F = fy/cos φ: a pixel at row v has the slope z/d = (principal_row − v)/F.
    principal_row : float
        Row of slope 0.
    arm_radius : float
        r, axis to optical centre [m].
    principal_angle : float
        Angle from the arm to the chosen ray [rad]: negative for the left eye, positive for the
        right eye, 0 for the centre.
    sweep_duration : float
        How long the sweep took [s].
    ray_angle : ndarray of float64, shape (W,)
        ψ, angle from the arm to the ray of each column [rad]; NaN where no frame saw the column.
    stripe_distance : float
        l_s, distance from the axis at which columns of different ray angles join as those of one
        angle would [m]; +inf if every column looks exactly along its own azimuth.

    Raises
    ------
    ValueError
        If a value cannot describe a panorama.
    """

    columns: int
    rows: int
    azimuth_column: float
    focal_length_px: float
    principal_row: float
    arm_radius: float
    principal_angle: float
    sweep_duration: float
    ray_angle: npt.NDArray[np.float64]
    stripe_distance: float = math.inf

    def __post_init__(self) -> None:
        for name in ('columns', 'rows', 'focal_length_px', 'arm_radius'):
            value = getattr(self, name)
            if not (value > 0 and math.isfinite(value)):
                raise ValueError(f'panorama {name} is {value}; allowed: finite and above 0')
        for name in ('azimuth_column', 'principal_row'):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f'panorama {name} is {getattr(self, name)}; allowed: finite')
        if not -math.pi / 2 < self.principal_angle < math.pi / 2:
            raise ValueError(
                f'panorama principal_angle is {self.principal_angle} rad; '
                'allowed: above −π/2, below π/2'
            )
        if not self.sweep_duration >= 0:
            raise ValueError(f'panorama sweep_duration is {self.sweep_duration} s; allowed: >= 0')
        if self.ray_angle.shape != (self.columns,):
            raise ValueError(
                f'panorama has {self.columns} columns, but ray_angle has shape '
                f'{self.ray_angle.shape}; allowed: one per column'
            )
        if np.any(np.abs(self.ray_angle[self.seen]) >= math.pi / 2):
            raise ValueError('panorama ray_angle holds an angle outside (−π/2, π/2)')
        if not self.stripe_distance > self.arm_radius:
            raise ValueError(
                f'panorama stripe_distance is {self.stripe_distance} m; '
                f'allowed: above the arm_radius {self.arm_radius}'
            )

    @property
    def column_step(self) -> float:
        """θ0, angle between neighbouring columns [rad]."""
        return 2 * math.pi / self.columns

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Whether a frame saw the column, shape (W,)."""
        return np.isfinite(self.ray_angle)

    @property
    def uniform(self) -> bool:
        """Whether every column was seen, and at the principal angle."""
        deviation = np.abs(self.ray_angle - self.principal_angle)
        return bool(np.all(deviation <= RAY_ANGLE_TOLERANCE))

    def ray_azimuth(
        self, column: npt.ArrayLike, ray_angle: npt.NDArray[np.float64] | None = None
    ) -> npt.NDArray[np.float64]:
        """
        Azimuth β at which a column looks [rad], not wrapped; any shape, columns may be real.

        ``ray_angle`` is their :meth:`ray_angle_at`, for who has it already.

        Notes
        -----
        The ray of the principal angle at the column's place passes the point at l_s whose azimuth
        is (azimuth_column − x)·θ0 − asin(r·sin φ / l_s), and the column's own ray passes it, too.
        """
        place = np.asarray(column, np.float64)
        azimuth = (self.azimuth_column - place) * self.column_step
        if math.isinf(self.stripe_distance) or self.uniform:
            return azimuth
        turn = self.stripe_turn(self.ray_angle_at(place) if ray_angle is None else ray_angle)
        return azimuth + np.where(np.isfinite(turn), turn, 0.0)

    def stripe_turn(self, ray_angle: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """By how much rays' azimuths exceed those of the principal rays there [rad], any shape."""
        lever = self.arm_radius / self.stripe_distance
        principal = math.asin(lever * math.sin(self.principal_angle))
        return np.asarray(np.arcsin(lever * np.sin(ray_angle)) - principal)

    def ray_angle_at(self, column: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Ray angle [rad] at real columns, any shape, linear between; NaN at NaN and by unseen."""
        whole = np.floor(np.where(np.isfinite(column), column, 0.0))
        index = whole.astype(np.int64) % self.columns
        step = np.roll(self.ray_angle, -1) - self.ray_angle
        with np.errstate(invalid='ignore'):
            share = column - whole
            beyond = share * step[index]
        # Beside an unseen column a step is NaN, which must not spoil whole columns.
        return np.asarray(self.ray_angle[index] + np.where(share == 0, 0.0, beyond))

    def slope(self, row: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Height over horizontal distance from the camera centre, z/d, of a row; any shape."""
        return (self.principal_row - np.asarray(row, np.float64)) / self.focal_length_px


@dataclass(frozen=True, eq=False, slots=True)
class Panorama:
    """
    A panoramic image and its geometry.

    Attributes
    ----------
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        Grey or BGR.
    geometry : PanoramaGeometry

    Raises
    ------
    ValueError
        If the image has another size or type than the geometry says.
    """

    image: npt.NDArray[np.uint8]
    geometry: PanoramaGeometry

    def __post_init__(self) -> None:
        size = (self.geometry.rows, self.geometry.columns)
        shape = self.image.shape
        if self.image.dtype != np.uint8 or shape not in (size, (*size, 3)):
            raise ValueError(
                f'panorama image is {self.image.dtype} of shape {shape}; '
                f'allowed: uint8 of {size} or {(*size, 3)}, as its geometry says'
            )
