"""
Where to cut a panorama open so that the cut does not depend on which column comes first.

Anything may be computed in strips and tiles after that, and rolling the panoramas still rolls
the result, bit by bit.
"""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt


def canonical_seam(*layers: npt.NDArray[np.uint8]) -> int:
    """
    Column at which the lexicographically smallest rotation of the panoramas begins.

    Parameters
    ----------
    *layers : ndarray of uint8, shape (..., W)
        What belongs to the columns. If it is rolled along the last axis by s, so is the answer,
        mod W, unless the layers repeat themselves within the turn.

    Notes
    -----
    Columns are compared by their CRC-32. Only where several share the smallest one do the
    columns that follow decide.
    """
    columns = layers[0].shape[-1]
    stacked = np.concatenate([layer.reshape(-1, columns) for layer in layers])
    keys = np.array([zlib.crc32(column) for column in np.ascontiguousarray(stacked.T)])
    starts = np.flatnonzero(keys == keys.min())
    for offset in range(1, columns):
        if starts.size == 1:
            break
        ahead = keys[(starts + offset) % columns]
        starts = starts[ahead == ahead.min()]
    return int(starts[0])
