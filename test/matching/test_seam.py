"""The seam and the cuts follow the content."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from panodepth_ros.matching.seam import (
    canonical_seam,
    column_keys,
    local_cuts,
    seen_around,
    sides_of,
)


@pytest.mark.parametrize('rolled', [0, 1, 17, 59])
def test_seam_rolls_with_the_panoramas(rolled: int) -> None:
    rng = np.random.default_rng(1)
    # Few different columns, so that many share the smallest key and the next ones must decide.
    columns = rng.integers(0, 256, (6, 3)).astype(np.uint8)
    left = columns[:, rng.integers(0, 3, 60)]
    right = columns[:, rng.integers(0, 3, 60)]
    here = canonical_seam(column_keys(left, right))
    rolled_layers = [np.roll(layer, rolled, axis=1) for layer in (left, right)]
    assert canonical_seam(column_keys(*rolled_layers)) == (here + rolled) % 60


def test_every_layer_counts() -> None:
    plain, marked = np.zeros((2, 4, 50), np.uint8)
    marked[2, 33] = 1
    moved = np.roll(marked, 5, axis=1)
    # The plain layer looks the same when rolled: only the mark can move the seam.
    for here, there in (((plain, marked), (plain, moved)), ((marked, plain), (moved, plain))):
        found = canonical_seam(column_keys(*there))
        assert found == (canonical_seam(column_keys(*here)) + 5) % 50


def test_a_panorama_without_content_has_a_seam_but_no_cut() -> None:
    keys = column_keys(np.zeros((4, 50), np.uint8))
    assert canonical_seam(keys) == 0
    cuts = local_cuts(keys, np.ones(50, bool), 8)
    assert not cuts.any()
    assert sides_of(cuts, 20, 7) == [(7, 17 + 7), (24, 33 + 7), (40, 57)]


def cut(keys: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    return sides_of(local_cuts(keys, seen, 8), 20, 0)


def test_sides_cover_the_turn_once_roll_with_it_and_are_no_wider_than_allowed() -> None:
    rng = np.random.default_rng(2)
    keys, seen = rng.integers(0, 1000, 400), rng.random(400) < 0.95
    sides = cut(keys, seen)
    counts = np.zeros(400, int)
    for start, stop in sides:
        assert 0 <= start < 400
        assert 9 <= stop - start <= 20 or (stop - start) * 2 > 9
        counts[np.arange(start, stop) % 400] += 1
    assert (counts == 1).all()
    assert len(sides) < 60
    rolled = cut(np.roll(keys, 123), np.roll(seen, 123))
    moved = {((start + 123) % 400, (start + 123) % 400 + stop - start) for start, stop in sides}
    assert set(rolled) == moved


def test_cuts_are_smaller_than_all_seen_columns_within_reach() -> None:
    keys = np.full(100, 50)
    keys[[10, 18, 27, 60, 69]] = [3, 2, 1, 7, 7]
    seen = np.ones(100, bool)
    assert np.flatnonzero(local_cuts(keys, seen, 8)).tolist() == [18, 27, 60, 69]
    assert np.flatnonzero(local_cuts(keys, seen, 9)).tolist() == [27]
    seen[[27, 60]] = False
    assert np.flatnonzero(local_cuts(keys, seen, 9)).tolist() == [18, 69]
    # In a panorama with fewer columns all of them count.
    assert np.flatnonzero(local_cuts(keys, seen, 80)).tolist() == [18]


def test_sides_of_a_growing_turn_are_those_of_the_whole_turn() -> None:
    rng = np.random.default_rng(3)
    keys, everything = rng.integers(0, 1000, 400), np.ones(400, bool)
    whole, before = set(cut(keys, everything)), 0
    for count in range(20, 400, 20):
        seen = np.roll(np.arange(400) < count, 300)
        known = seen_around(seen, -8, 8)
        sides = sides_of(local_cuts(keys, seen, 8), 20, 0, known)
        assert set(sides) <= whole
        assert len(sides) >= before
        before = len(sides)
    assert before > len(whole) - 5
