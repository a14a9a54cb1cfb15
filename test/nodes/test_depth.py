"""The depth node: a pair with known distance in, depth and scan out; bad pairs refused."""

import dataclasses
import math
import threading

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fixtures.diagnostics import Diagnosis
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.matching import match
from panodepth_ros.nodes import depth as depth_module
from panodepth_ros.nodes.depth import Depth
from panodepth_ros.nodes.depth_settings import DepthParameters
from panodepth_ros.ros.images import to_array, to_message
from panodepth_ros.ros.messages import panorama_info, to_stamp
from panodepth_ros.ros.parameters import ParameterError
from panodepth_ros.ros.pointcloud import POINT
from panodepth_ros.scan.beams import ScanSettings

pytestmark = pytest.mark.ros

COLUMNS, ROWS = 360, 24
STEP = 2 * math.pi / COLUMNS
R, PHI, DISPARITY = 0.3, math.radians(15.2), 26
#: Eq. 2 for a cylinder wall around the axis at 26 columns of disparity.
DISTANCE = R * math.sin(PHI) / math.sin(PHI - DISPARITY * STEP / 2)


def geometry(angle, columns=COLUMNS, seen=None):
    ray_angle = np.full(columns, angle)
    if seen is not None:
        ray_angle[~seen] = np.nan
    return PanoramaGeometry(
        columns=columns,
        rows=ROWS,
        azimuth_column=columns / 2 + angle / STEP,
        focal_length_px=100.0,
        principal_row=11.5,
        arm_radius=R,
        principal_angle=angle,
        sweep_duration=12.5,
        ray_angle=ray_angle,
    )


EYES = ['left', 'right', 'pair_1/left', 'pair_1/right', 'pair_2/left', 'pair_2/right']


class Bench:
    """A depth node, a publisher of panoramas, and a listener."""

    def __init__(self, ros, **values):
        overrides = [Parameter(name, value=value) for name, value in values.items()]
        self.ros = ros
        self.depth = ros.add(Depth(context=ros.context, parameter_overrides=overrides))
        self.node = ros.node('panoramas')
        self.got = {'depth/image': [], 'depth/confidence': [], 'depth/camera_info': [], 'scan': []}
        for topic, messages in self.got.items():
            kind = {'scan': LaserScan, 'depth/camera_info': CameraInfo}.get(topic, Image)
            self.node.create_subscription(kind, topic, messages.append, 10)
        self.out = {
            topic: self.node.create_publisher(kind, topic, 10)
            for eye in EYES[: 2 + 2 * values.get('further_pairs', 0)]
            + (['center'] if values.get('use_center') else [])
            for topic, kind in ((f'{eye}/image', Image), (f'{eye}/camera_info', CameraInfo))
        }
        ros.spin_until(
            lambda: (
                all(publisher.get_subscription_count() for publisher in self.out.values())
                and all(self.depth.count_subscribers(topic) for topic in self.got)
            ),
            'the graph',
        )

    def send(self, stamp=1, *, seen=None, shift=DISPARITY, **change):
        rng = np.random.default_rng(3)
        wall = rng.integers(0, 255, (ROWS, COLUMNS), dtype=np.uint8)
        header = Header(stamp=to_stamp(stamp * 10**9), frame_id='panodepth')
        messages = {}
        for eye, sign, image in (('left', -1, wall), ('right', 1, np.roll(wall, shift, axis=1))):
            messages[f'{eye}/image'] = to_message(
                image, 'mono8', stamp=header.stamp, frame_id=header.frame_id
            )
            messages[f'{eye}/camera_info'] = panorama_info(geometry(sign * PHI, seen=seen), header)
        for name in {topic.rpartition('/')[0] for topic in self.out} - {'left', 'right'}:
            angle = {'l': -PHI / 2, 'r': PHI / 2, 'c': 0.0}[name.rpartition('/')[2][0]]
            messages[f'{name}/image'] = messages['left/image']
            messages[f'{name}/camera_info'] = panorama_info(geometry(angle), header)
        messages |= change
        for topic, message in messages.items():
            if message is not None:
                self.out[topic].publish(message)

    def results(self, count=1):
        self.ros.spin_until(
            lambda: all(len(messages) >= count for messages in self.got.values()), 'depth and scan'
        )
        return {topic: messages[count - 1] for topic, messages in self.got.items()}

    def set(self, **values):
        client = self.node.create_client(SetParameters, 'depth/set_parameters')
        self.ros.spin_until(client.service_is_ready, 'set_parameters')
        messages = [Parameter(n, value=value).to_parameter_msg() for n, value in values.items()]
        request = SetParameters.Request(parameters=messages)
        (result,) = self.ros.result(client.call_async(request)).results
        return result


