"""Errors by Taylor's formula from second derivatives at the vertices: some fifty times cheaper.

Along an edge the second derivative is taken as linear, which is exact for cubics; inside a triangle
the Hessian is that of the mean. Good for finding where vertices should be and how many, while the
true errors have the last word.
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled

__all__ = ["alike", "model_edge", "model_inner", "model_rise"]

# Squares of relative differences of second derivatives, beyond which the true errors are asked.
_ALIKE = 0.02


@compiled
def _peak(p, q, t):
    """The error of the chord at t in units of -1/6, and t."""
    return t * (1.0 - t) * (p + q * t), t


@compiled
def model_edge(m, a, b):
    """(signed largest error, position) of the chord from vertex a to vertex b."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ka = m.h[a, 0] * dx * dx + 2.0 * m.h[a, 1] * dx * dy + m.h[a, 2] * dy * dy
    kb = m.h[b, 0] * dx * dx + 2.0 * m.h[b, 1] * dx * dy + m.h[b, 2] * dy * dy
    # f'' = ka + (kb - ka) t gives e = -t (1 - t) (p + q t) / 6.
    p, q = 2.0 * ka + kb, kb - ka
    if abs(q) < 0.02 * abs(p):
        # Second order in q / p around the middle.
        e, t = _peak(p, q, 0.5 + 0.125 * q / (p + 0.5 * q))
        return -e / 6.0, t
    root = math.sqrt(p * p + p * q + q * q)
    best, where = 0.0, 0.5
    for i in range(2):
        t = ((q - p) + (root if i == 0 else -root)) / (3.0 * q)
        if 0.0 < t < 1.0:
            e, t = _peak(p, q, t)
            if abs(e) > abs(best):
                best, where = e, t
    return -best / 6.0, where


@compiled
def alike(m, a, b):
    """Whether the second derivatives at two vertices are so near that higher ones hardly matter."""
    xx, xy, yy = m.h[a, 0] + m.h[b, 0], m.h[a, 1] + m.h[b, 1], m.h[a, 2] + m.h[b, 2]
    dxx, dxy, dyy = m.h[a, 0] - m.h[b, 0], m.h[a, 1] - m.h[b, 1], m.h[a, 2] - m.h[b, 2]
    size = xx * xx + 2.0 * xy * xy + yy * yy
    return dxx * dxx + 2.0 * dxy * dxy + dyy * dyy < _ALIKE * size


@compiled
def _bend(m, a, b):
    """Second derivative along the edge from a to b, times its length squared."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    hxx, hxy, hyy = m.h[a, 0] + m.h[b, 0], m.h[a, 1] + m.h[b, 1], m.h[a, 2] + m.h[b, 2]
    return 0.5 * (hxx * dx * dx + hyy * dy * dy) + hxy * dx * dy


@compiled
def model_inner(m, a, b, c):
    """(signed largest error, x, y) inside the triangle.

    With barycentric coordinates u, v, w the error is -(p v w + q w u + r u v) / 2, where p, q, r
    are the edges' bends: -R^2 / 2 at the circumcentre of their metric.
    """
    p, q, r = _bend(m, b, c), _bend(m, c, a), _bend(m, a, b)
    alpha, beta, gamma = p * (q + r - p), q * (r + p - q), r * (p + q - r)
    total = alpha + beta + gamma
    if alpha <= 0.0 or beta <= 0.0 or gamma <= 0.0:
        third = 1.0 / 3.0
        return (
            0.0,
            third * (m.x[a] + m.x[b] + m.x[c]),
            third * (m.y[a] + m.y[b] + m.y[c]),
        )
    u, v, w = alpha / total, beta / total, gamma / total
    return (
        -0.5 * p * q * r / total,
        u * m.x[a] + v * m.x[b] + w * m.x[c],
        u * m.y[a] + v * m.y[b] + w * m.y[c],
    )


@compiled
def model_rise(m, v, r, dx, dy):
    """Gradient at (dx, dy) from vertex v minus that at v, with the Hessian between v and r."""
    hxx = 0.5 * (m.h[v, 0] + m.h[r, 0])
    hxy = 0.5 * (m.h[v, 1] + m.h[r, 1])
    hyy = 0.5 * (m.h[v, 2] + m.h[r, 2])
    return hxx * dx + hxy * dy, hxy * dx + hyy * dy
