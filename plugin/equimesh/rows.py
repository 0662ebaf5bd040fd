"""Rows of vertices in saddles, laid before the lattice grows from them.

Errors of a saddle's edges change with strain to first order, so where the metric is curved wide
crystals pay for their strain and narrow ones for the seams between them. Strips have half the seams
of round grains as wide. The middle of each is a row along a geodesic, from which the lattice grows
to both sides until strips meet.

Along lines where det H = 0 the triangles of a mesh reach across. They end at a row along the line,
and a lattice of other rows does not fit there. So the first rows follow contours of det H, and a
lattice grows from these by an edge before strips are laid.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating, compiled, inlined
from equimesh.fields.patch_kernels import derivatives3
from equimesh.front import gauge, geodesic, grow, turn
from equimesh.ground import Front, Ground, add, near_boundary, there, within
from equimesh.metric import eigenvalues, frame_at, gamma

__all__ = ["grow_rows"]

# Lengths are in edges of the lattice. A strip's width, times the cube root of the curvature, and
# its limits. A strip's strain grows like K times the square of its width, and what seams cost like
# one over it, so the best width is in proportion to 1 / K^(1/3).
_WIDTH, _NARROWEST, _WIDEST = 3.0, 6.0, 60.0
_BEGIN, _END = 0.9, 0.55  # widths from all other rows at which one may begin, and ends
_EVERY = 4  # vertices of a row, from which others may begin at both sides
_LONGEST = 3000  # vertices of a row to either side
_OWN = 0.65  # from a row's own vertices
# Rows along lines where det H = 0: how far from the line they begin, and may come; how far apart
# they begin, and end; for how many generations a lattice grows from them, and how near to that
# other rows come.
_BESIDE, _REACH = (3.0, 6.0), (2.0, 8.0)
_APART, _MEET = 6.3, 2.0
_GENERATIONS, _CLEAR = 1, 2.0
_SEEDS = 20_000  # that are tried, and places beside rows that wait for it
_ALONG = 0.2  # a contour nearer to an asymptote has no row
_TO_ROWS = math.asinh(0.5)  # boost that brings a lattice's vector (1/2, sqrt5/2) to (0, 1)


def grow_rows(ground: Ground, front: Front, count: int, seeds: NDArray[np.float64]) -> int:
    """Lay rows near some of the ``seeds`` (k, 3), and the lattice around them (``front`` has
    ``count`` points); returns the number of points."""
    seeds = seeds[:_SEEDS]
    first = count
    count = _lay_beside(ground, front, count, seeds)
    count = grow(ground, front, count, first, _GENERATIONS)
    strips = count
    count = _lay_strips(ground, front, count, seeds)
    count = grow(ground, front, count, strips, -1)
    return int(grow(ground, front, count, first, -1))


@compiled
def _curvature(ground, x, y):
    """Gauss curvature K of the metric: Gamma / (4 det^2) by (10) of the paper."""
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(
        ground.frame, ground.child, ground.coef, x, y
    )
    det = hxx * hyy - hxy * hxy
    k = 0.25 * gamma(hxx, hxy, hyy, t111, t112, t122, t222) / (det * det)
    return k * ground.eight_tol


@compiled
def _width(ground, x, y):
    """How wide a strip is."""
    k = abs(_curvature(ground, x, y))
    if not k > (_WIDTH / _WIDEST) ** 3:
        return _WIDEST
    return max(_WIDTH * k ** (-1.0 / 3.0), _NARROWEST)


@compiled
def _beside(ground, x, y):
    """How far away det H = 0 is along the eigenvector of the lesser eigenvalue, in edges that long,
    as far as the third derivative tells."""
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(
        ground.frame, ground.child, ground.coef, x, y
    )
    lesser, other, vx, vy = eigenvalues(hxx, hxy, hyy)
    if abs(lesser) > abs(other):
        lesser, vx, vy = other, -vy, vx
    slope = abs(t111 * vx**3 + 3.0 * t112 * vx * vx * vy + 3.0 * t122 * vx * vy * vy + t222 * vy**3)
    return abs(lesser) ** 1.5 / (slope * math.sqrt(ground.eight_tol)) if slope > 0.0 else math.inf


@inlined
def _saddle_at(ground, x, y, w):
    """The eigenframe as ``w``; whether the surface is a saddle there by H alone."""
    e1x, e1y, e2x, e2y, eps, pure = frame_at(
        ground.frame, ground.child, ground.coef, x, y, ground.eight_tol, ground.floor
    )
    w[0], w[1], w[2], w[3] = e1x, e2x, e1y, e2y
    return pure and eps < 0


@allocating
def _along(ground, x, y, w):
    """The frame ``w`` with a vector along the contour of det H: the first, or the second.

    Returns whether there is one, whether it is the first, and which way along the contour.
    """
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(
        ground.frame, ground.child, ground.coef, x, y
    )
    # The contour is normal to the gradient of det H.
    dx = -(t112 * hyy + hxx * t222 - 2.0 * hxy * t122)
    dy = t111 * hyy + hxx * t122 - 2.0 * hxy * t112
    if not _saddle_at(ground, x, y, w):
        return False, True, 1.0
    det = w[0] * w[3] - w[1] * w[2]
    u, v = (w[3] * dx - w[1] * dy) / det, (w[0] * dy - w[2] * dx) / det
    if not abs(abs(u) - abs(v)) > _ALONG * max(abs(u), abs(v)):
        return False, True, 1.0
    first = abs(u) > abs(v)
    turn(w, -1, math.atanh(v / u) if first else math.atanh(u / v))
    return True, first, math.copysign(1.0, u if first else v)


@allocating
def _step_along(ground, x, y, first, way, w):
    """One edge along the contour of det H by the midpoint rule.

    Returns whether that is possible, and the end, whose frame ``w`` is.
    """
    column = 0 if first else 1
    ex, ey = x, y
    for share in (0.5, 1.0):
        ok, same, side = _along(ground, ex, ey, w)
        if not ok or same != first:
            return False, x, y
        length = share * way * side
        ex, ey = x + length * w[column], y + length * w[2 + column]
    ok, same, _ = _along(ground, ex, ey, w)
    return ok and same == first, ex, ey


@allocating
def _lay_row(ground, front, count, x, y, w, first, contour, strips):
    """A row through (x, y), where the frame is ``w``, along its ``first`` or its second vector.

    Along the ``contour`` of det H, or a geodesic, which must keep away from other strips, from the
    point ``strips`` on, and from the lattices before. Returns the number of points.
    """
    step, start = np.empty(6), w.copy()
    begin = count
    for way in (1.0, -1.0):
        nx, ny = x, y
        w[:] = start
        for number in range(_LONGEST):
            if number > 0 or way > 0.0:
                if count >= front.px.shape[0]:
                    return count
                if not first:
                    turn(w, -1, -_TO_ROWS)
                count = add(front, count, nx, ny, w, -1)
                if not first:
                    turn(w, -1, _TO_ROWS)
            if contour:
                ok, nx, ny = _step_along(ground, nx, ny, first, way, w)
                if not ok or not within(ground, nx, ny):
                    break
                if not _REACH[0] < _beside(ground, nx, ny) < _REACH[1]:
                    break
                if there(front, nx, ny, w, _MEET, ground.boundary, begin):
                    break
            else:
                if not _advance(ground, nx, ny, w, way * first, way * (not first), 1, step):
                    break
                nx, ny = step[0], step[1]
                if there(front, nx, ny, w, _END * _width(ground, nx, ny), strips, begin):
                    break
                if there(front, nx, ny, w, _CLEAR, ground.boundary, strips):
                    break
            if there(front, nx, ny, w, _OWN, begin, count):
                break
            if near_boundary(ground, front, nx, ny, w):
                break
    return count


@allocating
def _advance(ground, x, y, w, l1, l2, steps, step):
    """Along a geodesic by (l1, l2) in the frame ``w``, carried along; ``step`` begins with where.

    Returns whether the saddle reaches as far.
    """
    if not geodesic(ground.frame, ground.child, ground.coef, x, y, w, l1, l2, steps, step):
        return False
    if not within(ground, step[0], step[1]):
        return False
    e1x, e1y, e2x, e2y, eps, pure = frame_at(
        ground.frame, ground.child, ground.coef, step[0], step[1], ground.eight_tol, ground.floor
    )
    gauge(e1x, e1y, e2x, e2y, eps, step[2:6], w)
    return pure and eps < 0


@allocating
def _lay_beside(ground, front, count, seeds):
    """Rows along lines where det H = 0; returns the number of points."""
    w = np.empty(4)
    for k in range(seeds.shape[0]):
        x, y = seeds[k, 0], seeds[k, 1]
        if not within(ground, x, y):
            continue
        if not _BESIDE[0] < _beside(ground, x, y) < _BESIDE[1]:
            continue
        ok, first, _ = _along(ground, x, y, w)
        if not ok or there(front, x, y, w, _APART, ground.boundary, count):
            continue
        if near_boundary(ground, front, x, y, w):
            continue
        count = _lay_row(ground, front, count, x, y, w, first, True, count)
    return count


@allocating
def _lay_strips(ground, front, count, seeds):
    """Rows along geodesics, each beside others where there are any; returns the number of points.

    They go in the direction in which geodesics come together (Jacobi's equation): where K > 0
    along vectors on which the metric is positive.
    """
    strips, w, step = count, np.empty(4), np.empty(6)
    waiting = np.empty((_SEEDS, 6))
    for k in range(seeds.shape[0]):
        x, y = seeds[k, 0], seeds[k, 1]
        if not within(ground, x, y) or not _saddle_at(ground, x, y, w):
            continue
        turn(w, -1, seeds[k, 2])
        waiting[0, 0], waiting[0, 1] = x, y
        waiting[0, 2:] = w
        head, tail = 0, 1
        while head < tail:
            x, y = waiting[head, 0], waiting[head, 1]
            w[:] = waiting[head, 2:]
            head += 1
            if there(front, x, y, w, _BEGIN * _width(ground, x, y), strips, count):
                continue
            if there(front, x, y, w, _CLEAR, ground.boundary, strips):
                continue
            if near_boundary(ground, front, x, y, w):
                continue
            first = _curvature(ground, x, y) > 0.0
            begin = count
            count = _lay_row(ground, front, count, x, y, w, first, False, strips)
            for i in range(begin, count, _EVERY):
                for side in (1.0, -1.0):
                    w[:] = front.frames[i]
                    if not first:
                        turn(w, -1, _TO_ROWS)
                    width = _width(ground, front.px[i], front.py[i])
                    l1, l2 = side * width * (not first), side * width * first
                    steps = int(0.5 * width) + 1
                    if tail < waiting.shape[0] and _advance(
                        ground, front.px[i], front.py[i], w, l1, l2, steps, step
                    ):
                        waiting[tail, 0], waiting[tail, 1] = step[0], step[1]
                        waiting[tail, 2:] = w
                        tail += 1
    return count
