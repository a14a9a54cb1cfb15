"""Image messages and arrays, encoding by encoding, against the layout the message defines."""

import dataclasses
import itertools
import struct
import sys
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panodepth_ros.ros.images import (
    decompressed,
    pixel_layout,
    to_array,
    to_bgr_or_mono,
    to_message,
)

# name -> (struct code of one value, values per pixel): sensor_msgs/image_encodings.hpp
NAMED = {
    f'{name}{bits}': (code, channels)
    for name, channels in [('mono', 1), ('rgb', 3), ('bgr', 3), ('rgba', 4), ('bgra', 4)]
    for bits, code in [(8, 'B'), (16, 'H')]
}
BAYER = {
    f'bayer_{pattern}{bits}': (code, 1)
    for pattern in ('rggb', 'bggr', 'gbrg', 'grbg')
    for bits, code in [(8, 'B'), (16, 'H')]
}
YUV = dict.fromkeys(('uyvy', 'yuv422', 'yuyv', 'yuv422_yuy2'), ('B', 2))
DEPTHS = {'8U': 'B', '8S': 'b', '16U': 'H', '16S': 'h', '32S': 'i', '32F': 'f', '64F': 'd'}
GENERIC = {f'{depth}C{n}': (code, n) for depth, code in DEPTHS.items() for n in (1, 2, 3, 4)}
ALL = NAMED | BAYER | YUV | GENERIC | {depth: (code, 1) for depth, code in DEPTHS.items()}


@dataclasses.dataclass
class Message:
    """Fields of sensor_msgs/Image that say what the pixels are."""

    encoding: str
    width: int
    height: int
    step: int
    data: bytes
    is_bigendian: int = 0


def encoded(encoding: str, width: int, height: int, padding: int = 0, big: bool = False) -> Any:
    """A message written value by value, and the values."""
    code, channels = ALL[encoding]
    values = [(7 * i + 3) % 120 for i in range(width * height * channels)]
    per_row = width * channels
    row = struct.Struct(f'{">" if big else "<"}{per_row}{code}')
    rows = [values[y * per_row : (y + 1) * per_row] for y in range(height)]
    data = b''.join(row.pack(*row_values) + b'\xee' * padding for row_values in rows)
    message = Message(encoding, width, height, row.size + padding, data, int(big))
    shape = (height, width) if channels == 1 else (height, width, channels)
    return message, np.array(values).reshape(shape)


@pytest.mark.parametrize('big', [False, True], ids=['little', 'big'])
@pytest.mark.parametrize('padding', [0, 1, 5, 8])
@pytest.mark.parametrize('encoding', ALL)
def test_reading_gives_the_written_values(encoding: str, padding: int, big: bool) -> None:
    message, expected = encoded(encoding, width=5, height=3, padding=padding, big=big)
    array = to_array(message)
    assert array.dtype == np.dtype(ALL[encoding][0])
    assert array.dtype.isnative
    np.testing.assert_array_equal(array, expected)


def test_there_are_thirty_five_generic_names_and_twenty_two_others() -> None:
    assert len(GENERIC) == 28
    assert len(ALL) == 28 + 7 + 10 + 8 + 4


@pytest.mark.parametrize('padding', [0, 3])
@pytest.mark.parametrize('encoding', ['bgr8', 'mono16', '32FC1', 'yuyv'])
@pytest.mark.skipif(sys.byteorder == 'big', reason='only little-endian machines get a view here')
def test_reading_is_a_view(encoding: str, padding: int) -> None:
    message, _ = encoded(encoding, width=4, height=3, padding=padding)
    message.data = bytearray(message.data)
    array = to_array(message)
    message.data[0] ^= 1
    assert array.view(np.uint8).flat[0] == message.data[0]


@pytest.mark.parametrize('extra', [-1, 1, 20])
def test_data_of_another_length_are_refused(extra: int) -> None:
    message, _ = encoded('bgr8', width=4, height=3)
    message.data = message.data[:extra] if extra < 0 else message.data + bytes(extra)
    with pytest.raises(ValueError, match=rf'bgr8 image are {36 + extra} bytes.*12 times height 3'):
        to_array(message)


def test_last_row_without_its_padding_is_refused() -> None:
    message, _ = encoded('mono8', width=4, height=3, padding=2)
    message.data = message.data[:-2]
    with pytest.raises(ValueError, match='16 bytes long; step 6 times height 3 is 18'):
        to_array(message)


