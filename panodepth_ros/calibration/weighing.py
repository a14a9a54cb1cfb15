"""
What a sweep tells of its camera, weighed against what was given.

A fit takes all errors for white noise, and so the sweep for several times as sure as it is; what
was given beside it would hardly count. Points of one wall are misjudged alike, for it is seen at a
like slant; and what the lens model lacks displaces all that is seen in the same columns alike.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Errors of points of one such sector may depend on each other [rad].
_SECTOR = math.radians(30.0)
#: The sum of all is 0 where the fit ends, so that few sectors would tell nothing.
_FEWEST_SECTORS = 6
#: Errors of sightings in one of so many stripes of the image may depend on each other; what is
#: fitted takes this many of them away: place, slope and bend of the paths, k1, fx.
_STRIPES, _FITTED = 16, 6


def spread_of(
    information: Array, by_track: Array, by_sighting: Array, azimuth: Array, column: Array
) -> Array:
    """
    Covariance of the fit's gradient with errors shared within sectors and within stripes.

    Both are taken from the residuals, as sums over such groups (Cameron, Gelbach, Miller 2011: the
    groups' covariances added, less what both have in common).

    Parameters
    ----------
    information : ndarray of float64, shape (G, G)
        The same covariance, were all errors white noise.
    by_track : ndarray of float64, shape (T, G)
        Each point's share of the gradient.
    by_sighting : ndarray of float64, shape (T, K, G)
        Each sighting's share; 0 where a point is not seen.
    azimuth : ndarray of float64, shape (T,)
        Where each point was seen from [rad].
    column : ndarray of float64, shape (T, K)
        Where in the image, as share of its width; any number where a point is not seen.

    Returns
    -------
    ndarray of float64, shape (G, G)
    """
    count = max(_FEWEST_SECTORS, round(float(np.ptp(azimuth)) / _SECTOR))
    edges = np.linspace(azimuth.min(), azimuth.max(), count + 1)[1:-1]
    by_sector = _summed(by_track, np.searchsorted(edges, azimuth), count)
    stripe = np.clip(column.ravel() * _STRIPES, 0, _STRIPES - 1).astype(np.int64)
    by_stripe = _summed(by_sighting.reshape(stripe.size, -1), stripe, _STRIPES)
    # White noise is in both, and counts once.
    return np.asarray(
        by_sector.T @ by_sector * (count / (count - 1))
        + by_stripe.T @ by_stripe * (_STRIPES / (_STRIPES - _FITTED))
        - information
    )


def weigh(
    information: Array, spread: Array, gradient: Array, weak: Array, total: Array
) -> tuple[Array, Array]:
    """
    Best estimate of what the sweep tells and what was given, each with its own covariance.

    Few groups may agree by chance: in no direction the sweep is taken for surer than white noise
    of the residuals allows.

    Parameters
    ----------
    information : ndarray of float64, shape (G, G)
        Second derivative of the fit's cost without what was given.
    spread : ndarray of float64, shape (G, G)
        Covariance of its gradient.
    gradient : ndarray of float64, shape (G,)
        That gradient at ``total``.
    weak : ndarray of float64, shape (G,)
        Inverse variances of what was given; 0 where nothing was.
    total : ndarray of float64, shape (G,)
        Where the fit ended, from what was given.

    Returns
    -------
    ndarray of float64, shape (G,)
        The unknowns, from what was given.
    ndarray of float64, shape (G, G)
        Their covariance.
    """
    given = np.diag(weak)
    # With what was given, all directions are known and the root exists.
    root = np.linalg.cholesky(information + given)
    whitened = np.linalg.solve(root, np.linalg.solve(root, spread + given).T)
    size, axes = np.linalg.eigh(whitened)
    turned = root @ axes
    spread = (turned * np.maximum(size, 1.0)) @ turned.T - given
    # The sweep alone says information·θ = reached, and is wrong by ``spread`` in that.
    reached = information @ total - gradient
    weight = information @ np.linalg.solve(spread, np.column_stack([information, reached]))
    covariance = np.linalg.inv(weight[:, :-1] + given)
    return np.asarray(covariance @ weight[:, -1]), np.asarray(covariance)


def _summed(values: Array, group: npt.NDArray[np.int64], count: int) -> Array:
    """Sums over groups, shape (count, G), of values of shape (…, G), about their mean."""
    summed = np.zeros((count, values.shape[-1]))
    np.add.at(summed, group, values)
    return np.asarray(summed - summed.mean(axis=0))
