"""
Vectors of numbers inside numba kernels.

A loop over candidates runs over slices of several arrays at once. The compiler must then prove,
for every short loop again, that they do not overlap, and treats what does not fill a register
number by number; that took longer than the arithmetic. Here a kernel says what it means:
``store(a, i, load(a, i) + load(b, j))`` handles ``LANES`` numbers. The vectors are LLVM's own,
so the code is the same on every processor. Nothing checks bounds: arrays must be padded to
whole vectors.

Vectors of one type combine with ``+``, ``-`` and ``*``, those of integers, which wrap, also with
``&``, ``|`` and ``^``, those of unsigned ones with ``>>``, those of real numbers with ``/``.
``load_wide`` and ``splat_wide`` make vectors of ``WIDE`` small integers; they combine in the same
way.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]  # has no types
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

#: Numbers in a vector: one register of AVX-512 for 32 bits, two of AVX2, four of NEON.
LANES = 16
#: Numbers in a vector of small integers: one register of AVX2 for bytes, two of NEON.
WIDE = 32

_INDEX = ir.IntType(32)


class Vector(types.Type):  # type: ignore[misc]  # numba has no types
    """Numba's type of ``lanes`` numbers of one type."""

    def __init__(self, element: types.Number, lanes: int) -> None:
        self.element = element
        self.lanes = lanes
        super().__init__(name=f'Vector({element}, {lanes})')


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]  # numba has no types
    def __init__(self, data_models: Any, vector: Vector) -> None:
        element = data_models.lookup(vector.element).get_value_type()
        super().__init__(data_models, vector, ir.VectorType(element, vector.lanes))


def _is_integer(vector: Vector) -> bool:
    return isinstance(vector.element, types.Integer)


def _address(
    context: Any, builder: Any, array_type: Any, lanes: int, array: Any, index: Any
) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(context.get_data_type(array_type.dtype), lanes)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _spread(builder: Any, value: Any, lanes: int) -> Any:
    vector = ir.VectorType(value.type, lanes)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INDEX(0))
    zeros = ir.Constant(ir.VectorType(_INDEX, lanes), [0] * lanes)
    return builder.shuffle_vector(single, ir.Constant(vector, ir.Undefined), zeros)


def _loading(lanes: int) -> Any:
    def function(typing: Any, array: Any, index: Any) -> Any:
        # A truth value is a byte in memory.
        element = types.uint8 if isinstance(array.dtype, types.Boolean) else array.dtype

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            address = _address(context, builder, signature.args[0], lanes, *arguments)
            vector = builder.load(address)
            vector.align = element.bitwidth // 8
            return vector

        return Vector(element, lanes)(array, types.intp), generate

    return function


def _store(typing: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write a vector into a contiguous array from an index on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = _address(context, builder, signature.args[0], vector.lanes, *arguments[:2])
        builder.store(arguments[2], address).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def _greater(typing: Any, a: Any, b: Any) -> Any:
    """Return 1 where an integer of one vector exceeds that of another, else 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        compare = builder.icmp_signed if a.element.signed else builder.icmp_unsigned
        return builder.zext(compare('>', *arguments), context.get_value_type(a))

    return a(a, b), generate


def _of_llvm(name: str) -> Any:
    """LLVM's own function of one vector, or of two of one type."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = signature.return_type
        kind = context.get_value_type(vector)
        letter = 'i' if _is_integer(vector) else 'f'
        function = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(kind, [kind] * len(arguments)),
            f'llvm.{name}.v{vector.lanes}{letter}{vector.element.bitwidth}',
        )
        return builder.call(function, arguments)

    return generate


def _square_root(typing: Any, vector: Any) -> Any:
    """Return the square roots of real numbers, correctly rounded."""
    return vector(vector), _of_llvm('sqrt')


def _bit_count(typing: Any, vector: Any) -> Any:
    """Return the numbers of ones in integers."""
    return vector(vector), _of_llvm('ctpop')


def _saturated_sum(typing: Any, a: Any, b: Any) -> Any:
    """Return the sums of unsigned integers, or the largest integer where that is too much."""
    return a(a, b), _of_llvm('uadd.sat')


def _saturated_difference(typing: Any, a: Any, b: Any) -> Any:
    """Return the differences of unsigned integers, or 0 where they are negative."""
    return a(a, b), _of_llvm('usub.sat')


def _transpose(
    typing: Any, source: Any, at: Any, stride: Any, target: Any, to: Any, target_stride: Any
) -> Any:  # fmt: skip
    """
    Write a block of ``WIDE`` × ``WIDE`` numbers with its rows as columns.

    Rows begin ``stride`` numbers apart from ``at`` on, those written ``target_stride`` from
    ``to`` on.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, begin, step, other, other_begin, other_step = arguments

        def address(kind: Any, of: Any, first: Any, apart: Any, number: int) -> Any:
            index = builder.add(first, builder.mul(apart, ir.Constant(apart.type, number)))
            return _address(context, builder, kind, WIDE, of, index)

        rows = []
        for number in range(WIDE):
            rows.append(builder.load(address(signature.args[0], array, begin, step, number)))
            rows[-1].align = 1
        # Merging row i with row i + WIDE / 2, number by number, log2(WIDE) times transposes.
        half, lanes = WIDE // 2, ir.VectorType(_INDEX, WIDE)
        for _ in range(WIDE.bit_length() - 1):
            merged = []
            for number in range(half):
                for start in (0, half):
                    order = [start + k // 2 + WIDE * (k % 2) for k in range(WIDE)]
                    merged.append(
                        builder.shuffle_vector(
                            rows[number], rows[number + half], ir.Constant(lanes, order)
                        )
                    )
            rows = merged
        for number, row in enumerate(rows):
            place = address(signature.args[3], other, other_begin, other_step, number)
            builder.store(row, place).align = 1
        return context.get_dummy_value()

    intp = types.intp
    return types.void(source, intp, intp, target, intp, intp), generate


def _splatting(lanes: int) -> Any:
    def function(typing: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _spread(builder, arguments[0], lanes)

        return Vector(value, lanes)(value), generate

    return function


def _where_at_most(typing: Any, a: Any, b: Any, x: Any, y: Any) -> Any:
    """Return x where an unsigned integer of a is at most that of b, else y, lane by lane."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, chosen, other = arguments
        return builder.select(builder.icmp_unsigned('<=', first, second), chosen, other)

    return x(a, b, x, y), generate


