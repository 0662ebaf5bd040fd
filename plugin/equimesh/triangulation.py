"""Constrained Delaunay triangulation of a domain's boundary edges and inner points."""

from __future__ import annotations

import numpy as np
import pythoncdt as cdt
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["constrained_delaunay"]


def constrained_delaunay(
    points: NDArray[np.float64],
    boundary: NDArray[np.int64],
    constraints: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Triangulate the side of the boundary edges that lies on their left.

    Parameters
    ----------
    points
        (n, 2) distinct points.
    boundary
        (b, 2) directed edges, the domain on their left.
    constraints
        (c, 2) further edges, inside the domain, that must be kept.

    Returns
    -------
    (m, 3) int
        Counter-clockwise triangles.
    """
    edges = boundary if constraints is None else np.vstack([boundary, constraints])
    mesh = cdt.Triangulation(
        cdt.VertexInsertionOrder.AUTO, cdt.IntersectingConstraintEdges.NOT_ALLOWED, 0.0
    )
    try:
        mesh.insert_vertices(np.ascontiguousarray(points))
        mesh.insert_edges(np.ascontiguousarray(edges, np.uint32))
    except RuntimeError as error:
        cause = str(error).partition("\n")[0]  # what follows is a place in the source of CDT
        raise InputError(
            f"The boundary and the points do not make a triangulation ({cause}): "
            "remove duplicate points and crossing lines."
        ) from None
    mesh.erase_super_triangle()
    triangles = np.asarray(mesh.triangles_array()["vertices"], np.int64)
    return triangles[_left_of(triangles, boundary, len(points))]


def _left_of(
    triangles: NDArray[np.int64], boundary: NDArray[np.int64], n: int
) -> NDArray[np.bool_]:
    """(m,) which triangles are reached from the left of boundary edges without crossing one."""
    m = len(triangles)
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    key = start * n + end
    order = np.argsort(key, kind="stable")
    wall = np.sort(boundary[:, 0] * n + boundary[:, 1])
    back = np.sort(boundary[:, 1] * n + boundary[:, 0])

    def among(sorted_keys: NDArray[np.int64], keys: NDArray[np.int64]) -> NDArray[np.bool_]:
        place = np.minimum(np.searchsorted(sorted_keys, keys), len(sorted_keys) - 1)
        return np.asarray(sorted_keys[place] == keys)

    is_wall = among(wall, key) | among(back, key)
    twin_key = end * n + start
    place = np.minimum(np.searchsorted(key[order], twin_key), 3 * m - 1)
    twin = order[place]
    is_open = ((key[twin] == twin_key) & ~is_wall).reshape(-1, 3)
    across = (twin // 3).reshape(-1, 3)
    reached = np.zeros(m, bool)
    front = np.unique(np.flatnonzero(among(wall, key)) // 3)
    while front.size:
        reached[front] = True
        beyond = across[front][is_open[front]]
        front = np.unique(beyond[~reached[beyond]])
    return reached
