"""Parameters of every node that leads or follows an arm: whether a frame is of a standing one."""

from __future__ import annotations

import math
from dataclasses import dataclass

from panodepth_ros.mosaic import ArmTrack
from panodepth_ros.nodes.still_settings import StillParameters
from panodepth_ros.ros.parameters import parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class SteppingParameters(StillParameters):
    """When the arm, the camera and the robot are ready for a frame, and how long to wait."""

    joint_name: str = parameter('panodepth_arm_joint', "The arm's joint in joint_states")
    settle_time: float = parameter(
        0.0,
        'Time a frame must come after the start of a standstill, for arms that report standing '
        'before they have settled',
        unit='s',
        bounds=(0.0, 10.0),
    )
    standstill_tolerance_deg: float = parameter(
        0.002, 'Largest change of position that counts as standing', unit='°', bounds=(0.0, 1.0)
    )
    joint_state_gap: float = parameter(
        1.0, 'Longest time between joint states around a frame', unit='s', bounds=(0.01, 10.0)
    )
    step_timeout: float = parameter(
        10.0, 'Longest time for a step of the arm', unit='s', bounds=(0.1, 600.0)
    )
    frame_timeout: float = parameter(
        5.0,
        'Time without a frame after which the camera is reported',
        unit='s',
        bounds=(0.1, 60.0),
    )
    robot_motion: str = parameter(
        'heed',
        'What odom and cmd_vel are for: heed gives up a sweep during which they tell that the '
        'robot moves, require also one of which odom does not prove that it stands',
        choices=('ignore', 'heed', 'require'),
    )
    stamped_cmd_vel: bool = parameter(
        False, 'Whether cmd_vel is TwistStamped, as in Kilted and later, or Twist'
    )

    def arm_track(self) -> ArmTrack:
        """Return what tells standstills of the arm."""
        return ArmTrack(
            math.radians(self.standstill_tolerance_deg), round(self.joint_state_gap * 1e9)
        )
