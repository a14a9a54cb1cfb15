"""
Fit the confidence of the semi-global matching on simulated rooms and print its coefficients.

Every room is swept as seen by an ideal camera, with noise, contrast, brightness and colour drawn
at random; the exact distance comes from rays. Half of the rooms fit, the other half judge:
reliability is printed as the share of disparities right within one column against the
probability that was promised.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from panodepth_ros.camera.simulated.furnished import furnished_room
from panodepth_ros.camera.simulated.room import RoomCamera
from panodepth_ros.geometry import Panorama, PanoramaGeometry
from panodepth_ros.matching import confidence, fusion, semiglobal
from panodepth_ros.matching.colour_pair import colour_pair
from panodepth_ros.matching.evaluation import block_of, evidence
from panodepth_ros.matching.rough import rough_match

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

COLUMNS, ROWS = 1800, 120
WIDTH, FIELD_OF_VIEW = 160, math.radians(34.0)
ARM_RADIUS = 0.3
#: Columns of further panoramas, as shares of the pair's distance from the middle.
FURTHER_SHARES = (1 / 6, 1 / 2, 5 / 6)


def swept(seed: int, pixels: list[int]) -> tuple[list[Image], Array, list[float]]:
    """Panoramas of pixel columns, true column disparity (H, W) of the first two, ray angles."""
    room = furnished_room(seed)
    camera = RoomCamera.from_field_of_view(WIDTH, ROWS, FIELD_OF_VIEW)
    angles = [-math.atan((pixel - camera.cx) / camera.fx) for pixel in pixels]
    angle = angles[1]
    step = 2 * math.pi / COLUMNS
    azimuths = -step * np.arange(COLUMNS)
    images = []
    for column in pixels:
        slit = RoomCamera(
            width=1, height=ROWS, fx=camera.fx, fy=camera.fy, cx=camera.cx - column, cy=camera.cy
        )
        columns = [room.render(float(a), slit, ARM_RADIUS)[:, 0] for a in azimuths]
        images.append(np.stack(columns, axis=1))
    heading = azimuths - angle
    slope = (camera.cy - np.arange(ROWS)) * math.cos(angle) / camera.fy
    origins = np.zeros((ROWS, COLUMNS, 3))
    origins[..., 0] = ARM_RADIUS * np.cos(azimuths)
    origins[..., 1] = ARM_RADIUS * np.sin(azimuths)
    rays = np.stack(
        np.broadcast_arrays(np.cos(heading), np.sin(heading), slope[:, np.newaxis]), axis=-1
    )
    lengths = room.cast(origins.reshape(-1, 3), rays.reshape(-1, 3)).reshape(ROWS, COLUMNS)
    points = origins + lengths[..., np.newaxis] * rays
    distance = np.hypot(points[..., 0], points[..., 1])
    # eq. 2 solved for θ, eq. 4
    half_turn = angle - np.arcsin(ARM_RADIUS * math.sin(angle) / distance)
    return images, 2 * half_turn / step, angles


def photographed(image: Image, look: dict[str, float], rng: np.random.Generator) -> Image:
    """The image with less contrast, another exposure and noise."""
    levels = 128 + look['contrast'] * (image.astype(np.float64) - 128)
    levels = look['gain'] * levels + rng.normal(0, look['noise'], image.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def panorama(image: Image, angle: float) -> Panorama:
    """Panorama of the rig that ``swept`` has."""
    step = 2 * math.pi / COLUMNS
    geometry = PanoramaGeometry(
        columns=COLUMNS,
        rows=ROWS,
        azimuth_column=angle / step,
        focal_length_px=0.5 * WIDTH / math.tan(0.5 * FIELD_OF_VIEW) / math.cos(angle),
        principal_row=0.5 * (ROWS - 1),
        arm_radius=ARM_RADIUS,
        principal_angle=angle,
        sweep_duration=0.0,
        ray_angle=np.full(COLUMNS, angle),
    )
    return Panorama(image, geometry)


def samples(
    seed: int, pool: ThreadPoolExecutor, *, further: bool
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Features (M, len(FEATURES)) of every fifth pixel of a room, and whether it was right."""
    rng = np.random.default_rng(seed)
    pixel = int(rng.choice([110, 130, 150]))
    middle = (WIDTH - 1) / 2
    offsets = [share * (pixel - middle) for share in FURTHER_SHARES] if further else []
    others = [round(middle + sign * offset) for offset in offsets for sign in (-1, 1)]
    images, truth, angles = swept(seed, [pixel, WIDTH - 1 - pixel, *others])
    photo = {
        'noise': float(rng.uniform(0.5, 4.0)),
        'contrast': float(rng.uniform(0.4, 1.0)),
        'gain': 1.0,
    }
    images[0] = photographed(images[0], photo, rng)
    photo['gain'] = float(rng.choice([1.0, 1.0, 1.06]))
    images[1] = photographed(images[1], photo, rng)
    grey = rng.random() < 0.3
    images[2:] = [photographed(image, photo, rng) for image in images[2:]]
    if grey:
        images = [np.repeat(image[..., 1:2], 3, axis=2) for image in images]
    left, right, *more = [
        panorama(image, angle) for image, angle in zip(images, angles, strict=True)
    ]
    if further:
        pair, views = fusion.look(left, right, more, pool)
        winners = fusion.aggregate_views(pair, views, semiglobal.noise_of(pair), pool)
        locate = fusion.locator(views)
        disparity, _ = fusion.refine_views(pair, views, winners, pool)
    else:
        pair = colour_pair(left, right)
        look = semiglobal.Look.of(pair, rough_match(pair, pool))
        pair, work = look.equalised(pair), semiglobal.Work.none(*pair.left_grey.shape)
        disparity, _ = semiglobal.complete(pair, look.noise, work, pool)
        winners, locate = work.winners, None
    block = block_of(pair, winners, 0, truth.shape[1])
    values, _, _ = evidence(block, 0, ROWS, locate)
    right_one = np.abs(disparity - truth) <= 1
    columns = [value.ravel()[::5].astype(np.float64) for value in values]
    return np.column_stack([*columns, np.ones_like(columns[0])]), right_one.ravel()[::5]


