"""Relaxation of a neighbourhood: a queue of vertices whose surroundings can still improve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, outlined
from equimesh.fields.reference import by_reference
from equimesh.fields.workers import apart
from equimesh.optimise.energy import penalty
from equimesh.optimise.flips import IDLE, try_flip
from equimesh.optimise.mesh import GONE
from equimesh.optimise.moves import move_vertex
from equimesh.optimise.topology import room_left, star

__all__ = [
    "Queue", "make_queue", "push", "push_listed", "push_star", "push_violated", "relax", "take",
    "waiting_in",
]  # fmt: skip


@by_reference
class Queue(NamedTuple):
    """First in, first out; ``waiting`` marks members, ``visits`` counts within an epoch."""

    items: NDArray[np.int32]
    waiting: NDArray[np.uint8]
    visits: NDArray[np.int32]
    stamp: NDArray[np.int32]
    state: NDArray[np.int64]  # head, length, epoch


def make_queue(vertices: int) -> Queue:
    """A queue for vertices 0 ... ``vertices`` - 1."""
    return Queue(
        np.empty(vertices, np.int32),
        np.zeros(vertices, np.uint8),
        np.empty(vertices, np.int32),
        np.zeros(vertices, np.int32),
        apart(np.zeros(3, np.int64)),
    )


@compiled
def push(q, v):
    if q.waiting[v] == 0:
        size = q.items.shape[0]
        q.items[(q.state[0] + q.state[1]) % size] = v
        q.state[1] += 1
        q.waiting[v] = 1


def waiting_in(q: Queue) -> NDArray[np.int64]:
    """(n,) the vertices in the queue, the first first."""
    head, length, _ = q.state
    return np.roll(q.items, -head)[:length].astype(np.int64)


@compiled
def clear(q):
    """Empty the queue and start a new count of visits."""
    size = q.items.shape[0]
    while q.state[1] > 0:
        q.waiting[q.items[q.state[0]]] = 0
        q.state[0] = (q.state[0] + 1) % size
        q.state[1] -= 1
    q.state[2] += 1


@compiled
def take(m, q, per_vertex):
    """The next vertex that is there and had fewer than ``per_vertex`` visits, this one counted.

    -1 where the queue has none.
    """
    size = q.items.shape[0]
    while q.state[1] > 0:
        v = q.items[q.state[0]]
        q.state[0] = (q.state[0] + 1) % size
        q.state[1] -= 1
        q.waiting[v] = 0
        if m.kind[v] == GONE:
            continue
        if q.stamp[v] != q.state[2]:
            q.stamp[v] = q.state[2]
            q.visits[v] = 0
        if q.visits[v] < per_vertex:
            q.visits[v] += 1
            return v
    return -1


@compiled
def push_listed(q, vertices):
    """The vertices (n,) in their order."""
    for i in range(vertices.shape[0]):
        push(q, vertices[i])


@compiled
def push_star(m, q, v):
    """The neighbours of v in their order; returns whether v is an inner vertex."""
    n, closed = star(m, v)
    for j in range(n if closed else n + 1):
        push(q, m.ring[0, j])
    return closed


@compiled
def push_violated(m, q):
    """All vertices of violated edges and insides, in the order of their numbers."""
    for t in range(m.count[0]):
        if m.tv[t, 0] < 0:
            continue
        if abs(m.ie[t]) > 1.0:
            for k in range(3):
                push(q, m.tv[t, k])
        for k in range(3):
            if abs(m.ee[t, k]) > 1.0:
                push(q, m.tv[t, k])
                push(q, m.tv[t, (k + 1) % 3])
                push(q, m.tv[t, (k + 2) % 3])


@compiled
def _flip_around(F, m, tol, v):
    """Flips of the edges of v's star; returns whether any was made."""
    any_flip = False
    for _ in range(20):
        n, _ = star(m, v)
        done = True
        for i in range(2 * n):  # the spoke and the rim of each triangle
            t, k = m.ring[1, i >> 1], (m.ring[2, i >> 1] + (i & 1)) % 3
            if penalty(m, m.ee[t, k]) + penalty(m, m.ie[t]) > IDLE and try_flip(F, m, tol, t, k):
                done = False
                break
        if done:
            return any_flip
        any_flip = True
    return any_flip


@outlined
def relax(F, m, tol, q, budget, per_vertex):
    """Work the queue off; at most ``budget`` visits and ``per_vertex`` for each. Returns visits."""
    done = 0
    while done < budget:
        v = take(m, q, per_vertex)
        if v < 0 or not room_left(m):
            break
        done += 1
        flipped = _flip_around(F, m, tol, v)
        gain = move_vertex(F, m, tol, v)
        if flipped or gain > 0.0:
            n, closed = star(m, v)
            count = n if closed else n + 1
            for i in range(count):
                push(q, m.ring[0, i])
            push(q, v)
    return done
