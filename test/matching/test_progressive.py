"""Growing pairs: what is matched meanwhile is what the whole turn gives, bit by bit."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from matching_scenes import pair_of, shifted_pair, texture

from panodepth_ros.geometry import Panorama
from panodepth_ros.matching import Correspondence, match, progressive
from panodepth_ros.matching.progressive import GrowingMatch

ROWS, COLUMNS, CANDIDATES = 40, 960, 45
#: Rows that show nothing, so that noise can be told from texture.
PLAIN = 16
Pair = tuple[Panorama, Panorama]


def disparity() -> npt.NDArray[np.float64]:
    x = 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    return np.tile(22.0 + 9.7 * np.sin(x), (ROWS, 1))


def images() -> tuple[npt.NDArray[np.uint8], ...]:
    rng = np.random.default_rng(1)
    signal = texture(rng, ROWS, COLUMNS)
    signal[:PLAIN] = 128
    return shifted_pair(signal, disparity(), noise=1.0, rng=rng)


def pair() -> Pair:
    return pair_of(*images(), CANDIDATES)


def seen_only(whole: Pair, seen: npt.NDArray[np.bool_]) -> list[Panorama]:
    return [
        Panorama(eye.image, dataclasses.replace(
            eye.geometry, ray_angle=np.where(seen, eye.geometry.ray_angle, np.nan)
        ))
        for eye in whole
    ]  # fmt: skip


def first_columns(count: int, direction: int = 1) -> npt.NDArray[np.bool_]:
    """Columns that an arm has come to that began at column 77."""
    order = (np.arange(COLUMNS)[::direction] + 77) % COLUMNS
    seen = np.zeros(COLUMNS, bool)
    seen[order[:count]] = True
    return seen


def grown(whole: Pair, direction: int = 1, portion: int = 60) -> GrowingMatch:
    growing = GrowingMatch(ROWS, COLUMNS)
    for count in range(portion, COLUMNS, portion):
        growing.add(*seen_only(whole, first_columns(count, direction)), threads=1)
    return growing


def same(one: Correspondence, other: Correspondence) -> bool:
    return all(
        getattr(one, name).tobytes() == getattr(other, name).tobytes()
        for name in ('column_disparity', 'confidence')
    )


@pytest.mark.parametrize('direction', [1, -1])
@pytest.mark.parametrize('portion', [60, 400])
def test_finished_match_is_that_of_the_whole_turn_and_was_mostly_done_before(
    direction: int, portion: int
) -> None:
    whole = pair()
    growing = grown(whole, direction, portion)
    ready = growing.ready.sum()
    assert same(growing.finish(*whole, threads=2), match(*whole))
    assert growing.reused == ready > COLUMNS / 4
    assert not growing.ready.any(), 'the next turn begins with nothing'


def test_match_grows_with_what_was_seen_and_is_near_the_finished_one() -> None:
    whole = pair()
    finished, growing, states = match(*whole), GrowingMatch(ROWS, COLUMNS), []
    for count in range(60, COLUMNS, 60):
        growing.add(*seen_only(whole, first_columns(count)), threads=1)
        found = growing.so_far(threads=1).column_disparity
        assert np.isnan(found[:, ~growing.ready]).all()
        states.append(growing.ready)
    assert 0 < states[5].sum() < states[-1].sum() < COLUMNS
    for ready, later in pairwise(states):
        assert (ready <= later).all()
    ready = growing.ready
    found = found[:, ready]
    off = np.abs(found - finished.column_disparity[:, ready])
    off = off[np.isfinite(off)]
    assert (off == 0).mean() > 0.5
    assert (off < 0.1).mean() > 0.97
    assert np.nanpercentile(np.abs(found - disparity()[:, ready])[PLAIN:], 95) < 0.25
    # To look at it changes nothing.
    assert same(growing.finish(*whole, threads=1), finished)


def test_most_of_a_growing_match_is_final(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = pair()
    growing, evaluated = grown(whole), []
    evaluate = progressive.evaluate
    monkeypatch.setattr(
        'panodepth_ros.matching.semiglobal.evaluate',
        lambda *values: evaluated.extend(values[-1]) or evaluate(*values),  # type: ignore[func-returns-value]
    )
    growing.finish(*whole, threads=1)
    assert 0 < sum(stop - start for start, stop in evaluated) < 0.7 * COLUMNS


def changed(whole: Pair, eye: int, column: int) -> Pair:
    images = [panorama.image.copy() for panorama in whole]
    images[eye][25:29, column] += 100
    left, right = (
        Panorama(image, panorama.geometry) for image, panorama in zip(images, whole, strict=True)
    )
    return left, right


@pytest.mark.parametrize('eye', [0, 1])
@pytest.mark.parametrize('column', [400, 70])
def test_columns_that_changed_after_all_are_matched_anew(eye: int, column: int) -> None:
    growing, other = grown(pair()), changed(pair(), eye, column)
    used = growing.ready[column]
    assert used == (column == 400)
    assert same(growing.finish(*other, threads=1), match(*other))
    assert (growing.reused > 0) == (not used)


def test_columns_that_changed_while_it_grew_are_matched_anew() -> None:
    growing, other = grown(pair(), portion=400), changed(pair(), 0, 400)
    assert growing.ready[400]
    growing.add(*seen_only(other, first_columns(900)), threads=1)
    assert growing.ready[400]
    assert same(growing.finish(*other, threads=1), match(*other))
    assert growing.reused > 0


def test_columns_that_are_lost_after_all_are_lost() -> None:
    whole = pair()
    growing, seen = grown(whole), np.ones(COLUMNS, bool)
    seen[400:410] = False
    lost = seen_only(whole, seen)
    assert same(growing.finish(*lost, threads=1), match(*lost))
    assert growing.reused == 0


@pytest.mark.parametrize(('noise', 'gain'), [(6.0, 1.0), (0.0, 0.7)])
def test_what_the_last_columns_tell_of_noise_and_exposure_counts_for_all(
    noise: float, gain: float
) -> None:
    rng = np.random.default_rng(3)
    left, right = images()
    late = ~first_columns(700)
    turned = gain * left[:, late] + rng.normal(0, noise, (ROWS, late.sum()))
    left[:, late] = np.clip(turned, 0, 255)
    whole = pair_of(left, right, CANDIDATES)
    assert same(grown(whole).finish(*whole, threads=1), match(*whole))


def test_noise_that_was_estimated_from_few_columns_is_estimated_again() -> None:
    rng = np.random.default_rng(4)
    left, right = images()
    early = first_columns(330)
    for image in (left, right):
        louder = image[:, early] + rng.normal(0, 7, (ROWS, early.sum()))
        image[:, early] = np.clip(louder, 0, 255)
    whole = pair_of(left, right, CANDIDATES)
    growing = grown(whole)
    assert same(growing.finish(*whole, threads=1), match(*whole))
    assert growing.reused > COLUMNS / 4


def test_another_search_range_is_another_match() -> None:
    growing = grown(pair())
    other = pair_of(*images(), CANDIDATES - 5)
    assert same(growing.finish(*other, threads=1), match(*other))
    assert growing.reused == 0


def test_panorama_of_another_size_is_refused() -> None:
    growing = GrowingMatch(ROWS, COLUMNS - 1)
    for take in (growing.add, growing.finish):
        with pytest.raises(ValueError, match=r'panorama is \(40, 960\) pixels; allowed: '):
            take(*pair(), threads=1)
