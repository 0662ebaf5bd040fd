"""Vertex removal: the best retriangulation of the hole, then repair, or as if nothing had been."""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled, outlined
from equimesh.optimise.energy import edge_of, inner_of, penalty, set_inner, worst_of
from equimesh.optimise.mesh import EPOCH, FREE, LOG_T, SLIDES
from equimesh.optimise.topology import (
    ample,
    begin,
    commit,
    drop_triangle,
    drop_vertex,
    new_triangle,
    note_triangle,
    note_vertex,
    rollback,
    room_left,
    star,
)

__all__ = ["remove_if_clean", "remove_vertex", "touched_excess"]

_MOST = 20  # corners of a hole


@outlined
def remove_vertex(F, m, tol, v, goal):
    """Remove v and fill the hole with the triangulation of least penalty (dynamic programming).

    Returns the penalty of the filling, or -1 (nothing changed): v cannot go, or it is not below
    ``goal``. A vertex on a side may go where its two border neighbours lie on the same side; of one
    that slides on a wall the two neighbours there are joined, and the hole is filled in two parts.
    """
    kind = m.kind[v]
    if kind != FREE and kind != SLIDES:
        return -1.0
    n, closed = star(m, v)
    if n == 0 or n > _MOST or (not closed and n < 2) or (closed and n < 3):
        return -1.0
    first = chord = 0
    if closed and kind == SLIDES:
        first, chord = _wall_spokes(m, n)
        if chord < 2 or n - chord < 2:
            return -1.0
    halved = chord > 0
    joined = closed and not halved
    # A hole in two parts has its first corner again at the end.
    size = n if joined else n + 1
    # ring: corners of the hole; outer: triangle and wall beyond each of its edges, with its error.
    apex, stack = m.hole_i[0], m.hole_i[2]
    ring, old = m.hole_i[1, 0], m.hole_i[1, 1]
    outer, wall = m.hole_i[1, 2], m.hole_i[1, 3]
    # cost[i, j]: least penalty inside the part of the hole cut off by the diagonal i-j.
    cost, edge_e, edge_p = m.hole_f[0], m.hole_f[1], m.hole_f[2]
    outer_e, outer_p = m.hole_f[3, 0], m.hole_f[3, 1]
    for i in range(n):
        t, k = m.ring[1, (first + i) % n], m.ring[2, (first + i) % n]
        if not halved and (m.wall[t, k] == 1 or m.wall[t, (k + 2) % 3] == 1):
            return -1.0
        old[i] = t
        ring[i] = m.ring[0, (first + i) % n]
        outer[i] = m.tn[t, (k + 1) % 3]
        wall[i] = m.wall[t, (k + 1) % 3]
        outer_e[i], outer_p[i] = m.ee[t, (k + 1) % 3], m.ep[t, (k + 1) % 3]
    if not closed:
        ring[n] = m.ring[0, n]
    elif halved:
        ring[n] = ring[0]
    for i in range(size - 1):
        cost[i, i + 1] = 0.0
    for i in range(size):
        for j in range(i + 2, size):
            if (joined and i == 0 and j == size - 1) or i < chord < j:
                continue
            edge_e[i, j], edge_p[i, j] = edge_of(F, m, tol, ring[i], ring[j])
    if halved:
        edge_e[chord, n], edge_p[chord, n] = edge_e[0, chord], 1.0 - edge_p[0, chord]
    for span in range(2, size):
        for i in range(size - span):
            j = i + span
            if i < chord < j:
                continue
            own = 0.0
            if not (joined and i == 0 and j == size - 1):
                own = penalty(m, edge_e[i, j])
            best = math.inf
            if own < goal:
                for k in range(i + 1, j):
                    below = own + cost[i, k] + cost[k, j]
                    if below >= best or below >= goal:
                        continue
                    a, b, c = ring[i], ring[k], ring[j]
                    if not ample(m.x[a], m.y[a], m.x[b], m.y[b], m.x[c], m.y[c]):
                        continue
                    e, _, _ = inner_of(F, m, tol, a, b, c)
                    below += penalty(m, e)
                    if below < best:
                        best = below
                        apex[i, j] = k
            cost[i, j] = best
    if halved:
        filled = cost[0, chord] + cost[chord, n] - penalty(m, edge_e[0, chord])
    else:
        filled = cost[0, size - 1]
    if not filled < goal:
        return -1.0
    for i in range(n):
        drop_triangle(m, old[i])
    drop_vertex(m, v)
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = chord, size - 1, -1, 0
    stack[1, 0], stack[1, 1], stack[1, 2], stack[1, 3] = 0, chord, -1, 0
    top = 2 if halved else 1
    beyond = -1
    while top > 0:
        top -= 1
        i, j, parent, parent_edge = (
            stack[top, 0],
            stack[top, 1],
            stack[top, 2],
            stack[top, 3],
        )
        k = apex[i, j]
        t = new_triangle(m)
        m.tv[t, 0], m.tv[t, 1], m.tv[t, 2] = ring[i], ring[k], ring[j]
        for corner in range(3):
            w = m.tv[t, corner]
            note_vertex(m, w)
            m.v2t[w] = t
            m.wall[t, corner] = 0
        if parent >= 0:
            m.tn[t, 2] = parent
            m.tn[parent, parent_edge] = t
            m.ee[t, 2], m.ep[t, 2] = edge_e[i, j], 1.0 - edge_p[i, j]
            m.ee[parent, parent_edge] = edge_e[i, j]
            m.ep[parent, parent_edge] = edge_p[i, j]
        elif joined:
            _sew(m, t, 2, outer, wall, outer_e, outer_p, size - 1)
        else:
            m.tn[t, 2] = beyond
            m.ee[t, 2], m.ep[t, 2] = edge_e[i, j], 1.0 - edge_p[i, j]
            if halved:
                m.wall[t, 2] = 1
                if beyond >= 0:
                    m.tn[beyond, 2] = t
                beyond = t
        if k == i + 1:
            _sew(m, t, 0, outer, wall, outer_e, outer_p, i)
        else:
            stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = i, k, t, 0
            top += 1
        if j == k + 1:
            _sew(m, t, 1, outer, wall, outer_e, outer_p, k)
        else:
            stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = k, j, t, 1
            top += 1
        set_inner(F, m, tol, t)
    return filled


