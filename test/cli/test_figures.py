"""``panodepth_ros figures`` and ``ply``: from a bag to pictures and points."""

import json
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip('rosbags', reason='bags need rosbags')

from fixtures.bags import (
    joint_states,
    panorama_pair,
    striped_pair,
    write_joint_states,
    write_panoramas,
)

from panodepth_ros.cli.figures import nearer_is_lighter
from panodepth_ros.cli.main import main
from panodepth_ros.cli.sweeps import PAIR, read_pair
from panodepth_ros.export.ply import VERTEX

COLUMNS, ROWS, DX = 360, 24, 12
#: Eq. 2 with φ = 20.5 and θ = 12 half columns.
DISTANCE = 0.3 * math.sin(math.radians(20.5 / 2)) / math.sin(math.radians((20.5 - DX) / 2))


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)


@pytest.fixture(scope='module')
def bag(tmp_path_factory) -> Path:
    """A room that is a cylinder about the axis."""
    return write_panoramas(tmp_path_factory.mktemp('room') / 'bag', [panorama_pair(noise(1), DX)])


def errors(printed: str) -> list[float]:
    """Errors of the features in the printed table [%]."""
    return [float(line.split()[-1].rstrip('%')) for line in printed.splitlines() if ' m  ' in line]


def test_figures_of_a_bag(capsys, bag, tmp_path):
    pytest.importorskip('matplotlib')
    features = tmp_path / 'features.yaml'
    features.write_text(f"""
features:
  - {{azimuth_deg: 30, distance: {DISTANCE / 1.25}}}
  - {{pixel: [7, 12], distance: {DISTANCE}}}
""")
    output = tmp_path / 'new' / 'figures'
    arguments = ['--output', str(output), '--features', str(features), '--method', 'ncc']
    assert main(['figures', str(bag), *arguments]) == 0
    names = {path.name for path in output.iterdir()}
    assert names == {'figure_6.png', 'figure_7.png', *(f'figure_6{c}.png' for c in 'abcde')}
    a, b, c, d, e = (cv2.imread(str(output / f'figure_6{x}.png'), -1) for x in 'abcde')
    np.testing.assert_array_equal(a, noise(1))
    for picture in (b, c, d, e):
        assert picture.shape == (ROWS, COLUMNS)
    assert (b > 0).mean() > 0.99
    assert (c[b > 0] > 250).all()  # the right eye is a copy
    assert (d > 0).mean() > 0.99
    assert 0.05 < (e > 0).mean() < 0.5
    printed = capsys.readouterr().out
    out = ' '.join(printed.split())
    assert 'matching 360 × 24 pixels, 1 thread(s)' in out
    for of_paper in ('6 h 42 min 20 s', '3 h 21 min 56 s', '38 s'):
        assert of_paper in out
    assert errors(printed) == pytest.approx([25, 0], abs=2)
    assert '2 of 2 features found' in out


def test_ground_plan_of_one_row(capsys, bag, tmp_path):
    pytest.importorskip('matplotlib')
    features = tmp_path / 'features.yaml'
    features.write_text(f'features: [{{azimuth_deg: -100, distance: {DISTANCE}}}]')
    arguments = ['--row', '3', '--features', str(features), '--method', 'ncc']
    assert main(['figures', str(bag), '--output', str(tmp_path / 'new'), *arguments]) == 0
    assert errors(capsys.readouterr().out) == pytest.approx([0], abs=2)


def test_near_is_light_and_unknown_is_black():
    distance = np.array([[0.2, 0.3, 0.7, 2.3, 9.0, np.nan]])
    levels = nearer_is_lighter(distance, 0.3, 2.3)
    assert levels.tolist() == [[255, 255, 212, 40, 40, 0]]


