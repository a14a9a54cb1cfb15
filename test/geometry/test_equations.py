"""The paper's numbers, and the geometry against independent ray intersections."""

import math

import numpy as np
import pytest

from panodepth_ros.geometry import equations as eq

R = 0.300
STEP = math.radians(0.2)
WIDE = math.radians(29.9625 / 2)
NARROW = math.radians(3.6125 / 2)


def test_view_angle_of_the_paper_follows_from_its_resolution():
    # 34 degrees over 160 columns: a rotation of 0.2125 degrees shifts by one column.
    assert math.degrees(eq.view_angle(160, 1.0, math.radians(34 / 160))) == pytest.approx(34)


def test_a_rotation_by_the_view_angle_uncovers_the_whole_image():
    assert eq.stripe_width(160, math.radians(34), math.radians(34)) == pytest.approx(160)
    # W_s inverts eq. 1: a shift of 1 px is what 34/160 degrees uncover.
    assert eq.stripe_width(160, math.radians(34), math.radians(0.2125)) == pytest.approx(1)


def test_linear_principal_angle_gives_the_papers_angles():
    # Eq. 3 with 34 degrees over 160 columns: 141 and 17 columns apart.
    two_phi = [
        2 * math.degrees(eq.linear_principal_angle(math.radians(34), 160, w)) for w in (141, 17)
    ]
    assert two_phi == pytest.approx([29.9625, 3.6125], abs=1e-12)


@pytest.mark.parametrize(
    ('phi', 'n', 'nearest_mm', 'farthest_mm'), [(WIDE, 149, 302, 54687), (NARROW, 18, 318, 86686)]
)
def test_search_range_and_distance_limits_of_section_6_2(phi, n, nearest_mm, farthest_mm):
    assert eq.search_range(phi, STEP) == n
    assert round(1000 * eq.nearest_distance(R, phi, STEP)) == nearest_mm
    assert round(1000 * eq.farthest_distance(R, phi, STEP)) == farthest_mm


def test_search_range_excludes_parallel_rays():
    assert eq.search_range(10 * STEP / 2, STEP) == 9


@pytest.mark.parametrize(
    ('phi', 'share', 'row'),
    [
        (WIDE, 1 / 4, (394.5, 398.0, 401.5)),
        (NARROW, 1 / 4, (372.5, 400.0, 431.8)),
        (WIDE, 7 / 8, (2252.9, 2373.2, 2507.0)),
        (NARROW, 7 / 8, (1663.0, 2399.6, 4307.4)),
    ],
)
def test_table_1(phi, share, row):
    theta = phi * share
    half = STEP / 2
    distances = 1000 * eq.radial_distance(
        [theta - half, theta, theta + half], arm_radius=R, principal_angle=phi
    )
    assert tuple(round(float(distance), 1) for distance in distances) == row
    before, after = eq.one_column_errors(
        theta, arm_radius=R, principal_angle=phi, column_step=STEP
    )
    assert 1000 * before == pytest.approx(distances[1] - distances[0])
    assert 1000 * after == pytest.approx(distances[2] - distances[1])


@pytest.mark.parametrize(
    ('phi', 'at_nearest_mm', 'at_farthest_mm'), [(WIDE, 2, 30172), (NARROW, 19, 81587)]
)
def test_table_2(phi, at_nearest_mm, at_farthest_mm):
    # The paper subtracts distances already rounded to whole millimetres: 337 - 318 = 19, where
    # the difference itself is 19.77; 86686 - 5099 = 81587, where it is 81586.48.
    n = eq.search_range(phi, STEP)
    first, second, last_but_one, last = (
        round(1000 * float(eq.radial_distance(k * STEP / 2, arm_radius=R, principal_angle=phi)))
        for k in (1, 2, n - 1, n)
    )
    assert second - first == at_nearest_mm
    assert last - last_but_one == at_farthest_mm
    rig = {'arm_radius': R, 'principal_angle': phi, 'column_step': STEP}
    assert 1000 * eq.one_column_errors(STEP / 2, **rig)[1] == pytest.approx(at_nearest_mm, abs=1)
    assert 1000 * eq.one_column_errors(n * STEP / 2, **rig)[0] == pytest.approx(
        at_farthest_mm, abs=1
    )


def test_distance_is_where_both_rays_cross():
    # Two lines in the plane, intersected without eq. 2.
    phi, theta, arm = math.radians(15.0), math.radians(11.0), 0.7
    rays = []
    for gamma, psi in ((arm + theta, -phi), (arm - theta, phi)):
        origin = R * np.array([math.cos(gamma), math.sin(gamma)])
        rays.append((origin, np.array([math.cos(gamma + psi), math.sin(gamma + psi)])))
    (o1, d1), (o2, d2) = rays
    t, _ = np.linalg.solve(np.stack([d1, -d2], axis=1), o2 - o1)
    crossing = o1 + t * d1
    assert math.atan2(crossing[1], crossing[0]) == pytest.approx(arm)
    distance = eq.radial_distance(theta, arm_radius=R, principal_angle=phi)
    assert float(distance) == pytest.approx(np.hypot(*crossing))


