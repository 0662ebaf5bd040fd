"""The border of a mesh, and which edge of an old border a new one continues."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

__all__ = ["border_edges", "nearest_edges", "triangles_beside"]


def border_edges(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k, 2) edges of one triangle only, in its direction.

    >>> border_edges(np.array([[0, 1, 2], [0, 2, 3]]))
    array([[0, 1],
           [1, 2],
           [2, 3],
           [3, 0]])
    """
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, inverse, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return edges[count[inverse.reshape(-1)] == 1]


def nearest_edges(old: NDArray[np.float64], new: NDArray[np.float64]) -> NDArray[np.int64]:
    """(k,) for each new edge (k, 2, d) the old one (j, 2, d) nearest to its middle.

    >>> old = np.array([[[0, 0], [4, 0]], [[4, 0], [4, 4.0]]])
    >>> nearest_edges(old, np.array([[[0.1, 0], [1, 0.1]], [[4, 2], [4, 3]]]))
    array([0, 1])
    """
    start, along = old[:, 0], old[:, 1] - old[:, 0]
    length = np.sqrt((along * along).sum(axis=1))
    spots = new.mean(axis=1)
    # No edge is nearer than the one of the nearest middle, unless its own middle is in this reach.
    tree = cKDTree(old.mean(axis=1))
    reach = tree.query(spots)[0] + 0.5 * length.max()
    near = tree.query_ball_point(spots, reach * (1.0 + 1e-9), return_sorted=True)
    count = np.array([len(some) for some in near])
    edge = np.concatenate([np.asarray(some, np.int64) for some in near])
    spot = np.repeat(np.arange(len(spots)), count)
    offset = spots[spot] - start[edge]
    share = (offset * along[edge]).sum(axis=1) / np.maximum(length[edge] ** 2, 1e-300)
    away = offset - np.clip(share, 0.0, 1.0)[:, None] * along[edge]
    order = np.lexsort((edge, (away * away).sum(axis=1), spot))
    return np.asarray(edge[order[np.cumsum(count) - count]])


def triangles_beside(triangles: NDArray[np.int64], edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) the triangle with each directed edge (k, 2) of the border.

    >>> triangles_beside(np.array([[0, 1, 2], [0, 2, 3]]), np.array([[2, 3], [1, 2]]))
    array([1, 0])
    """
    count = int(triangles.max()) + 1
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    keys = sides[:, 0] * count + sides[:, 1]
    order = np.argsort(keys)
    found = order[np.searchsorted(keys[order], edges[:, 0] * count + edges[:, 1])]
    return np.asarray(found // 3)
