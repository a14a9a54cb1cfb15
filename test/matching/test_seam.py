"""The seam and the cuts follow the content."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from panodepth_ros.matching.seam import (
    EDGE_REACH,
    canonical_seam,
    column_keys,
    local_cuts,
    seen_around,
    sides_of,
    texture_keys,
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
    assert sides_of(keys, cuts, 20, 7) == [(7, 17 + 7), (24, 33 + 7), (40, 57)]


def test_cuts_lie_beside_the_edges_of_most_rows() -> None:
    rng = np.random.default_rng(4)
    grey, seen = np.full((10, 400), 90, np.uint8), np.ones(400, bool)
    grey[:, 200] = 120  # all rows
    grey[:6, 70] = 120  # more than half of them
    grey[6:, 320] = 120
    keys = rng.integers(0, 2**32, 400)
    for rolled in (0, 195):
        found = texture_keys(np.roll(grey, rolled, axis=1), seen, np.roll(keys, rolled))
        order = (np.argsort(found) - rolled) % 400
        near = 2 * EDGE_REACH + 1
        assert (np.abs(order[:near] - 200) <= EDGE_REACH).all()
        assert (np.abs(order[near : 2 * near] - 70) <= EDGE_REACH).all()
        assert (np.abs(order[2 * near : 3 * near] - 320) <= EDGE_REACH).all()
        # Where nothing is to be seen the keys given decide.
        assert np.array_equal(np.roll(found, -rolled)[order[3 * near :]], keys[order[3 * near :]])


def test_what_was_not_seen_is_no_edge() -> None:
    grey, seen, keys = np.full((10, 100), 90, np.uint8), np.ones(100, bool), np.arange(100)
    grey[:, 40:50] = 0
    seen[40:50] = False
    assert np.array_equal(texture_keys(grey, seen, keys), keys)


def test_keys_depend_on_the_columns_within_reach_only() -> None:
    rng = np.random.default_rng(5)
    grey, seen, keys = rng.integers(0, 20, (10, 100), np.uint8), np.ones(100, bool), np.arange(100)
    before = texture_keys(grey, seen, keys)
    grey[:, 50] = 255
    changed = np.flatnonzero(texture_keys(grey, seen, keys) != before)
    assert [changed[0], changed[-1]] == [50 - EDGE_REACH, 50 + EDGE_REACH]


def test_what_is_too_wide_is_divided_at_the_smallest_key_that_leaves_no_part_too_wide() -> None:
    keys, cuts = np.full(100, 5), np.zeros(100, bool)
    cuts[[10, 95]] = True
    keys[[51, 54, 59]] = [3, 2, 1]
    # Two parts of 42 and 43 columns: both may have three more if none may have more than 50.
    assert sides_of(keys, cuts, 50, 0) == [(10, 54), (54, 95), (95, 110)]
    assert sides_of(keys, cuts, 45, 0)[:2] == [(10, 51), (51, 95)]
    keys[51] = 5
    assert sides_of(keys, cuts, 45, 0)[:2] == [(10, 52), (52, 95)]
    for widest in range(12, 50):
        widths = [stop - start for start, stop in sides_of(keys, cuts, widest, 0)]
        assert max(widths) <= widest
        assert min(widths) > 0
        assert len(widths) == -(-85 // widest) + -(-15 // widest)


def cut(keys: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    return sides_of(keys, local_cuts(keys, seen, 8), 20, 0)


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
        sides = sides_of(keys, local_cuts(keys, seen, 8), 20, 0, known)
        assert set(sides) <= whole
        assert len(sides) >= before
        before = len(sides)
    assert before > len(whole) - 5
