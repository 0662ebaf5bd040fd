"""Piecewise polynomials that stand in for a smooth function inside compiled kernels.

A quadtree over the domain's box; a cell is accepted when the trailing Chebyshev coefficients of f
on it are below a small share of the tolerance. Callables of any language feature thus become plain
arrays, with derivatives to the third order at hand, and the optimiser never calls back into Python.
The certificate of a mesh is always computed from f itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["DEGREE", "Patches", "fit_patches"]

Array = NDArray[np.float64]

DEGREE = 7
_NODES = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
_TO_CHEBYSHEV = np.linalg.inv(chebyshev.chebvander(_NODES, DEGREE))
_TO_POWERS = np.array(
    [np.pad(chebyshev.cheb2poly([0.0] * k + [1.0]), (0, DEGREE - k)) for k in range(DEGREE + 1)]
).T


@dataclass(frozen=True, eq=False)
class Patches:
    """A quadtree of polynomials.

    ``origin`` (2,), ``side``: the square that the root covers. ``child`` (n, 4) int32: node, or
    -(leaf + 1), of the quadrants (left bottom, right bottom, left top, right top). ``coef``
    (leaves, 8, 8): coefficients of s**i t**j. ``resolved``: every leaf met the tolerance.
    """

    origin: Array
    side: float
    child: NDArray[np.int32]
    coef: Array
    resolved: bool


def fit_patches(
    f: Callable[[Array, Array], Array],
    domain: shapely.Geometry,
    tol: float,
    *,
    max_depth: int = 13,
    max_leaves: int = 60_000,
) -> Patches:
    """Fit f over the domain (its coordinates) to within about ``tol``.

    Raises
    ------
    InputError
        f is not finite at a point of the domain.
    """
    xmin, ymin, xmax, ymax = shapely.bounds(domain)
    side = max(xmax - xmin, ymax - ymin) * (1.0 + 1e-12)
    origin = np.array([xmin, ymin])
    shapely.prepare(domain)
    child: list[list[int]] = [[0, 0, 0, 0]]
    coefs: list[Array] = []
    parents, quadrants = np.zeros(4, np.int64), np.arange(4)
    corners = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]])
    resolved, leaves = True, 0
    for depth in range(1, max_depth + 1):
        width = 0.5**depth
        fitted, good = _fit_cells(f, domain, origin + side * corners, side * width, tol)
        room = leaves + 4 * int((~good).sum()) <= max_leaves
        last = depth == max_depth or not room
        resolved &= bool(good.all()) or not last
        good |= last
        for cell in np.flatnonzero(good):
            child[parents[cell]][quadrants[cell]] = -(leaves + 1)
            coefs.append(fitted[cell])
            leaves += 1
        split = np.flatnonzero(~good)
        if len(split) == 0:
            break
        for cell in split:
            child[parents[cell]][quadrants[cell]] = len(child)
            child.append([0, 0, 0, 0])
        first = len(child) - len(split)
        parents = np.repeat(np.arange(first, len(child)), 4)
        quadrants = np.tile(np.arange(4), len(split))
        offsets = np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) * (0.5 * width)
        corners = (corners[split, None, :] + offsets).reshape(-1, 2)
    coef = np.ascontiguousarray(np.array(coefs))
    return Patches(origin, side, np.array(child, np.int32), coef, resolved)


def _fit_cells(
    f: Callable[[Array, Array], Array],
    domain: shapely.Geometry,
    corners: Array,
    width: float,
    tol: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """(k, 8, 8) power coefficients on k square cells, and which of them are accurate."""
    count, n = len(corners), DEGREE + 1
    coef, good = np.zeros((count, n, n)), np.ones(count, bool)
    slack = 0.05 * width
    low, high = corners - slack, corners + width + slack
    inside = shapely.intersects(domain, shapely.box(*low.T, *high.T))
    live = np.flatnonzero(inside)
    if len(live) == 0:
        return coef, good
    x = corners[live, 0, None, None] + 0.5 * width * (1.0 + _NODES[None, :, None])
    y = corners[live, 1, None, None] + 0.5 * width * (1.0 + _NODES[None, None, :])
    x, y = (np.ascontiguousarray(a) for a in np.broadcast_arrays(x, y))
    z = _sample(f, x, y)
    fitted = np.empty_like(z)
    bad = ~np.isfinite(z).all(axis=(1, 2))
    whole = np.flatnonzero(~bad)
    cheb = np.einsum("ia,kab,jb->kij", _TO_CHEBYSHEV, z[whole], _TO_CHEBYSHEV, optimize=True)
    tail = np.maximum(np.abs(cheb[:, -2:, :]).sum((1, 2)), np.abs(cheb[:, :, -2:]).sum((1, 2)))
    fitted[whole] = cheb
    accurate = np.zeros(len(live), bool)
    accurate[whole] = tail <= tol
    for cell in np.flatnonzero(bad):
        fitted[cell], accurate[cell] = _fit_partly(x[cell], y[cell], z[cell], domain, tol)
    coef[live] = np.einsum("ia,kab,jb->kij", _TO_POWERS, fitted, _TO_POWERS, optimize=True)
    good[live] = accurate
    return coef, good


def _sample(f: Callable[[Array, Array], Array], x: Array, y: Array) -> Array:
    with np.errstate(all="ignore"):
        return np.asarray(f(x.ravel(), y.ravel()), float).reshape(x.shape)


def _fit_partly(
    x: Array, y: Array, z: Array, domain: shapely.Geometry, tol: float
) -> tuple[Array, bool]:
    """Fit a cell that sticks out of the domain into where f is not defined."""
    finite = np.isfinite(z)
    lost = ~finite & shapely.contains_properly(domain, shapely.points(x, y))
    if lost.any():
        i = tuple(np.argwhere(lost)[0])
        raise InputError(
            f"The function is not finite at ({x[i]:.6g}, {y[i]:.6g}): "
            "choose a domain on which it is defined."
        )
    n = DEGREE + 1
    if finite.sum() < 12:
        level = z[finite].mean() if finite.any() else 0.0
        flat = np.zeros((n, n))
        flat[0, 0] = level
        return flat, not finite.any()
    basis = np.einsum("ia,jb->ijab", *(chebyshev.chebvander(_NODES, DEGREE),) * 2)
    rows = basis[finite].reshape(-1, n * n)
    order = np.add.outer(np.arange(n), np.arange(n)).ravel()
    weight = 0.3**order  # smoothest of the many polynomials through the samples that there are
    solution = np.linalg.lstsq(rows * weight, z[finite], rcond=1e-12)[0] * weight
    residual = np.abs(rows @ solution - z[finite]).max()
    cheb = solution.reshape(n, n)
    tail = max(np.abs(cheb[-2:, :]).sum(), np.abs(cheb[:, -2:]).sum())
    return cheb, bool(residual <= tol and tail <= tol)
