"""A pair of panoramas to column disparity and confidence."""

from panodepth_ros.matching.interface import METHODS, Correspondence, match, prepare

__all__ = ['METHODS', 'Correspondence', 'match', 'prepare']
