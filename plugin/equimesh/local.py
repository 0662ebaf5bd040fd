"""The exact error of a quadratic on a triangle, and equidistribution in one dimension.

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 2,
equation (4) and Appendix A.

Scale. The quadratic is ``f = x^T H x + linear``, as in section 2; ``H`` is **half** the matrix of
second derivatives. :func:`quadratic_form` makes it from a Hessian. The error is that of the paper,
``E = (linear interpolant) - f``; it is positive where f is convex.

Triangles are ``(m, 3, 2)`` float, of either orientation; ``H`` is ``(2, 2)`` or ``(m, 2, 2)``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError

__all__ = [
    "area",
    "area_per_error",
    "centre",
    "edge_error",
    "equidistribute",
    "error_at_centre",
    "largest_error",
    "quadratic_form",
    "squared_lengths",
]

Array = NDArray[np.float64]

# A panel is settled when halving it changes its integral by less than this share of the whole.
_SETTLED = 1e-13
_MOST_HALVINGS = 40


def quadratic_form(hessian: ArrayLike) -> Array:
    """Section 2's ``H`` from the (..., 2, 2) matrix of second derivatives: the half of it."""
    return 0.5 * np.asarray(hessian, dtype=np.float64)


def area(triangles: ArrayLike) -> Array:
    """(m,) signed area, positive counter-clockwise."""
    t = np.asarray(triangles, dtype=np.float64)
    a, b = t[..., 1, :] - t[..., 0, :], t[..., 2, :] - t[..., 0, :]
    return np.asarray(0.5 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]))


def squared_lengths(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m, 3) values ``d^T H d`` of the edges: D12, D23, D31 of Appendix A (negative for some d)."""
    t = np.asarray(triangles, dtype=np.float64)
    d = np.roll(t, -1, axis=-2) - t
    h = np.asarray(form, dtype=np.float64)[..., None, :, :]
    return np.asarray(np.einsum("...i,...ij,...j->...", d, h, d))


def edge_error(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m, 3) errors at the middles of the edges, ``D / 4``: the largest along each edge."""
    return 0.25 * squared_lengths(triangles, form)


def centre(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m, 2) common centre of the error's level curves, Appendix A.

    Not finite where det H = 0 (no centre, or a line of them) or where the triangle has no area.
    """
    t = np.asarray(triangles, dtype=np.float64)
    h = np.asarray(form, dtype=np.float64)
    # Measured from the first vertex, so that coordinates far from zero lose no digits: there
    # E(x) = b.x - x^T H x vanishes at the two other vertices p and q.
    p, q = t[..., 1, :] - t[..., 0, :], t[..., 2, :] - t[..., 0, :]
    rp = np.einsum("...i,...ij,...j->...", p, h, p)
    rq = np.einsum("...i,...ij,...j->...", q, h, q)
    with np.errstate(divide="ignore", invalid="ignore"):
        twice = 2.0 * area(t)
        b1 = (rp * q[..., 1] - rq * p[..., 1]) / twice
        b2 = (rq * p[..., 0] - rp * q[..., 0]) / twice
        double = 2.0 * _determinant(h)
        x = (b1 * h[..., 1, 1] - b2 * h[..., 0, 1]) / double
        y = (b2 * h[..., 0, 0] - b1 * h[..., 0, 1]) / double
    return np.asarray(t[..., 0, :] + np.stack([x, y], axis=-1))


def error_at_centre(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m,) error at the centre, ``D12 D23 D31 / (16 A^2 det H)``, wherever the centre lies."""
    d = squared_lengths(triangles, form)
    a = area(triangles)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(d.prod(axis=-1) / (16.0 * a * a * _determinant(np.asarray(form))))


