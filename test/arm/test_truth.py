"""The memory-mapped file of the true motion, between objects and between processes."""

import math
import subprocess
import sys
import time

import pytest

from panodepth_ros.arm.truth import (
    CAPACITY,
    Piece,
    TruthError,
    TruthReader,
    TruthWriter,
    truth_path,
)


@pytest.fixture
def path(tmp_path):
    return truth_path(tmp_path / 'arm')


@pytest.fixture
def writer(path):
    writer = TruthWriter(path, azimuth=0.25)
    yield writer
    writer.close()


def test_file_stands_beside_the_link(tmp_path):
    assert truth_path(tmp_path / 'arm') == tmp_path / 'arm.truth'


def test_arm_stands_where_it_was_made_at_any_time(writer, path):
    reader = TruthReader(path)
    assert [reader.azimuth(t) for t in (-1e9, 0.0, time.monotonic(), 1e9)] == [0.25] * 4


def test_pieces_are_evaluated_at_their_times(writer, path):
    # 2 rad/s² for 3 s: 9 rad and 6 rad/s; cruise 1 s: 15 rad; brake 3 s: 24 rad.
    writer.write(
        [
            Piece(-math.inf, 0.0),
            Piece(10.0, 0.0, 0.0, 2.0),
            Piece(13.0, 9.0, 6.0, 0.0),
            Piece(14.0, 15.0, 6.0, -2.0),
            Piece(17.0, 24.0),
        ]
    )
    reader = TruthReader(path)
    moments = {5.0: 0.0, 10.0: 0.0, 11.0: 1.0, 13.0: 9.0, 13.5: 12.0, 15.0: 20.0, 99.0: 24.0}
    for moment, azimuth in moments.items():
        assert reader.azimuth(moment) == pytest.approx(azimuth, abs=1e-12)


def test_reader_sees_what_is_written_after_it_was_opened(writer, path):
    reader = TruthReader(path)
    writer.write([Piece(-math.inf, 1.5)])
    assert reader.azimuth(0.0) == 1.5


def test_memory_is_limited_and_says_so(writer, path):
    writer.write([Piece(float(i), float(i)) for i in range(CAPACITY + 10)])
    reader = TruthReader(path)
    assert reader.azimuth(10.5) == 10.0
    with pytest.raises(TruthError, match=r'knows nothing of monotonic time 9\.500 s.*10\.000 s'):
        reader.azimuth(9.5)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(TruthError, match=r'nowhere\.truth .*No such file'):
        TruthReader(tmp_path / 'nowhere.truth')


@pytest.mark.parametrize('content', [b'', b'hello', b'PANOARM1', b'x' * 5000])
def test_file_of_another_format_is_refused(tmp_path, content):
    path = tmp_path / 'other'
    path.write_bytes(content)
    with pytest.raises(TruthError, match='other is not a truth file'):
        TruthReader(path)


def test_damaged_file_is_refused(writer, path):
    data = bytearray(path.read_bytes())
    data[30] ^= 1
    path.write_bytes(data)
    with pytest.raises(TruthError, match='damaged'):
        TruthReader(path).azimuth(0.0)


def test_second_writer_is_refused_and_a_left_over_is_taken_over(writer, path):
    with pytest.raises(TruthError, match='in use by another'):
        TruthWriter(path)
    left_over = path.with_name('left.truth')
    left_over.write_bytes(path.read_bytes())
    taken = TruthWriter(left_over, azimuth=2.0)
    assert TruthReader(left_over).azimuth(0.0) == 2.0
    taken.close()


def test_writer_that_cannot_write_says_so(tmp_path):
    with pytest.raises(TruthError, match='cannot be written'):
        TruthWriter(tmp_path / 'nowhere' / 'arm.truth')


def test_close_removes_the_file_and_readers_keep_the_last_motion(writer, path):
    reader = TruthReader(path)
    writer.write([Piece(-math.inf, 0.75)])
    writer.close()
    writer.close()
    assert not path.exists()
    assert reader.azimuth(0.0) == 0.75


def test_reader_follows_an_arm_that_is_started_anew(writer, path):
    reader = TruthReader(path)
    writer.close()
    with_new_position = TruthWriter(path, azimuth=-1.0)
    assert reader.azimuth(0.0) == -1.0
    with_new_position.close()


WRITE_FAST = """
import math, sys, time
from panodepth_ros.arm.truth import Piece, TruthWriter
writer = TruthWriter(sys.argv[1])
print('ready', flush=True)
count = 0
while True:
    count += 1
    writer.write([Piece(-math.inf, count)] * (1 + count % 100))
"""


@pytest.mark.launch
def test_reader_never_sees_a_torn_record_of_another_process(path):
    process = subprocess.Popen(
        [sys.executable, '-c', WRITE_FAST, str(path)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == 'ready\n'
        reader = TruthReader(path)
        seen = [reader.azimuth(0.0) for _ in range(3000)]
    finally:
        process.kill()
        process.communicate()
    assert all(value == int(value) for value in seen)
    assert seen == sorted(seen)
    assert seen[-1] > seen[0]
