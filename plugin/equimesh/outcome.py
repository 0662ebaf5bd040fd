"""From the optimiser's mesh back to the user's coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.domain import Sides
from equimesh.fields.base import Field
from equimesh.first_mesh import FirstMesh
from equimesh.frame import Frame
from equimesh.optimise.mesh import FIXED, GONE, SLIDES, Mesh
from equimesh.result import Boundary

__all__ = ["user_mesh"]


def user_mesh(
    mesh: Mesh, start: FirstMesh, frame: Frame, surface: Field
) -> tuple[NDArray[np.float64], NDArray[np.int64], Boundary, NDArray[np.int64]]:
    """Points (n, 3), counter-clockwise triangles (m, 3), tagged boundary, and each triangle's slot.

    Heights come from the surface itself. Corners keep the coordinates they were given, and vertices
    on an upright side that side's own coordinate to the last bit.
    """
    slots = np.flatnonzero(mesh.tv[:, 0] >= 0)
    live = np.flatnonzero(mesh.kind != GONE)
    index = np.full(len(mesh.kind), -1, np.int64)
    index[live] = np.arange(len(live))
    triangles = index[mesh.tv[slots]]
    plane = frame.to_user(np.stack([mesh.x[live], mesh.y[live]], 1))
    sides = start.sides
    kind, side = mesh.kind[live], mesh.side[live].astype(np.int64)
    first = live < len(start.corner_of)
    corner = np.full(len(live), -1, np.int64)
    corner[first] = start.corner_of[live[first]]
    fixed = (corner >= 0) & (kind == FIXED)
    plane[fixed] = sides.corners[corner[fixed]]
    sliding = np.flatnonzero(kind == SLIDES)
    a = sides.corners[side[sliding]]
    b = sides.corners[sides.following[side[sliding]]]
    for axis in range(2):
        upright = a[:, axis] == b[:, axis]
        plane[sliding[upright], axis] = a[upright, axis]
    z = surface.value(plane[:, 0], plane[:, 1]) + mesh.w[live]
    lost = ~np.isfinite(z)
    z[lost] = mesh.z[live][lost]  # on an outline drawn within the tolerance, beside the surface
    border = mesh.tn[slots] < 0
    row, k = np.nonzero(border)
    edges = np.stack([triangles[row, k], triangles[row, (k + 1) % 3]], 1)
    own = np.where(kind[edges[:, 0]] == SLIDES, side[edges[:, 0]], side[edges[:, 1]])
    both = (kind[edges[:, 0]] != SLIDES) & (kind[edges[:, 1]] != SLIDES)
    own[both] = _side_between(sides, corner, side, edges[both])
    if frame.determinant < 0.0:
        triangles, edges = triangles[:, ::-1], edges[:, ::-1]
    points = np.ascontiguousarray(np.column_stack([plane, z]))
    boundary = Boundary(edges, sides.tags[own], sides.names)
    return points, np.ascontiguousarray(triangles), boundary, slots


def _side_between(
    sides: Sides,
    corner: NDArray[np.int64],
    side: NDArray[np.int64],
    edges: NDArray[np.int64],
) -> NDArray[np.int64]:
    """The side of an edge between two corners: the one that leads from its first to its second.

    Where rings touch, sides of both start at the same place.
    """
    start, end = corner[edges[:, 0]], corner[edges[:, 1]]
    own = np.where(start >= 0, start, side[edges[:, 0]])
    known = np.flatnonzero((start >= 0) & (end >= 0))
    _, place = np.unique(sides.corners, axis=0, return_inverse=True)
    place = place.ravel()
    key = place * len(place) + place[sides.following]
    order = np.argsort(key)
    wanted = place[start[known]] * len(place) + place[end[known]]
    found = order[np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)]
    hit = key[found] == wanted
    own[known[hit]] = found[hit]
    return np.asarray(own)
