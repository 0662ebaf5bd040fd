"""Moves of single vertices.

A vertex moves by a damped Gauss-Newton step on the violated errors around it. At its peak p the
error of a spoke (v, r) is stationary in p, so its derivative is ``(1 - s) (grad f(p) - grad
f(v))``, and likewise with the barycentric weight of v for the inside of a triangle (vertices stay
on the graph).
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, outlined
from equimesh.fields.dispatch import gradient
from equimesh.fields.kernel import PATCHES
from equimesh.optimise.angles import angle_slope, by_angle
from equimesh.optimise.energy import (
    ROOM,
    edge_of,
    inner_of,
    lift,
    penalty,
    share_along,
    share_inside,
)
from equimesh.optimise.mesh import FIXED, FREE, HEIGHTS, HELD, MANNER, MODEL, SLIDES, SOFT
from equimesh.optimise.model import edge_gradient, inner_gradient
from equimesh.optimise.topology import ample, note_triangle, note_vertex, star

__all__ = ["move_vertex", "star_energy"]

# Share of a star's penalty that a move must lower it by, and that where the penalty is a power and
# nothing but a step on the way; half as much at least the errors' slopes must promise to make it
# worth a trial: of those that promise less one in five hundred succeeds.
_GAIN, _GAIN_OF_POWER = 5e-3, 2e-2
_SHARES = (1.0, 0.4, 0.16, 0.064)  # of a step that are tried


@compiled
def star_energy(m, n, closed):
    """Penalty of the spokes and insides of the star in ``m.ring``."""
    total = 0.0
    for i in range(n):
        t, k = m.ring[1, i], m.ring[2, i]
        total += penalty(m, m.ee[t, k]) + penalty(m, m.ie[t])
    if not closed:
        t, k = m.ring[1, n - 1], m.ring[2, n - 1]
        total += penalty(m, m.ee[t, (k + 2) % 3])
    return total


@outlined
def _trial(F, m, tol, v, n, closed, goal):
    """Penalty of the star at v's present coordinates, up to ``goal``; errors go to ``m.work``."""
    vx, vy = m.x[v], m.y[v]
    spokes = n if closed else n + 1
    for i in range(n):
        p = m.ring[0, i]
        q = m.ring[0, (i + 1) % spokes]
        if not ample(vx, vy, m.x[p], m.y[p], m.x[q], m.y[q]):
            return math.inf
    total = 0.0
    for i in range(spokes):
        e, s = edge_of(F, m, tol, v, m.ring[0, i])
        m.work[0, i], m.work[1, i] = e, s
        total += penalty(m, e)
        if total >= goal:
            return total
    for i in range(n):
        e, x, y = inner_of(F, m, tol, v, m.ring[0, i], m.ring[0, (i + 1) % spokes])
        m.work[2, i], m.work[3, i], m.work[4, i] = e, x, y
        total += penalty(m, e)
        if total >= goal:
            return total
    return total


@compiled
def store_star(m, v, n, closed):
    """Write the errors in ``m.work`` into the star's triangles."""
    for i in range(n):
        t, k = m.ring[1, i], m.ring[2, i]
        note_triangle(m, t)
        m.ie[t], m.ix[t], m.iy[t] = m.work[2, i], m.work[3, i], m.work[4, i]
        m.ee[t, k], m.ep[t, k] = m.work[0, i], m.work[1, i]
        j = (i + 1) % n if closed else i + 1
        m.ee[t, (k + 2) % 3], m.ep[t, (k + 2) % 3] = m.work[0, j], 1.0 - m.work[1, j]


