"""
Coloured points as a PLY file, binary little endian.

The element ``vertex`` has the properties ``float x, y, z`` [m] in the scan frame (z up),
``uchar red, green, blue`` and ``float confidence``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

#: One vertex in the file.
VERTEX = np.dtype(
    [
        *((name, '<f4') for name in ('x', 'y', 'z')),
        *((name, 'u1') for name in ('red', 'green', 'blue')),
        ('confidence', '<f4'),
    ]
)
_TYPES = {'<f4': 'float', '|u1': 'uchar'}


def vertices(
    xyz: npt.NDArray[np.floating],
    image: npt.NDArray[np.uint8],
    confidence: npt.NDArray[np.floating],
    min_confidence: float,
) -> npt.NDArray[np.void]:
    """
    Vertices of the pixels that hold a trusted point.

    Parameters
    ----------
    xyz : ndarray of float, shape (H, W, 3)
        Points [m], NaN where unknown.
    image : ndarray of uint8, shape (H, W) or (H, W, 3)
        Their colours, grey or BGR.
    confidence : ndarray of float, shape (H, W)
        From 0 to 1, NaN where unknown.
    min_confidence : float
        Least confidence of a vertex.

    Returns
    -------
    ndarray of :data:`VERTEX`, shape (M,)
        Row by row.

    Raises
    ------
    ValueError
        If the sizes differ.
    """
    size = xyz.shape[:2]
    for name, values in (('image', image), ('confidence', confidence)):
        if values.shape[:2] != size:
            raise ValueError(f'{name} has shape {values.shape}; allowed: {size} as the points')
    with np.errstate(invalid='ignore'):
        known = np.isfinite(xyz).all(axis=-1) & (confidence >= min_confidence)
    found = np.empty(int(known.sum()), VERTEX)
    for index, name in enumerate('xyz'):
        found[name] = xyz[known][:, index]
    bgr = np.broadcast_to(image.reshape(*size, -1), (*size, 3))[known]
    for index, name in enumerate(('blue', 'green', 'red')):
        found[name] = bgr[:, index]
    found['confidence'] = confidence[known]
    return found


def write_ply(path: Path, points: npt.NDArray[np.void]) -> None:
    """
    Write vertices, shape (M,), made by :func:`vertices`, as a PLY file.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    header = [
        'ply',
        'format binary_little_endian 1.0',
        'comment metres; z is the axis of rotation, x forward',
        f'element vertex {points.size}',
        *(f'property {_TYPES[VERTEX[name].str]} {name}' for name in VERTEX.names or ()),
        'end_header',
    ]
    with path.open('wb') as file:
        file.write(''.join(f'{line}\n' for line in header).encode('ascii'))
        file.write(points.tobytes())
