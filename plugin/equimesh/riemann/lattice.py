"""The equilateral lattice, carried along geodesics from vertex to vertex.

Each vertex owns a frame W, orthonormal in the metric: its six neighbours lie where the geodesics
with the initial velocities W l end, l being the unit vectors at multiples of 60 degrees, and they
inherit the frame that is parallel along them. On a flat metric every closed walk brings the frame
back and the vertices are those of one lattice in flat coordinates; on a curved one fronts that meet
do not fit, and vertices that come too close are merged, which leaves a few dislocations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from equimesh.boundary import BoundaryNodes
from equimesh.domain import Sides, strips_of
from equimesh.fields.compiled import allocating
from equimesh.ground import inside, nearest
from equimesh.pointtree import insert, make_tree
from equimesh.riemann.kernels import geodesic, metric_at, orthonormal, unit_frame
from equimesh.riemann.patches import MetricPatches

__all__ = ["lattice_points"]

Array = NDArray[np.float64]

# Two vertices of fronts that meet closer than the first are one, and nothing is laid nearer to the
# boundary than the second: the number of vertices decides which pair.
_LIMITS = (
    (0.72, 0.5), (0.65, 0.5), (0.78, 0.5), (0.84, 0.5), (0.72, 0.42), (0.72, 0.6), (0.65, 0.42),
    (0.78, 0.6), (0.65, 0.36), (0.84, 0.7),
)  # fmt: skip
_NEAR, _TOLERABLE = 0.005, 0.02
_FAR = 0.95  # a seed this far from all vertices starts a lattice of its own
_STEPS = 2  # of the integration along an edge


@allocating
def _beside(tree, link, box, px, py, neighbours, x, y, w, gap):
    """Whether the boundary edges at the nearest boundary node pass within ``gap`` of (x, y)."""
    who = nearest(tree, link, box, px, py, x, y, w, 1.5, 0, px.shape[0], False)
    if who < 0:
        return False
    det = w[0] * w[3] - w[1] * w[2]
    dx, dy = px[who] - x, py[who] - y
    u, v = (w[3] * dx - w[1] * dy) / det, (w[0] * dy - w[2] * dx) / det
    for k in range(2):
        other = neighbours[who, k]
        ex, ey = px[other] - px[who], py[other] - py[who]
        p, q = (w[3] * ex - w[1] * ey) / det, (w[0] * ey - w[2] * ex) / det
        s = min(max(-(u * p + v * q) / (p * p + q * q), 0.0), 1.0)
        if (u + s * p) ** 2 + (v + s * q) ** 2 < gap * gap:
            return True
    return False


@allocating
def _grow(
    P, sides, strip_start, strip_items, strip_box, box,
    tree, link, used, px, py, frames, count,
    border_tree, border_link, bx, by, neighbours,
    seeds, merge, gap, far, steps,
):  # fmt: skip
    """Lay vertices from each of ``seeds`` (k, 3: x, y, angle) that is not covered yet."""
    capacity = px.shape[0]
    step, w, out = np.empty(6), np.empty(4), np.empty(4)
    for k in range(seeds.shape[0]):
        x, y = seeds[k, 0], seeds[k, 1]
        if count >= capacity or not inside(sides, strip_start, strip_items, strip_box, x, y):
            continue
        m11, m12, m22 = metric_at(P, x, y)
        out[0], out[1], out[2], out[3] = unit_frame(m11, m12, m22)
        if nearest(tree, link, box, px, py, x, y, out, far, 0, count, True) >= 0:
            continue
        if _beside(border_tree, border_link, box, bx, by, neighbours, x, y, out, gap):
            continue
        cs, sn = math.cos(seeds[k, 2]), math.sin(seeds[k, 2])
        px[count], py[count] = x, y
        frames[count, 0], frames[count, 1] = out[0] * cs + out[1] * sn, out[1] * cs - out[0] * sn
        frames[count, 2], frames[count, 3] = out[2] * cs + out[3] * sn, out[3] * cs - out[2] * sn
        insert(tree, link, used, box, px, py, count)
        head = count
        count += 1
        while head < count:
            here = head
            head += 1
            for side in range(6):
                if count >= capacity:
                    return count
                angle = side * math.pi / 3.0
                w[:] = frames[here]
                geodesic(P, px[here], py[here], w, math.cos(angle), math.sin(angle), steps, step)
                nx, ny = step[0], step[1]
                if not (math.isfinite(nx) and math.isfinite(ny)):
                    continue
                if not inside(sides, strip_start, strip_items, strip_box, nx, ny):
                    continue
                m11, m12, m22 = metric_at(P, nx, ny)
                orthonormal(m11, m12, m22, step[2:6], out)
                if nearest(tree, link, box, px, py, nx, ny, out, merge, 0, count, True) >= 0:
                    continue
                if _beside(border_tree, border_link, box, bx, by, neighbours, nx, ny, out, gap):
                    continue
                px[count], py[count] = nx, ny
                frames[count] = out
                insert(tree, link, used, box, px, py, count)
                count += 1
    return count


def lattice_points(
    patches: MetricPatches,
    sides: Sides,
    nodes: BoundaryNodes,
    starts: Sequence[Array],
    expected: int,
) -> Array:
    """(n, 2) interior vertices in local coordinates, nearly as many as ``expected``.

    ``starts``, in the order in which they are to be tried: (k, 3) x, y and angle of lattices to
    start, those that an earlier one covers left out.
    """
    capacity = 3 * expected + 1000
    px, py = np.empty(capacity), np.empty(capacity)
    low, high = sides.corners.min(0), sides.corners.max(0)
    box = np.array([*low, float((high - low).max()) * (1.0 + 1e-9)])
    bx, by = (np.ascontiguousarray(a) for a in nodes.points.T)
    border = make_tree(len(bx))
    for i in range(len(bx)):
        insert(*border, box, bx, by, i)
    previous = np.empty(len(bx), np.int64)
    previous[nodes.following] = np.arange(len(bx))
    neighbours = np.stack([nodes.following, previous], 1)
    segments = np.hstack([sides.corners, sides.corners[sides.following]])
    strips = strips_of(segments)
    best = np.empty((0, 2))
    for seeds in starts:
        for merge, gap in _LIMITS:
            count = _grow(
                patches, segments, *strips, box,
                *make_tree(capacity), px, py, np.empty((capacity, 4)), 0,
                border[0], border[1], bx, by, neighbours,
                np.ascontiguousarray(seeds), merge, gap, _FAR, _STEPS,
            )  # fmt: skip
            if len(best) == 0 or abs(count - expected) < abs(len(best) - expected):
                best = np.stack([px[:count], py[:count]], 1)
            if abs(count - expected) <= _NEAR * expected:
                return best
        if abs(len(best) - expected) <= _TOLERABLE * expected:
            return best
    return best
