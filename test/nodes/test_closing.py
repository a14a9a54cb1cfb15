"""What the mosaicer makes of a turn that does not close."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from fixtures.mosaicer import Bench
from sensor_msgs.msg import CameraInfo

from panodepth_ros.ros.images import to_array, to_message
from panodepth_ros.ros.messages import panorama_geometry

pytestmark = pytest.mark.ros

WIDTH, HEIGHT, F = 97, 73, 100.0
COLUMNS, STEP_DEG = 180, 2.0


class SceneBench(Bench):
    """Its rig shows far away things, and may lose an angle little by little."""

    def __init__(self, ros, lost_deg=0.0, **values):
        super().__init__(ros, column_step_deg=STEP_DEG, **values)
        self.rig.step = math.radians(STEP_DEG)
        self.lost = math.radians(lost_deg)
        rng = np.random.default_rng(4)
        self.waves = rng.integers(4, 25, 15), rng.uniform(-20, 20, 15), rng.uniform(0, 6.28, 15)
        self.rig.camera_info = self.camera_info
        self.rig.frame = self.frame
        self.ready()

    def camera_info(self, stamp=None):
        info = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model='plumb_bob')
        info.header.stamp = stamp or self.rig.later(1)
        info.k = [F, 0.0, 48.0, 0.0, F, 36.0, 0.0, 0.0, 1.0]
        info.d = [0.0] * 5
        self.rig._infos.publish(info)

    def look(self, bearing, slope):
        along, up, phase = self.waves
        arms = (along[:, None, None] * bearing + up[:, None, None] * slope) + phase[:, None, None]
        return np.clip(128 + 20 * np.cos(arms).sum(axis=0), 0, 255)

    def frame(self, mark=None):
        rig = self.rig
        true = rig.azimuth - self.lost * rig.steps / COLUMNS
        v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
        ray = np.arctan((u - 48.0) / F)
        image = np.rint(self.look(true - ray, (36.0 - v) / F * np.cos(ray))).astype(np.uint8)
        stamp = rig.later(10)
        self.camera_info(stamp)
        rig._images.publish(to_message(image, 'mono8', stamp=stamp, frame_id='camera'))

    def error(self, image, geometry):
        """Mean difference of a panorama and what is there."""
        v, x = np.mgrid[0 : geometry.rows, 0:COLUMNS]
        slope = (geometry.principal_row - v) / geometry.focal_length_px
        there = self.look(geometry.ray_azimuth(x), slope)
        return np.abs(image - there)[:, geometry.seen].mean()


def test_turn_that_lost_an_angle_is_refused_with_the_numbers(ros):
    bench = SceneBench(ros, lost_deg=0.5, closure='refuse', closure_tolerance_deg=0.12)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    bench.given_up()
    values = diagnosis.says(DiagnosticStatus.OK, 'ready')
    assert values['last_end'].startswith('given up: the turn does not close: the arm turned ')
    number = float(values['last_end'].split('turned ')[1].split('°')[0])
    assert number == pytest.approx(0.5, abs=0.03)
    assert 'less than it reported, allowed: 0.12°' in values['last_end']


def test_lost_angle_is_corrected_if_it_shall_be(ros):
    bench = SceneBench(ros, lost_deg=0.5, closure='correct', closure_tolerance_deg=0.12)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    swept, publish = [], bench.mosaicer._publish_panoramas
    bench.mosaicer._publish_panoramas = lambda sweep: swept.append(sweep) or publish(sweep)
    bench.start()
    got = bench.sweeps()
    uncorrected = swept[0].panoramas()['left']
    geometry = panorama_geometry(got['left/camera_info'])
    corrected = bench.error(to_array(got['left/image']), geometry)
    # A column of 2° is the mean of its pixels, which the scene is not: that error stays.
    assert corrected < 0.6 * bench.error(uncorrected.image, uncorrected.geometry)
    assert diagnosis.says(DiagnosticStatus.OK, 'ready')['closure'].endswith('points, corrected')


def test_nothing_is_measured_if_it_shall_not_be(ros):
    bench = Bench(ros).ready()
    bench.start()
    assert bench.sweeps()
    assert bench.mosaicer._closure.told == 'not measured'


def test_part_of_a_turn_is_not_measured(ros):
    bench = SceneBench(ros, sweep_deg=20.0, closure='refuse')
    bench.start()
    assert bench.sweeps()
    assert bench.mosaicer._closure.told == 'not measured'


def test_turn_that_tells_nothing_is_refused(ros):
    bench = Bench(ros, closure='refuse').ready()
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    bench.given_up()
    assert bench.rig.steps == 61, 'no frame was taken at 360°'
    said = diagnosis.says(DiagnosticStatus.OK, 'ready')['last_end']
    assert 'given up: whether the turn closes cannot be told: only 0 points are seen' in said


def test_frame_at_360_is_no_column(ros):
    bench = SceneBench(ros, closure='refuse', closure_tolerance_deg=0.12)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    bench.start()
    got = bench.sweeps()
    assert bench.rig.steps == COLUMNS + 1
    geometry = panorama_geometry(got['left/camera_info'])
    assert geometry.seen.all()
    assert bench.error(to_array(got['left/image']), geometry) < 1.0
    assert diagnosis.says(DiagnosticStatus.OK, 'ready')['closure'].startswith('lost ')


def test_arm_whose_cable_ends_before_360_closes_with_the_frame_before(ros, capfd):
    bench = SceneBench(ros, closure='refuse', closure_tolerance_deg=0.12)
    bench.rig.refuse_at = COLUMNS
    bench.start()
    assert panorama_geometry(bench.sweeps()['left/camera_info']).seen.all()
    assert 'the motor is hot; there is no frame at 360°' in capfd.readouterr().err


def test_followers_leave_the_frame_at_360_alone(ros):
    bench = SceneBench(ros, lead=False, closure='refuse', closure_tolerance_deg=0.12)
    bench.someone_else_steps(range(COLUMNS + 1))
    assert panorama_geometry(bench.sweeps()['left/camera_info']).seen.all()
    assert bench.mosaicer._assembler.sweep is None


def test_light_that_takes_a_step_is_told_and_removed(ros):
    bench = SceneBench(ros)
    diagnosis = Diagnosis(ros, 'mosaicer: sweep')
    steady = bench.look
    bench.look = lambda bearing, slope: (
        steady(bearing, slope) * (0.7 if 90 <= bench.rig.steps < 1000 else 1.0)
    )
    bench.start()
    got = bench.sweeps()
    bench.look = steady
    assert bench.error(to_array(got['left/image']), panorama_geometry(got['left/camera_info'])) < 3
    told = diagnosis.says(DiagnosticStatus.OK, 'ready')['light']
    assert told.startswith('the light changed 1 times, to between 70%')
