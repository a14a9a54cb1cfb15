"""
Whether an arm that was out of sight still counts its azimuth as before.

While nobody hears of the arm, its controller may lose its count; then every azimuth that it tells
is another one than before, and a sweep that goes on is wrong. What can be known is where the arm
may have gone meanwhile, and that a controller which has lost its count begins again at 0.
"""

from __future__ import annotations

import math


def doubt(
    azimuth: float, between: tuple[float, float], tolerance: float, *, restarted: bool
) -> str:
    """
    Why an arm that is heard of again may count otherwise than before.

    Parameters
    ----------
    azimuth : float
        Where it stands now, as it says [rad].
    between : (float, float)
        Between where and where it may stand [rad], in any order.
    tolerance : float
        How far off that it may be [rad].
    restarted : bool
        Whether its driver, and perhaps its controller, has been started anew.

    Returns
    -------
    str
        A sentence; empty if there is no doubt.
    """
    low, high = sorted(between)
    stands = f'the arm is heard of again at {math.degrees(azimuth):.2f}°'
    if not low - tolerance <= azimuth <= high + tolerance:
        return (
            f'{stands}; allowed: {math.degrees(low):.2f}° to {math.degrees(high):.2f}°, where it '
            'can have gone, so its count is lost or it was moved'
        )
    if restarted and abs(azimuth) <= tolerance:
        return f'{stands} by a new driver, where a controller begins that has lost its count'
    return ''
