"""Borders that follow curves of Gmsh's models: nodes on them, and triangles they would spoil."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from equimesh_adapters.gmsh_fit import Curve, Patch

__all__ = ["chain_of", "on_curves", "turned_over"]

Array = NDArray[np.float64]

_FLAT = 1e-2  # of a triangle's size: what a Jacobian may be below 0


def on_curves(
    gmsh: Any, patch: Patch, curves: Sequence[Curve], height: float
) -> tuple[Patch, float]:
    """The mesh with its border nodes on the curves, and how far one had to move at most."""
    points, farthest = patch.points.copy(), 0.0
    for curve in curves:
        free = patch.places.get((1, curve.tag), np.zeros(0, np.int64))
        if not curve.smooth or not len(free):
            continue
        flat = points[free].copy()
        flat[:, 2] = height
        at = gmsh.model.getParametrization(1, curve.tag, flat.ravel())
        there = np.asarray(gmsh.model.getValue(1, curve.tag, at)).reshape(-1, 3)
        farthest = max(farthest, float(np.hypot(*(there - flat)[:, :2].T).max()))
        points[free, :2] = there[:, :2]
    return replace(patch, points=points), farthest


def chain_of(
    gmsh: Any, patch: Patch, curves: Sequence[Curve], height: float
) -> tuple[list[Array], bool]:
    """The border edges as lines, and whether some must be divided on their curve.

    They must where their triangle would turn over somewhere if it had curved edges of the second
    order, as a vertex beside a curve makes it.
    """
    chain = [*patch.points[patch.edges][..., :2]]
    middles = patch.points[patch.edges][..., :2].mean(1)
    bent = np.zeros(len(chain), bool)
    for curve in curves:
        own = np.flatnonzero(patch.owners == curve.tag)
        if curve.smooth and len(own):
            middles[own] = _between(gmsh, curve, patch.points[patch.edges[own]], height)
            bent[own] = True
    if not bent.any():
        return chain, False
    number = {frozenset(edge): k for k, edge in enumerate(patch.edges.tolist()) if bent[k]}
    sides = patch.triangles[:, [[0, 1], [1, 2], [2, 0]]]
    edge = np.array([[number.get(frozenset(e), -1) for e in t] for t in sides.tolist()])
    beside = np.flatnonzero((edge >= 0).any(1))
    corners, edge = patch.points[patch.triangles[beside], :2], edge[beside]
    straight = 0.5 * (corners + corners[:, [1, 2, 0]])
    nodes = np.where((edge >= 0)[..., None], middles[edge], straight)
    crowded = np.unique(edge[turned_over(corners, nodes)])
    for k in crowded[crowded >= 0]:
        chain[k] = np.stack([chain[k][0], middles[k], chain[k][1]])
    return chain, len(crowded) > 0


def turned_over(corners: Array, middles: Array) -> NDArray[np.bool_]:
    """(k,) whether triangles of the second order may turn over, by Bernstein's coefficients of the
    Jacobian; ``middles`` (k, 3, 2) on the edges from each of the ``corners`` (k, 3, 2) on.

    Where two edges of one smooth curve meet it is 0, which counts as whole.
    """
    before, after = middles[:, [2, 0, 1]], corners[:, [1, 2, 0]]
    last = corners[:, [2, 0, 1]]

    def cross(u: Array, v: Array) -> Array:
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    at_corner = cross(4.0 * middles - 3.0 * corners - after, 4.0 * before - 3.0 * corners - last)
    # In the middle of an edge: along it, and towards the third corner.
    inward = 2.0 * (middles[:, [1, 2, 0]] + before - middles) - corners - last
    at_middle = cross(after - corners, inward)
    between = 2.0 * at_middle - 0.5 * (at_corner + at_corner[:, [1, 2, 0]])
    size = np.abs(cross(after - corners, last - corners)[:, 0])
    return np.asarray(np.minimum(at_corner, between).min(1) < -_FLAT * size)


def _between(gmsh: Any, curve: Curve, ends: Array, height: float) -> Array:
    """(k, 2) places on a curve halfway between each two (k, 2, 3) places on it."""
    flat = ends.copy()
    flat[..., 2] = height
    at = np.asarray(gmsh.model.getParametrization(1, curve.tag, flat.ravel())).reshape(-1, 2)
    low, high = (float(bound[0]) for bound in gmsh.model.getParametrizationBounds(1, curve.tag))
    # Across the seam of a closed curve the other way is the shorter one.
    far = (len(set(curve.ends)) < 2) & (np.abs(at[:, 1] - at[:, 0]) > 0.5 * (high - low))
    middle = at.mean(1) + np.where(far, 0.5 * (high - low), 0.0)
    middle = np.where(middle > high, middle - (high - low), middle)
    return np.asarray(gmsh.model.getValue(1, curve.tag, middle)).reshape(-1, 3)[:, :2]
