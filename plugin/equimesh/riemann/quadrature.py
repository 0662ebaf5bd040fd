"""Adaptive integrals over a polygon."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.domain import sides_of
from equimesh.triangulation import constrained_delaunay

__all__ = ["POINTS", "WEIGHTS", "domain_triangles", "integral", "quartered"]

Array = NDArray[np.float64]

# Seven points, exact to degree 5 (J. Radon, 1948): barycentric coordinates and weights.
_A, _B = (6.0 - np.sqrt(15.0)) / 21.0, (6.0 + np.sqrt(15.0)) / 21.0
POINTS = np.array(
    [[1 / 3] * 3]
    + [np.roll([1 - 2 * _A, _A, _A], k).tolist() for k in range(3)]
    + [np.roll([1 - 2 * _B, _B, _B], k).tolist() for k in range(3)]
)
WEIGHTS = np.array(
    [0.225] + 3 * [(155 - np.sqrt(15.0)) / 1200] + 3 * [(155 + np.sqrt(15.0)) / 1200]
)
_START, _MOST = 4096, 400_000  # triangles


def domain_triangles(geometry: shapely.Geometry) -> tuple[Array, NDArray[np.int64]]:
    """Corners (k, 2) of a domain and triangles (m, 3) that cover it."""
    sides = sides_of(geometry)
    points, place = np.unique(sides.corners, axis=0, return_inverse=True)
    place = place.ravel()
    return points, constrained_delaunay(points, np.stack([place, place[sides.following]], 1))


def integral(
    f: Callable[[Array, Array], Array], geometry: shapely.Geometry, accuracy: float = 1e-5
) -> float:
    """The integral of a positive f over a polygon to about a relative ``accuracy``.

    Triangles are cut in four until a rule of degree 5 agrees with itself on their parts.
    """
    points, triangles = domain_triangles(geometry)
    corners = points[triangles]
    while len(corners) < _START:
        corners = quartered(corners)
    coarse = _rule(f, corners)
    total = 0.0
    while True:
        parts = quartered(corners)
        fine = _rule(f, parts)
        together = fine.reshape(4, -1).sum(0)
        whole = total + float(together.sum())
        off = np.abs(together - coarse)
        order = np.argsort(-off, kind="stable")
        left = off.sum() - np.cumsum(off[order])
        enough = int(np.searchsorted(-left, -accuracy * whole)) + 1
        if off.sum() <= accuracy * whole or 4 * enough > _MOST:
            return whole
        worst = np.sort(order[:enough])
        total += float(np.delete(together, worst).sum())
        corners = parts.reshape(4, -1, 3, 2)[:, worst].reshape(-1, 3, 2)
        coarse = fine.reshape(4, -1)[:, worst].ravel()


def quartered(corners: Array) -> Array:
    """(4 m, 3, 2) parts of triangles (m, 3, 2): all first parts, all second parts, ..."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, 1) for part in parts])


def _rule(f: Callable[[Array, Array], Array], corners: Array) -> Array:
    p = np.einsum("qk,tkd->tqd", POINTS, corners)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    values = f(p[..., 0].ravel(), p[..., 1].ravel()).reshape(len(corners), -1)
    return np.asarray(area * (values @ WEIGHTS))
