"""The order of the moves: flip, relax, insert where it must be, remove where it can be."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating, compiled, outlined
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.fields.patch_kernels import derivatives2
from equimesh.optimise.angles import by_angle
from equimesh.optimise.centres import split_for_angle
from equimesh.optimise.energy import ROOM, set_jet, worst_of
from equimesh.optimise.insertion import split_edge, split_inside
from equimesh.optimise.mesh import (
    FREE,
    GONE,
    SEAM,
    SLIDES,
    VERTICES,
    Mesh,
)
from equimesh.optimise.parts import in_parts
from equimesh.optimise.relax import (
    Queue,
    clear,
    push,
    push_listed,
    push_violated,
    relax,
    waiting_in,
)
from equimesh.optimise.removal import remove_if_clean
from equimesh.optimise.topology import star

__all__ = [
    "insert_round",
    "lift_all",
    "relax_all",
    "relax_everything",
    "split_at_worst",
    "split_borders",
    "split_listed",
    "step_aside",
    "thin_out",
    "vertex_waste",
    "violations",
]

_OFTEN = 4  # moves of a vertex before nothing gives way any more, about
_WANDERING, _AROUND = 4_000, 100  # visits at least, and for each violated vertex, where they relax

_AREA_CONVEX = 3.0 * math.sqrt(3.0) / 16.0  # of the optimal triangles in units of 8 tol
_AREA_SADDLE = math.sqrt(5.0) / 4.0


@compiled
def lift_all(F, m):
    """First and second derivatives at all vertices."""
    for v in range(m.count[1]):
        set_jet(F, m, v, m.x[v], m.y[v])


@compiled
def step_aside(F, m, tol):
    """Move vertices off the surface to where it halves their chords' errors: where all lie on one
    side of it."""
    for v in range(m.count[1]):
        _, _, _, hxx, hxy, hyy = derivatives2(F.frame, F.child, F.coef, m.x[v], m.y[v])
        if hxx * hyy > hxy * hxy and math.isfinite(m.z[v]):
            m.w[v] = -ROOM * tol if hxx > 0.0 else ROOM * tol
            m.z[v] += m.w[v]


@compiled
def violations(m, limit):
    """How many triangles have an error above ``limit``, and the largest error."""
    count, worst = 0, 0.0
    for t in range(m.count[0]):
        if m.tv[t, 0] >= 0:
            e = worst_of(m, t)
            worst = max(worst, e)
            if e > limit:
                count += 1
    return count, worst


@compiled
def split_borders(F, m, tol):
    """Split border edges and walls until none is violated by much: little else lowers it."""
    made = 0
    t = 0
    while t < m.count[0] and m.count[0] + 16 < m.tv.shape[0]:
        again = False
        for k in range(3):
            stays = m.tn[t, k] < 0 or m.wall[t, k] == 1
            if m.tv[t, 0] >= 0 and stays and abs(m.ee[t, k]) > 1.5:
                s = min(max(m.ep[t, k], 0.1), 0.9)
                if split_edge(F, m, tol, t, k, s) >= 0:
                    made += 1
                    again = True
                    break
        if not again:
            t += 1
    return made


# Each kernel's code has that of all kernels that it calls: what ends in one call is left to Python.
def relax_all(F: KernelField, m: Mesh, tol: float, q: Queue, per_vertex: int) -> None:
    """Relax around every violation; what has wandered far from them is left as it is."""
    clear(q)
    push_violated(m, q)
    _relax_around(F, m, tol, q, waiting_in(q), per_vertex, _WANDERING)


def relax_everything(F: KernelField, m: Mesh, tol: float, q: Queue, per_vertex: int) -> None:
    """Relax around every vertex."""
    vertices = np.flatnonzero(m.kind[: int(m.count[VERTICES])] != GONE)
    _relax_around(F, m, tol, q, vertices, per_vertex, 1 << 60)


def _relax_around(
    F: KernelField,
    m: Mesh,
    tol: float,
    q: Queue,
    vertices: NDArray[np.int64],
    per_vertex: int,
    least: int,
) -> None:
    """Relax around the ``vertices`` (n,), in ``least`` visits or as many as they may need."""

    def work(m: Mesh, q: Queue, rows: NDArray[np.int64]) -> int:
        clear(q)
        push_listed(q, vertices[rows])
        return int(relax(F, m, tol, q, max(least, _AROUND * len(rows)), per_vertex))

    in_parts(m, q, vertices, work, _OFTEN)


@outlined
def split_at_worst(F, m, tol, t):
    """Split the place of t's largest error; returns the new vertex or -1."""
    k, e = -1, abs(m.ie[t])
    for i in range(3):
        if abs(m.ee[t, i]) > e and m.wall[t, i] < SEAM:
            k, e = i, abs(m.ee[t, i])
    for i in range(3):
        stays = (m.tn[t, i] < 0 and m.wall[t, i] < SEAM) or m.wall[t, i] == 1
        if stays and abs(m.ee[t, i]) > 1.0:
            k = i
    if k < 0 and by_angle(F, m, t):
        v = split_for_angle(F, m, tol, t)
        if v >= 0:
            return v
        k = 0
    if k < 0:
        v = split_inside(F, m, tol, t, m.ix[t], m.iy[t])
        if v >= 0:
            return v
        k = 0
        for i in range(1, 3):
            if abs(m.ee[t, i]) > abs(m.ee[t, k]):
                k = i
    return split_edge(F, m, tol, t, k, min(max(m.ep[t, k], 0.3), 0.7))


