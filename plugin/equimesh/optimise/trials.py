"""A vertex taken out, or put in where an error is too large: kept if moves around it mend the rest.

Either leaves violations behind, of which most give way once slack some triangles away comes into
play. So the neighbourhood is relaxed until nothing in it is violated; where that fails everything
is as if nothing had been tried.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import worst_around, worst_of
from equimesh.optimise.insertion import split_edge
from equimesh.optimise.mesh import FREE, GONE, MANNER, SETTLE, SLIDES, SPREAD, Mesh
from equimesh.optimise.parts import in_parts
from equimesh.optimise.relax import Queue, clear, push, push_star, relax
from equimesh.optimise.removal import remove_vertex, touched_excess
from equimesh.optimise.topology import (
    begin,
    commit,
    note_triangle,
    rollback,
    room_left,
    stamp_touched,
    star,
)

__all__ = ["mending_round", "removal_round"]

# What repairs that succeed leave of the squared excess: at most the first times the second to the
# power of the share of their visits that is spent (three thousand trials on five functions).
_HOPE, _FALL = 3.0, 1e-6
_TRIED = 0.1  # of a repair's visits, at least, are made
_MENDING = 300  # visits around a violation
_PLACES = 9  # for a vertex that mends it: the edges of the triangle and of its three neighbours


@inlined
def _repaired(F, m, tol, q, budget):
    """Relax what is in the queue until no triangle in the journal is violated.

    Here violations are to spread: only then does slack some triangles away come into play. Gives up
    when visits no longer lower the squared excess by a tenth, when it is larger than it ever was
    at that share of the budget before a success, or when the budget is spent.
    """
    excess = touched_excess(m)
    spent = 0
    while excess > 0.0:
        if spent >= budget or q.state[1] == 0:
            return False
        spent += relax(F, m, tol, q, min(max(budget // 5, 12), 24), 40)
        now = touched_excess(m)
        if now > 0.9 * excess and spent > 24:
            return False
        if now > _HOPE * _FALL ** (spent / budget):
            return False
        excess = now
    return True


@inlined
def _settled(F, m, tol, q, budget):
    """Keep what is in the journal if it can be repaired, else take it back; returns which."""
    m.count[MANNER] = SPREAD
    repaired = _repaired(F, m, tol, q, budget)
    m.count[MANNER] = SETTLE
    if not repaired:
        rollback(m)
    return repaired


@compiled
def _removal_round(F, m, tol, q, candidates, budget, goal, stamp, number):
    removed = 0
    for i in range(candidates.shape[0]):
        v = candidates[i]
        if (m.kind[v] != FREE and m.kind[v] != SLIDES) or not room_left(m):
            continue
        n, closed = star(m, v)
        count = n if closed else n + 1
        for j in range(count):
            m.ring[3, j] = m.ring[0, j]
        begin(m)
        if remove_vertex(F, m, tol, v, goal) < 0.0:
            rollback(m)
            continue
        clear(q)
        for j in range(count):
            push(q, m.ring[3, j])
        if _settled(F, m, tol, q, budget):
            stamp_touched(m, stamp, number)
            commit(m)
            removed += 1
    return removed


def removal_round(
    F: KernelField,
    m: Mesh,
    tol: float,
    q: Queue,
    candidates: NDArray[np.int64],
    budget: int,
    goal: float,
    stamp: NDArray[np.int64],
    number: int,
) -> int:
    """Try to remove each candidate with repair; returns how many went.

    Vertices around where one went get the ``stamp`` (v,) ``number``.
    """

    def work(m: Mesh, q: Queue, rows: NDArray[np.int64]) -> int:
        return int(_removal_round(F, m, tol, q, candidates[rows], budget, goal, stamp, number))

    return in_parts(m, q, candidates, work, _TRIED * budget)


@compiled
def _place(m, t, number):
    """Triangle and edge of a place for a vertex that mends t; no triangle: there is none.

    First the edges of t, then the others of its neighbours.
    """
    if number < 3:
        return t, number
    u = m.tn[t, (number - 3) >> 1]
    if u >= 0:
        for j in range(3):
            if m.tn[u, j] == t:
                return u, (j + 1 + ((number - 3) & 1)) % 3
    return -1, 0


@compiled
def _mending_round(F, m, tol, q, vertices):
    mended = 0
    for i in range(vertices.shape[0]):
        if m.kind[vertices[i]] == GONE:
            continue
        t = worst_around(m, vertices[i])
        if worst_of(m, t) <= 1.0:
            continue
        for number in range(-1, _PLACES):  # first without a vertex
            s, k = t, 0
            if number >= 0:
                s, k = _place(m, t, number)
            if s < 0 or not room_left(m):
                continue
            begin(m)
            clear(q)
            note_triangle(m, t)
            for j in range(3):
                push(q, m.tv[t, j])
                if m.tn[t, j] >= 0:
                    note_triangle(m, m.tn[t, j])
            if number >= 0:
                v = split_edge(F, m, tol, s, k, 0.5)
                if v < 0:
                    rollback(m)
                    continue
                push(q, v)
                push_star(m, q, v)
            if _settled(F, m, tol, q, _MENDING):
                commit(m)
                mended += 1
                break
    return mended


def mending_round(F: KernelField, m: Mesh, tol: float, q: Queue, listed: NDArray[np.int64]) -> int:
    """Try to mend each of the ``listed`` triangles by moves, or by one vertex and moves.

    So it takes no more vertices than there are violations, however near to the tolerance the errors
    around them are. Returns how many were mended.
    """
    vertices = np.unique(m.tv[listed, 0])

    def work(m: Mesh, q: Queue, rows: NDArray[np.int64]) -> int:
        return int(_mending_round(F, m, tol, q, vertices[rows]))

    return in_parts(m, q, vertices, work, _TRIED * _MENDING)
