"""Loops that (12) does not close: the curvature that hides where det H vanishes, or in a hole.

Where Gamma of (10) is zero, (12) carries the same values along any two paths that can be moved into
each other. Around a zero of det H, a singular point or a hole they may still differ: the metric is
that of a cone, and all of its curvature sits in the apex. A function homogeneous of degree k has
such an apex at the origin, ``Re z^n`` with total angle ``n pi``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.collocation import Collocation
from equimesh.errors import InputError
from equimesh.net import Net
from equimesh.signature import circle, loops
from equimesh.transport import Array, Derivatives, carry, compose, invert

__all__ = ["Apex", "around", "around_holes", "around_vertices", "around_zeros", "frame_of"]

_LOOP = 48


@dataclass(frozen=True)
class Apex:
    """A point, or a hole, that loops of the domain run around.

    Parameters
    ----------
    where
        (x, y); for a hole, a point inside it.
    angle
        The total angle around it in y-space, in radians: 2 pi around any ordinary point. NaN on a
        saddle where (12) comes back neither to the same values nor to their negatives: a boost is
        no angle.
    mismatch
        By how much (12) comes back changed, in the frame of y: the largest entry of the difference
        of the carried Jacobian, or of that of y over the loop's length, whichever is larger.
    """

    where: tuple[float, float]
    angle: float
    mismatch: float


def frame_of(hessian: Array) -> Array:
    """(2, 2) Jacobian with rows (16), (17): scaled eigenvectors, that of the larger eigenvalue
    first, turned so that y keeps the orientation of x."""
    values, vectors = np.linalg.eigh(hessian)
    order = np.argsort(-values)
    rows = np.sqrt(np.abs(values[order]))[:, None] * vectors[:, order].T
    if rows[0, np.abs(rows[0]).argmax()] < 0.0:
        rows[0] *= -1.0
    if np.linalg.det(rows) < 0.0:
        rows[1] *= -1.0
    return np.asarray(rows)


def around(source: Derivatives, corners: Array, where: Array) -> Apex | None:
    """Carry (12) around a closed polygon, (k, 2) and counter-clockwise.

    None where it cannot be integrated: the function is not defined, or det H vanishes, on the way.
    """
    following = np.roll(corners, -1, axis=0)
    turn, shift = carry(source, corners, following, strict=False)
    if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
        return None
    side = following - corners
    jacobian = frame_of(source.hessian(*corners[:1].T)[0])
    start, end, angle, length = jacobian, np.zeros(2), 0.0, 0.0
    for i in range(len(corners)):
        before = jacobian @ side[i]
        end, jacobian = end + jacobian @ shift[i], jacobian @ turn[i]
        after, onward = jacobian @ side[i], jacobian @ side[(i + 1) % len(side)]
        angle += _angle(before, after) + _angle(after, onward)
        length += float(np.linalg.norm(after))
    changed = jacobian @ np.linalg.inv(start)
    same, negated = (float(np.abs(changed - s * np.eye(2)).max()) for s in (1.0, -1.0))
    x, y = corners[0]
    if np.linalg.det(source.hessian(x[None], y[None])[0]) < 0.0 and min(same, negated) > 1e-3:
        angle = math.nan
    gained = float(np.linalg.norm(end)) / length
    return Apex((float(where[0]), float(where[1])), angle, max(same, gained))


def around_zeros(source: Derivatives, net: Net, zeros: Array) -> tuple[Apex, ...]:
    """The apexes at isolated zeros of det H.

    A zero on the boundary is encircled as far as the function goes on beyond it: a transform of a
    closed domain is one of its neighbourhood. Where the function ends there, no loop can run
    around the zero and it is left out.
    """
    found = []
    for k, zero in enumerate(zeros):
        for radius in loops(source, net, zeros, k):
            loop = _around_zero(source, net, zero, circle(zero, radius, _LOOP))
            if loop is not None:
                found.append(loop)
                break
    return tuple(found)


def _around_zero(source: Derivatives, net: Net, zero: Array, corners: Array) -> Apex | None:
    loop = around(source, corners, zero)
    inside = shapely.intersects_xy(net.polygon, *corners.T).all()
    if loop is not None or inside or not isinstance(source, Collocation):
        return loop
    # Polynomials end with the domain; the callable that they stand for may go on.
    ring = shapely.Polygon(zero + 1.01 * (corners - zero), [zero + 0.98 * (corners - zero)])
    try:
        return around(Collocation.of(source.value, ring), corners, zero)
    except InputError:
        return None


def around_holes(source: Derivatives, polygon: shapely.Polygon) -> tuple[Apex, ...]:
    """Carry (12) around every hole of the domain, along its edge."""
    found = []
    for ring in polygon.interiors:
        fine = shapely.segmentize(shapely.orient_polygons(shapely.Polygon(ring)), ring.length / 48)
        middle = fine.representative_point()
        corners = shapely.get_coordinates(fine.exterior)[:-1]
        loop = around(source, corners, np.array([middle.x, middle.y]))
        if loop is not None:
            found.append(loop)
    return tuple(found)


def around_vertices(source: Derivatives, net: Net, largest: float) -> Apex | None:
    """The worst loop around one inner vertex of the net, from anchor to anchor of its triangles.

    These loops enclose all of the domain but a rim half an edge wide, so that no apex inside slips
    through, not even one where det H does not vanish (degree 2). None where all loops are closed to
    within ``largest``.
    """
    m = len(net.triangles)
    ends = net.middles.reshape(-1, 2)
    turn, shift = carry(source, np.repeat(net.anchors, 3, axis=0), ends, strict=False)
    out = turn.reshape(m, 3, 2, 2), shift.reshape(m, 3, 2)
    beyond, arrival = np.full((2, m, 3), -1)
    for (a, b), (side_a, side_b) in (
        (net.links.T, net.sides.T),
        (net.links.T[::-1], net.sides.T[::-1]),
    ):
        beyond[a, side_a], arrival[a, side_a] = b, side_b

    vertex, first = np.unique(net.triangles, return_index=True)
    start, corner = first // 3, first % 3
    at, along = start.copy(), corner.copy()
    path = np.tile(np.eye(2), (len(vertex), 1, 1)), np.zeros((len(vertex), 2))
    open_ = np.arange(len(vertex))
    closed: NDArray[np.bool_] = np.zeros(len(vertex), dtype=np.bool_)
    while open_.size:
        # Counter-clockwise around corner j the way leads through the edge that ends there.
        side = (along[open_] + 2) % 3
        there = beyond[at[open_], side]
        open_, side, there = open_[there >= 0], side[there >= 0], there[there >= 0]
        here, entry = at[open_], arrival[at[open_], side]
        step = compose(
            (out[0][here, side], out[1][here, side]),
            invert((out[0][there, entry], out[1][there, entry])),
        )
        path[0][open_], path[1][open_] = compose((path[0][open_], path[1][open_]), step)
        at[open_], along[open_] = there, entry
        back = there == start[open_]
        closed[open_[back]] = True
        open_ = open_[~back]

    loops = np.flatnonzero(closed & np.isfinite(path[0]).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(source.hessian(*net.anchors[start[loops]].T))
    frames = np.sqrt(np.abs(values))[:, :, None] * vectors.transpose(0, 2, 1)
    change = frames @ path[0][loops] @ np.linalg.inv(frames) - np.eye(2)
    length = np.linalg.norm(frames, axis=(1, 2)) * net.spacing
    gain = np.linalg.norm(np.einsum("nij,nj->ni", frames, path[1][loops]), axis=1) / length
    mismatch = np.maximum(np.abs(change).max(axis=(1, 2)), gain)
    if not (mismatch > largest).any():
        return None
    worst = int(np.argmax(mismatch))
    x, y = net.points[vertex[loops[worst]]]
    return _closer(source, net, Apex((float(x), float(y)), np.nan, float(mismatch[worst])), largest)


def _closer(source: Derivatives, net: Net, apex: Apex, largest: float) -> Apex:
    """Shrink a loop about an apex: of four squares, always the one that does not close."""
    where, half, best = np.array(apex.where), 1.5 * net.spacing, apex
    for _ in range(40):
        # Not halved in the middle, where apexes like to lie.
        split = where + 0.0713 * half
        found = None
        for i in (-1.0, 1.0):
            for j in (-1.0, 1.0):
                far = where + half * np.array([i, j])
                low, high = np.minimum(split, far), np.maximum(split, far)
                corners = shapely.get_coordinates(
                    shapely.segmentize(shapely.box(*low, *high, ccw=True), 0.26 * half).exterior
                )[:-1]
                loop = around(source, corners, 0.5 * (low + high))
                if loop is not None and loop.mismatch > largest:
                    found = loop, 0.5 * (low + high), 0.5 * float((high - low).max())
        if found is None:
            break
        loop, where, half = found
        # The first loop is the widest, and least disturbed by rounding.
        best = replace(loop if best is apex else best, where=(float(where[0]), float(where[1])))
        if half < 1e-9 * net.size:
            break
    return best


def _angle(a: Array, b: Array) -> float:
    return float(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b))
