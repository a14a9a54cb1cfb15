"""The paper's Figs. 4 to 7: depth functions, possible depths, matching, ground plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry.equations import radial_distance, search_range

mpl.use('Agg')
from matplotlib import pyplot as plt

Array = npt.NDArray[np.float64]

#: Distances are drawn up to this many radii of the arm.
_RADII_SHOWN = 14


class Curve(NamedTuple):
    """Arm radius r [m], principal angle φ [rad] and column step θ0 [rad] of a rig."""

    arm_radius: float
    principal_angle: float
    column_step: float

    def distance(self, theta: Array) -> Array:
        """Return l of θ [m]."""
        return radial_distance(
            theta, arm_radius=self.arm_radius, principal_angle=self.principal_angle
        )

    def possible(self) -> tuple[Array, Array]:
        """Return θ and l of every whole column."""
        n = search_range(self.principal_angle, self.column_step)
        theta = np.arange(1, n + 1) * self.column_step / 2
        return theta, self.distance(theta)

    @property
    def farthest_shown(self) -> float:
        """Upper end of the pictures [m]."""
        return _RADII_SHOWN * self.arm_radius

    @property
    def title(self) -> str:
        """Heading of a picture."""
        n = search_range(self.principal_angle, self.column_step)
        return f'2φ = {2 * math.degrees(self.principal_angle):.4f}°, n = {n}'


def _side_by_side(count: int) -> tuple[Any, Any]:
    figure, axes = plt.subplots(
        1, count, figsize=(6.5 * count, 6), layout='constrained', squeeze=False
    )
    return figure, axes[0]


def _save(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=110)
    plt.close(figure)


def save_depth_curves(curves: Sequence[Curve], path: Path) -> None:
    """
    Draw distance over θ, with the width of one column at θ = 7φ/8 (Fig. 4).

    Parameters
    ----------
    curves : sequence of Curve
        One picture each.
    path : Path
        PNG to write.
    """
    figure, pictures = _side_by_side(len(curves))
    for curve, axes in zip(curves, pictures, strict=True):
        theta = np.linspace(0, curve.principal_angle, 2000)[:-1]
        axes.plot(np.degrees(theta), curve.distance(theta), color='tab:blue')
        for share, colour in ((1 / 4, 'tab:green'), (1 / 2, 'tab:orange'), (7 / 8, 'tab:red')):
            at = np.array([share * curve.principal_angle])
            axes.plot(np.degrees(at), curve.distance(at), 'o', color=colour)
        for side in (-1, 1):
            edge = math.degrees(7 / 8 * curve.principal_angle + side * curve.column_step / 4)
            axes.axvline(edge, color='tab:red', linewidth=0.8)
        axes.set_xlim(0, math.degrees(curve.principal_angle))
        axes.set_ylim(0, curve.farthest_shown)
        axes.set_xlabel('θ [°]; between the red lines: half a column step')
        axes.set_ylabel('distance l [m]')
        axes.set_title(curve.title)
        axes.grid(alpha=0.3)
    _save(figure, path)


def save_depth_circles(curves: Sequence[Curve], path: Path) -> None:
    """Draw the distances that whole columns can tell, as circles (Fig. 5); arguments as above."""
    figure, pictures = _side_by_side(len(curves))
    for curve, axes in zip(curves, pictures, strict=True):
        _, distances = curve.possible()
        shown = distances[distances <= curve.farthest_shown]
        for distance in shown:
            axes.add_patch(plt.Circle((0, 0), distance, fill=False, linewidth=0.6))
        camera = plt.Circle((0, 0), curve.arm_radius, fill=False, color='tab:blue')
        axes.add_patch(camera)
        axes.plot(0, 0, '+', color='tab:blue', markersize=10)
        axes.set_xlim(-curve.farthest_shown, curve.farthest_shown)
        axes.set_ylim(-curve.farthest_shown, curve.farthest_shown)
        axes.set_aspect('equal')
        axes.set_xlabel('[m]')
        axes.set_title(f'{curve.title}: {shown.size} within {curve.farthest_shown:g} m')
    _save(figure, path)


def save_stack(pictures: Sequence[tuple[str, npt.NDArray[Any]]], path: Path) -> None:
    """
    Draw panoramas below one another (Fig. 6).

    Parameters
    ----------
    pictures : sequence of (str, ndarray)
        Heading and picture; uint8 of shape (H, W) or (H, W, 3) in BGR order.
    path : Path
        PNG to write.
    """
    figure, rows = plt.subplots(
        len(pictures), 1, figsize=(16, 1.55 * len(pictures)), layout='constrained', squeeze=False
    )
    for (heading, picture), axes in zip(pictures, rows[:, 0], strict=True):
        shown = picture[..., ::-1] if picture.ndim == 3 else picture
        axes.imshow(shown, cmap='gray', vmin=0, vmax=255, interpolation='nearest')
        axes.set_title(heading, loc='left', fontsize=10)
        axes.set_axis_off()
    _save(figure, path)


def save_measured_plan(
    x: Array,
    y: Array,
    path: Path,
    *,
    arm_radius: float,
    features: Sequence[tuple[float, float]],
    title: str,
) -> None:
    """
    Draw a ground plan with lines between successive points and numbered features (Fig. 7).

    Parameters
    ----------
    x, y : ndarray of float64, shape (M,)
        Points in order around the axis, in the scan frame [m]; the last is linked to the first.
    path : Path
        PNG to write.
    arm_radius : float
        The camera's circle [m].
    features : sequence of (float, float)
        x and y of the features as measured [m], numbered from 1.
    title : str
        Heading.
    """
    figure, axes = plt.subplots(figsize=(9, 9), layout='constrained')
    axes.plot(np.append(y, y[:1]), np.append(x, x[:1]), color='0.6', linewidth=0.6, zorder=1)
    axes.plot(y, x, '.', color='black', markersize=3, label='reconstructed', zorder=2)
    axes.add_patch(plt.Circle((0, 0), arm_radius, fill=False, color='tab:blue'))
    axes.plot(0, 0, 'o', color='tab:blue', markersize=9, label='centre, camera circle')
    for number, (forward, left) in enumerate(features, 1):
        label = 'measured by hand' if number == 1 else None
        axes.plot(left, forward, 'o', color='tab:red', markersize=8, label=label, zorder=3)
        axes.annotate(
            f'{number}',
            (left, forward),
            textcoords='offset points',
            xytext=(7, 5),
            color='tab:red',
            fontsize=12,
        )
    axes.invert_xaxis()
    axes.set_aspect('equal')
    axes.grid(alpha=0.3)
    axes.set_xlabel('y, left [m]')
    axes.set_ylabel('x, forward [m]')
    axes.set_title(title)
    axes.legend(loc='upper right')
    _save(figure, path)
