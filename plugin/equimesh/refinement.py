"""Large meshes from smaller ones: every triangle becomes four by the middles of its edges.

So does red refinement of finite elements (Bank, Sherman and Weiser 1983). The error of a quadratic
falls to a quarter with it: an optimal mesh for four times the tolerance becomes nearly one for the
tolerance, with no more dislocations than it had.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.base import Field
from equimesh.first_mesh import FirstMesh, heights_at
from equimesh.frame import Frame
from equimesh.locality import curve_order
from equimesh.optimise.mesh import FREE, GONE, HEIGHTS, SLIDES, build, compact
from equimesh.outcome import border_of, corners_of, numbers_of, walls_of

__all__ = ["refined"]

_ROOM = 0.3  # share of spare slots: few vertices will come


def refined(start: FirstMesh, surface: Field, frame: Frame, aim: float) -> FirstMesh:
    """The mesh with four times the triangles, to be optimised for ``aim``.

    Middles of edges on sides and constraints slide there; where vertices may leave the surface,
    heights above it fall to a quarter, as the tolerance does.
    """
    mesh, sides = start.mesh, start.sides
    live, index = mesh.kind != GONE, numbers_of(mesh)
    old, triangles, kind, side = compact(mesh)
    n = len(old)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], 2).reshape(-1, 2)
    keys, edge = np.unique(_keys(ends, n), return_inverse=True)
    low, high = keys // n, keys % n

    def with_middles(of: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.concatenate([of, 0.5 * (of[low] + of[high])])

    def middle_of(edges: NDArray[np.int64]) -> NDArray[np.int64]:
        return n + np.searchsorted(keys, _keys(index[edges], n))

    points, above = with_middles(old[:, :2]), 0.25 * with_middles(mesh.w[live])
    kind = np.concatenate([kind, np.full(len(keys), FREE, np.int8)])
    side = np.concatenate([side, np.zeros(len(keys), np.int64)])
    corner = np.concatenate([corners_of(mesh, start)[live], np.full(len(keys), -1)])
    border, own = border_of(mesh, start)
    walls, line = walls_of(mesh, start)
    for edges, row in ((border, own), (walls, len(sides.corners) + line)):
        kind[middle_of(edges)], side[middle_of(edges)] = SLIDES, row
    halves = np.vstack([np.stack([end, middle_of(walls)], 1) for end in index[walls].T])

    # Near in the plane is to be near in memory.
    order = curve_order(points)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    quarters = place[_quarters(triangles, n + edge.reshape(-1, 3))]
    points, above, corner = points[order], above[order], corner[order]
    quarters = quarters[curve_order(points[quarters].mean(1))]

    z = heights_at(surface, sides, frame, points, corner) + above
    fine = build(
        np.column_stack([points, z]), quarters, kind[order], side[order], mesh.sides, place[halves],
        room=_ROOM,
    )  # fmt: skip
    fine.w[: len(above)] = above
    fine.count[HEIGHTS], fine.hinge[0] = mesh.count[HEIGHTS], mesh.hinge[0]
    return FirstMesh(fine, sides, corner, aim, least=math.inf)


def _quarters(triangles: NDArray[np.int64], middles: NDArray[np.int64]) -> NDArray[np.int64]:
    """(4 m, 3) from corners (m, 3) and the middles (m, 3) of the edges that start there."""
    a, b, c = triangles.T
    ab, bc, ca = middles.T
    pieces = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
    return np.vstack([np.stack(piece, 1) for piece in pieces])


def _keys(ends: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """(e,) one number for each edge (e, 2), in either direction, between ``n`` vertices."""
    return np.asarray(ends.min(1) * n + ends.max(1))
