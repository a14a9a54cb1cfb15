"""Parameters of the depth node."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, fields

from panodepth_ros.matching import METHODS
from panodepth_ros.nodes.still_settings import StillParameters
from panodepth_ros.ros.parameters import parameter
from panodepth_ros.scan.beams import ScanSettings
from panodepth_ros.scan.uncertainty import Uncertainty


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthParameters(StillParameters):
    """Parameters of the depth node."""

    method: str = parameter(
        'semiglobal', 'How the panoramas are matched', choices=METHODS, live=True
    )
    further_pairs: int = parameter(
        0,
        'Further pairs, pair_1 and so on, that the matching is given; it waits for all of them',
        bounds=(0, 16),
    )
    use_center: bool = parameter(False, 'Whether the matching is given the centre panorama, too')
    threads: int = parameter(
        2, 'Threads that match; the result does not depend on it', bounds=(1, 64), live=True
    )
    min_confidence: float = parameter(
        0.3, 'Pixels of less confidence are unknown', bounds=(0.0, 1.0), live=True
    )
    beams: int = parameter(720, 'Beams of the scan', bounds=(60, 7200))
    range_min: float = parameter(
        0.35, 'Ranges below are reported as −inf', unit='m', bounds=(0.01, 100.0)
    )
    range_max: float = parameter(
        8.0, 'Ranges above are reported as +inf', unit='m', bounds=(0.1, 1000.0)
    )
    min_height: float = parameter(
        -0.15,
        "Lower edge of the scan's height band, from the camera",
        unit='m',
        bounds=(-100.0, 100.0),
        live=True,
    )
    max_height: float = parameter(
        0.15,
        "Upper edge of the scan's height band, from the camera",
        unit='m',
        bounds=(-100.0, 100.0),
        live=True,
    )
    min_support: float = parameter(
        12.0,
        'Sum of the confidences of pixels of one distance that make a surface of a beam; '
        'more within 1.2 m; a third of it makes the beam unknown',
        bounds=(0.0, 10000.0),
        live=True,
    )
    row: int = parameter(
        -1,
        'Make the scan from this row of the panorama alone; -1 for the height band',
        bounds=(-1, 100000),
        live=True,
    )

    disparity_stddev_columns: float = parameter(
        0.05,
        "Standard deviation of a beam's column disparity at a confidence of 1",
        unit='columns',
        bounds=(0.0, 100.0),
        live=True,
    )
    doubtful_stddev_columns: float = parameter(
        3.5,
        'The same at a confidence of 0; what is between is interpolated',
        unit='columns',
        bounds=(0.0, 100.0),
        live=True,
    )
    focal_length_stddev: float = parameter(
        0.001,
        'Standard deviation of fx as a share of it, as the calibration tells',
        bounds=(0.0, 0.1),
        live=True,
    )
    arm_radius_stddev: float = parameter(
        0.001, 'Standard deviation of arm_radius', unit='m', bounds=(0.0, 0.1), live=True
    )
    allowed_stddev: float = parameter(
        0.0,
        'Beams of a larger standard deviation are unknown; 0 for none',
        unit='m',
        bounds=(0.0, 100.0),
        live=True,
    )
    republish_period: float = parameter(
        1.0,
        'Period of publishing the last scan again while the robot stands still; 0 for never',
        unit='s',
        bounds=(0.0, 3600.0),
    )
    robot_stands_still: bool = parameter(
        False,
        'Promise that the robot never moves, which makes odometry unnecessary',
        live=True,
    )

    def __post_init__(self) -> None:
        self.scan_settings()

    def uncertainty(self) -> Uncertainty:
        """Return what ranges are computed from, and how well it is known."""
        return Uncertainty(
            certain_disparity=self.disparity_stddev_columns,
            doubtful_disparity=self.doubtful_stddev_columns,
            focal_length=self.focal_length_stddev,
            arm_radius=self.arm_radius_stddev,
        )

    def way_of_measuring(self) -> Hashable:
        """Return all that ranges of the same panoramas depend on."""
        return self.method, self.scan_settings(), self.uncertainty(), self.allowed_stddev

    def scan_settings(self) -> ScanSettings:
        """Return what the core needs."""
        return ScanSettings(**{f.name: getattr(self, f.name) for f in fields(ScanSettings)})
