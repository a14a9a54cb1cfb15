"""Pictures for people: a depth panorama, a confidence map, a ground plan."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

mpl.use('Agg')
from matplotlib import pyplot as plt

#: Colour of what is unknown.
_UNKNOWN = '0.15'


def _panorama(
    values: npt.NDArray[np.floating[Any]],
    path: Path,
    label: str,
    low: float,
    high: float,
    map_: str,
) -> None:
    colours = mpl.colormaps[map_].with_extremes(bad=_UNKNOWN)
    figure, axes = plt.subplots(figsize=(18, 2.6), layout='constrained')
    shown = axes.imshow(values, cmap=colours, vmin=low, vmax=high, interpolation='nearest')
    axes.set_xlabel('panorama column')
    axes.set_ylabel('row')
    figure.colorbar(shown, ax=axes, label=label, pad=0.01)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def save_depth(depth: npt.NDArray[np.floating[Any]], path: Path, *, farthest: float) -> None:
    """
    Write a depth panorama with a colour scale in metres.

    Parameters
    ----------
    depth : ndarray of float, shape (H, W)
        Radial distance [m], NaN where unknown.
    path : Path
        PNG to write.
    farthest : float
        Upper end of the scale [m].
    """
    _panorama(depth, path, 'distance from the axis [m]', 0.0, farthest, 'turbo_r')


def save_confidence(confidence: npt.NDArray[np.floating[Any]], path: Path) -> None:
    """Write a confidence map, shape (H, W), from 0 to 1 and NaN for unknown, as a picture."""
    _panorama(confidence, path, 'confidence', 0.0, 1.0, 'viridis')


def save_ground_plan(
    ranges: npt.NDArray[np.floating[Any]],
    path: Path,
    *,
    arm_radius: float,
    outline: Sequence[npt.NDArray[np.float64]] = (),
    band_outline: Sequence[npt.NDArray[np.float64]] = (),
    title: str = '',
) -> None:
    """
    Write a scan as seen from above, x (forward) up and y to the left.

    Parameters
    ----------
    ranges : ndarray of float, shape (N,)
        Ranges of a full turn, counter-clockwise from −π [m].
    path : Path
        PNG to write.
    arm_radius : float
        The camera's circle [m].
    outline : sequence of ndarray of float64, shape (K, 2)
        Polylines of the true room at the height of the camera, x and y [m]; none if it is not
        known.
    band_outline : sequence of ndarray of float64, shape (K, 2)
        The same at the edges of the scan's height band.
    title : str
        Heading.
    """
    azimuth = -np.pi + np.arange(ranges.size) * (2 * np.pi / ranges.size)
    known = np.isfinite(ranges)
    x, y = ranges[known] * np.cos(azimuth[known]), ranges[known] * np.sin(azimuth[known])
    figure, axes = plt.subplots(figsize=(9, 9), layout='constrained')
    for lines, colour, width, label in (
        (band_outline, '0.85', 1.5, "true room at the height band's edges"),
        (outline, '0.6', 2.5, 'true room'),
    ):
        for k, line in enumerate(lines):
            axes.plot(
                *(line[:, 1], line[:, 0]),
                color=colour,
                linewidth=width,
                label=label if k == 0 else None,
                zorder=1,
            )
    axes.scatter(y, x, s=7, color='tab:red', label='scan', zorder=3)
    circle = plt.Circle((0, 0), arm_radius, fill=False, color='tab:blue', label="camera's circle")
    axes.add_patch(circle)
    axes.plot(0, 0, '+', color='tab:blue', markersize=12)
    axes.invert_xaxis()
    axes.set_aspect('equal')
    axes.grid(alpha=0.3)
    axes.set_xlabel('y, left [m]')
    axes.set_ylabel('x, forward [m]')
    axes.set_title(title)
    axes.legend(loc='upper right')
    figure.savefig(path, dpi=110)
    plt.close(figure)
