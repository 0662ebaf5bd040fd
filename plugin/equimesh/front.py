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

from equimesh.fields.compiled import allocating
from equimesh.fields.patch_kernels import derivatives3
from equimesh.metric import BOOST_PERIOD, frame_at
from equimesh.pointtree import insert

__all__ = ["grow", "inside", "nearest"]

_HALF_SQRT5 = 0.5 * math.sqrt(5.0)
_EDGE_CONVEX = 0.5 * math.sqrt(3.0)  # circumradius 1/2: error 1
_THERE = 0.3  # spacings: a vertex so near the end of a straight step is that of the curved one too


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
def _geodesic(f, child, coef, x, y, w, l1, l2, steps, out):
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
def _gauge(e1x, e1y, e2x, e2y, eps, w, out):
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
def nearest(tree, link, box, px, py, x, y, w, radius, first, any_one):
    """The point from ``first`` on that is nearest to (x, y) in the metric, at most at ``radius``;
    -1 where there is none. With ``any_one`` whichever within the radius is found before others:
    where triangles are huge the whole domain may be near.
    """
    det = w[0] * w[3] - w[1] * w[2]
    reach_x = radius * math.hypot(w[0], w[1])
    reach_y = radius * math.hypot(w[2], w[3])
    xlo, xhi, ylo, yhi = x - reach_x, x + reach_x, y - reach_y, y + reach_y
    best, who = radius * radius, -1
    stack = np.empty(200, np.int32)
    corner = np.empty((200, 3))
    stack[0] = 0
    corner[0, 0], corner[0, 1], corner[0, 2] = box[0], box[1], box[2]
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        x0, y0, side = corner[top, 0], corner[top, 1], corner[top, 2]
        if tree[node, 0] >= 0:
            side *= 0.5
            for q in range(4):
                cx, cy = x0 + side * (q & 1), y0 + side * (q >> 1)
                if cx <= xhi and cx + side >= xlo and cy <= yhi and cy + side >= ylo:
                    stack[top] = tree[node, q]
                    corner[top, 0], corner[top, 1], corner[top, 2] = cx, cy, side
                    top += 1
            continue
        point = tree[node, 4]
        while point >= 0:
            if point >= first:
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
def _near_boundary(tree, link, box, px, py, count, following, x, y, w, gap):
    """Whether a boundary segment (node to ``following`` node) passes within ``gap`` of (x, y)."""
    det = w[0] * w[3] - w[1] * w[2]
    radius = 1.1
    reach_x = radius * math.hypot(w[0], w[1])
    reach_y = radius * math.hypot(w[2], w[3])
    xlo, xhi, ylo, yhi = x - reach_x, x + reach_x, y - reach_y, y + reach_y
    stack = np.empty(200, np.int32)
    corner = np.empty((200, 3))
    stack[0] = 0
    corner[0, 0], corner[0, 1], corner[0, 2] = box[0], box[1], box[2]
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        x0, y0, side = corner[top, 0], corner[top, 1], corner[top, 2]
        if tree[node, 0] >= 0:
            side *= 0.5
            for q in range(4):
                cx, cy = x0 + side * (q & 1), y0 + side * (q >> 1)
                if cx <= xhi and cx + side >= xlo and cy <= yhi and cy + side >= ylo:
                    stack[top] = tree[node, q]
                    corner[top, 0], corner[top, 1], corner[top, 2] = cx, cy, side
                    top += 1
            continue
        point = tree[node, 4]
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


