"""Derivatives of a callable by high-order differences.

Around each point f is interpolated on a 11 x 11 grid of Chebyshev nodes and the polynomial is
differentiated. The stencil's half width is a fixed share of the domain's extent; near the edge of
the domain's box the stencil is shifted inwards, so f is never asked outside it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

__all__ = ["stencil_derivatives"]

Array = NDArray[np.float64]

_DEGREE = 10
_NODES = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
_FIT = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
_HALF_WIDTH = 0.02  # of the box; truncation and rounding of third derivatives balance near here
_CHUNK = 4096


def stencil_derivatives(
    f: Callable[[Array, Array], Array],
    x: Array,
    y: Array,
    box: tuple[float, float, float, float] | None,
    order: int,
) -> Array:
    """(n, order + 1) derivatives d^order f / dx^(order - k) dy^k, k = 0 ... order.

    ``box`` is (xmin, ymin, xmax, ymax); without it each point's own size serves as the extent.
    """
    x, y = np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float))
    out = np.empty((len(x), order + 1))
    for first in range(0, len(x), _CHUNK):
        part = slice(first, first + _CHUNK)
        out[part] = _chunk(f, x[part], y[part], box, order)
    return out


def _chunk(
    f: Callable[[Array, Array], Array],
    x: Array,
    y: Array,
    box: tuple[float, float, float, float] | None,
    order: int,
) -> Array:
    if box is None:
        width_x = _HALF_WIDTH * np.maximum(1.0, np.abs(x))
        width_y = _HALF_WIDTH * np.maximum(1.0, np.abs(y))
        cx, cy = x, y
    else:
        width_x = np.full(len(x), _HALF_WIDTH * (box[2] - box[0]))
        width_y = np.full(len(y), _HALF_WIDTH * (box[3] - box[1]))
        cx = np.clip(x, box[0] + width_x, box[2] - width_x)
        cy = np.clip(y, box[1] + width_y, box[3] - width_y)
    px = np.broadcast_to((cx[:, None] + width_x[:, None] * _NODES)[:, :, None], (len(x), 11, 11))
    py = np.broadcast_to((cy[:, None] + width_y[:, None] * _NODES)[:, None, :], (len(x), 11, 11))
    z = f(px.ravel(), py.ravel()).reshape(px.shape)
    coefficients = np.einsum("ia,nab,jb->nij", _FIT, z, _FIT, optimize=True)
    s, t = (x - cx) / width_x, (y - cy) / width_y
    out = np.empty((len(x), order + 1))
    for k in range(order + 1):
        along_x = _derived(s, order - k) / width_x[:, None] ** (order - k)
        along_y = _derived(t, k) / width_y[:, None] ** k
        out[:, k] = np.einsum("ni,nij,nj->n", along_x, coefficients, along_y, optimize=True)
    return out


def _derived(s: Array, order: int) -> Array:
    """(n, 11) derivatives of the Chebyshev polynomials at s."""
    if order == 0:
        return np.asarray(chebyshev.chebvander(s, _DEGREE))
    table = chebyshev.chebder(np.eye(_DEGREE + 1), order)
    return np.asarray(chebyshev.chebvander(s, _DEGREE - order) @ table)
