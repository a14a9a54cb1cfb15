"""An arm that was out of sight: whether its azimuths still mean what they meant."""

import math

import pytest

from panodepth_ros.mosaic.continuity import doubt

DEG = math.radians(1.0)
PLACES = 40 * DEG, 44 * DEG


@pytest.mark.parametrize('azimuth', [40, 42.5, 44, 44.9, 39.1])
@pytest.mark.parametrize('restarted', [False, True])
def test_arm_between_the_last_place_and_the_next_goes_on(azimuth, restarted):
    assert doubt(azimuth * DEG, PLACES, DEG, restarted=restarted) == ''


@pytest.mark.parametrize('azimuth', [0, 38, 48, -40, 400])
def test_arm_elsewhere_has_lost_its_count(azimuth):
    said = doubt(azimuth * DEG, PLACES, DEG, restarted=False)
    assert f'heard of again at {azimuth:.2f}°; allowed: 40.00° to 44.00°' in said


def test_arm_at_zero_is_believed_only_of_the_driver_that_led_it_there():
    for between in ((-4 * DEG, 0.0), (0.0, 4 * DEG), (-math.inf, math.inf)):
        assert doubt(0.0, between, DEG, restarted=False) == ''
        assert 'a controller begins that has lost its count' in doubt(
            0.0, between, DEG, restarted=True
        )
