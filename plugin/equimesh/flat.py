"""The paper's two strategies: a lattice of y-space pulled back to the domain, section 4."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from equimesh.domain import sides_of
from equimesh.errors import InputError
from equimesh.lattice import equilateral_vectors, lattice_vectors, tile
from equimesh.local import area, equidistribute
from equimesh.transform import FlatMap
from equimesh.triangulation import constrained_delaunay

__all__ = ["FlatMesh", "flat_mesh"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# A side along a null direction of a saddle has no error of its own at all; its nodes then keep this
# share of the lattice's spacing, or its triangles would be long and their other sides bad.
_NULL_SHARE = 0.7
# A lattice vertex closer to a boundary node than this (in spacings of y-space) makes way for it.
_ROOM = 0.5


@dataclass(frozen=True, eq=False)
class FlatMesh:
    """A lattice of y-space pulled back to the domain.

    Parameters
    ----------
    points
        (n, 3) vertices on the surface.
    triangles
        (m, 3) their numbers, counter-clockwise.
    flat_map
        The transform that was used.
    """

    points: Array
    triangles: IntArray
    flat_map: FlatMap

    @property
    def image(self) -> Array:
        """(n, 2) the vertices in y-space."""
        return np.stack(self.flat_map.forward(*self.points[:, :2].T), axis=1)


def flat_mesh(
    source: Any,
    domain: Any,
    tol: float,
    shape: Literal["optimal", "equilateral"] = "optimal",
    cover: Literal["interior", "full"] = "interior",
    *,
    offset: tuple[float, float] = (0.0, 0.0),
    variant: int = 2,
    theta: float = 0.0,
) -> FlatMesh:
    """Mesh a function with a flat Hessian by the lattice of y-space.

    Parameters
    ----------
    source, domain
        As in ``FlatMap``; or a ``FlatMap`` that exists already, and None.
    tol
        The interpolation error at which the lattice aims: as ``tol`` goes to zero all inner
        triangles have it exactly.
    shape
        ``optimal`` triangles, or ``equilateral`` ones of y-space (the same for a convex function).
    cover
        ``interior``: the lattice triangles that lie in the domain, and nothing else. ``full``:
        the whole domain; for equilateral triangles as in the paper, lattice vertices and boundary
        nodes by (4) triangulated by Delaunay in y-space, errors near the boundary as they come;
        for optimal ones by ``remesh``, which certifies the tolerance everywhere.
    offset
        Position of the lattice, in units of its two vectors.
    variant, theta
        Shape V1 to V6 of a saddle's triangles and the direction of their base.

    Raises
    ------
    InputError
        Where the metric is not flat, the transform not single-valued, or the tolerance not
        positive.
    """
    if not (math.isfinite(tol) and tol > 0.0):
        raise InputError(f"The tolerance is {tol}: give a positive number.")
    if shape not in ("optimal", "equilateral") or cover not in ("interior", "full"):
        raise InputError(
            f"There is no strategy {shape!r} with cover {cover!r}: choose 'optimal' or "
            "'equilateral', and 'interior' or 'full'."
        )
    flat_map = source if isinstance(source, FlatMap) else FlatMap(source, domain)
    if flat_map.flatness.cause == "hole":
        x, y = flat_map.flatness.where
        raise InputError(
            f"The transform has several values around the hole at ({x:.6g}, {y:.6g}): cut the "
            "domain there, or use remesh."
        )
    if not flat_map.flatness.flat:
        raise InputError(
            f"The Hessian of this function is no flat metric ({flat_map.flatness}): use remesh."
        )
    if shape == "equilateral":
        vectors = equilateral_vectors(flat_map.signature)
    else:
        vectors = lattice_vectors(flat_map.signature, variant, theta)
    vectors = math.sqrt(tol) * vectors
    if cover == "interior":
        plane, triangles = _interior(flat_map, vectors, offset)
    elif shape == "equilateral":
        plane, triangles = _equilateral_cover(flat_map, vectors, offset, tol)
    else:
        return _certified_cover(flat_map, tol)
    return FlatMesh(_lifted(flat_map, plane), triangles, flat_map)


def _interior(
    flat_map: FlatMap, vectors: Array, offset: tuple[float, float]
) -> tuple[Array, IntArray]:
    """The lattice triangles whose straight pull-back lies in the domain."""
    image, triangles = tile(vectors, flat_map.image_bounds, offset)
    points = np.stack(flat_map.inverse(*image.T), axis=1)
    triangles = triangles[np.isfinite(points[:, 0])[triangles].all(axis=1)]
    whole = shapely.polygons(points[triangles])
    shapely.prepare(flat_map.domain)
    reach = 1e-9 * math.sqrt(flat_map.domain.area)
    triangles = triangles[shapely.covers(flat_map.domain.buffer(reach), whole)]
    # Where the image overlaps itself corners may come back from different sheets of it.
    middle = np.stack(flat_map.forward(*points[triangles].mean(axis=1).T), axis=1)
    gap = np.linalg.norm(middle - image[triangles].mean(axis=1), axis=1)
    span = float(np.linalg.norm(vectors, axis=1).max())
    triangles = triangles[(gap <= 0.5 * span) & (area(points[triangles]) > 0.0)]
    used, number = np.unique(triangles, return_inverse=True)
    return points[used], number.reshape(-1, 3).astype(np.int64)


def _equilateral_cover(
    flat_map: FlatMap, vectors: Array, offset: tuple[float, float], tol: float
) -> tuple[Array, IntArray]:
    """Lattice vertices and boundary nodes, triangulated by Delaunay in y-space."""
    border, edges = _boundary_nodes(flat_map, tol)
    border_image = np.stack(flat_map.forward(*border.T), axis=1)
    image, _ = tile(vectors, flat_map.image_bounds, offset)
    spacing = float(np.linalg.norm(vectors[0]))
    distance, _ = scipy.spatial.cKDTree(border_image).query(image)
    image = image[distance > _ROOM * spacing]
    points = np.stack(flat_map.inverse(*image.T), axis=1)
    inside = np.isfinite(points[:, 0])
    points, image = points[inside], image[inside]
    # Boundary chords of y-space cut corners: what lies beyond them would be outside the mesh.
    ring = shapely.linestrings(border_image[edges])
    near = shapely.STRtree(ring).query(
        shapely.points(image), predicate="dwithin", distance=0.25 * spacing
    )[0]
    keep = np.setdiff1d(np.arange(len(image)), near)
    everywhere = np.concatenate([border_image, image[keep]])
    triangles = constrained_delaunay(everywhere, edges)
    plane = np.concatenate([border, points[keep]])
    used, number = np.unique(triangles, return_inverse=True)
    plane, triangles = plane[used], number.reshape(-1, 3).astype(np.int64)
    areas = area(plane[triangles])
    if areas.min() <= 0.0 or abs(areas.sum() - flat_map.domain.area) > 1e-9 * areas.sum():
        raise InputError(
            "The lattice does not cover the domain at this tolerance, which is too coarse or whose "
            "image in y-space overlaps itself: give a smaller tolerance or cut the domain."
        )
    return plane, triangles


def _boundary_nodes(flat_map: FlatMap, tol: float) -> tuple[Array, IntArray]:
    """Nodes on every side by (4), and the edges between them with the domain on their left."""
    sides = sides_of(flat_map.domain)
    nodes: list[Array] = []
    for corner, following in zip(sides.corners, sides.following, strict=True):
        density = _edge_density(flat_map, corner, sides.corners[following], tol)
        t = np.linspace(0.0, 1.0, 2001)
        count = max(1, math.ceil(float(np.trapezoid(density(t), t)) - 0.05))
        s = equidistribute(density, 0.0, 1.0, count)[:-1, None]
        nodes.append((1.0 - s) * corner + s * sides.corners[following])
    start = np.cumsum([0, *(len(n) for n in nodes)])
    after = np.arange(start[-1]) + 1
    after[start[1:] - 1] = start[sides.following]
    return np.concatenate(nodes), np.stack([np.arange(start[-1]), after], axis=1)


def _edge_density(flat_map: FlatMap, p: Array, q: Array, tol: float) -> Callable[[Array], Array]:
    """Edges of error ``tol`` per unit of t on the way from p to q: (4) over the error's root."""
    step = q - p

    def density(t: Array) -> Array:
        at = p + t[:, None] * step
        along = np.einsum("nij,j->ni", flat_map.jacobian(*at.T), step)
        length = (along**2).sum(axis=1)
        bend = np.abs(along[:, 0] ** 2 + flat_map.signature * along[:, 1] ** 2)
        return np.asarray(np.sqrt(np.maximum(bend, _NULL_SHARE**2 * length) / (8.0 * tol)))

    return density


def _certified_cover(flat_map: FlatMap, tol: float) -> FlatMesh:
    from equimesh import remesh  # the package's front door imports this module

    result = remesh(flat_map.given, tol, flat_map.domain)
    return FlatMesh(result.points, result.triangles, flat_map)


def _lifted(flat_map: FlatMap, plane: Array) -> Array:
    """(n, 3) the points on the surface."""
    value = getattr(flat_map.source, "value", None)
    if value is None:
        raise InputError("This source has no heights: give a function, an expression or a field.")
    height = np.asarray(value(*plane.T), dtype=np.float64)
    return np.column_stack([plane, np.broadcast_to(height, len(plane))])
