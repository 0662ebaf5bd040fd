"""Named tuples that compiled kernels are given by reference.

Numba passes a tuple by value: every array in it is seven numbers or more, and a call that hands on
a mesh and a field copies hundreds of them and costs the compiler as many instructions. Here the
numbers are written once, where Python calls a kernel, and kernels hand on where they are.
"""

from __future__ import annotations

from typing import Any, TypeVar

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_borrowed, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    models,
    register_model,
    typeof_impl,
    unbox,
)

__all__ = ["by_reference"]

_Tuple = TypeVar("_Tuple", bound=type[tuple[Any, ...]])


class Reference(types.Type):  # type: ignore[misc]
    """A named tuple whose fields kernels read one by one, and cannot take apart or return."""

    def __init__(self, made_by: Any, fields: tuple[Any, ...]) -> None:
        self.made_by, self.fields = made_by, fields
        super().__init__(f"{made_by.__module__}.{made_by.__name__}&{fields}")


def by_reference(named_tuple: _Tuple) -> _Tuple:
    """Class decorator: kernels are given its instances by reference."""

    @typeof_impl.register(named_tuple)
    def _(value: Any, context: Any) -> Reference | None:
        fields = tuple(typeof_impl(part, context) for part in value)
        return None if None in fields else Reference(named_tuple, fields)

    return named_tuple


@register_model(Reference)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    """The place of a struct of the fields."""

    def __init__(self, manager: Any, kind: Reference) -> None:
        fields = [manager.lookup(field).get_value_type() for field in kind.fields]
        super().__init__(manager, kind, ir.LiteralStructType(fields).as_pointer())


@infer_getattr
class _Fields(AttributeTemplate):  # type: ignore[misc]
    key = Reference

    def generic_resolve(self, kind: Reference, name: str) -> Any:
        names = kind.made_by._fields
        return kind.fields[names.index(name)] if name in names else None


@lower_getattr_generic(Reference)
def _field(context: Any, builder: Any, kind: Reference, place: Any, name: str) -> Any:
    k = kind.made_by._fields.index(name)
    value = builder.load(cgutils.gep_inbounds(builder, place, 0, k))
    return impl_ret_borrowed(context, builder, kind.fields[k], value)


@unbox(Reference)
def _unboxed(kind: Reference, given: Any, c: Any) -> NativeValue:
    """The struct lives in the frame of the call from Python, which holds the arrays as well."""
    builder = c.builder
    struct = c.context.get_value_type(kind).pointee
    place = cgutils.alloca_once(builder, struct)
    failed = cgutils.alloca_once_value(builder, cgutils.false_bit)
    arrays = [k for k, field in enumerate(kind.fields) if isinstance(field, types.Array)]
    for k in set(range(len(kind.fields))).difference(arrays):
        part = c.unbox(kind.fields[k], c.pyapi.tuple_getitem(given, k))
        builder.store(part.value, cgutils.gep_inbounds(builder, place, 0, k))
        with builder.if_then(part.is_error, likely=False):
            builder.store(cgutils.true_bit, failed)
    if arrays:
        # A loop: code for each of the arrays is more than most kernels are.
        size = c.pyapi.py_ssize_t
        null = ir.Constant(struct.as_pointer(), None)
        zero = ir.Constant(ir.IntType(32), 0)
        at = [null.gep([zero, ir.Constant(ir.IntType(32), k)]).ptrtoint(size) for k in arrays]
        number = [ir.Constant(size, k) for k in arrays]
        table = ir.Constant.literal_array([ir.Constant.literal_array(r) for r in (number, at)])
        table = cgutils.global_constant(builder, ".fields", table)
        given_as, bytes_as = c.pyapi.pyobj, c.pyapi.voidptr
        item = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(given_as, [given_as, size]), "PyTuple_GetItem"
        )
        # As numba unboxes arrays where it does not count references.
        adapt = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(ir.IntType(32), [given_as, bytes_as]),
            "numba_adapt_ndarray",
        )
        start = builder.bitcast(place, bytes_as)
        with cgutils.for_range(builder, ir.Constant(size, len(arrays))) as loop:
            k = builder.load(cgutils.gep(builder, table, 0, 0, loop.index))
            offset = builder.load(cgutils.gep(builder, table, 0, 1, loop.index))
            array = builder.call(item, [given, k])
            error = builder.call(adapt, [array, builder.gep(start, [offset])])
            with builder.if_then(cgutils.is_not_null(builder, error), likely=False):
                c.pyapi.err_set_string("PyExc_TypeError", "a field of the tuple is no array")
                builder.store(cgutils.true_bit, failed)
    return NativeValue(place, is_error=builder.load(failed))
