"""The costs over all views, against their definition."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from panodepth_ros.matching import fusion_costs as fused
from panodepth_ros.matching.simd import WIDE

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]

HEIGHT, COUNT, CANDIDATES, LANES, FILLER = 3, 40, 37, 64, 130
#: Rows and columns of the views' images, columns of samples.
VIEW_ROWS, WIDTH, SAMPLES = 26, 128 + WIDE + 3, 128
#: Weights in quarter columns between whole ones (Catmull and Rom).
TAPS = np.array([[0, 128, 0, 0], [-9, 111, 29, -3], [-8, 72, 72, -8], [-3, 29, 111, -9]])


def sampled(image: Bytes, fine: int, phase: int) -> Integers:
    """Half row ``fine`` of a channel from column 1 on, so many quarters of a column on."""
    upper, lower = (image[row].astype(int) for row in (fine // 2, (fine + 1) // 2))
    mean = (upper + lower + 1) // 2
    taps = sum(TAPS[phase, tap] * mean[tap : tap + WIDTH - 3] for tap in range(4))
    return np.clip((taps + 64) // 128, 0, 255)


def descriptor(window: Integers, margin: int) -> list[bool]:
    """Comparisons of the middle of 7 × 9 grey levels with the columns one and three away."""
    bits = []
    for j in range(7):
        for i in (1, 3, 5, 7):
            above, below = window[3, 4] + margin, window[3, 4] - margin
            bits.append(window[j, i] > above if (i + j) % 2 else window[j, i] < below)
    return bits


def differing(one: Integers, other: Integers, margin: int) -> int:
    pairs = zip(descriptor(one, margin), descriptor(other, margin), strict=True)
    return sum(a != b for a, b in pairs)


@pytest.mark.parametrize(('cut', 'doubled', 'margin'), [(30, True, 1), (60, False, 5)])
def test_costs_are_as_defined(cut: int, doubled: bool, margin: int) -> None:
    rng = np.random.default_rng(1)
    left_wide = COUNT + 2 * WIDE - COUNT % WIDE
    left = rng.integers(118, 132, (3, HEIGHT, left_wide)).astype(np.uint8)
    grey = rng.integers(110, 140, (HEIGHT + 6, left_wide + 8)).astype(np.uint8)
    census = np.empty((fused.CENSUS_PLANES, HEIGHT, left_wide), np.uint8)
    fused.short_census(grey, margin, census)
    slack = rng.integers(0, 12, (HEIGHT, left_wide)).astype(np.uint8)
    left_seen = np.ones(left_wide, bool)
    left_seen[4] = False
    images = rng.integers(118, 132, (2, 4, VIEW_ROWS, WIDTH)).astype(np.uint8)
    seen = np.ones((2, fused.PHASES, SAMPLES), bool)
    seen[1, 2, 20:30] = False
    columns = np.stack([np.arange(CANDIDATES), 3 * np.arange(CANDIDATES)]).astype(np.int16)
    rows = rng.integers(0, 9, (2, HEIGHT, CANDIDATES)).astype(np.int16)
    rows += np.array([[0], [12], [24]], np.int16)  # the rings turn
    weights = np.array([200, 414], np.uint16)
    source = fused.ViewCosts(
        left=left,
        left_census=census,
        slack=slack,
        left_seen=left_seen,
        images=images,
        seen=seen,
        columns=columns,
        rows=rows,
        weights=weights,
        noise=margin,
        cut=cut,
        doubled=doubled,
        samples=np.empty((2, 16, fused.PHASES, fused.PLANES, SAMPLES), np.uint8),
        held=np.full((2, 16, fused.PHASES), -1, np.int32),
        greys=np.empty((2, 32, fused.PHASES, SAMPLES + WIDE), np.uint8),
        held_greys=np.full((2, 32, fused.PHASES), -1, np.int32),
    )
    memory = np.empty((COUNT - 2 + WIDE, LANES), np.uint8)
    found = memory[: COUNT - 2]
    for y in range(HEIGHT):
        fused.fused_costs(source, y, 2, FILLER, CANDIDATES, found)
        assert not found[4 - 2].any()
        assert np.all(np.delete(found, 4 - 2, axis=0)[:, CANDIDATES:] == FILLER)
        for k in range(CANDIDATES):
            total = np.zeros(COUNT, np.int64)
            for v in range(2):
                fine, (start, phase) = int(rows[v, y, k]), divmod(int(columns[v, k]), 4)
                colours = [sampled(images[v, c], fine + 6, phase)[4:] for c in range(3)]
                levels = np.stack([sampled(images[v, 3], fine + 2 * j, phase) for j in range(7)])
                for x in range(2, COUNT):
                    there = start + x
                    colour = sum(abs(int(left[c, y, x]) - colours[c][there]) for c in range(3))
                    if v == 0:  # the last view has the left panorama's rows
                        colour = max(colour - int(slack[y, x]), 0)
                    colour = min(colour, cut) * (2 if doubled else 1)
                    here = grey[y : y + 7, x : x + 9].astype(int)
                    bits = differing(here, levels[:, there : there + 9], margin)
                    cost = min(colour + bits, fused.CUT)
                    if not seen[v, phase, there]:
                        cost = fused.UNSEEN
                    total[x] += weights[v] * cost
            expected = np.delete(total // 256, [0, 1, 4])
            np.testing.assert_array_equal(np.delete(found[:, k], 4 - 2), expected)


def test_a_mean_of_what_views_can_say_at_most_is_below_the_fillers() -> None:
    assert fused.WEIGHTS * fused.CUT < 2**16
    assert fused.WEIGHTS * fused.CUT // 256 < FILLER
