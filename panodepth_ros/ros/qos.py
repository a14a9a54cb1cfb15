"""
Quality of service, by what flows.

All are reliable: a reliable publisher serves reliable and best-effort subscribers alike, and
large best-effort messages are lost between processes. All are volatile: a subscriber that asks
for volatile never gets a latched message.
"""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
    )


IMAGES = _reliable(10)
"""``image_raw`` and ``camera_info``."""

JOINT_STATES = _reliable(50)
"""``joint_states``: many small messages, each of which may decide about a frame."""

PANORAMAS = _reliable(5)
"""Panoramas, depth images and point clouds, with their ``camera_info``."""

SCAN = _reliable(10)
"""``scan``."""
