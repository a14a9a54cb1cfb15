"""Rules for scans: ours passes them all, every fault is found and named."""

import dataclasses
import math

import numpy as np
import pytest

from panodepth_ros.motion.frames import FrameMotion
from panodepth_ros.scan.consumers import by_consumer, check, rays_slam_toolbox_expects
from panodepth_ros.scan.findings import CONSUMERS, ReceivedScan, ScanStream, Verdict

IDENTITY = (0.0, 0.0, 0.0, 1.0)


def about(axis, angle):
    return (*(math.sin(angle / 2) * np.array(axis, float)), math.cos(angle / 2))


def good(beams=720, k=0, **change):
    increment = 2 * math.pi / beams
    ranges = np.full(beams, 2.0, np.float32)
    ranges[10:30] = np.nan
    ranges[100:140] = np.inf
    float32 = {
        'angle_min': -math.pi,
        'angle_max': -math.pi + (beams - 1) * increment,
        'angle_increment': increment,
    }
    values = {name: float(np.float32(value)) for name, value in float32.items()} | {
        'stamp': 100.0 + k,
        'received': 100.3 + k,
        'frame_id': 'panodepth',
        'time_increment': 0.0,
        'scan_time': 0.8,
        'range_min': 0.35,
        'range_max': 8.0,
        'ranges': ranges,
    }
    return ReceivedScan(**(values | change))


def still():
    motion = FrameMotion()
    motion.add_transform('base_link', 'panodepth', about((0, 0, 1), 1.0))
    return motion


def stream(*scans, **change):
    scans = scans or tuple(good(k=k) for k in range(3))
    return ScanStream(scans=scans, **({'reliable': {'depth': True}, 'motion': still()} | change))


def finding(rule, *scans, **change):
    (found,) = (f for f in check(stream(*scans, **change)) if f.rule == rule)
    return found


@pytest.mark.parametrize('beams', [60, 361, 720, 7200])
def test_a_good_scan_passes_every_rule(beams):
    findings = check(stream(*(good(beams, k) for k in range(3))))
    assert [f for f in findings if f.verdict is not Verdict.PASS] == []
    assert by_consumer(findings).keys() == set(CONSUMERS)
    assert {verdict for verdict, _ in by_consumer(findings).values()} == {Verdict.PASS}


def test_whether_a_short_sweep_is_stamped_with_its_first_ray_may_be_unknown():
    found = finding('stamp', good(stamp=97.7, scan_time=2.3))
    assert found.verdict is Verdict.UNKNOWN
    assert 'may tell its first ray' in found.reason


def test_a_lidar_of_270_degrees_passes():
    increment = math.radians(0.25)
    scan = good(
        angle_min=-135 * math.pi / 180,
        angle_max=135 * math.pi / 180,
        angle_increment=increment,
        ranges=np.full(1081, 2.0, np.float32),
        time_increment=0.025 / 1081,
        scan_time=0.025,
    )
    assert finding('rays', scan).verdict is Verdict.PASS
    assert finding('time', scan).verdict is Verdict.PASS


N, STEP = 720, 2 * math.pi / 720
RANGES = good().ranges


@pytest.mark.parametrize(
    ('rule', 'change', 'words'),
    [
        # angle_max of the first ray, a turn on, and N ranges: what many drivers write.
        ('rays', {'angle_max': math.pi}, 'angle_max is +1.00 increments off'),
        ('rays', {'angle_max': math.pi - 2 * STEP}, 'rejects it, expecting 719'),
        ('rays', {'angle_max': math.pi - 1.4 * STEP}, 'slam_toolbox takes it, too'),
        (
            'rays',
            {'angle_max': math.pi, 'ranges': np.append(RANGES, RANGES[0])},
            '721 rays are more than a turn',
        ),
        ('rays', {'angle_increment': -STEP}, 'an increment above 0'),
        ('rays', {'angle_increment': 0.0}, 'an increment above 0'),
        ('rays', {'angle_max': math.nan}, 'finite'),
        ('range limits', {'range_max': math.inf}, 'range_max inf m'),
        ('range limits', {'range_max': math.nan}, 'range_max nan m'),
        ('range limits', {'range_max': 2.0}, 'obstacle_max_range of 2.5 m'),
        ('range limits', {'range_min': 9.0}, '0 <= range_min < range_max'),
        ('values', {'range_min': 2.5}, '660 numbers below range_min and 0 above'),
        ('values', {'ranges': np.full(N, 9.0)}, '0 numbers below range_min and 720 above'),
        ('intensities', {'intensities': 719}, '719 intensities for 720 ranges'),
        ('stamp', {'stamp': 60.0}, 'stamps are up to 40.3 s old'),
        ('stamp', {'stamp': 0.0, 'received': 1.7e9}, 'set use_sim_time'),
        ('stamp', {'stamp': 101.0}, 'stamps are up to 0.7 s ahead'),
        ('stamp', {'stamp': 92.0, 'scan_time': 8.0}, 'they tell its first ray'),
        ('time', {'time_increment': 0.01}, 'time_increment is 0.01 s, 7.2 s a scan'),
        ('time', {'time_increment': -1e-6}, 'time_increment is -1e-06 s'),
        ('time', {'scan_time': math.nan}, 'scan_time is nan'),
        ('frame', {'frame_id': ''}, "frame_id is ''"),
        ('frame', {'frame_id': '/panodepth'}, 'without a leading slash'),
    ],
)
def test_a_fault_of_one_scan_is_found(rule, change, words):
    found = finding(rule, good(**change))
    assert (found.verdict, words in found.reason) == (Verdict.FAIL, True), found.reason
    assert set(found.consumers) <= set(CONSUMERS)