@compiled
def insert_round(F, m, tol, q, stamp, number, order, budget):
    """Insert at the worst of each cluster of violations, then relax its surroundings.

    ``order``: triangles by falling error; ``stamp`` (v,) marks vertices near an insertion of this
    round by ``number``. Returns the number of insertions.
    """
    made = 0
    for i in range(order.shape[0]):
        t = order[i]
        if m.tv[t, 0] < 0 or worst_of(m, t) <= 1.0:
            continue
        if m.count[0] + 64 >= m.tv.shape[0] or m.count[1] + 64 >= m.x.shape[0]:
            break
        if (
            stamp[m.tv[t, 0]] == number
            or stamp[m.tv[t, 1]] == number
            or stamp[m.tv[t, 2]] == number
        ):
            continue
        v = split_at_worst(F, m, tol, t)
        if v < 0:
            continue
        made += 1
        clear(q)
        push(q, v)
        n, closed = star(m, v)
        count = n if closed else n + 1
        for j in range(count):
            push(q, m.ring[0, j])
            stamp[m.ring[0, j]] = number
        stamp[v] = number
        relax(F, m, tol, q, budget, 8)
        n, closed = star(m, v)
        count = n if closed else n + 1
        for j in range(count):
            stamp[m.ring[0, j]] = number
    return made


@compiled
def split_listed(F, m, tol, q, slots):
    """Split each listed triangle at its worst place and relax around it."""
    for i in range(slots.shape[0]):
        if m.tv[slots[i], 0] < 0:
            continue
        v = split_at_worst(F, m, tol, slots[i])
        if v >= 0:
            clear(q)
            push(q, v)
            relax(F, m, tol, q, 20, 4)


@compiled
def triangle_waste(F, m, tol, t):
    """1 - area in the metric over the optimal area: 0 for a lattice triangle."""
    a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
    area = 0.5 * ((m.x[b] - m.x[a]) * (m.y[c] - m.y[a]) - (m.y[b] - m.y[a]) * (m.x[c] - m.x[a]))
    third = 1.0 / 3.0
    _, _, _, hxx, hxy, hyy = derivatives2(
        F.frame, F.child, F.coef,
        third * (m.x[a] + m.x[b] + m.x[c]), third * (m.y[a] + m.y[b] + m.y[c]),
    )  # fmt: skip
    area *= third * (m.share[a] + m.share[b] + m.share[c])
    det = (hxx * hyy - hxy * hxy) / (64.0 * tol * tol)
    if det > 0.0:
        return 1.0 - math.sqrt(det) * area / (_AREA_CONVEX * F.frame[3])
    return 1.0 - math.sqrt(-det) * area / _AREA_SADDLE


@allocating
def vertex_waste(F, m, tol, candidates):
    """For each candidate, how many triangles its star and half the next ring could do without.

    Where the field has no metric worth the name every vertex is worth a trial.
    """
    out = np.full(candidates.shape[0], math.inf)
    if F.kind != PATCHES:
        return out
    waste = np.zeros(m.count[0])
    star_waste = np.zeros(m.count[1])
    for t in range(m.count[0]):
        if m.tv[t, 0] >= 0:
            waste[t] = triangle_waste(F, m, tol, t)
            for k in range(3):
                star_waste[m.tv[t, k]] += waste[t]
    for i in range(candidates.shape[0]):
        v = candidates[i]
        n, closed = star(m, v)
        total = star_waste[v]
        for j in range(n if closed else n + 1):
            total += star_waste[m.ring[0, j]]
        out[i] = total / 3.0
    return out


@compiled
def thin_out(F, m, tol):
    """Remove every vertex whose hole can be filled without violation and without repair."""
    removed = 0
    for v in range(m.count[1]):
        if (m.kind[v] == FREE or m.kind[v] == SLIDES) and remove_if_clean(F, m, tol, v):
            removed += 1
    return removed
