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
_ALIKE = 0.01


@compiled
def model_edge(m, a, b):
    """(signed largest error, position) of the chord from vertex a to vertex b between its ends."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ka = m.h[a, 0] * dx * dx + 2.0 * m.h[a, 1] * dx * dy + m.h[a, 2] * dy * dy
    kb = m.h[b, 0] * dx * dx + 2.0 * m.h[b, 1] * dx * dy + m.h[b, 2] * dy * dy
    # f'' = ka + (kb - ka) t gives e = -t (1 - t) (p + q t) / 6, less the heights of the ends.
    p, q, d = 2.0 * ka + kb, kb - ka, m.w[b] - m.w[a]
    first, second = 0.5, 0.5
    bend, slope = q - p, p + 6.0 * d  # 6 e' = 3 q t^2 - 2 bend t - slope
    inner = bend * bend + 3.0 * q * slope
    if inner > 0.0:
        root = bend + math.sqrt(inner) if bend > 0.0 else bend - math.sqrt(inner)
        first, second = root / (3.0 * q), -slope / root
    best, where = 0.0, 0.5
    for i in range(2):
        t = first if i == 0 else second
        if 0.0 < t < 1.0:
            e = -t * (1.0 - t) * (p + q * t) / 6.0 - m.w[a] - d * t
            if abs(e) > abs(best):
                best, where = e, t
    return best, where


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
    are the edges' bends, less the heights of the corners: for these 0 it is -R^2 / 2 at the
    circumcentre of their metric.
    """
    p, q, r = _bend(m, b, c), _bend(m, c, a), _bend(m, a, b)
    mixed = 0.5 * (p + q - r)
    det = p * q - mixed * mixed
    third = 1.0 / 3.0
    if det > 0.0:
        s, t = 0.5 * q + m.w[a] - m.w[c], 0.5 * p + m.w[b] - m.w[c]
        u, v = (p * s - mixed * t) / det, (q * t - mixed * s) / det
        w = 1.0 - u - v
        if u > 0.0 and v > 0.0 and w > 0.0:
            e = -0.5 * (p * v * w + q * w * u + r * u * v)
            return (
                e - u * m.w[a] - v * m.w[b] - w * m.w[c],
                u * m.x[a] + v * m.x[b] + w * m.x[c],
                u * m.y[a] + v * m.y[b] + w * m.y[c],
            )
    return 0.0, third * (m.x[a] + m.x[b] + m.x[c]), third * (m.y[a] + m.y[b] + m.y[c])


@compiled
def model_rise(m, v, r, dx, dy):
    """Gradient at (dx, dy) from vertex v minus that at v, with the Hessian between v and r."""
    hxx = 0.5 * (m.h[v, 0] + m.h[r, 0])
    hxy = 0.5 * (m.h[v, 1] + m.h[r, 1])
    hyy = 0.5 * (m.h[v, 2] + m.h[r, 2])
    return hxx * dx + hxy * dy, hxy * dx + hyy * dy
