"""A smooth function as piecewise polynomials on a quadtree: value, derivatives, errors.

A leaf holds the 64 coefficients of a polynomial of degree 7 in each of s, t in [-1, 1]. The errors
of an edge and of a triangle's inside are found by sampling the polynomial and climbing from the
largest sample (secs. 2 and 3.1 of the paper tell where it lies for a quadratic).
"""

from __future__ import annotations

from equimesh.fields.compiled import compiled, inlined, outlined
from equimesh.fields.partials import partials0, partials1, partials2, partials3, values8

__all__ = [
    "derivatives2",
    "derivatives3",
    "edge_error",
    "gradient",
    "inner_error",
    "locate",
    "value",
]


@inlined
def locate(frame, child, x, y):
    """Leaf that holds (x, y), its local coordinates s, t and the half width of its cell."""
    side = frame[2]
    u = min(max((x - frame[0]) / side, 0.0), 1.0)
    v = min(max((y - frame[1]) / side, 0.0), 1.0)
    node = 0
    while True:
        right = 1 if u >= 0.5 else 0
        top = 1 if v >= 0.5 else 0
        below = child[node, right + 2 * top]
        u = 2.0 * u - right
        v = 2.0 * v - top
        side *= 0.5
        if below < 0:
            return -below - 1, 2.0 * u - 1.0, 2.0 * v - 1.0, 0.5 * side
        node = below


@compiled
def _value(frame, child, coef, x, y):
    leaf, s, t, _ = locate(frame, child, x, y)
    return partials0(coef, leaf, s, t)[0]


@compiled
def value(F, x, y):
    return _value(F.frame, F.child, F.coef, x, y)


@outlined
def derivatives2(frame, child, coef, x, y):
    """f, f_x, f_y, f_xx, f_xy, f_yy; second derivatives are 0 beside a kink."""
    leaf, s, t, half = locate(frame, child, x, y)
    f, fs, ft, fss, fst, ftt = partials2(coef, leaf, s, t)
    r = 1.0 / half
    if leaf >= frame[4]:
        return f, fs * r, ft * r, 0.0, 0.0, 0.0
    return f, fs * r, ft * r, fss * r * r, fst * r * r, ftt * r * r


@compiled
def derivatives3(frame, child, coef, x, y):
    """f_xx, f_xy, f_yy, f_xxx, f_xxy, f_xyy, f_yyy; all are 0 beside a kink."""
    leaf, s, t, half = locate(frame, child, x, y)
    if leaf >= frame[4]:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    _, _, _, fss, fst, ftt, fsss, fsst, fstt, fttt = partials3(coef, leaf, s, t)
    r2 = 1.0 / (half * half)
    r3 = r2 / half
    return fss * r2, fst * r2, ftt * r2, fsss * r3, fsst * r3, fstt * r3, fttt * r3


@compiled
def gradient(F, x, y):
    leaf, s, t, half = locate(F.frame, F.child, x, y)
    _, fs, ft = partials1(F.coef, leaf, s, t)
    return fs / half, ft / half


@compiled
def _chord_error(frame, child, coef, ax, ay, az, dx, dy, dz, s):
    return _value(frame, child, coef, ax + s * dx, ay + s * dy) - (az + s * dz)


@inlined
def _spaced(start, along, first, step):
    """Eight places from ``start`` at the shares ``first``, ``first + step``, ... of ``along``."""
    p0, p1, p2, p3 = first, first + step, first + 2.0 * step, first + 3.0 * step
    p4, p5, p6, p7 = p0 + 4.0 * step, p1 + 4.0 * step, p2 + 4.0 * step, p3 + 4.0 * step
    return (
        start + p0 * along, start + p1 * along, start + p2 * along, start + p3 * along,
        start + p4 * along, start + p5 * along, start + p6 * along, start + p7 * along,
    )  # fmt: skip


