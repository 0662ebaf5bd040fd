"""Errors from what a vertex knows of the surface: height, gradient and second derivatives there.

Between two vertices that makes the quintic that Hermite's formula asks for, inside a triangle the
mean of the corners' Taylor polynomials that is exact for cubics. Both cost a tenth of the true
errors. Where the surface changes much between vertices it is asked once more, in between. Good for
finding where vertices should be and how many, while the true errors have the last word.
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, inlined, outlined
from equimesh.fields.patch_kernels import derivatives2

__all__ = [
    "climbed", "edge_gradient", "halved_edge", "inner_gradient", "mixed_inner", "model_edge",
    "model_inner", "model_middle", "smooth_edge", "smooth_inside",
]  # fmt: skip

# Bounds beyond which the true errors are asked: of the quintic's part in slopes at an edge's ends,
_EVEN, _ODD = 0.8, 1.6
# of squares of relative differences of second derivatives, and of ratios of their determinants.
_ALIKE, _NEAR = 0.25, 0.3
_OUTSIDE = -0.3  # barycentric coordinate beyond which a first guess comes back into no triangle


@compiled
def smooth_edge(m, a, b):
    """Whether Hermite's formula is good between two vertices."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ga, ka = _along(m, a, dx, dy)
    gb, kb = _along(m, b, dx, dy)
    return _smooth(ga, ka, gb, kb, (m.z[b] - m.w[b]) - (m.z[a] - m.w[a]))


@inlined
def _smooth(ga, ka, gb, kb, rise):
    """Whether the quintic is nearly a cubic, in its even and in its odd part."""
    first, last = ga - rise, gb - rise
    size = abs(first) + abs(last)
    even, odd = abs(ka + kb + 2.0 * (first - last)), abs(kb - ka - 6.0 * (first + last))
    return even < _EVEN * size and odd < _ODD * size


@compiled
def smooth_inside(m, a, b, c):
    """Whether second derivatives are alike, at the corners and as far as slopes tell between them,
    and their determinants of one sign."""
    p, q, r = _determinant(m, a), _determinant(m, b), _determinant(m, c)
    if p < 0.0 and q < 0.0 and r < 0.0:
        return True  # a saddle's error has no peak inside
    if not min(p, q, r) > _NEAR * max(p, q, r):
        return False
    return _alike(m, a, b) and _alike(m, b, c) and _alike(m, c, a)


@inlined
def _determinant(m, v):
    return m.jet[v, 2] * m.jet[v, 4] - m.jet[v, 3] * m.jet[v, 3]


@compiled
def _alike(m, a, b):
    xx, xy, yy = m.jet[a, 2] + m.jet[b, 2], m.jet[a, 3] + m.jet[b, 3], m.jet[a, 4] + m.jet[b, 4]
    dxx, dxy, dyy = m.jet[a, 2] - m.jet[b, 2], m.jet[a, 3] - m.jet[b, 3], m.jet[a, 4] - m.jet[b, 4]
    size = xx * xx + 2.0 * xy * xy + yy * yy
    if not dxx * dxx + 2.0 * dxy * dxy + dyy * dyy < _ALIKE * size:
        return False
    # Where they vanish in between, as those of x^4 do, slopes change by less than they promise.
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ga, ka = _along(m, a, dx, dy)
    gb, kb = _along(m, b, dx, dy)
    return abs(ka + kb - 2.0 * (gb - ga)) < _EVEN * abs(gb - ga)


@inlined
def _along(m, v, dx, dy):
    """Slope and second derivative at v in direction (dx, dy)."""
    return (
        m.jet[v, 0] * dx + m.jet[v, 1] * dy,
        m.jet[v, 2] * dx * dx + 2.0 * m.jet[v, 3] * dx * dy + m.jet[v, 4] * dy * dy,
    )


@compiled
def model_edge(m, a, b):
    """(signed largest error, position) of the chord from vertex a to vertex b between its ends."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ga, ka = _along(m, a, dx, dy)
    gb, kb = _along(m, b, dx, dy)
    d = m.w[b] - m.w[a]
    return _peak(ga, ka, gb, kb, m.z[b] - m.z[a] - d, m.w[a], d)


@compiled
def model_middle(m, a, b):
    """Signed error of the chord from vertex a to vertex b in its middle."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ga, ka = _along(m, a, dx, dy)
    gb, kb = _along(m, b, dx, dy)
    return (10.0 * (ga - gb) + ka + kb) / 64.0 - 0.5 * (m.w[a] + m.w[b])


