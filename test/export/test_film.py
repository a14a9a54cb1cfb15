"""The film of the growing ground plan: when each beam comes, and what the file is."""

import math

import numpy as np
import pytest

from panodepth_ros.export.film import decided_after, save_film

RADIUS, PHI = 0.3, math.radians(15.0)


@pytest.mark.parametrize(('begin', 'turn'), [(0.0, 1.0), (1.2, -1.0), (-20.0, 0.5)])
def test_a_beam_comes_when_the_later_eye_has_seen_its_point(begin, turn):
    end = begin + turn * 2 * math.pi
    ranges = np.random.default_rng(3).uniform(0.4, 6.0, 90)
    ranges[7] = math.nan
    after = decided_after(ranges, arm_radius=RADIUS, principal_angle=PHI, begin=begin, end=end)
    assert math.isnan(after[7])
    azimuth = -math.pi + np.arange(90) * math.radians(4.0)
    turned = np.linspace(0, 2 * math.pi, 20000, endpoint=False)
    arm = begin + math.copysign(1.0, turn) * turned
    for k in np.delete(np.arange(90), 7):
        point = ranges[k] * np.exp(1j * azimuth[k])
        sight = np.angle((point - RADIUS * np.exp(1j * arm)) * np.exp(-1j * arm))
        seen = [turned[np.argmin(np.abs(sight - eye))] for eye in (PHI, -PHI)]
        assert after[k] == pytest.approx(max(seen), abs=0.001)


def test_film_is_small_and_grows(tmp_path):
    image = pytest.importorskip('PIL.Image')
    path = tmp_path / 'film.gif'
    room = [np.array([[-2.0, -2.0], [-2.0, 2.0], [2.0, 2.0], [2.0, -2.0]])]
    ranges = np.full(360, 1.9)
    save_film(
        ranges,
        path,
        arm_radius=RADIUS,
        principal_angle=PHI,
        begin=0.0,
        end=2 * math.pi,
        duration=10.0,
        outline=room,
    )
    assert path.stat().st_size < 2**20
    with image.open(path) as film:
        assert film.n_frames > 30
        red = []
        for k in (0, film.n_frames // 2, film.n_frames - 1):
            film.seek(k)
            picture = np.asarray(film.convert('RGB')).astype(int)
            red.append(int((picture[..., 0] - picture[..., 2] > 100).sum()))
    assert red[0] < 0.1 * red[2]
    assert 0.3 * red[2] < red[1] < 0.7 * red[2]


def red_columns(path, **sweep):
    """Columns of the last picture that show beams, as shares of its width."""
    image = pytest.importorskip('PIL.Image')
    azimuth = -math.pi + np.arange(360) * math.radians(1.0)
    ranges = np.where(np.abs(azimuth - math.pi / 2) < 1.0, 1.9, math.nan)
    save_film(ranges, path, arm_radius=RADIUS, principal_angle=PHI, duration=10.0, **sweep)
    with image.open(path) as film:
        film.seek(film.n_frames - 1)
        picture = np.asarray(film.convert('RGB')).astype(int)
    return np.flatnonzero(np.any(picture[..., 0] - picture[..., 2] > 100, axis=0)) / len(picture)


def test_what_is_to_the_left_is_shown_left(tmp_path):
    assert red_columns(tmp_path / 'film.gif', begin=0.0, end=2 * math.pi).max() < 0.5


def test_last_picture_holds_beams_that_the_last_frames_stripe_has_seen(tmp_path):
    # Both eyes have seen the last of these beams only after the arm's last azimuth.
    assert red_columns(tmp_path / 'film.gif', begin=0.0, end=0.1).size > 0
