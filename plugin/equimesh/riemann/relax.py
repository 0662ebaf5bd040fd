"""Relaxation by a queue, and tentative changes that stay only where they lower the energy."""

from __future__ import annotations

from equimesh.fields.compiled import compiled
from equimesh.optimise.mesh import (
    EPOCH,
    FREE,
    FREE_TRIANGLES,
    GONE,
    LOG_T,
    LOG_V,
    RECORDING,
    TRIANGLES,
    VERTICES,
)
from equimesh.optimise.relax import clear, push, take
from equimesh.optimise.topology import begin, commit, rollback, room_left, star
from equimesh.riemann.changes import collapse, split
from equimesh.riemann.energy import edge_length, move, set_energy, try_flip

__all__ = ["improve", "relax", "relax_all", "set_energies", "triangles_of"]

_WORTH = 1e-3  # smallest gain of a tentative change
_GLANCE, _WINDOW, _VISITS = 14, 50, 6
_HOPELESS = 0.6  # energy that more relaxation hardly finds
_TRIES = 8  # visits of a vertex
# Energy per vertex and relative excess of triangles; what lies within _CLOSE is free.
_PRICE, _DEAREST, _CLOSE = 30.0, 1.2, 0.01
_IDLE = 1e-4  # smaller gains do not wake the neighbours


@compiled
def set_energies(P, m):
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] >= 0:
            set_energy(P, m, t)


@compiled
def _flip_around(P, m, v):
    any_flip = False
    for _ in range(30):
        n, _ = star(m, v)
        done = True
        for i in range(n):
            t, k = m.ring[1, i], m.ring[2, i]
            if try_flip(P, m, t, k) or try_flip(P, m, t, (k + 1) % 3):
                done = False
                break
        if done:
            return any_flip
        any_flip = True
    return any_flip


@compiled
def relax(P, m, q, budget, per_vertex, idle):
    """Work the queue off: flips and moves; a gain above ``idle`` wakes the neighbours."""
    done = 0
    while done < budget:
        v = take(m, q, per_vertex)
        if v < 0 or (m.count[RECORDING] == 1 and not room_left(m)):
            break
        done += 1
        flipped = _flip_around(P, m, v)
        gain = move(P, m, v)
        if flipped or gain > idle:
            n, closed = star(m, v)
            for i in range(n if closed else n + 1):
                push(q, m.ring[0, i])
            push(q, v)
    return done


@compiled
def relax_all(P, m, q, per_vertex, idle):
    """Relax the whole mesh; returns the visits."""
    clear(q)
    for v in range(m.count[VERTICES]):
        if m.kind[v] != GONE and m.v2t[v] >= 0:
            push(q, v)
    return relax(P, m, q, 1 << 60, per_vertex, idle)


@compiled
def _change(m):
    """Energy of the triangles in the journal now, less what it was."""
    m.count[EPOCH] += 1
    epoch = m.count[EPOCH]
    total = 0.0
    for i in range(m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.mark[t] != epoch:
            m.mark[t] = epoch
            if m.log_ti[i, 1] >= 0:
                total -= m.log_tf[i, 6]
            if m.tv[t, 0] >= 0:
                total += m.ie[t]
    return total


@compiled
def _settle(P, m, q, todo, v, price):
    """Relax around v after a change in the journal; keep it if it lowered the energy.

    ``price`` is the energy that the change may cost. A look after a few visits tells what is
    hopeless.
    """
    clear(q)
    n, closed = star(m, v)
    push(q, v)
    for i in range(n if closed else n + 1):
        push(q, m.ring[0, i])
    relax(P, m, q, _GLANCE, _VISITS, _WORTH)
    change = _change(m)
    if change < price + _HOPELESS:
        relax(P, m, q, _WINDOW, _VISITS, _WORTH)
        change = _change(m)
    clear(q)
    if change < price - _WORTH:
        for i in range(m.count[LOG_V]):
            push(todo, m.log_vi[i, 0])
        commit(m)
        return True
    rollback(m)
    return False


@compiled
def _attempts(P, m, q, todo, v, low, high, price):
    """Tentative changes at v: collapses and splits of its short and long spokes.

    ``price``: energy that a vertex less is worth. Returns whether one was kept.
    """
    n, closed = star(m, v)
    spokes = n if closed else n + 1
    for i in range(spokes):
        w = m.ring[0, i]
        length = edge_length(P, m, v, w)
        if not room_left(m):
            return False
        if length < low:
            begin(m)
            gone, kept = (v, w) if m.kind[v] == FREE else (w, v)
            if not collapse(P, m, gone, kept):
                rollback(m)
            elif _settle(P, m, q, todo, kept, price):
                return True
            star(m, v)
        if i < n and length > high:
            begin(m)
            new = split(P, m, m.ring[1, i], m.ring[2, i])
            if new < 0:
                rollback(m)
            elif _settle(P, m, q, todo, new, -price):
                return True
            star(m, v)
    return False


@compiled
def triangles_of(m):
    """How many there are."""
    return m.count[TRIANGLES] - m.count[FREE_TRIANGLES]


@compiled
def improve(P, m, q, todo, low, high, goal):
    """Tentative changes wherever a neighbourhood has changed since they were last tried.

    Collapses edges shorter than ``low`` and splits those longer than ``high``. The sum of energies
    has a weak minimum in the number of triangles; a price on each that is more (or less) than
    ``goal`` keeps the count. Returns how many changes were kept.
    """
    clear(todo)
    for v in range(m.count[VERTICES]):
        if m.kind[v] != GONE:
            push(todo, v)
    kept = 0
    while True:
        v = take(m, todo, _TRIES)
        if v < 0:
            return kept
        excess = triangles_of(m) / goal - 1.0
        price = 0.0
        if abs(excess) > _CLOSE:
            price = min(max(_PRICE * excess, -_DEAREST), _DEAREST)
        shorter = max(low, 1.0) if price > 0.0 else low
        longer = min(high, 1.0) if price < 0.0 else high
        if _attempts(P, m, q, todo, v, shorter, longer, price):
            kept += 1
            push(todo, v)