def test_points_of_a_bag(capsys, bag, tmp_path):
    path = tmp_path / 'points.ply'
    assert main(['ply', str(bag), '-o', str(path), '--method', 'ncc']) == 0
    body = path.read_bytes().partition(b'end_header\n')[2]
    points = np.frombuffer(body, VERTEX)
    assert points.size > 0.99 * ROWS * COLUMNS
    assert capsys.readouterr().out == f'{path}: {points.size} points\n'
    assert np.hypot(points['x'], points['y']) == pytest.approx(DISTANCE, rel=0.02)
    # The first pixel: β of column 0 is half a turn, less φ on the left; α = β + asin(r0/l).
    pixels = noise(1).reshape(-1, 3)
    assert [points[0][name] for name in ('blue', 'green', 'red')] == pixels[0].tolist()
    r0 = 0.3 * math.sin(math.radians(10.25))
    azimuth = math.radians(180 - 10.25) + math.asin(r0 / DISTANCE)
    assert math.atan2(points[0]['y'], points[0]['x']) == pytest.approx(azimuth, abs=0.01)
    d = math.sqrt(DISTANCE**2 - r0**2) - 0.3 * math.cos(math.radians(10.25))
    assert points[0]['z'] == pytest.approx(d * 11.5 / 50, rel=0.05)


@pytest.mark.parametrize('farthest', ['0', '-1', 'nan'])
def test_impossible_farthest_distance_is_refused(capsys, bag, farthest):
    with pytest.raises(SystemExit) as caught:
        main(['ply', str(bag), '--farthest', farthest])
    assert caught.value.code == 2
    assert 'metres, above 0' in capsys.readouterr().err


@pytest.mark.parametrize('row', [-2, ROWS])
def test_row_outside_of_the_panorama_is_refused(capsys, bag, tmp_path, row):
    pytest.importorskip('matplotlib')
    assert main(['figures', str(bag), '--output', str(tmp_path / 'new'), '--row', str(row)]) == 1
    assert f'--row is {row}; allowed: -1 to {ROWS - 1}' in capsys.readouterr().err


@pytest.mark.parametrize('command', ['ply', 'figures'])
def test_topics_of_other_types_are_told(capsys, tmp_path, command):
    pytest.importorskip('matplotlib')
    states = [state for topic in PAIR for state in joint_states(f'/{topic}', 2, 0.1)]
    bag = write_joint_states(tmp_path / 'bag', states)
    assert main([command, str(bag)]) == 1
    assert 'is of type sensor_msgs/msg/JointState; allowed: sens' in capsys.readouterr().err


def middle(values: np.ndarray) -> float:
    """How far apart the middle 68 % of some values lie."""
    low, high = np.percentile(values, [16, 84])
    return float(high - low)


@pytest.fixture(scope='module')
def striped_bag(tmp_path_factory) -> Path:
    """A cylinder of 1 m; by each column's own ray it would be a saw of 0.10 m, not 0.02 m."""
    return write_panoramas(tmp_path_factory.mktemp('stripes') / 'bag', [striped_pair(5, 1.0)])


def test_points_of_stripes_lie_on_a_smooth_wall(striped_bag, tmp_path):
    path = tmp_path / 'points.ply'
    assert main(['ply', str(striped_bag), '-o', str(path), '--method', 'ncc']) == 0
    points = np.frombuffer(path.read_bytes().partition(b'end_header\n')[2], VERTEX)
    assert points.size > 0.9 * ROWS * COLUMNS
    distance = np.hypot(points['x'], points['y'])
    assert np.median(distance) == pytest.approx(1.0, rel=0.03)
    assert middle(distance) < 0.04


def test_figures_of_stripes_show_a_smooth_wall(capsys, striped_bag, tmp_path):
    pytest.importorskip('matplotlib')
    features = tmp_path / 'features.yaml'
    lines = [f'  - {{azimuth_deg: {azimuth}, distance: 1.0}}' for azimuth in range(-177, 180, 7)]
    features.write_text('\n'.join(['features:', *lines]))
    arguments = ['--output', str(tmp_path), '--features', str(features)]
    arguments += ['--row', '12', '--method', 'ncc']
    assert main(['figures', str(striped_bag), *arguments]) == 0
    assert middle(np.array(errors(capsys.readouterr().out))) < 4.0
    levels = cv2.imread(str(tmp_path / 'figure_6b.png'), -1)
    assert middle(levels[levels > 0]) < 15


def test_far_points_are_left_out(bag, tmp_path):
    path = tmp_path / 'points.ply'
    arguments = ['-o', str(path), '--method', 'ncc', '--farthest', f'{DISTANCE / 2}']
    assert main(['ply', str(bag), *arguments]) == 0
    assert b'element vertex 0\n' in path.read_bytes()


