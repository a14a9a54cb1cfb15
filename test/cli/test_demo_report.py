"""What the demo prints of its results."""

import math

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='messages need ROS 2')

from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from panodepth_ros.cli.demo_report import report
from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.images import to_message
from panodepth_ros.ros.messages import panorama_info

COLUMNS, ROWS, PHI = 36, 5, math.radians(15.0)


def results(unseen):
    """One sweep of a coarse rig whose frames did not reach some columns."""
    found = {}
    for eye, angle in (('left', -PHI), ('right', PHI)):
        rays = np.full(COLUMNS, angle)
        rays[:unseen] = np.nan
        geometry = PanoramaGeometry(
            columns=COLUMNS,
            rows=ROWS,
            azimuth_column=COLUMNS / 2,
            focal_length_px=30.0,
            principal_row=2.0,
            arm_radius=0.3,
            principal_angle=angle,
            sweep_duration=10.0,
            ray_angle=rays,
        )
        found[f'{eye}/camera_info'] = panorama_info(geometry, Header(frame_id='panodepth'))
        found[f'{eye}/image'] = to_message(np.zeros((ROWS, COLUMNS, 3), np.uint8), 'bgr8')
    plane = np.full((ROWS, COLUMNS), 2.0, np.float32)
    found['depth/image'] = to_message(plane, '32FC1')
    found['depth/confidence'] = to_message(plane / 2, '32FC1')
    found['scan'] = LaserScan(
        angle_min=-math.pi, angle_increment=2 * math.pi / COLUMNS, ranges=[2.0] * COLUMNS
    )
    return found


@pytest.mark.parametrize('unseen', [0, 3])
def test_columns_without_a_frame_are_told(tmp_path, capsys, unseen):
    report(results(unseen), tmp_path, room_seed=0, band=(-0.15, 0.15))
    said = capsys.readouterr().out
    assert ('columns are unknown' in said) == bool(unseen)
    assert not unseen or '3 of 36 columns' in said
    assert (tmp_path / 'ground_plan.png').is_file()