@allocating
def grow(
    f, child, coef, eight_tol, floor,
    sides, strip_start, strip_items, strip_box,
    tree, link, used, box, px, py, frames, signs, following, boundary, count,
    seeds, gap, merge,
):  # fmt: skip
    """Lay vertices from each seed that is not covered yet; returns the number of points.

    ``px, py`` (capacity,) hold ``boundary`` nodes first, which are obstacles (``following`` (b, 2):
    their neighbours along the boundary); ``frames`` (capacity, 4) and ``signs`` are W and eps of
    every vertex; ``seeds`` (k, 6): x, y and a gauge to start from. Stops when capacity is reached.
    """
    capacity = px.shape[0]
    step, w, out = np.empty(6), np.empty(4), np.empty(4)
    for k in range(seeds.shape[0]):
        x, y = seeds[k, 0], seeds[k, 1]
        if count >= capacity or not inside(sides, strip_start, strip_items, strip_box, x, y):
            continue
        e1x, e1y, e2x, e2y, eps, _ = frame_at(f, child, coef, x, y, eight_tol, floor)
        out[0], out[1], out[2], out[3] = e1x, e2x, e1y, e2y
        if nearest(tree, link, box, px, py, x, y, out, 0.95, boundary, True) >= 0:
            continue
        if _near_boundary(tree, link, box, px, py, boundary, following, x, y, out, gap):
            continue
        g = seeds[k, 2]
        if eps > 0:
            ch, sh = math.cos(g), math.sin(g)
            sh2 = -sh
        else:
            ch, sh = math.cosh(g), math.sinh(g)
            sh2 = sh
        px[count], py[count], signs[count] = x, y, eps
        frames[count, 0], frames[count, 1] = e1x * ch + e2x * sh, e1x * sh2 + e2x * ch
        frames[count, 2], frames[count, 3] = e1y * ch + e2y * sh, e1y * sh2 + e2y * ch
        insert(tree, link, used, box, px, py, count)
        head = count
        count += 1
        while head < count:
            here = head
            head += 1
            convex = signs[here] > 0
            for side in range(6):
                if convex:
                    angle = side * math.pi / 3.0
                    l1, l2 = _EDGE_CONVEX * math.cos(angle), _EDGE_CONVEX * math.sin(angle)
                else:
                    l1 = 1.0 if side % 3 == 0 else (0.5 if side % 3 == 1 else -0.5)
                    l2 = 0.0 if side % 3 == 0 else _HALF_SQRT5
                    if side >= 3:
                        l1, l2 = -l1, -l2
                if count >= capacity:
                    return count
                x, y = px[here], py[here]
                w[:] = frames[here]
                dx, dy = w[0] * l1 + w[1] * l2, w[2] * l1 + w[3] * l2
                if nearest(tree, link, box, px, py, x + dx, y + dy, w, _THERE, boundary, True) >= 0:
                    continue  # five of six steps lead back to a vertex that is there
                exact = _geodesic(f, child, coef, x, y, w, l1, l2, 1, step)
                if exact:
                    # A step that strays from the straight one has left the reach of the series.
                    ex, ey = step[0] - x - dx, step[1] - y - dy
                    det = w[0] * w[3] - w[1] * w[2]
                    u, v = (w[3] * ex - w[1] * ey) / det, (w[0] * ey - w[2] * ex) / det
                    exact = u * u + v * v < 0.2
                if exact:
                    nx, ny = step[0], step[1]
                    e1x, e1y, e2x, e2y, eps, pure = frame_at(
                        f, child, coef, nx, ny, eight_tol, floor
                    )
                    exact = pure and eps == signs[here]
                if not exact:
                    # Trapezoidal rule with the limited metric at both ends.
                    nx, ny = x + dx, y + dy
                    for _ in range(2):
                        e1x, e1y, e2x, e2y, eps, pure = frame_at(
                            f, child, coef, nx, ny, eight_tol, floor
                        )
                        _gauge(e1x, e1y, e2x, e2y, eps, w, out)
                        if eps == signs[here]:
                            dx = 0.5 * ((w[0] + out[0]) * l1 + (w[1] + out[1]) * l2)
                            dy = 0.5 * ((w[2] + out[2]) * l1 + (w[3] + out[3]) * l2)
                        nx, ny = x + dx, y + dy
                    e1x, e1y, e2x, e2y, eps, pure = frame_at(
                        f, child, coef, nx, ny, eight_tol, floor
                    )
                    step[2], step[3], step[4], step[5] = w[0], w[1], w[2], w[3]
                if not inside(sides, strip_start, strip_items, strip_box, nx, ny):
                    continue
                if eps != signs[here]:
                    continue  # beyond det H = 0 nothing fits: a seed there does better
                _gauge(e1x, e1y, e2x, e2y, eps, step[2:6], out)
                limit = merge * (_EDGE_CONVEX if eps > 0 else 1.0)
                if nearest(tree, link, box, px, py, nx, ny, out, limit, boundary, True) >= 0:
                    continue
                if _near_boundary(tree, link, box, px, py, boundary, following, nx, ny, out, gap):
                    continue
                px[count], py[count], signs[count] = nx, ny, eps
                frames[count, 0], frames[count, 1] = out[0], out[1]
                frames[count, 2], frames[count, 3] = out[2], out[3]
                insert(tree, link, used, box, px, py, count)
                count += 1
    return count
