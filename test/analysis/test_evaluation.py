"""Scores, against cases computed by hand."""

import math

import numpy as np
import pytest

from panodepth_ros.analysis.evaluation import nearest_in_beams, score_depth, score_scan

NAN = math.nan


def test_scan_score_counts_what_it_says():
    truth = np.array([2.0, 2.0, 2.0, 2.0, 2.0, NAN])
    ranges = np.array([2.02, 2.3, 1.7, NAN, 2.0, 1.0])
    score = score_scan(ranges, truth, neighbours=0)
    assert score.coverage == 4 / 5
    assert score.within_5_percent == 2 / 4
    assert score.too_far == 1 / 4
    assert score.too_near == 1 / 4
    assert score.median_error == pytest.approx((0.01 + 0.15) / 2)


def test_truth_may_come_from_the_neighbouring_beam_and_wraps():
    truth = np.array([1.0, 3.0, 3.0, 5.0])
    ranges = np.array([5.0, 1.0, 3.0, 5.0])
    assert score_scan(ranges, truth, neighbours=1).within_5_percent == 1.0
    assert score_scan(ranges, truth, neighbours=0).within_5_percent == 0.5


def test_scan_without_a_comparable_beam_is_refused():
    with pytest.raises(ValueError, match='no beam'):
        score_scan(np.full(4, NAN), np.ones(4))
    with pytest.raises(ValueError, match='4 beams, truth has 5'):
        score_scan(np.ones(4), np.ones(5))


def test_nearest_in_beams():
    distance = np.array([2.0, 1.0, NAN, 4.0])
    azimuth = np.array([0.0, 0.1, 0.0, -math.pi])
    nearest = nearest_in_beams(distance, azimuth, 8)
    assert nearest[4] == 1.0
    assert nearest[0] == 4.0
    assert np.isnan(nearest).sum() == 6


def test_depth_score_counts_columns():
    r0, step = 0.08, math.radians(0.2)
    true = np.array([[2.0, 2.0, 2.0, 2.0, NAN]])
    delta = 2 * math.asin(r0 / 2.0)
    off = [0.0, 0.9, -1.1]
    measured = np.array([[*(r0 / math.sin((delta + k * step) / 2) for k in off), NAN, 1.0]])
    occluded = np.array([[False, False, True, False, False]])
    score = score_depth(measured, true, occluded, viewing_circle_radius=r0, column_step=step)
    assert score.kept == 2 / 3
    assert score.wrong == 1 / 3
    assert score.median_error == pytest.approx(abs(measured[0, 1] / 2.0 - 1))