@outlined
def halved_edge(F, m, a, b):
    """The same with what the surface is in the middle, for each half; NaN where not even a half is
    smooth."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    ga, ka = _along(m, a, dx, dy)
    gb, kb = _along(m, b, dx, dy)
    z, gx, gy, hxx, hxy, hyy = derivatives2(
        F.frame, F.child, F.coef, m.x[a] + 0.5 * dx, m.y[a] + 0.5 * dy
    )
    g, k = 0.5 * (gx * dx + gy * dy), 0.25 * (hxx * dx * dx + 2.0 * hxy * dx * dy + hyy * dy * dy)
    ga, ka, gb, kb = 0.5 * ga, 0.25 * ka, 0.5 * gb, 0.25 * kb
    rise, fall = z - (m.z[a] - m.w[a]), (m.z[b] - m.w[b]) - z
    if not (_smooth(ga, ka, g, k, rise) and _smooth(g, k, gb, kb, fall)):
        return math.nan, 0.5
    w = 0.5 * (m.z[a] + m.z[b]) - z
    best, where = (-w if abs(w) > max(abs(m.w[a]), abs(m.w[b])) else 0.0), 0.5
    e, s = _peak(ga, ka, g, k, rise, m.w[a], w - m.w[a])
    if abs(e) > abs(best):
        best, where = e, 0.5 * s
    e, s = _peak(g, k, gb, kb, fall, w, m.w[b] - w)
    if abs(e) > abs(best):
        best, where = e, 0.5 + 0.5 * s
    return best, where


@compiled
def _peak(ga, ka, gb, kb, rise, above, d):
    """(signed largest error, position) between the ends of a chord that are ``above`` and
    ``above + d`` over a quintic with these slopes and second derivatives at its ends, which goes up
    by ``rise``."""
    # The error is c1 s + ... + c5 s^5, 0 at both ends, less their heights above the surface.
    c1, c2 = ga - rise, 0.5 * ka
    r0, r1, r2 = -c1 - c2, gb - rise - c1 - ka, kb - ka
    c3 = 10.0 * r0 - 4.0 * r1 + 0.5 * r2
    c4 = -15.0 * r0 + 7.0 * r1 - r2
    c5 = 6.0 * r0 - 3.0 * r1 + 0.5 * r2
    # Its peaks, first those of the cubic with the same slopes at the ends.
    first, last = c1 - d, gb - rise - d
    bend = -2.0 * first - last - 3.0 * d
    curve = 3.0 * (first + last) + 6.0 * d
    inner = bend * bend - curve * first
    s1 = s2 = -1.0
    if inner >= 0.0:
        root = -bend - math.sqrt(inner) if bend > 0.0 else -bend + math.sqrt(inner)
        s1, s2 = root / curve, first / root
    best, where = 0.0, 0.5
    for i in range(2):
        s = s1 if i == 0 else s2
        if 0.0 < s < 1.0:
            slope = first + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
            change = 2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
            t = s - slope / change
            if abs(t - s) < 0.2 and 0.0 < t < 1.0:
                s = t
            e = s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * c5)))) - above - d * s
            if abs(e) > abs(best):
                best, where = e, s
    return best, where


@compiled
def edge_gradient(m, a, b, s):
    """Gradient of the surface at the share s of the way from vertex a to vertex b."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    left = 1.0 - s
    to_b = s * s * (1.0 + 2.0 * left)
    at_a, at_b = s * left * left, -s * s * left
    gx = m.jet[a, 0] + to_b * (m.jet[b, 0] - m.jet[a, 0])
    gy = m.jet[a, 1] + to_b * (m.jet[b, 1] - m.jet[a, 1])
    gx += at_a * (m.jet[a, 2] * dx + m.jet[a, 3] * dy)
    gx += at_b * (m.jet[b, 2] * dx + m.jet[b, 3] * dy)
    gy += at_a * (m.jet[a, 3] * dx + m.jet[a, 4] * dy)
    gy += at_b * (m.jet[b, 3] * dx + m.jet[b, 4] * dy)
    return gx, gy


