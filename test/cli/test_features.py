"""Features measured by hand: their file, and how they are compared."""

import math
from pathlib import Path

import numpy as np
import pytest

from panodepth_ros.cli.features import FeaturesError, compare, load_features, table
from panodepth_ros.geometry import Points

NAN = math.nan


def load(tmp_path: Path, text: str):
    path = tmp_path / 'features.yaml'
    path.write_text(text)
    return load_features(path)


def test_three_ways_to_say_where(tmp_path):
    by_azimuth, by_position, by_pixel = load(
        tmp_path,
        """
features:
  - {name: door, azimuth_deg: -90, distance: 2}
  - {position: [3.0, 4.0]}
  - {pixel: [2, 1], distance: 1.5}
""",
    )
    assert (by_azimuth.name, by_azimuth.distance) == ('door', 2.0)
    assert by_azimuth.azimuth == pytest.approx(-math.pi / 2)
    assert by_position.distance == pytest.approx(5.0)
    assert by_position.azimuth == pytest.approx(math.atan2(4.0, 3.0))
    assert (by_pixel.pixel, by_pixel.distance) == ((2, 1), 1.5)
    assert math.isnan(by_pixel.azimuth)


def test_the_demos_features_are_well_formed():
    file = Path(__file__).resolve().parents[2] / 'docs' / 'demo_features.yaml'
    assert len(load_features(file)) == 13


@pytest.mark.parametrize(
    ('entry', 'said'),
    [
        ('door', "feature 1 of .* is 'door'; allowed: keys name, azimuth_deg"),
        ('{azimuth: 3, distance: 1}', 'feature 1 of .* has azimuth; allowed: name, azimuth_deg'),
        ('{distance: 1}', 'has no place; allowed: one of azimuth_deg, position, pixel'),
        (
            '{pixel: [1, 1], azimuth_deg: 3, distance: 1}',
            'has azimuth_deg and pixel; allowed: one',
        ),
        ('{position: [1, 1], distance: 1}', 'has position and distance; allowed: one of them'),
        ('{azimuth_deg: 3}', r'has no distance \[m\]'),
        ('{azimuth_deg: 3, distance: far}', "distance of .* is 'far'; allowed: a finite number"),
        ('{azimuth_deg: 3, distance: true}', 'distance of .* is True; allowed: a finite number'),
        ('{azimuth_deg: .nan, distance: 1}', 'azimuth_deg of .* is nan; allowed: a finite number'),
        ('{azimuth_deg: 3, distance: 0}', 'distance of .* is 0 m; allowed: above 0'),
        ('{position: [0, 0]}', 'distance of .* is 0 m; allowed: above 0'),
        ('{position: [1, 2, 3]}', r'position of .* is \[1, 2, 3\]; allowed: two numbers'),
        ('{position: 1}', 'position of .* is 1; allowed: two numbers'),
        ('{pixel: [1.5, 2], distance: 1}', r'pixel of .* is \[1.5, 2\]; allowed: whole numbers'),
    ],
)
def test_wrong_feature_is_told_by_number_and_key(tmp_path, entry, said):
    with pytest.raises(FeaturesError, match=said):
        load(tmp_path, f'features:\n  - {entry}\n')


@pytest.mark.parametrize('text', ['', '- 1', 'features: {}', 'features: []', 'points: [1]'])
def test_file_without_features_is_refused(tmp_path, text):
    with pytest.raises(FeaturesError, match=r'features.yaml has no list "features"'):
        load(tmp_path, text)


@pytest.mark.parametrize('text', ['features: [', '!!python/object/apply:os.getcwd []'])
def test_what_is_no_plain_yaml_is_refused(tmp_path, text):
    with pytest.raises(FeaturesError, match=r'features.yaml is no YAML: '):
        load(tmp_path, text)


def test_file_that_is_too_long_is_refused_unread(tmp_path):
    with pytest.raises(FeaturesError, match=r'features.yaml is longer than 1000000 bytes'):
        load(tmp_path, '#' * 1_000_001)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(FeaturesError, match=r'nowhere.yaml cannot be read: No such file'):
        load_features(tmp_path / 'nowhere.yaml')


def points(distance: list[list[float]]) -> Points:
    l = np.array(distance)  # noqa: E741
    azimuth = np.where(np.isfinite(l), np.linspace(2, -2, l.shape[1]), NAN)
    return Points(radial_distance=l, azimuth=azimuth, height=np.zeros(l.shape))


GRID = points([[1.0, NAN, NAN, 5.0], [1.1, NAN, NAN, 5.0], [NAN, NAN, NAN, 5.0]])


def compared(tmp_path: Path, entry: str, azimuth_deg=(), distance=()):
    features = load(tmp_path, f'features:\n  - {entry}\n')
    plan = np.radians(np.array(azimuth_deg, float)), np.array(distance, float)
    (comparison,) = compare(features, GRID, *plan)
    return comparison


def test_feature_is_compared_with_the_nearest_azimuth_of_the_plan(tmp_path):
    entry = '{azimuth_deg: 179.8, distance: 2.0}'
    found = compared(tmp_path, entry, [-179.9, 179.0, 0.0], [2.1, 3.0, 4.0])  # wraps around
    assert found.estimated == 2.1
    assert found.error == pytest.approx(0.1)


def test_feature_without_a_near_point_is_unknown(tmp_path):
    entry = '{azimuth_deg: 20, distance: 2.0}'
    assert math.isnan(compared(tmp_path, entry, [18.9, 21.1], [2.0, 2.0]).estimated)
    assert math.isnan(compared(tmp_path, entry).estimated)


def test_pixel_is_compared_with_the_median_about_it(tmp_path):
    # Its neighbours wrap around: 1.0, 1.1, and 5.0 three times.
    found = compared(tmp_path, '{pixel: [0, 1], distance: 4.0}')
    assert found.estimated == 5.0
    assert found.azimuth == GRID.azimuth[0, 3]


def test_unknown_pixel_is_unknown(tmp_path):
    grid = points([[1.0, NAN, NAN, NAN, 5.0]])
    features = load(tmp_path, 'features: [{pixel: [2, 0], distance: 4.0}]')
    (found,) = compare(features, grid, np.array([]), np.array([]))
    assert math.isnan(found.estimated)
    assert math.isnan(found.azimuth)


@pytest.mark.parametrize('pixel', ['[4, 0]', '[-1, 0]', '[0, 3]'])
def test_pixel_outside_of_the_panorama_is_refused(tmp_path, pixel):
    with pytest.raises(FeaturesError, match=r'allowed: \[0, 0\] to \[3, 2\]'):
        compared(tmp_path, f'{{pixel: {pixel}, distance: 1}}')


def test_table_has_measured_estimated_and_error(tmp_path):
    features = load(
        tmp_path,
        """
features:
  - {name: door, azimuth_deg: 0, distance: 2.0}
  - {azimuth_deg: 90, distance: 1.0}
  - {azimuth_deg: 45, distance: 1.0}
""",
    )
    plan = np.radians([0.0, 90.0]), np.array([2.1, 0.98])
    lines = [' '.join(line.split()) for line in table(compare(features, GRID, *plan)).splitlines()]
    assert lines == [
        'feature measured estimated error',
        '1 door 2.000 m 2.100 m +0.100 m +5.0%',
        '2 feature 1.000 m 0.980 m -0.020 m -2.0%',
        '3 feature 1.000 m unknown',
        'median error 3.5%, largest 5.0%, 2 of 3 features found',
    ]
