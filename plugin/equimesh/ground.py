"""What a lattice is laid on, the points that it has so far, and what is near a place.

Distances are those of the metric at the place: of a frame W, whose columns are the steps in x that
advance y1 and y2 by one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating, inlined
from equimesh.fields.reference import by_reference
from equimesh.pointtree import insert, next_bucket, start_walk

__all__ = [
    "Front", "Ground", "add", "inside", "near_boundary", "nearest", "there", "within",
]  # fmt: skip


@by_reference
class Ground(NamedTuple):
    """What a lattice is laid on (local coordinates).

    A surface (``frame``, ``child``, ``coef`` of its kernel), eight times the tolerance and the
    least metric; the ``sides`` (s, 4) of the domain, by strips; the neighbours (b, 2) along it of
    each of ``boundary`` nodes; how near to it vertices come, and to each other where fronts meet.
    """

    frame: NDArray[np.float64]
    child: NDArray[np.int32]
    coef: NDArray[np.float64]
    eight_tol: float
    floor: float
    sides: NDArray[np.float64]
    strip_start: NDArray[np.int32]
    strip_items: NDArray[np.int32]
    strip_box: NDArray[np.float64]
    following: NDArray[np.int64]
    boundary: int
    gap: float
    merge: float


@by_reference
class Front(NamedTuple):
    """The lattice so far: room for its points, the boundary's nodes first.

    ``frames`` (capacity, 4) and ``signs`` are W and eps of every vertex; a tree of the points.
    """

    px: NDArray[np.float64]
    py: NDArray[np.float64]
    frames: NDArray[np.float64]
    signs: NDArray[np.int8]
    tree: NDArray[np.int32]
    link: NDArray[np.int32]
    used: NDArray[np.int64]
    box: NDArray[np.float64]


@allocating
def inside(sides, strip_start, strip_items, strip_box, x, y):
    """Whether (x, y) is in the domain: crossings of a ray with the sides (s, 4) of its strip."""
    count = strip_start.shape[0] - 1
    k = int((y - strip_box[0]) / strip_box[1] * count)
    if k < 0 or k >= count:
        return False
    odd = False
    for i in range(strip_start[k], strip_start[k + 1]):
        s = strip_items[i]
        ax, ay, bx, by = sides[s, 0], sides[s, 1], sides[s, 2], sides[s, 3]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            odd = not odd
    return odd


@allocating
def within(ground, x, y):
    """Whether (x, y) is in the domain."""
    return inside(ground.sides, ground.strip_start, ground.strip_items, ground.strip_box, x, y)


@allocating
def nearest(tree, link, box, px, py, x, y, w, radius, first, last, any_one):
    """The point from ``first`` on, before ``last``, nearest to (x, y) in the metric and within
    ``radius``; -1 where there is none. With ``any_one`` whichever within the radius is found before
    others: where triangles are huge the whole domain may be near.
    """
    det = w[0] * w[3] - w[1] * w[2]
    reach_x = radius * math.hypot(w[0], w[1])
    reach_y = radius * math.hypot(w[2], w[3])
    xlo, xhi, ylo, yhi = x - reach_x, x + reach_x, y - reach_y, y + reach_y
    best, who = radius * radius, -1
    stack, corner = start_walk(box)
    top = 1
    while top > 0:
        point, top = next_bucket(tree, stack, corner, top, xlo, xhi, ylo, yhi)
        while point >= 0:
            if first <= point < last:
                dx, dy = px[point] - x, py[point] - y
                if abs(dx) <= reach_x and abs(dy) <= reach_y:
                    u = (w[3] * dx - w[1] * dy) / det
                    v = (w[0] * dy - w[2] * dx) / det
                    d = u * u + v * v
                    if d < best:
                        best, who = d, point
                        if any_one:
                            return who
            point = link[point]
    return who


@allocating
def near_boundary(ground, front, x, y, w):
    """Whether a boundary segment passes within the gap of (x, y)."""
    tree, link, box, px, py = front.tree, front.link, front.box, front.px, front.py
    following, count, gap = ground.following, ground.boundary, ground.gap
    det = w[0] * w[3] - w[1] * w[2]
    radius = 1.1
    reach_x = radius * math.hypot(w[0], w[1])
    reach_y = radius * math.hypot(w[2], w[3])
    xlo, xhi, ylo, yhi = x - reach_x, x + reach_x, y - reach_y, y + reach_y
    stack, corner = start_walk(box)
    top = 1
    while top > 0:
        point, top = next_bucket(tree, stack, corner, top, xlo, xhi, ylo, yhi)
        while point >= 0:
            if point < count:
                for side_of in range(2):
                    other = following[point, side_of]
                    dx, dy = px[point] - x, py[point] - y
                    ex, ey = px[other] - x, py[other] - y
                    u, v = (w[3] * dx - w[1] * dy) / det, (w[0] * dy - w[2] * dx) / det
                    p, q = (w[3] * ex - w[1] * ey) / det, (w[0] * ey - w[2] * ex) / det
                    p, q = p - u, q - v
                    length = p * p + q * q
                    s = 0.0
                    if length > 0.0:
                        s = min(max(-(u * p + v * q) / length, 0.0), 1.0)
                    u, v = u + s * p, v + s * q
                    if u * u + v * v < gap * gap:
                        return True
            point = link[point]
    return False


@inlined
def there(front, x, y, w, radius, first, last):
    """Whether one of the points from ``first`` on, before ``last``, is within ``radius``."""
    px, py = front.px, front.py
    return (
        nearest(front.tree, front.link, front.box, px, py, x, y, w, radius, first, last, True) >= 0
    )


@allocating
def add(front, count, x, y, w, eps):
    """The vertex number ``count``; returns how many there are then."""
    front.px[count], front.py[count], front.signs[count] = x, y, eps
    front.frames[count] = w
    insert(front.tree, front.link, front.used, front.box, front.px, front.py, count)
    return count + 1
