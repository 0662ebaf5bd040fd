"""Piecewise polynomials that stand in for a smooth function inside compiled kernels.

A quadtree over the domain's box; a cell is accepted when the trailing Chebyshev coefficients of f
on it are below a small share of the tolerance. Callables of any language feature thus become plain
arrays, with derivatives to the third order at hand, and the optimiser never calls back into Python.
The certificate of a mesh is always computed from f itself.

Where f has a kink no polynomial is accurate, and second derivatives of one that is just good enough
say nothing. Coefficients of a smooth function fall by a power of two for every degree when a cell
is halved; across a kink the last ones only halve. The leaves where they do so are known as such.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

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
# A kink leaves a 16th of the last coefficients when a cell is halved so often, or little less; of a
# smooth function's hardly a millionth is left,
_SIZES, _SLOW = 4, 128.0
# and the last two degrees as large as this beside the two before, where they are more than nothing
# in units of the tolerance.
_WAVY, _NOTHING = 0.25, 1e-4
_JUMP = 1e3  # units of the tolerance: what is left of a jump, however small the cell
_QUADRANTS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
_TO_POWERS = np.array(
    [np.pad(chebyshev.cheb2poly([0.0] * k + [1.0]), (0, DEGREE - k)) for k in range(DEGREE + 1)]
).T


@dataclass(frozen=True, eq=False)
class Patches:
    """A quadtree of polynomials.

    ``origin`` (2,), ``side``: the square that the root covers. ``child`` (n, 4) int32: node, or
    -(leaf + 1), of the quadrants (left bottom, right bottom, left top, right top). ``coef``
    (leaves, 8, 8): coefficients of s**i t**j. ``smooth``: so many leaves have no kink; they come
    first. ``kinks`` (n,) uint8: sum of 2**quadrant over the quadrants of a node with a kink.
    """

    origin: Array
    side: float
    child: NDArray[np.int32]
    coef: Array
    smooth: int
    kinks: NDArray[np.uint8]

    @property
    def frame(self) -> Array:
        """(5,) the scalars that kernels ask for, see ``KernelField``."""
        return np.array([*self.origin, self.side, 1.0, self.smooth])


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
    # Level by level: nodes, and the leaves that end there.
    levels: list[NDArray[np.int64]] = [np.zeros((1, 4), np.int64)]
    coefs: list[Array] = []
    kinked: list[NDArray[np.bool_]] = []
    nodes, leaves = 1, 0
    corners = 0.5 * _QUADRANTS
    tails = np.full((_SIZES, 4), np.inf)  # of the larger cells around each, the largest first
    for depth in range(1, max_depth + 1):
        width = 0.5**depth
        cells = _fit_cells(f, domain, origin + side * corners, side * width, tol)
        room = leaves + 4 * int((~cells.good).sum()) <= max_leaves
        last = depth == max_depth or not room
        ends = cells.good | last
        # What a kink leaves in a cell that it hardly enters is less than in its neighbours.
        usual = np.maximum(tol, 0.25 * tails[-1]) if last else tol
        slow = (tails[0] < _SLOW * np.maximum(cells.tail, usual)) & (cells.tail < _JUMP * tol)
        kinked.append((cells.wavy & slow)[ends])
        coefs.append(cells.coef[ends])
        split = np.flatnonzero(~ends)
        below = levels[-1].reshape(-1)  # a view: what the last level's nodes lead to
        below[ends] = -(leaves + 1 + np.arange(len(coefs[-1])))
        below[split] = nodes + np.arange(len(split))
        leaves += len(coefs[-1])
        if len(split) == 0:
            break
        levels.append(np.zeros((len(split), 4), np.int64))
        nodes += len(split)
        corners = (corners[split, None, :] + 0.5 * width * _QUADRANTS).reshape(-1, 2)
        tails = np.repeat(np.vstack([tails[1:], cells.tail])[:, split], 4, axis=1)
    return _kinks_last(origin, side, levels, np.concatenate(coefs), np.concatenate(kinked))


def _kinks_last(
    origin: Array,
    side: float,
    levels: list[NDArray[np.int64]],
    coef: Array,
    kinked: NDArray[np.bool_],
) -> Patches:
    """The quadtree with the leaves that have a kink at the end, which the nodes above them know."""
    order = np.argsort(kinked, kind="stable")
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    child = np.concatenate(levels)
    leaf = child < 0
    has = np.zeros(child.shape, bool)
    has[leaf] = kinked[-child[leaf] - 1]
    child[leaf] = -(place[-child[leaf] - 1] + 1)
    if kinked.any():
        last = len(child)
        for level in reversed(levels):
            here = slice(last - len(level), last)
            inner = child[here] > 0
            has[here][inner] = has[child[here][inner]].any(1)
            last -= len(level)
    return Patches(
        origin,
        side,
        child.astype(np.int32),
        np.ascontiguousarray(coef[order]),
        int((~kinked).sum()),
        (has @ np.array([1, 2, 4, 8])).astype(np.uint8),
    )


class _Cells(NamedTuple):
    """Polynomials of k cells: (k, 8, 8) coefficients, and (k,) each of the rest.

    ``good``: accurate; ``tail``: how large the last Chebyshev coefficients are; ``wavy``: not
    small beside those before them, and of a size that matters.
    """

    coef: Array
    good: NDArray[np.bool_]
    tail: Array
    wavy: NDArray[np.bool_]


def _fit_cells(
    f: Callable[[Array, Array], Array],
    domain: shapely.Geometry,
    corners: Array,
    width: float,
    tol: float,
) -> _Cells:
    """Polynomials in powers of s and t on k square cells."""
    count, n = len(corners), DEGREE + 1
    cells = _Cells(
        np.zeros((count, n, n)), np.ones(count, bool), np.zeros(count), np.zeros(count, bool)
    )
    slack = 0.05 * width
    low, high = corners - slack, corners + width + slack
    inside = shapely.intersects(domain, shapely.box(*low.T, *high.T))
    live = np.flatnonzero(inside)
    if len(live) == 0:
        return cells
    x = corners[live, 0, None, None] + 0.5 * width * (1.0 + _NODES[None, :, None])
    y = corners[live, 1, None, None] + 0.5 * width * (1.0 + _NODES[None, None, :])
    x, y = (np.ascontiguousarray(a) for a in np.broadcast_arrays(x, y))
    z = _sample(f, x, y)
    fitted = np.empty_like(z)
    bad = ~np.isfinite(z).all(axis=(1, 2))
    whole = np.flatnonzero(~bad)
    cheb = _TO_CHEBYSHEV @ z[whole] @ _TO_CHEBYSHEV.T
    size = np.abs(cheb)
    along = np.array([size[:, -2:, :].sum((1, 2)), size[:, :, -2:].sum((1, 2))])
    before = np.array([size[:, -4:-2, :].sum((1, 2)), size[:, :, -4:-2].sum((1, 2))])
    tail = along.max(0)
    fitted[whole] = cheb
    accurate = np.zeros(len(live), bool)
    accurate[whole] = tail <= tol
    cells.tail[live[whole]] = tail
    cells.wavy[live[whole]] = ((along > _WAVY * before) & (along > _NOTHING * tol)).any(0)
    for cell in np.flatnonzero(bad):
        fitted[cell], accurate[cell] = _fit_partly(x[cell], y[cell], z[cell], domain, tol)
    cells.coef[live] = _TO_POWERS @ fitted @ _TO_POWERS.T
    cells.good[live] = accurate
    return cells


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
