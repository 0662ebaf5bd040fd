"""From the optimiser's mesh back to the user's coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.domain import Sides
from equimesh.fields.base import Field
from equimesh.first_mesh import FirstMesh
from equimesh.frame import Frame
from equimesh.optimise.mesh import FIXED, GONE, SLIDES, Mesh
from equimesh.result import Boundary, Constraints

__all__ = [
    "border_of", "corners_of", "numbers_of", "tagged_constraints", "user_mesh", "walls_of",
]  # fmt: skip


def user_mesh(
    mesh: Mesh,
    start: FirstMesh,
    frame: Frame,
    surface: Field,
    unit: float = 1.0,
    lowest: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[np.int64], Boundary, NDArray[np.int64]]:
    """Points (n, 3), counter-clockwise triangles (m, 3), tagged boundary, and each triangle's slot.

    Heights come from the surface itself. Corners keep the coordinates they were given, and vertices
    on an upright side that side's own coordinate to the last bit. The mesh counts heights from
    ``lowest`` in units of ``unit``.
    """
    slots = np.flatnonzero(mesh.tv[:, 0] >= 0)
    live = np.flatnonzero(mesh.kind != GONE)
    index = numbers_of(mesh)
    triangles = index[mesh.tv[slots]]
    plane = frame.to_user(np.stack([mesh.x[live], mesh.y[live]], 1))
    sides = start.sides
    kind, side = mesh.kind[live], mesh.side[live].astype(np.int64)
    corner = corners_of(mesh, start)[live]
    fixed = corner >= 0
    plane[fixed] = sides.vertices[corner[fixed]]
    sliding = np.flatnonzero(kind == SLIDES)
    ends = sides.segments[side[sliding]]
    for axis in range(2):
        upright = ends[:, axis] == ends[:, axis + 2]
        plane[sliding[upright], axis] = ends[upright, axis]
    z = surface.value(plane[:, 0], plane[:, 1]) + unit * mesh.w[live]
    lost = ~np.isfinite(z)
    z[lost] = (
        lowest + unit * mesh.z[live][lost]
    )  # on an outline drawn within the tolerance, beside the surface
    border, own = border_of(mesh, start)
    edges = index[border]
    if frame.determinant < 0.0:
        triangles, edges = triangles[:, ::-1], edges[:, ::-1]
    points = np.ascontiguousarray(np.column_stack([plane, z]))
    boundary = Boundary(edges, sides.tags[own], sides.names)
    return points, np.ascontiguousarray(triangles), boundary, slots


def tagged_constraints(mesh: Mesh, start: FirstMesh) -> Constraints:
    """Edges and vertices that constraints asked for, in the numbers of ``user_mesh``."""
    sides, lines, index = start.sides, start.sides.lines, numbers_of(mesh)
    corner = corners_of(mesh, start)
    walls, own = walls_of(mesh, start)
    border, side = border_of(mesh, start)
    along, edge_tags = _tagged(own, lines.edge_tags)
    beside, side_tags = _tagged(side, lines.side_tags)
    _, place = np.unique(sides.vertices, axis=0, return_inverse=True)
    place = place.ravel()
    vertex = np.full(len(place), -1, np.int64)
    fixed = np.flatnonzero(corner >= 0)
    vertex[place[corner[fixed]]] = index[fixed]
    return Constraints(
        edges=index[np.vstack([walls[along], border[beside]])],
        tags=np.concatenate([edge_tags, side_tags]),
        names=lines.names,
        points=vertex[place[lines.point_tags[:, 0]]],
        point_tags=lines.point_tags[:, 1],
    )


def _tagged(
    own: NDArray[np.int64], tags: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places in ``own`` (n,) and names, for every row (line, name) of ``tags``."""
    order = np.argsort(own, kind="stable")
    first = np.searchsorted(own[order], tags[:, 0], "left")
    count = np.searchsorted(own[order], tags[:, 0], "right") - first
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return order[np.repeat(first, count) + step], np.repeat(tags[:, 1], count)


def numbers_of(mesh: Mesh) -> NDArray[np.int64]:
    """(v,) the number of every vertex among the live ones."""
    return np.asarray(np.cumsum(mesh.kind != GONE) - 1)


def corners_of(mesh: Mesh, start: FirstMesh) -> NDArray[np.int64]:
    """(v,) which of the sides' vertices every vertex is, -1 for none."""
    corner = np.full(len(mesh.kind), -1, np.int64)
    corner[: len(start.corner_of)] = start.corner_of
    corner[mesh.kind != FIXED] = -1
    return corner


def border_of(mesh: Mesh, start: FirstMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(b, 2) vertices of the border edges and (b,) the side that each lies on."""
    slots = np.flatnonzero(mesh.tv[:, 0] >= 0)
    row, k = np.nonzero(mesh.tn[slots] < 0)
    edges = np.stack([mesh.tv[slots[row], k], mesh.tv[slots[row], (k + 1) % 3]], 1)
    slides = mesh.kind[edges] == SLIDES
    own = np.where(slides[:, 0], mesh.side[edges[:, 0]], mesh.side[edges[:, 1]])
    both = ~slides.any(1)
    own[both] = _side_between(start.sides, corners_of(mesh, start), mesh.side, edges[both])
    return edges, own


def walls_of(mesh: Mesh, start: FirstMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(w, 2) vertices of inner edges that must stay and (w,) the constraint line of each."""
    t, k = np.nonzero((mesh.wall == 1) & (mesh.tn > np.arange(len(mesh.tn))[:, None]))
    alive = mesh.tv[t, 0] >= 0
    t, k = t[alive], k[alive]
    walls = np.stack([mesh.tv[t, k], mesh.tv[t, (k + 1) % 3]], 1)
    return walls, _line_of(mesh, start.sides, corners_of(mesh, start), walls)


def _line_of(
    mesh: Mesh, sides: Sides, corner: NDArray[np.int64], walls: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(w,) the constraint line of every wall: where a vertex slides its own, else by both ends."""
    slides = mesh.kind[walls] == SLIDES
    own = np.where(slides[:, 0], mesh.side[walls[:, 0]], mesh.side[walls[:, 1]]) - len(
        sides.corners
    )
    both = ~slides.any(1)
    _, place = np.unique(sides.vertices, axis=0, return_inverse=True)
    place = place.ravel()
    ends, wanted = np.sort(place[sides.lines.edges], 1), np.sort(place[corner[walls[both]]], 1)
    key = ends[:, 0] * len(place) + ends[:, 1]
    order = np.argsort(key)
    own[both] = order[np.searchsorted(key[order], wanted[:, 0] * len(place) + wanted[:, 1])]
    return np.asarray(own)


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