@compiled
def _wall_spokes(m, n):
    """Index of the first wall among the spokes of a closed star, and steps from it to the second.

    0 steps where there are not two.
    """
    first, second, count = 0, 0, 0
    for i in range(n):
        if m.wall[m.ring[1, i], m.ring[2, i]] == 1:
            first, second = second, i
            count += 1
    return (first, second - first) if count == 2 else (0, 0)


@compiled
def _sew(m, t, k, outer, wall, outer_e, outer_p, i):
    """Join edge k of the new triangle t to what lies beyond edge i of the hole."""
    u = outer[i]
    m.tn[t, k] = u
    m.wall[t, k] = wall[i]
    m.ee[t, k], m.ep[t, k] = outer_e[i], outer_p[i]
    if u >= 0:
        note_triangle(m, u)
        a = m.tv[t, k]
        for j in range(3):
            if m.tv[u, (j + 1) % 3] == a and m.tv[u, j] == m.tv[t, (k + 1) % 3]:
                m.tn[u, j] = t
                return


@compiled
def touched_excess(m):
    """Squares of how much the live triangles in the journal exceed the tolerance; 0: none does."""
    m.count[EPOCH] += 1
    epoch = m.count[EPOCH]
    total = 0.0
    for i in range(m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.tv[t, 0] >= 0 and m.mark[t] != epoch:
            m.mark[t] = epoch
            e = worst_of(m, t)
            if e > 1.0:
                total += (e - 1.0) ** 2
    return total


@compiled
def remove_if_clean(F, m, tol, v):
    """Remove v if some filling of the hole has no violation; no repair."""
    if not room_left(m):
        return False
    begin(m)
    if remove_vertex(F, m, tol, v, 0.05) < 0.0 or touched_excess(m) > 0.0:
        rollback(m)
        return False
    commit(m)
    return True