@outlined
def _residuals(F, m, tol, v, n, closed):
    """Errors around v and their slopes, into ``m.work`` rows 5 to 8; returns how many.

    Row 5: error above the hinge; rows 6 and 7: its derivatives by v's place; row 8: by its height.
    """
    vx, vy = m.x[v], m.y[v]
    model = m.count[MODEL] == 1
    gx, gy = (m.jet[v, 0], m.jet[v, 1]) if model else gradient(F, vx, vy)
    if not (math.isfinite(gx) and math.isfinite(gy)):
        return 0
    count = 0
    spokes = n if closed else n + 1
    for i in range(spokes):
        if i < n:
            t, k = m.ring[1, i], m.ring[2, i]
            e, s = m.ee[t, k], m.ep[t, k]
        else:
            t, k = m.ring[1, n - 1], (m.ring[2, n - 1] + 2) % 3
            e, s = m.ee[t, k], 1.0 - m.ep[t, k]
        r = m.ring[0, i]
        if model:
            hx, hy = edge_gradient(m, v, r, s)
        else:
            hx, hy = gradient(F, vx + s * (m.x[r] - vx), vy + s * (m.y[r] - vy))
        if math.isfinite(hx) and math.isfinite(hy):
            w = (1.0 - s) * (1.0 if e > 0.0 else -1.0) * share_along(m, v, r)
            m.work[5, count] = abs(e) - m.hinge[0]
            m.work[6, count], m.work[7, count] = w * (hx - gx) / tol, w * (hy - gy) / tol
            m.work[8, count] = -w
            count += 1
    for i in range(n):
        t = m.ring[1, i]
        e = m.ie[t]
        if abs(e) < 0.8:
            continue
        p, q = m.ring[0, i], m.ring[0, (i + 1) % spokes]
        if by_angle(F, m, t):
            m.work[5, count] = e - m.hinge[0]
            m.work[6, count], m.work[7, count] = angle_slope(F, m, v, p, q)
            m.work[8, count] = 0.0
            count += 1
            continue
        area = (m.x[p] - vx) * (m.y[q] - vy) - (m.y[p] - vy) * (m.x[q] - vx)
        x, y = m.ix[t], m.iy[t]
        w = ((m.x[p] - x) * (m.y[q] - y) - (m.y[p] - y) * (m.x[q] - x)) / area
        hx, hy = inner_gradient(m, v, p, q, x, y) if model else gradient(F, x, y)
        if math.isfinite(hx) and math.isfinite(hy):
            w *= (1.0 if e > 0.0 else -1.0) * share_inside(m, v, p, q)
            m.work[5, count] = abs(e) - m.hinge[0]
            m.work[6, count], m.work[7, count] = w * (hx - gx) / tol, w * (hy - gy) / tol
            m.work[8, count] = -w
            count += 1
    return count


@compiled
def _gauss_newton(m, count):
    """Damped step (dx, dy, dz) on the violated errors among ``count``; dz in units of tol.

    All slopes, violated or not, measure lengths: damping by them does not see affine maps. A row of
    slopes that is 0 throughout keeps its variable where it is.
    """
    d11 = d12 = d22 = d33 = 1e-300
    for i in range(count):
        a, b, c = m.work[6, i], m.work[7, i], m.work[8, i]
        d11 += a * a
        d12 += a * b
        d22 += b * b
        d33 += c * c
    dx = dy = dz = 0.0
    for _ in range(3):
        h11, h12, h22, h33 = 0.02 * d11, 0.02 * d12, 0.02 * d22, 0.02 * d33
        h13 = h23 = g1 = g2 = g3 = 0.0
        for i in range(count):
            r = m.work[5, i]
            a, b, c = m.work[6, i], m.work[7, i], m.work[8, i]
            if r + a * dx + b * dy + c * dz > 0.0:
                h11 += a * a
                h12 += a * b
                h22 += b * b
                h13 += a * c
                h23 += b * c
                h33 += c * c
                g1 += a * r
                g2 += b * r
                g3 += c * r
        # Cholesky in three steps, z first: it stands alone where heights are given.
        a13, a23 = h13 / h33, h23 / h33
        h11, h12, h22 = h11 - a13 * h13, h12 - a13 * h23, h22 - a23 * h23
        g1, g2 = g1 - a13 * g3, g2 - a23 * g3
        det = h11 * h22 - h12 * h12
        if d22 <= 1e-300 and h11 > 0.0:  # along a line, or nowhere
            dx, dy = (-g1 / h11 if d11 > 1e-300 else 0.0), 0.0
        elif det > 1e-14 * h11 * h22:
            dx, dy = (-h22 * g1 + h12 * g2) / det, (-h11 * g2 + h12 * g1) / det
        else:
            return 0.0, 0.0, 0.0
        dz = -(g3 + h13 * dx + h23 * dy) / h33 if d33 > 1e-300 else 0.0
    return dx, dy, dz


@compiled
def _expected(m, count, dx, dy, dz):
    """Penalty of the errors around a vertex after a step, by their slopes."""
    total = 0.0
    for i in range(count):
        change = m.work[6, i] * dx + m.work[7, i] * dy + m.work[8, i] * dz
        total += penalty(m, m.work[5, i] + m.hinge[0] + change)
    return total


