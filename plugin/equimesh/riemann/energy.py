"""How far a triangle is from unit and equilateral, and moves and flips that lower it.

With A = G0^-1 G, G the Gram matrix of a triangle's edges in the metric and G0 that of the unit
equilateral one, the energy is ``tr A + tr A^-1 - 4`` (symmetric Dirichlet): zero for the unit
equilateral triangle alone, infinite for a degenerate one, and the same for sizes h and 1 / h. The
metric is the mean of those at the midpoints of the edges. ``Mesh.ie`` holds each triangle's energy.
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled
from equimesh.optimise.mesh import FIXED, SLIDES
from equimesh.optimise.topology import ample, flip, flippable, note_triangle, note_vertex, star
from equimesh.riemann.kernels import metric_at, unit_frame

__all__ = ["edge_length", "energy_of", "move", "set_energy", "star_energy", "try_flip"]

_PROBE = 2e-3  # unit edges: differences of the energy
_LONGEST = 0.4  # move


@compiled
def _energy(ux, uy, vx, vy, m11, m12, m22):
    """Energy of the triangle 0, u, v in a constant metric."""
    guu = m11 * ux * ux + 2.0 * m12 * ux * uy + m22 * uy * uy
    guv = m11 * ux * vx + m12 * (ux * vy + uy * vx) + m22 * uy * vy
    gvv = m11 * vx * vx + 2.0 * m12 * vx * vy + m22 * vy * vy
    cross = ux * vy - uy * vx
    det = (m11 * m22 - m12 * m12) * cross * cross / 0.75
    if not (cross > 0.0 and det > 1e-30):
        return 1e30
    trace = 4.0 / 3.0 * (guu - guv + gvv)
    return trace + trace / det - 4.0


@compiled
def energy_of(P, m, a, b, c):
    """Energy of the triangle of vertices a, b, c."""
    ax, ay, bx, by, cx, cy = m.x[a], m.y[a], m.x[b], m.y[b], m.x[c], m.y[c]
    p11, p12, p22 = metric_at(P, 0.5 * (ax + bx), 0.5 * (ay + by))
    q11, q12, q22 = metric_at(P, 0.5 * (bx + cx), 0.5 * (by + cy))
    r11, r12, r22 = metric_at(P, 0.5 * (cx + ax), 0.5 * (cy + ay))
    k = 1.0 / 3.0
    return _energy(
        bx - ax, by - ay, cx - ax, cy - ay,
        k * (p11 + q11 + r11), k * (p12 + q12 + r12), k * (p22 + q22 + r22),
    )  # fmt: skip


@compiled
def set_energy(P, m, t):
    m.ie[t] = energy_of(P, m, m.tv[t, 0], m.tv[t, 1], m.tv[t, 2])


@compiled
def edge_length(P, m, a, b):
    """Metric length of the edge from a to b, by Simpson's rule."""
    dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
    total = 0.0
    for i in range(3):
        p, q, r = metric_at(P, m.x[a] + 0.5 * i * dx, m.y[a] + 0.5 * i * dy)
        weight = 4.0 if i == 1 else 1.0
        total += weight * math.sqrt(max(p * dx * dx + 2.0 * q * dx * dy + r * dy * dy, 0.0))
    return total / 6.0


@compiled
def try_flip(P, m, t, k):
    """Flip edge k of t if that lowers the energy of its two triangles."""
    u, a, b, c, d = flippable(m, t, k)
    if u < 0:
        return False
    before = m.ie[t] + m.ie[u]
    goal = before - 1e-6 * (1.0 + before)
    one = energy_of(P, m, c, a, d)
    if one >= goal:
        return False
    two = energy_of(P, m, d, b, c)
    if one + two >= goal:
        return False
    u = flip(m, t, k)
    m.ie[t], m.ie[u] = one, two
    return True


@compiled
def star_energy(m, n):
    """Energy of the star in ``m.ring``."""
    total = 0.0
    for i in range(n):
        total += m.ie[m.ring[1, i]]
    return total


@compiled
def _at(P, m, n, closed, x, y):
    """Energy of the star in ``m.ring`` with its centre at (x, y), the parts in ``m.work[6]``.

    Rows 0 to 2 of ``m.work`` hold the metric of the outer edges, 3 to 5 that of the spokes.
    """
    spokes = n if closed else n + 1
    for i in range(spokes):
        p = m.ring[0, i]
        m.work[3, i], m.work[4, i], m.work[5, i] = metric_at(
            P, 0.5 * (x + m.x[p]), 0.5 * (y + m.y[p])
        )
    total = 0.0
    for i in range(n):
        j = (i + 1) % spokes
        p, q = m.ring[0, i], m.ring[0, j]
        k = 1.0 / 3.0
        e = _energy(
            m.x[p] - x, m.y[p] - y, m.x[q] - x, m.y[q] - y,
            k * (m.work[0, i] + m.work[3, i] + m.work[3, j]),
            k * (m.work[1, i] + m.work[4, i] + m.work[4, j]),
            k * (m.work[2, i] + m.work[5, i] + m.work[5, j]),
        )  # fmt: skip
        m.work[6, i] = e
        total += e
    return total


