"""A mesh in parts that threads change at once.

Vertices that move, come and go one after another are seldom near each other. So the mesh is halved,
along the straight line of a few that cuts the fewest triangles and leaves half of the vertices to
be changed on either side, and the halves again. On a seam vertices are held and edges stay: what
one thread changes no other one reads. What is near the seams has its turn when they are closed.
Where they run does not depend on the number of threads, so the answer is always the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.workers import apart, in_ranges
from equimesh.optimise.mesh import (
    EPOCH,
    FREE_TRIANGLES,
    FREE_VERTICES,
    GONE,
    HELD,
    PASSING,
    SEAM,
    TRIANGLES,
    VERTICES,
    Mesh,
    triangles_in,
)
from equimesh.optimise.relax import Queue, make_queue
from equimesh.optimise.topology import star

__all__ = ["Work", "in_parts"]

Work = Callable[[Mesh, Queue, NDArray[np.int64]], int]

_HALVED = (1_500, 12_000, 50_000)  # triangles from which on a mesh is halved, once more each time
_REACH = 3  # steps between a seam and what is changed meanwhile
_ROUNDS = 2  # of cuts
_ROWS = 8_000  # of a part's journal
_BLOCK = 64  # slots side by side that a part is given
_DIRECTIONS = 4  # of lines
_SAMPLE = 8_192  # triangles, about, that a line is chosen by
# What moves of vertices a cut pays for, at least: so many, and so many more for each triangle.
_MOVES, _MOVES_EACH = 400, 0.02


def in_parts(
    mesh: Mesh, queue: Queue, vertices: NDArray[np.int64], work: Work, moves: float
) -> int:
    """Call ``work(mesh, queue, rows)`` on all rows of ``vertices`` (n,), in their order.

    Where it pays for the cut, on those inside each part at once; so again on those near the seams,
    for these are near others; then on the rest. ``work`` changes the mesh around its vertices and
    returns a number, of which this is the sum; it should release the GIL. ``moves``: about how
    often it moves a vertex for each.
    """
    rows, total = np.arange(len(vertices)), 0
    for _ in range(_ROUNDS):
        size = triangles_in(mesh)
        halvings = sum(size >= least for least in _HALVED)
        if halvings == 0 or moves * len(rows) < _MOVES + _MOVES_EACH * size:
            break
        parts, inside = _cut(mesh, vertices[rows], halvings)
        total += _changed(
            parts, [rows[inside[vertices[rows]] == k] for k in range(len(parts))], work
        )
        _join(mesh, parts)
        _journals.extend({name: getattr(part, name) for name in PASSING} for part in parts)
        rows = rows[inside[vertices[rows]] < 0]
    return total + work(mesh, queue, rows)


def _changed(parts: list[Mesh], rows: list[NDArray[np.int64]], work: Work) -> int:
    """The sum of what ``work`` returns on each part's rows."""
    done = np.zeros(len(parts), np.int64)
    queues = [make_queue(len(part.x)) for part in parts]  # what another thread makes stays its own

    def change(first: int, last: int) -> None:
        for k in range(first, last):
            done[k] = work(parts[k], queues[k], rows[k])

    in_ranges(change, len(parts), 1)
    return int(done.sum())


# Journals and scratch of parts that are closed, for the next: made anew by one thread after another
# they would spread over all memory.
_journals: list[dict[str, NDArray[Any]]] = []


class _Slots(NamedTuple):
    """Slots of triangles or vertices that parts may fill."""

    used: int  # where the count of the mesh stands
    free: int  # where its number of spare slots stands
    spare: str  # their stack


_SLOTS = (
    _Slots(TRIANGLES, FREE_TRIANGLES, "spare_t"),
    _Slots(VERTICES, FREE_VERTICES, "spare_v"),
)


def _cut(
    mesh: Mesh, vertices: NDArray[np.int64], halvings: int
) -> tuple[list[Mesh], NDArray[np.int8]]:
    """The parts, and (v,) in which of them a vertex is, -1 near a seam."""
    number = 2**halvings
    part = _halved(mesh, vertices, halvings)
    v2t = np.tile(mesh.v2t, (number, 1))
    of, steps = np.full((len(part), 2), -1, np.int8), np.full(len(part), -1, np.int8)
    seam = np.empty(len(part), np.int32)
    held = _find_seams(mesh, part, of, seam)
    steps[seam[:held]] = 0
    _walk(mesh, seam, held, steps)
    _sever(mesh, part, steps, v2t)
    parts = [_part(mesh, k, number, v2t[k]) for k in range(number)]
    return parts, np.where(steps < 0, of[:, 0], -1)


