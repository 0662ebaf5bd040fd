"""A leaf's polynomial and its derivatives by Horner's rule, several numbers at a time.

Numba's kernels take one number after the other, and a smooth function's mesh is made of hardly
anything but polynomials. Here they are written for vectors of numbers, which the compiler fits to
what the machine has. Each number goes through the same steps as if it were alone.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

__all__ = ["partials0", "partials1", "partials2", "partials3", "values8"]

_SIZE = 8  # coefficients in each direction
_NUMBER, _PLACE = ir.DoubleType(), ir.IntType(32)


def _partials(order: int) -> Any:
    """The intrinsic ``(coef, leaf, s, t)`` for the derivatives up to ``order``, at most 3.

    ``coef`` (leaves, 8, 8): coefficients of s**i t**j. Lower orders come first, within each more
    derivatives by s: f, f_s, f_t, f_ss, f_st, f_tt, ...
    """

    @intrinsic
    def partials(typing: Any, coef: Any, leaf: Any, s: Any, t: Any) -> Any:
        many = (order + 1) * (order + 2) // 2
        signature = types.UniTuple(types.float64, many)(coef, types.intp, s, t)

        def generated(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            s, t = _all(builder, args[2], _SIZE), _all(builder, args[3], 4)
            first = _first(context, builder, signature, args)
            by_s = [None] * (order + 1)  # Taylor coefficients in s for all powers of t,
            for i in range(_SIZE - 1, -1, -1):
                by_s = _step(builder, by_s, s, _row(builder, first, i))
            by_s = [_times(builder, w, math.factorial(k)) for k, w in enumerate(by_s)]
            by_t = [None] * (order + 1)  # and in t of all derivatives by s
            for j in range(_SIZE - 1, -1, -1):
                by_t = _step(builder, by_t, t, _vector(builder, [_at(builder, w, j) for w in by_s]))
            by_t = [_times(builder, w, math.factorial(k)) for k, w in enumerate(by_t)]
            out = [
                _at(builder, by_t[k], total - k) for total in range(order + 1)
                for k in range(total + 1)
            ]  # fmt: skip
            return context.make_tuple(builder, signature.return_type, out)

        return signature, generated

    return partials


@intrinsic
def values8(typing: Any, coef: Any, leaf: Any, s: Any, t: Any) -> Any:
    """The polynomial of a leaf at eight places, whose coordinates are the tuples s and t."""
    signature = types.UniTuple(types.float64, 8)(coef, types.intp, s, t)

    def generated(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        first = _first(context, builder, signature, args)
        s, t = (_vector(builder, [builder.extract_value(a, k) for k in range(8)]) for a in args[2:])
        value = [None]
        for j in range(_SIZE - 1, -1, -1):
            along = [None]
            for i in range(_SIZE - 1, -1, -1):
                place = builder.gep(first, [ir.Constant(_PLACE, _SIZE * i + j)])
                along = _step(builder, along, s, _all(builder, builder.load(place), 8))
            value = _step(builder, value, t, along[0])
        out = [_at(builder, value[0], k) for k in range(8)]
        return context.make_tuple(builder, signature.return_type, out)

    return signature, generated


def _step(builder: Any, taylor: list[Any], x: Any, coefficient: Any) -> list[Any]:
    """Horner's rule for a polynomial and its Taylor coefficients at x; None stands for 0."""
    below = [coefficient, *taylor]
    return [
        low if w is None else builder.fadd(builder.fmul(w, x), low)
        for w, low in zip(taylor, below, strict=False)
    ]


def _first(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    """Where the leaf's coefficients begin."""
    coef = context.make_array(signature.args[0])(context, builder, args[0])
    return builder.gep(coef.data, [builder.mul(args[1], ir.Constant(args[1].type, _SIZE**2))])


def _row(builder: Any, first: Any, i: int) -> Any:
    """The coefficients of s**i."""
    place = builder.gep(first, [ir.Constant(_PLACE, _SIZE * i)])
    kind = ir.VectorType(_NUMBER, _SIZE).as_pointer()
    return builder.load(builder.bitcast(place, kind), align=8)


def _at(builder: Any, vector: Any, k: int) -> Any:
    return builder.extract_element(vector, ir.Constant(_PLACE, k))


def _vector(builder: Any, numbers: list[Any]) -> Any:
    """A vector of 4 or 8, of which the last numbers may be missing."""
    vector = ir.Constant(ir.VectorType(_NUMBER, 4 if len(numbers) <= 4 else 8), None)
    for k, number in enumerate(numbers):
        vector = builder.insert_element(vector, number, ir.Constant(_PLACE, k))
    return vector


def _all(builder: Any, number: Any, size: int) -> Any:
    """A vector of the same number."""
    kind = ir.VectorType(_NUMBER, size)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.Constant(_PLACE, 0))
    zeros = ir.Constant(ir.VectorType(_PLACE, size), None)
    return builder.shuffle_vector(one, ir.Constant(kind, ir.Undefined), zeros)


def _times(builder: Any, vector: Any, factor: int) -> Any:
    if factor == 1:
        return vector
    return builder.fmul(vector, ir.Constant(vector.type, [float(factor)] * vector.type.count))


partials0, partials1, partials2, partials3 = (_partials(order) for order in range(4))
