"""Errors of triangles under a smooth function: samples, a quadratic model between, a bound on it.

The error is sampled on a grid of 8 subdivisions. On each of the 16 small triangles with their edge
midpoints it is interpolated by a quadratic, whose maximum is exact; what the quadratic misses is
bounded through third differences on the same grid. Where that remainder matters the triangle is cut
in four and sampled again, so the bound tightens as far as it has to.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating
from equimesh.fields.workers import in_ranges

__all__ = ["sampled_errors"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_N = 8
_CHUNK = 512  # triangles whose samples, and what f makes of them, stay in a core's cache
# Largest error of quadratic interpolation of a cubic on a triangle in units of its largest third
# difference along and across the grid (0.2561, by linear programming over all cubics), and a
# margin.
_REMAINDER = 0.3
# Remainder that is let be, as a share of the largest error; the second where a limit is to be kept.
_TIGHT, _TIGHT_ENOUGH = 0.001, 0.012
_DEPTH = 4
# Across a kink the remainder only halves with the samples' distance: where that leaves open whether
# a limit is kept, and pieces of triangles are few, they may be finer.
_DEEPEST, _PIECES = 8, 4
_ROUNDS = 3 * _DEPTH  # the largest error falls on the way, and others come into question


def _grid(n: int) -> tuple[Array, IntArray]:
    """Barycentric weights (k, 2) of vertices b and c, and their (n + 1, n + 1) numbering."""
    weights: list[tuple[float, float]] = []
    index = np.full((n + 1, n + 1), -1)
    for i in range(n + 1):
        for j in range(n + 1 - i):
            index[i, j] = len(weights)
            weights.append((i / n, j / n))
    return np.array(weights), index


_WEIGHTS, _INDEX = _grid(_N)


def sampled_errors(
    f: Callable[[Array, Array], Array], points: Array, triangles: IntArray, limit: float = np.inf
) -> tuple[Array, Array]:
    """(m,) largest |f - linear| of each triangle and (m,) bounds.

    ``points`` (n, 3) with the heights of the linear interpolant. Bounds are tightened near the
    largest error and where they leave open whether the error exceeds ``limit``. f must be smooth at
    the scale of an eighth of a triangle for the bound to hold; features finer than that between
    samples are not seen.
    """
    corners = points[triangles]
    owner, depth = np.arange(len(triangles)), np.zeros(len(triangles), np.int64)
    fine, fine_bound = _sample_all(f, corners)
    tight = _TIGHT if np.isinf(limit) else _TIGHT_ENOUGH
    for _ in range(_ROUNDS):
        largest = fine.max(initial=0.0)
        loose = (fine_bound - fine > tight * largest) & (fine_bound > 0.98 * largest)
        # The model may be off either way by as much as its remainder.
        open_case = (fine_bound > limit) & (2.0 * fine - fine_bound <= limit)
        todo = (loose | open_case) & (depth < _DEPTH)
        deeper = open_case & (depth >= _DEPTH) & (depth < _DEEPEST)
        if limit > 0.0 and deeper.sum() < _PIECES * len(triangles):
            todo |= deeper
        if not todo.any():
            break
        # What a coarser model said is replaced: the pieces know better.
        pieces = _quarters(corners[todo])
        errors, bounds = _sample_all(f, pieces)
        corners = np.concatenate([corners[~todo], pieces])
        fine = np.concatenate([fine[~todo], errors])
        fine_bound = np.concatenate([fine_bound[~todo], bounds])
        owner = np.concatenate([owner[~todo], np.repeat(owner[todo], 4)])
        depth = np.concatenate([depth[~todo], np.repeat(depth[todo] + 1, 4)])
    errors, bounds = np.zeros(len(triangles)), np.zeros(len(triangles))
    np.maximum.at(errors, owner, fine)
    np.maximum.at(bounds, owner, fine_bound)
    return errors, bounds


def _quarters(corners: Array) -> Array:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
    pieces = [np.stack(p, 1) for p in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))]
    return np.stack(pieces, 1).reshape(-1, 3, 3)


def _sample_all(f: Callable[[Array, Array], Array], corners: Array) -> tuple[Array, Array]:
    errors, bounds = np.empty(len(corners)), np.empty(len(corners))

    def work(first: int, last: int) -> None:
        for start in range(first * _CHUNK, last * _CHUNK, _CHUNK):
            part = slice(start, start + _CHUNK)
            x, y, linear = _samples(corners[part], _WEIGHTS)
            z = f(x.ravel(), y.ravel()).reshape(x.shape)
            _model(z - linear, _INDEX, _REMAINDER, errors[part], bounds[part])

    in_ranges(work, -(-len(corners) // _CHUNK), 1)
    return errors, bounds


@allocating
def _samples(corners: Array, weights: Array) -> tuple[Array, Array, Array]:
    """x, y and the linear interpolant's height, each (m, k), at the weights (k, 2) of b and c."""
    shape = (corners.shape[0], weights.shape[0])
    x, y, z = np.empty(shape), np.empty(shape), np.empty(shape)
    for t in range(shape[0]):
        a, b, c = corners[t, 0], corners[t, 1], corners[t, 2]
        for k in range(shape[1]):
            u, v = weights[k]
            x[t, k] = a[0] + u * (b[0] - a[0]) + v * (c[0] - a[0])
            y[t, k] = a[1] + u * (b[1] - a[1]) + v * (c[1] - a[1])
            z[t, k] = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
    return x, y, z


