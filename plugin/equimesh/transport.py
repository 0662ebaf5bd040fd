"""Parallel transport in the metric of a Hessian: equations (10) to (13) of the paper.

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 3.2 and
3.3. The metric is ``g = H``, the Hessian, and its derivatives are the third derivatives of f. With
``T(d)`` the matrix of ``d_i f_ijk``, the Christoffel symbols contracted with a step d are

    M(d) = g^-1 T(d) / 2,        M(d)[k, j] = {k; i j} d_i,

and (12) reads ``J' = J M(x')``, ``y' = J x'`` for the Jacobian J = dy/dx, whose rows are the pairs
(u1, u2) of y1 and of y2. It is linear, so a path acts on any starting values in the same way: as a
*propagator* ``(U, w)``,

    J_end = J_start U,        y_end = y_start + J_start w.
"""

from __future__ import annotations

from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = [
    "Array",
    "Derivatives",
    "carry",
    "christoffel",
    "compose",
    "curvature",
    "gamma",
    "gamma_error",
    "harmonic_christoffel",
    "invert",
    "third_tensor",
]

Array = NDArray[np.float64]

_STAGES = 6
# The carried metric may differ from the Hessian by this share of it; a smooth step reaches 1e-15.
_TOLERANCE = 1e-13
_COARSE = 1e-6
_MOST_HALVINGS = 20


