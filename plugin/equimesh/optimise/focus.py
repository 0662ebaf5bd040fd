"""Removal with repair by a focused random search, for data.

Where slopes mean little, a descent soon finds no way to repair what a removal has violated, though
there is one. A random search does that changes nothing but violated triangles: one of them at
random, a corner of it to a random place or one of its edges flipped, accepted as Metropolis did, at
a low temperature. Searches for satisfying assignments focus alike (Seitz, Alava and Orponen,
"Focused local search for random 3-satisfiability", 2005). Where it fails, a vertex goes in at the
worst place, and if the search then repairs the rest, the mesh has as many triangles as before but
others: from those the next removal starts. Everything else is undone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.dispatch import edge_error, inner_error
from equimesh.fields.reference import by_reference
from equimesh.optimise.energy import ROOM, lift, worst_of
from equimesh.optimise.mesh import FIXED, FREE, HEIGHTS, LOG_T, SLIDES, Mesh
from equimesh.optimise.moves import store_star
from equimesh.optimise.removal import remove_vertex
from equimesh.optimise.sweep import split_at_worst
from equimesh.optimise.topology import (
    ample,
    begin,
    commit,
    flip,
    flippable,
    note_vertex,
    rollback,
    room_left,
    star,
)

__all__ = ["Search", "exchange_round", "make_search"]

# In units of the tolerance. A violation costs a step and how far it exceeds the tolerance, up to a
# most: one bad triangle is better than two slight ones, and a hopeless one no worse than a bad one.
_STEP = 0.3
_MOST = 3.0
_TEMPERATURE = 0.07
_GOAL = 100.0  # of a removal: what costs more is not worth a search
_TRIES = 300  # changes tried after a removal, and again after an insertion
# A removal that leaves more than this is repaired without an insertion so rarely that only a few
# changes are worth a try.
_HARD = 2.0
_FEW = 50
_HOPELESS = 10  # violated triangles that no insertion is tried for
# Shares of what is tried: changes beside a violated triangle, flips, moves to the largest error,
# moves up or down.
_BESIDE = 0.3
_FLIPS = 0.35
_ONTO = 0.1
_UPRIGHT = 0.3
_FINEST = 5.0  # moves are between 1 and exp(-_FINEST) edges long, evenly in the logarithm


@by_reference
class Search(NamedTuple):
    """Scratch of a search on a mesh with t slots for triangles."""

    random: NDArray[np.uint64]  # (1,) state of the generator
    bad: NDArray[np.int64]  # (t,) the violated triangles
    place: NDArray[np.int64]  # (t,) where a triangle is in ``bad``, -1: nowhere


def make_search(mesh: Mesh) -> Search:
    """A search that has yet to start."""
    slots = len(mesh.tv)
    return Search(
        np.array([0x9E3779B97F4A7C15], np.uint64),
        np.zeros(slots, np.int64),
        np.full(slots, -1, np.int64),
    )


@compiled
def _uniform(random):
    """The next number in [0, 1): xorshift64* (Vigna, 2016)."""
    x = random[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    random[0] = x
    x = x * np.uint64(2685821657736338717)
    return float(x >> np.uint64(11)) / 9007199254740992.0


@compiled
def _cost(e):
    over = abs(e) - 1.0
    return _STEP + min(over, _MOST) if over > 0.0 else 0.0


@compiled
def _edge_of(F, m, tol, a, b):
    """As ``energy.edge_of``, on true errors, no farther than costs tell apart."""
    e, s = edge_error(F, m.x[a], m.y[a], m.z[a], m.x[b], m.y[b], m.z[b], (1.0 + _MOST) * tol)
    return e / tol, s


@compiled
def _inner_of(F, m, tol, a, b, c):
    e, x, y = inner_error(
        F, m.x[a], m.y[a], m.z[a], m.x[b], m.y[b], m.z[b], m.x[c], m.y[c], m.z[c],
        (1.0 + _MOST) * tol,
    )  # fmt: skip
    return e / tol, x, y


@compiled
def _list(m, s, n, t):
    """Put triangle t on the list of n violated ones or take it off; returns the list's length."""
    at = s.place[t]
    if worst_of(m, t) > 1.0:
        if at < 0:
            s.place[t], s.bad[n] = n, t
            n += 1
    elif at >= 0:
        n -= 1
        s.bad[at] = s.bad[n]
        s.place[s.bad[n]] = at
        s.place[t] = -1
    return n


