"""The arrays that the kernels of a triangle surface work on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.base import Array, IntArray
from equimesh.fields.compiled import allocating
from equimesh.fields.kernel import SURFACE, KernelField
from equimesh.fields.surface_topology import opposites

__all__ = ["index_surface"]

Int32Array = NDArray[np.int32]

_PER_CELL = 2.0  # vertices


def index_surface(points: Array, triangles: IntArray, slack: float) -> KernelField:
    """Sort a surface by the cells of a grid and list the triangles over every cell.

    ``points`` (n, 3), ``triangles`` (m, 3) counter-clockwise, local coordinates; every point should
    be a corner. The numbering changes: answers of kernels name sorted vertices and triangles.
    """
    low = points[:, :2].min(axis=0)
    width, height = np.ptp(points[:, :2], axis=0)
    cells = max(len(points) / _PER_CELL, 1.0)
    # square cells, at most as many along one axis as there are in all
    cell = max(math.sqrt(width * height / cells), max(width, height) / cells)
    columns, rows = int(width / cell) + 1, int(height / cell) + 1
    frame = np.array([low[0], low[1], 1.0 / cell, columns, rows, slack])

    at = _cell_of(points[:, :2], frame)
    order = np.argsort(at, kind="stable")
    rank = np.argsort(order)
    points = np.ascontiguousarray(points[order])
    vertex_start = _starts(at, columns * rows)

    triangles = rank[triangles]
    middle = points[triangles, :2].mean(axis=1)
    triangles = triangles[np.argsort(_cell_of(middle, frame), kind="stable")]
    joined = np.hstack([triangles, opposites(triangles).reshape(-1, 3)]).astype(np.int32)
    count = np.zeros(columns * rows + 1, np.int32)
    _list_triangles(points, joined, frame, count, np.zeros(0, np.int32))
    start = np.concatenate([[0], np.cumsum(count[:-1])]).astype(np.int32)
    items = np.zeros(start[-1], np.int32)
    _list_triangles(points, joined, frame, start.copy(), items)
    return KernelField(
        SURFACE,
        frame=frame,
        points=points,
        triangles=joined,
        vertex_start=vertex_start,
        triangle_start=start,
        triangle_items=items,
    )


def _cell_of(points: Array, frame: Array) -> IntArray:
    """(n,) cells, the grid closed to the right and above."""
    place = ((points - frame[:2]) * frame[2]).astype(np.int64)
    column, row = np.clip(place, 0, frame[3:5].astype(np.int64) - 1).T
    return np.asarray(row * int(frame[3]) + column)


def _starts(cell: IntArray, cells: int) -> Int32Array:
    """(cells + 1,) where the items of each cell start in a list sorted by cell."""
    return np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=cells))]).astype(np.int32)


@allocating
def _list_triangles(
    points: Array, triangles: Int32Array, frame: Array, at: Int32Array, items: Int32Array
) -> None:
    """Add to ``at[cell]`` the number of triangles over a cell, and list these if there are items.

    Every row of cells is crossed by the part of the triangle between its two lines; a margin takes
    in the cells that the triangle only touches.
    """
    per_cell, columns, rows = frame[2], int(frame[3]), int(frame[4])
    margin = 1e-9 + frame[5] * per_cell
    u, v = np.zeros(3), np.zeros(3)
    for t in range(len(triangles)):
        for k in range(3):
            u[k] = (points[triangles[t, k], 0] - frame[0]) * per_cell
            v[k] = (points[triangles[t, k], 1] - frame[1]) * per_cell
        first = max(math.floor(v.min() - margin), 0)
        last = min(math.floor(v.max() + margin), rows - 1)
        for row in range(first, last + 1):
            low, high = row - margin, row + 1 + margin
            left, right = math.inf, -math.inf
            for k in range(3):
                n = (k + 1) % 3
                if low <= v[k] <= high:
                    left, right = min(left, u[k]), max(right, u[k])
                for line in (low, high):
                    if min(v[k], v[n]) < line < max(v[k], v[n]):
                        cut = u[k] + (line - v[k]) / (v[n] - v[k]) * (u[n] - u[k])
                        left, right = min(left, cut), max(right, cut)
            if left > right:
                continue
            begin = max(math.floor(left - margin), 0)
            end = min(math.floor(right + margin), columns - 1)
            for cell in range(row * columns + begin, row * columns + end + 1):
                if len(items) > 0:
                    items[at[cell]] = t
                at[cell] += 1
