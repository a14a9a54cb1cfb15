"""The pinhole against hand-made projections."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import PinholeCamera

PAPER = {'width': 160, 'height': 120, 'fx': 261.668, 'fy': 261.668, 'cx': 79.5, 'cy': 59.5}


def test_column_right_of_the_centre_looks_clockwise():
    camera = PinholeCamera(**PAPER)
    assert camera.ray_angle(70.5) == pytest.approx(-math.radians(15.0789), abs=1e-6)
    assert camera.ray_angle(-70.5) == -camera.ray_angle(70.5)


def test_projection_of_a_point_in_space():
    # A point 2 m ahead, 0.4 m to the left, 0.3 m up: u = cx − fx·0.4/2, v = cy − fy·0.3/2.
    camera = PinholeCamera(**PAPER)
    psi, slope = math.atan2(0.4, 2.0), 0.3 / math.hypot(2.0, 0.4)
    u, v = camera.project(psi, slope)
    assert float(u) == pytest.approx(79.5 - 261.668 * 0.2)
    assert float(v) == pytest.approx(59.5 - 261.668 * 0.15)


def test_plumb_bob_distortion_is_applied():
    camera = PinholeCamera(**PAPER, distortion=(-0.1, 0.02, 0.001, -0.002, 0.0))
    psi, slope = 0.2, 0.1
    x, y = -math.tan(psi), -slope / math.cos(psi)
    r2 = x * x + y * y
    radial = 1 - 0.1 * r2 + 0.02 * r2**2
    xd = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    yd = y * radial + 0.001 * (r2 + 2 * y * y) + 2 * -0.002 * x * y
    u, v = camera.project([psi], [slope])
    assert u[0] == pytest.approx(79.5 + 261.668 * xd)
    assert v[0] == pytest.approx(59.5 + 261.668 * yd)


def test_equidistant_distortion_is_applied():
    camera = PinholeCamera(
        **PAPER, distortion_model='equidistant', distortion=(0.05, -0.01, 0.002, 0.0)
    )
    psi = 0.25
    theta = psi
    bent = theta * (1 + 0.05 * theta**2 - 0.01 * theta**4 + 0.002 * theta**6)
    u, v = camera.project([psi], [0.0])
    assert u[0] == pytest.approx(79.5 - 261.668 * bent)
    assert v[0] == pytest.approx(59.5)


def test_project_broadcasts_rays_against_rows():
    u, v = PinholeCamera(**PAPER).project(np.zeros(3), np.zeros((5, 1)))
    assert u.shape == v.shape == (5, 3)


@pytest.mark.parametrize(
    ('change', 'named'),
    [
        ({'fx': 0.0}, 'fx is 0.0'),
        ({'width': 0}, 'width is 0'),
        ({'cx': math.nan}, 'principal point'),
        ({'distortion_model': 'cylindrical'}, 'cylindrical'),
        ({'distortion': (0.1, 0.2)}, '2 plumb_bob coefficients'),
    ],
)
def test_impossible_camera_is_refused_by_name(change, named):
    with pytest.raises(ValueError, match=named):
        PinholeCamera(**{**PAPER, **change})
