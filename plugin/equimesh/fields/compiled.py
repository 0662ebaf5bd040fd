"""How the inner loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.core.compiler_lock import global_compiler_lock

from equimesh.fields.by_name import publish
from equimesh.fields.kernel_cache import KernelCache

__all__ = ["allocating", "compiled", "inlined", "outlined"]

# Division by zero gives inf or NaN. Nothing calls kernels from C, and wrappers for that take the
# compiler some seconds.
_HOW: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}
# Numba counts references to every array that a function takes from a KernelField, which costs more
# than a short walk over its cells. Most kernels neither allocate nor keep arrays, so they do
# without; the caller holds the arrays.
_UNCOUNTED: dict[str, Any] = {**_HOW, "_nrt": False}


def compiled(kernel: Callable[..., Any]) -> Any:
    """A compiled kernel that makes no arrays."""
    return _made(kernel, _UNCOUNTED)


def allocating(kernel: Callable[..., Any]) -> Any:
    """A compiled kernel that may make arrays, or hand them on to one that does."""
    return _made(kernel, _HOW)


def _made(kernel: Callable[..., Any], how: dict[str, Any]) -> Any:
    made = njit(**how)(kernel)
    made._cache = KernelCache(kernel)
    template = made.get_call_template

    def by_types(args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        """Numba would compile a kernel once more for every number that it is called with."""
        return template(
            tuple(types.unliteral(kind) for kind in args),
            {name: types.unliteral(kind) for name, kind in kws.items()},
        )

    made.get_call_template = by_types
    return made


# For parts of one kernel that are not worth the compiler's time for a kernel of their own.
inlined = njit(**_UNCOUNTED, inline="always")


def outlined(kernel: Callable[..., Any]) -> Any:
    """A compiled kernel whose code those that call it do not take in.

    Numba gives each kernel a copy of all that it calls, and of all that this calls, and the
    compiler works on every copy. Large kernels with many callers exist once and are found by name.
    """
    made = compiled(kernel)
    compile_whole, known = made.compile, set[Any]()

    def compile_once(signature: Any) -> Any:
        with global_compiler_lock:
            entry = compile_whole(signature)
            if signature not in known:
                publish(made, signature)
                known.add(signature)
        return entry

    made.compile = compile_once
    return made