@pytest.mark.parametrize(('width', 'height'), [(0, 3), (4, 0), (0, 0)])
def test_empty_image_is_refused(width: int, height: int) -> None:
    with pytest.raises(ValueError, match=f'{width} by {height} pixels is empty'):
        to_array(Message('mono8', width, height, width, b''))


def test_step_shorter_than_a_row_is_refused() -> None:
    message, _ = encoded('rgb16', width=4, height=3)
    message.step = 23
    message.data = message.data[: 23 * 3]
    with pytest.raises(ValueError, match=r'step of the rgb16 image is 23; .* takes 24 bytes'):
        to_array(message)


@pytest.mark.parametrize(
    'encoding',
    ['', 'mono', 'mono32', 'BGR8', 'bgr8 ', '8UC0', '8UC5', '8UC', '64U', 'jpeg', 'nv21'],
)
def test_unknown_encoding_is_named(encoding: str) -> None:
    with pytest.raises(ValueError, match=f'unknown image encoding {encoding!r}'):
        to_array(Message(encoding, 1, 1, 1, b'\0'))
    with pytest.raises(ValueError, match=f'unknown image encoding {encoding!r}'):
        pixel_layout(encoding)


# Pictures. A flat colour of blue 40, green 120, red 200 must come back from every encoding.

BLUE, GREEN, RED = 40, 120, 200
FLAT = {
    'bgr': (BLUE, GREEN, RED),
    'rgb': (RED, GREEN, BLUE),
    'bgra': (BLUE, GREEN, RED, 9),
    'rgba': (RED, GREEN, BLUE, 9),
}


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('order', FLAT)
def test_colours_become_bgr8(order: str, bits: int) -> None:
    kind, scale = (np.uint8, 1) if bits == 8 else (np.uint16, 257)
    pixels = np.tile(np.array(FLAT[order], kind) * kind(scale), (4, 6, 1))
    picture = to_bgr_or_mono(
        Message(f'{order}{bits}', 6, 4, pixels.strides[0], pixels.tobytes())  # type: ignore[arg-type]
    )
    assert picture.dtype == np.uint8
    assert picture.shape == (4, 6, 3)
    assert (picture == (BLUE, GREEN, RED)).all()


@pytest.mark.parametrize('bits', [8, 16])
@pytest.mark.parametrize('pattern', ['rggb', 'bggr', 'gbrg', 'grbg'])
def test_bayer_becomes_bgr8(pattern: str, bits: int) -> None:
    kind, scale = (np.uint8, 1) if bits == 8 else (np.uint16, 257)
    cell = np.array([{'r': RED, 'g': GREEN, 'b': BLUE}[letter] for letter in pattern], kind)
    pixels = np.tile(cell.reshape(2, 2) * kind(scale), (4, 5))
    picture = to_bgr_or_mono(
        Message(f'bayer_{pattern}{bits}', 10, 8, pixels.strides[0], pixels.tobytes())  # type: ignore[arg-type]
    )
    assert picture.dtype == np.uint8
    assert picture.shape == (8, 10, 3)
    assert (picture == (BLUE, GREEN, RED)).all()


@pytest.mark.parametrize('encoding', YUV)
def test_yuv422_becomes_bgr8(encoding: str) -> None:
    # ITU-R BT.601, studio swing: Y = 16 + 0.257 R + 0.504 G + 0.098 B, and so on.
    y = round(16 + 0.257 * RED + 0.504 * GREEN + 0.098 * BLUE)
    u = round(128 - 0.148 * RED - 0.291 * GREEN + 0.439 * BLUE)
    v = round(128 + 0.439 * RED - 0.368 * GREEN - 0.071 * BLUE)
    pair = [u, y, v, y] if encoding in ('uyvy', 'yuv422') else [y, u, y, v]
    data = bytes(pair) * 3 * 4
    picture = to_bgr_or_mono(Message(encoding, 6, 4, 12, data))  # type: ignore[arg-type]
    assert picture.shape == (4, 6, 3)
    # Each of Y, U, V was rounded by up to half a level; blue takes U times 2.02.
    np.testing.assert_allclose(picture, np.full_like(picture, (BLUE, GREEN, RED)), atol=3)


def test_mono16_is_scaled_and_rounded() -> None:
    levels = np.array([[0, 128, 129, 257, 32768, 65535]], '<u2')
    picture = to_bgr_or_mono(Message('mono16', 6, 1, 12, levels.tobytes()))  # type: ignore[arg-type]
    np.testing.assert_array_equal(picture, np.array([[0, 0, 1, 1, 128, 255]], np.uint8))


