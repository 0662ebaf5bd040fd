"""From second derivatives to the local frame of the lattice.

Lengths are scaled so that the tolerance is 1: with ``G = H / (8 tol)`` an edge d has the error
``|d^T G d|`` (in units of tol), a convex triangle ``4 R^2`` with R its circumradius in y-space
(sec. 2 of the paper, H the full Hessian). A *frame* W is the inverse of dy/dx: its columns are the
steps in x that advance y1, y2 by one, so that ``W^T G W = diag(1, eps)``.

Near det H = 0 one eigenvalue says nothing. There the length of an edge is limited by the third
derivative instead: the error of a cubic on an edge of length s is ``|f'''| s^3 / (72 sqrt 3)``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.kernel import KernelField
from equimesh.fields.patch_kernels import derivatives2, derivatives3
from equimesh.fields.workers import in_ranges

__all__ = [
    "AREA_CONVEX",
    "AREA_SADDLE",
    "BOOST_PERIOD",
    "frame_at",
    "lattice_size",
    "lower_bound",
    "lower_bound_of",
    "total_curvature",
]

# Area per error of the optimal triangle (sec. 2, App. B) where f must be met at the vertices.
AREA_CONVEX = 3.0 * math.sqrt(3.0) / 4.0
AREA_SADDLE = math.sqrt(5.0)
# A boost by this much maps the lattice of V2 triangles onto itself: it multiplies by the unit
# (1 + sqrt 5) / 2 squared in the ring of integers of Q(sqrt 5), of which the lattice is an image.
BOOST_PERIOD = 2.0 * math.log((1.0 + math.sqrt(5.0)) / 2.0)

_CUBIC = 72.0 * math.sqrt(3.0)
_FINE = 24  # parts of a side where a metric that is limited near det H = 0 is integrated,
_BESIDE = 12  # and where the density of H itself is,
_BESIDE_SMALL = 4  # also in triangles that are as small as the others' parts
_LOOKS = 500  # places at which curvature is looked at
_SINGULAR = 1e-6  # det H, in units of the squared norm of H, below which curvature says nothing
_SIGN = 0.05  # of the range of det H in a triangle, that it must reach on both sides of zero


@compiled
def cubic_floor(l1, l2, vx, vy, t111, t112, t122, t222, eight_tol):
    """Eigenvalues of H that bound the error of the cubic part along each eigenvector too."""
    c1 = abs(t111 * vx**3 + 3 * t112 * vx * vx * vy + 3 * t122 * vx * vy * vy + t222 * vy**3)
    c2 = abs(-t111 * vy**3 + 3 * t112 * vy * vy * vx - 3 * t122 * vy * vx * vx + t222 * vx**3)
    tol = eight_tol / 8.0
    k1 = eight_tol * (c1 / (_CUBIC * tol)) ** (2.0 / 3.0)
    k2 = eight_tol * (c2 / (_CUBIC * tol)) ** (2.0 / 3.0)
    return k1, k2


@compiled
def frame_at(frame, child, coef, x, y, eight_tol, floor):
    """The eigenframe of the metric at a point.

    Returns ``(e1x, e1y, e2x, e2y, eps, pure)``: steps along the two eigenvectors that advance y by
    one, the signature, and whether H alone decided (True) or the cubic or size limit had a say.
    In the saddle case the first vector belongs to the positive eigenvalue of H. ``floor`` is the
    smallest eigenvalue of H / eight_tol allowed (a longest length).
    """
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(frame, child, coef, x, y)
    mean, half = 0.5 * (hxx + hyy), 0.5 * (hxx - hyy)
    radius = math.hypot(half, hxy)
    l1, l2 = mean + radius, mean - radius
    if radius > 0.0:
        # Eigenvector of l1, from the row without cancellation.
        if half >= 0.0:
            vx, vy = radius + half, hxy
        else:
            vx, vy = hxy, radius - half
        norm = math.hypot(vx, vy)
        vx, vy = vx / norm, vy / norm
    else:
        vx, vy = 1.0, 0.0
    eps = 1 if l1 * l2 > 0.0 else -1
    if eps > 0:
        l1, l2 = l1 / frame[3], l2 / frame[3]
    k1, k2 = cubic_floor(l1, l2, vx, vy, t111, t112, t122, t222, eight_tol)
    a1, a2 = abs(l1), abs(l2)
    pure = a1 > 1.5 * k1 and a2 > 1.5 * k2
    m1 = (a1**4 + k1**4) ** 0.25 / eight_tol if not pure else a1 / eight_tol
    m2 = (a2**4 + k2**4) ** 0.25 / eight_tol if not pure else a2 / eight_tol
    if m1 < floor or m2 < floor:
        pure = False
        m1, m2 = max(m1, floor), max(m2, floor)
    if frame.shape[0] > 5 and max(m1, m2) > frame[5] * min(m1, m2):
        pure = False
        m1, m2 = max(m1, m2 / frame[5]), max(m2, m1 / frame[5])
    s1, s2 = 1.0 / math.sqrt(m1), 1.0 / math.sqrt(m2)
    return s1 * vx, s1 * vy, -s2 * vy, s2 * vx, eps, pure


@compiled
def _constant(det, tol):
    """Optimal triangles per unit area over the root of |det(H / 2)|, by its sign."""
    return 1.0 / ((AREA_CONVEX if det > 0.0 else AREA_SADDLE) * tol)


def lower_bound_of(hessian: NDArray[np.float64], areas: NDArray[np.float64], tol: float) -> float:
    """N* = integral of sqrt|det(H/2)| / (C tol): the fewest triangles as tol -> 0.

    Parameters
    ----------
    hessian
        (n, 2, 2) at quadrature points.
    areas
        (n,) weights of the points.
    """
    det = 0.25 * (hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] ** 2)
    constant = np.where(det > 0.0, AREA_CONVEX, AREA_SADDLE)
    return float((np.sqrt(np.abs(det)) / constant * areas).sum() / tol)


@compiled
def _mean_beside(d0, d1, d2, tol):
    """Mean density of H over a triangle in which det(H / 2) is linear, of these values at corners,
    and changes its sign.

    It is twice the second divided difference of what has the density as second derivative, by the
    formula of Hermite and Genocchi.
    """
    low, high = min(d0, d1, d2), max(d0, d1, d2)
    middle = d0 + d1 + d2 - low - high
    below, above = _slope(low, middle, high - low, tol), _slope(middle, high, high - low, tol)
    return 2.0 * (above - below) / (high - low)


@compiled
def _slope(a, b, scale, tol):
    """Divided difference of 4/15 |d|^(5/2), times the constant for the sign of d, from a to b."""
    if b - a > 1e-6 * scale:
        upper = 4.0 / 15.0 * _constant(b, tol) * abs(b) ** 2.5
        return (upper - 4.0 / 15.0 * _constant(a, tol) * abs(a) ** 2.5) / (b - a)
    d = 0.5 * (a + b)
    return math.copysign(2.0 / 3.0 * _constant(d, tol) * abs(d) ** 1.5, d)


@compiled
def _det(frame, child, coef, x, y):
    """det(H / 2)."""
    _, _, _, hxx, hxy, hyy = derivatives2(frame, child, coef, x, y)
    return 0.25 * (hxx * hyy - hxy * hxy)


@compiled
def _crossed(frame, child, coef, ax, ay, ux, uy, vx, vy):
    """Whether det H changes its sign between corners, middles of edges and the centre."""
    signs = 0
    for i in range(7):
        p, q = 0.5 * (i % 3), 0.5 * (i // 3)
        if i == 5:
            p, q = 1.0 / 3.0, 1.0 / 3.0
        d = _det(frame, child, coef, ax + p * ux + q * vx, ay + p * uy + q * vy)
        signs |= 1 if d > 0.0 else 2
    return signs == 3


@compiled
def _of_part(frame, child, coef, x, y, ux, uy, vx, vy, tol):
    """Mean density of H over the triangle of x + u and x + v, and whether det H changes its sign.

    By the rule of second order; but where the density has a kink, as if det H were linear. Next to
    nothing on one side of zero is no sign: what decays is not linear.
    """
    s, l = 1.0 / 6.0, 2.0 / 3.0
    a = _det(frame, child, coef, x + s * (ux + vx), y + s * (uy + vy))
    b = _det(frame, child, coef, x + l * ux + s * vx, y + l * uy + s * vy)
    c = _det(frame, child, coef, x + s * ux + l * vx, y + s * uy + l * vy)
    mean = (a + b + c) / 3.0
    # At a corner a linear function is twice what it is there, less the mean.
    if 2.0 * min(a, b, c) < mean and 2.0 * max(a, b, c) > mean:
        d0 = _det(frame, child, coef, x, y)
        d1 = _det(frame, child, coef, x + ux, y + uy)
        d2 = _det(frame, child, coef, x + vx, y + vy)
        low, high = min(d0, d1, d2), max(d0, d1, d2)
        if min(-low, high) > _SIGN * (high - low):
            return _mean_beside(d0, d1, d2, tol), True
    total = 0.0
    for d in (a, b, c):
        total += _constant(d, tol) * math.sqrt(abs(d))
    return total / 3.0, False


@compiled
def _of_limited(frame, child, coef, x, y, ux, uy, vx, vy, tol, floor):
    """The same in the limited metric, by the rule alone."""
    total, signs = 0.0, 0.0
    for k in range(3):
        p, q = 4.0 if k == 1 else 1.0, 4.0 if k == 2 else 1.0
        px, py = x + (p * ux + q * vx) / 6.0, y + (p * uy + q * vy) / 6.0
        e1x, e1y, e2x, e2y, eps, _ = frame_at(frame, child, coef, px, py, 8.0 * tol, floor)
        constant = AREA_CONVEX if eps > 0 else AREA_SADDLE
        # dy/dx has the determinant 1 / det W, in units of 8 tol for H
        total += 4.0 / (constant * abs(e1x * e2y - e2x * e1y))
        signs += eps
    return total / 3.0, abs(signs) < 3.0


@compiled
def _summed(frame, child, coef, ax, ay, ux, uy, vx, vy, n, tol, floor):
    """Sum of the mean densities of n^2 parts of a triangle, and whether det H changes its sign."""
    total, mixed = 0.0, False
    for i in range(n):
        for j in range(n - i):
            for half in range(2):
                if half == 1 and i + j >= n - 1:
                    continue
                # the corner of this part, and the direction in which it lies
                u, v, side = (i + half) / n, (j + half) / n, (1.0 - 2.0 * half) / n
                x, y = ax + u * ux + v * vx, ay + u * uy + v * vy
                if floor > 0.0:
                    part, changes = _of_limited(
                        frame, child, coef, x, y, side * ux, side * uy, side * vx, side * vy, tol,
                        floor,
                    )  # fmt: skip
                else:
                    part, changes = _of_part(
                        frame, child, coef, x, y, side * ux, side * uy, side * vx, side * vy, tol
                    )
                total += part
                mixed = mixed or changes
    return total, mixed


@compiled
def _integrate(frame, child, coef, points, triangles, depth, tol, floor, first, last, out):
    """Lattice triangles over each of the triangles ``first`` ... ``last`` into ``out``.

    On 4^depth parts, and on more where det H changes its sign. Small triangles (``depth`` 0) tell
    that by the quadrature points themselves.
    """
    fine = _FINE if floor > 0.0 else _BESIDE if depth > 0 else _BESIDE_SMALL
    for t in range(first, last):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = points[a, 0], points[a, 1]
        ux, uy = points[b, 0] - ax, points[b, 1] - ay
        vx, vy = points[c, 0] - ax, points[c, 1] - ay
        n = 2**depth
        if depth > 0 and _crossed(frame, child, coef, ax, ay, ux, uy, vx, vy):
            n = max(n, fine)
        total, mixed = _summed(frame, child, coef, ax, ay, ux, uy, vx, vy, n, tol, floor)
        if depth == 0 and mixed:
            n = fine
            total, _ = _summed(frame, child, coef, ax, ay, ux, uy, vx, vy, n, tol, floor)
        out[t] = total * (ux * vy - uy * vx) / (2.0 * n * n)


def lower_bound(
    field: KernelField,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float,
) -> float:
    """N* of a function over a domain that ``triangles`` cover (local coordinates).

    Some 50,000 quadrature points lie in the domain, and more along lines where det H changes sign.
    """
    return _integrated(field, points, triangles, tol, 0.0, 5e4)


def lattice_size(
    field: KernelField,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float,
    floor: float,
) -> float:
    """About how many triangles a lattice in the limited metric of ``frame_at`` has."""
    return _integrated(field, points, triangles, tol, floor, 1e4)


@compiled
def _bent(frame, child, coef, x, y):
    """``|K| sqrt|det H| = |Gamma| / (4 |det H|^(3/2))``, Gamma of (10); 0 where H is singular."""
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(frame, child, coef, x, y)
    det = abs(hxx * hyy - hxy * hxy)
    if det <= _SINGULAR * (hxx * hxx + 2.0 * hxy * hxy + hyy * hyy):
        return 0.0
    gamma = (
        hxx * (t122 * t122 - t222 * t112)
        + hxy * (t111 * t222 - t112 * t122)
        + hyy * (t112 * t112 - t122 * t111)
    )
    return 0.25 * abs(gamma) / det**1.5


@compiled
def _sum_bent(frame, child, coef, points, triangles, n):
    """Integral of ``_bent`` by the centres of n^2 parts of each triangle."""
    total = 0.0
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        area = (ux * vy - uy * vx) / (2.0 * n * n)
        for i in range(n):
            for j in range(n - i):
                for half in range(1 if i + j == n - 1 else 2):
                    p, q = (i + (1 + half) / 3.0) / n, (j + (1 + half) / 3.0) / n
                    x, y = points[a, 0] + p * ux + q * vx, points[a, 1] + p * uy + q * vy
                    total += area * _bent(frame, child, coef, x, y)
    return total


def total_curvature(
    field: KernelField, points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> float:
    """About the integral of |K| over a domain that ``triangles`` cover (local coordinates).

    K is the Gauss curvature of the metric H: near 0 where that is flat, and a number that neither
    scale nor tolerance changes elsewhere, of 1 and more where no single lattice fits.
    """
    n = max(1, round(math.sqrt(_LOOKS / max(len(triangles), 1))))
    plane = np.ascontiguousarray(points[:, :2])
    return float(_sum_bent(field.frame, field.child, field.coef, plane, triangles, n))


def _integrated(
    field: KernelField,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float,
    floor: float,
    places: float,
) -> float:
    depth = max(0, round(0.5 * math.log2(places / max(3 * len(triangles), 1))))
    plane, parts = np.ascontiguousarray(points[:, :2]), np.zeros(len(triangles))

    def work(first: int, last: int) -> None:
        _integrate(
            field.frame, field.child, field.coef, plane, triangles, depth, tol, floor, first, last,
            parts,
        )  # fmt: skip

    in_ranges(work, len(triangles), 1)
    return float(parts.sum())
