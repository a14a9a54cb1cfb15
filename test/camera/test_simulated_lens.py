"""A misaligned, distorted camera of known mounting gives the panoramas of an aligned one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from panodepth_ros.camera.simulated import RealCamera, Room, RoomCamera, furnished_room
from panodepth_ros.geometry import Mounting, PinholeCamera
from panodepth_ros.mosaic import Rig, Sweep

IDEAL = RoomCamera.from_field_of_view(160, 120, math.radians(34.0))
ALIGNED = PinholeCamera(width=160, height=120, fx=IDEAL.fx, fy=IDEAL.fx, cx=79.5, cy=59.5)
MOUNTING = Mounting(yaw=math.radians(1.2), roll=math.radians(0.7), tilt=math.radians(-0.8))
REAL = replace(ALIGNED, distortion=(-0.08, 0.0, 0.0, 0.0), mounting=MOUNTING)
RADIUS = 0.3


@pytest.fixture(scope='module')
def room() -> Room:
    return furnished_room(1)


def panoramas(room: Room, lens: PinholeCamera, mounting: Mounting) -> dict[str, np.ndarray]:
    """Sixty columns of the turn by a camera taken to have that mounting, rows by slope."""
    rig = Rig(
        arm_radius=RADIUS, column_offset=70.5, columns=1800, sweep_columns=60, mounting=mounting
    )
    sweep, camera = Sweep(rig, lens, 0.0), RealCamera(lens)
    for k in range(60):
        azimuth = k * rig.column_step
        sweep.add(k + 1, camera.render(room, azimuth, RADIUS), azimuth)
    found = {}
    for name, panorama in sweep.panoramas().items():
        seen = panorama.image[:, panorama.geometry.seen].astype(np.float64)
        first = round(59.5 - panorama.geometry.principal_row)
        assert panorama.geometry.principal_row == 59.5 - first
        found[name] = np.full((140, 60, 3), np.nan)
        found[name][10 + first : 10 + first + len(seen)] = seen
    return found


def test_known_mounting_gives_the_panoramas_of_an_aligned_camera(room: Room) -> None:
    aligned = panoramas(room, ALIGNED, Mounting())
    known = panoramas(room, REAL, MOUNTING)
    ignored = panoramas(room, REAL, Mounting())
    for name in aligned:
        off = [np.abs(seen[name] - aligned[name]) for seen in (known, ignored)]
        assert np.isfinite(off[0]).mean() > 0.75
        # Interpolation blurs edges by half a pixel; a wrong mounting moves them by several.
        right, wrong = (np.nanmean(o) for o in off)
        assert right < 3.5
        assert right < 0.3 * wrong


class Waves:
    """Upright waves of four pixels on an endless wall, in place of a room."""

    wave_number = 2 * math.pi * IDEAL.fx / 4

    def render(self, phase: float, level: RoomCamera, _: float) -> np.ndarray:
        x = (np.arange(level.width) - level.cx) / level.fx
        row = np.rint(127.5 + 100 * np.cos(self.wave_number * x + phase))
        return np.broadcast_to(row[:, np.newaxis], (level.height, level.width, 3)).astype(np.uint8)


def test_turned_camera_sees_things_where_they_are_in_all_columns() -> None:
    # Columns that are displaced alike are a lens; a calibration sees what 0.005 px do.
    lens = replace(ALIGNED, mounting=Mounting(yaw=math.radians(1.2)))
    camera, waves = RealCamera(lens), Waves()
    phases = 2 * math.pi * np.arange(16) / 16
    seen = sum(
        camera.render(cast('Room', waves), phase, RADIUS)[..., 0] * np.exp(-1j * phase)
        for phase in phases.tolist()
    )
    v, u = np.mgrid[0:120, 0:160]
    expected = waves.wave_number * -np.tan(lens.rays(u, v)[0])
    off = np.angle(seen * np.exp(-1j * expected)) * 4 / (2 * math.pi)
    stripes = off.mean(axis=0).reshape(16, 10).mean(axis=1)
    assert np.abs(stripes).max() < 0.003


def test_ideal_camera_is_rendered_directly(room: Room) -> None:
    frame = RealCamera(ALIGNED).render(room, 0.3, RADIUS)
    assert np.array_equal(frame, room.render(0.3, IDEAL, RADIUS))


def test_camera_that_looks_back_is_refused() -> None:
    with pytest.raises(ValueError, match=r'looks \d+° aside .* allowed: 75°'):
        RealCamera(replace(ALIGNED, mounting=Mounting(yaw=1.2)))
