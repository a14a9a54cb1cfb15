"""The security policy grants each node what it uses, and nothing else."""

import fnmatch
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from fixtures.arm import FAST, ArmServer
from rclpy.parameter import Parameter

from panodepth_ros.nodes.arm_driver import ArmDriver
from panodepth_ros.nodes.calibrator import Calibrator
from panodepth_ros.nodes.camera import CameraNode
from panodepth_ros.nodes.depth import Depth
from panodepth_ros.nodes.mosaicer import Mosaicer
from panodepth_ros.nodes.views import Views

pytestmark = pytest.mark.ros

POLICY = Path(__file__).resolve().parents[2] / 'config' / 'sros2_policy.xml'
KINDS = {
    ('topics', 'publish'): 'get_publisher_names_and_types_by_node',
    ('topics', 'subscribe'): 'get_subscriber_names_and_types_by_node',
    ('services', 'reply'): 'get_service_names_and_types_by_node',
    ('services', 'request'): 'get_client_names_and_types_by_node',
}
#: Each node in all the ways that differ in what it uses; in each it may take its time from /clock.
WAYS = {
    'arm_driver': [{}],
    'camera': [{}],
    'mosaicer': [
        {'further_offsets_px': [20.0], 'partial_deg': 30.0},
        {'motion': 'continuous', 'image_transport': 'compressed'},
    ],
    'calibrator': [{}],
    'views': [{'faces': 36}],
    'depth': [{'further_pairs': 1, 'use_center': True, 'method': 'sgbm'}],
}

#: What a camera has of a V4L2 device only, as test_camera_v4l2 shows; and views where tf2_msgs,
#: which PyPI has not, is installed.
ELSEWHERE = {
    ('camera', 'services', 'reply'): {'/camera/settle'},
    ('views', 'topics', 'publish'): {'/tf_static'},
}


def granted():
    """What the policy allows, (node, kind, rule) to patterns of full names."""
    root = ET.parse(POLICY).getroot()
    assert (root.tag, root.get('version')) == ('policy', '0.2.0')
    grants = {}
    for enclave in root.findall('enclaves/enclave'):
        (profile,) = enclave.findall('profiles/profile')
        node = profile.get('node')
        assert (profile.get('ns'), enclave.get('path')) == ('/', f'/panodepth/{node}')
        for group in profile:
            for rule, value in group.attrib.items():
                assert value == 'ALLOW'
                names = grants.setdefault((node, group.tag, rule), set())
                names |= {f'/{entry.text.removeprefix("/")}' for entry in group}
    return grants


@pytest.fixture
def used(ros, tmp_path):
    """What the running nodes have, as :func:`granted`."""
    server = ArmServer(tmp_path / 'arm', FAST)
    made = {
        'arm_driver': ArmDriver,
        'camera': CameraNode,
        'mosaicer': Mosaicer,
        'calibrator': Calibrator,
        'depth': Depth,
        'views': Views,
    }
    own = {
        'arm_driver': {'port': server.link},
        'camera': {
            'source': 'simulated',
            'simulated_arm_truth': f'{server.link}.truth',
            'image_width': 32,
            'image_height': 24,
        },
    }
    found = {}
    try:
        for name, ways in WAYS.items():
            for way in ways:
                values = {'use_sim_time': True, **own.get(name, {}), **way}
                node = made[name](
                    context=ros.context,
                    parameter_overrides=[Parameter(key, value=v) for key, v in values.items()],
                )
                try:
                    for (kind, rule), ask in KINDS.items():
                        names = {entry for entry, _ in getattr(node, ask)(name, '/')}
                        found.setdefault((name, kind, rule), set()).update(names)
                finally:
                    node.destroy_node()
        for key, names in ELSEWHERE.items():
            found[key] |= names
        yield found
    finally:
        server.unplug()


def test_every_node_is_granted_what_it_uses_and_nothing_else(used):
    grants = granted()
    assert {key for key, names in used.items() if names} == set(grants)
    for key, patterns in grants.items():
        refused = [
            name
            for name in used[key]
            if not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
        ]
        assert refused == [], f'{key} is not granted what it uses'
        idle = [pattern for pattern in patterns if not fnmatch.filter(used[key], pattern)]
        assert idle == [], f'{key} is granted what it does not use'


def test_patterns_reach_no_other_name():
    for patterns in granted().values():
        for pattern in patterns:
            assert not set('*?') & set(pattern)
            numbered = re.match(r'/(pair_\[1-9\]|view_(\[1-3\])?\[0-9\])/', pattern)
            assert numbered or '[' not in pattern
