"""Greedy insertion: split the worst triangle at its worst point until all keep the tolerance.

After Garland and Heckbert ("Fast polygonal approximation of terrains and height fields", 1995),
with the exact error of the field between the samples, and Delaunay flips on the way.
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled
from equimesh.fields.kernel import RASTER
from equimesh.optimise.angles import by_angle
from equimesh.optimise.centres import beyond, circumcentre, split_for_angle
from equimesh.optimise.energy import edge_of, set_edge, set_inner, worst_of
from equimesh.optimise.insertion import split_edge, split_inside
from equimesh.optimise.mesh import FREE_TRIANGLES
from equimesh.optimise.topology import flip, flippable, star

__all__ = ["refine"]

_STEPS = 200  # triangles on the way to the centre of a circumcircle
_WIDE = -0.87  # the cosine of the angle above a wall, 150 degrees


@compiled
def _push(heap, key, size, t, e):
    i = size
    heap[i], key[i] = t, e
    while i > 0:
        parent = (i - 1) // 2
        if key[parent] >= key[i]:
            break
        heap[i], heap[parent] = heap[parent], heap[i]
        key[i], key[parent] = key[parent], key[i]
        i = parent
    return size + 1


@compiled
def _pop(heap, key, size):
    size -= 1
    heap[0], key[0] = heap[size], key[size]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= size:
            break
        if child + 1 < size and key[child + 1] > key[child]:
            child += 1
        if key[i] >= key[child]:
            break
        heap[i], heap[child] = heap[child], heap[i]
        key[i], key[child] = key[child], key[i]
        i = child
    return size


@compiled
def _not_delaunay(F, m, t, k):
    """Whether the vertex beyond edge k lies well inside the circumcircle of t.

    The circle is one in the user's coordinates where angles have a floor, else in local ones.
    """
    u, a, b, c, d = flippable(m, t, k)
    if u < 0:
        return False
    ax, ay = m.x[a] - m.x[d], m.y[a] - m.y[d]
    bx, by = m.x[b] - m.x[d], m.y[b] - m.y[d]
    cx, cy = m.x[c] - m.x[d], m.y[c] - m.y[d]
    if F.shape.shape[0] > 0:
        ax, ay = F.shape[1] * ax + F.shape[2] * ay, F.shape[3] * ay
        bx, by = F.shape[1] * bx + F.shape[2] * by, F.shape[3] * by
        cx, cy = F.shape[1] * cx + F.shape[2] * cy, F.shape[3] * cy
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    p = ax * (by * c2 - cy * b2)
    q = ay * (bx * c2 - cx * b2)
    r = a2 * (bx * cy - cx * by)
    return p - q + r > 1e-10 * (abs(p) + abs(q) + abs(r))


@compiled
def _restore_delaunay(F, m, tol, v):
    """Flips around a new vertex v; errors of what was flipped."""
    changed = True
    while changed:
        changed = False
        n, _ = star(m, v)
        for i in range(n):
            t, k = m.ring[1, i], (m.ring[2, i] + 1) % 3
            if _not_delaunay(F, m, t, k):
                _flipped(F, m, tol, t, k)
                changed = True
                break


@compiled
def _flipped(F, m, tol, t, k):
    """Flip edge k of t; returns the other triangle."""
    u = flip(m, t, k)
    e, s = edge_of(F, m, tol, m.tv[t, 2], m.tv[t, 0])
    set_edge(m, t, 2, e, s)
    set_inner(F, m, tol, t)
    set_inner(F, m, tol, u)
    return u


@compiled
def _flipped_before(F, m, tol, t):
    """Flip an edge that is not Delaunay on the way from t to the centre of its circumcircle.

    Only in a Delaunay triangulation are such circles empty, and their centres far from all
    vertices. Returns the two triangles, (-1, -1) where there is none to flip.
    """
    x, y = circumcentre(F, m, t)
    s = t
    for _ in range(_STEPS):
        for k in range(3):
            if _not_delaunay(F, m, s, k):
                return s, _flipped(F, m, tol, s, k)
        k = beyond(m, s, x, y)
        if k < 0 or m.tn[s, k] < 0 or m.wall[s, k] == 1:
            break
        s = m.tn[s, k]
    return -1, -1


@compiled
def _collect(m, heap, key):
    """Fill the heap with every violated triangle; returns its size."""
    size = 0
    for t in range(m.count[0]):
        if m.tv[t, 0] >= 0:
            e = worst_of(m, t)
            if e > 1.0:
                size = _push(heap, key, size, t, e)
    return size


@compiled
def _split_wall_beside(F, m, tol, t, x, y):
    """A vertex on the wall of t that a vertex at (x, y) would come too near to; -1 where none is.

    As in Ruppert's refinement ("A Delaunay refinement algorithm", 1995), whose segments give way
    to a vertex in their circle: vertices would crowd towards a wall, flips being unable to part
    them from it. Here they give way where the angle above them is wide.
    """
    for k in range(3):
        if m.wall[t, k] == 1:
            a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
            ax, ay, bx, by = m.x[a] - x, m.y[a] - y, m.x[b] - x, m.y[b] - y
            if ax * bx + ay * by < _WIDE * math.sqrt((ax * ax + ay * ay) * (bx * bx + by * by)):
                dx, dy = bx - ax, by - ay
                s = -(ax * dx + ay * dy) / (dx * dx + dy * dy)
                if 0.0 < s < 1.0:
                    return split_edge(F, m, tol, t, k, s)
    return -1


@compiled
def _split_at(F, m, tol, t, x, y):
    """A vertex at a point of t: on the nearest edge where it is too close to one for an inner
    vertex.

    -1 where the point is a corner of t, or outside it.
    """
    v = _split_wall_beside(F, m, tol, t, x, y)
    if v >= 0:
        return v
    v = split_inside(F, m, tol, t, x, y)
    if v >= 0:
        return v
    nearest, k, share = math.inf, -1, 0.0
    for i in range(3):
        a, b = m.tv[t, i], m.tv[t, (i + 1) % 3]
        dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
        px, py = x - m.x[a], y - m.y[a]
        length = dx * dx + dy * dy
        s = (px * dx + py * dy) / length
        distance = abs(dx * py - dy * px) / math.sqrt(length)
        if 0.0 < s < 1.0 and distance < nearest:
            nearest, k, share = distance, i, s
            if distance > 1e-6 * math.sqrt(length):
                k = -1
    if k < 0:
        return -1
    return split_edge(F, m, tol, t, k, share)


@compiled
def _split_worst(F, m, tol, t):
    """A vertex at t's largest error; -1 where none can be.

    A violated wall goes first: flips cannot put it right, and vertices beside it would crowd
    towards it. On a raster the largest error of another edge moves to the nearest sample, if that
    lies in one of the two triangles: a vertex between samples rarely lasts.
    """
    for i in range(3):
        if m.wall[t, i] == 1 and abs(m.ee[t, i]) > 1.0:
            v = split_edge(F, m, tol, t, i, m.ep[t, i])
            if v < 0:
                v = split_edge(F, m, tol, t, i, 0.5)
            if v >= 0:
                return v
    k, worst = -1, abs(m.ie[t])
    for i in range(3):
        if abs(m.ee[t, i]) > worst:
            k, worst = i, abs(m.ee[t, i])
    if k < 0 and by_angle(F, m, t):
        return split_for_angle(F, m, tol, t)
    if k < 0:
        return _split_at(F, m, tol, t, m.ix[t], m.iy[t])
    s = m.ep[t, k]
    if F.kind == RASTER:
        a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
        x = round(m.x[a] + s * (m.x[b] - m.x[a]))
        y = round(m.y[a] + s * (m.y[b] - m.y[a]))
        v = _split_at(F, m, tol, t, x, y)
        if v < 0 and m.tn[t, k] >= 0:
            v = _split_at(F, m, tol, m.tn[t, k], x, y)
        if v >= 0:
            return v
    a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
    x, y = m.x[a] + s * (m.x[b] - m.x[a]), m.y[a] + s * (m.y[b] - m.y[a])
    v = _split_wall_beside(F, m, tol, t, x, y)
    if v < 0 and m.tn[t, k] >= 0:
        v = _split_wall_beside(F, m, tol, m.tn[t, k], x, y)
    if v < 0:
        v = split_edge(F, m, tol, t, k, s)
    return v if v >= 0 else split_edge(F, m, tol, t, k, 0.5)


@compiled
def refine(F, m, tol, heap, key, most):
    """Insert until every error is at most ``tol``; False where the mesh ran out of slots.

    Stops at ``most`` triangles: at a jump no insertion helps.

    ``heap``, ``key``: scratch, several times as long as there are slots for triangles. A violated
    triangle that cannot be split is left.
    """
    size = _collect(m, heap, key)
    while size > 0:
        t, e = heap[0], key[0]
        size = _pop(heap, key, size)
        if m.tv[t, 0] < 0 or worst_of(m, t) != e:
            continue
        if m.count[0] - m.count[FREE_TRIANGLES] >= most:
            return True
        if m.count[0] + 16 > m.tv.shape[0] or m.count[1] + 4 > m.x.shape[0]:
            return False
        if by_angle(F, m, t):
            s, u = _flipped_before(F, m, tol, t)
            if s >= 0:
                for r in (s, u, t):
                    if worst_of(m, r) > 1.0 and size < heap.shape[0]:
                        size = _push(heap, key, size, r, worst_of(m, r))
                continue
        v = _split_worst(F, m, tol, t)
        if v < 0:
            continue
        _restore_delaunay(F, m, tol, v)
        if size + 600 > heap.shape[0]:  # mostly entries that are out of date
            size = _collect(m, heap, key)
            continue
        n, _ = star(m, v)
        for i in range(n):
            s = m.ring[1, i]
            worst = worst_of(m, s)
            if worst > 1.0:
                size = _push(heap, key, size, s, worst)
        if m.tv[t, 0] >= 0 and worst_of(m, t) == e:  # a wall beside it was split instead
            size = _push(heap, key, size, t, e)
    return True
