"""Derivatives of a triangle surface, recovered by local quadratic fits."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from equimesh.fields.base import Array, IntArray
from equimesh.fields.compiled import allocating
from equimesh.fields.kernel import KernelField
from equimesh.fields.surface_kernels import locate

__all__ = ["Derivatives", "fit_quadratics", "interpolate"]

Int32Array = NDArray[np.int32]

_RIDGE = 1e-10  # of the largest eigenvalue: below it a direction is not determined by the points


class Derivatives(NamedTuple):
    """At the vertices of a surface."""

    gradient: Array  # (n, 2)
    hessian: Array  # (n, 2, 2)
    misfit: tuple[float, float]  # root mean squares that linear and quadratic fits leave


def fit_quadratics(points: Array, triangles: Int32Array, every: int = 1) -> Derivatives:
    """Least-squares quadratics through each vertex's neighbours up to the second ring.

    ``points`` (n, 3), ``triangles`` (m, 3). Vertices with fewer than six points within reach
    take in the third ring and the fourth; what these leave open is set to zero (least norm).
    With ``every`` only each so manyth vertex gets its quadratic.
    """
    count = len(points)
    centre = np.arange(0, count, every)
    i = triangles.reshape(-1).astype(np.int64)
    j = np.roll(triangles, -1, axis=1).reshape(-1).astype(np.int64)
    near = scipy.sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(count, count))
    near = near + near.T + scipy.sparse.eye_array(count, dtype=bool, format="csr")
    ring = near[centre] @ near
    for _ in range(2):
        few = np.flatnonzero(np.diff(ring.indptr) < 6)
        pick = scipy.sparse.csr_array(
            (np.ones(len(few), bool), (few, few)), shape=(len(centre), len(centre))
        )
        ring = ring + pick @ ring @ near
    start, neighbour = ring.indptr, ring.indices
    normal, right, scale = _normal_equations(points, centre, start, neighbour)
    quadratic, linear = _solve(normal, right), np.zeros((len(centre), 6))
    linear[:, :3] = _solve(normal[:, :3, :3], right[:, :3])
    misfit = (
        float(_misfit(points, centre, start, neighbour, scale, linear)),
        float(_misfit(points, centre, start, neighbour, scale, quadratic)),
    )
    gradient = quadratic[:, 1:3] / scale[:, None]
    second = quadratic[:, 3:] / scale[:, None] ** 2
    hessian = np.stack([second[:, [0, 1]], second[:, [1, 2]]], axis=1)
    return Derivatives(gradient, hessian, misfit)


def _solve(normal: Array, right: Array) -> Array:
    """Least-norm solutions of (n, k, k) symmetric systems."""
    inverse = np.linalg.pinv(normal, rcond=_RIDGE, hermitian=True)
    return np.asarray(np.einsum("nij,nj->ni", inverse, right))


@allocating
def _set_terms(term: Array, u: float, v: float) -> None:
    term[0], term[1], term[2] = 1.0, u, v
    term[3], term[4], term[5] = 0.5 * u * u, u * v, 0.5 * v * v


@allocating
def _normal_equations(
    points: Array, centre: IntArray, start: Int32Array, neighbour: Int32Array
) -> tuple[Array, Array, Array]:
    """Per vertex: (n, 6, 6), (n, 6) and the length that scales u and v, its distance to neighbours.

    For 1, u, v, u^2/2, u v, v^2/2 and heights above the vertex.
    """
    count = len(centre)
    normal, right = np.zeros((count, 6, 6)), np.zeros((count, 6))
    scale = np.full(count, 1e-290)
    term = np.zeros(6)
    for i in range(count):
        for item in range(start[i], start[i + 1]):
            for k in range(2):
                scale[i] = max(scale[i], abs(points[neighbour[item], k] - points[centre[i], k]))
        for item in range(start[i], start[i + 1]):
            x, y, z = points[neighbour[item]] - points[centre[i]]
            _set_terms(term, x / scale[i], y / scale[i])
            for k in range(6):
                right[i, k] += term[k] * z
                for m in range(6):
                    normal[i, k, m] += term[k] * term[m]
    return normal, right, scale


@allocating
def _misfit(
    points: Array,
    centre: IntArray,
    start: Int32Array,
    neighbour: Int32Array,
    scale: Array,
    fit: Array,
) -> float:
    """Root mean square of what the fits (n, 6) leave, over all vertices and their neighbours."""
    total = 0.0
    term = np.zeros(6)
    for i in range(len(centre)):
        for item in range(start[i], start[i + 1]):
            x, y, z = points[neighbour[item]] - points[centre[i]]
            _set_terms(term, x / scale[i], y / scale[i])
            for k in range(6):
                z -= fit[i, k] * term[k]
            total += z * z
    return math.sqrt(total / len(neighbour))


@allocating
def interpolate(F: KernelField, data: Array, points: Array, out: Array) -> None:
    """``out`` (k, c): data (n, c) of the vertices at points (k, 2), linear in every triangle.

    Rows outside the surface stay as they are.
    """
    for i in range(len(points)):
        t, w0, w1, w2 = locate(F, points[i, 0], points[i, 1])
        if t >= 0:
            a, b, c = F.triangles[t, 0], F.triangles[t, 1], F.triangles[t, 2]
            out[i] = w0 * data[a] + w1 * data[b] + w2 * data[c]
