"""
How probable it is that a disparity is right within one column: a logistic regression.

What it looks at is dimensionless or in columns and was chosen on generated rooms: the margin of
the winner over the next best candidate, the agreement of both eyes, the agreement with the
neighbours near and farther (a speckle has none), the agreement with those of them that have the
same colour (the rest of a thin board agrees, what is behind it need not), and how well the
window determines the fraction. ``tools/fit_confidence.py`` prints the coefficients.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import int32, uint8

from panodepth_ros.matching.compiled import kernel

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Seen = npt.NDArray[np.bool_]

#: Half width and stride of the neighbourhoods whose agreement counts [pixels].
NEAR, NEAR_STRIDE = 2, 1
FAR, FAR_STRIDE = 6, 2
#: Half height and half width of the neighbourhood of like colour, stride along its rows [pixels].
ALIKE_ROWS, ALIKE_COLUMNS, ALIKE_STRIDE = 3, 12, 2
#: Colours are alike if no channel differs by more [grey levels].
ALIKE = 15
#: Candidate of a pixel on which the eyes disagree: far from all others.
DISAGREES = 30000
#: Names of what the regression looks at, in the order of the coefficients.
FEATURES = (
    'margin', 'margin²', 'eyes agree', 'eyes differ by 1', 'eyes differ by 2', 'near', 'near²',
    'far', 'far²', 'fraction', 'weight', 'margin · far', 'alike', 'alike²',
    'margin · alike', '1',
)  # fmt: skip
COEFFICIENTS = np.array(
    [-0.7561, 0.0938, 0.1010, 0.0713, 0.1368, 1.6968, -0.2543, 0.2231, -0.2443, -0.2352, -0.0564,
     0.2487, 4.7670, -1.5373, 0.2170, -1.9079]
)  # fmt: skip


@kernel
def agreement(
    best: npt.NDArray[np.int16], agreed: npt.NDArray[np.int16], start: int, stop: int,
    half: int, stride: int, out: Float32Array,
) -> None:  # fmt: skip
    """
    Share of the neighbours that have the same disparity within one column.

    Parameters
    ----------
    best : ndarray of int16, shape (H, W)
        Candidate of each pixel.
    agreed : ndarray of int16, shape (H + 2·FAR, W + 2·ALIKE_COLUMNS)
        The same with a border, ``DISAGREES`` where it must not count.
    start, stop : int
        Rows to handle.
    half, stride : int
        Neighbourhood: offsets −half, −half + stride … half, without the pixel itself.
    out : ndarray of float32, shape (stop − start, W)
        Receives the share, 0 … 1.
    """
    columns = best.shape[1]
    share = np.float32(1 / ((2 * half // stride + 1) ** 2 - 1))
    votes = np.empty(columns, np.int16)
    for y in range(start, stop):
        here = best[y]
        votes[:] = 0
        for j in range(-half, half + 1, stride):
            for i in range(-half, half + 1, stride):
                if j == 0 and i == 0:
                    continue
                first = ALIKE_COLUMNS + i
                there = agreed[y + FAR + j, first : first + columns]
                for x in range(columns):
                    votes[x] += np.int16(abs(np.int16(there[x] - here[x])) <= 1)
        for x in range(columns):
            out[y - start, x] = share * np.float32(votes[x])


@kernel
def agreement_in_colour(
    best: npt.NDArray[np.int16], agreed: npt.NDArray[np.int16], image: Bytes, seen: Seen,
    start: int, stop: int, out: Float32Array,
) -> None:  # fmt: skip
    """
    Share of the neighbours of like colour that have the same disparity within one column.

    Parameters
    ----------
    best, agreed : ndarray of int16
        As in :func:`agreement`.
    image : ndarray of uint8, shape (3, H, W + 2·ALIKE_COLUMNS)
        Colours, with a border.
    seen : ndarray of bool, shape (W + 2·ALIKE_COLUMNS,)
        Columns that a frame saw, with a border.
    start, stop : int
        Rows to handle.
    out : ndarray of float32, shape (stop − start, W)
        Receives the share, 0 … 1; one more that does not agree is counted in, so that few
        neighbours say less than many.
    """
    rows, columns = best.shape
    side = ALIKE_COLUMNS
    core = slice(side, side + columns)
    votes, alike = np.empty(columns, np.uint8), np.empty(columns, np.uint8)
    for y in range(start, stop):
        here = best[y]
        blue, green, red = image[0, y, core], image[1, y, core], image[2, y, core]
        votes[:] = uint8(0)
        alike[:] = uint8(0)
        for j in range(-ALIKE_ROWS, ALIKE_ROWS + 1):
            other = min(max(y + j, 0), rows - 1)
            for i in range(0, 2 * side + 1, ALIKE_STRIDE):
                if j == 0 and i == side:
                    continue
                there = agreed[y + FAR + j, i : i + columns]
                there_too = slice(i, i + columns)
                blues, greens, reds = (
                    image[0, other, there_too],
                    image[1, other, there_too],
                    image[2, other, there_too],
                )
                usable = seen[there_too]
                for x in range(columns):
                    b = uint8(max(blue[x], blues[x]) - min(blue[x], blues[x]))
                    g = uint8(max(green[x], greens[x]) - min(green[x], greens[x]))
                    r = uint8(max(red[x], reds[x]) - min(red[x], reds[x]))
                    same = uint8(max(b, g, r) <= uint8(ALIKE)) & uint8(usable[x])
                    alike[x] += same
                    votes[x] += same & uint8(abs(np.int16(there[x] - here[x])) <= 1)
        for x in range(columns):
            out[y - start, x] = np.float32(votes[x]) / np.float32(int32(alike[x]) + 1)


def features(
    margin: npt.NDArray[np.uint16], eyes: npt.NDArray[np.integer], near: Float32Array,
    far: Float32Array, alike: Float32Array, fraction: Float32Array, weight: Float32Array,
) -> list[Float32Array]:  # fmt: skip
    """
    What the regression looks at, in the order of ``FEATURES`` without the constant.

    Parameters
    ----------
    margin : ndarray of uint16, shape (...)
        Aggregated cost of the next best candidate minus that of the winner.
    eyes : ndarray of int, shape (...)
        By how many columns the right pixel's winner differs.
    near, far, alike : ndarray of float32, shape (...)
        Agreement with the neighbours and with those of like colour, 0 … 1.
    fraction, weight : ndarray of float32, shape (...)
        What ``refinement.locate`` found.
    """
    log_margin = np.log1p(margin.astype(np.float32))
    one = np.float32(1)
    return [
        log_margin,
        log_margin**2,
        one * (eyes == 0),
        one * (eyes == 1),
        one * (eyes == 2),
        near,
        near**2,
        far,
        far**2,
        np.abs(fraction),
        np.log(weight + np.float32(0.01)),
        log_margin * far,
        alike,
        alike**2,
        log_margin * alike,
    ]


def probability(
    values: list[Float32Array], coefficients: npt.NDArray[np.float64] = COEFFICIENTS
) -> Float32Array:
    """Logistic function of the weighted features, in (0, 1)."""
    exponent = np.full(values[0].shape, coefficients[-1], np.float32)
    for coefficient, value in zip(coefficients[:-1], values, strict=True):
        exponent += np.float32(coefficient) * value
    return np.asarray(1 / (1 + np.exp(-exponent)), np.float32)