def test_mono8_and_bgr8_stay_views_and_drop_the_padding() -> None:
    for encoding in ('mono8', 'bgr8'):
        message, expected = encoded(encoding, width=5, height=3, padding=3)
        message.data = bytearray(message.data)
        picture = to_bgr_or_mono(message)
        np.testing.assert_array_equal(picture, expected)
        message.data[0] ^= 1
        assert picture.flat[0] == message.data[0]


def test_padded_big_endian_colours_are_converted() -> None:
    pixels = np.tile(np.array(FLAT['rgb'], '>u2') * 257, (2, 3, 1)).astype('>u2')
    data = b''.join(row.tobytes() + b'\xee\xee\xee' for row in pixels)
    picture = to_bgr_or_mono(Message('rgb16', 3, 2, 21, data, 1))  # type: ignore[arg-type]
    assert (picture == (BLUE, GREEN, RED)).all()


@pytest.mark.parametrize('encoding', [*GENERIC, *DEPTHS])
def test_generic_encoding_is_no_picture(encoding: str) -> None:
    message, _ = encoded(encoding, width=4, height=4)
    with pytest.raises(ValueError, match=f'encoding {encoding} '):
        to_bgr_or_mono(message)


@pytest.mark.parametrize('encoding', YUV)
def test_yuv422_of_odd_width_is_refused(encoding: str) -> None:
    message, _ = encoded(encoding, width=5, height=3)
    with pytest.raises(ValueError, match=f'{encoding} image is 5 pixels wide'):
        to_bgr_or_mono(message)


@pytest.mark.parametrize(('width', 'height'), [(2, 8), (8, 2), (1, 1)])
@pytest.mark.parametrize('encoding', BAYER)
def test_bayer_image_without_a_neighbourhood_is_refused(
    encoding: str, width: int, height: int
) -> None:
    message, _ = encoded(encoding, width=width, height=height)
    with pytest.raises(ValueError, match=f'{encoding} image of {width} by {height}'):
        to_bgr_or_mono(message)


# Writing makes a real message.


@st.composite
def images(draw: st.DrawFn) -> tuple[str, np.ndarray]:
    encoding = draw(st.sampled_from(sorted(ALL)))
    code, channels = ALL[encoding]
    height, width = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    shape = (height, width) if channels == 1 else (height, width, channels)
    size = height * width * channels * np.dtype(code).itemsize
    data = draw(st.binary(min_size=size, max_size=size))
    return encoding, np.frombuffer(data, code).reshape(shape)


@pytest.mark.ros
@settings(max_examples=200)
@given(image=images(), flip=st.booleans(), swap=st.booleans())
def test_writing_and_reading_give_back_every_bit(
    image: tuple[str, np.ndarray], flip: bool, swap: bool
) -> None:
    encoding, array = image
    given_array = array[::-1, ::-1] if flip else array  # no longer contiguous
    expected = np.ascontiguousarray(given_array).tobytes()
    if swap:
        given_array = given_array.astype(given_array.dtype.newbyteorder())
    message = to_message(given_array, encoding)
    assert (message.height, message.width) == array.shape[:2]
    assert message.step * message.height == len(message.data)
    assert message.is_bigendian == (sys.byteorder == 'big')
    read = to_array(message)
    assert read.shape == array.shape
    assert np.ascontiguousarray(read).tobytes() == expected  # NaNs with their bits


@pytest.mark.ros
def test_header_is_what_was_given() -> None:
    from builtin_interfaces.msg import Time  # noqa: PLC0415 - the rest runs without ROS

    array = np.zeros((2, 3), np.float32)
    message = to_message(array, '32FC1', stamp=Time(sec=5, nanosec=7), frame_id='panodepth')
    assert message.header.stamp == Time(sec=5, nanosec=7)
    assert message.header.frame_id == 'panodepth'
    assert to_message(array, '32FC1').header.stamp == Time()
    assert to_message(array, '32FC1').header.frame_id == ''


@pytest.mark.ros
@pytest.mark.parametrize(
    ('encoding', 'kind'), [('mono8', 'i1'), ('32FC1', 'f8'), ('16UC1', 'i2'), ('rgb8', '?')]
)
def test_array_of_another_type_is_refused(encoding: str, kind: str) -> None:
    shape = (2, 3, 3) if encoding == 'rgb8' else (2, 3)
    with pytest.raises(ValueError, match=f'encoding {encoding} is of {np.dtype(kind)}'):
        to_message(np.zeros(shape, kind), encoding)


