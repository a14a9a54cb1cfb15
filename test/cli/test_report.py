"""``panodepth_ros report``: one HTML file, complete in itself, of a bag or a demo's folder."""

import base64
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from fixtures.browser import browser
from fixtures.sweeps import COLUMNS, HOLE, ROWS, WALL, sweep_messages, write_sweep
from rcl_interfaces.msg import Log

from panodepth_ros.cli.main import main

pytestmark = pytest.mark.ros


def bag_of(path, messages, prefix='/', extra=()):
    entries = [(f'{prefix}{topic}', 1000 + k, m) for k, (topic, m) in enumerate(messages.items())]
    return write_sweep(path, [*entries, *extra])


def reported(path, output, *options):
    assert main(['report', str(path), '--output', str(output), *options]) == 0
    return output.read_text(encoding='utf-8')


def data_of(text):
    (found,) = re.findall(r'^const data = (\{.*\});$', text, re.MULTILINE)
    return json.loads(found)


def body_of(text):
    """The page without plotly's own code."""
    return text[text.index('<body>') :]


def test_page_of_a_bag_holds_its_depth_and_its_numbers(tmp_path):
    text = reported(bag_of(tmp_path / 'bag', sweep_messages(7)), tmp_path / 'report.html')
    data = data_of(text)
    depth = np.frombuffer(base64.b64decode(data['depth']), '<u2').reshape(ROWS, COLUMNS)
    expected = np.full((ROWS, COLUMNS), round(WALL * 1000))
    expected[HOLE] = 0
    assert np.array_equal(depth, expected)
    body = body_of(text)
    assert f'{COLUMNS} × {ROWS} pixels, arm radius 30.0 cm' in body
    assert '<b>90%</b><span>of the beams hold a range' in body
    assert 'The true room is not known.' in body
    assert 'The recording holds no log.' in body


def test_time_of_a_column_is_that_of_the_columns_seen(tmp_path):
    # 12.5 s for 25 of 90 columns.
    text = reported(bag_of(tmp_path / 'bag', sweep_messages(7, seen=25)), tmp_path / 'report.html')
    assert '<td>a column</td><td>500 ms</td>' in text
    assert '<td>25 of 90</td>' in text


def test_page_loads_nothing_from_elsewhere(tmp_path):
    text = reported(bag_of(tmp_path / 'bag', sweep_messages(7)), tmp_path / 'report.html')
    body = body_of(text)
    assert re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?(?!data:)[a-z]+:', body) == []
    assert re.findall(r'<script[^>]+src', text[: text.index('<body>')]) == []


def test_last_complete_sweep_is_shown(tmp_path):
    incomplete = {k: v for k, v in sweep_messages(9).items() if k != 'depth/image'}
    later = [(f'/{topic}', 3000, m) for topic, m in incomplete.items()]
    first = [(f'/{topic}', 2000, m) for topic, m in sweep_messages(5).items()]
    bag = write_sweep(
        tmp_path / 'bag',
        [*first, *((f'/{t}', 2500, m) for t, m in sweep_messages(7).items()), *later],
    )
    assert 'sweep ended 7 s' in reported(bag, tmp_path / 'report.html')


def test_namespace_and_logged_warnings_are_found(tmp_path):
    warning = ('/rosout', 5000, Log(level=30, name='mosaicer', msg='columns <b>lost</b>'))
    chat = ('/rosout', 5001, Log(level=20, name='mosaicer', msg='all is well'))
    bag = bag_of(tmp_path / 'bag', sweep_messages(7), '/robot/', [warning, chat])
    body = body_of(reported(bag, tmp_path / 'report.html'))
    assert 'mosaicer: columns &lt;b&gt;lost' in body
    assert '<b>1</b><span>warning</span>' in body
    assert 'all is well' not in body


