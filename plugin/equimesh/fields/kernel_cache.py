"""Compiled kernels on disk, each good as long as all that it calls is what it was.

Numba itself looks at the file that a kernel is written in, and would go on with the old code of
what it calls from other files.
"""

from __future__ import annotations

import functools
import gc
import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import FunctionCache
from numba.core.extending import _Intrinsic
from numba.core.registry import CPUDispatcher

__all__ = ["KernelCache", "digest"]


class KernelCache:
    """Numba's cache of one kernel, its entries told apart by ``digest`` as well.

    Files are looked for when the kernel is first called: most kernels of most programs never are.
    """

    def __init__(self, kernel: Callable[..., Any]) -> None:
        self._kernel = kernel

    @functools.cached_property
    def _files(self) -> FunctionCache:
        return _Files(self._kernel)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._files, name)


class _Files(FunctionCache):  # type: ignore[misc]
    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return (*super()._index_key(sig, codegen), digest(self._py_func))

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Also what is compiled with a kernel from disk in it needs what that calls by name."""
        with _uncollected():
            loaded = super().load_overload(sig, target_context)
        if loaded is not None:
            loaded.library._reload_init.update(loaded.reload_init)
        return loaded


@contextmanager
def _uncollected() -> Iterator[None]:
    """Within it nothing is looked through for garbage: of what a kernel brings there is much, all
    of it to stay, and looking through it while it comes takes as long as reading it."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


@functools.cache
def digest(kernel: Callable[..., Any]) -> str:
    """A number for the code of a kernel, of all that it calls, and for the constants they know."""
    said, met, left = hashlib.sha256(), {kernel}, [kernel]
    while left:
        one = left.pop()
        said.update(one.__code__.co_code)
        for part in _constants(one.__code__):
            said.update(repr(part).encode())
        for part in _known(one):
            if isinstance(part, CPUDispatcher):
                if part.py_func not in met:
                    met.add(part.py_func)
                    left.append(part.py_func)
            elif isinstance(part, _Intrinsic):
                said.update(_written(part._defn.__code__.co_filename))
            elif isinstance(part, np.ndarray):
                said.update(part.tobytes())
            elif isinstance(part, (int, float, str, tuple, dict)):
                said.update(repr(part).encode())
    return said.hexdigest()


@functools.cache
def _written(file: str) -> bytes:
    """The file that an intrinsic is made in: what it generates may depend on all that is there."""
    return Path(file).read_bytes()


def _constants(code: CodeType) -> Iterator[Any]:
    """Constants in a function, without functions within it, whose code has its place for a name."""
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield part.co_code
            yield from _constants(part)
        else:
            yield part


def _known(function: Callable[..., Any]) -> Iterator[Any]:
    """What the names in a function stand for, in its module or in one that it names."""
    names, here = function.__code__.co_names, function.__globals__
    for name in names:
        part = here.get(name)
        yield part
        if isinstance(part, ModuleType):
            yield from (vars(part).get(other) for other in names)