def test_defaults_are_those_of_the_core():
    assert DepthParameters().scan_settings() == ScanSettings()


def test_wall_of_known_distance(ros):
    bench = Bench(ros, beams=180)
    bench.send()
    got = bench.results()
    depth = to_array(got['depth/image'])
    assert got['depth/image'].encoding == '32FC1'
    assert depth.shape == (ROWS, COLUMNS)
    assert np.nanmedian(depth) == pytest.approx(DISTANCE, rel=2e-3)
    assert np.isfinite(depth).mean() > 0.9
    confidence = to_array(got['depth/confidence'])
    assert np.nanmax(confidence) <= 1.0
    assert np.nanmedian(confidence) > 0.9
    scan = got['scan']
    assert len(scan.ranges) == 180
    assert np.nanmedian(scan.ranges) == pytest.approx(DISTANCE, rel=2e-3)
    assert np.isfinite(scan.ranges).mean() > 0.95
    assert scan.scan_time == 12.5
    for message in got.values():
        assert message.header == Header(stamp=to_stamp(10**9), frame_id='panodepth')
    assert got['depth/camera_info'].distortion_model == 'cylindrical'


def test_points_lie_on_the_wall_of_the_depth_image(ros):
    bench = Bench(ros, min_confidence=0.5)
    clouds = []
    bench.node.create_subscription(PointCloud2, 'points', clouds.append, 10)
    ros.spin_until(lambda: bench.depth.count_subscribers('points'), 'the points listener')
    bench.send()
    depth = to_array(bench.results()['depth/image'])
    ros.spin_until(lambda: clouds, 'points')
    cloud = clouds[0]
    assert cloud.header == Header(stamp=to_stamp(10**9), frame_id='panodepth')
    points = np.frombuffer(cloud.data, POINT).reshape(cloud.height, cloud.width)
    known = np.isfinite(depth)
    assert known.any()
    assert np.array_equal(np.isfinite(points['x']), known)
    assert np.hypot(points['x'], points['y'])[known] == pytest.approx(depth[known], rel=1e-6)
    # The left eye's ray passes left of the axis: the point's azimuth is not the column's.
    column, turn = 100, (360 / 2 - 100) * STEP - PHI
    azimuth = turn + math.asin(R * math.sin(PHI) / DISTANCE)
    x, y = DISTANCE * math.cos(azimuth), DISTANCE * math.sin(azimuth)
    assert np.nanmedian(points['x'][:, column]) == pytest.approx(x, abs=5e-3)
    assert np.nanmedian(points['y'][:, column]) == pytest.approx(y, abs=5e-3)
    farther, nearer = (
        R * math.sin(PHI) / math.sin(PHI - (DISPARITY + columns) * STEP / 2)
        for columns in (0.05, -0.05)
    )
    parameters = DepthParameters()
    noise = parameters.uncertainty().of_disparity(points['confidence'][known])
    ratio = points['stddev'][known] / noise
    assert np.median(ratio) == pytest.approx(10 * (farther - nearer), rel=0.02)


def test_points_are_made_only_for_subscribers(ros, monkeypatch):
    def fail(*_):
        raise ValueError('nobody asked for points')

    monkeypatch.setattr(depth_module, 'point_cloud', fail)
    bench = Bench(ros)
    bench.send()
    assert bench.results()['scan'].header.stamp.sec == 1


def test_pixels_of_little_confidence_are_unknown_in_depth(ros):
    bench = Bench(ros, min_confidence=1.0)
    bench.send()
    got = bench.results()
    confidence = to_array(got['depth/confidence'])
    assert np.isfinite(confidence).sum() > 0
    known = np.isfinite(to_array(got['depth/image']))
    assert np.array_equal(known, confidence >= 1.0)


