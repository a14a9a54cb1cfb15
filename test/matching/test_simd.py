"""Vectors inside kernels against NumPy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import int32, uint16

from panodepth_ros.matching.compiled import kernel
from panodepth_ros.matching.simd import (
    LANES,
    WIDE,
    bit_count,
    greater,
    lane_after,
    lane_before,
    largest,
    load,
    load_wide,
    maximum,
    minimum,
    narrow_words,
    saturated_difference,
    saturated_sum,
    smallest,
    splat,
    splat_wide,
    square_root,
    store,
    to_double,
    to_float,
    to_integer,
    transpose,
    where_at_most,
    widen,
    widen_bytes,
)


@kernel
def integers(
    a: npt.NDArray[np.int32], b: npt.NDArray[np.int32], out: npt.NDArray[np.int32]
) -> int:
    for i in range(0, a.size, LANES):
        x, y = load(a, i), load(b, i)
        store(out, i, (maximum(x * y, x - y) & splat(a[0])) | (x + y))
    result: int = largest(load(a, LANES))
    return result


def test_integers_wrap_compare_and_mask() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(-(2**31), 2**31, (2, 4 * LANES)).astype(np.int32)
    out = np.zeros_like(a)
    greatest = integers(a, b, out)
    np.testing.assert_array_equal(out, (np.maximum(a * b, a - b) & a[0]) | (a + b))
    assert greatest == a[LANES : 2 * LANES].max()


@kernel
def roots(
    a: npt.NDArray[np.int32], b: npt.NDArray[np.int32], out: npt.NDArray[np.float32]
) -> None:
    for i in range(0, a.size, LANES):
        x, y = load(a, i), load(b, i)
        store(out, i, to_float(greater(x, y)) + to_float(x) / square_root(to_float(y)))


def test_comparison_gives_one_or_zero_and_roots_are_rounded_correctly() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.integers(1, 2**31, (2, 4 * LANES)).astype(np.int32)
    b[:5] = a[:5]
    out = np.zeros(a.size, np.float32)
    roots(a, b, out)
    quotient = a.astype(np.float32) / np.sqrt(b.astype(np.float32))
    np.testing.assert_array_equal(out, (a > b).astype(np.float32) + quotient)


@kernel
def reals(
    a: npt.NDArray[np.int16], b: npt.NDArray[np.float32],
    out: npt.NDArray[np.float32], whole: npt.NDArray[np.int32], double: npt.NDArray[np.float64],
) -> None:  # fmt: skip
    for i in range(3, a.size - LANES, LANES):  # not aligned
        x = to_float(widen(load(a, i))) * load(b, i) - load(b, i)
        store(out, i, maximum(x, splat(b[0])))
        store(whole, i, to_integer(x))
        wide = widen(load(a, i))
        store(double, i, to_double(wide * wide + splat(int32(1))))


def test_conversions_are_exact_and_truncate() -> None:
    rng = np.random.default_rng(2)
    a = rng.integers(-(2**15), 2**15, 3 + 4 * LANES).astype(np.int16)
    b = rng.normal(0, 10, a.size).astype(np.float32)
    out, whole = np.zeros(a.size, np.float32), np.zeros(a.size, np.int32)
    double = np.zeros(a.size)
    reals(a, b, out, whole, double)
    done = slice(3, 3 + 3 * LANES)
    x = a.astype(np.float32) * b - b
    np.testing.assert_array_equal(out[done], np.maximum(x, b[0])[done])
    np.testing.assert_array_equal(whole[done], np.trunc(x[done]).astype(np.int32))
    # More digits than 32 bits of floating point have.
    np.testing.assert_array_equal(double[done], a[done].astype(np.int64) ** 2 + 1)
    assert not out[:3].any()


@kernel
def small_integers(
    a: npt.NDArray[np.uint8], b: npt.NDArray[np.uint8], seen: npt.NDArray[np.bool_],
    out: npt.NDArray[np.uint8], sums: npt.NDArray[np.uint16],
) -> int:  # fmt: skip
    for i in range(0, a.size, WIDE):
        x, y = load_wide(a, i), load_wide(b, i)
        store(out[0], i, bit_count(x ^ y))
        store(out[1], i, saturated_sum(x, y))
        store(out[2], i, minimum(x, y))
        store(out[3], i, where_at_most(x, y, load_wide(seen, i), splat_wide(b[0])))
        store(out[4], i, saturated_difference(x, y))
        product = widen_bytes(x) * widen_bytes(y)
        store(out[5], i, narrow_words(product >> splat_wide(uint16(3))))
        store(sums, i, widen_bytes(x) + widen_bytes(y))
    result: int = smallest(load_wide(a, WIDE))
    return result


def test_bytes_count_saturate_and_choose() -> None:
    rng = np.random.default_rng(4)
    a, b = rng.integers(0, 256, (2, 3 * WIDE)).astype(np.uint8)
    seen = rng.random(a.size) < 0.5
    b[:5] = a[:5]
    out, sums = np.zeros((6, a.size), np.uint8), np.zeros(a.size, np.uint16)
    least = small_integers(a, b, seen, out, sums)
    np.testing.assert_array_equal(out[0], np.unpackbits((a ^ b)[:, np.newaxis], axis=1).sum(1))
    np.testing.assert_array_equal(sums, a.astype(np.uint16) + b)
    np.testing.assert_array_equal(out[1], np.minimum(sums, 255))
    np.testing.assert_array_equal(out[2], np.minimum(a, b))
    np.testing.assert_array_equal(out[3], np.where(a <= b, seen, b[0]))
    high = a.astype(np.uint16) * b >> 3
    np.testing.assert_array_equal(out[5], high.astype(np.uint8))  # modulo 256
    np.testing.assert_array_equal(out[4], np.maximum(a.astype(np.int16) - b, 0))
    assert least == a[WIDE : 2 * WIDE].min()


@kernel
def turned(a: npt.NDArray[np.uint8], out: npt.NDArray[np.uint8]) -> None:
    transpose(a, 3, a.shape[1], out, 2 * out.shape[1] + 1, out.shape[1])


def test_blocks_are_transposed() -> None:
    rng = np.random.default_rng(6)
    a = rng.integers(0, 256, (WIDE, WIDE + 5)).astype(np.uint8)
    out = np.zeros((WIDE + 3, WIDE + 2), np.uint8)
    turned(a, out)
    np.testing.assert_array_equal(out[2:-1, 1:-1], a[:, 3 : 3 + WIDE].T)
    out[2:-1, 1:-1] = 0
    assert not out.any()


@kernel
def neighbours(a: npt.NDArray[np.uint8], out: npt.NDArray[np.uint8]) -> None:
    store(out[0], 0, lane_before(load_wide(a, 0), load_wide(a, WIDE)))
    store(out[1], 0, lane_after(load_wide(a, WIDE), load_wide(a, 2 * WIDE)))


def test_lanes_have_neighbours_in_the_vectors_beside() -> None:
    a = np.arange(3 * WIDE, dtype=np.uint8)
    out = np.zeros((2, WIDE), np.uint8)
    neighbours(a, out)
    np.testing.assert_array_equal(out[0], a[WIDE - 1 : 2 * WIDE - 1])
    np.testing.assert_array_equal(out[1], a[WIDE + 1 : 2 * WIDE + 1])