def test_folder_of_a_demo_brings_its_accuracy_and_its_logs(tmp_path):
    bag_of(tmp_path / 'bag', sweep_messages(7))
    scan = {'coverage': 0.987, 'median_error': 0.0123, 'within_5_percent': 0.9}
    scan |= {'too_far': 0.01, 'too_near': 0.02}
    accuracy = {'scan': scan, 'depth': {'kept': 0.91, 'wrong': 0.05, 'median_error': 0.005}}
    about = {'accuracy': accuracy, 'height_band': [-0.4, 0.2], 'room_seed': 3}
    (tmp_path / 'scan.json').write_text(json.dumps(about))
    (tmp_path / 'log').mkdir()
    (tmp_path / 'log' / 'depth.log').write_text(
        '[INFO] [1.0] [depth]: fine\n[WARN] [2.0] [x]: hot\n'
    )
    body = body_of(reported(tmp_path, tmp_path / 'report.html'))
    assert '98.7%' in body
    assert 'depth: [WARN] [2.0] [x]: hot' in body
    assert '-0.40 to +0.20 m' in body
    assert 'true room' in body
    assert '-0.10 to +0.10 m' in body_of(
        reported(tmp_path, tmp_path / 'report.html', '--band', '-0.1', '0.1')
    )


def failed(capsys, *arguments):
    assert main(['report', *map(str, arguments)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_what_cannot_be_reported_is_told_in_a_sentence(tmp_path, capsys):
    assert 'none does not exist' in failed(capsys, tmp_path / 'none')
    without = {k: v for k, v in sweep_messages(7).items() if k != 'depth/image'}
    bag = bag_of(tmp_path / 'without', without)
    assert 'has 0 topics that end with /depth/image; allowed: 1' in failed(capsys, bag)
    mixed = sweep_messages(7) | {'right/image': sweep_messages(8)['right/image']}
    assert 'no complete sweep' in failed(capsys, bag_of(tmp_path / 'mixed', mixed))
    good = bag_of(tmp_path / 'good', sweep_messages(7))
    output = ('-o', tmp_path / 'r.html')
    assert 'band is 0.2 m to 0.1 m' in failed(capsys, good, *output, '--band', '0.2', '0.1')
    assert 'nowhere is not a folder' in failed(capsys, good, '-o', tmp_path / 'nowhere' / 'r.html')
    assert not (tmp_path / 'r.html').exists()


@pytest.mark.launch
def test_missing_library_is_told_with_the_remedy(tmp_path):
    code = "import sys; sys.modules['plotly'] = None\nfrom panodepth_ros.cli.main import main\n"
    code += 'sys.exit(main())'
    bag = bag_of(tmp_path / 'bag', sweep_messages(7))
    command = [sys.executable, '-c', code, 'report', str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert 'pip install plotly' in done.stderr


PROBE = """<script>addEventListener('load', () => setTimeout(() => {
  const strip = document.querySelector('.strip'), box = strip.getBoundingClientRect();
  const at = {clientX: box.left + box.width / 2, clientY: box.top + 2};
  strip.dispatchEvent(new PointerEvent('pointermove', at));
  document.title = JSON.stringify({read: document.getElementById('readout').textContent,
    plots: document.querySelectorAll('.js-plotly-plot .main-svg').length,
    clouds: document.querySelectorAll('.gl-container canvas').length,
    wide: document.documentElement.scrollWidth, window: innerWidth});
}, 500));</script>"""


@pytest.mark.launch
def test_page_works_in_a_browser_without_a_network(tmp_path):
    command = browser(tmp_path / 'profile')
    page = tmp_path / 'report.html'
    page.write_text(reported(bag_of(tmp_path / 'bag', sweep_messages(7)), page) + PROBE)
    command += ['--virtual-time-budget=10000', '--enable-logging=stderr']
    command += ['--dump-dom', page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=True)
    (title,) = re.findall(r'<title>(\{.*?\})</title>', done.stdout)
    found = json.loads(title)
    assert re.fullmatch(
        r'column 45, row \d, looks along -15\.\d°: 2\.50 m, confidence 0\.80', found['read']
    )
    assert found['plots'] > 0
    assert found['clouds'] > 0
    assert found['wide'] <= found['window']
    assert 'Uncaught' not in done.stderr
