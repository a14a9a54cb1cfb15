"""Panorama pairs with known disparity, made without the code under test."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry import Panorama, PanoramaGeometry

Image = npt.NDArray[np.uint8]


def pair_of(
    left: Image,
    right: Image,
    candidates: int,
    *,
    left_seen: npt.NDArray[np.bool_] | None = None,
    right_seen: npt.NDArray[np.bool_] | None = None,
) -> tuple[Panorama, Panorama]:
    """Two images as a symmetric pair whose search range is 1 … candidates."""
    columns = left.shape[1]
    step = 2 * math.pi / columns
    angle = (candidates + 0.5) * step / 2

    def panorama(image: Image, sign: int, seen: npt.NDArray[np.bool_] | None) -> Panorama:
        ray_angle = np.full(image.shape[1], sign * angle)
        if seen is not None:
            ray_angle[~seen] = np.nan
        geometry = PanoramaGeometry(
            columns=image.shape[1],
            rows=image.shape[0],
            azimuth_column=columns / 2 + sign * angle / step,
            focal_length_px=250.0,
            principal_row=(image.shape[0] - 1) / 2,
            arm_radius=0.3,
            principal_angle=sign * angle,
            sweep_duration=0.0,
            ray_angle=ray_angle,
        )
        return Panorama(image, geometry)

    return panorama(left, -1, left_seen), panorama(right, 1, right_seen)


def noise_image(rng: np.random.Generator, rows: int, columns: int) -> Image:
    return rng.integers(0, 256, (rows, columns)).astype(np.uint8)


def texture(
    rng: np.random.Generator, rows: int, columns: int, *, wavelength: float = 6.0
) -> npt.NDArray[np.float64]:
    """
    Smooth periodic random signal on a grid 32 times finer along the rows.

    Nothing in it is shorter than ``wavelength`` columns; mean 128, standard deviation 40.
    """
    fine = 32
    highest = int(columns / wavelength)
    spectrum = np.zeros((rows, columns * fine // 2 + 1), complex)
    phases = rng.uniform(0, 2 * np.pi, (rows, highest))
    amplitudes = rng.rayleigh(1.0, (rows, highest))
    spectrum[:, 1 : highest + 1] = amplitudes * np.exp(1j * phases)
    signal = np.fft.irfft(spectrum, columns * fine, axis=1)
    kernel = np.array([1.0, 2.0, 1.0]) / 4  # rows resemble their neighbours, as in pictures
    signal = np.apply_along_axis(lambda column: np.convolve(column, kernel, 'same'), 0, signal)
    return 128 + 40 * (signal - signal.mean()) / signal.std()


def shifted_pair(
    signal: npt.NDArray[np.float64],
    disparity: npt.NDArray[np.float64],
    *,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> tuple[Image, Image]:
    """
    Left and right image with right(x + disparity(x)) = left(x).

    ``disparity`` is (H, W) and must vary so slowly that x + disparity(x) grows with x.
    """
    rows, columns = disparity.shape
    fine = signal.shape[1] // columns
    x = np.arange(columns)
    left = np.empty((rows, columns))
    positions = np.arange(signal.shape[1]) / fine
    for y in range(rows):
        left[y] = np.interp(x + disparity[y], positions, signal[y], period=columns)
    right = signal[:, ::fine].copy()
    if noise:
        assert rng is not None
        left += rng.normal(0, noise, left.shape)
        right += rng.normal(0, noise, right.shape)
    return (
        np.clip(np.rint(left), 0, 255).astype(np.uint8),
        np.clip(np.rint(right), 0, 255).astype(np.uint8),
    )
