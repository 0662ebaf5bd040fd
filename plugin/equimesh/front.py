"""The transported lattice: each vertex carries its frame, neighbours are reached along geodesics.

Along a step the frame obeys (12) of the paper, ``dU = U Gamma(dx)``, or for its inverse W
``dW = -1/2 H^-1 T(dx) W`` with ``T = D^3 f(dx)``: for a Hessian metric the Christoffel symbols are
half the third derivatives. A lattice step l is the geodesic ``x' = W l``. On a flat metric the
frame returns unchanged from any closed walk, so the vertices are those of the paper's pulled-back
lattice; on a curved one the fronts fail to meet and vertices that come too close are merged, which
leaves a few dislocations.

Only the gauge is transported: a rotation where f is convex, a boost where it is a saddle. Lengths
are those of the metric at the vertex itself, so errors of integration do not add up.
"""

from __future__ import annotations

import math

import numpy as np

from equimesh.fields.compiled import allocating, inlined
from equimesh.fields.patch_kernels import derivatives3
from equimesh.ground import add, near_boundary, there, within
from equimesh.metric import BOOST_PERIOD, frame_at

__all__ = ["gauge", "geodesic", "grow", "sow", "turn"]

_HALF_SQRT5 = 0.5 * math.sqrt(5.0)
_EDGE_CONVEX = 0.5 * math.sqrt(3.0)  # circumradius 1/2: error 1
_FREE = 0.95  # spacings from every vertex: there a lattice of its own begins
_THERE = 0.3  # spacings: a vertex so near the end of a straight step is that of the curved one too


@inlined
def turn(w, eps, angle):
    """Turn the frame ``w`` by its gauge: a rotation, or a boost where the surface is a saddle."""
    c, s = (math.cos(angle), math.sin(angle)) if eps > 0 else (math.cosh(angle), math.sinh(angle))
    back = -s if eps > 0 else s
    for row in range(0, 4, 2):
        a, b = w[row], w[row + 1]
        w[row], w[row + 1] = a * c + b * s, a * back + b * c


@allocating
def _spin(f, child, coef, x, y, wx, wy):
    """-1/2 H^-1 D^3 f(w) as four numbers, or a failure where H is nearly singular."""
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(f, child, coef, x, y)
    det = hxx * hyy - hxy * hxy
    size = hxx * hxx + 2 * hxy * hxy + hyy * hyy
    if abs(det) < 1e-6 * size:
        return 0.0, 0.0, 0.0, 0.0, False
    a, b, d = t111 * wx + t112 * wy, t112 * wx + t122 * wy, t122 * wx + t222 * wy
    r = -0.5 / det
    return (
        r * (hyy * a - hxy * b),
        r * (hyy * b - hxy * d),
        r * (hxx * b - hxy * a),
        r * (hxx * d - hxy * b),
        True,
    )


@allocating
def geodesic(f, child, coef, x, y, w, l1, l2, steps, out):
    """Runge-Kutta of order 4 for (x, W) along the lattice step (l1, l2); out = x, y, W."""
    a, b, c, d = w[0], w[1], w[2], w[3]
    h = 1.0 / steps
    for _ in range(steps):
        sx = sy = sa = sb = sc = sd = 0.0
        px, py, pa, pb, pc, pd = x, y, a, b, c, d
        for stage in range(4):
            dx, dy = pa * l1 + pb * l2, pc * l1 + pd * l2
            g11, g12, g21, g22, ok = _spin(f, child, coef, px, py, dx, dy)
            if not ok:
                return False
            da, db = g11 * pa + g12 * pc, g11 * pb + g12 * pd
            dc, dd = g21 * pa + g22 * pc, g21 * pb + g22 * pd
            weight = 1.0 if stage == 0 or stage == 3 else 2.0
            sx += weight * dx
            sy += weight * dy
            sa += weight * da
            sb += weight * db
            sc += weight * dc
            sd += weight * dd
            ahead = h if stage == 2 else 0.5 * h
            px, py = x + ahead * dx, y + ahead * dy
            pa, pb, pc, pd = a + ahead * da, b + ahead * db, c + ahead * dc, d + ahead * dd
        k = h / 6.0
        x, y = x + k * sx, y + k * sy
        a, b, c, d = a + k * sa, b + k * sb, c + k * sc, d + k * sd
    out[0], out[1], out[2], out[3], out[4], out[5] = x, y, a, b, c, d
    return True


@allocating
def gauge(e1x, e1y, e2x, e2y, eps, w, out):
    """The frame at a point (eigenframe e1, e2) whose gauge is nearest to the carried frame w.

    ``out[0:4]`` = W row by row. ``w`` may stem from the other signature: the rotation is kept.
    """
    # K = W^-1 of the eigenframe times w: ideally a rotation (eps = 1) or a boost (eps = -1).
    det = e1x * e2y - e2x * e1y
    k11, k12 = (e2y * w[0] - e2x * w[2]) / det, (e2y * w[1] - e2x * w[3]) / det
    k21, k22 = (e1x * w[2] - e1y * w[0]) / det, (e1x * w[3] - e1y * w[1]) / det
    if eps > 0:
        # Nearest rotation or reflection of the plane (polar decomposition of a 2 x 2 matrix).
        if k11 * k22 - k12 * k21 >= 0.0:
            p, q = k11 + k22, k21 - k12
            r = math.hypot(p, q)
            k11, k12, k21, k22 = p / r, -q / r, q / r, p / r
        else:
            p, q = k11 - k22, k21 + k12
            r = math.hypot(p, q)
            k11, k12, k21, k22 = p / r, q / r, q / r, -p / r
    else:
        s1 = 1.0 if k11 >= 0.0 else -1.0
        s2 = 1.0 if k22 >= 0.0 else -1.0
        boost = math.asinh(0.5 * (s1 * k12 + s2 * k21))
        boost -= BOOST_PERIOD * math.floor(boost / BOOST_PERIOD + 0.5)
        ch, sh = math.cosh(boost), math.sinh(boost)
        k11, k12, k21, k22 = s1 * ch, s1 * sh, s2 * sh, s2 * ch
    out[0], out[1] = e1x * k11 + e2x * k21, e1x * k12 + e2x * k22
    out[2], out[3] = e1y * k11 + e2y * k21, e1y * k12 + e2y * k22