def fitted(features: Array, right: npt.NDArray[np.bool_]) -> Array:
    """Coefficients of the logistic regression, by iteratively reweighted least squares."""
    coefficients = np.zeros(features.shape[1])
    ridge = 1e-3 * np.eye(coefficients.size)
    for _ in range(20):
        promised = 1 / (1 + np.exp(-features @ coefficients))
        weights = promised * (1 - promised) + 1e-9
        gradient = features.T @ (right - promised) - ridge @ coefficients
        coefficients += np.linalg.solve(
            (features * weights[:, np.newaxis]).T @ features + ridge, gradient
        )
    return coefficients


def main() -> None:
    """Fit, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rooms', type=int, default=24, help='number of rooms')
    parser.add_argument('--first-seed', type=int, default=100, help='seed of the first room')
    parser.add_argument(
        '--further', action='store_true', help='with further panoramas: fit those of fusion'
    )
    arguments = parser.parse_args()
    found = []
    with ThreadPoolExecutor(2) as pool:
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.rooms):
            found.append(samples(seed, pool, further=arguments.further))
            print(f'room {seed}: {found[-1][1].mean():.3f} right')
    coefficients = fitted(
        np.concatenate([f for f, _ in found[::2]]), np.concatenate([r for _, r in found[::2]])
    )
    for name, value in zip(confidence.FEATURES, coefficients, strict=True):
        print(f'{value:9.4f}  {name}')
    features = np.concatenate([f for f, _ in found[1::2]])
    right = np.concatenate([r for _, r in found[1::2]])
    promised = 1 / (1 + np.exp(-features @ coefficients))
    limits = [0.0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0]
    for low, high in pairwise(limits):
        inside = (promised >= low) & (promised <= high)
        print(
            f'promised {low:.2f} to {high:.2f}: mean {promised[inside].mean():.3f}, '
            f'right {right[inside].mean():.3f}, share {inside.mean():.3f}'
        )


if __name__ == '__main__':
    main()
