"""Splits and collapses of edges, noted in the journal of the mesh."""

from __future__ import annotations

from equimesh.fields.compiled import compiled
from equimesh.optimise.mesh import FREE
from equimesh.optimise.topology import (
    ample,
    drop_triangle,
    drop_vertex,
    new_triangle,
    new_vertex,
    note_triangle,
    note_vertex,
    redirect,
    star,
)
from equimesh.riemann.energy import set_energy

__all__ = ["collapse", "split"]


@compiled
def _become(m, t, a, b, c, n0, n1, n2):
    m.tv[t, 0], m.tv[t, 1], m.tv[t, 2] = a, b, c
    m.tn[t, 0], m.tn[t, 1], m.tn[t, 2] = n0, n1, n2


@compiled
def _hold(m, v, t):
    note_vertex(m, v)
    m.v2t[v] = t


@compiled
def split(P, m, t, k):
    """Put a vertex at the middle of edge k of t; returns it, or -1 where that is impossible."""
    a, b, c = m.tv[t, k], m.tv[t, (k + 1) % 3], m.tv[t, (k + 2) % 3]
    x, y = 0.5 * (m.x[a] + m.x[b]), 0.5 * (m.y[a] + m.y[b])
    u = m.tn[t, k]
    if u < 0:
        return -1
    j = 0
    while not (m.tn[u, j] == t and m.tv[u, j] == b):
        j += 1
    d = m.tv[u, (j + 2) % 3]
    for i in range(4):
        p = (a, c, b, d)[i]
        q = (d, a, c, b)[i]
        if not ample(x, y, m.x[q], m.y[q], m.x[p], m.y[p]) and not ample(
            x, y, m.x[p], m.y[p], m.x[q], m.y[q]
        ):
            return -1
    v = new_vertex(m, x, y, 0.0, FREE, 0)
    note_triangle(m, t)
    note_triangle(m, u)
    t1, u1 = new_triangle(m), new_triangle(m)
    bc, ca = m.tn[t, (k + 1) % 3], m.tn[t, (k + 2) % 3]
    ad, db = m.tn[u, (j + 1) % 3], m.tn[u, (j + 2) % 3]
    _become(m, t, c, a, v, ca, u1, t1)
    _become(m, t1, b, c, v, bc, t, u)
    _become(m, u, d, b, v, db, t1, u1)
    _become(m, u1, a, d, v, ad, u, t)
    redirect(m, bc, t, t1, b)
    redirect(m, ad, u, u1, a)
    _hold(m, a, t)
    _hold(m, b, t1)
    _hold(m, c, t)
    _hold(m, d, u)
    m.v2t[v] = t
    for s in (t, t1, u, u1):
        for i in range(3):
            m.wall[s, i] = 0
        set_energy(P, m, s)
    return v


@compiled
def collapse(P, m, v, w):
    """Merge the inner vertex v into its neighbour w; False, nothing changed, if one inverts."""
    if m.kind[v] != FREE:
        return False
    n, closed = star(m, v)
    if n < 3 or not closed:
        return False
    k = 0
    while k < n and m.ring[0, k] != w:
        k += 1
    if k == n:
        return False
    x, y = m.x[w], m.y[w]
    for i in range(n):
        j = (i + 1) % n
        if i != k and j != k:
            p, q = m.ring[0, i], m.ring[0, j]
            if not ample(x, y, m.x[p], m.y[p], m.x[q], m.y[q]):
                return False
    before = (k - 1) % n
    lost, other = m.ring[1, k], m.ring[1, before]
    right, left = m.ring[0, (k + 1) % n], m.ring[0, before]
    # Beyond the outer edges w-right of one lost triangle and left-w of the other.
    beyond = m.tn[lost, (m.ring[2, k] + 1) % 3]
    beyond_other = m.tn[other, (m.ring[2, before] + 1) % 3]
    for i in range(n):
        if i != k and i != before:
            t = m.ring[1, i]
            note_triangle(m, t)
            m.tv[t, m.ring[2, i]] = w
    first, last = m.ring[1, (k + 1) % n], m.ring[1, (k - 2) % n]
    m.tn[first, m.ring[2, (k + 1) % n]] = beyond
    m.tn[last, (m.ring[2, (k - 2) % n] + 2) % 3] = beyond_other
    redirect(m, beyond, lost, first, w)
    redirect(m, beyond_other, other, last, left)
    _hold(m, w, first)
    _hold(m, right, first)
    _hold(m, left, last)
    drop_triangle(m, lost)
    drop_triangle(m, other)
    drop_vertex(m, v)
    for i in range(n):
        if i != k and i != before:
            set_energy(P, m, m.ring[1, i])
    return True
