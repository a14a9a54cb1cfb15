"""
Vectors of numbers inside numba kernels.

A loop over candidates runs over slices of several arrays at once. The compiler must then prove,
for every short loop again, that they do not overlap, and treats what does not fill a register
number by number; that took longer than the arithmetic. Here a kernel says what it means:
``store(a, i, load(a, i) + load(b, j))`` handles ``LANES`` numbers. The vectors are LLVM's own,
so the code is the same on every processor. Nothing checks bounds: arrays must be padded to
whole vectors.

Vectors of one type combine with ``+``, ``-`` and ``*``, those of integers, which wrap, also with
``&`` and ``|``, those of real numbers with ``/``.
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

_INDEX = ir.IntType(32)


class Vector(types.Type):  # type: ignore[misc]  # numba has no types
    """Numba's type of ``LANES`` numbers of one type."""

    def __init__(self, element: types.Number) -> None:
        self.element = element
        super().__init__(name=f'Vector({element}, {LANES})')


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]  # numba has no types
    def __init__(self, data_models: Any, vector: Vector) -> None:
        element = data_models.lookup(vector.element).get_value_type()
        super().__init__(data_models, vector, ir.VectorType(element, LANES))


def _is_integer(vector: Vector) -> bool:
    return isinstance(vector.element, types.Integer)


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    vector = ir.VectorType(context.get_data_type(array_type.dtype), LANES)
    return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())


def _spread(builder: Any, value: Any) -> Any:
    vector = ir.VectorType(value.type, LANES)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), value, _INDEX(0))
    lanes = ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES)
    return builder.shuffle_vector(single, ir.Constant(vector, ir.Undefined), lanes)


def _load(typing: Any, array: Any, index: Any) -> Any:
    """Return the ``LANES`` numbers of a one-dimensional contiguous array from an index on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = builder.load(_address(context, builder, signature.args[0], *arguments))
        vector.align = array.dtype.bitwidth // 8
        return vector

    return Vector(array.dtype)(array, types.intp), generate


def _store(typing: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write a vector into a one-dimensional contiguous array from an index on."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = _address(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], address).align = array.dtype.bitwidth // 8
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def _greater(typing: Any, a: Any, b: Any) -> Any:
    """Return 1 where an integer of one vector exceeds that of another, else 0."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        compare = builder.icmp_signed if a.element.signed else builder.icmp_unsigned
        return builder.zext(compare('>', *arguments), context.get_value_type(a))

    return a(a, b), generate


def _square_root(typing: Any, vector: Any) -> Any:
    """Return the square roots of real numbers, correctly rounded."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = context.get_value_type(vector)
        name = f'llvm.sqrt.v{LANES}f{vector.element.bitwidth}'
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(kind, [kind]), name
        )
        return builder.call(function, arguments)

    return vector(vector), generate


def _splat(typing: Any, value: Any) -> Any:
    """Return a vector of one number."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _spread(builder, arguments[0])

    return Vector(value)(value), generate


def _arithmetic(integer: str | None, floating: str | None) -> Any:
    def function(typing: Any, a: Any, b: Any) -> Any:
        operation = integer if _is_integer(a) else floating
        if operation is None:
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
            rest, width = arguments[0], LANES
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
        target = Vector(element)

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, operation)(arguments[0], context.get_value_type(target))

        return target(vector), generate

    return function


load = intrinsic(_load)
store = intrinsic(_store)
splat = intrinsic(_splat)
greater = intrinsic(_greater)
square_root = intrinsic(_square_root)
#: The larger of two vectors, lane by lane.
maximum = intrinsic(_extremum('>'))
#: The largest number in a vector.
largest = intrinsic(_reduction('>'))
#: int16 to int32, int32 to float32 (nearest), float32 to int32 (towards zero).
widen = intrinsic(_conversion(types.int32, 'sext'))
to_float = intrinsic(_conversion(types.float32, 'sitofp'))
to_integer = intrinsic(_conversion(types.int32, 'fptosi'))

_overload(operator.add, _arithmetic('add', 'fadd'))
_overload(operator.sub, _arithmetic('sub', 'fsub'))
_overload(operator.mul, _arithmetic('mul', 'fmul'))
_overload(operator.truediv, _arithmetic(None, 'fdiv'))
_overload(operator.and_, _arithmetic('and_', None))
_overload(operator.or_, _arithmetic('or_', None))
