"""Attributes of an old mesh on a new one: linear on the old triangles, or from the nearest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["Carrier"]


@dataclass(frozen=True, eq=False)
class Carrier:
    """Where every vertex and triangle of a new mesh lies on an old one.

    ``corners`` (n, 3) vertices of the old triangle under each new vertex and ``weights`` (n, 3),
    its barycentric coordinates there; ``faces`` (m,) the old triangle under the centroid of each
    new one, and ``owners`` (n,) that under each vertex. What lies beside the old mesh belongs to
    the nearest place on it. Cells of another kind may have more corners.
    """

    corners: NDArray[np.int64]
    weights: NDArray[np.float64]
    faces: NDArray[np.int64]
    owners: NDArray[np.int64]

    @classmethod
    def between(
        cls,
        old: tuple[NDArray[np.float64], NDArray[np.int64]],
        new: tuple[NDArray[np.float64], NDArray[np.int64]],
    ) -> Carrier:
        """From an old mesh to a new one, both as points (n, 2) in a plane and triangles (m, 3).

        >>> old = np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([[0, 1, 2]])
        >>> new = np.array([[0.5, 0.5], [0, 0], [0.5, 0]]), np.array([[0, 1, 2]])
        >>> Carrier.between(old, new).at_vertices(np.array([0.0, 1.0, 3.0]))
        array([2. , 0. , 0.5])
        """
        points, triangles = old
        a, b, c = points[triangles].transpose(1, 0, 2)
        area = _cross(b - a, c - a)
        solid = np.flatnonzero(area != 0.0)
        tree = shapely.STRtree(shapely.polygons(points[triangles[solid]]))
        places, faces = new
        at, places = _owners(tree, places)
        at = solid[at]
        a, b, c = (points[triangles[at, k]] for k in range(3))
        s = _cross(places - a, c - a) / area[at]
        t = _cross(b - a, places - a) / area[at]
        weights = np.clip(np.stack([1.0 - s - t, s, t], axis=1), 0.0, 1.0)
        weights /= weights.sum(axis=1, keepdims=True)
        centroids, _ = _owners(tree, new[0][faces].mean(axis=1))
        return cls(triangles[at], weights, solid[centroids], at)

    def at_vertices(self, values: Any) -> NDArray[Any]:
        """(n, ...) values of the old vertices on the new ones.

        Real and complex numbers are interpolated; whole numbers, flags and texts may be names of
        something, so they come from the corner with the largest weight. A corner without weight has
        no say, whatever its value.
        """
        values = np.asarray(values)
        if values.dtype.kind not in "fc":
            return values[np.take_along_axis(self.corners, self._strongest[:, None], 1)[:, 0]]
        return self._blended(values).astype(values.dtype)

    def colours_at_vertices(self, values: Any) -> NDArray[Any]:
        """The same for colours: whole numbers are interpolated too, and rounded."""
        values = np.asarray(values)
        if values.dtype.kind not in "iu":
            return self.at_vertices(values)
        return np.rint(self._blended(values.astype(np.float64))).astype(values.dtype)

    def at_triangles(self, values: Any) -> NDArray[Any]:
        """(m, ...) values of the old triangles on the new ones: that under the centroid."""
        return np.asarray(values)[self.faces]

    def at_corners(
        self, values: Any, old: NDArray[np.int64], new: NDArray[np.int64]
    ) -> NDArray[Any]:
        """(m, 3, ...) values (k, 3, ...) at the corners of old triangles, at those of new ones.

        Such as texture coordinates, which may jump from triangle to triangle. A corner of the old
        triangle under the centroid keeps what it has there, any other place takes it from the one
        old triangle that it lies on. ``old`` (k, 3) and ``new`` (m, 3) are the triangles.
        """
        values = np.asarray(values)
        weights = self.weights.reshape(*self.weights.shape, *(1,) * (values.ndim - 2))
        found = (weights * values[self.owners]).sum(axis=1)[new]
        vertex = np.take_along_axis(self.corners, self._strongest[:, None], 1)[:, 0]
        vertex[self.weights.max(axis=1) < 1.0] = -1
        face, corner, place = np.nonzero(vertex[new][:, :, None] == old[self.faces][:, None, :])
        found[face, corner] = values[self.faces[face], place]
        return np.asarray(found)

    @property
    def _strongest(self) -> NDArray[np.int64]:
        return np.argmax(self.weights, axis=1)

    def _blended(self, values: NDArray[Any]) -> NDArray[Any]:
        total = np.zeros((len(self.corners), *values.shape[1:]), np.result_type(values, np.float64))
        for k in range(self.corners.shape[1]):
            weight = self.weights[:, k].reshape(-1, *(1,) * (values.ndim - 1))
            with np.errstate(invalid="ignore"):
                part = weight * values[self.corners[:, k]]
            total += np.where(weight > 0.0, part, 0.0)
        return total


def _cross(u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _owners(
    tree: shapely.STRtree, places: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """(k,) the first triangle at each place (k, 2), and the places, moved onto it if beside it."""
    spots = shapely.points(places)
    found = np.full(len(places), len(tree), np.int64)
    which, triangle = tree.query(spots, predicate="intersects")
    np.minimum.at(found, which, triangle)
    outside = np.flatnonzero(found == len(tree))
    if len(outside):
        found[outside] = tree.nearest(spots[outside])
        lines = shapely.shortest_line(tree.geometries[found[outside]], spots[outside])
        places = places.copy()
        places[outside] = shapely.get_coordinates(shapely.get_point(lines, 0))
    return found, places
