"""How the inner loops are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit

__all__ = ["compiled", "inlined"]

# Numba counts references to every array of a KernelField in every function that is given one, which
# costs more than a short walk over its cells. Kernels neither allocate nor keep arrays, so they do
# without (``_nrt``); the caller holds the arrays. Division by zero gives inf or NaN.
_HOW: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}

compiled = njit(**_HOW)

# For parts of a kernel that are given the whole field: passing it on means copying it.
inlined = njit(**_HOW, inline="always")