def test_unseen_sector_is_unknown_in_depth_and_scan(ros):
    bench = Bench(ros, beams=180)
    seen = np.ones(COLUMNS, bool)
    seen[: COLUMNS // 2] = False
    bench.send(seen=seen)
    got = bench.results()
    assert np.isnan(to_array(got['depth/image'])[:, : COLUMNS // 2]).all()
    # Columns run clockwise from behind: the first half is the left, positive azimuth.
    ranges = np.array(got['scan'].ranges)
    assert np.isnan(ranges[110:170]).all()
    assert np.isfinite(ranges[20:70]).any()


@pytest.mark.parametrize(('beams', 'times'), [(COLUMNS, 0), (COLUMNS + 1, 1)])
def test_more_beams_than_columns_are_told_once(ros, capfd, beams, times):
    bench = Bench(ros, beams=beams)
    for stamp in (1, 2):
        bench.send(stamp)
        bench.results(stamp)
    told = capfd.readouterr().err
    assert told.count('beams that lie between columns stay unknown; set beams to 360') == times


def test_far_wall_is_infinite_and_near_wall_minus_infinite(ros):
    bench = Bench(ros, range_min=2.0, range_max=3.0)
    bench.send(shift=29)
    assert np.isposinf(bench.results()['scan'].ranges).sum() > 300
    bench.send(stamp=2, shift=5)
    assert np.isneginf(bench.results(2)['scan'].ranges).sum() > 300


def test_live_parameters_act_on_the_next_pair(ros):
    bench = Bench(ros)
    bench.send()
    assert np.isfinite(to_array(bench.results()['depth/image'])).any()
    assert bench.set(method='sgbm').successful
    bench.send(stamp=2)
    second = to_array(bench.results(2)['depth/image'])
    assert np.nanmedian(second) == pytest.approx(DISTANCE, rel=0.02)


def test_contradictory_live_parameter_is_refused(ros):
    result = Bench(ros).set(min_height=0.5)
    assert not result.successful
    assert (
        result.reason
        == 'min_height is 0.5 m and max_height 0.15 m; allowed: min_height < max_height'
    )


def test_what_consumers_remember_cannot_be_set_live(ros):
    bench = Bench(ros)
    for name, value in (('beams', 360), ('range_max', 5.0), ('range_min', 0.2)):
        assert not bench.set(**{name: value}).successful


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'method': 'guess'}, "method is 'guess'; allowed: "),
        ({'range_min': 9.0}, 'range_min is 9.0 m and range_max 8.0 m'),
        ({'beams': 59}, 'beams is 59; allowed: 60 to 7200'),
    ],
)
def test_bad_parameter_stops_the_start_with_a_sentence(ros, values, sentence):
    with pytest.raises(ParameterError) as error:
        Bench(ros, **values)
    assert sentence in str(error.value)


def _plain_info():
    return CameraInfo(width=COLUMNS, height=ROWS, distortion_model='plumb_bob')


def _short_image():
    return to_message(np.zeros((ROWS - 1, COLUMNS), np.uint8), 'mono8')


def _other_size():
    return panorama_info(geometry(PHI, columns=720), Header())


@pytest.mark.parametrize(
    ('topic', 'make', 'sentence'),
    [
        ('right/camera_info', _plain_info, "distortion_model 'plumb_bob'"),
        ('right/image', _short_image, 'panorama image is uint8 of shape (23, 360)'),
        ('right/camera_info', _other_size, 'panorama image is uint8 of shape (24, 360)'),
        ('right/camera_info', lambda: panorama_info(geometry(-PHI), Header()), 'principal_angle'),
    ],
)
def test_bad_pair_is_refused_and_the_next_good_one_served(ros, capfd, topic, make, sentence):
    bench = Bench(ros)
    message = make()
    message.header = Header(stamp=to_stamp(10**9), frame_id='panodepth')
    bench.send(stamp=1, **{topic: message})
    ros.spin_until(lambda: 'refused' in bench.depth._outcome.message, 'the refusal')
    bench.send(stamp=2)
    got = bench.results()
    assert [m.header.stamp.sec for m in bench.got['scan']] == [2]
    assert got['depth/image'].header.stamp.sec == 2
    assert sentence in capfd.readouterr().err