@pytest.mark.ros
@pytest.mark.parametrize(
    ('encoding', 'shape'),
    [
        *itertools.product(['mono8'], [(), (6,), (2, 3, 1), (2, 3, 3), (0, 3), (2, 0)]),
        *itertools.product(['bgr8'], [(2, 3), (2, 9), (2, 3, 4), (1, 2, 3, 3), (0, 3, 3)]),
        ('yuyv', (2, 3)),
    ],
)
def test_array_of_another_shape_is_refused(encoding: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf'encoding {encoding} has shape \('):
        to_message(np.zeros(shape, np.uint8), encoding)


def test_opencv_takes_every_view(tmp_path: Any) -> None:
    message, expected = encoded('bgr8', width=5, height=4, padding=1)
    assert cv2.imwrite(str(tmp_path / 'view.png'), to_array(message))
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / 'view.png')), expected)


@dataclasses.dataclass
class Compressed:
    """Fields of sensor_msgs/CompressedImage."""

    format: str
    data: bytes


def picture(*channels: int, kind: type = np.uint8) -> Any:
    ramp = np.arange(16 * 12 * int(np.prod(channels or (1,)))) % 251
    return ramp.reshape(12, 16, *channels).astype(kind)


def file_of(suffix: str, pixels: Any) -> bytes:
    done, data = cv2.imencode(suffix, pixels)
    assert done
    return bytes(data)


@pytest.mark.parametrize('format', ['png', 'rgb8; png compressed bgr8', ''])
def test_png_gives_its_pixels_back(format: str) -> None:
    message = Compressed(format, file_of('.png', picture(3)))
    np.testing.assert_array_equal(decompressed(message), picture(3))


def test_grey_transparent_and_deep_pngs() -> None:
    np.testing.assert_array_equal(
        decompressed(Compressed('mono8; png compressed ', file_of('.png', picture()))), picture()
    )
    np.testing.assert_array_equal(
        decompressed(Compressed('png', file_of('.png', picture(4)))), picture(4)[:, :, :3]
    )
    deep = picture(kind=np.uint16) * 257
    np.testing.assert_array_equal(
        decompressed(Compressed('png', file_of('.png', deep))), picture()
    )


def test_jpeg_is_blue_green_red() -> None:
    blue = np.zeros((16, 16, 3), np.uint8)
    blue[:, :, 0] = 200
    pixels = decompressed(Compressed('bgr8; jpeg compressed bgr8', file_of('.jpg', blue)))
    assert np.abs(pixels.astype(int) - blue).max() <= 3


@pytest.mark.parametrize(
    ('format', 'data', 'sentence'),
    [
        ('jpeg', b'', "format 'jpeg' and 0 bytes cannot be decoded"),
        ('jpeg', b'no picture at all', "format 'jpeg' and 17 bytes cannot be decoded"),
        ('16UC1; compressedDepth png', b'', "'16UC1; compressedDepth png' is no picture"),
    ],
)
def test_what_is_no_compressed_picture_is_refused(format: str, data: bytes, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        decompressed(Compressed(format, data))


def test_compressed_picture_that_claims_too_many_pixels_is_refused() -> None:
    png = bytearray(file_of('.png', picture()))
    png[16:24] = struct.pack('>II', 2**20, 2**20)  # the size in IHDR
    jpeg = bytearray(file_of('.jpg', picture()))
    size = jpeg.index(b'\xff\xc0') + 5  # of the frame, in the header that no checksum guards
    jpeg[size : size + 4] = struct.pack('>HH', 20000, 20000)
    for data in (png, jpeg):
        with pytest.raises(ValueError, match='cannot be decoded'):
            decompressed(Compressed('', bytes(data)))


def test_cut_png_is_refused_before_opencv_makes_room_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    png = file_of('.png', picture())
    monkeypatch.setattr(cv2, 'imdecode', lambda *_: pytest.fail('OpenCV was asked'))
    at = png.index(b'IDAT') - 4
    claiming = png[:at] + struct.pack('>I', 3_000_000_000) + png[at + 4 :]
    for data in (png[:-1], claiming):
        with pytest.raises(ValueError, match='cannot be decoded'):
            decompressed(Compressed('', data))
