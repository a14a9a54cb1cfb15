"""The bytes that the semi-global matching adds up, against their definition."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import noise_image

from panodepth_ros.matching import semiglobal_costs as costs
from panodepth_ros.matching import semiglobal_paths

Bytes = npt.NDArray[np.uint8]

HEIGHT, WIDTH, CANDIDATES, LANES = 5, 12, 37, 64
FILLER = 130


def descriptor(grey: Bytes, y: int, x: int, margin: int) -> list[bool]:
    """Comparisons of the pixel (y, x) of the region, as the module says."""
    centre = int(grey[y + 3, x + 4])
    bits = []
    for j in range(-3, 4):
        for i in range(-4, 5):
            if i == j == 0:
                continue
            neighbour = int(grey[y + 3 + j, x + 4 + i])
            if (i + j) % 2 == 0:
                bits.append(neighbour > centre + margin)
            else:
                bits.append(neighbour < centre - margin)
    return bits


@pytest.mark.parametrize(('cut', 'doubled', 'margin'), [(30, True, 1), (60, False, 5)])
def test_costs_are_as_defined(cut: int, doubled: bool, margin: int) -> None:
    rng = np.random.default_rng(1)
    left = rng.integers(90, 160, (3, HEIGHT, WIDTH)).astype(np.uint8)
    right = rng.integers(90, 160, (3, HEIGHT, WIDTH + LANES)).astype(np.uint8)
    left_grey = noise_image(rng, HEIGHT + 6, WIDTH + 8)
    right_grey = noise_image(rng, HEIGHT + 6, WIDTH + LANES + 8)
    left_seen, right_seen = np.ones(WIDTH, bool), np.ones(WIDTH + LANES, bool)
    left_seen[4] = False
    right_seen[[9, 20, 21]] = False
    left_census = np.empty((8, HEIGHT, WIDTH), np.uint8)
    right_census = np.empty((8, HEIGHT, WIDTH + LANES), np.uint8)
    costs.census(left_grey, margin, left_census)
    costs.census(right_grey, margin, right_census)
    found = np.empty((WIDTH - 2, LANES), np.uint8)
    source = costs.PairCosts(
        left, right, left_census, right_census, left_seen, right_seen, cut, doubled
    )
    costs.pair_costs(source, 3, 2, FILLER, CANDIDATES, found)
    for x in range(2, WIDTH):
        for k in range(LANES):
            if not left_seen[x]:
                expected = 0
            elif k >= CANDIDATES:
                expected = FILLER
            elif not right_seen[x + k]:
                expected = costs.UNSEEN_COST
            else:
                there = right[:, 3, x + k].astype(int)
                colour = min(int(np.abs(left[:, 3, x] - there).sum()), cut)
                bits = zip(
                    descriptor(left_grey, 3, x, margin),
                    descriptor(right_grey, 3, x + k, margin),
                    strict=True,
                )
                expected = (2 if doubled else 1) * colour + sum(a != b for a, b in bits)
            if not left_seen[x] and k >= CANDIDATES:
                continue  # whatever fills the vectors
            assert found[x - 2, k] == expected, (x, k)


def test_costs_and_penalties_fit_into_bytes() -> None:
    assert costs.LARGEST_COST < semiglobal_paths.FILLER_COST
    assert costs.LARGEST_COST + semiglobal_paths.LARGE_PENALTY <= 255
    assert semiglobal_paths.FILLER_COST + semiglobal_paths.LARGE_PENALTY <= 255
    assert 2 * semiglobal_paths.LARGE_PENALTY <= 255  # two paths' L − C share a byte


def test_no_cost_exceeds_the_largest() -> None:
    rng = np.random.default_rng(2)
    extremes = rng.choice(np.array([0, 255], np.uint8), (3, 1, 80))
    census = rng.integers(0, 256, (8, 1, 80)).astype(np.uint8)
    census[7] &= 0b111111
    seen = np.ones(80, bool)
    found = np.empty((16, LANES), np.uint8)
    for cut, doubled in ((costs.LOW_NOISE_CUT, True), (costs.HIGH_NOISE_CUT, False)):
        source = costs.PairCosts(
            extremes[..., :16].copy(), extremes, census[..., :16].copy(), ~census, seen[:16],
            seen, cut, doubled,
        )  # fmt: skip
        costs.pair_costs(source, 0, 0, FILLER, LANES, found)
        assert found.max() <= costs.LARGEST_COST


@pytest.mark.parametrize('noise', [0.7, 1.5, 4.0])
def test_noise_is_estimated_in_spite_of_texture(noise: float) -> None:
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:100, 0:400]
    clean = 120 + 0.1 * x + 0.2 * y
    clean[30:60, 100:300] += 40 * np.sin(x[30:60, 100:300] / 2.0)
    grey = np.rint(clean + rng.normal(0, noise, clean.shape)).astype(np.uint8)
    seen = np.ones(400, bool)
    assert costs.grey_noise(grey, seen) == pytest.approx(noise, rel=0.2)
    # Columns that nobody saw, here without noise, do not count, nor where the panorama begins.
    seen[150:250] = False
    grey[:, ~seen] = 120
    found = costs.grey_noise(grey, seen)
    assert found == pytest.approx(noise, rel=0.2)
    assert costs.grey_noise(np.roll(grey, 37, axis=1), np.roll(seen, 37)) == found


def test_noise_has_steps_and_one_of_them_tells_strong_from_weak() -> None:
    noises = (0.4, 0.6, 1.3, 1.5, 1.8, 1.81, 2.4, 2.6, 4.9, 90.0)
    found = [costs.noise_step(noise) for noise in noises]
    assert found == [0.0, 1.0, 1.0, 1.8, 1.8, 2.0, 2.0, 3.0, 4.0, 32.0]


def test_a_clipped_image_has_no_noise_to_speak_of() -> None:
    assert costs.grey_noise(np.full((20, 40), 255, np.uint8), np.ones(40, bool)) == 0.0