@inlined
def _eight(frame, child, coef, ax, ay, dx, dy, ends, first, step):
    """Heights at eight shares of an edge from ``first`` on; ``ends``: see ``_ends``."""
    leaf, sa, ta, ds, dt = ends
    if leaf >= 0:
        return values8(coef, leaf, _spaced(sa, ds, first, step), _spaced(ta, dt, first, step))
    x, y = _spaced(ax, dx, first, step), _spaced(ay, dy, first, step)
    return (
        _value(frame, child, coef, x[0], y[0]), _value(frame, child, coef, x[1], y[1]),
        _value(frame, child, coef, x[2], y[2]), _value(frame, child, coef, x[3], y[3]),
        _value(frame, child, coef, x[4], y[4]), _value(frame, child, coef, x[5], y[5]),
        _value(frame, child, coef, x[6], y[6]), _value(frame, child, coef, x[7], y[7]),
    )  # fmt: skip


@inlined
def _ends(frame, child, ax, ay, bx, by):
    """The leaf that holds both ends of an edge, the local coordinates of the first end and those of
    the edge; a leaf of -1 where each end has its own."""
    leaf, sa, ta, _ = locate(frame, child, ax, ay)
    other, sb, tb, _ = locate(frame, child, bx, by)
    return (leaf if leaf == other else -1), sa, ta, sb - sa, tb - ta


@compiled
def _scan(frame, child, coef, ax, ay, az, dx, dy, dz, ends, left, n):
    """Samples at n - 1 places along an edge, n a multiple of 8, and its second end.

    Climbs from each leading local maximum by a parabola; ``left``: error at the first end.
    """
    here = best = left
    where, step = 0.0, 1.0 / n
    for k in range(0, n, 8):
        heights = _eight(frame, child, coef, ax, ay, dx, dy, ends, (k + 1.0) * step, step)
        for i in range(8):
            right = heights[i] - (az + (k + i + 1.0) * step * dz)
            size = abs(here)
            sign = 1.0 if here > 0.0 else -1.0
            if (
                k + i > 0
                and size > 0.85 * abs(best)
                and sign * left <= size
                and sign * right <= size
            ):
                if size > abs(best):
                    best, where = here, (k + i) * step
                bend = left - 2.0 * here + right
                if bend != 0.0:
                    s = (k + i + 0.5 * (left - right) / bend) * step
                    if 0.0 < s < 1.0:
                        e = _chord_error(frame, child, coef, ax, ay, az, dx, dy, dz, s)
                        if abs(e) > abs(best):
                            best, where = e, s
            left, here = here, right
    if abs(here) > abs(best):
        best, where = here, 1.0
    return best, where


@compiled
def edge_error(F, ax, ay, az, bx, by, bz, stop):
    """Five samples, then the peak of the parabola through each leading sample and its neighbours.

    Along an edge the error of a cubic may have two peaks of opposite sign (an S): both are climbed.
    Where fourth differences tell that the error is no smooth arch, samples are taken more densely.
    """
    dx, dy, dz = bx - ax, by - ay, bz - az
    frame, child, coef = F.frame, F.child, F.coef
    ends = _ends(frame, child, ax, ay, bx, by)
    sixth = 1.0 / 6.0
    e0, e1, e2, e3, e4, e5, e6, _ = _eight(frame, child, coef, ax, ay, dx, dy, ends, 0.0, sixth)
    e0, e6 = e0 - az, e6 - bz
    e1, e2, e3 = e1 - (az + sixth * dz), e2 - (az + 2.0 * sixth * dz), e3 - (az + 0.5 * dz)
    e4, e5 = e4 - (az + 4.0 * sixth * dz), e5 - (az + 5.0 * sixth * dz)
    top = max(abs(e1), abs(e2), abs(e3), abs(e4), abs(e5))
    fourth = max(
        abs(e0 - 4.0 * e1 + 6.0 * e2 - 4.0 * e3 + e4),
        abs(e1 - 4.0 * e2 + 6.0 * e3 - 4.0 * e4 + e5),
        abs(e2 - 4.0 * e3 + 6.0 * e4 - 4.0 * e5 + e6),
    )
    if fourth > 0.15 * top and top <= stop:
        n = 24 if fourth > 0.6 * top else 16
        return _scan(frame, child, coef, ax, ay, az, dx, dy, dz, ends, e0, n)
    best, where = e0, 0.0
    if abs(e6) > abs(best):
        best, where = e6, 1.0
    left, here, right = e0, e1, e2
    for k in range(1, 6):
        if k == 2:
            left, here, right = e1, e2, e3
        elif k == 3:
            left, here, right = e2, e3, e4
        elif k == 4:
            left, here, right = e3, e4, e5
        elif k == 5:
            left, here, right = e4, e5, e6
        size = abs(here)
        if size > abs(best):
            best, where = here, k * sixth
        sign = 1.0 if here > 0.0 else -1.0
        if size < 0.85 * top or sign * left > size or sign * right > size or size > stop:
            continue
        bend = left - 2.0 * here + right
        if bend != 0.0:
            s = (k + 0.5 * (left - right) / bend) * sixth
            if 0.0 < s < 1.0:
                e = _chord_error(frame, child, coef, ax, ay, az, dx, dy, dz, s)
                if abs(e) > abs(best):
                    best, where = e, s
    return best, where


