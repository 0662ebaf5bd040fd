"""Integrals over a domain of what the metric of a function says: N*, a lattice's size, curvature.

Triangles cover the domain, in local coordinates. The density of H has a kink where det H = 0; on
both sides of it det H itself is as good as linear, and so the density is integrated there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField
from equimesh.fields.patch_kernels import derivatives2, derivatives3
from equimesh.fields.workers import in_ranges
from equimesh.metric import AREA_CONVEX, AREA_SADDLE, frame_at, gamma

__all__ = ["lattice_size", "lower_bound", "lower_bound_of", "total_curvature"]

_PLACES_LIMITED = 1e4  # at which a lattice's size is found, at least,
_FINE = 24  # parts of a side where its metric is limited near det H = 0
_PLACES = 1e3  # at which N* is found at first: all that a mesh gets which has more than the next,
_MANY = 5e4  # but where det H changes its sign
_ACCURATE = 1e-3  # of a triangle's share, what halving its parts changes N* by in the end
_FINEST = 8  # parts of a side, at most,
_BESIDE, _BESIDE_MANY = 10, 4  # and where det H changes its sign, in few triangles and many
_LOOKS = 500  # places at which curvature is looked at
_SINGULAR = 1e-6  # det H, in units of the squared norm of H, below which curvature says nothing
_SIGN = 0.05  # of the range of det H in a triangle, that it must reach on both sides of zero
_RANGES = 8  # that threads share


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
def _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, n, tol, floor):
    """Mean density over a triangle by n^2 parts, and whether det H changes its sign in one.

    The density is that of H, or, with a ``floor``, of the limited metric.
    """
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
    return total / (n * n), mixed


@inlined
def _spanned(points, triangles, t):
    """A corner of triangle t and the two sides from there."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    ax, ay = points[a, 0], points[a, 1]
    return ax, ay, points[b, 0] - ax, points[b, 1] - ay, points[c, 0] - ax, points[c, 1] - ay


@compiled
def _integrate_bound(frame, child, coef, points, triangles, n, few, tol, first, last, out):
    """N* over each of the triangles ``first`` ... ``last`` into ``out``, where a share is.

    By n^2 parts; where they are ``few``, by more until that makes no difference. Where det H
    changes its sign that takes long: then by a fixed number.
    """
    for t in range(first, last):
        ax, ay, ux, uy, vx, vy = _spanned(points, triangles, t)
        area, share, parts = 0.5 * (ux * vy - uy * vx), out[t], n
        mixed = few and _crossed(frame, child, coef, ax, ay, ux, uy, vx, vy)
        if mixed:
            parts = max(n, _BESIDE)
        mean, changes = _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, parts, tol, 0.0)
        if changes and not few:
            parts = max(n, _BESIDE_MANY)
            mean, _ = _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, parts, tol, 0.0)
        more = few and not mixed
        while more and parts < _FINEST:
            parts, before = 2 * parts, mean
            mean, _ = _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, parts, tol, 0.0)
            more = abs(mean - before) * area > _ACCURATE * share
        out[t] = mean * area


@compiled
def _integrate_limited(frame, child, coef, points, triangles, n, tol, floor, first, last, out):
    """Lattice triangles over each of the triangles ``first`` ... ``last`` into ``out``.

    By n^2 parts, and by more where det H changes its sign.
    """
    for t in range(first, last):
        ax, ay, ux, uy, vx, vy = _spanned(points, triangles, t)
        parts = n
        if n > 1 and _crossed(frame, child, coef, ax, ay, ux, uy, vx, vy):
            parts = max(n, _FINE)
        mean, mixed = _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, parts, tol, floor)
        if n == 1 and mixed:
            mean, _ = _mean(frame, child, coef, ax, ay, ux, uy, vx, vy, _FINE, tol, floor)
        out[t] = mean * 0.5 * (ux * vy - uy * vx)


def lower_bound(
    field: KernelField,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float,
) -> float:
    """N* of a function over a domain that ``triangles`` cover, the better the more they show."""
    n = _parts_of_side(_PLACES, triangles)
    some = triangles[:: max(1, len(triangles) // int(_PLACES))]
    shares = np.full(len(some), np.inf)
    plane = np.ascontiguousarray(points[:, :2])
    given = field.frame, field.child, field.coef, plane
    _integrate_bound(*given, some, n, False, tol, 0, len(some), shares)  # roughly
    out = np.full(len(triangles), shares.mean())
    few = 3 * len(triangles) < _MANY

    def work(first: int, last: int) -> None:
        _integrate_bound(*given, triangles, n, few, tol, first, last, out)

    in_ranges(work, len(triangles), -(-len(triangles) // _RANGES))
    return float(out.sum())


def lattice_size(
    field: KernelField,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float,
    floor: float,
) -> float:
    """About how many triangles a lattice in the limited metric of ``frame_at`` has."""
    n = _parts_of_side(_PLACES_LIMITED, triangles)
    plane, out = np.ascontiguousarray(points[:, :2]), np.zeros(len(triangles))

    def work(first: int, last: int) -> None:
        _integrate_limited(
            field.frame, field.child, field.coef, plane, triangles, n, tol, floor, first, last, out
        )

    in_ranges(work, len(triangles), 1)
    return float(out.sum())


def _parts_of_side(places: float, triangles: NDArray[np.int64]) -> int:
    """Parts of a triangle's side so that all together have about so many ``places``."""
    return int(2 ** max(0, round(0.5 * math.log2(places / max(3 * len(triangles), 1)))))


@compiled
def _bent(frame, child, coef, x, y):
    """``|K| sqrt|det H| = |Gamma| / (4 |det H|^(3/2))``, Gamma of (10); 0 where H is singular."""
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(frame, child, coef, x, y)
    det = abs(hxx * hyy - hxy * hxy)
    if det <= _SINGULAR * (hxx * hxx + 2.0 * hxy * hxy + hyy * hyy):
        return 0.0
    return 0.25 * abs(gamma(hxx, hxy, hyy, t111, t112, t122, t222)) / det**1.5


@compiled
def _sum_bent(frame, child, coef, points, triangles, n):
    """Integral of ``_bent`` by the centres of n^2 parts of each triangle."""
    total = 0.0
    for t in range(triangles.shape[0]):
        ax, ay, ux, uy, vx, vy = _spanned(points, triangles, t)
        area = (ux * vy - uy * vx) / (2.0 * n * n)
        for i in range(n):
            for j in range(n - i):
                for half in range(1 if i + j == n - 1 else 2):
                    p, q = (i + (1 + half) / 3.0) / n, (j + (1 + half) / 3.0) / n
                    x, y = ax + p * ux + q * vx, ay + p * uy + q * vy
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
