"""
Where to cut a panorama open, and into tiles, so that it does not depend on where columns begin.

Whatever is computed in such tiles, rolling the panoramas rolls the result, bit by bit. Where a
tile begins is decided by the columns around, as in content-defined chunking (Muthitacharoen et
al., "A low-bandwidth network file system", 2001): so tiles are known before the turn has ended.
"""

from __future__ import annotations

import zlib
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt

Keys = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
#: Columns start … stop − 1 with 0 ≤ start < W, which wrap around.
Side = tuple[int, int]
#: Columns to either side that a key depends on besides its own; edges count up to one less.
EDGE_REACH = 17
#: Difference of grey levels, two columns apart, from which on an edge counts no more.
EDGE_LEVELS = 32
#: Steps in which edges count: where there is enough of them everywhere, chance spreads the cuts.
EDGE_STEPS = 8


def column_keys(*layers: npt.NDArray[np.uint8]) -> Keys:
    """CRC-32 of what belongs to each column, shape (W,), of layers of shape (..., W)."""
    columns = layers[0].shape[-1]
    stacked = np.concatenate([layer.reshape(-1, columns) for layer in layers])
    crcs = [zlib.crc32(column) for column in np.ascontiguousarray(stacked.T)]
    return np.array(crcs, np.int64)


def texture_keys(grey: npt.NDArray[np.uint8], seen: Mask, keys: Keys) -> Keys:
    """
    Keys that are the smaller, the more rows have an edge near a column.

    A tile that ends there has in most rows what a plain surface takes its depth from.

    Parameters
    ----------
    grey : ndarray of uint8, shape (H, W)
        Grey levels.
    seen : ndarray of bool, shape (W,)
        Columns that count.
    keys : ndarray of int64, shape (W,)
        From 0 to 2³² − 1; decide where edges do not.

    Returns
    -------
    ndarray of int64, shape (W,)
        Depends on ``EDGE_REACH`` columns to either side.
    """
    columns = np.arange(-EDGE_REACH, keys.size + EDGE_REACH) % keys.size
    image, seen = grey[:, columns], seen[columns]
    steps = np.minimum(cv2.absdiff(image[:, 2:], image[:, :-2]), EDGE_LEVELS)
    steps[:, ~(seen[2:] & seen[:-2])] = 0
    nearby = cv2.dilate(steps, np.ones((1, 2 * EDGE_REACH - 1), np.uint8))
    edges = nearby[:, EDGE_REACH - 1 : 1 - EDGE_REACH].sum(axis=0, dtype=np.int64)
    share = EDGE_STEPS * edges // (EDGE_LEVELS * grey.shape[0])
    return np.asarray(keys - (share << 32), np.int64)


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


def sides_of(
    keys: Keys, cuts: Mask, widest: int, seam: int, known: Mask | None = None
) -> list[Side]:
    """
    Cut a turn into sides.

    Parameters
    ----------
    keys : ndarray of int64, shape (W,)
        Of the columns, which wrap around.
    cuts : ndarray of bool, shape (W,)
        Columns at which a side begins.
    widest : int
        Most columns of a side. Where cuts are farther apart, what is between is divided at the
        smallest keys, as evenly as that takes.
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
        freedom = (widest + (begin - end) // parts) // 2  # so that no part is too wide
        around = np.array(sorted(range(-freedom, freedom + 1), key=abs))
        edges = [begin]
        for part in range(1, parts):
            choice = begin + round(part * (end - begin) / parts) + around
            edges.append(int(choice[np.argmin(np.take(keys, choice, mode='wrap'))]))
        edges.append(end)
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
