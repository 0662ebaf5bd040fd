"""A metric as piecewise polynomials of its logarithm, for compiled kernels.

A quadtree over the domain's box in local coordinates. The exponential of any symmetric tensor is
positive definite, so the stand-in is a metric whatever the fit. A cell is accepted when the
stand-in agrees with the metric in every direction, or when it is small against a unit edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from equimesh.fields.reference import by_reference
from equimesh.frame import Frame
from equimesh.riemann.metric import Metric
from equimesh.riemann.tensors import checked, exponential, logarithm, packed, unpacked

__all__ = ["DEGREE", "MetricPatches", "fit_metric"]

Array = NDArray[np.float64]

DEGREE = 5
_NODES = np.cos(np.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
_TO_CHEBYSHEV = np.linalg.inv(chebyshev.chebvander(_NODES, DEGREE))
_TO_POWERS = np.array(
    [np.pad(chebyshev.cheb2poly([0.0] * k + [1.0]), (0, DEGREE - k)) for k in range(DEGREE + 1)]
).T
_TESTS = np.array([-0.99, -0.5, 0.13, 0.99])
_ACCURACY = 2e-3  # of squared lengths, in the worst direction
_SMALL = 0.3  # unit edges
_DEEPEST, _MOST = 20, 40_000


@by_reference
class MetricPatches(NamedTuple):
    """A quadtree of polynomials.

    ``frame`` (3,): left, bottom and side of the root's square. ``child`` (n, 4) int32: node, or
    -(leaf + 1), of the quadrants (left bottom, right bottom, left top, right top). ``coef``
    (leaves, 3, 6, 6): log M's xx, xy, yy as coefficients of s**i t**j.
    """

    frame: Array
    child: NDArray[np.int32]
    coef: Array


def fit_metric(metric: Metric, domain: shapely.Geometry, frame: Frame) -> MetricPatches:
    """Fit a metric over ``domain`` (local coordinates of ``frame``).

    Raises
    ------
    InputError
        The metric is not finite or not positive definite at a point of the domain.
    """
    xmin, ymin, xmax, ymax = shapely.bounds(domain)
    side = max(xmax - xmin, ymax - ymin) * (1.0 + 1e-9)
    origin = np.array([xmin, ymin])
    shapely.prepare(domain)
    child: list[list[int]] = [[0, 0, 0, 0]]
    coefs: list[Array] = [np.zeros((3, DEGREE + 1, DEGREE + 1))]  # for cells without domain
    parents, quadrants = np.zeros(4, np.int64), np.arange(4)
    corners = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]])
    offsets = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    for depth in range(1, _DEEPEST + 1):
        width = 0.5**depth
        low = origin + side * corners
        slack = 0.02 * width * side
        boxes = shapely.box(*(low - slack).T, *(low + side * width + slack).T)
        meets = shapely.intersects(domain, boxes)
        for cell in np.flatnonzero(~meets):
            child[parents[cell]][quadrants[cell]] = -1
        corners, parents, quadrants = corners[meets], parents[meets], quadrants[meets]
        fitted, flat, good = _fit_cells(metric, domain, frame, low[meets], side * width)
        if depth == _DEEPEST or len(coefs) + 4 * int((~good).sum()) > _MOST:
            fitted[~good] = flat[~good]  # without the overshoots of a high degree
            good[:] = True
        for cell in np.flatnonzero(good):
            child[parents[cell]][quadrants[cell]] = -(len(coefs) + 1)
            coefs.append(fitted[cell])
        split = np.flatnonzero(~good)
        if len(split) == 0:
            break
        first = len(child)
        for cell in split:
            child[parents[cell]][quadrants[cell]] = len(child)
            child.append([0, 0, 0, 0])
        parents = np.repeat(np.arange(first, len(child)), 4)
        quadrants = np.tile(np.arange(4), len(split))
        corners = (corners[split, None, :] + offsets * (0.5 * width)).reshape(-1, 2)
    return MetricPatches(
        np.array([*origin, side]), np.array(child, np.int32), np.ascontiguousarray(coefs)
    )


def _fit_cells(
    metric: Metric, domain: shapely.Geometry, frame: Frame, low: Array, width: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(k, 3, 6, 6) coefficients on square cells, the same of low degree, and which are accurate."""
    nodes = _log_on(metric, domain, frame, low, width, _NODES)
    cheb = np.einsum("ia,kabc,jb->kcij", _TO_CHEBYSHEV, nodes, _TO_CHEBYSHEV, optimize=True)
    tests = _log_on(metric, domain, frame, low, width, _TESTS)
    basis = chebyshev.chebvander(_TESTS, DEGREE)
    found = np.einsum("ai,kcij,bj->kabc", basis, cheb, basis, optimize=True)
    off = _distance(found.reshape(-1, 3), tests.reshape(-1, 3)).reshape(len(low), -1).max(1)
    finest = np.exp(0.5 * nodes[..., [0, 2]].max((1, 2, 3)))  # no eigenvalue of log M is far above
    good = (off <= _ACCURACY) | (width * finest < _SMALL)
    plain = cheb.copy()
    plain[:, :, 2:, :] = 0.0
    plain[:, :, :, 2:] = 0.0
    poor = good & (off > 0.2)
    cheb[poor] = plain[poor]

    def powers(c: Array) -> Array:
        return np.asarray(np.einsum("ia,kcab,jb->kcij", _TO_POWERS, c, _TO_POWERS, optimize=True))

    return powers(cheb), powers(plain), good


