"""The geometry of the rig: equations, mounted camera, panoramas, triangulation of a pair."""

from panodepth_ros.geometry.camera import PinholeCamera
from panodepth_ros.geometry.mounting import ALIGNED, Mounting
from panodepth_ros.geometry.omnistereo import (
    SURFACE_DEPTH,
    Points,
    check_pair,
    distance_stddev,
    locate,
    pair_search_range,
    triangulate,
)
from panodepth_ros.geometry.panorama import Panorama, PanoramaGeometry

__all__ = [
    'ALIGNED',
    'SURFACE_DEPTH',
    'Mounting',
    'Panorama',
    'PanoramaGeometry',
    'PinholeCamera',
    'Points',
    'check_pair',
    'distance_stddev',
    'locate',
    'pair_search_range',
    'triangulate',
]
