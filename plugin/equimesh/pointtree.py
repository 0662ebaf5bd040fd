"""A growing set of points in the plane: a quadtree for compiled kernels.

Mesh sizes differ by orders of magnitude over a domain, so buckets split where points are dense.
State is two arrays: ``tree`` (nodes, 5) int32 holds the four children, or -1 -1 -1 -1, and the head
of the node's linked list; ``link`` (points,) int32 holds the next point of the list.
"""

from __future__ import annotations

import numpy as np

from equimesh.fields.compiled import allocating, compiled

__all__ = ["insert", "make_tree", "next_bucket", "start_walk"]

_BUCKET = 8
_MAX_DEPTH = 40
_STACK = 200  # nodes that a walk has to come back to, at most


def make_tree(capacity: int):
    """Empty ``tree`` and ``link`` for up to ``capacity`` points; node 0 is the root."""
    tree = np.full((max(64, capacity), 6), -1, np.int32)
    tree[0, 5] = 0
    return tree, np.full(capacity, -1, np.int32), np.ones(1, np.int64)


@allocating
def insert(tree, link, used, box, px, py, point):
    """Insert ``point`` at (px[point], py[point]) in the square ``box`` = (x0, y0, side)."""
    x, y = px[point], py[point]
    node, x0, y0, side = 0, box[0], box[1], box[2]
    depth = 0
    while tree[node, 0] >= 0:
        side *= 0.5
        q = 0
        if x >= x0 + side:
            q += 1
            x0 += side
        if y >= y0 + side:
            q += 2
            y0 += side
        node = tree[node, q]
        depth += 1
    link[point] = tree[node, 4]
    tree[node, 4] = point
    tree[node, 5] += 1
    while tree[node, 5] > _BUCKET and depth < _MAX_DEPTH and used[0] + 4 <= tree.shape[0]:
        head = tree[node, 4]
        first = used[0]
        used[0] += 4
        for q in range(4):
            tree[node, q] = first + q
            tree[first + q, 5] = 0
        tree[node, 4] = -1
        tree[node, 5] = 0
        side *= 0.5
        while head >= 0:
            follower = link[head]
            q = (1 if px[head] >= x0 + side else 0) + (2 if py[head] >= y0 + side else 0)
            link[head] = tree[first + q, 4]
            tree[first + q, 4] = head
            tree[first + q, 5] += 1
            head = follower
        q = (1 if x >= x0 + side else 0) + (2 if y >= y0 + side else 0)
        x0 += side * (q & 1)
        y0 += side * (q >> 1)
        node = first + q
        depth += 1


@allocating
def start_walk(box):
    """A stack with the root alone: nodes, and (x0, y0, side) of their squares."""
    stack, corner = np.empty(_STACK, np.int32), np.empty((_STACK, 3))
    stack[0] = 0
    corner[0] = box
    return stack, corner


@compiled
def next_bucket(tree, stack, corner, top, xlo, xhi, ylo, yhi):
    """The first point of the next bucket that may have some in a window, -1 where it is empty or
    there is no other bucket; and how many nodes the stack, which had ``top``, still has."""
    while top > 0:
        top -= 1
        node = stack[top]
        if tree[node, 0] < 0:
            return tree[node, 4], top
        x0, y0, side = corner[top, 0], corner[top, 1], 0.5 * corner[top, 2]
        for q in range(4):
            cx, cy = x0 + side * (q & 1), y0 + side * (q >> 1)
            if cx <= xhi and cx + side >= xlo and cy <= yhi and cy + side >= ylo:
                stack[top] = tree[node, q]
                corner[top, 0], corner[top, 1], corner[top, 2] = cx, cy, side
                top += 1
    return -1, 0
