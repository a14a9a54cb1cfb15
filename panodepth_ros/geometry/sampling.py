"""Where pictures are sampled, to less than OpenCV's rounding."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: ``cv2.remap`` rounds positions to this share of a pixel.
_ROUNDING = 1 / 32


def sampling_maps(
    u: npt.NDArray[np.float64], v: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """
    Maps for ``cv2.remap`` whose rounding errs at random.

    Where positions grow by nearly a whole or half pixel from column to column, many neighbours
    are rounded alike, and what is seen there seems shifted by up to 1/64 px. Random parts of a
    rounding step, the same at each call, let neighbours differ, and patches do not shift.

    Parameters
    ----------
    u, v : ndarray of float64, shape (H, W)
        Positions to sample at [px].
    """
    rng = np.random.default_rng(0)
    shift = rng.uniform(-0.5 * _ROUNDING, 0.5 * _ROUNDING, (2, *u.shape))
    return (u + shift[0]).astype(np.float32), (v + shift[1]).astype(np.float32)
