"""From frames and arm angles to panoramas: arm track, column lookup, sweep, assembler."""

from panodepth_ros.mosaic.arm_motion import ArmMotion, Turning
from panodepth_ros.mosaic.arm_track import ArmTrack, Standstill
from panodepth_ros.mosaic.assembler import Assembler
from panodepth_ros.mosaic.continuous import ContinuousAssembler
from panodepth_ros.mosaic.lookup import ColumnLookup
from panodepth_ros.mosaic.rig import Rig
from panodepth_ros.mosaic.sweep import Sweep

__all__ = [
    'ArmMotion',
    'ArmTrack',
    'Assembler',
    'ColumnLookup',
    'ContinuousAssembler',
    'Rig',
    'Standstill',
    'Sweep',
    'Turning',
]
