"""The metric, its Christoffel symbols and geodesics in compiled kernels."""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.patch_kernels import locate

__all__ = ["christoffel", "geodesic", "metric_at", "orthonormal", "unit_frame"]


@inlined
def _polynomial(c, s, t):
    p = 0.0
    for i in range(5, -1, -1):
        q = c[i, 5]
        for j in range(4, -1, -1):
            q = q * t + c[i, j]
        p = p * s + q
    return p


@compiled
def metric_at(P, x, y):
    """M at a point: xx, xy, yy."""
    leaf, s, t, _ = locate(P.frame, P.child, x, y)
    l11 = _polynomial(P.coef[leaf, 0], s, t)
    l12 = _polynomial(P.coef[leaf, 1], s, t)
    l22 = _polynomial(P.coef[leaf, 2], s, t)
    mean, half = 0.5 * (l11 + l22), 0.5 * (l11 - l22)
    b = math.hypot(half, l12)
    scale = math.exp(mean)
    c = scale * math.cosh(b)
    f = scale * (math.sinh(b) / b if b > 1e-4 else 1.0 + b * b / 6.0)
    return c + f * half, f * l12, c - f * half


@compiled
def _slopes(P, x, y):
    """Log M (three numbers) and its derivatives by x and by y."""
    leaf, s, t, half = locate(P.frame, P.child, x, y)
    r = 1.0 / half
    out = (0.0, 0.0, 0.0)
    dx = (0.0, 0.0, 0.0)
    dy = (0.0, 0.0, 0.0)
    for k in range(3):
        c = P.coef[leaf, k]
        p = ps = pt = 0.0
        for i in range(5, -1, -1):
            q = qt = 0.0
            for j in range(5, -1, -1):
                qt = qt * t + q
                q = q * t + c[i, j]
            ps = ps * s + p
            p = p * s + q
            pt = pt * s + qt
        out = (out[1], out[2], p)
        dx = (dx[1], dx[2], ps * r)
        dy = (dy[1], dy[2], pt * r)
    return out, dx, dy


@inlined
def _derivative(scale, c, f, g, half, off, d11, d12, d22):
    """Slope along dL of exp L = c I + f B, B = (half off; off -half); g = (c - f) / b^2."""
    da, dp, dq = 0.5 * (d11 + d22), 0.5 * (d11 - d22), d12
    turn = half * dp + off * dq
    dc = da * c + f * turn
    df = da * f + g * turn
    return dc + df * half + f * dp, df * off + f * dq, dc - df * half - f * dp


@compiled
def christoffel(P, x, y):
    """Gamma^k_ij = M^kl (d_i M_lj + d_j M_li - d_l M_ij) / 2: ij = 11, 12, 22 of k = 1, then 2."""
    log, dx, dy = _slopes(P, x, y)
    mean, half, off = 0.5 * (log[0] + log[2]), 0.5 * (log[0] - log[2]), log[1]
    b = math.hypot(half, off)
    scale = math.exp(mean)
    c = scale * math.cosh(b)
    if b > 1e-2:
        f = scale * math.sinh(b) / b
        g = (c - f) / (b * b)
    else:
        f = scale * (1.0 + b * b / 6.0)
        g = scale * (1.0 / 3.0 + b * b / 30.0)
    m11, m12, m22 = c + f * half, f * off, c - f * half
    x11, x12, x22 = _derivative(scale, c, f, g, half, off, dx[0], dx[1], dx[2])
    y11, y12, y22 = _derivative(scale, c, f, g, half, off, dy[0], dy[1], dy[2])
    r = 0.5 / math.exp(log[0] + log[2])  # over the determinant
    # First kind, times two: [ij, l] = d_i M_lj + d_j M_li - d_l M_ij.
    a111, a112 = x11, 2.0 * x12 - y11
    a121, a122 = y11, x22
    a221, a222 = 2.0 * y12 - x22, y22
    return (
        r * (m22 * a111 - m12 * a112),
        r * (m22 * a121 - m12 * a122),
        r * (m22 * a221 - m12 * a222),
        r * (m11 * a112 - m12 * a111),
        r * (m11 * a122 - m12 * a121),
        r * (m11 * a222 - m12 * a221),
    )


@compiled
def geodesic(P, x, y, w, l1, l2, steps, out):
    """Follow the geodesic that starts with W l for a unit of its parameter, W parallel along it.

    ``x' = W l`` and ``W' = -Gamma(x') W`` by the classical method of Runge and Kutta; ``w`` (4,)
    is W row by row, ``out`` (6,) gets x, y, W.
    """
    a, b, c, d = w[0], w[1], w[2], w[3]
    h = 1.0 / steps
    for _ in range(steps):
        sx = sy = sa = sb = sc = sd = 0.0
        px, py, pa, pb, pc, pd = x, y, a, b, c, d
        for stage in range(4):
            dx, dy = pa * l1 + pb * l2, pc * l1 + pd * l2
            g1, g2, g3, g4, g5, g6 = christoffel(P, px, py)
            k11, k12 = g1 * dx + g2 * dy, g2 * dx + g3 * dy
            k21, k22 = g4 * dx + g5 * dy, g5 * dx + g6 * dy
            da, db = -(k11 * pa + k12 * pc), -(k11 * pb + k12 * pd)
            dc, dd = -(k21 * pa + k22 * pc), -(k21 * pb + k22 * pd)
            weight = 1.0 if stage == 0 or stage == 3 else 2.0
            sx += weight * dx
            sy += weight * dy
            sa += weight * da
            sb += weight * db
            sc += weight * dc
            sd += weight * dd
            ahead = h if stage == 2 else 0.5 * h
            px, py = x + ahead * dx, y + ahead * dy
            pa, pb, pc, pd = a + ahead * da, b + ahead * db, c + ahead * dc, d + ahead * dd
        k = h / 6.0
        x, y = x + k * sx, y + k * sy
        a, b, c, d = a + k * sa, b + k * sb, c + k * sc, d + k * sd
    out[0], out[1], out[2], out[3], out[4], out[5] = x, y, a, b, c, d


@compiled
def unit_frame(m11, m12, m22):
    """W = M^-1/2 row by row: W^T M W = I."""
    det = math.sqrt(max(m11 * m22 - m12 * m12, 1e-300))
    t = math.sqrt(m11 + m22 + 2.0 * det)
    r = 1.0 / (det * t)
    return r * (m22 + det), -r * m12, -r * m12, r * (m11 + det)


@compiled
def orthonormal(m11, m12, m22, w, out):
    """The frame that is orthonormal in M and nearest to w (polar decomposition)."""
    e1, e2, e3, e4 = unit_frame(m11, m12, m22)
    det = e1 * e4 - e2 * e3
    k11, k12 = (e4 * w[0] - e2 * w[2]) / det, (e4 * w[1] - e2 * w[3]) / det
    k21, k22 = (e1 * w[2] - e3 * w[0]) / det, (e1 * w[3] - e3 * w[1]) / det
    p, q = k11 + k22, k21 - k12
    r = math.hypot(p, q)
    if r > 0.0:
        p, q = p / r, q / r
    else:
        p, q = 1.0, 0.0
    out[0], out[1] = e1 * p + e2 * q, e2 * p - e1 * q
    out[2], out[3] = e3 * p + e4 * q, e4 * p - e3 * q
