"""Nodes on the boundary by one-dimensional equidistribution (sec. 3.1 of the paper).

The result depends on the field along each side alone, so two domains that share a side get the same
nodes on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from equimesh.domain import Sides
from equimesh.fields.compiled import allocating
from equimesh.fields.kernel import KernelField
from equimesh.fields.patch_kernels import derivatives2
from equimesh.metric import frame_at

__all__ = ["BoundaryNodes", "boundary_nodes", "side_nodes"]

# Share of the Euclidean length in y-space that a saddle's boundary edges keep where they run along
# a null direction, in which the one-dimensional error alone would ask for no nodes at all.
_NULL_SHARE = 0.6
_EDGE_CONVEX = 0.5 * math.sqrt(3.0)
_SPACING = 1.06  # of nodes on a side, in units of the lattice's edges


@dataclass(frozen=True, eq=False)
class BoundaryNodes:
    """Nodes of all sides: ``points`` (b, 2), ``side`` (b,) that each lies on, ``corner`` (b,) bool,
    ``following`` (b,) the next node along the boundary, the domain on its left."""

    points: NDArray[np.float64]
    side: NDArray[np.int64]
    corner: NDArray[np.bool_]
    following: NDArray[np.int64]


@allocating
def _density(f, child, coef, ax, ay, dx, dy, s, eight_tol, floor):
    """Edges per unit of s at a + s d that the tolerance asks for."""
    x, y = ax + s * dx, ay + s * dy
    e1x, e1y, e2x, e2y, eps, _ = frame_at(f, child, coef, x, y, eight_tol, floor)
    _, _, _, hxx, hxy, hyy = derivatives2(f, child, coef, x, y)
    det = e1x * e2y - e2x * e1y
    u, v = (e2y * dx - e2x * dy) / det, (e1x * dy - e1y * dx) / det
    length = math.sqrt(u * u + v * v)
    if eps > 0:
        return length / _EDGE_CONVEX
    bend = math.sqrt(abs(hxx * dx * dx + 2 * hxy * dx * dy + hyy * dy * dy) / eight_tol)
    return max(bend, _NULL_SHARE * length)


@allocating
def _side_nodes(f, child, coef, ax, ay, bx, by, eight_tol, floor, spacing, out):
    """Parameters s of the inner nodes of one side, into ``out``; returns how many."""
    dx, dy = bx - ax, by - ay
    n = 64
    while True:
        density = np.empty(n + 1)
        density[0] = _density(f, child, coef, ax, ay, dx, dy, 0.0, eight_tol, floor)
        total = 0.0
        largest = 0.0
        for i in range(n):
            at = (i + 1) / n
            density[i + 1] = _density(f, child, coef, ax, ay, dx, dy, at, eight_tol, floor)
            piece = 0.5 * (density[i] + density[i + 1]) / n
            total += piece
            largest = max(largest, piece)
        if n >= 65536 or largest < 0.25:
            break
        n *= 4
    count = max(1, math.ceil(total / spacing - 0.05))
    count = min(count, out.shape[0])
    target = total / count
    found = 0
    reached = 0.0
    for i in range(n):
        piece = 0.5 * (density[i] + density[i + 1]) / n
        while found < count - 1 and reached + piece >= (found + 1) * target:
            out[found] = (i + ((found + 1) * target - reached) / piece) / n
            found += 1
        reached += piece
    return found


def side_nodes(
    field: KernelField,
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    tol: float,
    floor: float,
    spacing: float = _SPACING,
) -> NDArray[np.float64]:
    """(n, 2) equidistributed nodes between a and b (see ``boundary_nodes``)."""
    flip = tuple(a) > tuple(b)  # both owners of a shared side walk it the same way
    p, q = (b, a) if flip else (a, b)
    buffer = np.empty(2_000_000)
    found = _side_nodes(
        field.frame, field.child, field.coef, p[0], p[1], q[0], q[1],
        8.0 * tol, floor, spacing, buffer,
    )  # fmt: skip
    inner = p + buffer[:found, None] * (q - p)
    return np.asarray(inner[::-1] if flip else inner)


def boundary_nodes(
    field: KernelField, sides: Sides, tol: float, floor: float, spacing: float = _SPACING
) -> BoundaryNodes:
    """Equidistribute nodes on every side (local coordinates).

    ``floor`` bounds the metric from below (see ``frame_at``); ``spacing`` is the length of an edge
    in units of the lattice's.
    """
    points, side, corner = [], [], []
    start = np.zeros(len(sides.corners), np.int64)
    count = 0
    for i, a in enumerate(sides.corners):
        inner = side_nodes(field, a, sides.corners[sides.following[i]], tol, floor, spacing)
        found = len(inner)
        start[i] = count
        points.append(np.vstack([a[None], inner]))
        side.append(np.full(found + 1, i))
        corner.append(np.arange(found + 1) == 0)
        count += found + 1
    following = np.arange(1, count + 1)
    last = np.append(start[1:], count) - 1
    following[last] = start[sides.following]
    return BoundaryNodes(
        np.concatenate(points), np.concatenate(side), np.concatenate(corner), following
    )
