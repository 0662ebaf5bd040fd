"""Half-edges of a triangle surface.

Half-edge 3 t + k runs from vertex k to vertex (k + 1) % 3 of triangle t. ``opposite[h]`` is the
half-edge of the neighbour along the same edge, -1 on the border.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.base import IntArray
from equimesh.fields.compiled import allocating

__all__ = ["Rings", "consistent_winding", "crowded_edges", "opposites", "trace_rings"]

Flags = NDArray[np.bool_]


def _edge_order(triangles: IntArray) -> tuple[IntArray, Flags]:
    """Half-edges sorted by their edge, and whether each is on the same edge as the one before."""
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    ends = ends.reshape(-1, 2)
    key = ends[:, 0] * (int(triangles.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    again = np.zeros(len(key), bool)
    again[1:] = key[order[1:]] == key[order[:-1]]
    return order, again


def crowded_edges(triangles: IntArray) -> tuple[IntArray, IntArray]:
    """(k, 2) vertices of the edges that more than two triangles share, and (j, 2) their half-edges.

    Every row of the second is the number of an edge in the first and one of its half-edges.
    """
    order, again = _edge_order(triangles)
    edge = np.cumsum(~again) - 1
    crowd = np.bincount(edge) > 2
    number = np.cumsum(crowd) - 1
    chosen = crowd[edge]
    member = np.stack([number[edge[chosen]], order[chosen]], axis=1)
    half = order[chosen & ~again]
    ends = np.stack([triangles[half // 3, half % 3], triangles[half // 3, (half + 1) % 3]], axis=1)
    return np.sort(ends, axis=1), member


def opposites(triangles: IntArray) -> IntArray:
    """(3 m,) the other half-edge of every edge, whatever their directions; -1 on the border."""
    order, again = _edge_order(triangles)
    second = np.flatnonzero(again)
    out = np.full(triangles.size, -1)
    out[order[second]] = order[second - 1]
    out[order[second - 1]] = order[second]
    return out


@allocating
def consistent_winding(triangles: IntArray, opposite: IntArray) -> tuple[IntArray, Flags, int]:
    """Wind neighbours alike: (m,) edge-connected component, (m,) whether to turn, and a triangle.

    In every component the smaller part of its triangles is turned. The triangle is one where this
    is impossible, -1 if there is none.
    """
    count = len(triangles)
    component = np.full(count, -1)
    turn = np.zeros(count, np.bool_)
    queue = np.zeros(count, np.int64)
    twisted = -1
    parts = 0
    for seed in range(count):
        if component[seed] >= 0:
            continue
        component[seed] = parts
        queue[0] = seed
        head, tail, turned = 0, 1, 0
        while head < tail:
            t = queue[head]
            head += 1
            for k in range(3):
                g = opposite[3 * t + k]
                if g < 0:
                    continue
                u = g // 3
                against = turn[t] != (triangles[t, k] == triangles[u, g % 3])
                if component[u] < 0:
                    component[u] = parts
                    turn[u] = against
                    turned += 1 if against else 0
                    queue[tail] = u
                    tail += 1
                elif turn[u] != against:
                    twisted = t
        if 2 * turned > tail:
            for i in range(tail):
                turn[queue[i]] = not turn[queue[i]]
        parts += 1
    return component, turn, twisted


class Rings(NamedTuple):
    """Closed border chains, the surface on their left; they may pass a vertex more than once."""

    vertices: IntArray  # of all rings, one after the other
    start: IntArray  # (rings + 1,) where each begins
    triangle: IntArray  # (rings,) a triangle beside each


@allocating
def _trace(triangles: IntArray, opposite: IntArray) -> tuple[IntArray, list[int], list[int]]:
    done = opposite >= 0
    vertices = np.full(len(opposite) - np.count_nonzero(done), -1)
    start, beside = [0], [0]
    filled = 0
    for seed in range(len(opposite)):
        if done[seed]:
            continue
        h = seed
        while not done[h]:
            done[h] = True
            vertices[filled] = triangles[h // 3, h % 3]
            filled += 1
            # turn about the end of h, through the triangles around it, to the next border
            h = 3 * (h // 3) + (h + 1) % 3
            while opposite[h] >= 0:
                g = opposite[h]
                h = 3 * (g // 3) + (g + 1) % 3
        start.append(filled)
        beside.append(seed // 3)
    return vertices, start, beside


def trace_rings(triangles: IntArray, opposite: IntArray) -> Rings:
    """The border of consistently wound triangles."""
    vertices, start, beside = _trace(triangles, opposite)
    return Rings(vertices, np.array(start), np.array(beside[1:], dtype=np.int64))