@allocating
def _edge_peak(a: float, m: float, b: float) -> float:
    """Largest |q| of the parabola through a, m (middle), b on its segment."""
    top = max(abs(a), abs(m), abs(b))
    bend = a - 2.0 * m + b
    if bend != 0.0:
        s = 0.5 * (a - b) / bend  # in units of half the segment
        if -1.0 < s < 1.0:
            top = max(top, abs(m - 0.125 * (a - b) ** 2 / bend))
    return float(top)


@allocating
def _triangle_peak(a: float, b: float, c: float, ab: float, bc: float, ca: float) -> float:
    """Largest |q| of the quadratic through three corners and three edge midpoints."""
    top = max(_edge_peak(a, ab, b), _edge_peak(b, bc, c), _edge_peak(c, ca, a))
    # q = a + gu u + gv v + huu u^2 + huv u v + hvv v^2 in barycentric u (of b), v (of c)
    gu, gv = 4.0 * ab - 3.0 * a - b, 4.0 * ca - 3.0 * a - c
    huu, hvv = 2.0 * (a + b) - 4.0 * ab, 2.0 * (a + c) - 4.0 * ca
    huv = 4.0 * (a + bc - ab - ca)
    det = 4.0 * huu * hvv - huv * huv
    if det > 0.0:
        u = (huv * gv - 2.0 * hvv * gu) / det
        v = (huv * gu - 2.0 * huu * gv) / det
        if u > 0.0 and v > 0.0 and u + v < 1.0:
            top = max(top, abs(a + 0.5 * (gu * u + gv * v)))
    return float(top)


@allocating
def _model(samples: Array, index: IntArray, remainder: float, errors: Array, bounds: Array) -> None:
    n = index.shape[0] - 1
    for t in range(samples.shape[0]):
        e = samples[t]
        top = 0.0
        for i in range(0, n, 2):
            for j in range(0, n - i, 2):
                top = max(
                    top,
                    _triangle_peak(
                        e[index[i, j]], e[index[i + 2, j]], e[index[i, j + 2]],
                        e[index[i + 1, j]], e[index[i + 1, j + 1]], e[index[i, j + 1]],
                    ),
                )  # fmt: skip
                if i + j + 4 <= n:
                    top = max(
                        top,
                        _triangle_peak(
                            e[index[i + 2, j + 2]], e[index[i, j + 2]], e[index[i + 2, j]],
                            e[index[i + 1, j + 2]], e[index[i + 1, j + 1]], e[index[i + 2, j + 1]],
                        ),
                    )  # fmt: skip
        third = 0.0
        for i in range(n + 1):
            for j in range(n - 2 - i):
                third = max(
                    third,
                    abs(e[index[i, j + 3]] - 3 * e[index[i, j + 2]] + 3 * e[index[i, j + 1]]
                        - e[index[i, j]]),
                    abs(e[index[j + 3, i]] - 3 * e[index[j + 2, i]] + 3 * e[index[j + 1, i]]
                        - e[index[j, i]]),
                    abs(e[index[i + 3, j]] - 3 * e[index[i + 2, j + 1]]
                        + 3 * e[index[i + 1, j + 2]] - e[index[i, j + 3]]),
                    abs(e[index[i + 2, j + 1]] - 2 * e[index[i + 1, j + 1]] + e[index[i, j + 1]]
                        - e[index[i + 2, j]] + 2 * e[index[i + 1, j]] - e[index[i, j]]),
                    abs(e[index[i + 1, j + 2]] - 2 * e[index[i + 1, j + 1]] + e[index[i + 1, j]]
                        - e[index[i, j + 2]] + 2 * e[index[i, j + 1]] - e[index[i, j]]),
                )  # fmt: skip
        errors[t] = top
        bounds[t] = top + remainder * third
