"""Single vertices that come or go where that lowers the energy of a mesh.

Each is taken out, or put in, and its neighbourhood relaxed; the change is kept if it pays for the
triangles that it takes. At a temperature above 0 some that do not pay are kept as well (Metropolis
et al. 1953): so dislocations climb over what stands between them and where they cost less.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import penalty, worst_around
from equimesh.optimise.mesh import (
    EPOCH,
    FIRM,
    FREE,
    HARD,
    LOG_T,
    MANNER,
    SLIDES,
    SOFT,
    Mesh,
    movable,
)
from equimesh.optimise.parts import in_parts
from equimesh.optimise.relax import Queue, clear, push, push_star, relax
from equimesh.optimise.removal import remove_vertex
from equimesh.optimise.sweep import split_at_worst, vertex_waste
from equimesh.optimise.topology import begin, commit, rollback, room_left, stamp_touched

__all__ = ["exchange_once"]

# For each power p: (p - 1) times the energy of a lattice triangle of error 1, in the mean of the
# convex and the saddle lattice. Then an error of 1 has the least energy in a given area.
_PRICE = {SOFT: 7.0, FIRM: 28.0, HARD: 58.0}
_OFF = 1.0  # triangles too few or too many around a vertex that make an exchange worth a trial
# Energy above what would pay, in prices of a triangle, that removals and insertions which are kept
# still have after a fifth of the visits, and by what it falls in the next fifths (a thousand trials
# on four functions).
_HOPE_OUT, _HOPE_IN, _FALL = 9.0, 1.0, 1 / 3
_TRIED = 0.2  # of an exchange's visits, at least, are made
_AGAINST = 0.3  # of the exchanges in the heat that go against what looks wasteful


@compiled
def _energy(m, e0, e1, e2, inner):
    return 0.5 * (penalty(m, e0) + penalty(m, e1) + penalty(m, e2)) + penalty(m, inner)


@compiled
def _energy_change(m):
    """Energy of the journal's triangles now, less what it was."""
    m.count[EPOCH] += 1
    epoch = m.count[EPOCH]
    total = 0.0
    for i in range(m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.mark[t] != epoch:
            m.mark[t] = epoch
            if m.log_ti[i, 1] >= 0:
                old = m.log_tf[i]
                total -= _energy(m, old[0], old[1], old[2], old[6])
            if m.tv[t, 0] >= 0:
                total += _energy(m, m.ee[t, 0], m.ee[t, 1], m.ee[t, 2], m.ie[t])
    return total


@inlined
def _pays(F, m, tol, q, visits, price, triangles, loan):
    """Whether the neighbourhood, relaxed, has less energy than that of what the change saves, and a
    ``loan``.

    What is far from it after some of the visits never gets there: then the rest are not made.
    """
    done, hope = 0, (_HOPE_OUT if triangles < 0 else _HOPE_IN) * price
    while done < visits:
        made = relax(F, m, tol, q, visits // 5, 12)
        if made == 0:
            break
        done += made
        if _energy_change(m) + price * triangles > hope + loan:
            return False
        hope *= _FALL
    return _energy_change(m) + price * triangles < loan


@compiled
def _chance(v, number, draw):
    """A number between 0 and 1 that looks random and depends on these alone (Knuth's multiplicative
    hashing, The Art of Computer Programming 3, 6.4)."""
    x = (v * 2654435761 + number * 40503 + draw * 1013904223) & 0xFFFFFFFF
    for _ in range(3):
        x ^= x >> 15
        x = (x * 2246822519) & 0xFFFFFFFF
    x ^= x >> 13
    return (x + 0.5) / 4294967296.0


@compiled
def _exchange(F, m, tol, q, candidates, waste, visits, stamp, number, price, heat):
    """Remove each candidate whose waste is positive, or insert beside it; keep what pays.

    A triangle costs ``price``. Vertices around what was kept get the stamp ``number``. ``heat``:
    see ``exchange_once``. Returns how many changes were kept.
    """
    kept = 0
    for i in range(candidates.shape[0]):
        v = candidates[i]
        if (m.kind[v] != FREE and m.kind[v] != SLIDES) or not room_left(m):
            continue
        begin(m)
        clear(q)
        wasteful, loan = waste[i] > 0.0, 0.0
        if heat > 0.0:
            loan = -heat * price * math.log(_chance(v, number, 0))
            wasteful = wasteful != (_chance(v, number, 1) < _AGAINST)
        if wasteful:
            triangles = -2 if push_star(m, q, v) else -1
            if remove_vertex(F, m, tol, v, 1e30) < 0.0:
                rollback(m)
                continue
        else:
            v = split_at_worst(F, m, tol, worst_around(m, v))
            if v < 0:
                rollback(m)
                continue
            push(q, v)
            triangles = 2 if push_star(m, q, v) else 1
        if _pays(F, m, tol, q, visits, price, triangles, loan):
            stamp_touched(m, stamp, number)
            commit(m)
            kept += 1
        else:
            rollback(m)
    return kept


def exchange_once(
    field: KernelField,
    mesh: Mesh,
    aim: float,
    queue: Queue,
    visits: int,
    stamp: NDArray[np.int64],
    number: int,
    off: float = _OFF,
    heat: float = 0.0,
) -> int:
    """One pass in the mesh's manner over the vertices whose ``stamp`` (v,) is the last pass's.

    ``off``: triangles too few or too many around a vertex that make an exchange worth a trial.
    ``heat``: a temperature, in prices of a triangle. What costs energy is kept by Metropolis's
    rule, and some exchanges go against what looks wasteful. Vertices around what was kept get the
    stamp ``number``. Returns how many changes were kept.
    """
    candidates = movable(mesh)
    candidates = candidates[stamp[candidates] == number - 1]
    waste = vertex_waste(field, mesh, aim, candidates)
    chosen = np.flatnonzero(np.abs(waste) > off)
    order = chosen[np.argsort(-np.abs(waste[chosen]), kind="stable")]
    price = _PRICE[int(mesh.count[MANNER])]
    candidates, waste = candidates[order], waste[order]

    def work(mesh: Mesh, queue: Queue, rows: NDArray[np.int64]) -> int:
        return int(
            _exchange(
                field, mesh, aim, queue, candidates[rows], waste[rows], visits, stamp, number,
                price, heat,
            )
        )  # fmt: skip

    return in_parts(mesh, queue, candidates, work, _TRIED * visits)
