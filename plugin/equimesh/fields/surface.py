"""Imported triangle surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import shapely

from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.kernel import KernelField
from equimesh.fields.measures import border_heights, chord_spans, heights, triangle_errors
from equimesh.fields.surface_fit import Derivatives, fit_quadratics, interpolate
from equimesh.fields.surface_holes import filled, hole_size
from equimesh.fields.surface_index import index_surface
from equimesh.fields.surface_outline import Border
from equimesh.fields.surface_repair import Graph, as_graph, joined
from equimesh.frame import Frame

__all__ = ["Surface"]

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle surface that is a graph over a plane: linear on every triangle.

    Vertices at the same place are merged, triangles without area ignored, triangles that hang on an
    edge of two others left out and windings made alike; ``notes`` tells what was done.

    Parameters
    ----------
    points
        (n, 3) vertices. Kept as (x, y, height): the input's own coordinates if heights run along z,
        else rotated; ``to_input`` goes back.
    triangles
        (m, 3) vertex numbers. Kept counter-clockwise seen from above, of merged vertices.
    up
        The direction of heights: three numbers, or ``"x"``, ``"y"``, ``"z"``. Without it z if the
        surface is a graph over x and y, else the mean normal (weighted by area).
    fill_holes
        Holes up to this area, seen along the heights, are closed by triangles between the vertices
        of their rims; so are, with text such as ``"40 edges"``, those with at most so many edges,
        and all with ``"all"``. Holes stay without it.

    Raises
    ------
    InputError
        Arrays of the wrong shape, coordinates that are not finite, no triangle with an area, edges
        shared by more than two triangles, or a surface that is no graph in this direction.
    """

    points: Array
    triangles: IntArray
    up: Any = None
    fill_holes: float | str = 0.0
    notes: tuple[str, ...] = field(init=False, default=())
    _graph: Graph = field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = hole_size(self.fill_holes)
        graph = as_graph(self.points, self.triangles, self.up)
        if size[0] > 0.0:
            border = Border.of(graph)
            graph = joined(filled(graph, border.rings, border.outer, size))
        object.__setattr__(self, "_graph", graph)
        object.__setattr__(self, "points", graph.points)
        object.__setattr__(self, "triangles", graph.triangles[~graph.flat])
        object.__setattr__(self, "notes", graph.notes)
        _ = self._border  # finds parts that lie over one another

    @property
    def size(self) -> str:
        """Such as ``85,182 vertices, 166,259 triangles``."""
        return f"{len(self.points):,} vertices, {len(self.triangles):,} triangles"

    @cached_property
    def smooth(self) -> bool:
        """Whether quadratics fit the surface far better than planes do.

        Both are fitted to the neighbours of vertices, of some 20,000 at most, up to the second
        ring. What they leave goes like h^3 and h^2 for vertices on a smooth surface, but is alike
        for noise and kinks. Smooth: root mean squares in a ratio below 0.35.
        """
        every = 1 + len(self._kernel.points) // 20_000
        linear, quadratic = self._fitted(every).misfit
        if linear <= 64.0 * _EPS * np.abs(self._range).max():
            return True  # a plane
        return quadratic < 0.35 * linear

    def closed(self, size: float | str) -> Surface:
        """The same surface with its holes up to a size closed, see ``fill_holes``."""
        up = self._graph.rotation[2]
        again = Surface(self.to_input(self.points), self.triangles, up, size)
        object.__setattr__(again, "notes", (*self.notes, *again.notes))
        return again

    def to_input(self, points: Array) -> Array:
        """(n, 3) points (x, y, height) in the coordinates of the input."""
        return np.asarray(points @ self._graph.rotation)

    def value(self, x: Array, y: Array) -> Array:
        """(n,) heights; NaN outside the surface."""
        return heights(self._kernel, self._local(x, y))

    def gradient(self, x: Array, y: Array) -> Array:
        """(n, 2) slopes of quadratics fitted at the vertices, interpolated in the triangles.

        Outside the surface those of the nearest vertex.
        """
        return self._interpolated(x, y, self._derivatives.gradient)

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives of the same quadratics."""
        packed = self._derivatives.hessian.reshape(-1, 4)
        return self._interpolated(x, y, packed).reshape(-1, 2, 2)

    def outline(self, tol: float = 0.0) -> shapely.Geometry:
        """The border in projection, its vertices among the surface's.

        Every border vertex stays within ``tol`` of the simplified border, measured in space, and
        still does if nodes on the surface divide that further; 0 keeps all of them.
        """
        return self._border.simplified(tol, self._sag)

    def span(self, domain: shapely.Geometry) -> tuple[float, float]:
        """Extremes over the domain: at vertices inside and along its border."""
        low, high = self._range
        shapely.prepare(domain)
        inside = self.points[shapely.contains_xy(domain, self.points[:, 0], self.points[:, 1]), 2]
        local = self._frame.geometry_to_local(domain)
        reached = np.concatenate([inside, border_heights(self._kernel, local, low, high)])
        if not len(reached):
            raise InputError("The domain does not meet the surface: check its coordinates.")
        return float(reached.min()), float(reached.max())

    def frame(self, domain: shapely.Geometry | None = None) -> Frame:
        """The middle of the surface, its longer side scaled to 2, whatever the domain."""
        return self._frame

    def kernel(self, domain: shapely.Geometry | None = None, tol: float = 0.0) -> KernelField:
        """The indexed surface; the same for every domain and tolerance."""
        return self._kernel

    def errors(
        self, points: Array, triangles: IntArray, limit: float = np.inf
    ) -> tuple[Array, Array]:
        """(m,) largest |surface - triangle| anywhere on each triangle, and (m,) bounds.

        Exact up to rounding, vertices off the surface included; what lies outside the surface is
        ignored. The bounds add the rounding of heights and of coordinates on a slope of one height
        range per half width.
        """
        points = np.asarray(points, np.float64)
        local = np.column_stack([self._frame.to_local(points[:, :2]), points[:, 2]])
        errors = triangle_errors(self._kernel, local, triangles)
        low, high = self._range
        size = max(abs(low), abs(high)) + np.abs(points[triangles, 2]).max(axis=1, initial=0.0)
        rounding = 16.0 * _EPS * size + self._slack * (high - low)
        return errors, errors * (1.0 + 1e-12) + rounding

    @cached_property
    def _border(self) -> Border:
        return Border.of(self._graph)

    @cached_property
    def _range(self) -> tuple[float, float]:
        return float(self.points[:, 2].min()), float(self.points[:, 2].max())

    @cached_property
    def _frame(self) -> Frame:
        x, y = self.points[:, 0], self.points[:, 1]
        return Frame.of_bounds(x.min(), y.min(), x.max(), y.max())

    @cached_property
    def _slack(self) -> float:
        """Rounding, in local units, of a point carried from the user's coordinates."""
        size = np.abs(self.points[:, :2]).max() / np.abs(self._frame.matrix).max()
        return float(8.0 * _EPS * (size + 16.0))

    @cached_property
    def _kernel(self) -> KernelField:
        local = np.column_stack([self._frame.to_local(self.points[:, :2]), self.points[:, 2]])
        return index_surface(local, self.triangles, self._slack)

    @cached_property
    def _derivatives(self) -> Derivatives:
        return self._fitted(1)

    def _fitted(self, every: int) -> Derivatives:
        """At the kernel's vertices or some of them, in the user's coordinates."""
        points = self._kernel.points.copy()
        points[:, :2] = self._frame.to_user(points[:, :2])
        return fit_quadratics(points, self._kernel.triangles[:, :3], every)

    def _sag(self, a: Array, b: Array) -> Array:
        """(n, 2) least and largest of surface - chord, or 0, on chords from a to b, (n, 3)."""
        p, q = (np.column_stack([self._frame.to_local(v[:, :2]), v[:, 2]]) for v in (a, b))
        return chord_spans(self._kernel, p, q, *self._range)

    def _local(self, x: Array, y: Array) -> Array:
        points = np.stack(np.broadcast_arrays(x, y), axis=-1).astype(np.float64)
        return np.ascontiguousarray(self._frame.to_local(points.reshape(-1, 2)))

    def _interpolated(self, x: Array, y: Array, data: Array) -> Array:
        local = self._local(x, y)
        out = np.full((len(local), data.shape[1]), np.nan)
        interpolate(self._kernel, data, local, out)
        outside = np.isnan(out[:, 0])
        if outside.any():
            _, nearest = scipy.spatial.cKDTree(self._kernel.points[:, :2]).query(local[outside])
            out[outside] = data[nearest]
        return out
