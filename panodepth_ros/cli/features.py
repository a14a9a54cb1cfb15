"""
Features of a scene, measured by hand, against a sweep (Fig. 7).

A YAML file holds a list ``features``. Each has one of

* ``azimuth_deg`` and ``distance``: azimuth from the axis, counter-clockwise from x [degrees],
  and horizontal distance from the axis [m];
* ``position``: ``[x, y]`` in the scan frame [m], instead of both;
* ``pixel`` and ``distance``: ``[column, row]`` of the left panorama.

and may have a ``name``. The first two are compared with the ground plan, a pixel with the depth
panorama.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from panodepth_ros.geometry import Points

Array = npt.NDArray[np.float64]

#: A point of the ground plan is that of a feature if its azimuth differs by no more than this.
NEARBY = math.radians(1.0)
#: A pixel's estimate is the median of the known distances within this many pixels.
PIXELS = 1
#: No such file of a person's is longer [bytes].
_LARGEST_FILE = 1_000_000
_KEYS = ('name', 'azimuth_deg', 'position', 'pixel', 'distance')


class FeaturesError(ValueError):
    """A file of features is wrong; the sentence names the file and the feature."""


@dataclass(frozen=True, slots=True)
class Feature:
    """
    One measured feature.

    Attributes
    ----------
    name : str
        For the table; may be empty.
    distance : float
        Measured horizontal distance from the axis [m].
    azimuth : float
        From the axis [rad]; NaN if ``pixel`` says where.
    pixel : (int, int) or None
        Column and row of the left panorama.
    """

    name: str
    distance: float
    azimuth: float = math.nan
    pixel: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """
    A feature beside what the sweep says.

    Attributes
    ----------
    feature : Feature
    azimuth : float
        Where it is in the ground plan [rad]; NaN for a pixel without a known distance.
    estimated : float
        Distance [m], NaN if the sweep knows none there.
    """

    feature: Feature
    azimuth: float
    estimated: float

    @property
    def error(self) -> float:
        """Return estimated minus measured distance [m]."""
        return self.estimated - self.feature.distance


def load_features(path: Path) -> list[Feature]:
    """
    Read a file of features.

    Raises
    ------
    FeaturesError
        If it cannot be read or does not have the form above.
    """
    try:
        with path.open('rb') as file:
            text = file.read(_LARGEST_FILE + 1)
        if len(text) > _LARGEST_FILE:
            raise FeaturesError(f'features {path} is longer than {_LARGEST_FILE} bytes')
        content = yaml.safe_load(text)
    except OSError as error:
        raise FeaturesError(f'features {path} cannot be read: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = ' '.join(str(error).split())
        raise FeaturesError(f'features {path} is no YAML: {reason}') from error
    entries = content.get('features') if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries:
        raise FeaturesError(f'features {path} has no list "features" with at least one entry')
    return [_feature(entry, f'feature {k} of {path}') for k, entry in enumerate(entries, 1)]


def _feature(entry: Any, what: str) -> Feature:
    if not isinstance(entry, dict):
        raise FeaturesError(f'{what} is {entry!r}; allowed: keys {", ".join(_KEYS)}')
    if unknown := sorted(map(str, set(entry) - set(_KEYS))):
        raise FeaturesError(f'{what} has {", ".join(unknown)}; allowed: {", ".join(_KEYS)}')
    places = [key for key in ('azimuth_deg', 'position', 'pixel') if key in entry]
    if len(places) != 1:
        raise FeaturesError(
            f'{what} has {" and ".join(places) or "no place"}; '
            'allowed: one of azimuth_deg, position, pixel'
        )
    name = str(entry.get('name', ''))
    if places == ['position']:
        if 'distance' in entry:
            raise FeaturesError(f'{what} has position and distance; allowed: one of them')
        x, y = _numbers(entry['position'], 2, f'position of {what}')
        return Feature(name, _positive(math.hypot(x, y), what), math.atan2(y, x))
    if 'distance' not in entry:
        raise FeaturesError(f'{what} has no distance [m]')
    (distance,) = _numbers([entry['distance']], 1, f'distance of {what}')
    distance = _positive(distance, what)
    if places == ['azimuth_deg']:
        (azimuth,) = _numbers([entry['azimuth_deg']], 1, f'azimuth_deg of {what}')
        return Feature(name, distance, math.radians(azimuth))
    column, row = _numbers(entry['pixel'], 2, f'pixel of {what}')
    if column != int(column) or row != int(row):
        raise FeaturesError(f'pixel of {what} is {entry["pixel"]}; allowed: whole numbers')
    return Feature(name, distance, pixel=(int(column), int(row)))


def _numbers(values: Any, count: int, what: str) -> list[float]:
    if (
        not isinstance(values, list)
        or len(values) != count
        or not all(type(value) in (int, float) and math.isfinite(value) for value in values)
    ):
        shown = values[0] if count == 1 and isinstance(values, list) else values
        raise FeaturesError(
            f'{what} is {shown!r}; allowed: {"a finite number" if count == 1 else "two numbers"}'
        )
    return [float(value) for value in values]


def _positive(distance: float, what: str) -> float:
    if distance <= 0:
        raise FeaturesError(f'distance of {what} is {distance:g} m; allowed: above 0')
    return distance


def compare(
    features: Sequence[Feature], points: Points, plan_azimuth: Array, plan_distance: Array
) -> list[Comparison]:
    """
    Compare features with a sweep.

    Parameters
    ----------
    features : sequence of Feature
    points : Points
        Of the left panorama's pixels, shape (H, W), for features given by a pixel.
    plan_azimuth, plan_distance : ndarray of float64, shape (M,)
        Ground plan, for the others [rad], [m]; finite.

    Returns
    -------
    list of Comparison
        In the same order.

    Raises
    ------
    FeaturesError
        If a pixel lies outside of the panorama.
    """
    return [
        _at_pixel(feature, feature.pixel, points)
        if feature.pixel is not None
        else _in_plan(feature, plan_azimuth, plan_distance)
        for feature in features
    ]


def _in_plan(feature: Feature, azimuth: Array, distance: Array) -> Comparison:
    off = np.abs((azimuth - feature.azimuth + np.pi) % (2 * np.pi) - np.pi)
    nearest = int(np.argmin(off)) if off.size else -1
    found = distance[nearest] if nearest >= 0 and off[nearest] <= NEARBY else math.nan
    return Comparison(feature, feature.azimuth, float(found))


def _at_pixel(feature: Feature, pixel: tuple[int, int], points: Points) -> Comparison:
    rows, columns = points.radial_distance.shape
    column, row = pixel
    if not (0 <= column < columns and 0 <= row < rows):
        raise FeaturesError(
            f'pixel of a feature is [{column}, {row}]; allowed: [0, 0] to '
            f'[{columns - 1}, {rows - 1}], column and row of the left panorama'
        )
    beside = np.arange(column - PIXELS, column + PIXELS + 1) % columns
    window = np.ix_(np.arange(max(0, row - PIXELS), min(rows, row + PIXELS + 1)), beside)
    distance, azimuth = points.radial_distance[window], points.azimuth[window]
    known = np.isfinite(distance)
    if not known.any():
        return Comparison(feature, math.nan, math.nan)
    middle = float(np.median(distance[known]))
    at = int(np.argmin(np.abs(distance[known] - middle)))
    return Comparison(feature, float(azimuth[known][at]), middle)


def table(comparisons: Sequence[Comparison]) -> str:
    """Write measured, estimated and error, feature by feature, and the median error."""
    lines = [f'{"":>3} {"feature":<32}{"measured":>10}{"estimated":>11}{"error":>10}']
    for number, item in enumerate(comparisons, 1):
        place = item.feature.name or 'feature'
        measured = f'{number:>3} {place:<32.32}{item.feature.distance:>8.3f} m'
        if math.isnan(item.estimated):
            lines.append(f'{measured}    unknown')
            continue
        share = item.error / item.feature.distance
        lines.append(f'{measured}{item.estimated:>9.3f} m{item.error:>+8.3f} m{share:>+8.1%}')
    shares = [abs(item.error) / item.feature.distance for item in comparisons]
    known = [value for value in shares if not math.isnan(value)]
    if known:
        lines.append(
            f'median error {np.median(known):.1%}, largest {max(known):.1%}, '
            f'{len(known)} of {len(comparisons)} features found'
        )
    return '\n'.join(lines)
