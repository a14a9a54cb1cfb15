"""
The paper's equations and the error analysis that follows from them.

Peer and Solina, "Mosaic-Based Panoramic Depth Imaging with a Single Standard Camera", 2001.
Equation and section numbers are theirs; symbols as in docs/conventions.md.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def view_angle(image_width: int, shift_px: float, rotation: float) -> float:
    """
    Horizontal view angle of a camera from the shift that a known rotation causes (eq. 1).

    Parameters
    ----------
    image_width : int
        Width of the image [px].
    shift_px : float
        Shift between the two images [px], > 0.
    rotation : float
        Rotation between the two images [rad].

    Returns
    -------
    float
        View angle [rad]. The equation is linear in the image column; a pinhole is not, see
        :meth:`panodepth_ros.geometry.camera.PinholeCamera.ray_angle`.

    Raises
    ------
    ValueError
        If ``shift_px`` is not above 0.
    """
    if shift_px <= 0:
        raise ValueError(f'shift_px is {shift_px}; allowed: above 0')
    return image_width / shift_px * rotation


def stripe_width(image_width: int, angle_of_view: float, rotation: float) -> float:
    """
    Image columns that a rotation uncovers, W_s = x0·θ0 with x0 = W/α (sec. 3).

    Parameters
    ----------
    image_width : int
        W [px].
    angle_of_view : float
        Horizontal view angle α [rad].
    rotation : float
        Turn of the arm between two images, θ0 for a single column [rad].

    Returns
    -------
    float
        [px], by the linear rule of eq. 1.
    """
    return image_width / angle_of_view * rotation


def linear_principal_angle(angle_of_view: float, image_width: int, separation_px: float) -> float:
    """
    Principal angle by the paper's linear rule, 2φ = α·W_2φ/W (eq. 3).

    Parameters
    ----------
    angle_of_view : float
        Horizontal view angle α [rad].
    image_width : int
        W [px].
    separation_px : float
        W_2φ, the distance between the left and the right eye's columns [px].

    Returns
    -------
    float
        φ [rad]. Kept to reproduce the paper's tables; scans use the pinhole's exact angle.
    """
    return angle_of_view / image_width * separation_px / 2


def pinhole_principal_angle(angle_of_view: float, image_width: int, separation_px: float) -> float:
    """
    Principal angle of an ideal pinhole, tan φ = (W_2φ/2)/f with f = (W/2)/tan(α/2).

    Parameters and returns as of :func:`linear_principal_angle`, which it replaces.
    """
    return math.atan(separation_px / image_width * math.tan(angle_of_view / 2))


def pinhole_separation(angle_of_view: float, image_width: int, principal_angle: float) -> float:
    """Return W_2φ [px], the inverse of :func:`pinhole_principal_angle`."""
    return image_width * math.tan(principal_angle) / math.tan(angle_of_view / 2)


def linear_separation(angle_of_view: float, image_width: int, principal_angle: float) -> float:
    """Return W_2φ [px], the inverse of :func:`linear_principal_angle`."""
    return image_width * 2 * principal_angle / angle_of_view


def radial_distance(theta: npt.ArrayLike, *, arm_radius: float, principal_angle: float) -> Array:
    """
    Distance from the axis of a point seen by a symmetric pair (eq. 2).

    Parameters
    ----------
    theta : array_like of float
        θ, half the arm's turn between both sightings [rad].
    arm_radius : float
        r, axis to optical centre [m].
    principal_angle : float
        φ [rad], in (0, π/2).

    Returns
    -------
    ndarray of float64
        l = r·sin φ / sin(φ − θ) [m]; +inf at θ = φ, NaN beyond (the rays diverge) and for θ < 0.

    Raises
    ------
    ValueError
        If ``arm_radius`` or ``principal_angle`` is outside of its interval.
    """
    if arm_radius <= 0:
        raise ValueError(f'arm_radius is {arm_radius} m; allowed: above 0')
    if not 0 < principal_angle < math.pi / 2:
        raise ValueError(f'principal_angle is {principal_angle} rad; allowed: above 0, below π/2')
    theta = np.asarray(theta, dtype=np.float64)
    remaining = principal_angle - theta
    with np.errstate(divide='ignore', invalid='ignore'):
        distance = arm_radius * math.sin(principal_angle) / np.sin(remaining)
    return np.where((remaining >= 0) & (theta >= 0), distance, np.nan)


def theta_from_columns(column_disparity: npt.ArrayLike, column_step: float) -> Array:
    """
    Half the arm's turn between both sightings, θ = dx·θ0/2 (eq. 4).

    Parameters
    ----------
    column_disparity : array_like of float
        dx [columns].
    column_step : float
        θ0 [rad].

    Returns
    -------
    ndarray of float64
        θ [rad].
    """
    return np.asarray(column_disparity, dtype=np.float64) * (column_step / 2)


def search_range(principal_angle: float, column_step: float) -> int:
    """
    Largest column disparity worth searching, n = φ div θ0/2 (sec. 6.2).

    A point at x on the left panorama lies at x+1 … x+n on the right one. A disparity at which
    the rays would be parallel (φ mod θ0/2 = 0) is excluded.
    """
    steps = principal_angle / (column_step / 2)
    whole = math.floor(steps + 1e-9)
    return whole - 1 if math.isclose(steps, whole, abs_tol=1e-9) else whole


def nearest_distance(arm_radius: float, principal_angle: float, column_step: float) -> float:
    """Return l_min [m], the distance at one column of disparity (sec. 6.2)."""
    return float(
        radial_distance(column_step / 2, arm_radius=arm_radius, principal_angle=principal_angle)
    )


def farthest_distance(arm_radius: float, principal_angle: float, column_step: float) -> float:
    """Return l_max [m], the distance at n columns of disparity (sec. 6.2)."""
    n = search_range(principal_angle, column_step)
    return float(
        radial_distance(
            n * column_step / 2, arm_radius=arm_radius, principal_angle=principal_angle
        )
    )


def one_column_errors(
    theta: float, *, arm_radius: float, principal_angle: float, column_step: float
) -> tuple[float, float]:
    """
    What missing the right column by one costs in distance (sec. 6.3, Table 1).

    Parameters
    ----------
    theta : float
        θ of the true match [rad].
    arm_radius : float
        r [m].
    principal_angle : float
        φ [rad].
    column_step : float
        θ0 [rad].

    Returns
    -------
    (float, float)
        l(θ) − l(θ − θ0/2) and l(θ + θ0/2) − l(θ) [m].
    """
    half = column_step / 2
    before, at, after = radial_distance(
        [theta - half, theta, theta + half], arm_radius=arm_radius, principal_angle=principal_angle
    )
    return float(at - before), float(after - at)


def theta_at(distance: float, *, arm_radius: float, principal_angle: float) -> float:
    """
    Return θ [rad] of a point at a distance from the axis [m]; the inverse of eq. 2.

    Raises
    ------
    ValueError
        If the distance is not outside of the camera's circle.
    """
    if not arm_radius < distance < math.inf:
        raise ValueError(
            f'distance is {distance:g} m; allowed: above the arm_radius of {arm_radius:g} m'
        )
    return principal_angle - math.asin(arm_radius * math.sin(principal_angle) / distance)


def needed_viewing_circle(allowed_error: float, distance: float, column_step: float) -> float:
    """
    Viewing circle whose error of one column is a given one at a given distance.

    Parameters
    ----------
    allowed_error : float
        E = l(θ + θ0/2) − l(θ) [m], > 0: the larger one of :func:`one_column_errors`.
    distance : float
        l(θ) [m], > 0.
    column_step : float
        θ0 [rad].

    Returns
    -------
    float
        r0 = r·sin φ [m]: any arm radius and principal angle of this product will do. Larger
        circles have smaller errors.

    Raises
    ------
    ValueError
        If ``allowed_error`` or ``distance`` is not above 0.

    Notes
    -----
    With h = θ0/2 eq. 2 says sin(φ − θ) = r0/l and sin(φ − θ − h) = r0/(l + E). The sine of the
    difference, √(1 − r0²/l²)·sin h = r0·c with c = cos h/l − 1/(l + E), gives
    r0 = sin h/√(c² + sin²h/l²).
    """
    if allowed_error <= 0 or distance <= 0:
        raise ValueError(
            f'allowed_error is {allowed_error} m at a distance of {distance} m; '
            'allowed: both above 0'
        )
    half = column_step / 2
    c = math.cos(half) / distance - 1 / (distance + allowed_error)
    return math.sin(half) / math.hypot(c, math.sin(half) / distance)


def trusted_distance(
    allowed_error: float,
    *,
    arm_radius: float,
    principal_angle: float,
    column_step: float,
    relative: bool = False,
) -> float:
    """
    Farthest distance whose one-column error stays within a bound (sec. 6.4).

    Parameters
    ----------
    allowed_error : float
        Largest allowed l(dx) − l(dx − 1), > 0 [m]; if ``relative``, as a share of l(dx).
    arm_radius : float
        r [m].
    principal_angle : float
        φ [rad].
    column_step : float
        θ0 [rad].
    relative : bool
        What ``allowed_error`` is.

    Returns
    -------
    float
        The largest l(dx) [m] over whole columns dx; NaN if even the nearest has a larger error.

    Raises
    ------
    ValueError
        If ``allowed_error`` is not above 0 or the rig is impossible.
    """
    if allowed_error <= 0:
        raise ValueError(f'allowed_error is {allowed_error}; allowed: above 0')
    n = search_range(principal_angle, column_step)
    distances = radial_distance(
        theta_from_columns(np.arange(1, n + 1), column_step),
        arm_radius=arm_radius,
        principal_angle=principal_angle,
    )
    errors = np.diff(distances) / (distances[1:] if relative else 1.0)
    within = np.flatnonzero(errors <= allowed_error)
    return float(distances[within[-1] + 1]) if within.size else math.nan
