"""A mesh laid into a patch of curves and points, as Gmsh's models have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh_adapters.borders import border_edges, nearest_edges

__all__ = ["SAME", "Curve", "Patch", "fitted"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

SAME = 1e-9  # of the surface's size: places that are one


@dataclass(frozen=True, eq=False)
class Curve:
    """A boundary curve as straight pieces (s, 2, 3) in its own direction.

    ``ends`` are the tags of its end points; ``loose`` (k, 3) the places of ends that have none.
    """

    tag: int
    kind: str
    pieces: Array
    ends: tuple[int, ...]
    loose: Array

    @property
    def smooth(self) -> bool:
        """Whether there is more of it between the ends of its pieces."""
        return self.kind not in ("Line", "Discrete curve")


@dataclass(frozen=True, eq=False)
class Patch:
    """The new mesh of a surface.

    ``points`` (n, 3), ``triangles`` (m, 3) in the surface's orientation, ``edges`` (k, 2) in the
    curves' directions with the curves' tags ``owners`` (k,), ``corners`` {point tag: vertex}.
    """

    points: Array
    triangles: IntArray
    edges: IntArray
    owners: IntArray
    corners: Mapping[int, int]

    @cached_property
    def places(self) -> dict[tuple[int, int], IntArray]:
        """The vertices of each curve and, under (2, 0), of the surface's inside."""
        free = np.ones(len(self.points), bool)
        free[list(self.corners.values())] = False
        found = {}
        for tag in dict.fromkeys(self.owners.tolist()):
            vertices = np.unique(self.edges[self.owners == tag])
            found[1, tag] = vertices[free[vertices]]
            free[vertices] = False
        inside = np.zeros(len(self.points), bool)
        inside[self.triangles] = True
        found[2, 0] = np.flatnonzero(free & inside)
        return found


def fitted(
    points: Array,
    triangles: IntArray,
    pieces: Sequence[Array],
    curves: Sequence[Curve],
    ends: dict[int, Array],
) -> Patch:
    """The mesh, its border edges given to the nearest curve, with a vertex at every end point.

    Where two curves meet on a straight line, or the tolerance has straightened the border, there is
    no vertex: the edge is cut there, its triangle too, which changes nothing in the surface.
    """
    if not curves:
        return Patch(points, triangles, np.zeros((0, 2), np.int64), np.zeros(0, np.int64), {})
    size = float(np.ptp(points[:, :2], axis=0).max())
    corners: dict[int, int] = {}
    for end, place in ends.items():
        edges = border_edges(triangles)
        rim = np.unique(edges)
        away = np.hypot(*(points[rim, :2] - place[:2]).T)
        k = int(away.argmin())
        if away[k] <= SAME * size and rim[k] not in corners.values():
            corners[end] = int(rim[k])
            continue
        spot = shapely.Point(place[:2])
        lines = shapely.linestrings(points[edges][..., :2])
        nearest = int(shapely.distance(lines, spot).argmin())
        a, b = edges[nearest]
        share = shapely.line_locate_point(lines[nearest], spot, normalized=True)
        share = float(np.clip(share, 1e-3, 0.999))
        points = np.concatenate([points, [points[a] + share * (points[b] - points[a])]])
        triangles = _cut(triangles, int(a), int(b), len(points) - 1)
        corners[end] = len(points) - 1
    edges = border_edges(triangles)
    all_pieces = np.concatenate(list(pieces))[..., :2]
    owner = np.repeat([curve.tag for curve in curves], [len(p) for p in pieces])
    ahead = points[edges][..., :2]
    nearest = nearest_edges(all_pieces, ahead)
    along = all_pieces[nearest]
    back = np.einsum("ki,ki->k", ahead[:, 1] - ahead[:, 0], along[:, 1] - along[:, 0]) < 0.0
    edges[back] = edges[back][:, ::-1]
    kept = {end: vertex for end, vertex in corners.items() if end > 0}
    return Patch(points, triangles, edges, owner[nearest], kept)


def _cut(triangles: IntArray, a: int, b: int, middle: int) -> IntArray:
    """Triangles with the one on the edge from a to b divided at a vertex between them."""
    for turn in range(3):
        rolled = np.roll(triangles, -turn, axis=1)
        hit = np.flatnonzero((rolled[:, 0] == a) & (rolled[:, 1] == b))
        if len(hit):
            c = rolled[hit[0], 2]
            new = triangles.copy()
            new[hit[0]] = (a, middle, c)
            return np.concatenate([new, [[middle, b, c]]])
    raise AssertionError("the edge is one of the border")
