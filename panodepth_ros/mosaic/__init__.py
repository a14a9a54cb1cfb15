"""From frames and arm angles to panoramas: arm track, column lookup, sweep, assembler."""

from panodepth_ros.mosaic.arm_track import ArmTrack, Standstill
from panodepth_ros.mosaic.assembler import Assembler
from panodepth_ros.mosaic.lookup import ColumnLookup
from panodepth_ros.mosaic.sweep import Rig, Sweep

__all__ = ['ArmTrack', 'Assembler', 'ColumnLookup', 'Rig', 'Standstill', 'Sweep']
