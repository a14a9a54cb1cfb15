"""What textures are painted with: noise, grain, bricks, motifs that continue beyond the edges."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
Plane = npt.NDArray[np.float32]
Colour = tuple[float, float, float]
Generator = np.random.Generator


def noise(rng: Generator, size: int, longest: float, shortest: float, slope: float = 1.0) -> Plane:
    """
    Seamless band-limited noise.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    size : int
        Edge [px].
    longest, shortest : float
        Wavelengths that limit the band [px].
    slope : float
        Amplitude falls with frequency to this power.

    Returns
    -------
    ndarray of float32, shape (size, size)
        Mean 0, standard deviation 1.
    """
    fy = np.fft.fftfreq(size)[:, None]
    fx = np.fft.rfftfreq(size)[None, :]
    fx = fx[fx <= 1.0 / shortest][None, :]  # nothing of the band lies beyond
    f = np.hypot(fx, fy)
    f[0, 0] = np.inf
    weight = f**-slope * (f >= 1.0 / longest) * (f <= 1.0 / shortest)
    rows = np.fft.rfft(rng.standard_normal((size, size)), axis=1)[:, : fx.size]
    spectrum = np.fft.fft(rows, axis=0) * weight
    plane = np.fft.irfft(np.fft.ifft(spectrum, axis=0), size, axis=1)
    scaled: Plane = (plane / plane.std()).astype(np.float32)
    return scaled


def painted(colour: Colour, *layers: npt.NDArray[np.floating]) -> Plane:
    """One colour whose brightness varies by the sum of the layers [grey levels]."""
    total: Plane = np.sum(layers, axis=0, dtype=np.float32)
    painted: Plane = total[..., None] + np.asarray(colour, np.float32)
    return painted


def finish(plane: Plane) -> Picture:
    """Round to grey levels, same shape; what is out of range is cut off."""
    return np.ascontiguousarray(np.clip(plane, 0, 255).round(), np.uint8)


def copies(x: float, y: float, size: int) -> Iterator[tuple[int, int]]:
    """Places where a motif must be drawn so that it continues beyond the edges."""
    for dy in (-size, 0, size):
        for dx in (-size, 0, size):
            yield round(x + dx), round(y + dy)


def cells(
    size: int, columns: int, rows: int, shift: float
) -> tuple[Plane, Plane, npt.NDArray[np.int64]]:
    """Bricks: distances to vertical and horizontal joints [px], and each brick's number."""
    y, x = np.mgrid[0:size, 0:size].astype(np.float32) + np.float32(0.5)
    tall, wide = size / rows, size / columns
    row = np.floor(y / tall)
    x = np.mod(x + shift * wide * np.mod(row, 2), size)
    column = np.floor(x / wide)
    in_x, in_y = x - column * wide, y - row * tall
    number = (row * columns + column).astype(np.int64)
    return np.minimum(in_x, wide - in_x), np.minimum(in_y, tall - in_y), number


def wood_grain(rng: Generator, size: int, stretch: int) -> Plane:
    """Wood grain along the rows of the array: noise compressed across and stretched along."""
    fine = noise(rng, size, 40, 3, 0.6)
    rows = np.fft.rfft(fine, axis=1)
    rows *= np.exp(-((np.arange(rows.shape[1]) * stretch / 60.0) ** 2))
    plane = np.fft.irfft(rows, n=size, axis=1)
    scaled: Plane = (plane / plane.std()).astype(np.float32)
    return scaled