@compiled
def inner_gradient(m, a, b, c, x, y):
    """Gradient of the surface at (x, y) in the triangle."""
    ux, uy, vx, vy = m.x[b] - m.x[a], m.y[b] - m.y[a], m.x[c] - m.x[a], m.y[c] - m.y[a]
    area = ux * vy - uy * vx
    second = ((x - m.x[a]) * vy - (y - m.y[a]) * vx) / area
    third = (ux * (y - m.y[a]) - uy * (x - m.x[a])) / area
    gx = gy = 0.0
    for i in range(3):
        p, share = a, 1.0 - second - third
        if i == 1:
            p, share = b, second
        elif i == 2:
            p, share = c, third
        dx, dy = 0.5 * (x - m.x[p]), 0.5 * (y - m.y[p])
        gx += share * (m.jet[p, 0] + m.jet[p, 2] * dx + m.jet[p, 3] * dy)
        gy += share * (m.jet[p, 1] + m.jet[p, 3] * dx + m.jet[p, 4] * dy)
    return gx, gy


@compiled
def _bend(m, a, b):
    """Second derivative along the edge from a to b, times its length squared."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    hxx, hxy = m.jet[a, 2] + m.jet[b, 2], m.jet[a, 3] + m.jet[b, 3]
    hyy = m.jet[a, 4] + m.jet[b, 4]
    return 0.5 * (hxx * dx * dx + hyy * dy * dy) + hxy * dx * dy


@outlined
def model_inner(m, a, b, c):
    """(signed largest error, x, y) inside the triangle.

    By the edges' bends p, q, r alone the error is ``-(p v w + q w u + r u v) / 2`` in barycentric
    coordinates u, v, w, less the heights of the corners; from its peak one step of Newton's method
    leads to that of the corners' mean.
    """
    third = 1.0 / 3.0
    p, q, r = _bend(m, b, c), _bend(m, c, a), _bend(m, a, b)
    mixed = 0.5 * (p + q - r)
    det = p * q - mixed * mixed
    if det > 0.0:
        s, t = 0.5 * q + m.w[a] - m.w[c], 0.5 * p + m.w[b] - m.w[c]
        u, v = (p * s - mixed * t) / det, (q * t - mixed * s) / det
        if u > _OUTSIDE and v > _OUTSIDE and 1.0 - u - v > _OUTSIDE:
            x = m.x[c] + u * (m.x[a] - m.x[c]) + v * (m.x[b] - m.x[c])
            y = m.y[c] + u * (m.y[a] - m.y[c]) + v * (m.y[b] - m.y[c])
            gx, gy = inner_gradient(m, a, b, c, x, y)
            s = gx * (m.x[a] - m.x[c]) + gy * (m.y[a] - m.y[c]) - m.z[a] + m.z[c]
            t = gx * (m.x[b] - m.x[c]) + gy * (m.y[b] - m.y[c]) - m.z[b] + m.z[c]
            u, v = u - (p * s - mixed * t) / det, v - (q * t - mixed * s) / det
            w = 1.0 - u - v
            if u > 0.0 and v > 0.0 and w > 0.0:
                x = u * m.x[a] + v * m.x[b] + w * m.x[c]
                y = u * m.y[a] + v * m.y[b] + w * m.y[c]
                e = u * _above(m, a, x, y) + v * _above(m, b, x, y) + w * _above(m, c, x, y)
                return e, x, y
    return 0.0, third * (m.x[a] + m.x[b] + m.x[c]), third * (m.y[a] + m.y[b] + m.y[c])


@outlined
def mixed_inner(m, a, b, c, low):
    """The same where second derivatives differ much: the best of four samples of the corners' mean,
    then Newton's method with the mean of their second derivatives. Below ``low`` a sample will do.
    """
    third = 1.0 / 3.0
    best, u, v = 0.0, third, third
    if _determinant(m, a) > 0.0 or _determinant(m, b) > 0.0 or _determinant(m, c) > 0.0:
        best = _mean(m, a, b, c, third, third)
        for i in range(3):
            s, t = (0.5 if i == 0 else 0.25), (0.5 if i == 1 else 0.25)
            e = _mean(m, a, b, c, s, t)
            if abs(e) > abs(best):
                best, u, v = e, s, t
    ax, ay, bx, by = m.x[a] - m.x[c], m.y[a] - m.y[c], m.x[b] - m.x[c], m.y[b] - m.y[c]
    for _ in range(2):
        w = 1.0 - u - v
        hxx = u * m.jet[a, 2] + v * m.jet[b, 2] + w * m.jet[c, 2]
        hxy = u * m.jet[a, 3] + v * m.jet[b, 3] + w * m.jet[c, 3]
        hyy = u * m.jet[a, 4] + v * m.jet[b, 4] + w * m.jet[c, 4]
        if abs(best) < low or hxx * hyy <= hxy * hxy:
            break
        gx, gy = inner_gradient(m, a, b, c, m.x[c] + u * ax + v * bx, m.y[c] + u * ay + v * by)
        s = gx * ax + gy * ay - m.z[a] + m.z[c]
        t = gx * bx + gy * by - m.z[b] + m.z[c]
        p = hxx * ax * ax + 2.0 * hxy * ax * ay + hyy * ay * ay
        q = hxx * bx * bx + 2.0 * hxy * bx * by + hyy * by * by
        mixed = hxx * ax * bx + hxy * (ax * by + ay * bx) + hyy * ay * by
        det = p * q - mixed * mixed
        s, t = u - (q * s - mixed * t) / det, v - (p * t - mixed * s) / det
        if not (s > 0.0 and t > 0.0 and s + t < 1.0):
            break
        e = _mean(m, a, b, c, s, t)
        if abs(e) <= abs(best):
            break
        best, u, v = e, s, t
    return best, m.x[c] + u * ax + v * bx, m.y[c] + u * ay + v * by


@compiled
def _mean(m, a, b, c, u, v):
    """Error at barycentric coordinates u, v, 1 - u - v by the corners' mean."""
    w = 1.0 - u - v
    x = u * m.x[a] + v * m.x[b] + w * m.x[c]
    y = u * m.y[a] + v * m.y[b] + w * m.y[c]
    return u * _above(m, a, x, y) + v * _above(m, b, x, y) + w * _above(m, c, x, y)