@compiled
def _list_journal(m, s, n, first):
    """The same for the live triangles in the journal from its entry ``first`` on."""
    for i in range(first, m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.tv[t, 0] >= 0:
            n = _list(m, s, n, t)
    return n


@compiled
def _flip(F, m, tol, t, k, rise):
    """Flip edge k of t where that costs at most ``rise``; returns the other triangle or -1."""
    u, a, b, c, d = flippable(m, t, k)
    if u < 0:
        return -1
    left = rise + _cost(m.ee[t, k]) + _cost(m.ie[t]) + _cost(m.ie[u])
    e, p = _edge_of(F, m, tol, d, c)
    left -= _cost(e)
    if left < 0.0:
        return -1
    e1, x1, y1 = _inner_of(F, m, tol, c, a, d)
    left -= _cost(e1)
    if left < 0.0:
        return -1
    e2, x2, y2 = _inner_of(F, m, tol, d, b, c)
    if left < _cost(e2):
        return -1
    u = flip(m, t, k)
    m.ee[t, 2], m.ep[t, 2] = e, p
    m.ee[u, 2], m.ep[u, 2] = e, 1.0 - p
    m.ie[t], m.ix[t], m.iy[t] = e1, x1, y1
    m.ie[u], m.ix[u], m.iy[u] = e2, x2, y2
    return u


@compiled
def _affordable(F, m, tol, v, n, closed, left):
    """Whether the star in ``m.ring`` costs at most ``left``; its errors go to ``m.work``."""
    spokes = n if closed else n + 1
    for i in range(n):
        p, q = m.ring[0, i], m.ring[0, (i + 1) % spokes]
        if not ample(m.x[v], m.y[v], m.x[p], m.y[p], m.x[q], m.y[q]):
            return False
    for i in range(spokes):
        e, p = _edge_of(F, m, tol, v, m.ring[0, i])
        m.work[0, i], m.work[1, i] = e, p
        left -= _cost(e)
        if left < 0.0:
            return False
    for i in range(n):
        e, x, y = _inner_of(F, m, tol, v, m.ring[0, i], m.ring[0, (i + 1) % spokes])
        m.work[2, i], m.work[3, i], m.work[4, i] = e, x, y
        left -= _cost(e)
        if left < 0.0:
            return False
    return True


@compiled
def _place_for(m, random, t, v, n):
    """A random place for v: the largest error inside t, or anywhere around where it is."""
    if _uniform(random) < _ONTO:
        return m.ix[t], m.iy[t]
    r = m.ring[0, int(_uniform(random) * n)]
    reach = math.hypot(m.x[r] - m.x[v], m.y[r] - m.y[v]) * math.exp(-_FINEST * _uniform(random))
    angle = 2.0 * math.pi * _uniform(random)
    return m.x[v] + reach * math.cos(angle), m.y[v] + reach * math.sin(angle)


@compiled
def _move(F, m, tol, random, t, v, rise):
    """Move the corner v of t to a random place where that costs at most ``rise``.

    Returns the number of triangles around it, which ``m.ring`` then holds, or 0: it stayed.
    """
    kind, high = m.kind[v], m.count[HEIGHTS] == 1
    if kind == FIXED and not high:
        return 0
    n, closed = star(m, v)
    if n == 0:
        return 0
    x, y, z, w = m.x[v], m.y[v], m.z[v], m.w[v]
    nx, ny = x, y
    upright = high and (kind == FIXED or _uniform(random) < _UPRIGHT)
    if not upright:
        nx, ny = _place_for(m, random, t, v, n)
    if kind == SLIDES:
        side = m.sides[m.side[v]]
        ux, uy = side[2] - side[0], side[3] - side[1]
        along = ((nx - side[0]) * ux + (ny - side[1]) * uy) / (ux * ux + uy * uy)
        if not 0.0 < along < 1.0:
            return 0
        nx, ny = side[0] + along * ux, side[1] + along * uy
    left = rise
    for i in range(n):
        u, k = m.ring[1, i], m.ring[2, i]
        left += _cost(m.ee[u, k]) + _cost(m.ie[u])
    if not closed:
        left += _cost(m.ee[m.ring[1, n - 1], (m.ring[2, n - 1] + 2) % 3])
    note_vertex(m, v)
    if high and (upright or _uniform(random) < 0.5):
        size = math.exp(-_FINEST * _uniform(random))
        higher = w + size * (2.0 * _uniform(random) - 1.0) * tol
        if abs(higher) <= ROOM * tol:
            m.w[v] = higher
    if lift(F, m, v, nx, ny) and _affordable(F, m, tol, v, n, closed, left):
        store_star(m, v, n, closed)
        return n
    m.x[v], m.y[v], m.z[v], m.w[v] = x, y, z, w
    return 0


@compiled
def _listed_cost(m, s, n):
    """What the n violated triangles on the list cost, edges between two of them once."""
    total = 0.0
    for i in range(n):
        t = s.bad[i]
        total += _cost(m.ie[t])
        for k in range(3):
            total += (0.5 if m.tn[t, k] >= 0 else 1.0) * _cost(m.ee[t, k])
    return total


@compiled
def _search(F, m, tol, s, n, tries):
    """Random changes of the n violated triangles on the list and of those beside them.

    Returns how many are left.
    """
    for _ in range(tries):
        if n == 0 or not room_left(m):
            break
        t = s.bad[int(_uniform(s.random) * n)]
        rise = -_TEMPERATURE * math.log(1.0 - _uniform(s.random))
        if _uniform(s.random) < _BESIDE:
            beside = m.tn[t, int(_uniform(s.random) * 3)]
            t = beside if beside >= 0 else t
        corner = int(_uniform(s.random) * 3)
        if _uniform(s.random) < _FLIPS:
            u = _flip(F, m, tol, t, corner, rise)
            if u >= 0:
                n = _list(m, s, n, t)
                n = _list(m, s, n, u)
        else:
            changed = _move(F, m, tol, s.random, t, m.tv[t, corner], rise)
            for i in range(changed):
                n = _list(m, s, n, m.ring[1, i])
    return n


@compiled
def _insert(F, m, tol, s, n):
    """A vertex where the largest error of the n violated triangles is; returns how many are left.

    -1 where none can be put in.
    """
    worst = s.bad[0]
    for i in range(1, n):
        if worst_of(m, s.bad[i]) > worst_of(m, worst):
            worst = s.bad[i]
    first = m.count[LOG_T]
    if split_at_worst(F, m, tol, worst) < 0:
        return -1
    return _list_journal(m, s, n, first)


@compiled
def exchange_round(F, m, tol, s, candidates):
    """Remove each candidate, or exchange it for another vertex, where a search can repair that.

    The mesh keeps the tolerance before and after. Returns (removed, exchanged).
    """
    removed = exchanged = 0
    for i in range(candidates.shape[0]):
        v = candidates[i]
        if m.kind[v] != FREE and m.kind[v] != SLIDES:
            continue
        begin(m)
        if not room_left(m) or remove_vertex(F, m, tol, v, _GOAL) < 0.0:
            rollback(m)
            continue
        n = _list_journal(m, s, 0, 0)
        n = _search(F, m, tol, s, n, _TRIES if _listed_cost(m, s, n) <= _HARD else _FEW)
        fewer = n == 0
        if 0 < n <= _HOPELESS and room_left(m):
            more = _insert(F, m, tol, s, n)
            if more >= 0:
                n = _search(F, m, tol, s, more, _TRIES)
        if n == 0:
            commit(m)
            removed += fewer
            exchanged += not fewer
        else:
            for j in range(n):
                s.place[s.bad[j]] = -1
            rollback(m)
    return removed, exchanged
