"""A short film of the ground plan that grows while the arm turns."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.animation import PillowWriter

mpl.use('Agg')
from matplotlib import pyplot as plt

#: Pictures of a turn, those that hold the end, and pictures a second.
PICTURES, HELD, RATE = 45, 20, 10
_SIZE, _DPI = 4.8, 80
#: How far the plan reaches beyond what is drawn [m].
_MARGIN = 0.3


def decided_after(
    ranges: npt.NDArray[np.floating],
    *,
    arm_radius: float,
    principal_angle: float,
    begin: float,
    end: float,
) -> npt.NDArray[np.float64]:
    """
    How far the arm had turned when both eyes had seen what a beam meets.

    Parameters
    ----------
    ranges : ndarray of float, shape (N,)
        Ranges of a full turn, counter-clockwise from −π [m].
    arm_radius : float
        r [m].
    principal_angle : float
        φ [rad], > 0.
    begin, end : float
        Arm azimuths of the sweep [rad], not wrapped.

    Returns
    -------
    ndarray of float64, shape (N,)
        Turned since the begin [rad], ≥ 0, below a turn; NaN where the range is not finite.

    Notes
    -----
    A point at azimuth α and distance l is seen at the arm azimuths α ± (φ − asin(r·sin φ/l)).
    """
    azimuth = -np.pi + np.arange(ranges.size) * (2 * np.pi / ranges.size)
    known = np.where(np.isfinite(ranges), ranges, np.nan).astype(np.float64)
    with np.errstate(invalid='ignore'):
        aside = principal_angle - np.arcsin(arm_radius * np.sin(principal_angle) / known)
    side = np.sign(end - begin)
    turned = [side * (azimuth + eye * aside - begin) % (2 * np.pi) for eye in (1, -1)]
    return np.asarray(np.maximum(*turned))


def save_film(
    ranges: npt.NDArray[np.floating],
    path: Path,
    *,
    arm_radius: float,
    principal_angle: float,
    begin: float,
    end: float,
    duration: float,
    outline: Sequence[npt.NDArray[np.float64]] = (),
) -> None:
    """
    Write the film, x (forward) up and y to the left.

    Parameters
    ----------
    ranges, arm_radius, principal_angle, begin, end
        As for :func:`decided_after`.
    path : Path
        GIF to write.
    duration : float
        Of the sweep [s]; the film has a length of its own and tells this one.
    outline : sequence of ndarray of float64, shape (K, 2)
        Polylines of the true room, x and y [m]; none if it is not known.
    """
    after = decided_after(
        ranges, arm_radius=arm_radius, principal_angle=principal_angle, begin=begin, end=end
    )
    azimuth = -np.pi + np.arange(ranges.size) * (2 * np.pi / ranges.size)
    x, y = ranges * np.cos(azimuth), ranges * np.sin(azimuth)
    figure, axes = plt.subplots(figsize=(_SIZE, _SIZE), layout='constrained')
    for line in outline:
        axes.plot(line[:, 1], line[:, 0], color='0.75', linewidth=1.5)
    (points,) = axes.plot([], [], '.', color='tab:red', markersize=3)
    (rays,) = axes.plot([], [], color='tab:blue', linewidth=0.6)
    (arm,) = axes.plot([], [], 'o-', color='tab:blue', linewidth=2, markersize=5, markevery=[1])
    axes.add_patch(plt.Circle((0, 0), arm_radius, fill=False, color='0.6', linewidth=0.8))
    drawn = [np.column_stack([x, y])[np.isfinite(ranges)], *outline]
    reach = max((float(np.abs(line).max()) for line in drawn if line.size), default=1.0) + _MARGIN
    axes.set(xlim=(reach, -reach), ylim=(-reach, reach), aspect='equal')
    axes.set(xlabel='y, left [m]', ylabel='x, forward [m]')
    writer = PillowWriter(fps=RATE)
    with writer.saving(figure, str(path), dpi=_DPI):
        for share in [*np.linspace(0, 1, PICTURES), *[1.0] * HELD]:
            at = begin + share * (end - begin)
            with np.errstate(invalid='ignore'):
                seen = after <= abs(at - begin)
            if share == 1.0:
                seen = np.isfinite(after)  # the last columns lie within the stripe of a frame
            points.set_data(y[seen], x[seen])
            tip = arm_radius * np.array([np.cos(at), np.sin(at)])
            arm.set_data([0, tip[1]], [0, tip[0]])
            ends = [
                tip + 2 * reach * np.array([np.cos(at + eye), np.sin(at + eye)])
                for eye in (principal_angle, -principal_angle)
            ]
            way = np.array([ends[0], tip, ends[1]])
            rays.set_data(way[:, 1], way[:, 0])
            axes.set_title(f'{share * duration:.1f} s')
            writer.grab_frame()
    plt.close(figure)
