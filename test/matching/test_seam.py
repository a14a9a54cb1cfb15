"""The seam follows the content."""

from __future__ import annotations

import numpy as np
import pytest

from panodepth_ros.matching.seam import canonical_seam


@pytest.mark.parametrize('rolled', [0, 1, 17, 59])
def test_seam_rolls_with_the_panoramas(rolled: int) -> None:
    rng = np.random.default_rng(1)
    # Few different columns, so that many share the smallest key and the next ones must decide.
    columns = rng.integers(0, 256, (6, 3)).astype(np.uint8)
    left = columns[:, rng.integers(0, 3, 60)]
    right = columns[:, rng.integers(0, 3, 60)]
    here = canonical_seam(left, right)
    there = canonical_seam(np.roll(left, rolled, axis=1), np.roll(right, rolled, axis=1))
    assert there == (here + rolled) % 60


def test_every_layer_counts() -> None:
    plain, marked = np.zeros((2, 4, 50), np.uint8)
    marked[2, 33] = 1
    moved = np.roll(marked, 5, axis=1)
    # The plain layer looks the same when rolled: only the mark can move the seam.
    for here, there in (((plain, marked), (plain, moved)), ((marked, plain), (moved, plain))):
        assert canonical_seam(*there) == (canonical_seam(*here) + 5) % 50


def test_a_panorama_without_content_has_a_seam() -> None:
    assert canonical_seam(np.zeros((4, 50), np.uint8)) == 0
