"""Tensors at the vertices of a mesh, log-Euclidean in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
import shapely
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError
from equimesh.riemann.tensors import checked, exponential, logarithm, packed, unpacked

__all__ = ["Background"]

Array = NDArray[np.float64]
_MOST_CELLS = 60_000
_DEEPEST = 14
_RESOLVED = 0.3  # in the logarithm of the metric, over a cell
_FINEST = 0.5  # in unit lengths: what varies over less than an edge no mesh can follow


@dataclass(frozen=True, eq=False)
class Background:
    """A background mesh: ``points`` (n, 2), ``triangles`` (m, 3), ``tensors`` (n, 2, 2)."""

    points: Array
    triangles: NDArray[np.int64]
    tensors: Array

    @classmethod
    def of(cls, points: ArrayLike, triangles: ArrayLike, tensors: ArrayLike) -> Background:
        """Checked arrays.

        Raises
        ------
        InputError
            Shapes or indices that make no mesh, tensors that are no metric.
        """
        p, t = np.array(points, float), np.asarray(triangles)
        if p.ndim != 2 or p.shape[1] not in (2, 3) or not np.isfinite(p).all():
            raise InputError(
                f"The metric's points have the shape {p.shape} or are not finite: "
                "give (n, 2) coordinates."
            )
        if t.ndim != 2 or t.shape[1] != 3 or t.dtype.kind not in "iu" or len(t) == 0:
            raise InputError("The metric's triangles must be an (m, 3) array of vertex indices.")
        if t.min() < 0 or t.max() >= len(p):
            raise InputError("The metric's triangles name vertices that do not exist.")
        m = np.asarray(tensors, float)
        if m.shape != (len(p), 2, 2):
            raise InputError(
                f"The metric has the shape {m.shape} on {len(p)} vertices: give (n, 2, 2) tensors."
            )
        p = np.ascontiguousarray(p[:, :2])
        used = np.unique(t)
        checked(m[used], *p[used].T)
        m = m.copy()
        m[np.setdiff1d(np.arange(len(p)), used)] = np.eye(2)  # of no triangle: never asked
        return cls(p, t.astype(np.int64), 0.5 * (m + m.transpose(0, 2, 1)))

    @classmethod
    def resolving(
        cls, metric: Callable[[Array, Array], Array], geometry: shapely.Geometry
    ) -> Background:
        """A mesh over the domain's box, fine where the metric changes: Delaunay of a quadtree."""
        xmin, ymin, xmax, ymax = shapely.bounds(geometry)
        side = max(xmax - xmin, ymax - ymin)
        n = 16
        i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n)))
        cells, width, done = np.stack([i, j], 1) / n, 1.0 / n, []
        shapely.prepare(geometry)
        kept = 0
        for _ in range(_DEEPEST):
            low = np.array([xmin, ymin]) + side * cells
            meets = shapely.intersects(geometry, shapely.box(*low.T, *(low + side * width).T))
            cells = cells[meets]
            offsets = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5]]) * width
            p = np.array([xmin, ymin]) + side * (cells[:, None] + offsets)
            p = np.minimum(p, [xmax, ymax])
            m = metric(*p.reshape(-1, 2).T)
            log = packed(logarithm(m)).reshape(len(cells), 5, 3)
            units = side * width * np.sqrt(np.trace(m, axis1=1, axis2=2)).reshape(-1, 5).max(1)
            coarse = (np.ptp(log, axis=1).max(1) > _RESOLVED) & (units > _FINEST)
            if kept + 4 * coarse.sum() > _MOST_CELLS:
                coarse[:] = False
            done.append(p[~coarse].reshape(-1, 2))
            kept += int((~coarse).sum())
            width *= 0.5
            cells = (cells[coarse, None] + offsets[:4] * 0.5).reshape(-1, 2)
            if len(cells) == 0:
                break
        points = np.unique(np.concatenate(done), axis=0)
        triangles = np.sort(scipy.spatial.Delaunay(points).simplices.astype(np.int64), axis=1)
        return cls(points, triangles, metric(*points.T))

    def with_tensors(self, tensors: Array) -> Background:
        """The same mesh with other tensors (n, 2, 2)."""
        return replace(self, tensors=tensors)

    @cached_property
    def _logs(self) -> Array:
        return packed(logarithm(self.tensors))

    @cached_property
    def _tree(self) -> shapely.STRtree:
        ring = self.points[self.triangles]
        return shapely.STRtree(shapely.polygons(ring))

    def __call__(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) tensors at points (n,)."""
        p = np.stack([x, y], 1)
        places = shapely.points(p)
        owner = np.full(len(p), -1, np.int64)
        who, found = self._tree.query(places, predicate="intersects")
        owner[who[::-1]] = found[::-1]  # the first of several
        out = np.flatnonzero(owner < 0)
        if len(out):
            owner[out] = self._tree.nearest(places[out])
        corner = self.points[self.triangles[owner]]
        u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], p - corner[:, 0]
        det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        with np.errstate(all="ignore"):
            s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / det
            t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / det
        share = np.stack([1.0 - s - t, s, t], 1)
        share[~np.isfinite(share).all(axis=1)] = 1.0 / 3.0
        share = np.maximum(share, 0.0)
        share /= share.sum(1, keepdims=True)
        logs = np.einsum("nk,nkc->nc", share, self._logs[self.triangles[owner]])
        return exponential(unpacked(logs))
