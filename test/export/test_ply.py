"""PLY files, read by the format's rules."""

import numpy as np
import pytest

from panodepth_ros.export.ply import VERTEX, vertices, write_ply

NAN = np.nan
XYZ = np.array([[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [NAN, NAN, NAN], [7.0, 8.0, 9.0]]])
CONFIDENCE = np.array([[0.5, 0.2, NAN, 1.0]], np.float32)
BGR = np.arange(12, dtype=np.uint8).reshape(1, 4, 3)


def test_only_trusted_points_and_their_colours_are_written(tmp_path):
    path = tmp_path / 'points.ply'
    write_ply(path, vertices(XYZ, BGR, CONFIDENCE, 0.3))
    head, _, body = path.read_bytes().partition(b'end_header\n')
    lines = head.decode('ascii').splitlines()
    assert lines[:2] == ['ply', 'format binary_little_endian 1.0']
    assert [line for line in lines[2:] if not line.startswith('comment ')] == [
        'element vertex 2',
        *(f'property float {name}' for name in 'xyz'),
        *(f'property uchar {name}' for name in ('red', 'green', 'blue')),
        'property float confidence',
    ]
    # 19 bytes a vertex, little endian, red first.
    first = np.array([1.0, 2.0, 3.0], '<f4').tobytes() + bytes([2, 1, 0])
    last = np.array([7.0, 8.0, 9.0], '<f4').tobytes() + bytes([11, 10, 9])
    assert body == first + np.float32(0.5).tobytes() + last + np.float32(1.0).tobytes()


def test_grey_becomes_a_colour():
    grey = np.array([[10, 20, 30, 40]], np.uint8)
    found = vertices(XYZ, grey, CONFIDENCE, 0.0)
    assert found.size == 3
    for name in ('red', 'green', 'blue'):
        assert found[name].tolist() == [10, 20, 40]


def test_no_point_makes_an_empty_cloud(tmp_path):
    path = tmp_path / 'points.ply'
    write_ply(path, np.empty(0, VERTEX))
    assert b'element vertex 0\n' in path.read_bytes()


@pytest.mark.parametrize('named', ['image', 'confidence'])
def test_other_sizes_are_refused_by_name(named):
    values = {'image': BGR, 'confidence': CONFIDENCE}
    values[named] = values[named][:, :3]
    with pytest.raises(ValueError, match=rf'{named} has shape .* allowed: \(1, 4\)'):
        vertices(XYZ, values['image'], values['confidence'], 0.3)
