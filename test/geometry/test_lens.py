"""Whether a lens model holds in the whole image."""

import math

import pytest

from panodepth_ros.geometry import PinholeCamera
from panodepth_ros.geometry.lens import check_lens


def camera(distortion, model='plumb_bob', f=262.0):
    return PinholeCamera(
        width=160,
        height=120,
        fx=f,
        fy=f,
        cx=79.5,
        cy=59.5,
        distortion_model=model,
        distortion=distortion,
    )


@pytest.mark.parametrize(
    ('distortion', 'model', 'f'),
    [
        ((), 'plumb_bob', 262.0),
        ((-0.08, 0.0, 0.0, 0.0, 0.0), 'plumb_bob', 262.0),
        ((0.5, 0.0, 0.01, -0.01, 0.0), 'plumb_bob', 262.0),
        # The corner is at 0.9 of the largest radius that has a ray.
        ((-0.82, 0.0, 0.0, 0.0), 'plumb_bob', 262.0),
        ((0.1, 0.02, 0.0, 0.0, 0.0, 0.15, 0.01, 0.0), 'rational_polynomial', 262.0),
        ((0.05, -0.01, 0.002, 0.0), 'equidistant', 90.0),
    ],
)
def test_lens_that_holds_in_the_image_is_taken(distortion, model, f):
    check_lens(camera(distortion, model, f))


@pytest.mark.parametrize(
    ('distortion', 'model', 'f'),
    [
        ((-5.0, 0.0, 0.0, 0.0, 0.0), 'plumb_bob', 262.0),
        # Turns back between the middle and the corner, and out again: all pixels have rays.
        ((-12.0, 57.6, 0.0, 0.0, 0.0), 'plumb_bob', 262.0),
        ((0.0, 0.0, 0.0, 0.0, 0.0, -9.5, 0.0, 0.0), 'rational_polynomial', 262.0),
        ((-0.9, 0.0, 0.0, 0.0), 'equidistant', 90.0),
        ((0.0, 0.0, 0.0, 3.0), 'plumb_bob', 262.0),
    ],
)
def test_lens_that_folds_inside_of_the_image_is_refused_with_its_numbers(distortion, model, f):
    with pytest.raises(ValueError, match='folds inside of the image of 160 by 120') as caught:
        check_lens(camera(distortion, model, f))
    assert str(distortion) in str(caught.value)
    assert model in str(caught.value)


def test_lens_may_fold_outside_of_the_image():
    folds_at = math.sqrt(1 / (3 * 0.08))  # tangent of the angle
    assert folds_at > 2.0
    check_lens(camera((-0.08, 0.0, 0.0, 0.0, 0.0), f=85.0))
    with pytest.raises(ValueError, match='folds'):
        check_lens(camera((-0.08, 0.0, 0.0, 0.0, 0.0), f=70.0))
