"""Positions of cv2.remap to less than its rounding."""

import math

import cv2
import numpy as np

from panodepth_ros.geometry.sampling import sampling_maps

PERIOD = 16.0
#: Between two of the positions that OpenCV knows, near the middle, where Lanczos' kernel is exact.
OFF = 0.5 + 0.49 / 32


def shift_of(u, v):
    """How far a wave seems shifted where it is sampled, mean over the picture [px]."""
    phases = 2 * math.pi * np.arange(8) / 8
    found = 0
    for phase in phases.tolist():
        wave = 127.5 + 120 * np.cos(2 * math.pi * np.arange(200) / PERIOD + phase)
        picture = np.tile(wave.astype(np.float32), (60, 1))
        seen = cv2.remap(picture, u, v, cv2.INTER_LANCZOS4)
        found = found + seen * np.exp(-1j * phase)
    place = np.arange(20, 180) + OFF
    turned = found[5:-5, 20:180] * np.exp(-2j * math.pi * place / PERIOD)
    return float(np.angle(turned.mean()) / (2 * math.pi) * PERIOD)


def test_positions_between_those_of_opencv_are_met_in_the_mean():
    v, u = np.mgrid[0:60, 0:200] + np.zeros((2, 1, 1))
    u = u + OFF
    rounded = shift_of(u.astype(np.float32), v.astype(np.float32))
    assert abs(rounded) > 0.01, 'else there is nothing to mend'
    assert abs(shift_of(*sampling_maps(u, v))) < 0.002


def test_no_position_moves_by_more_than_half_a_rounding_step():
    v, u = np.mgrid[0:60, 0:200] + np.zeros((2, 1, 1))
    for map_, place in zip(sampling_maps(u, v), (u, v), strict=True):
        assert map_.dtype == np.float32
        assert np.abs(map_ - place).max() <= 1 / 64 + 1e-5