@outlined
def move_vertex(F, m, tol, v):
    """Move v where that lowers the penalty of its star; returns the gain (0: it stays).

    ``m.ring`` holds the star of v afterwards.
    """
    n, closed = star(m, v)
    kind, high = m.kind[v], m.count[HEIGHTS] == 1
    if n == 0 or kind >= HELD or (kind == FIXED and not high):
        return 0.0
    before = star_energy(m, n, closed)
    if before < 1e-3:
        return 0.0
    count = _residuals(F, m, tol, v, n, closed)
    ux = uy = 0.0
    side = m.sides[m.side[v]]
    if kind == SLIDES:
        ux, uy = side[2] - side[0], side[3] - side[1]
    if kind != FREE:
        for i in range(count):
            m.work[6, i], m.work[7, i] = m.work[6, i] * ux + m.work[7, i] * uy, 0.0
    if not high:
        for i in range(count):
            m.work[8, i] = 0.0
    sx, sy, dz = _gauss_newton(m, count)
    dx, dy = (sx, sy) if kind == FREE else (sx * ux, sx * uy)
    if not (math.isfinite(dx) and math.isfinite(dy) and math.isfinite(dz)) or (
        dx == 0.0 and dy == 0.0 and dz == 0.0
    ):
        return 0.0
    x, y, z, w = m.x[v], m.y[v], m.z[v], m.w[v]
    gx, gy, hxx, hxy, hyy = m.jet[v, 0], m.jet[v, 1], m.jet[v, 2], m.jet[v, 3], m.jet[v, 4]
    note_vertex(m, v)
    least = before * (_GAIN_OF_POWER if m.count[MANNER] >= SOFT else _GAIN)
    hope = _expected(m, count, 0.0, 0.0, 0.0) - 0.5 * least
    for k in range(4):
        scale = _SHARES[k]
        if _expected(m, count, scale * sx, scale * sy, scale * dz) > hope:
            continue
        nx, ny = x + scale * dx, y + scale * dy
        if kind == SLIDES:
            along = ((nx - side[0]) * ux + (ny - side[1]) * uy) / (ux * ux + uy * uy)
            nx, ny = side[0] + along * ux, side[1] + along * uy
            if along <= 0.0 or along >= 1.0:
                continue
        if high:
            m.w[v] = min(max(w + scale * dz * tol, -ROOM * tol), ROOM * tol)
        if lift(F, m, v, nx, ny):
            after = _trial(F, m, tol, v, n, closed, before - least)
            if after < before - least:
                store_star(m, v, n, closed)
                return before - after
    m.x[v], m.y[v], m.z[v], m.w[v] = x, y, z, w
    m.jet[v, 0], m.jet[v, 1] = gx, gy
    m.jet[v, 2], m.jet[v, 3], m.jet[v, 4] = hxx, hxy, hyy
    if F.kind != PATCHES and kind == FREE:
        return _probe(F, m, tol, v, n, closed, before)
    return 0.0


@compiled
def _probe(F, m, tol, v, n, closed, before):
    """Where slopes mean little: v towards the largest errors and the corners around it, or away.

    Takes the best of the places tried; returns the gain.
    """
    x, y, z, w = m.x[v], m.y[v], m.z[v], m.w[v]
    best, bx, by = before * 0.98, x, y
    for i in range(2 * n):
        t = m.ring[1, i % n]
        if i < n:
            r = m.ring[0, i]
            px, py = m.x[r], m.y[r]
        elif abs(m.ie[t]) > m.hinge[0]:
            px, py = m.ix[t], m.iy[t]
        else:
            continue
        for share in (0.3, 0.1):
            if i >= n:
                share *= 2.0
            nx, ny = x + share * (px - x), y + share * (py - y)
            if lift(F, m, v, nx, ny):
                after = _trial(F, m, tol, v, n, closed, best)
                if after < best:
                    best, bx, by = after, nx, ny
    if bx == x and by == y:
        m.x[v], m.y[v], m.z[v], m.w[v] = x, y, z, w
        return 0.0
    lift(F, m, v, bx, by)
    _trial(F, m, tol, v, n, closed, math.inf)
    store_star(m, v, n, closed)
    return before - best
