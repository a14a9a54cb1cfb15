"""Named quality of service profiles, against what subscribers of each kind ask for."""

import pytest
from rclpy.qos import (
    DurabilityPolicy,
    QoSCompatibility,
    QoSProfile,
    qos_check_compatible,
    qos_profile_sensor_data,
)

from panodepth_ros.ros import qos

pytestmark = pytest.mark.ros

RELIABLE = QoSProfile(depth=10)  # what RViz asks for
PROFILES = [(qos.IMAGES, 10), (qos.JOINT_STATES, 50), (qos.PANORAMAS, 5), (qos.SCAN, 10)]


@pytest.mark.parametrize(('profile', 'depth'), PROFILES)
def test_profile_serves_reliable_and_best_effort_subscribers(profile, depth) -> None:
    for subscriber in (RELIABLE, qos_profile_sensor_data):
        compatibility, reason = qos_check_compatible(profile, subscriber)
        assert compatibility != QoSCompatibility.ERROR, reason
    assert profile.durability == DurabilityPolicy.VOLATILE
    assert profile.depth == depth
