"""Errors of a mesh, measured without the mesher that made it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

__all__ = ["integral_of_root", "triangle_errors"]

Function = Callable[[np.ndarray, np.ndarray], np.ndarray]


def triangle_errors(f: Function, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(m,) largest |f - interpolant| of each triangle.

    All four functions solve an elliptic equation ``k1 f_xx + k2 f_yy = 0``, and so does the error:
    by the maximum principle it is largest on an edge. Along each edge: 65 samples, then a golden
    section about the largest.
    """
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    edges, number = np.unique(np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    a, b = points[edges[:, 0], :2], points[edges[:, 1], :2]
    fa, fb = f(*a.T), f(*b.T)

    def error(t: np.ndarray) -> np.ndarray:
        at = a[:, None] + t[..., None] * (b - a)[:, None]
        chord = fa[:, None] + t * (fb - fa)[:, None]
        return np.abs(f(at[..., 0].ravel(), at[..., 1].ravel()).reshape(t.shape) - chord)

    samples = np.broadcast_to(np.linspace(0.0, 1.0, 65), (len(edges), 65))
    at_samples = error(samples)
    best = samples[0][at_samples.argmax(axis=1)]
    low, high = np.maximum(best - 1 / 64, 0.0), np.minimum(best + 1 / 64, 1.0)
    ratio = 0.5 * (np.sqrt(5.0) - 1.0)
    for _ in range(30):
        inner = np.stack([high - ratio * (high - low), low + ratio * (high - low)], axis=1)
        e = error(inner)
        left = e[:, 0] > e[:, 1]
        low, high = np.where(left, low, inner[:, 0]), np.where(left, inner[:, 1], high)
    along = np.maximum(at_samples.max(axis=1), error(0.5 * (low + high)[:, None])[:, 0])
    return along[number.ravel()].reshape(-1, 3).max(axis=1)


def integral_of_root(hessian: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> float:
    """I = integral of sqrt|det(H / 2)| over the unit square, by Gauss in 20 x 20 cells."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    t = (np.arange(20)[:, None] + 0.5 * (nodes + 1.0)).ravel() / 20.0
    w = np.tile(0.5 * weights, 20) / 20.0
    x, y = (v.ravel() for v in np.meshgrid(t, t))
    root = np.sqrt(np.abs(np.linalg.det(0.5 * hessian(x, y))))
    return float(root @ np.outer(w, w).ravel())