def largest_error(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m,) largest ``|E|`` over each closed triangle.

    The error has an extremum inside only where the form is definite and the centre lies inside;
    everywhere else it is attained at the middle of an edge.

    Examples
    --------
    >>> largest_error([[[0, 0], [2, 0], [0, 2]]], quadratic_form([[1, 0], [0, 1]]))
    array([1.])
    """
    d = squared_lengths(triangles, form)
    edges = 0.25 * np.abs(d).max(axis=-1)
    definite = _determinant(np.asarray(form, dtype=np.float64)) > 0.0
    # The centre is the circumcentre in the metric, inside exactly where no angle is obtuse: no
    # squared length exceeds the sum of the two others.
    size = np.abs(d)
    inside = definite & (2.0 * size.max(axis=-1) <= size.sum(axis=-1)) & (area(triangles) != 0.0)
    return np.where(inside, np.abs(error_at_centre(triangles, form)), edges)


def area_per_error(triangles: ArrayLike, form: ArrayLike) -> Array:
    """(m,) ``C = sqrt|det H| A / max|E|``: the area covered per unit of error, in y-space.

    At most ``sqrt(5)`` where det H < 0 and ``3 sqrt(3) / 4`` where det H > 0. Infinite for a
    triangle without error; not a number where the area is zero as well.
    """
    root = np.sqrt(np.abs(_determinant(np.asarray(form, dtype=np.float64))))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(root * np.abs(area(triangles)) / largest_error(triangles, form))


def _determinant(h: Array) -> Array:
    return np.asarray(h[..., 0, 0] * h[..., 1, 1] - h[..., 0, 1] * h[..., 1, 0])


def equidistribute(density: Callable[[Array], ArrayLike], a: float, b: float, n: int) -> Array:
    """(n + 1,) nodes from a to b between which ``density`` has equal integrals, equation (4).

    Parameters
    ----------
    density
        Vectorised, non-negative: ``sqrt(|f''| / 2)`` for interpolation of f, so that an interval
        of integral L has error ``L^2 / 4``. Kinks and zeros are allowed. A density that vanishes
        everywhere gives equal intervals.
    a, b
        The ends; a > b gives descending nodes.
    n
        Number of intervals, at least 1.

    Raises
    ------
    InputError
        Where the density is negative or not finite.
    """
    if n < 1:
        raise InputError(f"Cannot make {n} intervals: ask for at least one.")

    def rate(t: Array) -> Array:
        values = np.asarray(density(a + (b - a) * t), dtype=np.float64)
        values = np.broadcast_to(values, t.shape)
        if not np.isfinite(values).all() or values.min(initial=0.0) < 0.0:
            raise InputError(
                "The density to equidistribute is negative or not finite between "
                f"{a:g} and {b:g}: give a finite density that is nowhere below zero."
            )
        return values

    left, right, weight = _panels(rate)
    total = np.concatenate([[0.0], np.cumsum(weight)])
    if total[-1] == 0.0:
        return np.linspace(a, b, n + 1)
    wanted = total[-1] * np.arange(1, n) / n
    cell = np.searchsorted(total, wanted, side="right") - 1
    t = _solve_panels(rate, left[cell], right[cell], wanted - total[cell])
    return np.concatenate([[a], a + (b - a) * np.maximum.accumulate(t), [b]])


def _panels(rate: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Ends and integrals of panels of [0, 1] on which Gauss's rule is exact to rounding."""
    left = np.linspace(0.0, 1.0, 33)[:-1]
    right = left + 1.0 / 32.0
    weight = _gauss(rate, left, right)
    done: list[tuple[Array, Array, Array]] = []
    for _ in range(_MOST_HALVINGS):
        middle = 0.5 * (left + right)
        first, second = _gauss(rate, left, middle), _gauss(rate, middle, right)
        whole = weight.sum() + sum(float(w.sum()) for _, _, w in done)
        good = np.abs(first + second - weight) <= _SETTLED * whole
        for ends, part in (((left, middle), first), ((middle, right), second)):
            done.append((ends[0][good], ends[1][good], part[good]))
        bad = ~good
        if not bad.any():
            break
        left, right = (
            np.concatenate([left[bad], middle[bad]]),
            np.concatenate([middle[bad], right[bad]]),
        )
        weight = np.concatenate([first[bad], second[bad]])
    else:
        done.append((left, right, weight))
    starts, ends_, weights = (np.concatenate(column) for column in zip(*done, strict=True))
    order = np.argsort(starts, kind="stable")
    return starts[order], ends_[order], weights[order]


def _gauss(rate: Callable[[Array], Array], left: Array, right: Array) -> Array:
    """Integrals over (k,) intervals by ten-point Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(10)
    width = right - left
    t = left[:, None] + 0.5 * width[:, None] * (nodes + 1.0)
    return np.asarray(0.5 * width * (rate(t.ravel()).reshape(t.shape) @ weights))


def _solve_panels(
    rate: Callable[[Array], Array], left: Array, right: Array, wanted: Array
) -> Array:
    """Where the integral from ``left`` reaches ``wanted``: Newton's method kept in its bracket."""
    low, high, t = left.copy(), right.copy(), 0.5 * (left + right)
    for _ in range(60):
        excess = _gauss(rate, left, t) - wanted
        low, high = np.where(excess <= 0.0, t, low), np.where(excess >= 0.0, t, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = t - excess / rate(t)
        new = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
        if np.abs(new - t).max(initial=0.0) <= 4e-15:
            break
        t = new
    return np.asarray(t)
