"""Parameters of the calibrator."""

from __future__ import annotations

import math
from dataclasses import dataclass

from panodepth_ros.mosaic import Assembler, Rig
from panodepth_ros.mosaic.rig import columns_per_turn
from panodepth_ros.nodes.stepping_settings import SteppingParameters
from panodepth_ros.ros.parameters import parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratorParameters(SteppingParameters):
    """Parameters of the calibrator."""

    output: str = parameter(
        'camera.yaml', 'Calibration file to write, for camera_info_url', live=True
    )
    camera_name: str = parameter(
        'panodepth_camera', 'Name of the camera in the calibration file', live=True
    )
    field_of_view_deg: float = parameter(
        0.0,
        'Rough horizontal view angle to begin with, for a camera without a calibration; 0 begins '
        'with camera_info',
        unit='°',
        bounds=(0.0, 120.0),
    )
    largest_stddev: float = parameter(
        0.03,
        'Largest standard deviation of fx, as a share of it, of a calibration that is written',
        bounds=(0.0001, 0.1),
        live=True,
    )
    column_step_deg: float = parameter(
        0.2,
        "The arm's step_deg without its sign, a whole fraction of 360",
        unit='°',
        bounds=(0.01, 2.0),
    )
    sweep_deg: float = parameter(360.0, 'Angle that the arm turns', unit='°', bounds=(60.0, 360.0))

    def __post_init__(self) -> None:
        columns_per_turn(self.column_step_deg)

    def assembler(self) -> Assembler:
        """Return what tells which frames are of a standing arm; its panoramas are not used."""
        columns = columns_per_turn(self.column_step_deg)
        rig = Rig(
            arm_radius=1.0,
            column_offset=0.0,
            columns=columns,
            sweep_columns=round(columns * self.sweep_deg / 360.0),
        )
        return Assembler(rig, self.arm_track(), round(self.settle_time * 1e9))

    @property
    def view_angle(self) -> float | None:
        """Rough horizontal view angle [rad]; None for that of camera_info."""
        return math.radians(self.field_of_view_deg) or None
