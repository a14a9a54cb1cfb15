"""``panodepth_ros analyse``: the paper's numbers to the digit, and what it refuses."""

import json
import re
import subprocess
import sys

import cv2
import pytest

from panodepth_ros.cli.main import main


def analysed(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    """Lines of the output, runs of blanks made one."""
    assert main(['analyse', *arguments]) == 0
    captured = capsys.readouterr()
    assert captured.err == ''
    return [' '.join(line.split()) for line in captured.out.splitlines()]


def test_the_paper_to_the_digit(capsys):
    lines = analysed(capsys, '--paper', '--motor-steps', '7000')
    for line in (
        "2φ, paper's linear rule (eq. 3) 29.9625° 3.6125°",
        '2φ, exact pinhole 30.1577° 3.7211°',
        'viewing circle r0 = r·sin φ (sec. 4) 77.6 mm 9.5 mm',
        'image columns of a step, W_s (sec. 3) 0.941 px 0.941 px',
        'n, columns to search = depths (sec. 6.2) 149 18',
        'nearest distance l_min 302 mm 318 mm',
        'farthest distance l_max 54687 mm 86686 mm',
        # Table 1: three distances and two errors.
        '2φ = 29.9625°, θ = φ/4 394.5 398 401.5 3.5 3.5',
        '2φ = 3.6125°, θ = φ/4 372.5 400 431.8 27.5 31.8',
        '2φ = 29.9625°, θ = 7φ/8 2252.9 2373.2 2507 120.3 133.8',
        '2φ = 3.6125°, θ = 7φ/8 1663 2399.6 4307.4 736.6 1907.8',
        # Table 2: the paper subtracts distances rounded to millimetres.
        '2φ = 29.9625°, Δl_min 2.00 2',
        '2φ = 3.6125°, Δl_min 19.77 19',
        '2φ = 29.9625°, Δl_max 30172.25 30172',
        '2φ = 3.6125°, Δl_max 81586.48 81587',
        'a column step is 3.889 motor steps of 0.0514286°: columns lie up to 0.0257° off',
    ):
        assert line in lines
    assert 'sweep of 1501 columns (sec. 6.1) frames time arm exposure ≤' in lines


def test_arguments_equal_to_the_papers_give_the_papers_numbers(capsys):
    paper = analysed(capsys, '--paper')
    rig = '--radius 0.3 --fov 34 --width 160 --offset 70.5 8.5 --step 0.2 --linear --sweep 300.2'
    assert analysed(capsys, *rig.split()) == paper


def test_what_is_given_beside_the_paper_counts(capsys):
    # Sec. 6.3: twice the radius makes twice the distances and twice the errors.
    lines = analysed(capsys, '--paper', '--radius', '0.6')
    assert 'farthest distance l_max 109375 mm 173371 mm' in lines
    assert '2φ = 29.9625°, θ = 7φ/8 4505.8 4746.3 5014 240.5 267.7' in lines
    # Half the step halves the errors, nearly.
    lines = analysed(capsys, '--paper', '--step', '0.1')
    assert '2φ = 29.9625°, θ = 7φ/8 2311.5 2373.2 2438.2 61.7 65' in lines
    assert 'n, columns to search = depths (sec. 6.2) 299 36' in lines


def test_the_exact_angle_is_the_default(capsys):
    lines = analysed(capsys, '--at', '3')
    assert lines[0].endswith('φ by the exact pinhole')
    assert 'n, columns to search = depths (sec. 6.2) 150' in lines
    assert any(line.startswith('at 3 m 0.189 m 0.216 m 7.2%') for line in lines)


def needs(lines: list[str]) -> tuple[float, float]:
    """Radius [m] and column offset [px] that the one distance asked for needs."""
    (found,) = (re.search(r'r ≥ (\d+) mm, or columns ≥ ±([\d.]+) px', line) for line in lines
                if line.startswith('at '))  # fmt: skip
    return float(found[1]) / 1000, float(found[2])


def far_error(lines: list[str]) -> float:
    (line,) = (line for line in lines if line.startswith('at '))
    return float(line.split()[5])


@pytest.mark.parametrize('rule', [[], ['--linear']])
@pytest.mark.parametrize(('allow', 'bound'), [('5%', 0.10), ('0.12', 0.12)])
def test_what_it_says_is_needed_keeps_the_error(capsys, rule, allow, bound):
    asked = ['--at', '2', '--allow', allow, *rule]
    radius, offset = needs(analysed(capsys, *asked))
    # Radius and offset are printed rounded, the error to a millimetre.
    assert far_error(analysed(capsys, *asked, '--radius', f'{radius}')) == pytest.approx(
        bound, abs=0.0012
    )
    kept = far_error(analysed(capsys, *asked, '--offset', f'{offset}'))
    assert bound - 0.0012 <= kept <= bound + 0.0005


def test_it_says_when_no_column_and_no_radius_suffices(capsys):
    lines = analysed(capsys, '--at', '3', '--allow', '5%')
    assert any('r ≥ 423 mm, or no column of this lens (±79.5 px)' in line for line in lines)
    lines = analysed(capsys, '--at', '1', '--allow', '5%', '--offset', '8.5')
    assert any('no radius (it would reach there), or columns ≥ ±32.2 px' in line for line in lines)


def test_capture_times_by_formula(capsys):
    motor = '--speed 30 --acceleration 3600 --settle 0 --frame-rate 60 --stripe 1 5'
    lines = analysed(capsys, *motor.split())
    for line in (
        'stop and go, 1 column 1800 60.0 s stands any',
        'stop and go, 5 columns 360 24.0 s stands any',
        'turning steadily, 1 column 1800 30.0 s 12.0 °/s 8.3 ms',
        'turning steadily, 5 columns 360 12.0 s 30.0 °/s 3.3 ms',
    ):
        assert line in lines


def test_widest_stripe_divides_the_turn(capsys):
    # 19 columns lie within the image, but 1800 are no multiple of 19.
    lines = analysed(capsys)
    assert any(line.startswith('stop and go, 18 columns 100 ') for line in lines)


@pytest.mark.parametrize(
    ('arguments', 'said'),
    [
        ('--radius 0', 'radius is 0 m; allowed: above 0'),
        ('--fov 180', 'fov is 180°; allowed: above 0°, below 180°'),
        ('--width 1', 'width is 1 px; allowed: at least 2'),
        ('--offset 80', 'offset is 80 px; allowed: above 0, at most 79.5'),
        ('--offset nan', 'offset is nan px; allowed: above 0, at most 79.5'),
        (
            '--offset 0.5',
            'which leaves 1 columns to search at a step of 0.2°; allowed: at least 2',
        ),
        ('--step 0.7', 'step is 0.7°; allowed: a whole fraction of 360°'),
        ('--sweep 361', 'sweep is 361°; allowed: above 0°, at most 360°'),
        ('--at 0.3', 'distance is 0.3 m; allowed: above the arm_radius of 0.3 m'),
        ('--stripe 20', 'stripe is 20; allowed: 1 to 19 columns'),
        ('--stripe 7', 'stripe is 7; allowed: a divisor of the 1800 columns of a turn'),
        ('--motor-steps 0', 'motor-steps is 0; allowed: at least 1'),
        ('--speed -3', ' speed is -3 °/s; allowed: finite and above 0'),
        ('--frame-rate 0', 'frame_rate is 0.0 Hz; allowed: finite and above 0'),
    ],
)
def test_impossible_rig_is_told_in_one_sentence(capsys, arguments, said):
    assert main(['analyse', *arguments.split()]) == 1
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.startswith('panodepth_ros analyse: ')
    assert captured.err.count('\n') == 1
    assert said in captured.err


@pytest.mark.parametrize('allow', ['0', '-5%', '%', 'inf', 'much'])
def test_impossible_allowed_error_is_refused(capsys, allow):
    with pytest.raises(SystemExit) as caught:
        main(['analyse', f'--allow={allow}'])
    assert caught.value.code == 2
    assert '5%' in capsys.readouterr().err


def test_figures_4_and_5_are_drawn(capsys, tmp_path):
    pytest.importorskip('matplotlib')
    assert (
        'wrote figure_4.png' in analysed(capsys, '--paper', '--figures', str(tmp_path / 'new'))[-1]
    )
    for name in ('figure_4.png', 'figure_5.png'):
        height, width, _ = cv2.imread(str(tmp_path / 'new' / name)).shape
        assert width > 2 * height  # two rigs side by side


PROBE = """
import json, sys
for missing in ('matplotlib', 'rclpy', 'rosbags', 'sensor_msgs'):
    sys.modules[missing] = None  # as if it were not installed
from panodepth_ros.cli.main import main
sys.exit(main(json.loads(sys.argv[1])))
"""


def without_ros_and_matplotlib(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, '-c', PROBE, json.dumps(arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.launch
def test_it_needs_neither_ros_nor_matplotlib_but_to_draw(tmp_path):
    done = without_ros_and_matplotlib('analyse', '--paper')
    assert (done.returncode, done.stderr) == (0, '')
    done = without_ros_and_matplotlib('analyse', '--figures', str(tmp_path / 'new'))
    assert done.returncode == 1
    assert done.stderr.count('\n') == 1
    assert 'pip install "panodepth_ros[plot]"' in done.stderr
    assert not (tmp_path / 'new').exists()


def test_safe_speed_of_an_exposure_is_told(capsys):
    lines = analysed(capsys, '--exposure', '5')
    said = (
        'an exposure of 5 ms blurs by half a column at 20.0 °/s, a turn of 18.0 s; turn no faster'
    )
    assert said in lines