def test_distance_is_infinite_at_parallel_rays_and_unknown_beyond():
    phi = math.radians(15.0)
    distance = eq.radial_distance([phi, phi + 0.01, -0.01], arm_radius=R, principal_angle=phi)
    assert distance[0] == math.inf
    assert np.isnan(distance[1:]).all()


def test_trusted_distance_is_the_last_with_an_error_below_the_bound():
    rig = {'arm_radius': R, 'principal_angle': WIDE, 'column_step': STEP}
    trusted = eq.trusted_distance(0.20, **rig)
    columns = np.arange(1, 150)
    distances = eq.radial_distance(columns * STEP / 2, arm_radius=R, principal_angle=WIDE)
    k = int(np.argmin(np.abs(distances - trusted)))
    assert distances[k] == trusted
    assert distances[k] - distances[k - 1] <= 0.20 < distances[k + 1] - distances[k]


def test_trusted_distance_is_unknown_when_no_distance_is_that_precise():
    rig = {'arm_radius': R, 'principal_angle': NARROW, 'column_step': STEP}
    assert math.isnan(eq.trusted_distance(0.001, **rig))


@pytest.mark.parametrize(
    ('arguments', 'named'),
    [
        ({'arm_radius': 0.0, 'principal_angle': WIDE}, 'arm_radius'),
        ({'arm_radius': R, 'principal_angle': 2.0}, 'principal_angle'),
    ],
)
def test_impossible_rig_is_refused_by_name(arguments, named):
    with pytest.raises(ValueError, match=named):
        eq.radial_distance(0.1, **arguments)


def test_pinhole_angle_is_that_of_a_camera_with_this_view():
    # 34 degrees over 160 columns: f = 80/tan 17 degrees; columns 141 apart are at 70.5 px.
    f = 80 / math.tan(math.radians(17))
    phi = eq.pinhole_principal_angle(math.radians(34), 160, 141)
    assert phi == pytest.approx(math.atan(70.5 / f), abs=1e-15)
    assert math.degrees(phi) == pytest.approx(15.0789, abs=1e-4)
    # The linear rule is off by 0.1 degree: 6.6 % of the distance at 3 m.
    linear = eq.linear_principal_angle(math.radians(34), 160, 141)
    assert math.degrees(phi - linear) == pytest.approx(0.0976, abs=1e-4)


@pytest.mark.parametrize('columns', [1.0, 17.0, 141.0])
def test_separations_are_the_inverse_of_the_angles(columns):
    view = math.radians(34)
    pinhole = eq.pinhole_principal_angle(view, 160, columns)
    assert eq.pinhole_separation(view, 160, pinhole) == pytest.approx(columns)
    linear = eq.linear_principal_angle(view, 160, columns)
    assert eq.linear_separation(view, 160, linear) == pytest.approx(columns)


@pytest.mark.parametrize('distance', [0.31, 1.0, 3.0, 50.0])
def test_theta_at_a_distance_is_the_inverse_of_equation_2(distance):
    theta = eq.theta_at(distance, arm_radius=R, principal_angle=WIDE)
    found = eq.radial_distance(theta, arm_radius=R, principal_angle=WIDE)
    assert float(found) == pytest.approx(distance, rel=1e-12)


@pytest.mark.parametrize('distance', [0.2, 0.3, math.inf, math.nan])
def test_theta_within_the_circle_of_the_camera_is_refused(distance):
    with pytest.raises(ValueError, match=r'distance is .* above the arm_radius of 0.3 m'):
        eq.theta_at(distance, arm_radius=R, principal_angle=WIDE)


@pytest.mark.parametrize(('distance', 'allowed'), [(1.0, 0.05), (3.0, 0.15), (3.0, 2.0)])
def test_needed_viewing_circle_has_the_allowed_error(distance, allowed):
    circle = eq.needed_viewing_circle(allowed, distance, STEP)
    for phi in (WIDE, math.radians(40.0)):  # whatever makes up the circle
        rig = {'arm_radius': circle / math.sin(phi), 'principal_angle': phi}
        theta = eq.theta_at(distance, **rig)
        assert eq.one_column_errors(theta, column_step=STEP, **rig)[1] == pytest.approx(allowed)


@pytest.mark.parametrize(('allowed', 'distance'), [(0.0, 1.0), (0.1, 0.0)])
def test_needed_viewing_circle_of_nothing_is_refused(allowed, distance):
    with pytest.raises(ValueError, match='both above 0'):
        eq.needed_viewing_circle(allowed, distance, STEP)


def test_trusted_distance_for_a_share_of_the_distance():
    rig = {'arm_radius': R, 'principal_angle': WIDE, 'column_step': STEP}
    trusted = eq.trusted_distance(0.05, relative=True, **rig)
    columns = np.arange(1, 150)
    distances = eq.radial_distance(columns * STEP / 2, arm_radius=R, principal_angle=WIDE)
    k = int(np.flatnonzero(distances == trusted)[0])
    assert distances[k] - distances[k - 1] <= 0.05 * distances[k]
    assert distances[k + 1] - distances[k] > 0.05 * distances[k + 1]