def test_last_complete_sweep_is_read(tmp_path):
    sweeps = [panorama_pair(noise(seed), DX) for seed in (1, 2, 3)]
    sweeps[2] = sweeps[2][:1]  # recording ended before the right eye came
    bag = write_panoramas(tmp_path / 'bag', sweeps, 'sqlite3', '/robot')
    left, right = read_pair(bag, 'robot')
    np.testing.assert_array_equal(left.image, noise(2))
    np.testing.assert_array_equal(right.image, sweeps[1][1].image)
    assert right.geometry.principal_angle == pytest.approx(math.radians(10.25))
    assert left.geometry.azimuth_column == sweeps[1][0].geometry.azimuth_column


def test_folder_of_the_demo_is_taken_for_its_bag(bag):
    left, _ = read_pair(bag.parent)
    np.testing.assert_array_equal(left.image, noise(1))


def failed(capsys, *arguments: str) -> str:
    """The one sentence of a command that fails."""
    assert main(list(arguments)) == 1
    captured = capsys.readouterr()
    assert captured.err.startswith(f'panodepth_ros {arguments[0]}: ')
    assert captured.err.count('\n') == 1
    return captured.err


@pytest.mark.parametrize('command', ['figures', 'ply'])
def test_bag_without_panoramas_is_refused(capsys, tmp_path, command):
    pytest.importorskip('matplotlib')
    output = ['--output', str(tmp_path / 'new')]
    said = failed(capsys, command, str(tmp_path / 'nowhere'), *output)
    assert 'nowhere does not exist' in said
    raw = write_joint_states(tmp_path / 'raw', [('/joint_states', 10**18, 0.0)])
    assert 'has no topic /left/camera_info' in failed(capsys, command, str(raw), *output)
    half = write_panoramas(tmp_path / 'half', [panorama_pair(noise(1), DX)[:1]])
    said = failed(capsys, command, str(half), *output)
    assert 'holds no complete sweep: no /left/image, /left/camera_info, /right/image' in said
    twice = write_panoramas(tmp_path / 'twice', [panorama_pair(noise(1), DX)[:1] * 2])
    assert 'principal_angle is' in failed(capsys, command, str(twice), *output)
    assert not (tmp_path / 'new').exists()


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        (['--row', '24'], '--row is 24; allowed: -1 to 23'),
        (['--band', '1', '-1'], 'min_height is 1.0 m and max_height -1.0 m'),
        (['--threads', '0'], 'threads is 0; allowed: at least 1'),
        (['--features', 'nowhere.yaml'], 'features nowhere.yaml cannot be read'),
    ],
)
def test_impossible_arguments_are_told(capsys, bag, tmp_path, arguments, said):
    pytest.importorskip('matplotlib')
    output = tmp_path / 'new'
    plan = ['figures', str(bag), '--output', str(output), '--method', 'ncc', *arguments]
    assert said in failed(capsys, *plan)
    assert not output.exists()


def test_points_that_cannot_be_written_are_told(capsys, bag, tmp_path):
    said = failed(capsys, 'ply', str(bag), '--method', 'ncc', '-o', str(tmp_path / 'no' / 'p.ply'))
    assert 'no is not a folder' in said


@pytest.mark.parametrize('value', ['-0.1', '1.1', 'nan', 'x'])
def test_share_outside_of_0_to_1_is_refused(capsys, bag, value):
    with pytest.raises(SystemExit) as caught:
        main(['ply', str(bag), f'--min-confidence={value}'])
    assert caught.value.code == 2
    assert 'share (0 to 1)' in capsys.readouterr().err


PROBE = """
import json, sys
for missing in json.loads(sys.argv[1]):
    sys.modules[missing] = None  # as if it were not installed
from panodepth_ros.cli.main import main
sys.exit(main(json.loads(sys.argv[2])))
"""


def without(missing: list[str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-c', PROBE, json.dumps(missing), json.dumps(arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)


@pytest.mark.launch
def test_points_need_no_ros(bag, tmp_path):
    ros = ['rclpy', 'sensor_msgs', 'std_msgs', 'builtin_interfaces']
    done = without(ros, 'ply', str(bag), '-o', str(tmp_path / 'p.ply'), '--method', 'ncc')
    assert (done.returncode, done.stderr) == (0, '')


@pytest.mark.launch
def test_figures_tell_what_to_draw_with(bag, tmp_path):
    done = without(['matplotlib'], 'figures', str(bag), '--output', str(tmp_path / 'new'))
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert 'pip install "panodepth_ros[plot]"' in done.stderr
    assert not (tmp_path / 'new').exists()
