"""Blocks of a growing pair: what decides about them, and how near they are to the truth."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from matching_scenes import noise_image, pair_of, shifted_pair, texture

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching.interface import grey_pair
from panodepth_ros.matching.progressive import (
    MARGIN,
    GrowingMatch,
    match_block,
    ready_columns,
)

ROWS, COLUMNS, CANDIDATES = 24, 480, 45


def disparity():
    x = 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    return np.tile(22.0 + 9.7 * np.sin(x), (ROWS, 1))


def images():
    rng = np.random.default_rng(1)
    return shifted_pair(texture(rng, ROWS, COLUMNS), disparity(), noise=1.0, rng=rng)


def seen_only(pair, seen):
    return [
        Panorama(eye.image, dataclasses.replace(
            eye.geometry, ray_angle=np.where(seen, eye.geometry.ray_angle, np.nan)
        ))
        for eye in pair
    ]  # fmt: skip


def grown(order, portion, pair):
    """Grow a match, ``portion`` columns at a time in this order; return it and its states."""
    growing, states = GrowingMatch(ROWS, COLUMNS), []
    for count in range(portion, COLUMNS + 1, portion):
        seen = np.zeros(COLUMNS, bool)
        seen[order[:count]] = True
        growing.add(*seen_only(pair, seen), threads=1)
        states.append((growing.ready.copy(), growing.matched.column_disparity.copy()))
    return growing, states


@pytest.mark.parametrize('direction', [1, -1])
def test_match_grows_with_what_was_seen_and_finds_the_disparity(direction):
    order = (np.arange(COLUMNS)[::direction] + 77) % COLUMNS
    growing, states = grown(order, 60, pair_of(*images(), CANDIDATES))
    before_last = states[-2][0]
    assert 0 < states[4][0].sum() < before_last.sum() < COLUMNS
    for (ready, found), (later_ready, later) in pairwise(states):
        assert (ready <= later_ready).all()
        assert np.isnan(found[:, ~ready]).all()
        assert np.array_equal(found[:, ready], later[:, ready], equal_nan=True)
    assert growing.ready.all()
    off = np.abs(growing.matched.column_disparity - disparity())
    assert np.isfinite(off).mean() > 0.95
    assert np.nanpercentile(off, 95) < 0.25
    assert np.nanmax(growing.matched.confidence) <= 1


def test_nothing_but_the_margins_decides_about_a_block():
    left, right = images()
    start, stop = 150, 230
    rng = np.random.default_rng(5)
    others = [noise_image(rng, ROWS, COLUMNS) for _ in range(2)]
    others[0][:, start - MARGIN : stop + MARGIN] = left[:, start - MARGIN : stop + MARGIN]
    needed = slice(start - MARGIN + 1, stop - 1 + MARGIN + CANDIDATES + 1)
    others[1][:, needed] = right[:, needed]
    full, other = (
        match_block(*pair_of(*pair, CANDIDATES), start, stop, noise=1.0, threads=1)
        for pair in ((left, right), others)
    )
    assert np.isfinite(full.confidence).mean() > 0.9
    assert np.array_equal(full.column_disparity, other.column_disparity, equal_nan=True)
    assert np.array_equal(full.confidence, other.confidence, equal_nan=True)
    # What decides is what readiness asks for.
    seen = np.zeros((2, COLUMNS), bool)
    seen[0, start - MARGIN : stop + MARGIN] = seen[1, needed] = True
    pair = grey_pair(*pair_of(left, right, CANDIDATES, left_seen=seen[0], right_seen=seen[1]))
    assert np.array_equal(np.flatnonzero(ready_columns(pair)), np.arange(start, stop))


def test_panorama_of_another_size_is_refused():
    growing = GrowingMatch(ROWS, COLUMNS - 1)
    with pytest.raises(ValueError, match=r'partial panorama is \(24, 480\) pixels; allowed: '):
        growing.add(*pair_of(*images(), CANDIDATES), threads=1)