class Derivatives(Protocol):
    """A function with the derivatives that transport needs."""

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives."""

    def third(self, x: Array, y: Array) -> Array:
        """(n, 4) third derivatives fxxx, fxxy, fxyy, fyyy."""


def third_tensor(third: Array) -> Array:
    """(n, 2, 2, 2) symmetric tensor ``f_ijk`` from its (n, 4) components."""
    count = np.add.outer(np.add.outer([0, 1], [0, 1]), [0, 1])
    return np.asarray(third[..., count])


def christoffel(hessian: Array, third: Array, step: Array) -> Array:
    """(n, 2, 2) matrices ``M(d)[k, j] = {k; i j} d_i`` of (12) for (n, 2) steps d."""
    change = np.einsum("nijk,ni->njk", third_tensor(third), step)
    return np.asarray(0.5 * _inverse(hessian) @ change)


def harmonic_christoffel(hessian: Array, third: Array, step: Array) -> Array:
    """(n, 2, 2) matrices of (13), the short form of (12) for a harmonic function."""
    g11, g12, g22 = hessian[:, 0, 0], hessian[:, 0, 1], hessian[:, 1, 1]
    g111, g112, g122, g222 = third.T
    four_g = 4.0 * (g11 * g22 - g12**2)
    alpha = (g111 * g22 + g11 * g122 - 2.0 * g12 * g112) / four_g
    beta = (g112 * g22 + g11 * g222 - 2.0 * g12 * g122) / four_g
    along = alpha * step[:, 0] + beta * step[:, 1]
    across = beta * step[:, 0] - alpha * step[:, 1]
    return np.stack([np.stack([along, across], 1), np.stack([-across, along], 1)], 1)


def gamma(hessian: Array, third: Array) -> Array:
    """(n,) Gamma of (10), which vanishes where a flat map exists."""
    return np.asarray(_gamma_factors(hessian, third).prod(axis=2) @ _GAMMA_SIGNS)


def curvature(hessian: Array, third: Array) -> tuple[Array, Array]:
    """(n,) Gauss curvature ``|Gamma| / (4 g^2)`` of the metric, and what rounding may fake of it.

    The second array is the same with every term of Gamma taken positive: a curvature far below it
    is cancellation.
    """
    terms = _gamma_factors(hessian, third).prod(axis=2)
    determinant = hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] ** 2
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = 0.25 / determinant**2
        return np.abs(terms @ _GAMMA_SIGNS) * scale, np.abs(terms).sum(axis=1) * scale


def gamma_error(hessian: Array, third: Array, share: float) -> Array:
    """(n,) by how much Gamma may be wrong where each derivative is wrong by a share of the largest
    one of its kind."""
    size = np.abs(_gamma_factors(hessian, third))
    largest = share * size.max(axis=0, initial=0.0)
    a, b, c = size.transpose(2, 0, 1)
    return np.asarray(
        (largest[:, 0] * b * c + a * largest[:, 1] * c + a * b * largest[:, 2]).sum(axis=1)
    )


_GAMMA_SIGNS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


def _gamma_factors(hessian: Array, third: Array) -> Array:
    """(n, 6, 3) the factors of the terms of (10), in the order in which they are printed."""
    g11, g12, g22 = hessian[:, 0, 0], hessian[:, 0, 1], hessian[:, 1, 1]
    g111, g112, g122, g222 = third.T
    terms = (
        (g11, g122, g122),
        (g11, g222, g112),
        (g12, g111, g222),
        (g12, g112, g122),
        (g22, g112, g112),
        (g22, g122, g111),
    )
    return np.stack([np.stack(term, axis=1) for term in terms], axis=1)


def carry(
    source: Derivatives, start: Array, end: Array, strict: bool = True
) -> tuple[Array, Array]:
    """Propagators along (n, 2) straight segments: U (n, 2, 2) and w (n, 2).

    Gauss-Legendre collocation of order 12, one step for each segment. Transport keeps lengths
    whatever the curvature, ``U^T g(start) U = g(end)``: a segment that fails this is halved.

    Raises
    ------
    InputError
        Where the derivatives are not finite or det H vanishes on the way. Unless ``strict``, such
        segments have NaN instead.
    """
    before, after = source.hessian(*start.T), source.hessian(*end.T)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        turn, shift = _carry(source, start, end, before, after, np.full(len(start), np.inf), 0)
    lost = ~np.isfinite(turn).all(axis=(1, 2))
    if strict and lost.any():
        x, y = start[np.argmax(lost)]
        raise InputError(
            f"The transform cannot be integrated near ({x:.6g}, {y:.6g}), where det H vanishes or "
            "the function is not smooth: choose a domain away from it."
        )
    return turn, shift


def compose(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
    """The propagator of one path after another."""
    (u, w), (v, z) = first, second
    return u @ v, w + np.einsum("nij,nj->ni", u, z)


def invert(propagator: tuple[Array, Array]) -> tuple[Array, Array]:
    """The propagator of the same path walked backwards."""
    back = _inverse(propagator[0])
    return back, -np.einsum("nij,nj->ni", back, propagator[1])


def _carry(
    source: Derivatives,
    start: Array,
    end: Array,
    before: Array,
    after: Array,
    parent: Array,
    depth: int,
) -> tuple[Array, Array]:
    """Propagators of segments whose Hessians at the ends, and defect as one step, are known."""
    settled = max(_TOLERANCE, 1e-4 * float(getattr(source, "accuracy", 0.0)))
    turn, shift = _step(source, start, end)
    carried = turn.transpose(0, 2, 1) @ before @ turn
    defect = np.abs(carried - after).max(axis=(1, 2)) / np.abs(after).max(axis=(1, 2))
    # Where halving stops to help it has met the rounding of the derivatives themselves.
    good = (defect <= settled) | ((defect <= _COARSE) & (defect > 0.1 * parent))
    if good.all():
        return turn, shift
    turn[~good] = np.nan
    bad = np.flatnonzero(~good & _regular(before) & _regular(after))
    if depth == _MOST_HALVINGS or not bad.size:
        return turn, shift
    middle = 0.5 * (start[bad] + end[bad])
    between = source.hessian(*middle.T)
    first = _carry(source, start[bad], middle, before[bad], between, defect[bad], depth + 1)
    # A path that is lost in its first half needs no second.
    on = np.isfinite(first[0]).all(axis=(1, 2))
    bad = bad[on]
    if bad.size:
        second = _carry(
            source, middle[on], end[bad], between[on], after[bad], defect[bad], depth + 1
        )
        turn[bad], shift[bad] = compose((first[0][on], first[1][on]), second)
    return turn, shift


def _step(source: Derivatives, start: Array, end: Array) -> tuple[Array, Array]:
    """One collocation step: the stages U_i solve ``U_i = I + sum_j a_ij U_j M_j``."""
    nodes, inner, weights = _gauss_method(_STAGES)
    n, step = len(start), end - start
    at = (start[:, None, :] + nodes[:, None] * step[:, None, :]).reshape(-1, 2)
    hessian = source.hessian(*at.T)
    rates = christoffel(hessian, source.third(at[:, 0], at[:, 1]), np.repeat(step, _STAGES, 0))
    rates = rates.reshape(n, _STAGES, 2, 2)
    identity = np.eye(2)
    # Transposed, so that the unknowns are the columns of one matrix: (I - a (x) M^T) V = (I, ...).
    matrix = np.eye(2 * _STAGES) - np.einsum("ij,njlk->nikjl", inner, rates).reshape(
        n, 2 * _STAGES, 2 * _STAGES
    )
    right = np.broadcast_to(np.tile(identity, (_STAGES, 1)), (n, 2 * _STAGES, 2))
    stages = np.linalg.solve(matrix, right).reshape(n, _STAGES, 2, 2).transpose(0, 1, 3, 2)
    turn = identity + np.einsum("j,njkl,njlm->nkm", weights, stages, rates)
    shift = np.einsum("j,njkl,nl->nk", weights, stages, step)
    return turn, shift


@cache
def _gauss_method(stages: int) -> tuple[Array, Array, Array]:
    """Nodes c, matrix a and weights b of Gauss-Legendre collocation on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(stages)
    c, b = 0.5 * (x + 1.0), 0.5 * w
    power = np.arange(stages)
    vandermonde = c[:, None] ** power
    integrals = c[:, None] ** (power + 1) / (power + 1)
    return c, integrals @ np.linalg.inv(vandermonde), b


def _regular(hessian: Array) -> NDArray[np.bool_]:
    determinant = hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] ** 2
    return np.asarray(np.isfinite(determinant) & (determinant != 0.0))


def _inverse(matrix: Array) -> Array:
    """(n, 2, 2) inverses, by the adjugate."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    adjugate = np.stack([np.stack([d, -b], 1), np.stack([-c, a], 1)], 1)
    return np.asarray(adjugate / (a * d - b * c)[:, None, None])
