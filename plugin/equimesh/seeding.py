"""Vertices of the first mesh: boundary nodes and the transported lattice between them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.boundary import BoundaryNodes
from equimesh.domain import Sides, strips_of
from equimesh.fields.kernel import KernelField
from equimesh.front import sow
from equimesh.ground import Front, Ground
from equimesh.pointtree import insert, make_tree
from equimesh.rows import grow_rows

__all__ = ["lattice_points"]

# A lattice vertex nearer to the boundary than this (lattice spacings) is left to the boundary's
# own.
_GAP = 0.2
# Two vertices of fronts that meet closer than this are one.
_MERGE = 0.65
# A saddle's lattice is its own image after this boost, and one turned by an angle less than that
# meets the boundary otherwise.
_PERIOD = math.asinh(0.5)
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def lattice_points(
    field: KernelField,
    sides: Sides,
    nodes: BoundaryNodes,
    tol: float,
    floor: float,
    expected: int,
    *,
    gap: float = _GAP,
    merge: float = _MERGE,
    turn: int = 0,
    rows: bool = False,
    start: NDArray[np.float64] | None = None,
    obstacles: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Interior vertices of the lattice for tolerance ``tol`` (local coordinates).

    Parameters
    ----------
    expected
        About how many vertices will be laid; three times as many are the limit.
    turn
        Which of the quasi-random seeds comes first, and which of a quasi-random sequence of gauges
        (rotations, or boosts where the surface is a saddle) all seeds have.
    rows
        Whether saddles get rows first (``rows.py``): for large lattices that do not fit.
    start
        (k, 3) places and gauges to try as seeds before the quasi-random ones.
    obstacles
        (w, 4) segments inside the domain to keep away from as from the boundary.

    Returns
    -------
    (n, 2) float
    """
    points, neighbours = _obstacles(nodes, np.empty((0, 4)) if obstacles is None else obstacles)
    b = len(points)
    capacity = b + 3 * expected + 1000
    px, py = np.empty(capacity), np.empty(capacity)
    px[:b], py[:b] = points.T
    tree, link, used = make_tree(capacity)
    low, high = sides.corners.min(0), sides.corners.max(0)
    extent = float((high - low).max())
    box = np.array([low[0], low[1], extent * (1.0 + 1e-9)])
    for i in range(b):
        insert(tree, link, used, box, px, py, i)
    segments = np.hstack([sides.corners, sides.corners[sides.following]])
    ground = Ground(
        field.frame, field.child, field.coef, 8.0 * tol, floor, segments, *strips_of(segments),
        neighbours, b, gap, merge,
    )  # fmt: skip
    front = Front(
        px, py, np.empty((capacity, 4)), np.zeros(capacity, np.int8), tree, link, used, box
    )
    seeds = _halton(max(64, 2 * expected, turn + 1)) * (high - low) + low
    seeds = np.hstack([seeds, np.zeros((len(seeds), 1))])
    seeds[:, 2] = math.fmod(_GOLDEN * turn, 1.0) * _PERIOD
    seeds[[0, turn]] = seeds[[turn, 0]]
    if start is not None:
        seeds = np.vstack([start, seeds])
    count = grow_rows(ground, front, b, seeds) if rows else b
    count = sow(ground, front, count, seeds)
    return np.stack([px[b:count], py[b:count]], 1)


def _obstacles(
    nodes: BoundaryNodes, segments: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(b, 2) points of the boundary and of segments, and (b, 2) the neighbours of each."""
    n, w = len(nodes.points), len(segments)
    previous = np.empty(n, np.int64)
    previous[nodes.following] = np.arange(n)
    ends = n + np.concatenate([np.arange(w, 2 * w), np.arange(w)])
    return (
        np.vstack([nodes.points, segments[:, :2], segments[:, 2:]]),
        np.vstack([np.stack([nodes.following, previous], 1), np.stack([ends, ends], 1)]),
    )


def _halton(n: int) -> NDArray[np.float64]:
    """(n, 2) points of the Halton sequence in bases 2 and 3, the centre of the box first."""
    out = np.empty((n, 2))
    for axis, base in enumerate((2, 3)):
        index = np.arange(1, n + 1)
        result, weight = np.zeros(n), 1.0 / base
        while index.any():
            result += weight * (index % base)
            index //= base
            weight /= base
        out[:, axis] = result
    out[0] = 0.5
    return out
