"""A triangle surface that is a graph, for compiled loops.

``F.points`` (n, 3) are sorted by the cell of an index grid, row by row, so that the vertices of
neighbouring cells of a row are one range: those of cell c are ``F.vertex_start[c]`` to
``F.vertex_start[c + 1]``. ``F.triangles`` (m, 6) holds three vertices, counter-clockwise, and the
opposite half-edges of the three edges (half-edge 3 t + k leaves vertex k of triangle t; -1 on the
border). Triangles over cell c: ``F.triangle_items`` from ``F.triangle_start[c]``.
``F.frame`` = (x0, y0, cells per unit length, columns, rows, slack); slack is the rounding of
coordinates, within which the surface is closed and a vertex counts as on a line.

Surface minus triangle is linear on every part of their overlay: the largest error is attained at
a surface vertex inside the triangle, where edges of both cross, or at a corner of the triangle.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField

__all__ = [
    "edge_error",
    "gradient",
    "inner_error",
    "locate",
    "value",
]

Array = NDArray[np.float64]


@compiled
def _bounded(position: float, count: float) -> int:
    """The cell along one axis, kept inside the grid."""
    return int(min(max(position, 0.0), count - 1.0))


@compiled
def _weight(ax: float, ay: float, bx: float, by: float, x: float, y: float, slack: float) -> float:
    """Twice the area of (a, b, point); 0 within ``slack`` of the line, NaN beyond to the right."""
    w = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
    if w >= 0.0:
        return w
    return 0.0 if w >= -slack * (abs(bx - ax) + abs(by - ay)) else math.nan


@compiled
def locate(F: KernelField, x: float, y: float) -> tuple[int, float, float, float]:
    """The triangle over a point and barycentric weights of its corners; -1 outside the surface."""
    points = F.points
    triangles = F.triangles
    triangle_start = F.triangle_start
    triangle_items = F.triangle_items
    frame = F.frame
    slack = frame[5]
    u, v = (x - frame[0]) * frame[2], (y - frame[1]) * frame[2]
    edge = slack * frame[2]
    columns, rows = frame[3], frame[4]
    if not (-edge <= u <= columns + edge and -edge <= v <= rows + edge):
        return -1, 0.0, 0.0, 0.0
    cell = _bounded(v, rows) * int(columns) + _bounded(u, columns)
    for item in range(triangle_start[cell], triangle_start[cell + 1]):
        t = triangle_items[item]
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = points[i, 0], points[i, 1]
        bx, by = points[j, 0], points[j, 1]
        w2 = _weight(ax, ay, bx, by, x, y, slack)
        if math.isnan(w2):
            continue
        cx, cy = points[k, 0], points[k, 1]
        w0 = _weight(bx, by, cx, cy, x, y, slack)
        w1 = _weight(cx, cy, ax, ay, x, y, slack)
        total = w0 + w1 + w2
        if total > 0.0:
            return t, w0 / total, w1 / total, w2 / total
    return -1, 0.0, 0.0, 0.0


@compiled
def value(F: KernelField, x: float, y: float) -> float:
    """Height of the surface; NaN outside."""
    points = F.points
    triangles = F.triangles
    t, w0, w1, w2 = locate(F, x, y)
    if t < 0:
        return math.nan
    i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    z0, z1, z2 = points[i, 2], points[j, 2], points[k, 2]
    return w0 * z0 + w1 * z1 + w2 * z2  # type: ignore[no-any-return]


@compiled
def gradient(F: KernelField, x: float, y: float) -> tuple[float, float]:
    """Gradient of the triangle over the point; NaN outside."""
    points = F.points
    triangles = F.triangles
    t, _, _, _ = locate(F, x, y)
    if t < 0:
        return math.nan, math.nan
    i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    ux, uy, uz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
    vx, vy, vz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
    area = ux * vy - uy * vx
    return (uz * vy - vz * uy) / area, (vz * ux - uz * vx) / area


@compiled
def _seen(
    points: Array, vertex: int, ax: float, ay: float, dx: float, dy: float, snap: float
) -> tuple[float, float]:
    """A vertex seen along a line: (distance to its left, 0 within snap; place, b at |d|^2)."""
    x, y = points[vertex, 0] - ax, points[vertex, 1] - ay
    left = dx * y - dy * x
    return (0.0 if abs(left) <= snap else left), dx * x + dy * y


@inlined
def _enter(
    F: KernelField, ax: float, ay: float, dx: float, dy: float, snap: float, since: float
) -> tuple[int, bool, float]:
    """Where the line a + t d meets the surface first after t = ``since``: (half-edge, side, t).

    A vertex on the line counts as left of it if ``side``, else as right: the line never
    passes through a vertex, and where it runs along the border one of the two sides has it inside.
    The half-edge is entered at t, which is before ``since`` if the surface is there already. -1: it
    is not met before t = 1.
    """
    points = F.points
    triangles = F.triangles
    triangle_start = F.triangle_start
    triangle_items = F.triangle_items
    frame = F.frame
    x0, y0, per_cell, columns, rows = frame[0], frame[1], frame[2], frame[3], frame[4]
    per_length = 1.0 / (dx * dx + dy * dy)
    tiny = snap * per_length
    # cells that the line crosses, in units of cells
    px, py = (ax - x0) * per_cell, (ay - y0) * per_cell
    ux, uy = dx * per_cell, dy * per_cell
    i = _bounded(math.floor(px + since * ux), columns)
    j = _bounded(math.floor(py + since * uy), rows)
    found, found_side, found_t = -1, True, 2.0
    while True:
        tx = ((i + 1 if ux > 0.0 else i) - px) / ux if ux != 0.0 else math.inf
        ty = ((j + 1 if uy > 0.0 else j) - py) / uy if uy != 0.0 else math.inf
        cell = j * int(columns) + i
        for item in range(triangle_start[cell], triangle_start[cell + 1]):
            t = triangle_items[item]
            d0, s0 = _seen(points, triangles[t, 0], ax, ay, dx, dy, snap)
            d1, s1 = _seen(points, triangles[t, 1], ax, ay, dx, dy, snap)
            d2, s2 = _seen(points, triangles[t, 2], ax, ay, dx, dy, snap)
            if (d0 > 0.0 and d1 > 0.0 and d2 > 0.0) or (d0 < 0.0 and d1 < 0.0 and d2 < 0.0):
                continue
            side = not (d0 >= 0.0 and d1 >= 0.0 and d2 >= 0.0)
            left0, left1, left2 = d0 > 0.0, d1 > 0.0, d2 > 0.0
            if side:
                left0, left1, left2 = d0 >= 0.0, d1 >= 0.0, d2 >= 0.0
            if left0 == left1 and left1 == left2:
                continue  # all three corners on the line
            t01 = (s0 + (s1 - s0) * (d0 / (d0 - d1))) * per_length if left0 != left1 else 0.0
            t12 = (s1 + (s2 - s1) * (d1 / (d1 - d2))) * per_length if left1 != left2 else 0.0
            t20 = (s2 + (s0 - s2) * (d2 / (d2 - d0))) * per_length if left2 != left0 else 0.0
            # in by the half-edge from left to right, out by the one from right to left
            if left0 and not left1:
                k, t_in = 0, t01
            elif left1 and not left2:
                k, t_in = 1, t12
            else:
                k, t_in = 2, t20
            if left1 and not left0:
                t_out = t01
            elif left2 and not left1:
                t_out = t12
            else:
                t_out = t20
            if t_out > since + tiny and t_in < found_t:
                found, found_side, found_t = 3 * t + k, side, t_in
                if t_in <= since:
                    return found, found_side, found_t
        leave = min(tx, ty)
        if found_t <= min(leave, 1.0) + tiny:
            return found, found_side, found_t
        if leave >= 1.0:
            return -1, True, 2.0
        if tx <= ty:
            i += 1 if ux > 0.0 else -1
            if i < 0 or i >= columns:
                break
        else:
            j += 1 if uy > 0.0 else -1
            if j < 0 or j >= rows:
                break
    return (found, found_side, found_t) if found_t <= 1.0 + tiny else (-1, True, 2.0)


@compiled
def edge_error(
    F: KernelField,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    stop: float,
) -> tuple[float, float]:
    """Signed surface minus chord of largest magnitude on a-b, and where in [0, 1].

    Walks from triangle to triangle along the segment, and asks the index where to go on after a
    hole; exact up to rounding. Parts outside the surface are ignored. Returns early with any point
    whose |error| exceeds ``stop``.
    """
    points = F.points
    triangles = F.triangles
    dx, dy, dz = bx - ax, by - ay, bz - az
    square = dx * dx + dy * dy
    if not 0.0 < square < math.inf:
        z = value(F, ax, ay)
        return (0.0, 0.5) if math.isnan(z) else (z - az, 0.0)
    per_length = 1.0 / square
    snap = F.frame[5] * math.sqrt(square)
    best, worst, where = 0.0, 0.0, 0.5
    since, steps = 0.0, 0
    while since < 1.0 and steps <= 2 * len(triangles):
        h, side, t0 = _enter(F, ax, ay, dx, dy, snap, since)
        if since == 0.0 and t0 > 0.0:  # a touches the surface at most
            e = value(F, ax, ay) - az
            if abs(e) > worst:
                best, worst, where = e, abs(e), 0.0
        if h < 0:
            break
        t, k = h // 3, h % 3
        vertex = triangles[t, k]
        left, s_left = _seen(points, vertex, ax, ay, dx, dy, snap)
        z_left = points[vertex, 2]
        vertex = triangles[t, (k + 1) % 3]
        right, s_right = _seen(points, vertex, ax, ay, dx, dy, snap)
        z_right = points[vertex, 2]
        part = left / (left - right)
        t0 = (s_left + part * (s_right - s_left)) * per_length
        z0 = z_left + part * (z_right - z_left)
        t1, z1 = t0, z0
        if t0 >= 0.0:
            e = z0 - (az + t0 * dz)
            if abs(e) > worst:
                best, worst, where = e, abs(e), t0
        while h >= 0:
            t, k = h // 3, h % 3
            k = k + 2 if k == 0 else k - 1
            vertex = triangles[t, k]
            off, s = _seen(points, vertex, ax, ay, dx, dy, snap)
            if off > 0.0 or (side and off == 0.0):
                left, s_left, z_left = off, s, points[vertex, 2]
                k = k - 1 if k > 0 else 2
            else:
                right, s_right, z_right = off, s, points[vertex, 2]
            part = left / (left - right)
            t1 = (s_left + part * (s_right - s_left)) * per_length
            z1 = z_left + part * (z_right - z_left)
            if t0 < 0.0 < t1:
                e = z0 - t0 / (t1 - t0) * (z1 - z0) - az
                if abs(e) > worst:
                    best, worst, where = e, abs(e), 0.0
            if t1 >= 1.0:
                part = (1.0 - t0) / (t1 - t0) if t1 > t0 else 1.0
                e = z0 + part * (z1 - z0) - bz
                if abs(e) > worst:
                    best, worst, where = e, abs(e), 1.0
                return best, where
            if t1 >= 0.0:
                e = z1 - (az + t1 * dz)
                if abs(e) > worst:
                    best, worst, where = e, abs(e), t1
            if worst > stop:
                return best, where
            t0, z0 = t1, z1
            h = triangles[t, 3 + k]
            steps += 1
        since = max(since, t1)
    e = value(F, bx, by) - bz
    if abs(e) > worst:
        best, where = e, 1.0
    return best, where


@compiled
def _inverse(length: float) -> float:
    """1 / length, or 0 where there is no length to divide."""
    return 1.0 / length if length > 1e-290 else 0.0


@compiled
def inner_error(
    F: KernelField,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    cx: float,
    cy: float,
    cz: float,
    stop: float,
) -> tuple[float, float, float]:
    """Signed surface minus triangle of largest magnitude at the vertices inside, and its place.

    Looks at the cells that the triangle (counter-clockwise) covers, row by row. (0.0, centroid) if
    there is no vertex inside.
    """
    points = F.points
    vertex_start = F.vertex_start
    frame = F.frame
    px, py = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
    best, worst = 0.0, 0.0
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if not 0.0 < area < math.inf:
        return best, px, py
    rise_b, rise_c = (bz - az) / area, (cz - az) / area
    x0, y0, per_cell, columns, rows = frame[0], frame[1], frame[2], frame[3], frame[4]
    # corners by rising y: low, mid, high
    lx, ly, mx, my, hx, hy = ax, ay, bx, by, cx, cy
    if my < ly:
        lx, ly, mx, my = mx, my, lx, ly
    if hy < my:
        mx, my, hx, hy = hx, hy, mx, my
        if my < ly:
            lx, ly, mx, my = mx, my, lx, ly
    long_slope = (hx - lx) * _inverse(hy - ly)
    low_slope, high_slope = (mx - lx) * _inverse(my - ly), (hx - mx) * _inverse(hy - my)
    first = _bounded((ly - y0) * per_cell, rows)
    middle = _bounded((my - y0) * per_cell, rows)
    last = _bounded((hy - y0) * per_cell, rows)
    left = right = lx
    for row in range(first, last + 1):
        # the triangle's extent in this row: at the two lines that bound it and at mid
        top = y0 + (row + 1) / per_cell
        x_min, x_max = left, right
        if row == last or top >= hy:
            left = right = hx
        else:
            left = lx + (top - ly) * long_slope
            right = lx + (top - ly) * low_slope if top < my else mx + (top - my) * high_slope
            if right < left:
                left, right = right, left
        x_min, x_max = min(x_min, left), max(x_max, right)
        if row == middle:
            x_min, x_max = min(x_min, mx), max(x_max, mx)
        start = row * int(columns)
        begin = vertex_start[start + _bounded((x_min - x0) * per_cell, columns)]
        end = vertex_start[start + _bounded((x_max - x0) * per_cell, columns) + 1]
        for vertex in range(begin, end):
            x, y = points[vertex, 0], points[vertex, 1]
            wb = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
            wc = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            if wb < 0.0 or wc < 0.0 or (cx - bx) * (y - by) - (cy - by) * (x - bx) < 0.0:
                continue
            e = points[vertex, 2] - (az + wb * rise_b + wc * rise_c)
            if abs(e) > worst:
                best, worst, px, py = e, abs(e), x, y
                if worst > stop:
                    return best, px, py
    return best, px, py
