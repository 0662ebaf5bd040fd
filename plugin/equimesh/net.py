"""A net of straight paths through a plane domain: one anchor in each triangle of a triangulation.

Every point of the domain sees the anchor of the triangle that it lies in, and neighbouring anchors
see each other by way of the middle of their common edge. So a polyline inside the domain leads from
any point to any other, whatever the outline and its holes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from equimesh.domain import domain_geometry
from equimesh.errors import InputError
from equimesh.frame import Frame
from equimesh.triangulation import constrained_delaunay

__all__ = ["Net", "as_polygon"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


def as_polygon(domain: Any) -> shapely.Polygon:
    """A rectangle (xmin, ymin, xmax, ymax) or a shapely polygon of one piece, checked.

    Raises
    ------
    InputError
        Where it is empty, not finite, crosses itself or has several pieces.
    """
    geometry = domain_geometry(domain)
    if isinstance(geometry, shapely.MultiPolygon) and len(geometry.geoms) == 1:
        geometry = geometry.geoms[0]
    if not isinstance(geometry, shapely.Polygon):
        raise InputError(
            "The domain has several pieces, each with a transform of its own: give one at a time."
        )
    return shapely.normalize(geometry)


@dataclass(frozen=True, eq=False)
class Net:
    """A constrained Delaunay triangulation of a polygon, seen as paths.

    Parameters
    ----------
    polygon
        The domain.
    points
        (n, 2) vertices.
    triangles
        (m, 3) their numbers, counter-clockwise.
    links
        (k, 2) pairs of triangles with a common edge.
    sides
        (k, 2) which edge of each that is: edge j leads from corner j to corner j + 1.
    tree
        The triangles, to be searched.
    spacing
        Length of a typical edge.
    """

    polygon: shapely.Polygon
    points: Array
    triangles: IntArray
    links: IntArray
    sides: IntArray
    tree: shapely.STRtree
    spacing: float

    @classmethod
    def of(cls, polygon: shapely.Polygon, cells: int = 32) -> Net:
        """About ``cells`` triangles along the longer side of the bounding box."""
        frame = Frame.of_bounds(*polygon.bounds)
        local = frame.geometry_to_local(polygon)
        points, edges = _seeds(local, 2.0 / cells)
        triangles = constrained_delaunay(points, edges)
        links, sides = _links(triangles)
        user = frame.to_user(points)
        tree = shapely.STRtree(shapely.polygons(user[triangles]))
        spacing = 2.0 / cells * float(frame.matrix[0, 0])
        return cls(polygon, user, triangles, links, sides, tree, spacing)

    @property
    def size(self) -> float:
        """The longer side of the bounding box."""
        return float(self.extent.max())

    @property
    def extent(self) -> Array:
        """(2,) width and height of the bounding box."""
        xmin, ymin, xmax, ymax = self.polygon.bounds
        return np.array([xmax - xmin, ymax - ymin])

    @cached_property
    def anchors(self) -> Array:
        """(m, 2) centroids of the triangles."""
        return np.asarray(self.points[self.triangles].mean(axis=1))

    @cached_property
    def middles(self) -> Array:
        """(m, 3, 2) middles of the edges."""
        corners = self.points[self.triangles]
        return np.asarray(0.5 * (corners + np.roll(corners, -1, axis=1)))

    @cached_property
    def areas(self) -> Array:
        """(m,) areas of the triangles."""
        a, b, c = self.points[self.triangles].transpose(1, 0, 2)
        u, v = b - a, c - a
        return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))

    def locate(self, points: Array) -> IntArray:
        """(n,) triangle that each (n, 2) point lies in; -1 outside the domain (and for NaN).

        Points within 1e-9 of the domain's size count as inside."""
        found = np.full(len(points), -1, dtype=np.int64)
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        geometry = shapely.points(points[finite])
        which, triangle = self.tree.query(geometry, predicate="intersects")
        # Points on an edge lie in several: the last write wins, so let it be the lowest number.
        order = np.lexsort((-triangle, which))
        found[finite[which[order]]] = triangle[order]
        lost = finite[found[finite] < 0]
        if lost.size:
            which, triangle = self.tree.query_nearest(
                shapely.points(points[lost]), max_distance=1e-9 * self.size, all_matches=False
            )
            found[lost[which]] = triangle
        return found

    def into(self, points: Array) -> Array:
        """(n, 2) nearest points of the domain: the points themselves where they lie in it."""
        out = ~shapely.intersects_xy(self.polygon, points[:, 0], points[:, 1])
        if not out.any():
            return points
        lines = shapely.shortest_line(self.polygon, shapely.points(points[out]))
        moved = points.copy()
        moved[out] = shapely.get_coordinates(lines)[::2]
        return moved

    def walk(self, root: int) -> tuple[IntArray, IntArray, IntArray]:
        """Shortest paths from one anchor to all others.

        Returns the (m,) order in which they are reached, the (m,) link by which each is entered
        (-1 for the root) and the (m,) anchor that it is entered from.
        """
        m = len(self.triangles)
        a, b = self.links.T
        number = np.arange(len(a)) + 1
        ends = np.concatenate([a, b]), np.concatenate([b, a])
        graph = scipy.sparse.coo_array((np.tile(number, 2), ends), shape=(m, m)).tocsr()
        order, before = scipy.sparse.csgraph.breadth_first_order(graph, root, directed=True)
        if order.size < m:
            raise InputError(
                "The domain is pinched to a point or a hair: give one piece that is connected "
                "through its inside."
            )
        entered = np.full(m, -1, dtype=np.int64)
        rest = order[1:]
        entered[rest] = np.asarray(graph[before[rest], rest]).ravel() - 1
        return order.astype(np.int64), entered, before.astype(np.int64)


def _seeds(polygon: shapely.Polygon, spacing: float) -> tuple[Array, IntArray]:
    """Vertices, and boundary edges with the domain on their left: the rings, cut into pieces, and
    rows of points inside."""
    points: list[Array] = []
    edges: list[IntArray] = []
    count = 0
    oriented = shapely.orient_polygons(polygon)
    for ring in (oriented.exterior, *oriented.interiors):
        corners = shapely.get_coordinates(shapely.segmentize(ring, spacing))[:-1]
        number = count + np.arange(len(corners))
        points.append(corners)
        edges.append(np.stack([number, np.roll(number, -1)], axis=1))
        count += len(corners)
    # Staggered rows make triangles that are nearly equilateral.
    xmin, ymin, xmax, ymax = polygon.bounds
    rise = 0.5 * np.sqrt(3.0) * spacing
    rows = np.arange(ymin + 0.5 * rise, ymax, rise)
    columns = np.arange(xmin, xmax + spacing, spacing)
    x = columns[None, :] + 0.5 * spacing * (np.arange(rows.size) % 2)[:, None]
    inside = np.stack([x.ravel(), np.repeat(rows, columns.size)], axis=1)
    core = polygon.buffer(-0.4 * spacing)
    points.append(inside[shapely.intersects_xy(core, inside[:, 0], inside[:, 1])])
    # A hole may touch another ring at a vertex, which is then there twice.
    distinct, number = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    return distinct, number.ravel()[np.concatenate(edges)].astype(np.int64)


def _links(triangles: IntArray) -> tuple[IntArray, IntArray]:
    m = len(triangles)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    ends.sort(axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    same = (ends[order[1:]] == ends[order[:-1]]).all(axis=1)
    first, second = order[:-1][same], order[1:][same]
    links = np.stack([first // 3, second // 3], axis=1)
    assert links.max(initial=-1) < m
    return links, np.stack([first % 3, second % 3], axis=1)