def test_diagnostics_tell_what_came_of_the_panoramas(ros):
    diagnosis = Diagnosis(ros, 'depth: matching')
    bench = Bench(ros)
    diagnosis.says(DiagnosticStatus.OK, 'no panoramas received yet')
    bench.send(
        stamp=1,
        **{'right/camera_info': panorama_info(geometry(-PHI), Header(stamp=to_stamp(10**9)))},
    )
    diagnosis.says(DiagnosticStatus.ERROR, 'panoramas refused: principal_angle')
    bench.send(stamp=2)
    diagnosis.says(DiagnosticStatus.OK, '100% of the pixels and 50% of the beams hold a distance')


def test_only_the_newest_sweep_is_matched_when_matching_takes_longer(ros, monkeypatch, capfd):
    begun, go = threading.Event(), threading.Event()

    def slow(*panoramas, **values):
        begun.set()
        go.wait()
        return match(*panoramas, **values)

    monkeypatch.setattr(depth_module, 'match', slow)
    bench = Bench(ros, robot_stands_still=True, republish_period=0.0)
    try:
        bench.send(stamp=1)
        ros.spin_until(begun.is_set, 'the matching')
        for stamp in (2, 3, 4):
            bench.send(stamp=stamp)
        ros.spin_until(lambda: bench.depth._passed_over == 2, 'the sweeps that are passed over')
    finally:
        go.set()
    bench.results(2)
    assert [message.header.stamp.sec for message in bench.got['scan']] == [1, 4]
    assert 'only the newest is matched, 2 passed over so far' in capfd.readouterr().err
    ros.spin_until(lambda: bench.depth._republisher._pauses == 0, 'the end of every pause')


def test_matching_that_breaks_is_told_and_the_next_sweep_served(ros, monkeypatch, capfd):
    def broken_once(*panoramas, **values):
        monkeypatch.setattr(depth_module, 'match', match)
        raise ZeroDivisionError('a kernel broke')

    monkeypatch.setattr(depth_module, 'match', broken_once)
    diagnosis = Diagnosis(ros, 'depth: matching')
    bench = Bench(ros)
    bench.send(stamp=1)
    diagnosis.says(DiagnosticStatus.ERROR, 'matching failed: ZeroDivisionError: a kernel broke')
    bench.send(stamp=2)
    bench.results()
    assert [message.header.stamp.sec for message in bench.got['scan']] == [2]
    said = capfd.readouterr().err
    assert 'matching failed, nothing is published' in said
    assert 'broken_once' in said, 'where it broke'


def test_further_pairs_and_the_centre_reach_the_matching(ros, monkeypatch):
    given = []

    def spied(left, right, **values):
        given.append([left, right, *values['further']])
        return match(left, right, **values)

    monkeypatch.setattr('panodepth_ros.nodes.depth.match', spied)
    bench = Bench(ros, further_pairs=2, use_center=True)
    bench.send()
    bench.results()
    angles = [panorama.geometry.principal_angle for panorama in given[0]]
    assert angles == [-PHI, PHI, -PHI / 2, PHI / 2, -PHI / 2, PHI / 2, 0.0]


def test_stripes_are_triangulated_with_the_mean_ray_of_the_window(ros):
    # Nine columns a stripe: a window holds all of its rays, and a disparity is their mean.
    fan = (np.arange(COLUMNS) % 9 - 4) * STEP
    header = Header(stamp=to_stamp(10**9), frame_id='panodepth')
    infos = {}
    for eye, sign in (('left', -1), ('right', 1)):
        rays = dataclasses.replace(geometry(sign * PHI), ray_angle=sign * PHI + fan)
        infos[f'{eye}/camera_info'] = panorama_info(rays, header)
    bench = Bench(ros)
    bench.send(**infos)
    depth = to_array(bench.results()['depth/image'])
    off = np.abs(depth / DISTANCE - 1)
    assert np.nanpercentile(off, 95) < 0.02


def test_sweep_without_its_further_pair_is_waited_for_and_named(ros, capfd):
    bench = Bench(ros, further_pairs=1)
    bench.send(stamp=1, **{'pair_1/right/image': None, 'pair_1/left/camera_info': None})
    sets = bench.depth._matcher._sets
    ros.spin_until(lambda: len(sets.get(10**9, ())) == 6, 'the incomplete sweep')
    bench.send(stamp=2)
    bench.results()
    assert [message.header.stamp.sec for message in bench.got['scan']] == [2]
    said = capfd.readouterr().err
    assert 'not yet pair_1/left/camera_info, pair_1/right/image of the last one' in said