def _neighbours(step: int) -> Any:
    def function(typing: Any, first: Any, second: Any) -> Any:
        start = first.lanes - 1 if step < 0 else 1

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            lanes = ir.VectorType(_INDEX, first.lanes)
            numbers = list(range(start, start + first.lanes))
            return builder.shuffle_vector(*arguments, ir.Constant(lanes, numbers))

        return first(first, second), generate

    return function


def _arithmetic(integer: str | None, floating: str | None) -> Any:
    def function(typing: Any, a: Any, b: Any) -> Any:
        operation = integer if _is_integer(a) else floating
        if operation is None or (operation == 'lshr' and a.element.signed):
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, operation)(*arguments)

        return a(a, b), generate

    return intrinsic(function)


def _overload(operation: Callable[..., Any], function: Any) -> None:
    def implementation(a: Any, b: Any) -> Any:
        def call(a: Any, b: Any) -> Any:
            return function(a, b)

        return call if isinstance(a, Vector) and a == b else None

    overload(operation)(implementation)


def _select(builder: Any, vector: Vector, sign: str, a: Any, b: Any) -> Any:
    if _is_integer(vector):
        signed = vector.element.signed
        compare = builder.icmp_signed if signed else builder.icmp_unsigned
    else:
        compare = builder.fcmp_ordered
    return builder.select(compare(sign, a, b), a, b)


def _extremum(sign: str) -> Any:
    def function(typing: Any, a: Any, b: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return _select(builder, a, sign, *arguments)

        return a(a, b), generate

    return function


def _reduction(sign: str) -> Any:
    def function(typing: Any, vector: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            rest, width = arguments[0], vector.lanes
            while width > 1:
                width //= 2
                halves = [
                    builder.shuffle_vector(
                        rest, rest, ir.Constant(ir.VectorType(_INDEX, width), list(lanes))
                    )
                    for lanes in (range(width), range(width, 2 * width))
                ]
                rest = _select(builder, vector, sign, *halves)
            return builder.extract_element(rest, _INDEX(0))

        return vector.element(vector), generate

    return function


def _conversion(element: Any, operation: str) -> Any:
    def function(typing: Any, vector: Any) -> Any:
        target = Vector(element, vector.lanes)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, operation)(arguments[0], context.get_value_type(target))

        return target(vector), generate

    return function


#: ``LANES``, or ``WIDE``, numbers of a contiguous array from an index on.
load, load_wide = intrinsic(_loading(LANES)), intrinsic(_loading(WIDE))
store = intrinsic(_store)
#: A vector of one number.
splat, splat_wide = intrinsic(_splatting(LANES)), intrinsic(_splatting(WIDE))
where_at_most = intrinsic(_where_at_most)
bit_count = intrinsic(_bit_count)
saturated_sum = intrinsic(_saturated_sum)
saturated_difference = intrinsic(_saturated_difference)
transpose = intrinsic(_transpose)
#: Each lane's neighbour before it in (before, here), or after it in (here, after).
lane_before, lane_after = intrinsic(_neighbours(-1)), intrinsic(_neighbours(1))
greater = intrinsic(_greater)
square_root = intrinsic(_square_root)
#: The larger, or smaller, of two vectors, lane by lane.
maximum, minimum = intrinsic(_extremum('>')), intrinsic(_extremum('<'))
#: The largest, or smallest, number in a vector.
largest, smallest = intrinsic(_reduction('>')), intrinsic(_reduction('<'))
#: int16 to int32, uint8 to uint16 and back (modulo 256), int32 to float32 (nearest), int32 to
#: float64, float32 to int32 (towards zero).
widen = intrinsic(_conversion(types.int32, 'sext'))
widen_bytes = intrinsic(_conversion(types.uint16, 'zext'))
narrow_words = intrinsic(_conversion(types.uint8, 'trunc'))
to_float = intrinsic(_conversion(types.float32, 'sitofp'))
to_double = intrinsic(_conversion(types.float64, 'sitofp'))
to_integer = intrinsic(_conversion(types.int32, 'fptosi'))

_overload(operator.add, _arithmetic('add', 'fadd'))
_overload(operator.sub, _arithmetic('sub', 'fsub'))
_overload(operator.mul, _arithmetic('mul', 'fmul'))
_overload(operator.truediv, _arithmetic(None, 'fdiv'))
_overload(operator.and_, _arithmetic('and_', None))
_overload(operator.or_, _arithmetic('or_', None))
_overload(operator.xor, _arithmetic('xor', None))
_overload(operator.rshift, _arithmetic('lshr', None))
