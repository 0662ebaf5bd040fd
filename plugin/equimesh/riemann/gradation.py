"""Limiting how fast sizes grow (F. Alauzet, "Size gradation control of anisotropic meshes")."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating
from equimesh.riemann.background import Background
from equimesh.riemann.tensors import packed, unpacked

__all__ = ["graded"]

_ROUNDS = 200
_STILL = 1e-6


@allocating
def _intersect(a, b, c, p, q, r):
    """Intersection of (a b; b c) with (p q; q r), and the largest ratio of the second to the
    first."""
    # Cholesky factor of the first, the second in its basis, the rotation that makes it diagonal.
    l11 = math.sqrt(a)
    l21 = b / l11
    l22 = math.sqrt(max(c - l21 * l21, 1e-300))
    s11 = p / (l11 * l11)
    s12 = (q - p * l21 / l11) / (l11 * l22)
    s22 = (r - 2.0 * q * l21 / l11 + p * l21 * l21 / (l11 * l11)) / (l22 * l22)
    half = 0.5 * (s11 - s22)
    radius = math.hypot(half, s12)
    mean = 0.5 * (s11 + s22)
    top, low = mean + radius, mean - radius
    if top <= 1.0:
        return a, b, c, top
    if low >= 1.0 or radius == 0.0:
        return p, q, r, top
    angle = 0.5 * math.atan2(s12, half)
    cs, sn = math.cos(angle), math.sin(angle)
    # I + (top - 1) v v^T, back through the factor.
    u, v = l11 * cs, l21 * cs + l22 * sn
    k = top - 1.0
    return a + k * u * u, b + k * u * v, c + k * v * v, top


@allocating
def _sweeps(points, edges, m, log_rate, rounds, still):
    """Intersect the tensors (n, 3) at both ends of every edge until nothing changes."""
    for _ in range(rounds):
        largest = 0.0
        for i in range(edges.shape[0]):
            for way in range(2):
                p, q = edges[i, way], edges[i, 1 - way]
                dx, dy = points[q, 0] - points[p, 0], points[q, 1] - points[p, 1]
                a, b, c = m[p, 0], m[p, 1], m[p, 2]
                length = math.sqrt(max(a * dx * dx + 2.0 * b * dx * dy + c * dy * dy, 0.0))
                grown = (1.0 + length * log_rate) ** -2.0
                x, y, z, ratio = _intersect(
                    m[q, 0], m[q, 1], m[q, 2], grown * a, grown * b, grown * c
                )
                if ratio > 1.0 + still:
                    m[q, 0], m[q, 1], m[q, 2] = x, y, z
                    largest = max(largest, ratio - 1.0)
        if largest <= still:
            return


def graded(background: Background, rate: float) -> Background:
    """The background with tensors so enlarged that sizes grow by at most ``rate``."""
    t = background.triangles
    edges: NDArray[np.int64] = np.unique(
        np.sort(np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), axis=1), axis=0
    )
    m = np.ascontiguousarray(packed(background.tensors))
    _sweeps(background.points, edges, m, math.log(rate), _ROUNDS, _STILL)
    return background.with_tensors(unpacked(m))