def _log_on(
    metric: Metric, domain: shapely.Geometry, frame: Frame, low: Array, width: float, at: Array
) -> Array:
    """(k, a, b, 3) logarithms of the local metric on a tensor grid of every cell.

    Beyond the domain, where the metric need not be defined, that of the nearest point of the domain
    stands in.
    """
    n = len(at)
    x = low[:, 0, None, None] + 0.5 * width * (1.0 + at[None, :, None]) + np.zeros((1, 1, n))
    y = low[:, 1, None, None] + 0.5 * width * (1.0 + at[None, None, :]) + np.zeros((1, n, 1))
    local = np.stack([x.ravel(), y.ravel()], 1)
    user = frame.to_user(local)
    assert callable(metric.tensor)
    with np.errstate(all="ignore"):
        m = np.array(np.broadcast_to(metric.tensor(*user.T), (len(user), 2, 2)), float)
        a, b, d = m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]
        usable = np.isfinite(m).all((1, 2)) & (a > 0.0) & (d > 0.0) & (a * d - b * b > 0.0)
    lost = np.flatnonzero(~usable)
    if len(lost):
        places = shapely.points(local[lost])
        near = shapely.get_coordinates(shapely.shortest_line(domain, places)).reshape(-1, 2, 2)
        inner = 1e-9 * np.asarray(shapely.centroid(domain).coords)[0] + (1.0 - 1e-9) * near[:, 0]
        m[lost] = metric(*frame.to_user(inner).T)
    m = checked(m, *user.T)
    local_logs = packed(logarithm(frame.matrix.T @ m @ frame.matrix))
    return np.asarray(local_logs.reshape(len(low), n, n, 3))


def _distance(log: Array, other: Array) -> Array:
    """(n,) largest |logarithm| of the ratio of squared lengths of two metrics, any direction."""
    m, o = exponential(unpacked(log)), exponential(unpacked(other))
    with np.errstate(all="ignore"):
        det = o[:, 0, 0] * o[:, 1, 1] - o[:, 0, 1] ** 2
        half = 0.5 * (
            m[:, 0, 0] * o[:, 1, 1] - 2.0 * m[:, 0, 1] * o[:, 0, 1] + m[:, 1, 1] * o[:, 0, 0]
        ) / det  # fmt: skip
        product = np.exp(log[:, 0] + log[:, 2] - other[:, 0] - other[:, 2])
        large = half + np.sqrt(np.maximum(half * half - product, 0.0))
        worst = np.maximum(np.log(large), np.log(large / product))
    return np.asarray(np.where(np.isfinite(worst), worst, np.inf))
