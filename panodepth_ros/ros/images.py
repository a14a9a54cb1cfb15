"""
Between ``sensor_msgs/Image`` or ``CompressedImage`` and arrays, without cv_bridge.

The encodings and their array types are those of ``sensor_msgs/image_encodings.hpp``. Reading
needs no ROS: any object with the fields of the message will do, such as one out of a bag.
"""

from __future__ import annotations

import array as arrays
import re
import sys
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from sensor_msgs.msg import CompressedImage, Image

AnyArray = npt.NDArray[Any]

_DEPTHS = {
    '8U': np.uint8,
    '8S': np.int8,
    '16U': np.uint16,
    '16S': np.int16,
    '32S': np.int32,
    '32F': np.float32,
    '64F': np.float64,
}
_GENERIC = re.compile(rf'({"|".join(_DEPTHS)})(?:C([1-4]))?')
_CHANNELS = {'mono': 1, 'rgb': 3, 'bgr': 3, 'rgba': 4, 'bgra': 4}
_CHANNELS |= {f'bayer_{pattern}': 1 for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')}
_NAMED = re.compile(rf'({"|".join(_CHANNELS)})(8|16)')
_YUV422 = ('uyvy', 'yuv422', 'yuyv', 'yuv422_yuy2')

_PNG = b'\x89PNG\r\n\x1a\n'

# OpenCV names a Bayer pattern by its second row's second and third pixel, ROS by its corner.
_TO_BGR = {
    'rgb': cv2.COLOR_RGB2BGR,
    'rgba': cv2.COLOR_RGBA2BGR,
    'bgra': cv2.COLOR_BGRA2BGR,
    'bayer_rggb': cv2.COLOR_BayerBG2BGR,
    'bayer_bggr': cv2.COLOR_BayerRG2BGR,
    'bayer_gbrg': cv2.COLOR_BayerGR2BGR,
    'bayer_grbg': cv2.COLOR_BayerGB2BGR,
    'uyvy': cv2.COLOR_YUV2BGR_UYVY,
    'yuv422': cv2.COLOR_YUV2BGR_UYVY,
    'yuyv': cv2.COLOR_YUV2BGR_YUY2,
    'yuv422_yuy2': cv2.COLOR_YUV2BGR_YUY2,
}


def pixel_layout(encoding: str) -> tuple[np.dtype[Any], int]:
    """
    Type of one value, in the machine's byte order, and number of values per pixel.

    Parameters
    ----------
    encoding : str
        One of ``mono``, ``rgb``, ``bgr``, ``rgba``, ``bgra``, ``bayer_*`` followed by 8 or 16;
        ``<8U|8S|16U|16S|32S|32F|64F>C<1..4>``, where a missing ``C<n>`` means C1;
        ``uyvy`` = ``yuv422``, ``yuyv`` = ``yuv422_yuy2``.

    Raises
    ------
    ValueError
        If the encoding is none of these.
    """
    if match := _NAMED.fullmatch(encoding):
        return np.dtype(_DEPTHS[f'{match[2]}U']), _CHANNELS[match[1]]
    if match := _GENERIC.fullmatch(encoding):
        return np.dtype(_DEPTHS[match[1]]), int(match[2] or 1)
    if encoding in _YUV422:
        return np.dtype(np.uint8), 2
    raise ValueError(
        f'unknown image encoding {encoding!r}; known are {", ".join(_CHANNELS)} with 8 or 16, '
        f'{", ".join(_YUV422)}, and {", ".join(_DEPTHS)} with C1 to C4'
    )


def to_array(message: Image) -> AnyArray:
    """
    Pixels of an image message.

    Parameters
    ----------
    message : sensor_msgs.msg.Image
        Rows may be padded (``step``) and values may be big endian.

    Returns
    -------
    ndarray, shape (H, W) or (H, W, C)
        In the machine's byte order, two-dimensional for one channel. A view of the message's
        data, not necessarily contiguous; a copy only where bytes had to be swapped.

    Raises
    ------
    ValueError
        If the encoding is unknown, the size is zero, ``step`` is shorter than a row, or the
        data are not ``step * height`` bytes long.
    """
    kind, channels = pixel_layout(message.encoding)
    height, width, step = message.height, message.width, message.step
    if height < 1 or width < 1:
        raise ValueError(f'{message.encoding} image of {width} by {height} pixels is empty')
    row = width * channels * kind.itemsize
    if step < row:
        raise ValueError(
            f'step of the {message.encoding} image is {step}; '
            f'a row of {width} pixels takes {row} bytes'
        )
    data = np.frombuffer(message.data, np.uint8)
    if data.size != step * height:
        raise ValueError(
            f'data of the {message.encoding} image are {data.size} bytes long; '
            f'step {step} times height {height} is {step * height}'
        )
    stored = kind.newbyteorder('>' if message.is_bigendian else '<')
    pixels: AnyArray = np.ndarray(
        (height, width, channels),
        stored,
        buffer=data,
        strides=(step, channels * kind.itemsize, kind.itemsize),
    )
    return (pixels[:, :, 0] if channels == 1 else pixels).astype(kind, copy=False)


def to_message(
    array: AnyArray, encoding: str, *, stamp: Time | None = None, frame_id: str = ''
) -> Image:
    """
    Make an image message without row padding, in the machine's byte order.

    Parameters
    ----------
    array : ndarray, shape (H, W) or (H, W, C)
        Two-dimensional for one channel; its type must be the encoding's.
    encoding : str
        See :func:`pixel_layout`.
    stamp : builtin_interfaces.msg.Time, optional
        Time of the exposure; zero if not given.
    frame_id : str
        Frame of the header.

    Raises
    ------
    ValueError
        If the encoding is unknown, or the array is empty, of another type or another shape.
    """
    from sensor_msgs.msg import Image  # noqa: PLC0415 - reading works without ROS

    kind, channels = pixel_layout(encoding)
    if array.dtype.newbyteorder('=') != kind:
        raise ValueError(f'array for encoding {encoding} is of {array.dtype}; it takes {kind}')
    shape_fits = array.ndim == 2 if channels == 1 else array.shape[2:] == (channels,)
    if not shape_fits or array.size == 0:
        expected = '(H, W)' if channels == 1 else f'(H, W, {channels})'
        raise ValueError(
            f'array for encoding {encoding} has shape {array.shape}; '
            f'it takes {expected} with H and W of at least 1'
        )
    message = Image()
    if stamp is not None:
        message.header.stamp = stamp
    message.header.frame_id = frame_id
    message.encoding = encoding
    message.height, message.width = array.shape[:2]
    message.step = message.width * channels * kind.itemsize
    message.is_bigendian = int(sys.byteorder == 'big')
    # The one fast way: the setter checks any other type than array.array value by value.
    data = arrays.array('B')
    data.frombytes(np.ascontiguousarray(array, kind).data.cast('B'))
    message.data = data
    return message


def to_bgr_or_mono(message: Image) -> npt.NDArray[np.uint8]:
    """
    Picture of an image message as 8-bit colour or grey.

    Parameters
    ----------
    message : sensor_msgs.msg.Image
        With an encoding that says what its values mean as a picture: every one of
        :func:`pixel_layout` but the generic ones such as ``8UC3``.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3) or (H, W)
        Blue, green, red; or grey for ``mono8`` and ``mono16``. Sixteen bits are scaled by
        255/65535 and rounded. A view of the message's data for ``bgr8`` and ``mono8``.

    Raises
    ------
    ValueError
        As :func:`to_array`; or if the encoding has no meaning as a picture, a ``yuv422`` image
        is of odd width, or a Bayer image is smaller than 3 by 3.
    """
    pixels = to_array(message)
    encoding = message.encoding
    if _GENERIC.fullmatch(encoding):
        raise ValueError(f'an image of encoding {encoding} has no colours; convert it to mono8')
    meaning = encoding if encoding in _YUV422 else encoding.rstrip('0123456789')
    if encoding in _YUV422 and message.width % 2:
        raise ValueError(f'{encoding} image is {message.width} pixels wide; it must be even')
    if encoding.startswith('bayer') and min(pixels.shape) < 3:
        raise ValueError(
            f'{encoding} image of {message.width} by {message.height} pixels is too small; '
            f'its colours take 3 by 3'
        )
    if meaning in _TO_BGR:
        pixels = cv2.cvtColor(pixels, _TO_BGR[meaning])
    return _eight_bits(pixels)


def _eight_bits(pixels: AnyArray) -> npt.NDArray[np.uint8]:
    if pixels.dtype == np.uint16:
        pixels = cv2.convertScaleAbs(pixels, alpha=255.0 / 65535.0)
    return pixels


def decompressed(message: CompressedImage) -> npt.NDArray[np.uint8]:
    """
    Picture of a compressed image message as 8-bit colour or grey.

    Parameters
    ----------
    message : sensor_msgs.msg.CompressedImage
        JPEG, PNG or whatever else OpenCV decodes, in ``format`` as image_transport writes it
        (``jpeg``; ``rgb8; jpeg compressed bgr8``) or empty: the data tell by themselves.

    Returns
    -------
    ndarray of uint8, shape (H, W, 3) or (H, W)
        Blue, green, red; or grey. Sixteen bits are scaled by 255/65535 and rounded.

    Raises
    ------
    ValueError
        If the message is a compressed depth image, or its data hold no picture.
    """
    if 'compressedDepth' in message.format:
        raise ValueError(f'a compressed image of format {message.format!r} is no picture')
    data = np.frombuffer(message.data, np.uint8)
    try:
        whole = data.size and not _is_cut_png(data.tobytes())
        pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if whole else None
    except cv2.error:  # such as more pixels than OpenCV is willing to hold
        pixels = None
    if pixels is None or pixels.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f'compressed image of format {message.format!r} and {data.size} bytes '
            'cannot be decoded'
        )
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR)
    return _eight_bits(pixels)


def _is_cut_png(data: bytes) -> bool:
    """Whether a PNG's chunk claims more bytes than there are: OpenCV makes room for gigabytes."""
    at = len(_PNG)
    while data.startswith(_PNG) and at + 4 <= len(data):
        at += 12 + int.from_bytes(data[at : at + 4], 'big')  # length, type, bytes, checksum
        if at > len(data):
            return True
    return False
