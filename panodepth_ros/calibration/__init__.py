"""What a sweep tells about its own camera: tracks, bundle adjustment, view angle. No ROS."""

from panodepth_ros.calibration.self_calibration import (
    Estimate,
    Given,
    SelfCalibration,
    calibrate_by,
    self_calibrate,
)
from panodepth_ros.calibration.view_angle import ViewAngle, compare_view_angles

__all__ = [
    'Estimate',
    'Given',
    'SelfCalibration',
    'ViewAngle',
    'calibrate_by',
    'compare_view_angles',
    'self_calibrate',
]
