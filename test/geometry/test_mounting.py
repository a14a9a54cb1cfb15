"""The camera's rotation against the arm: signs, order, inverse, limits."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import Mounting, PinholeCamera

F = 200.0


def camera(**mounting):
    return PinholeCamera(
        width=161,
        height=121,
        fx=F,
        fy=F,
        cx=80.0,
        cy=60.0,
        distortion=(-0.2, 0.05, 0.001, -0.002, 0.0),
        mounting=Mounting(**mounting),
    )


def test_aligned_camera_changes_no_ray():
    rng = np.random.default_rng(0)
    directions = rng.uniform(-1, 1, (3, 50))
    np.testing.assert_allclose(Mounting().to_camera(directions), directions, atol=1e-15)


@pytest.mark.parametrize(
    ('mounting', 'u', 'v'),
    [
        # To the left of the arm: what the arm points at appears to the right.
        ({'yaw': 0.1}, F * math.tan(0.1), 0.0),
        # Above the plane: what the arm points at appears below.
        ({'tilt': 0.1}, 0.0, F * math.tan(0.1)),
        ({'roll': 0.5}, 0.0, 0.0),
    ],
)
def test_the_arm_appears_on_the_other_side(mounting, u, v):
    ideal = PinholeCamera(
        width=161, height=121, fx=F, fy=F, cx=0.0, cy=0.0, mounting=Mounting(**mounting)
    )
    assert np.ravel(ideal.project([0.0], [0.0])) == pytest.approx([u, v])


def test_clockwise_roll_turns_the_image_counter_clockwise():
    ideal = PinholeCamera(
        width=161, height=121, fx=F, fy=F, cx=0.0, cy=0.0, mounting=Mounting(roll=0.1)
    )
    # A point to the right of the axis, level with it, rises in the image.
    u, v = ideal.project([-0.2], [0.0])
    assert math.atan2(v[0], u[0]) == pytest.approx(-0.1)


def test_order_is_roll_then_tilt_then_yaw_of_the_held_camera():
    # The optical axis tells yaw and tilt apart from roll: azimuth and elevation of it.
    forward = Mounting(yaw=0.3, tilt=0.2, roll=0.9).rotation[:, 0]
    assert math.atan2(forward[1], forward[0]) == pytest.approx(0.3)
    assert math.asin(forward[2]) == pytest.approx(0.2)


def test_pixels_and_rays_are_inverse():
    v, u = np.mgrid[0:121:10, 0:161:10]
    lens = camera(yaw=0.2, roll=-0.4, tilt=0.1)
    np.testing.assert_allclose(lens.project(*lens.rays(u, v)), (u, v), atol=1e-6)
    angle, slope = lens.rays(80.0, 60.0)
    assert (angle, math.atan(slope)) == pytest.approx((0.2, 0.1))


def test_ray_from_behind_has_no_pixel():
    ideal = PinholeCamera(
        width=161, height=121, fx=F, fy=F, cx=0.0, cy=0.0, mounting=Mounting(yaw=0.7)
    )
    assert np.isnan(ideal.project([-1.0, 1.0], [0.0, 0.0])).tolist() == [[True, False]] * 2


def test_lens_model_that_folds_the_image_is_refused():
    lens = PinholeCamera(
        width=161, height=121, fx=100.0, fy=100.0, cx=80.0, cy=60.0, distortion=(-0.9, 0, 0, 0)
    )
    with pytest.raises(ValueError, match='without a ray'):
        lens.rays(0.0, 0.0)


@pytest.mark.parametrize('name', ['yaw', 'roll', 'tilt'])
@pytest.mark.parametrize('value', [math.nan, 3.2])
def test_impossible_angle_is_refused(name, value):
    with pytest.raises(ValueError, match=f'camera {name} is'):
        Mounting(**{name: value})
