"""Symmetric tensors as other programs store them.

Inside equimesh a field of tensors is one array (n, 2, 2) or (n, 3, 3). Elsewhere only some of the
entries are kept, in an order that differs from program to program:

=========  ==================  ====================================
layout     in the plane        in space
=========  ==================  ====================================
``medit``  m11 m12 m22         m11 m12 m22 m13 m23 m33
``mmg``    m11 m12 m22         m11 m12 m13 m22 m23 m33
``vtk``    nine, as in space   m11 m22 m33 m12 m23 m13
``rows``   nine, as in space   m11 m12 m13 m21 m22 m23 m31 m32 m33
=========  ==================  ====================================

``medit`` is the order of ``.sol`` files, ``mmg`` that of Mmg's functions, ``rows`` that of Gmsh's
views and of VTK's full tensors, ``vtk`` that of VTK's symmetric ones. The last two know only
space: a tensor in the plane is stored there with m33 = 1, and m13 = m23 = 0.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError

__all__ = ["Layout", "in_plane", "in_space", "pack", "unpack"]

Layout: TypeAlias = Literal["medit", "mmg", "vtk", "rows"]

# Row and column of each stored entry, by layout and dimension.
ENTRIES: dict[tuple[str, int], tuple[tuple[int, int], ...]] = {
    ("medit", 2): ((0, 0), (0, 1), (1, 1)),
    ("medit", 3): ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)),
    ("mmg", 2): ((0, 0), (0, 1), (1, 1)),
    ("mmg", 3): ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)),
    ("vtk", 3): ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)),
    ("rows", 3): tuple((i, j) for i in range(3) for j in range(3)),
}


def pack(tensors: ArrayLike, layout: Layout) -> NDArray[np.float64]:
    """(n, 2, 2) or (n, 3, 3) symmetric tensors as (n, k) stored entries.

    Raises InputError for another shape, and for tensors that are not symmetric to 12 digits.

    >>> pack([[[1, 2, 3], [2, 4, 5], [3, 5, 6]]], "medit")
    array([[1., 2., 4., 3., 5., 6.]])
    >>> pack([[[1, 2, 3], [2, 4, 5], [3, 5, 6]]], "mmg")
    array([[1., 2., 3., 4., 5., 6.]])
    """
    full = np.asarray(tensors, np.float64)
    if full.ndim != 3 or full.shape[1:] not in ((2, 2), (3, 3)):
        raise InputError(f"Tensors have the shape {full.shape}: give (n, 2, 2) or (n, 3, 3).")
    turned = full.transpose(0, 2, 1)
    if not np.allclose(full, turned, rtol=0.0, atol=1e-12 * np.abs(full).max(initial=0.0)):
        raise InputError("The tensors are not symmetric: give (T + T^t) / 2.")
    dimension = full.shape[1]
    if (layout, dimension) not in ENTRIES:
        full, dimension = in_space(full), 3
    rows, columns = zip(*ENTRIES[layout, dimension], strict=True)
    return np.ascontiguousarray(full[:, rows, columns])


def unpack(stored: ArrayLike, layout: Layout) -> NDArray[np.float64]:
    """(n, k) stored entries as (n, d, d) symmetric tensors; k tells d = 2 or 3.

    Raises InputError where no tensor has that many entries in this layout.

    >>> unpack([[1, 2, 4]], "medit")
    array([[[1., 2.],
            [2., 4.]]])
    """
    flat = np.asarray(stored, np.float64)
    for dimension in (2, 3):
        entries = ENTRIES.get((layout, dimension), ())
        if flat.ndim == 2 and flat.shape[1] == len(entries):
            full = np.empty((len(flat), dimension, dimension))
            for k, (i, j) in enumerate(entries):
                full[:, i, j] = flat[:, k]
                if layout != "rows":
                    full[:, j, i] = flat[:, k]
            return full
    raise InputError(
        f"Stored tensors have the shape {flat.shape}, which is none of the layout {layout!r}."
    )


def in_space(tensors: NDArray[np.float64], normal: float = 1.0) -> NDArray[np.float64]:
    """(n, 2, 2) tensors of the plane as (n, 3, 3), with ``normal`` across it."""
    full = np.zeros((len(tensors), 3, 3))
    full[:, :2, :2] = tensors
    full[:, 2, 2] = normal
    return full


def in_plane(tensors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3, 3) tensors restricted to the directions of x and y, (n, 2, 2)."""
    return np.ascontiguousarray(tensors[:, :2, :2])
