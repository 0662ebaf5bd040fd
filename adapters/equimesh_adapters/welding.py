"""Sewing a triangle soup: vertices with equal coordinates become one."""

from __future__ import annotations

import numpy as np

from equimesh.formats import TriangleMesh

__all__ = ["welded"]


def welded(mesh: TriangleMesh) -> TriangleMesh:
    """The same triangles with exact duplicates of vertices merged, in order of first appearance.

    No vertex moves: only equal coordinates merge. Triangles that lose a corner by it had no area
    and go.

    >>> import numpy as np
    >>> soup = TriangleMesh(
    ...     np.array([[0, 0], [1, 0], [0, 1], [1, 0], [1, 1], [0, 1.0]]),
    ...     np.array([[0, 1, 2], [3, 4, 5]]),
    ... )
    >>> welded(soup).triangles
    array([[0, 1, 2],
           [1, 3, 2]])
    """
    _, first, inverse = np.unique(mesh.points, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    triangles = rank[inverse.reshape(-1)[mesh.triangles]]
    a, b, c = triangles.T
    return TriangleMesh(mesh.points[first[order]], triangles[(a != b) & (b != c) & (c != a)])
