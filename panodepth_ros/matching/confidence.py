"""
How probable it is that a disparity is right within one column: a logistic regression.

What it looks at is dimensionless or in columns and was chosen on generated rooms: the margin of
the winner over the next best candidate, the agreement of both eyes, the agreement with the
neighbours near and farther (a speckle has none), and how well the window determines the
fraction. ``tools/fit_confidence.py`` prints the coefficients.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panodepth_ros.matching.compiled import kernel

Float32Array = npt.NDArray[np.float32]

#: Half width and stride of the neighbourhoods whose agreement counts [pixels].
NEAR, NEAR_STRIDE = 2, 1
FAR, FAR_STRIDE = 6, 2
#: Candidate of a pixel on which the eyes disagree: far from all others.
DISAGREES = 30000
#: Names of what the regression looks at, in the order of the coefficients.
FEATURES = (
    'margin', 'margin²', 'eyes agree', 'eyes differ by 1', 'eyes differ by 2', 'near', 'near²',
    'far', 'far²', 'fraction', 'weight', 'margin · far', '1',
)  # fmt: skip
COEFFICIENTS = np.array(
    [-0.7793, 0.0982, 0.5277, 0.5616, 0.7379, 3.4009, -1.1761, 0.9545, 0.3640, -0.3505, -0.0701,
     0.4124, -1.4807]
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
    agreed : ndarray of int16, shape (H + 2·FAR, W + 2·FAR)
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
                there = agreed[y + FAR + j, FAR + i : FAR + i + columns]
                for x in range(columns):
                    votes[x] += np.int16(abs(np.int16(there[x] - here[x])) <= 1)
        for x in range(columns):
            out[y - start, x] = share * np.float32(votes[x])


def features(
    margin: npt.NDArray[np.uint16], eyes: npt.NDArray[np.integer], near: Float32Array,
    far: Float32Array, fraction: Float32Array, weight: Float32Array,
) -> list[Float32Array]:  # fmt: skip
    """
    What the regression looks at, in the order of ``FEATURES`` without the constant.

    Parameters
    ----------
    margin : ndarray of uint16, shape (...)
        Aggregated cost of the next best candidate minus that of the winner.
    eyes : ndarray of int, shape (...)
        By how many columns the right pixel's winner differs.
    near, far : ndarray of float32, shape (...)
        Agreement with the neighbours, 0 … 1.
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
    ]


def probability(values: list[Float32Array]) -> Float32Array:
    """Logistic function of the weighted features, in (0, 1)."""
    exponent = np.full(values[0].shape, COEFFICIENTS[-1], np.float32)
    for coefficient, value in zip(COEFFICIENTS[:-1], values, strict=True):
        exponent += np.float32(coefficient) * value
    return np.asarray(1 / (1 + np.exp(-exponent)), np.float32)
