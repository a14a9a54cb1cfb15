"""Pairs of panoramas with truth: rendered rooms from files, the product's own, a synthetic one."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated import RoomCamera, furnished_room, truth_panorama
from panodepth_ros.geometry import Panorama, PanoramaGeometry

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

#: Columns of a frame that further panoramas are made of: shares of the pair's distance from the
#: principal point, on both sides.
FURTHER_SHARES = (1 / 6, 1 / 2, 5 / 6)
#: Sensor noise added to pictures made here, as in the rendered rooms [grey levels].
NOISE = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """
    Truth of one eye's panorama, H × W each.

    Attributes
    ----------
    geometry : PanoramaGeometry
    distance, height : ndarray of float64
        True radial distance and height of each pixel [m].
    visible : ndarray of bool
        Whether the other eye sees the point, too.
    """

    geometry: PanoramaGeometry
    distance: Array
    height: Array
    visible: npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """
    A pair with truth.

    Attributes
    ----------
    name : str
    left, right : Panorama
        The symmetric pair, H × W.
    further : sequence of Panorama
        What else the same sweep gives.
    disparity : ndarray of float64, shape (H, W)
        True dx of each pixel of the left panorama [columns].
    views : sequence of View
        Truth of the left panorama, and of the right one if it is known.
    """

    name: str
    left: Panorama
    right: Panorama
    further: Sequence[Panorama]
    disparity: Array
    views: Sequence[View]


def rendered_room(folder: Path) -> Scene:
    """
    Room from a data folder: ``meta.json``, ``angles.npy``, ``mosaics.npz``, ``gt_pano.npz``.

    Column k of the files is frame k, azimuth grows with k; panoramas run clockwise, so all is
    mirrored. Folders with ``frames.mkv`` also give further panoramas.
    """
    meta = json.loads((folder / 'meta.json').read_text())
    angles = np.load(folder / 'angles.npy')
    mosaics = np.load(folder / 'mosaics.npz')
    truth = np.load(folder / 'gt_pano.npz')
    angle = math.atan(meta['sym_offset_px'] / meta['fx'])
    step = 2 * math.pi / meta['N']
    last_azimuth = angles[0] + (meta['N'] - 1) * step  # of the arm, at column 0

    def panorama(image: Image, ray_angle: float) -> Panorama:
        geometry = PanoramaGeometry(
            columns=meta['N'],
            rows=meta['H'],
            azimuth_column=(last_azimuth + ray_angle) / step,
            focal_length_px=meta['fy'] / math.cos(ray_angle),
            principal_row=meta['cy'],
            arm_radius=meta['r'],
            principal_angle=ray_angle,
            sweep_duration=0.0,
            ray_angle=np.full(meta['N'], ray_angle),
        )
        return Panorama(np.ascontiguousarray(image[:, ::-1, ::-1]), geometry)

    further = []
    if (folder / 'frames.mkv').exists():
        columns = further_columns(meta['cx'], meta['sym_offset_px'])
        images = _columns_of_video(folder / 'frames.mkv', columns)
        for column, image in zip(columns, images, strict=True):
            further.append(panorama(image, -math.atan((column - meta['cx']) / meta['fx'])))
    disparity = (angles[np.newaxis, :] - truth['left_gamma_other'].astype(np.float64)) / step
    disparity = (disparity + meta['N'] / 2) % meta['N'] - meta['N'] / 2
    eyes = {'left': panorama(mosaics['left'], -angle), 'right': panorama(mosaics['right'], angle)}
    views = [
        View(
            geometry=eye.geometry,
            distance=truth[f'{name}_l'][:, ::-1].astype(np.float64),
            height=truth[f'{name}_z'][:, ::-1].astype(np.float64),
            visible=~truth[f'{name}_occl'][:, ::-1],
        )
        for name, eye in eyes.items()
    ]
    return Scene(
        name=folder.name,
        left=eyes['left'],
        right=eyes['right'],
        further=further,
        disparity=disparity[:, ::-1],
        views=views,
    )


def further_columns(principal_column: float, pair_offset: float) -> list[int]:
    """Columns of a frame for further panoramas, from left to right."""
    offsets = [share * pair_offset for share in FURTHER_SHARES]
    return sorted(
        round(principal_column + sign * offset) for offset in offsets for sign in (-1, 1)
    )


def _columns_of_video(file: Path, columns: Sequence[int]) -> list[Image]:
    """For each column its mosaic (H, N, 3) in red, green, blue; frame k is column k."""
    video = cv2.VideoCapture(str(file))
    taken: list[Image] = []
    while True:
        more, frame = video.read()
        if not more:
            break
        taken.append(frame[:, columns, ::-1])
    return [np.stack([frame[:, k] for frame in taken], axis=1) for k in range(len(columns))]


def own_room(
    seed: int,
    *,
    columns: int = 1800,
    further: bool = True,
    rows: int = 120,
    right_column: int = 150,
    noise: float = NOISE,
    contrast: float = 1.0,
) -> Scene:
    """Furnished room of the demo, r = 0.3 m, seen by two columns of 160 at 34°."""
    rng = np.random.default_rng(seed)
    room = furnished_room(seed)
    camera = RoomCamera.from_field_of_view(160, rows, math.radians(34.0))
    radius, step = 0.3, 2 * math.pi / columns
    arm_azimuth = math.pi - np.arange(columns) * step  # columns run clockwise

    def panorama(column: int) -> Panorama:
        ray_angle = -math.atan((column - camera.cx) / camera.fx)
        image = np.concatenate(
            [room.render(azimuth, camera.column(column), radius) for azimuth in arm_azimuth],
            axis=1,
        )
        geometry = PanoramaGeometry(
            columns=columns,
            rows=camera.height,
            azimuth_column=(math.pi + ray_angle) / step,
            focal_length_px=camera.fy / math.cos(ray_angle),
            principal_row=camera.cy,
            arm_radius=radius,
            principal_angle=ray_angle,
            sweep_duration=0.0,
            ray_angle=np.full(columns, ray_angle),
        )
        return Panorama(_noisy(128 + contrast * (image - 128.0), rng, noise), geometry)

    def view(geometry: PanoramaGeometry) -> View:
        truth = truth_panorama(
            room,
            arm_radius=radius,
            ray_angle=geometry.principal_angle,
            ray_azimuth=geometry.ray_azimuth(np.arange(columns)),
            slope=geometry.slope(np.arange(camera.height)),
        )
        return View(geometry, truth.radial_distance, truth.height, ~truth.occluded)

    left, right = panorama(right_column), panorama(159 - right_column)
    more = further_columns(camera.cx, right_column - camera.cx) if further else []
    views = [view(left.geometry), view(right.geometry)]
    angle = right.geometry.principal_angle
    theta = angle - np.arcsin(radius * math.sin(angle) / views[0].distance)
    return Scene(
        name=f'furnished room {seed}',
        left=left,
        right=right,
        further=[panorama(column) for column in more],
        disparity=2 * theta / step,
        views=views,
    )


def varied_room(seed: int) -> Scene:
    """Furnished room whose rows, eyes, noise and contrast are drawn by its seed, too."""
    rng = np.random.default_rng([seed, 1])
    return own_room(
        seed,
        further=False,
        rows=int(rng.choice([60, 120, 240])),
        right_column=int(rng.choice([110, 130, 150])),
        noise=float(rng.choice([0.5, 1.5, 3.0, 5.0])),
        contrast=float(rng.choice([0.6, 1.0])),
    )


def weak_texture(seed: int = 0, *, rows: int = 120, columns: int = 1800) -> Scene:
    """
    Walls of little contrast behind boxes of more, on a symmetric pair with 149 candidates.

    The wall's standard deviation runs from 1 to 12 grey levels and back around the turn, its
    disparity follows a rectangular room of 4.4 m × 3.4 m; 24 boxes stand before it at 0.7 to
    1.6 m. Textures lie on the right panorama and the left one samples them between columns, so
    the truth is exact.
    """
    rng = np.random.default_rng(seed)
    angle, step, radius = math.radians(29.9625 / 2), 2 * math.pi / columns, 0.3

    def disparity_of(distance: Array) -> Array:
        return 2 * (angle - np.arcsin(radius * math.sin(angle) / distance)) / step

    x = np.arange(columns)
    azimuth = (columns / 2 - x) * step
    wall = disparity_of(
        np.minimum(2.2 / np.abs(np.cos(azimuth)), 1.7 / np.maximum(np.abs(np.sin(azimuth)), 1e-9))
    )
    texture = _Texture(rng, rows, columns)

    def wall_at(column: Array) -> Array:
        contrast = 1 + 5.5 * (1 - np.cos(2 * np.pi * column / columns))
        return 128 + contrast * texture.at(column)

    left, right = wall_at(x + wall), wall_at(x.astype(np.float64))
    disparity = np.tile(wall, (rows, 1))
    shown_left, shown_right = (np.full((rows, columns), -1) for _ in range(2))
    for number, distance in enumerate(np.linspace(1.6, 0.7, 24)):  # the near ones cover the far
        top = int(rng.integers(0, rows - 30))
        height = min(int(rng.integers(20, 60)), rows - top)
        first, width = int(rng.integers(0, columns)), int(rng.integers(8, 80))
        dx = float(disparity_of(np.array(distance)))
        surface = _Texture(rng, height, columns)
        box = np.arange(first, first + width)
        on_right = np.arange(math.ceil(first + dx), math.floor(first + width - 1 + dx) + 1)
        band = slice(top, top + height)
        left[band, box % columns] = 128 + 20 * surface.at(box.astype(np.float64) + dx)
        right[band, on_right % columns] = 128 + 20 * surface.at(on_right.astype(np.float64))
        disparity[band, box % columns] = dx
        shown_left[band, box % columns] = shown_right[band, on_right % columns] = number
    target = np.rint(x + disparity).astype(np.int64) % columns
    distance = radius * math.sin(angle) / np.sin(angle - disparity * step / 2)

    def panorama(image: Array, sign: int) -> Panorama:
        geometry = PanoramaGeometry(
            columns=columns,
            rows=rows,
            azimuth_column=columns / 2 + sign * angle / step,
            focal_length_px=262.0,
            principal_row=(rows - 1) / 2,
            arm_radius=radius,
            principal_angle=sign * angle,
            sweep_duration=0.0,
            ray_angle=np.full(columns, sign * angle),
        )
        return Panorama(_noisy(image, rng), geometry)

    left_eye, right_eye = panorama(left, -1), panorama(right, 1)
    from_camera = np.sqrt(distance**2 - (radius * math.sin(angle)) ** 2) - radius * math.cos(angle)
    truth = View(
        geometry=left_eye.geometry,
        distance=distance,
        height=from_camera * left_eye.geometry.slope(np.arange(rows))[:, np.newaxis],
        visible=np.take_along_axis(shown_right, target, axis=1) == shown_left,
    )
    return Scene('weak texture', left_eye, right_eye, (), disparity, [truth])


def noise_pair(rows: int, columns: int, candidates: int) -> tuple[Panorama, Panorama]:
    """
    Pair of any size with that many candidates, for times and memory; true dx is half of it.

    Smooth noise, of which one pixel in twelve is a vertical edge, as in the rendered rooms.
    """
    rng = np.random.default_rng(0)
    step = 2 * math.pi / columns
    angle = (candidates + 0.5) * step / 2
    smooth = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), 2.0)
    right = np.clip(128 + 40 * smooth / smooth.std(), 0, 255)
    left = np.roll(right, -(candidates // 2), axis=1)

    def panorama(image: Array, sign: int) -> Panorama:
        geometry = PanoramaGeometry(
            columns=columns,
            rows=rows,
            azimuth_column=columns / 2 + sign * angle / step,
            focal_length_px=1000.0,
            principal_row=(rows - 1) / 2,
            arm_radius=0.3,
            principal_angle=sign * angle,
            sweep_duration=0.0,
            ray_angle=np.full(columns, sign * angle),
        )
        return Panorama(_noisy(image, rng), geometry)

    return panorama(left, -1), panorama(right, 1)


def noise_further(left: Panorama, right: Panorama) -> list[Panorama]:
    """What the sweep of a ``noise_pair`` gives besides, for times and memory."""
    eye = right.geometry
    radius, step = eye.arm_radius, eye.column_step
    candidates = int(2 * eye.principal_angle / step)
    delta = 2 * eye.principal_angle - candidates // 2 * step
    distance = radius * math.sin(eye.principal_angle) / math.sin(delta / 2)  # eq. 2
    further = []
    for share in sorted(sign * share for share in FURTHER_SHARES for sign in (-1, 1)):
        angle = share * eye.principal_angle
        lead = math.asin(radius * math.sin(angle) / distance) + delta / 2
        azimuth_column = eye.columns / 2 + angle / step
        shift = azimuth_column - left.geometry.azimuth_column - lead / step
        geometry = replace(
            eye,
            azimuth_column=azimuth_column,
            principal_angle=angle,
            ray_angle=np.full(eye.columns, angle),
        )
        further.append(Panorama(np.roll(left.image, round(shift), axis=1), geometry))
    return further


class _Texture:
    """Periodic random signal of unit variance without wavelengths below 5 columns."""

    fine = 16

    def __init__(self, rng: np.random.Generator, rows: int, columns: int) -> None:
        highest = columns // 5
        spectrum = np.zeros((rows, columns * self.fine // 2 + 1), np.complex128)
        spectrum[:, 1 : highest + 1] = rng.normal(size=(rows, highest, 2)) @ np.array([1, 1j])
        # Neighbouring rows resemble each other, as they do in pictures.
        spectrum[1:] += spectrum[:-1].copy()
        signal = np.fft.irfft(spectrum, columns * self.fine, axis=1)
        self._signal = signal / signal.std()

    def at(self, columns: Array) -> Array:
        """Values at real columns, shape (rows, len(columns)), linear on a 16 times finer grid."""
        position = columns * self.fine
        below = np.floor(position).astype(np.int64)
        share = position - below
        size = self._signal.shape[1]
        lower, upper = self._signal[:, below % size], self._signal[:, (below + 1) % size]
        return np.asarray(lower + share * (upper - lower))


def _noisy(image: npt.NDArray[Any], rng: np.random.Generator, noise: float = NOISE) -> Image:
    noisy = np.rint(image + rng.normal(0, noise, image.shape))
    return np.clip(noisy, 0, 255).astype(np.uint8)
