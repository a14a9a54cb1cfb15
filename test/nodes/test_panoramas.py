"""Panoramas of the sweep under construction, on topics of their own."""

import numpy as np
import pytest
from fixtures.mosaicer import COLUMNS, Bench
from sensor_msgs.msg import CameraInfo, Image

from panodepth_ros.nodes.panoramas import KINDS, PARTIAL
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry, to_nanoseconds

pytestmark = pytest.mark.ros


def listen(bench):
    """Messages that come on the partial topics from now on."""
    got = {}
    for topic in (f'{name}/{kind}' for name in PARTIAL for kind in KINDS):
        kind = Image if topic.endswith('image') else CameraInfo
        bench.listener.create_subscription(kind, topic, got.setdefault(topic, []).append, 100)
    bench.ros.spin_until(
        lambda: all(bench.mosaicer.count_subscribers(topic) for topic in got), 'the listener'
    )
    return got


def test_pair_under_construction_is_published_as_it_grows(ros):
    bench = Bench(ros, partial_deg=60.0).ready()
    got = listen(bench)
    bench.start()
    final = bench.sweeps()
    ros.spin_until(lambda: all(len(messages) == 5 for messages in got.values()), 'partial pairs')
    for name in PARTIAL:
        eye = name.rpartition('/')[2]
        whole = to_array(final[f'{eye}/image'])
        whole_geometry = panorama_geometry(final[f'{eye}/camera_info'])
        starts = set()
        for k, messages in enumerate(zip(*(got[f'{name}/{kind}'] for kind in KINDS), strict=True)):
            image, info = messages
            assert image.header == info.header
            assert image.header.frame_id == 'panodepth'
            geometry = panorama_geometry(info)
            assert int(geometry.seen.sum()) == (k + 1) * 10
            assert geometry.azimuth_column == whole_geometry.azimuth_column
            seen = to_array(image)[:, geometry.seen]
            assert np.array_equal(seen, whole[:, geometry.seen])
            stamp = to_nanoseconds(image.header.stamp)
            starts.add(round((stamp * 1e-9 - geometry.sweep_duration) * 1e6))
            assert stamp < to_nanoseconds(final[f'{eye}/image'].header.stamp)
        assert len(starts) == 1, 'the start tells of which sweep a pair is'
    bench.start()
    bench.sweeps(2)
    ros.spin_until(lambda: all(len(messages) == 10 for messages in got.values()), 'the next sweep')


def test_nothing_partial_unless_asked_for(ros):
    bench = Bench(ros).ready()
    bench.start()
    assert panorama_geometry(bench.sweeps()['left/camera_info']).seen.sum() == COLUMNS
    published = bench.mosaicer.get_publisher_names_and_types_by_node('mosaicer', '/')
    assert not [topic for topic, _ in published if 'partial' in topic]
