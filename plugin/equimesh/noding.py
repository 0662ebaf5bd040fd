"""Noding: straight segments cut wherever they meet, with what lies within rounding made one."""

from __future__ import annotations

import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["noded"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUNDS = 50


def noded(
    points: Array, segments: IntArray, reach: float
) -> tuple[Array, IntArray, IntArray, IntArray]:
    """Cut segments so that they meet in common ends only.

    Parameters
    ----------
    points
        (n, 2) points, also such as belong to no segment.
    segments
        (s, 2) their ends.
    reach
        What is nearer than this is the same: of near points the first stays, a segment that
        passes a point that near goes through it.

    Returns
    -------
    points (n + c, 2)
        With the crossings after the given ones.
    index (n + c,)
        The point that stands for each.
    pieces (p, 2)
        Ends of the pieces, directed as their segments.
    owner (p,)
        The segment of each piece; those of a segment follow one another along it.

    Raises
    ------
    InputError
        The cuts do not come to an end.
    """
    pieces, owner = np.array(segments, np.int64).reshape(-1, 2), np.arange(len(segments))
    for _ in range(_ROUNDS):
        index = _merged(points, reach)
        pieces = index[pieces]
        long = pieces[:, 0] != pieces[:, 1]
        pieces, owner = pieces[long], owner[long]
        lines = shapely.linestrings(points[pieces])
        tree = shapely.STRtree(lines)
        which, who = _passed(points, np.flatnonzero(index == np.arange(len(index))), pieces, tree,
                             reach)  # fmt: skip
        if len(which) == 0:
            which, who, crossings = _crossed(points, pieces, lines, tree)
            points = np.vstack([points, crossings])
        if len(which) == 0:
            return points, index, pieces, owner
        pieces, owner = _cut(points, pieces, owner, which, who)
    raise InputError(
        "The constraint lines cross each other within rounding: simplify or round them."
    )


def _merged(points: Array, reach: float) -> IntArray:
    """(n,) the first of the points that are connected by steps of at most ``reach``."""
    n = len(points)
    pairs = scipy.spatial.cKDTree(points).query_pairs(reach, output_type="ndarray")
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs), np.int8), pairs.T), shape=(n, n))
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    first = np.full(count, n, np.int64)
    np.minimum.at(first, label, np.arange(n))
    return np.asarray(first[label])


def _passed(
    points: Array, alone: IntArray, pieces: IntArray, tree: shapely.STRtree, reach: float
) -> tuple[IntArray, IntArray]:
    """Pieces and the points beside them, not their ends, that they pass within ``reach``."""
    place, which = tree.query(shapely.points(points[alone]), predicate="dwithin", distance=reach)
    who = alone[place]
    between = (pieces[which] != who[:, None]).all(1)
    return which[between], who[between]


def _crossed(
    points: Array, pieces: IntArray, lines: NDArray[np.object_], tree: shapely.STRtree
) -> tuple[IntArray, IntArray, Array]:
    """Pieces, numbers of new points on them, and those points: where two of them cross."""
    i, j = tree.query(lines, predicate="intersects")
    apart = (i < j) & (pieces[i][:, :, None] != pieces[j][:, None, :]).all((1, 2))
    i, j = i[apart], j[apart]
    a, c = points[pieces[i, 0]], points[pieces[j, 0]]
    u, v = points[pieces[i, 1]] - a, points[pieces[j, 1]] - c
    w = c - a
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    share = np.clip((w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / cross, 0.0, 1.0)
    new = len(points) + np.arange(len(i))
    return np.concatenate([i, j]), np.concatenate([new, new]), a + share[:, None] * u


def _cut(
    points: Array, pieces: IntArray, owner: IntArray, which: IntArray, who: IntArray
) -> tuple[IntArray, IntArray]:
    """Pieces cut at points on them."""
    step = points[pieces[which, 1]] - points[pieces[which, 0]]
    along = ((points[who] - points[pieces[which, 0]]) * step).sum(1)
    # Every piece is a chain: its first end, the points on it in their order, its second end.
    m = len(pieces)
    number = np.concatenate([np.arange(m), which, np.arange(m)])
    rank = np.concatenate([np.full(m, -np.inf), along, np.full(m, np.inf)])
    vertex = np.concatenate([pieces[:, 0], who, pieces[:, 1]])
    order = np.lexsort((rank, number))
    number, vertex = number[order], vertex[order]
    same = number[1:] == number[:-1]
    cut = np.stack([vertex[:-1], vertex[1:]], 1)[same]
    return cut, owner[number[:-1][same]]
