"""
Where to cut a panorama open, and into tiles, so that it does not depend on where columns begin.

Whatever is computed in such tiles, rolling the panoramas rolls the result, bit by bit. Where a
tile begins is decided by the columns around, as in content-defined chunking (Muthitacharoen et
al., "A low-bandwidth network file system", 2001): so tiles are known before the turn has ended.
"""

from __future__ import annotations

import zlib
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Keys = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
#: Columns start … stop − 1 with 0 ≤ start < W, which wrap around.
Side = tuple[int, int]


def column_keys(*layers: npt.NDArray[np.uint8]) -> Keys:
    """CRC-32 of what belongs to each column, shape (W,), of layers of shape (..., W)."""
    columns = layers[0].shape[-1]
    stacked = np.concatenate([layer.reshape(-1, columns) for layer in layers])
    crcs = [zlib.crc32(column) for column in np.ascontiguousarray(stacked.T)]
    return np.array(crcs, np.int64)


def canonical_seam(keys: Keys) -> int:
    """
    Column at which the lexicographically smallest rotation of the keys begins.

    If they are rolled by s, so is the answer, mod W, unless they repeat themselves within the
    turn.
    """
    columns = keys.size
    starts = np.flatnonzero(keys == keys.min())
    for offset in range(1, columns):
        if starts.size == 1:
            break
        ahead = keys[(starts + offset) % columns]
        starts = starts[ahead == ahead.min()]
    return int(starts[0])


def local_cuts(keys: Keys, seen: Mask, reach: int) -> Mask:
    """
    Columns, shape (W,), whose key is smaller than those of all seen ones within ``reach``.

    Parameters
    ----------
    keys : ndarray of int64, shape (W,)
        Of the columns, which wrap around.
    seen : ndarray of bool, shape (W,)
        Columns that count. No other one is a cut.
    reach : int
        To either side; less in a panorama that has not as many columns.
    """
    reach = min(reach, (keys.size - 1) // 2)
    keys = np.where(seen, keys, np.iinfo(np.int64).max)
    around = np.take(keys, np.arange(-reach, keys.size + reach), mode='wrap')
    least = np.lib.stride_tricks.sliding_window_view(around, reach).min(axis=1)
    return np.asarray((keys < least[: keys.size]) & (keys < least[reach + 1 :]))


def sides_of(cuts: Mask, widest: int, seam: int, known: Mask | None = None) -> list[Side]:
    """
    Cut a turn into sides.

    Parameters
    ----------
    cuts : ndarray of bool, shape (W,)
        Columns at which a side begins.
    widest : int
        Most columns of a side. Where cuts are farther apart, what is between is divided evenly.
    seam : int
        Where the first side begins if there is no cut.
    known : ndarray of bool, shape (W,), optional
        Columns of which it is certain whether they are cuts; sides that hang on others are left
        out.
    """
    begins = np.flatnonzero(cuts).tolist() or [seam]
    sides = []
    for begin, end in pairwise([*begins, begins[0] + cuts.size]):
        if known is not None and not np.take(known, range(begin, end + 1), mode='wrap').all():
            continue
        parts = -(-(end - begin) // widest)
        edges = [begin + round(part * (end - begin) / parts) for part in range(parts + 1)]
        sides += [(a % cuts.size, a % cuts.size + b - a) for a, b in pairwise(edges)]
    return sides


def seen_around(seen: Mask, first: int, last: int) -> Mask:
    """Whether the columns x + first … x + last, which wrap around, were all seen, for every x."""
    columns = seen.size
    reach = last - first + 1
    if reach >= columns:
        return np.full(columns, seen.all())
    before = np.concatenate([[0], np.cumsum(np.concatenate([seen, seen[: reach - 1]]))])
    return np.roll(before[reach:] - before[:columns] == reach, -first)