@compiled
def _newton(P, m, n, closed, x, y, before, w1, w2, w3, w4, line):
    """Newton's step in the frame w, along its first axis only if ``line``, and the slopes."""
    h = _PROBE
    p1 = _at(P, m, n, closed, x + h * w1, y + h * w3)
    n1 = _at(P, m, n, closed, x - h * w1, y - h * w3)
    g1, h11 = (p1 - n1) / (2.0 * h), (p1 - 2.0 * before + n1) / (h * h)
    if line:
        return -g1 / max(abs(h11), 1.0), 0.0, g1, 0.0
    p2 = _at(P, m, n, closed, x + h * w2, y + h * w4)
    n2 = _at(P, m, n, closed, x - h * w2, y - h * w4)
    both = _at(P, m, n, closed, x + h * (w1 + w2), y + h * (w3 + w4))
    g2, h22 = (p2 - n2) / (2.0 * h), (p2 - 2.0 * before + n2) / (h * h)
    h12 = (both - p1 - p2 + before) / (h * h)
    # Eigenvalues made positive: downhill even where the energy is not convex.
    mean, half = 0.5 * (h11 + h22), 0.5 * (h11 - h22)
    radius = math.hypot(half, h12)
    top, low = max(abs(mean + radius), 1.0), max(abs(mean - radius), 1.0)
    angle = 0.5 * math.atan2(h12, half)
    cs, sn = math.cos(angle), math.sin(angle)
    a, b = (cs * g1 + sn * g2) / top, (cs * g2 - sn * g1) / low
    return -(cs * a - sn * b), -(sn * a + cs * b), g1, g2


@compiled
def move(P, m, v):
    """Move v to where the energy of its star is less; returns the gain (0: it stays)."""
    if m.kind[v] == FIXED:
        return 0.0
    n, closed = star(m, v)
    if n == 0:
        return 0.0
    x, y = m.x[v], m.y[v]
    spokes = n if closed else n + 1
    for i in range(n):
        p, q = m.ring[0, i], m.ring[0, (i + 1) % spokes]
        m.work[0, i], m.work[1, i], m.work[2, i] = metric_at(
            P, 0.5 * (m.x[p] + m.x[q]), 0.5 * (m.y[p] + m.y[q])
        )
    before = _at(P, m, n, closed, x, y)
    w1, w2, w3, w4 = unit_frame(*metric_at(P, x, y))
    line = m.kind[v] == SLIDES
    row = m.sides[m.side[v]]
    sx, sy = row[2] - row[0], row[3] - row[1]
    if line:
        p, q, r = metric_at(P, x, y)
        speed = math.sqrt(p * sx * sx + 2.0 * q * sx * sy + r * sy * sy)
        w1, w3 = sx / speed, sy / speed
    a, b, g1, g2 = _newton(P, m, n, closed, x, y, before, w1, w2, w3, w4, line)
    if not (math.isfinite(a) and math.isfinite(b)):
        return 0.0
    size = math.hypot(a, b)
    if size > _LONGEST:
        a, b = a * _LONGEST / size, b * _LONGEST / size
    slope = a * g1 + b * g2
    if not -slope > 1e-7:
        return 0.0
    for _ in range(6):
        nx, ny = x + a * w1 + b * w2, y + a * w3 + b * w4
        good = True
        if line:
            s = ((nx - row[0]) * sx + (ny - row[1]) * sy) / (sx * sx + sy * sy)
            nx, ny = row[0] + s * sx, row[1] + s * sy
            good = 0.0 < s < 1.0
        for i in range(n):
            p, q = m.ring[0, i], m.ring[0, (i + 1) % spokes]
            good = good and ample(nx, ny, m.x[p], m.y[p], m.x[q], m.y[q])
        if good and _at(P, m, n, closed, nx, ny) < before + 0.1 * slope:
            note_vertex(m, v)
            m.x[v], m.y[v] = nx, ny
            after = 0.0
            for i in range(n):
                note_triangle(m, m.ring[1, i])
                m.ie[m.ring[1, i]] = m.work[6, i]
                after += m.work[6, i]
            return before - after
        a, b, slope = 0.4 * a, 0.4 * b, 0.4 * slope
    return 0.0
