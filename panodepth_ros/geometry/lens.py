"""Whether a lens model holds in the whole image, asked where a calibration comes in."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panodepth_ros.geometry.camera import PinholeCamera

Array = npt.NDArray[np.float64]

#: Pixels of each side of the image whose rays are followed outwards, and places on each of them.
_PIXELS, _PLACES = 17, 33
#: Step of the derivative, in ideal coordinates.
_STEP = 1e-5


def check_lens(camera: PinholeCamera) -> None:
    """
    Check that every pixel has one ray, and neighbouring pixels neighbouring rays.

    A polynomial of a strong or badly fitted distortion turns back at some angle: what is farther
    out is imaged nearer to the middle again, and pixels have two rays or none. Asked of each
    calibration that comes from outside; the trial cameras of an adjustment may pass such a place.

    Parameters
    ----------
    camera : PinholeCamera
        Its mounting does not matter.

    Raises
    ------
    ValueError
        If the model folds inside of the image.

    Notes
    -----
    The Jacobian of ideal coordinates to pixels must keep its sign from the optical axis to each
    pixel of the image's edge.
    """
    if not camera.distorted:
        return
    across = np.linspace(-0.5, camera.width - 0.5, _PIXELS)
    down = np.linspace(-0.5, camera.height - 0.5, _PIXELS)
    u = np.concatenate([across, across, np.repeat([across[0], across[-1]], _PIXELS)])
    v = np.concatenate([np.repeat([down[0], down[-1]], _PIXELS), down, down])
    try:
        x, y = camera.ideal(u, v)
    except ValueError:
        holds = False
    else:
        out = np.linspace(0.0, 1.0, _PLACES)[:, np.newaxis]
        holds = bool((_jacobian(camera, out * x, out * y) > 0).all())
    if not holds:
        raise ValueError(
            f'camera distortion {camera.distortion} ({camera.distortion_model}) folds inside of '
            f'the image of {camera.width} by {camera.height} pixels, some of which have no ray of '
            'their own; allowed: a lens model that holds up to the corners, so calibrate with the '
            'target in the corners, too, or with fewer coefficients'
        )


def _jacobian(camera: PinholeCamera, x: Array, y: Array) -> Array:
    """Determinant of the derivative of pixels by ideal coordinates."""
    (u_x, v_x), (u_y, v_y) = (
        np.subtract(camera.imaged(x + dx, y + dy), camera.imaged(x - dx, y - dy))
        for dx, dy in ((_STEP, 0.0), (0.0, _STEP))
    )
    return np.asarray(u_x * v_y - u_y * v_x)
