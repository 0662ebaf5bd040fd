"""Insertion of vertices where errors stay above the tolerance."""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, outlined
from equimesh.fields.dispatch import value
from equimesh.optimise.energy import edge_of, lift, set_edge, set_inner
from equimesh.optimise.mesh import FIXED, FREE, HELD, SEAM, SLIDES
from equimesh.optimise.topology import (
    new_triangle,
    new_vertex,
    note_triangle,
    note_vertex,
    positive,
    redirect,
    turns_by,
)

__all__ = ["split_edge", "split_inside"]


# What is nearer to an edge that must stay than this share of its length belongs onto it: flips
# cannot take away the sliver between.
_BESIDE = 4e-7


@outlined
def split_inside(F, m, tol, t, x, y):
    """Put a vertex at (x, y) inside t; returns it, or -1 where that is impossible."""
    a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
    for k in range(3):
        i, j = m.tv[t, k], m.tv[t, (k + 1) % 3]
        if not positive(m.x[i], m.y[i], m.x[j], m.y[j], x, y):
            return -1
        stays = m.tn[t, k] < 0 or m.wall[t, k] == 1
        if stays and not turns_by(m.x[i], m.y[i], m.x[j], m.y[j], x, y, _BESIDE):
            return -1
    z = value(F, x, y)
    if not math.isfinite(z):
        return -1
    v = new_vertex(m, x, y, z, FREE, 0)
    m.w[v] = (m.w[a] + m.w[b] + m.w[c]) / 3.0
    m.share[v] = (m.share[a] + m.share[b] + m.share[c]) / 3.0
    lift(F, m, v, x, y)
    note_triangle(m, t)
    t1, t2 = new_triangle(m), new_triangle(m)
    n1, n2 = m.tn[t, 1], m.tn[t, 2]
    _become(m, t1, b, c, v, n1, t2, t, m.wall[t, 1], m.ee[t, 1], m.ep[t, 1])
    _become(m, t2, c, a, v, n2, t, t1, m.wall[t, 2], m.ee[t, 2], m.ep[t, 2])
    redirect(m, n1, t, t1, b)
    redirect(m, n2, t, t2, c)
    _become(m, t, a, b, v, m.tn[t, 0], t1, t2, m.wall[t, 0], m.ee[t, 0], m.ep[t, 0])
    for k in range(3):
        w = m.tv[t1, k] if k < 2 else a
        note_vertex(m, w)
    m.v2t[a], m.v2t[b], m.v2t[c], m.v2t[v] = t, t, t1, t
    for s in (t, t1, t2):
        e, p = edge_of(F, m, tol, m.tv[s, 1], v)
        set_edge(m, s, 1, e, p)
        set_inner(F, m, tol, s)
    return v


@compiled
def _become(m, t, a, b, c, n0, n1, n2, wall, e, p):
    """Write triangle t = (a, b, c) with its neighbours; edge 0 keeps what it had."""
    m.tv[t, 0], m.tv[t, 1], m.tv[t, 2] = a, b, c
    m.tn[t, 0], m.tn[t, 1], m.tn[t, 2] = n0, n1, n2
    m.wall[t, 0], m.wall[t, 1], m.wall[t, 2] = wall, 0, 0
    m.ee[t, 0], m.ep[t, 0] = e, p


@compiled
def _onto_border(m, t, k, s):
    """Where a vertex at the share s of an inner edge belongs: triangle, edge and share.

    Another edge of one of the two triangles, where that must stay and is so near that the vertex
    would lie beside it. Once it lies on it, flips can take away the sliver.
    """
    a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
    x, y = m.x[a] + s * (m.x[b] - m.x[a]), m.y[a] + s * (m.y[b] - m.y[a])
    for r in (t, m.tn[t, k]):
        for j in range(3):
            if m.tn[r, j] >= 0 and m.wall[r, j] == 0:
                continue
            p, q = m.tv[r, j], m.tv[r, (j + 1) % 3]
            if turns_by(m.x[p], m.y[p], m.x[q], m.y[q], x, y, _BESIDE):
                continue
            dx, dy = m.x[q] - m.x[p], m.y[q] - m.y[p]
            along = ((x - m.x[p]) * dx + (y - m.y[p]) * dy) / (dx * dx + dy * dy)
            return r, j, min(max(along, 0.1), 0.9)
    return t, k, s


