"""Boundary nodes at equal distances in the metric.

The metric is asked for along each side alone, so two domains that share a side get the same nodes
on it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.boundary import BoundaryNodes
from equimesh.domain import Sides
from equimesh.errors import InputError
from equimesh.riemann.metric import Metric

__all__ = ["boundary_nodes", "equidistant"]

Array = NDArray[np.float64]

_GAUSS, _WEIGHT = np.polynomial.legendre.leggauss(4)
_FINE = 0.05  # unit edges: within such a piece the speed is constant
_ACCURACY = 1e-6
_MOST = 2_000_000


def equidistant(metric: Metric, a: Array, b: Array) -> Array:
    """(k,) parameters in (0, 1) that cut the segment from a to b into edges of equal length.

    Their length is as near to one as a whole number of edges allows.
    """
    ends = np.linspace(0.0, 1.0, 33)
    lengths = _lengths(metric, a, b, ends)
    while True:
        middle = 0.5 * (ends[1:] + ends[:-1])
        fine = np.empty(2 * len(ends) - 1)
        fine[::2], fine[1::2] = ends, middle
        parts = _lengths(metric, a, b, fine)
        together = parts[::2] + parts[1::2]
        off = np.abs(together - lengths) > _ACCURACY * max(together.sum(), 1.0)
        coarse = off | (together > _FINE)
        width = ends[1:] - ends[:-1]
        coarse &= width > 1e-14
        if not coarse.any():
            ends, lengths = fine, parts
            break
        if len(ends) > _MOST:
            raise InputError(
                "The metric asks for more than 100,000 edges on one side of the domain: scale it."
            )
        keep = np.ones(len(fine), bool)
        keep[1::2] = coarse
        ends = fine[keep]
        first = np.cumsum(np.append(0, 1 + coarse))[:-1]
        lengths = np.empty(len(ends) - 1)
        lengths[first] = np.where(coarse, parts[::2], together)
        lengths[first[coarse] + 1] = parts[1::2][coarse]
    reached = np.append(0.0, np.cumsum(lengths))
    count = max(1, round(float(reached[-1])))
    return np.asarray(np.interp(np.arange(1, count) * (reached[-1] / count), reached, ends))


def _lengths(metric: Metric, a: Array, b: Array, ends: Array) -> Array:
    """(k - 1,) metric lengths of the pieces between parameters ``ends`` (k,)."""
    width = ends[1:] - ends[:-1]
    s = ends[:-1, None] + width[:, None] * (0.5 * (1.0 + _GAUSS))
    d = b - a
    m = metric(*(a[:, None] + d[:, None] * s.ravel()))
    speed = np.sqrt(np.einsum("i,nij,j->n", d, m, d)).reshape(s.shape)
    return np.asarray(width * (speed @ (0.5 * _WEIGHT)))


def boundary_nodes(metric: Metric, sides: Sides) -> BoundaryNodes:
    """Nodes of all sides in the user's coordinates."""
    points, side, corner = [], [], []
    start = np.zeros(len(sides.corners), np.int64)
    count = 0
    for i, a in enumerate(sides.corners):
        b = sides.corners[sides.following[i]]
        flip = tuple(a) > tuple(b)  # both owners of a shared side walk it the same way
        p, q = (b, a) if flip else (a, b)
        inner = p + equidistant(metric, p, q)[:, None] * (q - p)
        inner = inner[::-1] if flip else inner
        start[i] = count
        n = len(inner) + 1
        points.append(np.vstack([a[None], inner]))
        side.append(np.full(n, i))
        corner.append(np.arange(n) == 0)
        count += n
    following = np.arange(1, count + 1)
    last = np.append(start[1:], count) - 1
    following[last] = start[sides.following]
    return BoundaryNodes(
        np.concatenate(points), np.concatenate(side), np.concatenate(corner), following
    )