def test_messages_of_different_stamps_are_not_mixed(ros):
    bench = Bench(ros)
    bench.send(stamp=1, **{'right/image': None})
    bench.send(stamp=2)
    assert bench.results()['scan'].header.stamp.sec == 2
    assert len(bench.got['scan']) == 1


def test_scan_is_published_again_once_the_robot_is_promised_to_stand(ros):
    bench = Bench(ros, republish_period=0.05, beams=180)
    bench.send()
    bench.results()
    assert bench.set(robot_stands_still=True).successful
    ros.spin_until(lambda: len(bench.got['scan']) >= 3, 'scans')
    first, last = bench.got['scan'][0], bench.got['scan'][-1]
    assert np.array_equal(first.ranges, last.ranges, equal_nan=True)
    assert last.header.stamp.sec > first.header.stamp.sec == 1


def test_stddev_comes_with_the_scan_and_withholds_vague_beams(ros):
    bench = Bench(
        ros,
        beams=180,
        republish_period=0.0,
        disparity_stddev_columns=0.25,
        doubtful_stddev_columns=0.25,
        focal_length_stddev=0.0,
        arm_radius_stddev=0.0,
    )
    stddevs = []
    bench.node.create_subscription(LaserScan, 'scan_stddev', stddevs.append, 10)
    ros.spin_until(lambda: bench.depth.count_subscribers('scan_stddev'), 'the subscription')
    bench.send()
    scan = bench.results()['scan']
    ros.spin_until(lambda: len(stddevs) == 1, 'the standard deviations')
    (stddev,) = stddevs
    assert stddev.header == scan.header
    assert (stddev.angle_min, stddev.angle_max) == (scan.angle_min, scan.angle_max)
    assert np.array_equal(np.isfinite(stddev.ranges), np.isfinite(scan.ranges))
    # A column of 1° at this distance, l²·θ0/(2·r0), a quarter of it.
    expected = 0.25 * STEP * DISTANCE**2 / (2 * R * math.sin(PHI))
    assert np.nanmedian(stddev.ranges) == pytest.approx(expected, rel=0.05)
    assert bench.set(allowed_stddev=0.9 * expected).successful
    bench.send(stamp=2)
    assert np.isnan(bench.results(2)['scan'].ranges).all()


def serve_panoramas(bench, at_request):
    """Serve what a mosaicer serves, with panoramas from a certain request on; the requests."""
    requests = []

    def answer(request, response):
        requests.append(request)
        response.success = len(requests) >= at_request
        if response.success:
            bench.send()
        return response

    bench.node.create_service(Trigger, 'mosaicer/publish_last', answer)
    return requests


def test_panoramas_are_asked_for_until_they_come(ros):
    bench = Bench(ros)
    requests = serve_panoramas(bench, at_request=2)
    bench.results()
    ros.spin_until(bench.depth._latecomer._timer.is_canceled, 'the end of asking')
    assert len(requests) == 2


def test_panoramas_that_came_before_the_scan_was_heard_are_asked_for_again(ros):
    bench = Bench(ros)
    (scans,) = (s for s in bench.node.subscriptions if s.topic_name == '/scan')
    bench.node.destroy_subscription(scans)
    ros.spin_until(lambda: not bench.depth.count_subscribers('scan'), 'nobody who hears the scan')
    bench.send()
    ros.spin_until(lambda: bench.got['depth/image'], 'the match')
    assert not bench.got['scan']
    bench.node.create_subscription(LaserScan, 'scan', bench.got['scan'].append, 10)
    requests = serve_panoramas(bench, at_request=1)
    bench.results()
    assert len(requests) == 1


def test_a_mosaicer_that_is_new_is_asked_for_what_it_may_have_published_before(ros):
    bench = Bench(ros)
    bench.send()
    bench.results()
    assert bench.depth._latecomer._timer.is_canceled()
    requests = serve_panoramas(bench, at_request=1)
    bench.node.create_publisher(Image, 'left/image', 10)
    bench.results(2)
    assert len(requests) == 1
