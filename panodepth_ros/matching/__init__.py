"""A pair of panoramas to column disparity and confidence."""

from panodepth_ros.matching.interface import (
    METHODS,
    Correspondence,
    match,
    prepare,
    triangulate_match,
    window_geometry,
)

__all__ = [
    'METHODS',
    'Correspondence',
    'match',
    'prepare',
    'triangulate_match',
    'window_geometry',
]
