"""How the mosaicer finds the delay between the clocks of camera and arm, sweep after sweep."""

import math

import numpy as np
import pytest
from fixtures.mosaicer import Bench
from fixtures.rig import HEIGHT, WIDTH, F

from panodepth_ros.nodes.watcher import Watcher
from panodepth_ros.ros.images import to_message

pytestmark = pytest.mark.ros

COLUMNS = 180
STEP = 2 * math.pi / COLUMNS
#: One column every 20 ms, and frames exposed one column later than their stamps say.
PERIOD_MS, LATE_MS = 20, 20.0


class SceneBench(Bench):
    """Follows an arm that turns to and fro before far away things, seen late."""

    def __init__(self, ros, **values):
        wide = {'stripe_columns': 2, 'column_offset_px': 10.0, 'column_step_deg': 2.0}
        super().__init__(ros, motion='continuous', lead=False, **wide, **values)
        self.ready()
        rng = np.random.default_rng(4)
        self.phases = rng.uniform(0, 2 * math.pi, (HEIGHT, 40))
        self.azimuth = 0.0

    def turn(self, columns, direction):
        """Turn by some columns, with one frame in the middle of each."""
        rig = self.rig
        for _ in range(columns):
            rig.joint_state(self.azimuth, direction * STEP / (PERIOD_MS / 1e3))
            self.show(rig.later(0), self.azimuth + direction * LATE_MS / PERIOD_MS * STEP)
            rig.later(PERIOD_MS - 10)
            self.azimuth += direction * STEP
            self.ros.spin_until(lambda: self.track.newest >= rig.now - PERIOD_MS * 10**6, 'joint')

    @property
    def track(self):
        return self.mosaicer._assembler.track

    def show(self, stamp, azimuth):
        bearing = azimuth - np.arctan((np.arange(WIDTH) - 20.0) / F)
        waves = np.arange(1, 41)
        value = np.cos(waves[:, np.newaxis] * bearing + self.phases[..., np.newaxis])
        value = 128 + 18 * (value / np.sqrt(waves)[:, np.newaxis]).sum(axis=1)
        image = np.clip(np.rint(value), 0, 255).astype(np.uint8)
        self.rig._images.publish(to_message(image, 'mono8', stamp=stamp, frame_id='camera'))

    def sweep_to_and_fro(self, between=lambda: None):
        self.turn(COLUMNS + 4, 1)
        self.sweeps(1)
        between()
        self.turn(COLUMNS + 8, -1)
        self.sweeps(2)
        return self.mosaicer._assembler.image_delay * 1e-6


def test_two_sweeps_to_either_side_correct_the_delay(ros):
    assert SceneBench(ros).sweep_to_and_fro() == pytest.approx(LATE_MS, abs=1.0)


def test_found_delay_is_a_parameter_that_stays_and_that_the_watcher_takes(ros):
    bench = SceneBench(ros)
    watcher = ros.add(Watcher(context=ros.context))
    ros.spin_until(lambda: watcher._assembler is not None, 'the parameters')
    found = bench.sweep_to_and_fro()
    assert bench.mosaicer.get_parameter('image_delay_ms').value == pytest.approx(found)
    assert bench.set(arm_radius=0.25).successful
    assert bench.mosaicer._assembler.image_delay == pytest.approx(found * 1e6)
    ros.spin_until(lambda: watcher._assembler.rig.arm_radius == 0.25, 'the parameters')
    assert watcher._assembler.image_delay == bench.mosaicer._assembler.image_delay


def test_delay_is_only_told_if_it_shall_not_be_corrected(ros, capfd):
    assert SceneBench(ros, correct_delay=False).sweep_to_and_fro() == 0.0
    said = capfd.readouterr().err
    begin = said.index('image_delay_ms should be ') + len('image_delay_ms should be ')
    assert float(said[begin:].split(',')[0]) == pytest.approx(LATE_MS, abs=1.0)


def test_sweeps_of_two_calibrations_tell_no_delay(ros, capfd):
    bench = SceneBench(ros)

    def recalibrate():
        # The arm rests between the sweeps, so that none is under way.
        bench.mosaicer._assembler.restart(0)
        before = bench.mosaicer._assembler.camera
        bench.rig.camera_info(focal_length=F + 0.5)
        ros.spin_until(lambda: bench.mosaicer._assembler.camera != before, 'the calibration')

    assert bench.sweep_to_and_fro(recalibrate) == 0.0
    assert 'image_delay_ms should be' not in capfd.readouterr().err


def test_delay_that_no_clocks_have_is_not_corrected(ros, capfd, monkeypatch):
    monkeypatch.setattr('panodepth_ros.nodes.delay.LONGEST_DELAY', LATE_MS * 1e-3 / 2)
    assert SceneBench(ros).sweep_to_and_fro() == 0.0
    assert 'that is no delay of clocks: it is not corrected' in capfd.readouterr().err
