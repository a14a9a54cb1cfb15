"""Parameters of the mosaicer, and the sweeps they describe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from panodepth_ros.geometry import Mounting
from panodepth_ros.mosaic import ArmMotion, Assembler, ContinuousAssembler, Rig
from panodepth_ros.mosaic.builder import SweepBuilder
from panodepth_ros.mosaic.rig import columns_per_turn
from panodepth_ros.nodes.stepping_settings import SteppingParameters
from panodepth_ros.ros.parameters import parameter


@dataclass(frozen=True, slots=True, kw_only=True)
class MosaicerParameters(SteppingParameters):
    """Parameters of the mosaicer."""

    lead: bool = parameter(
        True, "Lead the sweep by the arm's services; false only listens, live or to a bag"
    )
    motion: str = parameter(
        'stop_and_go',
        'How the arm turns: a step and a rest for every frame, or steadily',
        choices=('stop_and_go', 'continuous'),
    )
    free_running: bool = parameter(
        False, 'Let a steadily turning arm make sweep after sweep until ~/cancel', live=True
    )
    image_delay_ms: float = parameter(
        0.0,
        "From a frame's stamp to the middle of its exposure, by the arm's clock; for a steadily "
        'turning arm',
        unit='ms',
        bounds=(-1000.0, 1000.0),
        live=True,
    )
    correct_delay: bool = parameter(
        True,
        'Estimate what is missing in image_delay_ms from two sweeps to either side, and set it so',
        live=True,
    )
    row_time_us: float = parameter(
        0.0,
        'From the exposure of one image row to that of the next; 0 for a global shutter',
        unit='µs',
        bounds=(0.0, 1000.0),
        live=True,
    )
    image_transport: str = parameter(
        'raw',
        'Take frames from image_raw, or from image_raw/compressed',
        choices=('raw', 'compressed'),
    )
    arm_radius: float = parameter(
        0.30, 'Axis of rotation to optical centre', unit='m', bounds=(0.01, 10.0), live=True
    )
    column_offset_px: float = parameter(
        70.5,
        "Distance of the left and right eye's columns from the principal point",
        unit='px',
        bounds=(1.0, 10000.0),
        live=True,
    )
    camera_yaw_deg: float = parameter(
        0.0,
        'Optical axis to the left of the radial direction, counter-clockwise seen from above',
        unit='°',
        bounds=(-45.0, 45.0),
        live=True,
    )
    camera_roll_deg: float = parameter(
        0.0,
        'Camera turned clockwise about its optical axis, seen from behind',
        unit='°',
        bounds=(-180.0, 180.0),
        live=True,
    )
    camera_tilt_deg: float = parameter(
        0.0,
        'Optical axis above the plane of rotation',
        unit='°',
        bounds=(-45.0, 45.0),
        live=True,
    )
    further_offsets_px: tuple[float, ...] = parameter(
        (),
        'Such distances of further pairs, published under pair_1, pair_2, …; left out for none',
        unit='px',
        bounds=(1.0, 10000.0),
    )
    column_step_deg: float = parameter(
        0.2,
        'Angle between panorama columns, a whole fraction of 360',
        unit='°',
        bounds=(0.01, 6.0),
    )
    stripe_columns: int = parameter(
        1,
        "Columns that one frame fills, a divisor of those of a turn; the arm's step must be as "
        'many column steps, a steady turn at most as many from frame to frame, best half as many',
        bounds=(1, 360),
    )
    stripe_distance: float = parameter(
        2.0,
        'Distance from the axis at which neighbouring stripes join, at least twice the arm_radius',
        unit='m',
        bounds=(0.02, 1000.0),
    )
    sweep_deg: float = parameter(
        360.0,
        'Angle that a sweep covers, a whole number of column steps',
        unit='°',
        bounds=(1.0, 360.0),
        live=True,
    )
    partial_deg: float = parameter(
        0.0,
        'Publish the pair under construction each time it has grown by this angle; 0 for never',
        unit='°',
        bounds=(0.0, 180.0),
    )
    frame_id: str = parameter(
        'panodepth', 'Frame of the panoramas: on the axis, z up, x forward, not turning'
    )
    state_file: str = parameter(
        '',
        'Where a led sweep is kept, so that a killed mosaicer goes on with it; best in memory, as '
        'under /dev/shm; empty for nowhere',
    )
    equalize_light: bool = parameter(
        True,
        'Remove steps of the brightness and colour of whole frames; make columns unknown where a '
        'part of the view has changed between the sightings of the two eyes',
        live=True,
    )
    closure: str = parameter(
        'off',
        'What happens to a full turn whose last frame does not fit the first, or cannot be '
        'compared with it: off, it is not looked at; refuse, it is not published; correct, an '
        'angle that the arm lost is spread over the turn and all else refused. A led stop-and-go '
        'turn takes one more frame for that, at 360°',
        choices=('off', 'refuse', 'correct'),
    )
    closure_tolerance_deg: float = parameter(
        0.07,
        'Lost angle, and mismatch of the first and the last frame, that are none',
        unit='°',
        bounds=(0.001, 10.0),
        live=True,
    )

    def __post_init__(self) -> None:
        turn = columns_per_turn(self.column_step_deg)
        if turn % self.stripe_columns:
            divisors = [str(n) for n in range(1, 361) if turn % n == 0]
            raise ValueError(
                f'stripe_columns is {self.stripe_columns}; allowed: divisors of the {turn} '
                f'columns of a turn, {", ".join(divisors)}'
            )
        offsets = (self.column_offset_px, *self.further_offsets_px)
        if len(set(offsets)) < len(offsets):
            raise ValueError(
                f'further_offsets_px is {list(self.further_offsets_px)} besides column_offset_px '
                f'{self.column_offset_px}; allowed: distances that differ'
            )
        self.rig()
        if self.free_running and self.motion != 'continuous':
            raise ValueError('free_running is true; allowed: with motion continuous only')
        columns = self.sweep_deg / self.column_step_deg
        if abs(columns - round(columns)) > 0.02:
            raise ValueError(
                f'sweep_deg is {self.sweep_deg}: {columns:.3f} steps of column_step_deg '
                f'{self.column_step_deg}; allowed: a whole number of them'
            )

    def rig(self) -> Rig:
        """Return what the core needs."""
        columns = columns_per_turn(self.column_step_deg)
        return Rig(
            arm_radius=self.arm_radius,
            column_offset=self.column_offset_px,
            columns=columns,
            sweep_columns=min(columns, round(self.sweep_deg / self.column_step_deg)),
            mounting=Mounting(
                yaw=math.radians(self.camera_yaw_deg),
                roll=math.radians(self.camera_roll_deg),
                tilt=math.radians(self.camera_tilt_deg),
            ),
            further_offsets=self.further_offsets_px,
            stripe_columns=self.stripe_columns,
            stripe_distance=self.stripe_distance if self.stripe_columns > 1 else math.inf,
            closes=self.closure != 'off',
            mends_light=self.equalize_light,
            closing_frame=self.lead and self.motion == 'stop_and_go',
        )

    def builder(self) -> SweepBuilder[Any]:
        """Return what makes sweeps of frames and joint states."""
        if self.motion == 'continuous':
            return ContinuousAssembler(
                self.rig(),
                ArmMotion(round(self.joint_state_gap * 1e9)),
                round(self.image_delay_ms * 1e6),
                self.row_time_us * 1e-6,
            )
        return Assembler(self.rig(), self.arm_track(), round(self.settle_time * 1e9))

    def renew_timing(self, builder: SweepBuilder[Any]) -> None:
        """Let a builder go on with these delays."""
        if isinstance(builder, ContinuousAssembler):
            builder.image_delay = round(self.image_delay_ms * 1e6)
            builder.row_time = self.row_time_us * 1e-6