def _halved(mesh: Mesh, vertices: NDArray[np.int64], halvings: int) -> NDArray[np.int8]:
    """(v,) the part that each vertex belongs to."""
    used, count = int(mesh.count[VERTICES]), int(mesh.count[TRIANGLES])
    near = mesh.tv[: count : max(1, count // _SAMPLE)]
    changed = np.zeros(used, np.bool_)
    changed[vertices] = True
    near = near[near[:, 0] >= 0]  # others may number vertices that are no more
    near = near[changed[near].any(1)]
    wide, high = (max(float(np.ptp(at[vertices])), 1e-300) for at in (mesh.x, mesh.y))
    part = np.zeros(used, np.int8)
    for _ in range(halvings):
        beyond = np.zeros(used, np.int8)
        for k in range(int(part.max()) + 1):
            listed, crossed = vertices[part[vertices] == k], near[(part[near] == k).all(1)]
            if len(listed) == 0:
                continue
            fewest = math.inf
            for number in range(_DIRECTIONS):
                angle = math.pi * number / _DIRECTIONS
                u, v = math.cos(angle) / wide, math.sin(angle) / high
                middle = np.median(u * mesh.x[listed] + v * mesh.y[listed])
                sides = (u * mesh.x[crossed] + v * mesh.y[crossed] > middle).sum(1)
                cuts = int(((sides > 0) & (sides < 3)).sum())
                if cuts < fewest:
                    fewest, best = cuts, (u, v, middle)
            mine = np.flatnonzero(part == k)
            u, v, middle = best
            beyond[mine] = u * mesh.x[mine] + v * mesh.y[mine] > middle
        part = 2 * part + beyond
    return part


def _part(mesh: Mesh, k: int, number: int, v2t: NDArray[np.int64]) -> Mesh:
    """Part ``k`` of so many: the same arrays, but for what threads must not share."""
    try:
        own = _journals.pop()
    except IndexError:
        own = {name: np.empty_like(getattr(mesh, name)[:_ROWS]) for name in PASSING}
    own = own | {"v2t": v2t, "count": apart(mesh.count)}
    for slots, size in zip(_SLOTS, (len(mesh.tv), len(mesh.x)), strict=True):
        stack = np.empty(size, np.int64)
        given = _given(mesh, slots, size, k, number)
        stack[: len(given)] = given
        own[slots.spare] = stack
        own["count"][slots.used], own["count"][slots.free] = size, len(given)
    return mesh._replace(**own)


def _given(mesh: Mesh, slots: _Slots, size: int, k: int, number: int) -> NDArray[np.int64]:
    """The slots that part ``k`` may fill, the last first: its share of the stack, then new ones.

    Threads that write into the same line of memory wait for each other: so slots go by blocks.
    """
    used, free = int(mesh.count[slots.used]), int(mesh.count[slots.free])
    new = np.arange(used, size)
    new = new[(new // _BLOCK) % number == k][::-1]
    spare = getattr(mesh, slots.spare)
    return np.concatenate([new, spare[free * k // number : free * (k + 1) // number]])


def _join(mesh: Mesh, parts: list[Mesh]) -> None:
    """Close the seams."""
    count = mesh.count
    for slots, there in zip(_SLOTS, (mesh.tv[:, 0] >= 0, mesh.kind != GONE), strict=True):
        used = len(there) - int(np.argmax(there[::-1]))
        spare = np.flatnonzero(~there[:used])[::-1]
        getattr(mesh, slots.spare)[: len(spare)] = spare
        count[slots.used], count[slots.free] = used, len(spare)
    count[EPOCH] = max(int(part.count[EPOCH]) for part in parts)
    mesh.kind[mesh.kind >= HELD] -= HELD
    sides = np.empty((_open(mesh, np.empty((0, 4), np.int64)), 4), np.int64)
    _open(mesh, sides)
    sides = sides[np.lexsort((sides[:, 1], sides[:, 0]))]  # the two of each edge one after another
    (t, k), (u, j) = sides[0::2, 2:].T, sides[1::2, 2:].T
    mesh.tn[t, k], mesh.tn[u, j] = u, t


@compiled
def _find_seams(m, part, of, seam):
    """List the vertices (n,) of triangles of more than one part in ``seam``; returns how many.

    A triangle belongs to the least part (v,) of its vertices. Up to two parts of each vertex's
    triangles replace the -1 in ``of`` (v, 2).
    """
    n = 0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        p = _part_of(m, part, t)
        for k in range(3):
            v = m.tv[t, k]
            if of[v, 0] < 0:
                of[v, 0] = p
            elif of[v, 0] != p and of[v, 1] < 0:
                of[v, 1] = p
                seam[n] = v
                n += 1
    return n


@compiled
def _part_of(m, part, t):
    return min(part[m.tv[t, 0]], part[m.tv[t, 1]], part[m.tv[t, 2]])


@compiled
def _walk(m, order, reached, steps):
    """The ``steps`` (v,) from the first ``reached`` vertices in ``order``, up to ``_REACH``."""
    i = 0
    while i < reached and steps[order[i]] < _REACH:
        v = order[i]
        n, closed = star(m, v)
        for j in range(n if closed else n + 1):
            w = m.ring[0, j]
            if steps[w] < 0:
                order[reached], steps[w] = w, steps[v] + 1
                reached += 1
        i += 1


@compiled
def _sever(m, part, steps, v2t):
    """Open the mesh between parts, and hold the vertices there, which are 0 ``steps`` from it.

    Writes one triangle of each of them into its part's row of ``v2t`` (p, v).
    """
    for t in range(m.count[TRIANGLES]):
        a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
        if a < 0 or (steps[a] != 0 and steps[b] != 0 and steps[c] != 0):
            continue
        p = _part_of(m, part, t)
        for k in range(3):
            v, u = m.tv[t, k], m.tn[t, k]
            if u >= 0 and _part_of(m, part, u) != p:
                m.tn[t, k] = -1
                m.wall[t, k] += SEAM
            if steps[v] == 0:
                v2t[p, v] = t
                if m.kind[v] < HELD:
                    m.kind[v] += HELD


@compiled
def _open(m, sides):
    """How many sides of triangles lie on seams, which they do from now on no longer.

    Writes the lower and the higher end, the triangle and the number of each into ``sides`` (n, 4)
    if there is room; else nothing changes. ``v2t`` is made anew.
    """
    n = 0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        for k in range(3):
            v, w = m.tv[t, k], m.tv[t, (k + 1) % 3]
            m.v2t[v] = t
            if m.wall[t, k] < SEAM:
                continue
            if n < sides.shape[0]:
                m.wall[t, k] -= SEAM
                sides[n, 0], sides[n, 1], sides[n, 2], sides[n, 3] = min(v, w), max(v, w), t, k
            n += 1
    return n