@outlined
def split_edge(F, m, tol, t, k, s):
    """Put a vertex at the share s of edge k of t; returns it, or -1 where that is impossible."""
    if m.tn[t, k] >= 0 and m.wall[t, k] == 0:
        t, k, s = _onto_border(m, t, k, s)
    a, b, c = m.tv[t, k], m.tv[t, (k + 1) % 3], m.tv[t, (k + 2) % 3]
    x, y = m.x[a] + s * (m.x[b] - m.x[a]), m.y[a] + s * (m.y[b] - m.y[a])
    u = m.tn[t, k]
    wall = m.wall[t, k]
    if wall >= SEAM:
        return -1
    if not (
        positive(m.x[a], m.y[a], x, y, m.x[c], m.y[c])
        and positive(x, y, m.x[b], m.y[b], m.x[c], m.y[c])
    ):
        return -1
    j = -1
    if u >= 0:
        for i in range(3):
            if m.tn[u, i] == t and m.tv[u, i] == b:
                j = i
        d = m.tv[u, (j + 2) % 3]
        if not (
            positive(m.x[b], m.y[b], x, y, m.x[d], m.y[d])
            and positive(x, y, m.x[a], m.y[a], m.x[d], m.y[d])
        ):
            return -1
    z = value(F, x, y)
    on = math.isfinite(z)
    if not on:
        # An outline drawn within the tolerance may leave the surface: stay on the chord.
        if u >= 0:
            return -1
        z = m.z[a] + s * (m.z[b] - m.z[a])
    kind, side = FREE, 0
    if u < 0 or wall == 1:
        kind, side = SLIDES, _common_side(m, a, b)
        if side < 0:
            kind, side = FIXED, 0
    v = new_vertex(m, x, y, z, kind, side)
    m.w[v] = m.w[a] + s * (m.w[b] - m.w[a]) if on else 0.0
    m.share[v] = m.share[a] + s * (m.share[b] - m.share[a])
    if on:
        lift(F, m, v, x, y)
    note_triangle(m, t)
    k1, k2 = (k + 1) % 3, (k + 2) % 3
    t1 = new_triangle(m)
    nbc, nca = m.tn[t, k1], m.tn[t, k2]
    wbc, wca, ebc, pbc = m.wall[t, k1], m.wall[t, k2], m.ee[t, k1], m.ep[t, k1]
    eca, pca = m.ee[t, k2], m.ep[t, k2]
    # t = (c, a, v), t1 = (b, c, v): edge 0 of each is an old one.
    _become(m, t1, b, c, v, nbc, t, -1, wbc, ebc, pbc)
    _become(m, t, c, a, v, nca, -1, t1, wca, eca, pca)
    redirect(m, nbc, t, t1, b)
    m.wall[t, 1], m.wall[t1, 2] = wall, wall
    note_vertex(m, a)
    note_vertex(m, b)
    note_vertex(m, c)
    m.v2t[a], m.v2t[c], m.v2t[b], m.v2t[v] = t, t, t1, t
    if u >= 0:
        note_triangle(m, u)
        j1, j2 = (j + 1) % 3, (j + 2) % 3
        d = m.tv[u, j2]
        u1 = new_triangle(m)
        nad, ndb = m.tn[u, j1], m.tn[u, j2]
        wad, wdb, ead, pad = m.wall[u, j1], m.wall[u, j2], m.ee[u, j1], m.ep[u, j1]
        edb, pdb = m.ee[u, j2], m.ep[u, j2]
        # u = (d, b, v) beyond t1; u1 = (a, d, v) beyond t.
        _become(m, u1, a, d, v, nad, u, t, wad, ead, pad)
        _become(m, u, d, b, v, ndb, t1, u1, wdb, edb, pdb)
        redirect(m, nad, u, u1, a)
        m.wall[u, 1], m.wall[u1, 2] = wall, wall
        m.tn[t, 1], m.tn[t1, 2] = u1, u
        note_vertex(m, d)
        m.v2t[d] = u
        e, p = edge_of(F, m, tol, d, v)
        m.ee[u, 2], m.ep[u, 2] = e, 1.0 - p
        m.ee[u1, 1], m.ep[u1, 1] = e, p
    e, p = edge_of(F, m, tol, c, v)
    m.ee[t, 2], m.ep[t, 2] = e, 1.0 - p
    m.ee[t1, 1], m.ep[t1, 1] = e, p
    e, p = edge_of(F, m, tol, a, v)
    set_edge(m, t, 1, e, p)
    e, p = edge_of(F, m, tol, v, b)
    set_edge(m, t1, 2, e, p)
    set_inner(F, m, tol, t)
    set_inner(F, m, tol, t1)
    if u >= 0:
        set_inner(F, m, tol, u)
        set_inner(F, m, tol, u1)
    return v


@compiled
def _common_side(m, a, b):
    """The segment on which a border edge or a wall lies, -1 if its ends do not tell."""
    if m.kind[a] % HELD == SLIDES:
        return m.side[a]
    if m.kind[b] % HELD == SLIDES:
        return m.side[b]
    for s in range(m.sides.shape[0]):
        row = m.sides[s]
        if row[0] == m.x[a] and row[1] == m.y[a] and row[2] == m.x[b] and row[3] == m.y[b]:
            return s
        if row[0] == m.x[b] and row[1] == m.y[b] and row[2] == m.x[a] and row[3] == m.y[a]:
            return s
    return -1
