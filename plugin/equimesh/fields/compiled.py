"""How the inner loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types

__all__ = ["compiled", "inlined"]

# Numba counts references to every array that a function takes from a KernelField, which costs more
# than a short walk over its cells. Kernels neither allocate nor keep arrays, so they do without
# (``_nrt``); the caller holds the arrays. Division by zero gives inf or NaN. Nothing calls them
# from C, and wrappers for that take the compiler some seconds.
_HOW: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "_nrt": False,
    "no_cfunc_wrapper": True,
}


def compiled(kernel: Callable[..., Any]) -> Any:
    """A compiled kernel."""
    made = njit(**_HOW)(kernel)
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
inlined = njit(**_HOW, inline="always")
