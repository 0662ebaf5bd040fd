"""Second and third derivatives of a callable, by Chebyshev polynomials of high degree.

The domain's bounding box is halved until one polynomial fits each piece to rounding. Large pieces
of high degree lose fewer digits in third derivatives than any local difference can.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["Collocation"]

Array = NDArray[np.float64]

_DEGREE = 24
_ROUNDING = 2e-15  # of the largest coefficient: smaller ones at the tail are noise
_SETTLED = 1e-12
_MOST_HALVINGS = 12
_MARGIN = 1e-9


@dataclass(frozen=True, eq=False)
class _Piece:
    """A box (2,) low, (2,) high and the (d, d) coefficients of its polynomial."""

    low: Array
    high: Array
    coefficients: Array

    def derivatives(self, points: Array, order: int) -> Array:
        """(n, order + 1) derivatives of one order at (n, 2) points."""
        rate = 2.0 / (self.high - self.low)
        s = (points - self.low) * rate - 1.0
        out = np.empty((len(points), order + 1))
        for k in range(order + 1):
            c = self.coefficients
            for axis, times in ((0, order - k), (1, k)):
                if times:
                    c = chebyshev.chebder(c, times, scl=rate[axis], axis=axis)
            vx = chebyshev.chebvander(s[:, 0], c.shape[0] - 1)
            vy = chebyshev.chebvander(s[:, 1], c.shape[1] - 1)
            out[:, k] = ((vx @ c) * vy).sum(axis=1)
        return out


@dataclass(frozen=True, eq=False)
class Collocation:
    """A callable with ``value`` as it is and derivatives of the polynomials that stand for it.

    Parameters
    ----------
    value
        The function itself.
    pieces
        Polynomials on boxes that cover the domain.
    accuracy
        To what share third derivatives can be trusted.
    """

    value: Callable[[Array, Array], Array]
    pieces: tuple[_Piece, ...]
    accuracy: float = 1e-5

    @classmethod
    def of(cls, value: Callable[[Array, Array], Array], domain: shapely.Geometry) -> Collocation:
        """Fit a function on the boxes that meet a domain.

        Raises
        ------
        InputError
            Where it is not finite or not smooth on such a box.
        """
        xmin, ymin, xmax, ymax = shapely.bounds(domain)
        boxes = [(np.array([xmin, ymin]), np.array([xmax, ymax]), 0)]
        pieces: list[_Piece] = []
        while boxes:
            low, high, depth = boxes.pop()
            if not shapely.intersects(domain, shapely.box(*low, *high)):
                continue
            coefficients, axis = _fit(value, low, high)
            if axis is None:
                pieces.append(_Piece(low, high, coefficients))
                continue
            if depth == _MOST_HALVINGS:
                x, y = 0.5 * (low + high)
                raise InputError(
                    f"The function is not smooth, or not defined, near ({x:.6g}, {y:.6g}): "
                    "choose a domain where it has three derivatives."
                )
            middle, below, above = 0.5 * (low + high)[axis], high.copy(), low.copy()
            below[axis] = above[axis] = middle
            boxes += [(low, below, depth + 1), (above, high, depth + 1)]
        return cls(value, tuple(pieces))

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives; NaN outside the boxes."""
        h = self._derivatives(x, y, 2)
        return np.stack([h[:, [0, 1]], h[:, [1, 2]]], axis=1)

    def third(self, x: Array, y: Array) -> Array:
        """(n, 4) third derivatives; NaN outside the boxes."""
        return self._derivatives(x, y, 3)

    def _derivatives(self, x: Array, y: Array, order: int) -> Array:
        points = np.stack([np.asarray(x, float).ravel(), np.asarray(y, float).ravel()], axis=1)
        out = np.full((len(points), order + 1), np.nan)
        open_ = np.ones(len(points), dtype=np.bool_)
        for piece in self.pieces:
            reach = _MARGIN * (piece.high - piece.low)
            here = open_ & ((points >= piece.low - reach) & (points <= piece.high + reach)).all(1)
            out[here] = piece.derivatives(points[here], order)
            open_ &= ~here
        return out


def _fit(
    value: Callable[[Array, Array], Array], low: Array, high: Array
) -> tuple[Array, int | None]:
    """Coefficients cut off at rounding, and the axis to halve (None: they are all there)."""
    nodes = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, _DEGREE))
    at = low + 0.5 * (nodes[:, None] + 1.0) * (high - low)
    x, y = np.meshgrid(at[:, 0], at[:, 1], indexing="ij")
    z = np.asarray(value(x.ravel(), y.ravel()), float).reshape(x.shape)
    if not np.isfinite(z).all():
        return z, int(np.argmax(high - low))
    coefficients = inverse @ z @ inverse.T
    size = np.abs(coefficients)
    largest = float(size.max())
    sides = size.max(axis=1), size.max(axis=0)
    tails = [float(side[-3:].max()) for side in sides]
    if max(tails) > _SETTLED * largest:
        return coefficients, int(np.argmax(tails))
    cut = [int(np.flatnonzero(side > _ROUNDING * largest).max(initial=0)) + 1 for side in sides]
    return coefficients[: cut[0], : cut[1]], None
