"""
From winners to sub-column disparities and probabilities, block of columns by block.

What only columns nearby decide is done for a block as soon as they are there; what runs along
whole rows comes last (``smoothed``). The blocks do not show.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panodepth_ros.matching import confidence, refinement
from panodepth_ros.matching.aggregation import Winners
from panodepth_ros.matching.colour_pair import ColourPair, Scalar, put, wrapped
from panodepth_ros.matching.seam import Side

Bytes = npt.NDArray[np.uint8]
Float32Array = npt.NDArray[np.float32]
Locate = Callable[['Block', int, int, Float32Array, Float32Array], None]

#: Rows that one call of the kernels handles, of a block and of the panorama.
BLOCK_ROWS, ROW_BAND = 64, 8
#: Columns beyond either end along which a row is smoothed.
SMOOTHING_OVERLAP = 64
#: Candidate of columns that were not seen: far from all others.
UNSEEN_STEP = -30000


@dataclass(frozen=True, eq=False, slots=True)
class Estimates:
    """
    Disparities on their way, shape (H, W).

    Attributes
    ----------
    disparity : ndarray of float32
        Smoothed along the columns.
    weight : ndarray of float32
        How much each counts along the rows.
    probability : ndarray of float32
        That it is right within one column; 0 where an eye did not see, or another candidate does
        as well.
    """

    disparity: Float32Array
    weight: Float32Array
    probability: Float32Array

    @classmethod
    def none(cls, rows: int, columns: int) -> Estimates:
        """Nothing estimated yet."""
        disparity, probability = np.zeros((2, rows, columns), np.float32)
        return cls(disparity, np.ones((rows, columns), np.float32), probability)

    def copy(self) -> Estimates:
        """The same, to go on with another way."""
        return Estimates(self.disparity.copy(), self.weight.copy(), self.probability.copy())


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """
    What the kernels of ``refinement`` and ``confidence`` read of some columns, with borders.

    Attributes
    ----------
    start : int
        Its first column.
    left, right, winners : ndarray of uint8, uint8, uint16
        See ``refinement.locate``.
    best, agreed : ndarray of int16
        See ``confidence.agreement``.
    colours, seen : ndarray of uint8, bool
        See ``confidence.agreement_in_colour``.
    margin, eyes : ndarray of uint16, uint8, shape (H, w)
        See ``confidence.features``.
    """

    start: int
    left: Bytes
    right: Bytes
    winners: npt.NDArray[np.uint16]
    best: npt.NDArray[np.int16]
    agreed: npt.NDArray[np.int16]
    colours: Bytes
    seen: npt.NDArray[np.bool_]
    margin: npt.NDArray[np.uint16]
    eyes: Bytes


def block_of(pair: ColourPair, winners: Winners, start: int, stop: int) -> Block:
    """Cut the columns start … stop − 1 out, with their borders."""
    half, wide = refinement.HALF_WINDOW, confidence.ALIKE_COLUMNS
    core = slice(wide, wide + stop - start)
    last = stop + pair.first + pair.candidates + half
    seen = wrapped(pair.left_seen, start - wide, stop + wide)
    best = wrapped(winners.best, start - wide, stop + wide)
    eyes = winners.eyes(pair.first, start - wide, stop + wide)
    steps = best.astype(np.int16)
    steps[:, ~seen] = UNSEEN_STEP
    agreed = np.where(eyes <= 1, steps, np.int16(confidence.DISAGREES))
    agreed[:, ~seen] = confidence.DISAGREES
    return Block(
        start=start,
        left=_taller(wrapped(pair.left_grey, start - half, stop + half), half),
        right=_taller(wrapped(pair.right_grey, start + pair.first - half - 1, last), half),
        winners=np.ascontiguousarray(best[:, core]),
        best=np.ascontiguousarray(steps[:, core]),
        agreed=_taller(agreed, confidence.FAR),
        colours=wrapped(pair.left, start - wide, stop + wide),
        seen=seen,
        margin=wrapped(winners.margin, start, stop),
        eyes=np.ascontiguousarray(eyes[:, core]),
    )


def _taller(image: npt.NDArray[Scalar], border: int) -> npt.NDArray[Scalar]:
    """Image with its first and last row repeated."""
    return np.pad(image, ((border, border), (0, 0)), mode='edge')


def evidence(
    block: Block, start: int, stop: int, locate: Locate | None = None
) -> tuple[list[Float32Array], Float32Array, Float32Array]:
    """
    Features of ``confidence`` of the block's rows start … stop − 1, fractions and weights.

    ``locate`` stands in for ``refinement.locate``, from block and rows to fraction and weight.
    """
    shape = stop - start, block.best.shape[1]
    fraction, weight, near, far, alike = (np.empty(shape, np.float32) for _ in range(5))
    if locate is None:
        refinement.locate(block.left, block.right, block.winners, start, stop, fraction, weight)
    else:
        locate(block, start, stop, fraction, weight)
    for half, stride, out in (
        (confidence.NEAR, confidence.NEAR_STRIDE, near),
        (confidence.FAR, confidence.FAR_STRIDE, far),
    ):
        confidence.agreement(block.best, block.agreed, start, stop, half, stride, out)
    confidence.agreement_in_colour(
        block.best, block.agreed, block.colours, block.seen, start, stop, alike
    )
    margin, eyes = block.margin[start:stop], block.eyes[start:stop]
    values = confidence.features(margin, eyes, near, far, alike, fraction, weight)
    return values, fraction, weight


def evaluate(
    pair: ColourPair,
    winners: Winners,
    pool: ThreadPoolExecutor,
    estimates: Estimates,
    sides: Iterable[Side],
    *,
    locate: Locate | None = None,
    coefficients: npt.NDArray[np.float64] = confidence.COEFFICIENTS,
) -> None:
    """
    Estimate what only columns nearby decide, for some columns.

    Parameters
    ----------
    pair, winners
        Of the pair; of the winners, what lies within ``ALIKE_COLUMNS`` and whatever is compared
        with the same right columns counts.
    pool : ThreadPoolExecutor
        Shares the blocks.
    estimates : Estimates
        Receives them.
    sides : iterable of Side
        Columns of the blocks.
    locate, coefficients
        See :func:`evidence` and ``confidence.probability``.
    """
    everything_seen = bool(pair.right_seen.all())
    rows = winners.best.shape[0]

    def run(side: Side) -> None:
        start, stop = side
        block = block_of(pair, winners, start, stop)
        shape = rows, stop - start
        disparity, weight, probability = (np.empty(shape, np.float32) for _ in range(3))
        for top in range(0, rows, BLOCK_ROWS):
            band = slice(top, min(top + BLOCK_ROWS, rows))
            values, fraction, certainty = evidence(block, band.start, band.stop, locate)
            promised = confidence.probability(values, coefficients)
            best = block.winners[band]
            disparity[band] = fraction + best + np.float32(pair.first)
            weight[band] = certainty * promised**2 + np.float32(refinement.LEAST_WEIGHT)
            if not everything_seen:
                promised[~pair.right_seen[pair.partners(best, start, stop)]] = 0
            promised[block.margin[band] == 0] = 0  # a tie, as in what is overexposed or black
            probability[band] = promised
        image = wrapped(pair.left, start, stop)
        refinement.smooth_columns(disparity, weight, block.best, image)
        probability[:, ~wrapped(pair.left_seen, start, stop)] = 0
        for whole, part in (
            (estimates.disparity, disparity),
            (estimates.weight, weight),
            (estimates.probability, probability),
        ):
            put(whole, start, part)

    for _ in pool.map(run, sides):
        pass


def smoothed(
    pair: ColourPair, winners: Winners, estimates: Estimates, pool: ThreadPoolExecutor
) -> Float32Array:
    """Disparities of a pair after all else, smoothed along the rows, shape (H, W)."""
    rows, columns = winners.best.shape
    steps = winners.best.astype(np.int16)
    steps[:, ~pair.left_seen] = UNSEEN_STEP
    disparity = estimates.disparity.copy()
    overlap, seam = min(SMOOTHING_OVERLAP, columns), pair.seam

    def along_rows(start: int) -> None:
        stop = min(start + ROW_BAND, rows)
        refinement.hold(disparity, steps, pair.first, start, stop)
        refinement.smooth_rows(
            disparity, estimates.weight, steps, pair.left, start, stop, seam, overlap
        )
        refinement.hold(disparity, steps, pair.first, start, stop)

    for _ in pool.map(along_rows, range(0, rows, ROW_BAND)):
        pass
    return disparity
