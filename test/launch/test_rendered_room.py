"""Real input: a rendered sweep as a bag, replayed through the real nodes."""

import runpy
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from fixtures.ros import started
from fixtures.shared_data import DATA, folder, in_panorama_order

from panodepth_ros.analysis.evaluation import score_scan
from panodepth_ros.bag import read
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry

pytestmark = [pytest.mark.ros, pytest.mark.launch, pytest.mark.timeout(300)]
ROOT = Path(__file__).resolve().parents[2]
RESULTS = ('/left/image', '/left/camera_info', '/right/image', '/right/camera_info', '/scan')


@pytest.fixture(scope='module')
def truth():
    folder('study')
    with warnings.catch_warnings():  # the rooms' own reader leaves a file to the collector
        warnings.simplefilter('ignore', ResourceWarning)
        return runpy.run_path(str(DATA / 'score.py'))['scan_truth'](str(DATA / 'study'))


def test_replayed_room_gives_its_mosaics_and_its_ground_plan(ros, tmp_path, truth):
    room = folder('study')
    tool = str(ROOT / 'tools' / 'data_to_bag.py')
    with started(sys.executable, tool, str(room), str(tmp_path / 'study')) as conversion:
        assert conversion.wait(120) == 0
    with (
        started('mosaicer', '--ros-args', '-p', 'lead:=false'),
        started('depth') as depth,
        started('panodepth_ros', 'record', '-o', str(tmp_path / 'out'), *RESULTS) as recorder,
    ):
        depth.wait_for_output('ready')
        ros.spin_until_recorded(RESULTS)
        with started(
            'panodepth_ros',
            'replay',
            '--asap',
            str(tmp_path / 'study'),
            '--wait-for',
            '/image_raw',
            '/camera_info',
            '/joint_states',
        ) as replay:
            assert replay.wait(240) == 0
        depth.wait_for_output('beams hold a distance')
        recorder.stop()
    got = {topic: message for topic, _, message in read(tmp_path / 'out')}
    assert set(got) == set(RESULTS)
    mosaics = np.load(room / 'mosaics.npz')
    for eye in ('left', 'right'):
        expected = in_panorama_order(mosaics[eye])[..., ::-1]
        assert np.array_equal(to_array(got[f'/{eye}/image']), expected)
        assert panorama_geometry(got[f'/{eye}/camera_info']).uniform
    score = score_scan(np.array(got['/scan'].ranges, dtype=np.float64), truth)
    assert score.median_error < 0.02
    assert score.coverage > 0.95
