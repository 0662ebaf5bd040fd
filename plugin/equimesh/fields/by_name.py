"""Kernels whose code exists once, called by name instead of being copied into every caller.

Numba links the code of a callee into that of the caller, and of what this calls in turn, and the
compiler works on every copy. A name known to the linker of the process does as well.
"""

from __future__ import annotations

import hashlib
from copy import copy
from importlib import import_module
from typing import Any, NamedTuple

from llvmlite import binding
from numba.core.imputils import user_function

__all__ = ["publish"]


class _Needed(NamedTuple):
    """A kernel that others call by name; numba calls this before it loads their code from disk."""

    module: str
    name: str
    signature: Any

    @property
    def symbol(self) -> str:
        """The name: the same in every process."""
        kinds = hashlib.sha256(str(self.signature).encode()).hexdigest()[:16]
        return f"{self.module}.{self.name}.{kinds}"

    def __call__(self) -> None:
        getattr(import_module(self.module), self.name).compile(self.signature)


def publish(made: Any, signature: Any) -> None:
    """Have the kernels compiled from now on call ``made``, compiled for ``signature``, by name."""
    overload, context = made.overloads[signature], made.targetctx
    needed = _Needed(made.py_func.__module__, made.py_func.__name__, signature)
    own = overload.fndesc
    place = overload.library.get_pointer_to_function(own.llvm_func_name)
    binding.add_symbol(needed.symbol, place)
    named = copy(own)
    named.mangled_name = needed.symbol
    call = user_function(named, ())  # () are the libraries to link

    def by_name(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        # Numba keeps these on disk with the caller, and hands them on to what the caller is
        # linked into.
        context.active_code_library._reload_init.add(needed)
        return call(context, builder, sig, args)

    vars(by_name).update(signature=call.signature, libs=())
    context._defns[overload.entry_point].append(by_name, call.signature)
