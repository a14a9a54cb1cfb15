"""The estimate of a steadily turning arm, from readings that are coarse and late."""

import math

import numpy as np
import pytest

from panodepth_ros.motion.turning import Reading, TurnEstimator

DEG = math.pi / 180.0
STEP = 0.04 * DEG
PERIOD = 20_000_000  # [ns]


def readings(speed, number, late=None, start=1_000_000_000):
    """Readings every 20 ms, whole motor steps, read ``late`` [s] after they were asked for."""
    late = np.zeros(number) if late is None else late
    for k in range(number):
        stamp = start + k * PERIOD
        azimuth = speed * ((k * PERIOD) * 1e-9 + late[k])
        yield Reading(stamp, round(azimuth / STEP) * STEP, 2.0 * late[k])


def fed(speed, number, late=None):
    estimator = TurnEstimator(STEP)
    for reading in readings(speed, number, late):
        estimator.add(reading)
    return estimator, reading.stamp


@pytest.mark.parametrize('speed', [36 * DEG, -7.3 * DEG])
def test_line_is_far_better_than_a_motor_step(speed):
    errors, uncertainties = [], []
    for number in range(30, 90):
        estimator, stamp = fed(speed, number)
        estimate = estimator.at(stamp)
        errors.append(estimate.azimuth - speed * (number - 1) * PERIOD * 1e-9)
        uncertainties.append(estimate.uncertainty)
        assert estimate.velocity == pytest.approx(speed, rel=0.003)
    assert np.sqrt(np.mean(np.square(errors))) < 0.15 * STEP
    assert 0.05 * STEP < min(uncertainties) < max(uncertainties) < 0.15 * STEP


def test_late_readings_weigh_little_and_pull_nothing():
    late = np.zeros(64)
    late[::3] = np.random.default_rng(3).uniform(0.0, 0.03, late[::3].size)
    estimator, stamp = fed(36 * DEG, 64, late)
    assert estimator.at(stamp).azimuth == pytest.approx(36 * DEG * 63 * 0.02, abs=0.5 * STEP)


def test_readings_of_another_speed_are_left_out():
    estimator, stamp = fed(10 * DEG, 40)
    here = 10 * DEG * 39 * 0.02
    for k in range(1, 41):
        azimuth = here + k * 0.02 * 36 * DEG
        estimator.add(Reading(stamp + k * PERIOD, round(azimuth / STEP) * STEP, 0.0))
    estimate = estimator.at(stamp + 40 * PERIOD)
    assert estimate.velocity == pytest.approx(36 * DEG, rel=0.01)
    assert estimate.azimuth == pytest.approx(here + 0.8 * 36 * DEG, abs=0.5 * STEP)


def test_few_or_contradicting_readings_give_no_estimate():
    estimator, stamp = fed(36 * DEG, 3)
    assert estimator.at(stamp) is None
    for k, azimuth in enumerate((5.0, 0.0, 7.0, -3.0), start=1):
        estimator.add(Reading(stamp + k * PERIOD, azimuth, 0.0))
    assert estimator.at(stamp + 4 * PERIOD) is None


def test_cleared_estimator_knows_nothing():
    estimator, stamp = fed(36 * DEG, 20)
    estimator.clear()
    assert estimator.at(stamp) is None


def test_reading_out_of_order_is_refused():
    estimator, stamp = fed(36 * DEG, 20)
    with pytest.raises(ValueError, match=r'reading is 0\.010000 s older than the last one'):
        estimator.add(Reading(stamp - 10_000_000, 0.0, 0.0))
