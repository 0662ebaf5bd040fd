"""Insertion of vertices where an angle stays below its floor, after Ruppert."""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, outlined
from equimesh.optimise.insertion import split_edge, split_inside
from equimesh.optimise.mesh import EPOCH, FIXED, HELD

__all__ = ["beyond", "circumcentre", "crowded_side", "split_for_angle", "split_stiff"]

_STEPS = 200  # triangles on the way to a centre
_OBTUSE = 1e-6  # beyond a right angle


@compiled
def circumcentre(F, m, t):
    """Centre of t's circumcircle, a circle in the user's coordinates."""
    p, q, r = F.shape[1], F.shape[2], F.shape[3]
    a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
    ux, uy = p * (m.x[b] - m.x[a]) + q * (m.y[b] - m.y[a]), r * (m.y[b] - m.y[a])
    vx, vy = p * (m.x[c] - m.x[a]) + q * (m.y[c] - m.y[a]), r * (m.y[c] - m.y[a])
    d = 2.0 * (ux * vy - uy * vx)
    u2, v2 = ux * ux + uy * uy, vx * vx + vy * vy
    x, y = (vy * u2 - uy * v2) / d, (ux * v2 - vx * u2) / d
    y /= r
    return m.x[a] + (x - q * y) / p, m.y[a] + y


@compiled
def _length(F, dx, dy):
    return math.hypot(F.shape[1] * dx + F.shape[2] * dy, F.shape[3] * dy)


@compiled
def split_stiff(F, m, tol, t, k):
    """Split a border edge or a wall in the middle; beside a corner at a power of two from it.

    Sides that meet in a corner then have vertices at the same distances from it, and do not go on
    splitting each other (J. Ruppert, "A Delaunay refinement algorithm", 1995, sec. 6).
    """
    a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
    s = 0.5
    if (m.kind[a] % HELD == FIXED) != (m.kind[b] % HELD == FIXED):
        length = _length(F, m.x[b] - m.x[a], m.y[b] - m.y[a])
        s = 2.0 ** math.floor(math.log2(0.5 * length) + 0.5) / length
        if m.kind[b] % HELD == FIXED:
            s = 1.0 - s
    v = split_edge(F, m, tol, t, k, s)
    return v if v >= 0 else split_edge(F, m, tol, t, k, 0.5)


@compiled
def beyond(m, t, x, y):
    """The edge of t that (x, y) lies farthest beyond; -1 where it lies in t."""
    found, worst = -1, 0.0
    for k in range(3):
        a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
        dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
        turn = (dx * (y - m.y[a]) - dy * (x - m.x[a])) / math.hypot(dx, dy)
        if turn < worst:
            found, worst = k, turn
    return found


@compiled
def _stiff(m, t, k):
    return m.tn[t, k] < 0 or m.wall[t, k] == 1


@compiled
def _across(F, m, t, k, x, y):
    """Cosine of the angle at which (x, y) sees edge k of t, in the user's coordinates."""
    a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
    p, q, r = F.shape[1], F.shape[2], F.shape[3]
    ax, ay = p * (m.x[a] - x) + q * (m.y[a] - y), r * (m.y[a] - y)
    bx, by = p * (m.x[b] - x) + q * (m.y[b] - y), r * (m.y[b] - y)
    return (ax * bx + ay * by) / math.sqrt((ax * ax + ay * ay) * (bx * bx + by * by))


@compiled
def crowded_side(F, m, t):
    """An edge of t that must stay and that its third corner sees at more than a right angle."""
    for k in range(3):
        c = m.tv[t, (k + 2) % 3]
        if _stiff(m, t, k) and _across(F, m, t, k, m.x[c], m.y[c]) < -_OBTUSE:
            return k
    return -1


@compiled
def _crowded_by(F, m, t, x, y):
    """(triangle, edge) that must stay and has (x, y) of t in its circle; (-1, -1): none.

    Looks at the triangles whose circumcircles hold the point: those that it would change.
    """
    m.count[EPOCH] += 1
    epoch = m.count[EPOCH]
    stack = m.ring[3]
    stack[0] = t
    m.mark[t] = epoch
    size = 1
    while size > 0:
        size -= 1
        t = stack[size]
        for k in range(3):
            if _stiff(m, t, k):
                if _across(F, m, t, k, x, y) < 0.0:
                    return t, k
                continue
            u = m.tn[t, k]
            if m.mark[u] == epoch or size + 1 >= stack.shape[0]:
                continue
            m.mark[u] = epoch
            cx, cy = circumcentre(F, m, u)
            a = m.tv[u, 0]
            if _length(F, cx - x, cy - y) < _length(F, cx - m.x[a], cy - m.y[a]):
                stack[size] = u
                size += 1
    return -1, -1


@outlined
def split_for_angle(F, m, tol, t):
    """A vertex at the centre of t's circumcircle, after Ruppert; returns it, or -1.

    Where a border or a wall lies before it, or has it in its circle, that is split instead.
    """
    x, y = circumcentre(F, m, t)
    if not (math.isfinite(x) and math.isfinite(y)):
        return -1
    for _ in range(_STEPS):
        k = crowded_side(F, m, t)
        if k >= 0:
            return split_stiff(F, m, tol, t, k)
        k = beyond(m, t, x, y)
        if k < 0:
            break
        if _stiff(m, t, k):
            return split_stiff(F, m, tol, t, k)
        t = m.tn[t, k]
    s, k = _crowded_by(F, m, t, x, y)
    if s >= 0:
        return split_stiff(F, m, tol, s, k)
    v = split_inside(F, m, tol, t, x, y)
    if v >= 0:
        return v
    near, k, share = math.inf, -1, 0.5
    for i in range(3):  # on an edge, or next to one
        a, b = m.tv[t, i], m.tv[t, (i + 1) % 3]
        dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
        px, py = x - m.x[a], y - m.y[a]
        length = dx * dx + dy * dy
        if abs(dx * py - dy * px) / length < near:
            near, k = abs(dx * py - dy * px) / length, i
            share = min(max((px * dx + py * dy) / length, 0.2), 0.8)
    return split_edge(F, m, tol, t, k, share)