@outlined
def climbed(F, m, a, b, c, x, y):
    """(signed error, x, y) of the triangle where one step of Newton's method on the surface itself
    leads from (x, y), or there if it leads to no peak inside."""
    ux, uy, uz = m.x[b] - m.x[a], m.y[b] - m.y[a], m.z[b] - m.z[a]
    vx, vy, vz = m.x[c] - m.x[a], m.y[c] - m.y[a], m.z[c] - m.z[a]
    area = ux * vy - uy * vx
    sx, sy = (uz * vy - vz * uy) / area, (ux * vz - vx * uz) / area
    f, fx, fy, hxx, hxy, hyy = derivatives2(F.frame, F.child, F.coef, x, y)
    dx, dy = x - m.x[a], y - m.y[a]
    e = f - m.z[a] - sx * dx - sy * dy
    det = hxx * hyy - hxy * hxy
    if det > 0.0 and hxx * e < 0.0:
        fx, fy = fx - sx, fy - sy
        px, py = (hxy * fy - hyy * fx) / det, (hxy * fx - hxx * fy) / det
        u = ((dx + px) * vy - (dy + py) * vx) / area
        v = (ux * (dy + py) - uy * (dx + px)) / area
        gain = 0.5 * (fx * px + fy * py)
        if u > 0.0 and v > 0.0 and u + v < 1.0 and abs(gain) < abs(e):
            return e + gain, x + px, y + py
    return e, x, y


@inlined
def _above(m, v, x, y):
    """What v adds to the height of the surface at (x, y) above the vertices.

    With barycentric weights the sum is exact for cubics: two thirds of the slope's part and a third
    of the second derivatives' make up for each other's third order.
    """
    slope, bend = _along(m, v, x - m.x[v], y - m.y[v])
    return 2.0 / 3.0 * slope + bend / 6.0 - m.w[v]