@compiled
def _signature(frame, child, coef, ax, ay, bx, by, cx, cy):
    """1 or -1 where det H has one sign in the triangle as far as third derivatives tell, else 0."""
    third = 1.0 / 3.0
    mx, my = third * (ax + bx + cx), third * (ay + by + cy)
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(frame, child, coef, mx, my)
    det = hxx * hyy - hxy * hxy
    for k in range(3):
        dx, dy = ax - mx, ay - my
        if k == 1:
            dx, dy = bx - mx, by - my
        elif k == 2:
            dx, dy = cx - mx, cy - my
        pxx = hxx + t111 * dx + t112 * dy
        pxy = hxy + t112 * dx + t122 * dy
        pyy = hyy + t122 * dx + t222 * dy
        ratio = pxx * pyy - pxy * pxy
        if (det > 0.0 and ratio < 0.3 * det) or (det <= 0.0 and ratio > 0.3 * det):
            return 0
    return 1 if det > 0.0 else -1


@compiled
def inner_error(F, ax, ay, az, bx, by, bz, cx, cy, cz, stop):
    """Newton's method for grad f = slope of the triangle, from the centroid or the best of samples.

    Where det H < 0 the error has no interior extremum (it satisfies a maximum principle). Where the
    sign changes within the triangle, ten samples choose the start.
    """
    frame, child, coef = F.frame, F.child, F.coef
    third = 1.0 / 3.0
    x, y = third * (ax + bx + cx), third * (ay + by + cy)
    sign = _signature(frame, child, coef, ax, ay, bx, by, cx, cy)
    if sign < 0:
        return 0.0, x, y
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    area = ux * vy - uy * vx
    sx = (uz * vy - vz * uy) / area
    sy = (ux * vz - vx * uz) / area
    best, bestx, besty = 0.0, x, y
    if sign == 0:
        for i in range(1, 5):
            for j in range(1, 6 - i):
                px = ax + (i * ux + j * vx) / 6.0
                py = ay + (i * uy + j * vy) / 6.0
                e = _value(frame, child, coef, px, py) - (az + sx * (px - ax) + sy * (py - ay))
                if abs(e) > abs(best):
                    best, bestx, besty = e, px, py
        x, y = bestx, besty
    f, fx, fy, hxx, hxy, hyy = derivatives2(frame, child, coef, x, y)
    best = f - (az + sx * (x - ax) + sy * (y - ay))
    if abs(best) > stop:
        return best, bestx, besty
    for _ in range(4):
        det = hxx * hyy - hxy * hxy
        if det <= 0.0:
            break
        rx, ry = fx - sx, fy - sy
        stepx = (hyy * rx - hxy * ry) / det
        stepy = (hxx * ry - hxy * rx) / det
        nx, ny = x - stepx, y - stepy
        u = ((nx - ax) * vy - (ny - ay) * vx) / area
        v = (ux * (ny - ay) - uy * (nx - ax)) / area
        if u <= 0.0 or v <= 0.0 or u + v >= 1.0:
            break
        x, y = nx, ny
        gain = rx * stepx + ry * stepy
        f, fx, fy, hxx, hxy, hyy = derivatives2(frame, child, coef, x, y)
        e = f - (az + sx * (x - ax) + sy * (y - ay))
        if abs(e) > abs(best):
            best, bestx, besty = e, x, y
        if abs(gain) <= 2e-4 * abs(best):
            break
    return best, bestx, besty