@pytest.mark.parametrize(
    ('name', 'scan'),
    [
        ('N', good(719)),
        ('range_max', good(range_max=7.0)),
        ('range_min', good(range_min=0.3)),
        ('angles', good(angle_min=-3.0)),
        ('frame_id', good(frame_id='other')),
    ],
)
def test_what_consumers_remember_must_not_change(name, scan):
    found = finding('constant', good(), scan)
    assert found.verdict is Verdict.FAIL
    assert found.reason.startswith(f'{name} changes')


def test_one_scan_says_nothing_of_change():
    assert finding('constant', good()).verdict is Verdict.UNKNOWN


def test_59_beams_fail_amcl_alone():
    findings = check(stream(*(good(59, k) for k in range(2))))
    verdicts = by_consumer(findings)
    assert verdicts['amcl'] == (Verdict.FAIL, ['beams'])
    assert {v for who, (v, _) in verdicts.items() if who != 'amcl'} == {Verdict.PASS}


def test_repeated_stamps_fail():
    assert 'do not increase' in finding('stamp', good(), good()).reason


def test_slam_toolbox_remembers_longer():
    assert 'slam_toolbox' not in finding('stamp', good(stamp=80.0)).consumers
    assert 'slam_toolbox' in finding('stamp', good(stamp=60.0)).consumers


def test_failures_as_infinity_are_suspected_by_their_gaps():
    ranges = np.full(N, 2.0, np.float32)
    assert finding('unknown', good(ranges=ranges)).verdict is Verdict.PASS
    ranges[::20] = np.inf
    found = finding('unknown', good(ranges=ranges))
    assert found.verdict is Verdict.FAIL
    assert '36 of these in gaps' in found.reason
    ranges[5] = np.nan  # whoever knows NaN may have looked through a slit
    assert finding('unknown', good(ranges=ranges)).verdict is Verdict.UNKNOWN


def test_an_open_side_alone_proves_nothing():
    ranges = np.full(N, 2.0, np.float32)
    ranges[:200] = np.inf
    found = finding('unknown', good(ranges=ranges))
    assert found.verdict is Verdict.UNKNOWN
    assert 'cannot be told' in found.reason


def test_a_gap_over_the_seam_counts():
    ranges = np.full(N, 2.0, np.float32)
    ranges[[0, -1]] = np.inf
    assert ' 2 of these in gaps' in finding('unknown', good(ranges=ranges)).reason


def test_slow_scans_name_what_to_set():
    found = finding('period', good(), good(k=70))
    assert found.verdict is Verdict.UNKNOWN
    assert 'source_timeout' in found.reason


def test_best_effort_fails_rviz_alone():
    found = finding('qos', reliable={'depth': True, 'driver': False})
    assert (found.verdict, found.consumers) == (Verdict.FAIL, ('rviz',))
    assert found.reason.startswith('driver publishes with best effort')
    assert finding('qos', reliable={}).verdict is Verdict.UNKNOWN


def test_no_scan_is_an_error():
    with pytest.raises(ValueError, match='no scan to check'):
        check(ScanStream(scans=()))


@pytest.mark.parametrize(
    ('span', 'increment', 'n', 'expected'),
    [
        # Round(span/increment) + 1, but without the 1 for what it takes for a full turn.
        (2 * math.pi - STEP, STEP, 720, 720),
        (2 * math.pi, STEP, 720, 720),
        (2 * math.pi, STEP, 721, 721),
        (math.pi, math.pi / 100, 101, 101),
    ],
)
def test_rays_as_slam_toolbox_counts_them(span, increment, n, expected):
    scan = good(angle_min=0.0, angle_max=span, angle_increment=increment, ranges=np.full(n, 2.0))
    assert rays_slam_toolbox_expects(scan) == expected


def test_frame_that_turns_by_its_transform():
    motion = FrameMotion()
    motion.add_transform('base_link', 'mast', IDENTITY)
    motion.add_transform('mast', 'arm', about((0, 0, 1), 0.1))
    motion.add_transform('mast', 'arm', about((0, 0, 1), 0.4))
    motion.add_transform('arm', 'panodepth', IDENTITY)
    found = finding('frame', motion=motion)
    assert found.verdict is Verdict.FAIL
    assert 'turns by 17.2° with arm' in found.reason


def test_a_driving_robot_is_not_a_turning_frame():
    motion = still()
    for yaw in (0.0, 1.0):
        motion.add_transform('odom', 'base_link', about((0, 0, 1), yaw))
    assert finding('frame', motion=motion).verdict is Verdict.PASS


def test_leaning_frame():
    motion = FrameMotion()
    motion.add_transform('base_link', 'panodepth', about((1, 0, 0), math.pi / 2))
    assert 'leans 90°' in finding('frame', motion=motion).reason


def test_frame_that_turns_by_its_joint():
    motion = FrameMotion(transforms_readable=False)
    for position in (0.0, 0.0035):
        motion.add_joint('panodepth_arm_joint', position)
    assert finding('frame', motion=motion).verdict is Verdict.UNKNOWN
    found = finding('frame', good(frame_id='panodepth_arm_link'), motion=motion)
    assert found.verdict is Verdict.FAIL
    assert 'turns with the joint panodepth_arm_joint' in found.reason


@pytest.mark.parametrize(
    ('motion', 'words'),
    [
        (FrameMotion(transforms_readable=False), 'tf2_msgs is not installed'),
        (FrameMotion(), 'no transform to it was heard'),
        (dataclasses.replace(still(), base_frame='robot'), 'lead to base_link, not to robot'),
    ],
)
def test_unknown_frame_says_why(motion, words):
    found = finding('frame', motion=motion)
    assert found.verdict is Verdict.UNKNOWN
    assert words in found.reason


def test_frame_of_the_robot_itself():
    assert finding('frame', good(frame_id='base_link')).verdict is Verdict.PASS
