"""
Normalised correlation of windows on two panoramas, in exact integers.

For a left pixel (y, x) and a candidate d the window sums over the rows y−4 … y+4 and columns
x−4 … x+4 are N, Σl, Σr, Σl², Σr², Σlr, and

    ρ = (N·Σlr − Σl·Σr) / √((N·Σl² − (Σl)²)·(N·Σr² − (Σr)²)).

Grey levels are centred to −128 … 127, which changes nothing in ρ and lets every sum fit into 32
bits. Rows outside the image do not count: windows are clipped at the top and at the bottom.
Columns that were not seen on either panorama do not count either; a window needs both centres
and more than half of its columns.

Loops run over candidates inside, columns next, rows outside. ``column_sums`` holds Σlr of each
window column for all candidates; a row adds the products that come in below and takes away
those that leave above. Score and candidate share one integer, so that one maximum serves as
the best candidate of a left and, with the same numbers, of a right pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import float32, int16, int32

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.interface import WINDOW_HALF_WIDTH, GreyPair

Int16Array = npt.NDArray[np.int16]
Int32Array = npt.NDArray[np.int32]
Float32Array = npt.NDArray[np.float32]

N = WINDOW_HALF_WIDTH
WIDTH = 2 * N + 1
#: Columns of a tile; its column sums stay in the second-level cache.
TILE_COLUMNS = 128
#: Candidates are padded to a multiple of this, whole vector registers.
LANES = 32
#: Score of ρ = 1 with the candidate's number below it; leaves a bit of room in 32 bits.
SCORE_BITS = 29
#: A window needs this many seen columns.
MINIMAL_COLUMNS = N + 1


@dataclass(frozen=True, eq=False, slots=True)
class PaddedPair:
    """
    Grey levels with borders, so that kernels need no case distinctions.

    Attributes
    ----------
    left : ndarray of int16, shape (H + 2n + 2, W + 2n)
        Centred grey levels, 0 outside the image and where unseen; wraps around. Row y of the
        image is row y + n + 1, column x is column x + n.
    right : ndarray of int16, shape (H + 2n + 2, W + M + 2n)
        The same; column x + d of ``right`` is what candidate number d compares with column x of
        ``left``.
    left_seen, right_seen : ndarray of int32, shapes (W + 2n,) and (W + M + 2n,)
        1 where seen, else 0.
    first, candidates, lanes : int
        Smallest disparity, number of disparities, the same padded to whole vectors (M).
    """

    left: Int16Array
    right: Int16Array
    left_seen: Int32Array
    right_seen: Int32Array
    first: int
    candidates: int
    lanes: int

    @property
    def rows(self) -> int:
        """H."""
        return int(self.left.shape[0]) - WIDTH - 1

    @property
    def columns(self) -> int:
        """W."""
        return int(self.left.shape[1]) - WIDTH + 1


def pad(pair: GreyPair) -> PaddedPair:
    """Return the pair with wrapped columns and empty rows around it."""
    columns = pair.left.shape[1]
    candidates = pair.last - pair.first + 1
    lanes = -(-candidates // LANES) * LANES
    left_columns = np.arange(-N, columns + N) % columns
    right_columns = np.arange(pair.first - N, pair.first + columns + lanes + N) % columns
    return PaddedPair(
        left=_centred(pair.left, pair.left_seen, left_columns),
        right=_centred(pair.right, pair.right_seen, right_columns),
        left_seen=pair.left_seen[left_columns].astype(np.int32),
        right_seen=pair.right_seen[right_columns].astype(np.int32),
        first=pair.first,
        candidates=candidates,
        lanes=lanes,
    )


def _centred(
    grey: npt.NDArray[np.uint8], seen: npt.NDArray[np.bool_], columns: npt.NDArray[np.int64]
) -> npt.NDArray[np.int16]:
    rows = grey.shape[0]
    centred = np.zeros((rows + WIDTH + 1, columns.size), np.int16)
    centred[N + 1 : N + 1 + rows] = grey[:, columns]
    centred[N + 1 : N + 1 + rows] -= 128
    centred[:, ~seen[columns]] = 0
    return centred


def candidate_codes(candidates: int, lanes: int) -> Int32Array:
    """
    What is added to a shifted score so that it names its candidate.

    The code of candidate number d is lanes − 1 − d: of equal scores the smallest disparity
    wins. Candidates that only fill up a vector can never win.
    """
    codes = np.arange(lanes - 1, -1, -1, dtype=np.int32)
    codes[candidates:] = -(2**30)
    return codes


@kernel
def inverse_deviation(count: int, total: int, squares: int) -> float:
    """1/√(N·Σv² − (Σv)²), 0 for a window without texture."""
    variance = count * squares - total * total
    if variance <= 0:
        return float32(0)  # type: ignore[no-any-return]  # numba's types are not typed
    return float32(1 / np.sqrt(np.float64(variance)))  # type: ignore[no-any-return]  # as above


@kernel
def clipped_rows(row: int, rows: int) -> int:
    """Rows of the window around a row that lie in the image."""
    return min(row + N, rows - 1) - max(row - N, 0) + 1


@kernel
def move_down(padded: Int16Array, row: int, totals: Int32Array, squares: Int32Array) -> None:
    """Move the column sums Σv and Σv², shape (columns,), from the window of row − 1 to row."""
    for x in range(padded.shape[1]):
        new, old = int32(padded[row + WIDTH, x]), int32(padded[row, x])
        totals[x] += new - old
        squares[x] += new * new - old * old


@kernel
def window_statistics(
    padded: Int16Array, rows: int, start: int, stop: int
) -> tuple[Int32Array, Float32Array]:
    """
    Σv and 1/√(N·Σv² − (Σv)²) of all windows on the rows start … stop − 1.

    Columns count whether seen or not: where a window touches an unseen column the values are
    meaningless, and ``score_masked`` does without them.
    """
    columns = padded.shape[1] - 2 * N
    totals = np.empty((stop - start, columns), np.int32)
    inverses = np.empty((stop - start, columns), np.float32)
    column_totals = np.zeros(padded.shape[1], np.int32)
    column_squares = np.zeros(padded.shape[1], np.int32)
    for y in range(start, start + WIDTH):
        for x in range(padded.shape[1]):
            value = int32(padded[y, x])
            column_totals[x] += value
            column_squares[x] += value * value
    for y in range(start, stop):
        move_down(padded, y, column_totals, column_squares)
        count = WIDTH * clipped_rows(y, rows)
        total, squares = int32(0), int32(0)
        for x in range(2 * N):
            total += column_totals[x]
            squares += column_squares[x]
        for x in range(columns):
            total += column_totals[x + 2 * N]
            squares += column_squares[x + 2 * N]
            totals[y - start, x] = total
            inverses[y - start, x] = inverse_deviation(count, total, squares)
            total -= column_totals[x]
            squares -= column_squares[x]
    return totals, inverses


@kernel
def add_products(
    sums: Int32Array, at: int, new: int, below: int, old: int, above: int,
    right: Int16Array, lanes: int,
) -> None:  # fmt: skip
    """Move one window column down: add l·r of the row below, take away l·r of the row above."""
    for d in range(lanes):
        added = int16(new * right[below + d])
        taken = int16(old * right[above + d])
        sums[at + d] += int32(int16(added - taken))


@kernel
def slide(cross: Int32Array, sums: Int32Array, entering: int, leaving: int, lanes: int) -> None:
    """Move the window right: add the column that enters, take away the one that leaves."""
    for d in range(lanes):
        cross[d] += sums[entering + d] - sums[leaving + d]


@kernel
def score(
    cross: Int32Array, count: int, left_total: int, left_inverse: float,
    right_totals: Int32Array, right_inverses: Float32Array, right_at: int,
    codes: Int32Array, shift: int, right_best: Int32Array, best_at: int, lanes: int,
) -> int:  # fmt: skip
    """Score all candidates of a left pixel: its best, and the bests of the right pixels."""
    best = int32(0)
    for d in range(lanes):
        covariance = int32(count * cross[d]) - int32(left_total * right_totals[right_at + d])
        rho = float32(float32(int32(covariance)) * right_inverses[right_at + d]) * left_inverse
        named = int32(int32(int32(rho) << shift) + codes[d])
        right_best[best_at + d] = max(right_best[best_at + d], named)
        best = max(best, named)
    return best  # type: ignore[no-any-return]  # numba's types are not typed


@kernel
def vertex(before: float, peak: float, after: float) -> float:
    """Where between its neighbours a parabola through three scores peaks, −0.5 … 0.5."""
    curvature = before - 2 * peak + after
    if peak < before or peak < after or curvature >= 0:
        return 0.0
    return (before - after) / (2 * curvature)
