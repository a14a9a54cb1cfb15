"""What all methods share: search range, refusals, unseen columns, colour."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from matching_scenes import noise_image, pair_of, shifted_pair, texture

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import METHODS, match, prepare
from panodepth_ros.matching.interface import candidate_range

ONE_PAIR = ('ncc', 'sparse', 'sgbm', 'bm')


@pytest.mark.parametrize(('double_angle_deg', 'last'), [(29.9625, 149), (3.6125, 18), (30.0, 149)])
@pytest.mark.parametrize('rounding', [-1e-9, 0, 1e-9])
def test_search_range_is_that_of_the_paper(
    double_angle_deg: float, last: int, rounding: float
) -> None:
    left, right = pair_of(*[np.zeros((9, 1800), np.uint8)] * 2, 20)
    angle = math.radians(double_angle_deg / 2)
    shift = angle / left.geometry.column_step
    pair = [
        dataclasses.replace(
            panorama.geometry,
            principal_angle=sign * angle,
            azimuth_column=900 + sign * (shift + rounding),
            ray_angle=np.full(1800, sign * angle),
        )
        for panorama, sign in ((left, -1), (right, 1))
    ]
    assert candidate_range(*pair) == (1, last)


@pytest.mark.parametrize('method', ONE_PAIR)
@pytest.mark.parametrize('start', [-7, 5, 395, 1203])
def test_search_range_follows_a_panorama_that_starts_elsewhere(start: int, method: str) -> None:
    rng = np.random.default_rng(1)
    columns, truth = 400, 9
    left, right = shifted_pair(
        texture(rng, 40, columns, wavelength=4.0), np.full((40, columns), 9.0)
    )
    left_panorama, right_panorama = pair_of(left, right, 20)
    geometry = dataclasses.replace(
        right_panorama.geometry, azimuth_column=right_panorama.geometry.azimuth_column + start
    )
    shifted = Panorama(np.roll(right, start, axis=1), geometry)
    around = (start + columns // 2) % columns - columns // 2  # the short way
    assert candidate_range(left_panorama.geometry, geometry) == (around + 1, around + 20)
    result = match(left_panorama, shifted, method=method)
    error = (result.column_disparity - truth - start + columns / 2) % columns - columns / 2
    assert np.isfinite(error).mean() > {'sparse': 0.05, 'bm': 0.6}.get(method, 0.97)
    assert (np.abs(error[np.isfinite(error)]) > 1).mean() < 0.01


@pytest.mark.parametrize('method', ONE_PAIR)
def test_every_method_finds_a_known_disparity(method: str) -> None:
    rng = np.random.default_rng(2)
    columns = 400
    truth = np.full((40, columns), 21.25)
    left, right = shifted_pair(
        texture(rng, 40, columns, wavelength=4.0), truth, noise=2.0, rng=rng
    )
    result = match(*pair_of(left, right, 37), method=method)
    matched = np.isfinite(result.column_disparity)
    np.testing.assert_array_equal(matched, np.isfinite(result.confidence))
    least = {'sparse': 0.05, 'bm': 0.6}.get(method, 0.9)
    assert matched.mean() > least
    error = (result.column_disparity - truth)[matched]
    assert (np.abs(error) > 1).mean() < 0.01
    # OpenCV's semi-global matcher is drawn towards whole columns.
    assert abs(np.median(error)) < (0.2 if method == 'sgbm' else 0.05)
    assert result.confidence[matched].min() >= 0
    assert result.confidence[matched].max() <= 1
    assert result.column_disparity.dtype == result.confidence.dtype == np.float32


@pytest.mark.parametrize('method', ONE_PAIR)
def test_unseen_columns_stay_unmatched_and_spoil_no_neighbour(method: str) -> None:
    rng = np.random.default_rng(3)
    columns = 400
    truth = np.full((40, columns), 21.0)
    left, right = shifted_pair(texture(rng, 40, columns, wavelength=4.0), truth)
    left_seen, right_seen = np.ones(columns, bool), np.ones(columns, bool)
    left_seen[[0, 90]] = left_seen[200:260] = False
    right_seen[[10, 130]] = right_seen[330:350] = False
    whole = match(*pair_of(left, right, 37), method=method)
    result = match(
        *pair_of(left, right, 37, left_seen=left_seen, right_seen=right_seen), method=method
    )
    matched = np.isfinite(result.column_disparity)
    assert not matched[:, ~left_seen].any()
    to = (np.arange(columns) + 21) % columns
    assert not (np.abs(result.column_disparity - truth) < 0.4)[:, ~right_seen[to]].any()
    visible = left_seen & right_seen[to]
    gap_near = np.convolve(np.pad(~visible, 2, mode='wrap'), np.ones(5), 'valid') > 0
    beside = visible & gap_near
    right_beside = (np.abs(result.column_disparity - truth) <= 1)[:, beside].mean()
    was_there = np.isfinite(whole.column_disparity)[:, beside].mean()
    # BM's window and the Sobel filter lack what is in the gap; the others make do without.
    assert right_beside > {'sparse': 0.5 * was_there, 'bm': 0.75}.get(method, 0.95)
    error = np.abs(result.column_disparity - truth)[:, visible]
    assert (error[matched[:, visible]] > 1).mean() < 0.03


@pytest.mark.parametrize('method', ONE_PAIR)
def test_no_column_seen_gives_no_match(method: str) -> None:
    image = noise_image(np.random.default_rng(4), 40, 200)
    unseen = np.zeros(200, bool)
    result = match(*pair_of(image, image, 20, left_seen=unseen, right_seen=unseen), method=method)
    assert np.isnan(result.column_disparity).all()
    assert np.isnan(result.confidence).all()


@pytest.mark.parametrize('method', ONE_PAIR)
def test_rolling_rolls(method: str) -> None:
    rng = np.random.default_rng(5)
    columns, shift = 400, 150
    left, right = shifted_pair(
        texture(rng, 40, columns), np.full((40, columns), 21.4), noise=8.0, rng=rng
    )
    still = match(*pair_of(left, right, 37), method=method).column_disparity
    rolled = match(
        *pair_of(np.roll(left, shift, axis=1), np.roll(right, shift, axis=1), 37), method=method
    ).column_disparity
    same = np.isclose(np.roll(still, shift, axis=1), rolled, rtol=0, atol=0, equal_nan=True)
    # The paths of OpenCV's semi-global matcher start at the ends of what it is given.
    assert same.mean() > 0.999 if method == 'sgbm' else same.all()


@pytest.mark.parametrize('method', ONE_PAIR)
def test_image_without_texture_is_not_guessed(method: str) -> None:
    flat = np.full((40, 200), 99, np.uint8)
    result = match(*pair_of(flat, flat, 20), method=method)
    if method == 'sgbm':  # OpenCV does guess
        assert not result.confidence.any()
    else:
        assert np.isnan(result.column_disparity).all()


def test_colour_is_matched_as_grey() -> None:
    rng = np.random.default_rng(6)
    left, right = (rng.integers(0, 256, (12, 100, 3)).astype(np.uint8) for _ in range(2))
    greys = (cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in (left, right))
    colour = match(*pair_of(left, right, 15), method='ncc')
    grey = match(*pair_of(*greys, 15), method='ncc')
    np.testing.assert_array_equal(colour.column_disparity, grey.column_disparity)


def test_images_are_not_changed() -> None:
    rng = np.random.default_rng(7)
    left, right = noise_image(rng, 12, 100), noise_image(rng, 12, 100)
    seen = np.ones(100, bool)
    seen[30:40] = False
    before = left.copy(), right.copy()
    match(*pair_of(left, right, 15, left_seen=seen, right_seen=seen))
    np.testing.assert_array_equal(left, before[0])
    np.testing.assert_array_equal(right, before[1])


@pytest.mark.parametrize(
    ('rows', 'columns', 'sentence'),
    [
        (1, 100, 'panorama has 1 rows; allowed: at least 9'),
        (8, 100, 'panorama has 8 rows; allowed: at least 9'),
        (12, 13, 'panorama has 13 columns; allowed: at least 14'),
    ],
)
def test_too_small_panoramas_are_refused(rows: int, columns: int, sentence: str) -> None:
    image = np.zeros((rows, columns), np.uint8)
    with pytest.raises(ValueError, match=sentence):
        match(*pair_of(image, image, 5))


def test_an_angle_of_less_than_half_a_step_is_refused() -> None:
    image = np.zeros((12, 100), np.uint8)
    with pytest.raises(ValueError, match='leaves no column to search'):
        match(*pair_of(image, image, 0))


def test_panoramas_of_unequal_geometry_are_refused() -> None:
    left, right = pair_of(*[np.zeros((12, 100), np.uint8)] * 2, 15)
    lower, _ = pair_of(*[np.zeros((11, 100), np.uint8)] * 2, 15)
    wider, _ = pair_of(*[np.zeros((12, 120), np.uint8)] * 2, 15)
    with pytest.raises(ValueError, match='rows is 11 on the left and 12'):
        match(lower, right)
    with pytest.raises(ValueError, match='columns is 120 on the left and 100'):
        match(wider, right)
    with pytest.raises(ValueError, match='principal_angle is'):
        match(right, left)
    with pytest.raises(ValueError, match='principal_angle is'):
        match(left, left)


def test_unknown_method_and_too_few_threads_are_refused() -> None:
    pair = pair_of(*[np.zeros((12, 100), np.uint8)] * 2, 15)
    with pytest.raises(ValueError, match=r"method is 'magic'; allowed: .*ncc"):
        match(*pair, method='magic')
    with pytest.raises(ValueError, match="method is 'magic'"):
        prepare('magic')
    with pytest.raises(ValueError, match='threads is 0; allowed: at least 1'):
        match(*pair, threads=0)


def test_one_pair_methods_are_among_the_methods() -> None:
    assert set(ONE_PAIR) <= set(METHODS)
