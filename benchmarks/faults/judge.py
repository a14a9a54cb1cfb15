"""Whether what was published is true: panoramas and scan against the simulated room."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import occupancy
from benchmarks.faults.graph import ARM_RADIUS, BEAMS, FOV_DEG, HEIGHT, WIDTH
from panodepth_ros.analysis.evaluation import score_scan
from panodepth_ros.camera.simulated import Room, RoomCamera, furnished_room
from panodepth_ros.geometry import PanoramaGeometry
from panodepth_ros.ros.images import to_array
from panodepth_ros.ros.messages import panorama_geometry

#: Columns whose pixels differ from the truth by more than this, on average, are wrong [grey
#: levels]; the sensor's noise alone makes 1.2, a frame from the neighbouring place 10 and more.
WRONG_COLUMN = 8.0
#: Brighter pixels may be overexposed when the light is switched, and are not compared then.
GLARING = 200.0
#: Scans whose median error is larger are wrong: undisturbed ones of this rig, of few columns and
#: small frames, have 0.04 to 0.13, by the room.
WRONG_SCAN = 0.15
#: Heights that a scan covers [m].
_BAND = (-0.15, 0.15)

Array = npt.NDArray[np.float64]


class Judge:
    """Compares results with the room of one seed."""

    def __init__(self, seed: int) -> None:
        self._room: Room = furnished_room(seed)
        self._camera = RoomCamera.from_field_of_view(WIDTH, HEIGHT, math.radians(FOV_DEG))
        self._frame = functools.lru_cache(2000)(self._render)
        self._frame(0)
        self._ranges = occupancy.true_ranges(self._room, _BAND, BEAMS)

    def _render(self, azimuth: int) -> npt.NDArray[np.uint8]:
        """Frame of an arm azimuth [0.01°]."""
        return self._room.render(math.radians(azimuth / 100), self._camera, ARM_RADIUS)

    def look(self, arm_azimuth: float) -> npt.NDArray[np.uint8]:
        """What the camera sees from an arm azimuth [rad], without noise, shape (H, W, 3)."""
        return self._frame(round(math.degrees(arm_azimuth) * 100) % 36000)

    def wrong_columns(self, image: Any, info: Any, *, in_any_light: bool) -> tuple[int, int]:
        """Return how many columns of a panorama are untrue, and how many unknown."""
        picture, geometry = to_array(image).astype(np.float64), panorama_geometry(info)
        seen = np.flatnonzero(geometry.seen)
        errors = []
        for x in seen:
            true = self._column(geometry, int(x))
            errors.append(_error(picture[:, x], true, in_any_light=in_any_light))
        return int(np.sum(np.array(errors) > WRONG_COLUMN)), geometry.columns - seen.size

    def _column(self, geometry: PanoramaGeometry, x: int) -> Array:
        """What the camera sees in a column, shape (H, 3)."""
        angle = float(geometry.ray_angle[x])
        azimuth = float(geometry.ray_azimuth(x)) - angle
        frame = self.look(azimuth).astype(np.float64)
        camera = self._camera
        half = math.pi / geometry.columns
        u, right, left = (
            camera.cx - camera.fx * math.tan(side) for side in (angle, angle - half, angle + half)
        )
        # The slope of a row of the panorama, of the camera's pixels along this ray.
        slope = geometry.slope(np.arange(geometry.rows))
        v = camera.cy - slope * camera.fy / math.cos(angle)
        return _mean_column(frame, u, right - left, v)

    def scan_error(self, scan: Any) -> float:
        """Median relative error of a scan's finite ranges; +inf for none."""
        try:
            return score_scan(np.array(scan.ranges, np.float64), self._ranges).median_error
        except ValueError:
            return math.inf


def _error(seen: Array, true: Array, *, in_any_light: bool) -> float:
    """Mean difference of a column's pixels, of one factor if the light may have changed."""
    if not in_any_light:
        return float(np.abs(seen - true).mean())
    compared = true < GLARING
    if not compared.any():
        return 0.0
    seen, true = seen[compared], true[compared]
    factor = (seen * true).sum() / max((true**2).sum(), 1.0)
    return float(np.abs(seen - factor * true).mean())


def _mean_column(image: Array, middle: float, width: float, rows: Array) -> Array:
    """Mean over a width of the image [px] around u, at rows v between which is interpolated."""
    pixel = np.arange(image.shape[1])
    low, high = middle - 0.5 * width, middle + 0.5 * width
    covered = np.clip(np.minimum(high, pixel + 0.5) - np.maximum(low, pixel - 0.5), 0.0, 1.0)
    column = np.einsum('vuc,u->vc', image, covered / covered.sum())
    row = np.arange(image.shape[0])
    return np.stack([np.interp(rows, row, colour) for colour in column.T], axis=-1)
