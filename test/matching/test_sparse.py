"""Sparse matching: where, and the same as the dense one there."""

from __future__ import annotations

import numpy as np
import pytest
from matching_scenes import pair_of, shifted_pair, texture

from panodepth_ros.matching import match


def test_one_step_is_one_edge() -> None:
    # One step up at column 30, one down at column 60; each lies between two columns with equal
    # response, of which the right one is kept.
    left = np.full((20, 90), 60, np.uint8)
    left[:, 31:60] = 160
    result = match(*pair_of(left, np.roll(left, 6, axis=1), 10), method='sparse')
    matched = np.isfinite(result.column_disparity)
    assert set(np.flatnonzero(matched.any(axis=0))) == {31, 60}
    np.testing.assert_allclose(result.column_disparity[matched], 6, atol=0.05)


@pytest.mark.parametrize(('step', 'edges'), [(31, 0), (32, 20), (33, 20)])
def test_threshold_is_a_step_of_32_levels(step: int, edges: int) -> None:
    ramp = 100 + step * (np.arange(90) > 40) - np.clip(np.arange(90) - 60, 0, step)
    left = np.tile(ramp.astype(np.uint8), (20, 1))
    result = match(*pair_of(left, np.roll(left, 6, axis=1), 10), method='sparse')
    assert np.isfinite(result.column_disparity).sum() == edges


def test_horizontal_edges_are_no_features() -> None:
    image = np.zeros((20, 60), np.uint8)
    image[10:] = 200
    assert np.isnan(match(*pair_of(image, image, 10), method='sparse').column_disparity).all()


def test_rim_of_a_gap_is_no_edge() -> None:
    rng = np.random.default_rng(5)
    image = rng.integers(95, 106, (20, 90)).astype(np.uint8)  # Sobel answers with 40 at most
    seen = np.ones(90, bool)
    seen[[30, 31, 60]] = False
    result = match(*pair_of(image, image, 10, left_seen=seen, right_seen=seen), method='sparse')
    assert np.isnan(result.column_disparity).all()


def test_edge_without_a_counterpart_is_unmatched() -> None:
    left = np.full((20, 90), 60, np.uint8)
    left[:, 31:60] = 160
    flat = np.full((20, 90), 100, np.uint8)
    assert np.isnan(match(*pair_of(left, flat, 10), method='sparse').column_disparity).all()


@pytest.mark.parametrize('gaps', [False, True])
def test_equals_the_dense_matching_at_its_edges(gaps: bool) -> None:
    rng = np.random.default_rng(3)
    columns = 300
    left, right = shifted_pair(
        texture(rng, 30, columns, wavelength=4.0), np.full((30, columns), 9.3), noise=6.0, rng=rng
    )
    seen = np.ones((2, columns), bool)
    if gaps:
        seen[0, [20, 141]] = seen[1, 200:215] = False
    pair = pair_of(left, right, 20, left_seen=seen[0], right_seen=seen[1])
    sparse, dense = match(*pair, method='sparse'), match(*pair, method='ncc')
    both = np.isfinite(sparse.column_disparity) & np.isfinite(dense.column_disparity)
    assert both.sum() > 500
    np.testing.assert_allclose(
        sparse.column_disparity[both], dense.column_disparity[both], atol=1e-4
    )
    np.testing.assert_allclose(sparse.confidence[both], dense.confidence[both], atol=1e-6)


@pytest.mark.parametrize('threads', [2, 3])
def test_threads_do_not_change_a_byte(threads: int) -> None:
    rng = np.random.default_rng(4)
    left, right = shifted_pair(
        texture(rng, 40, 200, wavelength=4.0), np.full((40, 200), 9.3), noise=6.0, rng=rng
    )
    pair = pair_of(left, right, 20)
    one, several = match(*pair, method='sparse'), match(*pair, method='sparse', threads=threads)
    np.testing.assert_array_equal(one.column_disparity, several.column_disparity)
    np.testing.assert_array_equal(one.confidence, several.confidence)
    assert np.isfinite(one.column_disparity).sum() > 500
