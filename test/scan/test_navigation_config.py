"""The navigation stacks' example configurations: names that exist, values that fit our scan."""

from pathlib import Path

import pytest
import yaml

from panodepth_ros.scan.beams import ScanSettings

CONFIG = Path(__file__).resolve().parents[2] / 'config'
OURS = {'simulated.yaml', 'simulated_spin.yaml', 'real.yaml'}
NAVIGATION = ('nav2_costmap.yaml', 'amcl.yaml', 'slam_toolbox.yaml')

#: Parameters and their types as declared in the sources (navigation2 jazzy, slam_toolbox 2.7):
#: a misspelt name or an int for a double would be ignored or refused by the node.
COSTMAP = {
    **dict.fromkeys(('global_frame', 'robot_base_frame'), str),
    **dict.fromkeys(('transform_tolerance', 'update_frequency', 'publish_frequency'), float),
    **dict.fromkeys(('resolution', 'robot_radius'), float),
    **dict.fromkeys(('rolling_window', 'track_unknown_space'), bool),
    **dict.fromkeys(('width', 'height'), int),
    'plugins': list,
}
OBSTACLE_LAYER = {
    **dict.fromkeys(('plugin', 'observation_sources'), str),
    **dict.fromkeys(('enabled', 'footprint_clearing_enabled'), bool),
    **dict.fromkeys(('min_obstacle_height', 'max_obstacle_height'), float),
}
SOURCE = {
    **dict.fromkeys(('topic', 'data_type', 'sensor_frame'), str),
    **dict.fromkeys(('marking', 'clearing', 'inf_is_valid'), bool),
    **dict.fromkeys(('min_obstacle_height', 'max_obstacle_height'), float),
    **dict.fromkeys(('obstacle_min_range', 'obstacle_max_range'), float),
    **dict.fromkeys(('raytrace_min_range', 'raytrace_max_range'), float),
    **dict.fromkeys(('observation_persistence', 'expected_update_rate'), float),
}
INFLATION_LAYER = {'plugin': str, 'inflation_radius': float, 'cost_scaling_factor': float}
STATIC_LAYER = {'plugin': str, 'map_subscribe_transient_local': bool}
MONITOR = {'base_shift_correction': bool, 'observation_sources': list}
MONITOR_SOURCE = {'type': str, 'topic': str, 'enabled': bool, 'source_timeout': float}
AMCL = {
    **dict.fromkeys(('scan_topic', 'base_frame_id', 'odom_frame_id', 'global_frame_id'), str),
    'laser_model_type': str,
    **dict.fromkeys(('laser_min_range', 'laser_max_range', 'laser_likelihood_max_dist'), float),
    **dict.fromkeys(('max_beams', 'resample_interval', 'min_particles', 'max_particles'), int),
    **dict.fromkeys(('sigma_hit', 'z_hit', 'z_rand', 'update_min_d', 'update_min_a'), float),
    'transform_tolerance': float,
}
SLAM = {
    **dict.fromkeys(('scan_topic', 'base_frame', 'odom_frame', 'map_frame'), str),
    **dict.fromkeys(('throttle_scans', 'scan_queue_size', 'scan_buffer_size'), int),
    'loop_match_minimum_chain_size': int,
    **dict.fromkeys(('use_scan_matching', 'use_scan_barycenter'), bool),
    **dict.fromkeys(('resolution', 'max_laser_range', 'map_update_interval'), float),
    **dict.fromkeys(('minimum_time_interval', 'minimum_travel_distance'), float),
    **dict.fromkeys(('minimum_travel_heading', 'transform_timeout', 'tf_buffer_duration'), float),
    **dict.fromkeys(('transform_publish_period', 'link_scan_maximum_distance'), float),
    'scan_buffer_maximum_scan_distance': float,
    'correlation_search_space_dimension': float,
    'correlation_search_space_resolution': float,
    'correlation_search_space_smear_deviation': float,
}
LAYERS = {
    'obstacle_layer': OBSTACLE_LAYER,
    'inflation_layer': INFLATION_LAYER,
    'static_layer': STATIC_LAYER,
}


def load(name):
    return yaml.safe_load((CONFIG / name).read_text())


def fit(values, table):
    """Assert that scalars have a name and a type of the table."""
    scalars = {key: value for key, value in values.items() if not isinstance(value, dict)}
    assert {key: type(value) for key, value in scalars.items()} == {
        key: table.get(key) for key in scalars
    }


def costmaps():
    content = load('nav2_costmap.yaml')
    return [content[name][name]['ros__parameters'] for name in ('local_costmap', 'global_costmap')]


def test_every_configuration_is_tested_here_or_against_our_tables():
    parameter_files = {path.name for path in CONFIG.glob('*.yaml')} - {
        'camera_info_simulated.yaml'
    }
    assert parameter_files == OURS | set(NAVIGATION)


@pytest.mark.parametrize('name', NAVIGATION)
def test_every_value_gives_its_reason(name):
    lines = (CONFIG / name).read_text().splitlines()
    values = [line for line in lines if line.strip() and not line.rstrip().endswith(':')]
    assert [line for line in values if '#' not in line] == []


def test_costmap_names_and_types():
    for costmap in costmaps():
        fit(costmap, COSTMAP)
        sections = {key for key, value in costmap.items() if isinstance(value, dict)}
        assert sections == set(costmap['plugins'])
        for section in sections:
            fit(costmap[section], LAYERS[section])
        fit(costmap['obstacle_layer']['panodepth'], SOURCE)


def test_costmap_takes_a_slow_scan_above_the_floor():
    settings = ScanSettings()
    for costmap in costmaps():
        layer = costmap['obstacle_layer']
        source = layer[layer['observation_sources']]
        assert source['max_obstacle_height'] > 0
        assert source['clearing']
        assert source['marking']
        assert source['expected_update_rate'] == 0
        assert source['obstacle_max_range'] < settings.range_max
        assert source['obstacle_max_range'] < source['raytrace_max_range']
        assert source['obstacle_min_range'] >= settings.range_min
        assert costmap['track_unknown_space']


def test_collision_monitor_does_not_stop_for_a_slow_scan():
    monitor = load('nav2_costmap.yaml')['collision_monitor']['ros__parameters']
    fit(monitor, MONITOR)
    for source in monitor['observation_sources']:
        fit(monitor[source], MONITOR_SOURCE)
        assert monitor[source]['source_timeout'] == 0


def test_amcl():
    values = load('amcl.yaml')['amcl']['ros__parameters']
    fit(values, AMCL)
    assert values['max_beams'] <= ScanSettings().beams
    assert values['laser_max_range'] < ScanSettings().range_max


def test_slam_toolbox():
    values = load('slam_toolbox.yaml')['slam_toolbox']['ros__parameters']
    fit(values, SLAM)
    assert values['max_laser_range'] < ScanSettings().range_max