@allocating
def grow(ground, front, count, begin, generations):
    """Lay neighbours of the vertices from ``begin`` on, and theirs, up to so many ``generations``.

    Returns the number of points. Stops when there is room for no more.
    """
    f, child, coef, eight_tol, floor = (
        ground.frame, ground.child, ground.coef, ground.eight_tol, ground.floor,
    )  # fmt: skip
    px, py, frames, signs = front.px, front.py, front.frames, front.signs
    step, w, out = np.empty(6), np.empty(4), np.empty(4)
    here, end, generation = begin, count, 0
    while here < count:
        if here == end:
            end, generation = count, generation + 1
        if generation == generations:
            break
        convex = signs[here] > 0
        for side in range(6):
            if count >= px.shape[0]:
                return count
            if convex:
                angle = side * math.pi / 3.0
                l1, l2 = _EDGE_CONVEX * math.cos(angle), _EDGE_CONVEX * math.sin(angle)
            else:
                l1 = 1.0 if side % 3 == 0 else (0.5 if side % 3 == 1 else -0.5)
                l2 = 0.0 if side % 3 == 0 else _HALF_SQRT5
                if side >= 3:
                    l1, l2 = -l1, -l2
            x, y = px[here], py[here]
            w[:] = frames[here]
            dx, dy = w[0] * l1 + w[1] * l2, w[2] * l1 + w[3] * l2
            if there(front, x + dx, y + dy, w, _THERE, ground.boundary, count):
                continue  # five of six steps lead back to a vertex that is there
            exact = geodesic(f, child, coef, x, y, w, l1, l2, 1, step)
            if exact:
                # A step that strays from the straight one has left the reach of the series.
                ex, ey = step[0] - x - dx, step[1] - y - dy
                det = w[0] * w[3] - w[1] * w[2]
                u, v = (w[3] * ex - w[1] * ey) / det, (w[0] * ey - w[2] * ex) / det
                exact = u * u + v * v < 0.2
            if exact:
                nx, ny = step[0], step[1]
                e1x, e1y, e2x, e2y, eps, pure = frame_at(f, child, coef, nx, ny, eight_tol, floor)
                exact = pure and eps == signs[here]
            if not exact:
                # Trapezoidal rule with the limited metric at both ends.
                nx, ny = x + dx, y + dy
                for _ in range(2):
                    e1x, e1y, e2x, e2y, eps, pure = frame_at(
                        f, child, coef, nx, ny, eight_tol, floor
                    )
                    gauge(e1x, e1y, e2x, e2y, eps, w, out)
                    if eps == signs[here]:
                        dx = 0.5 * ((w[0] + out[0]) * l1 + (w[1] + out[1]) * l2)
                        dy = 0.5 * ((w[2] + out[2]) * l1 + (w[3] + out[3]) * l2)
                    nx, ny = x + dx, y + dy
                e1x, e1y, e2x, e2y, eps, pure = frame_at(f, child, coef, nx, ny, eight_tol, floor)
                step[2], step[3], step[4], step[5] = w[0], w[1], w[2], w[3]
            if not within(ground, nx, ny):
                continue
            if eps != signs[here]:
                continue  # beyond det H = 0 nothing fits: a seed there does better
            gauge(e1x, e1y, e2x, e2y, eps, step[2:6], out)
            limit = ground.merge * (_EDGE_CONVEX if eps > 0 else 1.0)
            if there(front, nx, ny, out, limit, ground.boundary, count):
                continue
            if near_boundary(ground, front, nx, ny, out):
                continue
            count = add(front, count, nx, ny, out, eps)
        here += 1
    return count


@allocating
def sow(ground, front, count, seeds):
    """Grow a lattice from each of the ``seeds`` (k, 3: x, y and a gauge) that is not covered yet.

    Returns the number of points.
    """
    w = np.empty(4)
    for k in range(seeds.shape[0]):
        x, y = seeds[k, 0], seeds[k, 1]
        if count >= front.px.shape[0] or not within(ground, x, y):
            continue
        e1x, e1y, e2x, e2y, eps, _ = frame_at(
            ground.frame, ground.child, ground.coef, x, y, ground.eight_tol, ground.floor
        )
        w[0], w[1], w[2], w[3] = e1x, e2x, e1y, e2y
        if there(front, x, y, w, _FREE, ground.boundary, count):
            continue
        if near_boundary(ground, front, x, y, w):
            continue
        turn(w, eps, seeds[k, 2])
        begin = count
        count = add(front, count, x, y, w, eps)
        count = grow(ground, front, count, begin, -1)
    return count
