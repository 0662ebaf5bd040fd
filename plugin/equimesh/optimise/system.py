"""The energy ``sum phi(e)`` of every error, its slope, and the matrix of Gauss and Newton.

With slopes g of the errors by the places of their vertices the matrix is ``sum phi''(e) g g^T``, a
2 x 2 block for each vertex and each edge; phi is a power, or its logarithm where that is large.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.dispatch import gradient
from equimesh.fields.kernel import KernelField
from equimesh.fields.workers import in_ranges
from equimesh.optimise.angles import angle_slope, by_angle
from equimesh.optimise.conjugate import matrix
from equimesh.optimise.energy import DEAREST, penalty, share_along, share_inside
from equimesh.optimise.mesh import (
    FIXED,
    HARD,
    HARDER,
    HARDEST,
    MANNER,
    MODEL,
    SLIDES,
    SOFT,
    TRIANGLES,
    VERTICES,
    Mesh,
)
from equimesh.optimise.model import edge_gradient, inner_gradient, smooth_edge, smooth_inside

__all__ = ["ALONE", "System", "prices", "prices_alone"]

_DEAR = 10.0  # powers of errors above this count by their logarithm: else one would hide the rest
_SLIGHT = 0.3  # errors inside below which their slopes do not matter
_RANGE = 2048  # triangles that a thread works on at a time,
_BLOCK = 8_192  # and whose slopes are kept at a time
ALONE = 4096  # up to which a step is one thread's: to hand out its parts would take longer


@inlined
def _judged(m, e):
    """The energy of an error; one that is dear counts by its logarithm."""
    return math.log1p(penalty(m, e) / _DEAR)


@compiled
def _price(m, t):
    """Energy of a triangle's inside and of its half of the edges."""
    edges = _judged(m, m.ee[t, 0]) + _judged(m, m.ee[t, 1]) + _judged(m, m.ee[t, 2])
    return _judged(m, m.ie[t]) + 0.5 * edges


@inlined
def _gives_way(m, t):
    """Whether there is a triangle in slot t and one of its corners can move."""
    a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
    return a >= 0 and (m.kind[a] != FIXED or m.kind[b] != FIXED or m.kind[c] != FIXED)


@compiled
def prices_alone(m, first, last, out):
    """``prices`` of triangles ``first`` ... ``last`` in one thread."""
    total = 0.0
    for t in range(first, last):
        out[t] = _price(m, t) if _gives_way(m, t) else 0.0
        total += out[t]
    return total


def prices(mesh: Mesh, out: NDArray[np.float64]) -> float:
    """Energy of each triangle that can give way into ``out`` (t,); returns their sum."""
    in_ranges(lambda first, last: prices_alone(mesh, first, last, out), len(out), _RANGE)
    return float(out.sum())


@compiled
def _derivatives(m, e):
    """phi'(e) and, but for what would make it negative, phi''(e), for e >= 0."""
    e4 = e * e * e * e
    p, below = 6.0, e4  # the power, and e^(p - 2)
    if m.count[MANNER] != SOFT:
        p, below = 24.0, e4 * e4 * e4 * e4 * e4 * e * e
        if m.count[MANNER] >= HARD:
            p, below = 48.0, below * below * e * e
        for manner in (HARDER, HARDEST):
            if m.count[MANNER] >= manner:
                below = min(below, DEAREST)
                power = min(below * e * e, DEAREST)
                p, below = 4.0 * p, power * power * power * below
    share = 1.0 / (_DEAR + below * e * e)
    return share * p * below * e, share * p * (p - 1.0) * below


@inlined
def _slope(F, m, v, weight, hx, hy):
    """Derivative, by the place of v, of an error at whose peak the surface has the gradient
    (hx, hy): the error is stationary there, so only the plane above it moves, v having this weight
    in it."""
    if m.count[MODEL] == 1:
        return weight * (hx - m.jet[v, 0]), weight * (hy - m.jet[v, 1])
    gx, gy = gradient(F, m.x[v], m.y[v])
    return weight * (hx - gx), weight * (hy - gy)


@inlined
def _edge_slopes(F, m, tol, t, k, g):
    """Slopes of the error of edge k of t into rows of ``g``, 0 for the third corner."""
    i, j = k, (k + 1) % 3
    a, b, s = m.tv[t, i], m.tv[t, j], m.ep[t, k]
    sign = (1.0 if m.ee[t, k] > 0.0 else -1.0) * share_along(m, a, b) / tol
    if m.count[MODEL] == 1 and smooth_edge(m, a, b):
        hx, hy = edge_gradient(m, a, b, s)
    else:
        hx, hy = gradient(F, m.x[a] + s * (m.x[b] - m.x[a]), m.y[a] + s * (m.y[b] - m.y[a]))
    g[i, 0], g[i, 1] = _slope(F, m, a, sign * (1.0 - s), hx, hy)
    g[j, 0], g[j, 1] = _slope(F, m, b, sign * s, hx, hy)
    g[(k + 2) % 3, 0] = g[(k + 2) % 3, 1] = 0.0


@inlined
def _inner_slopes(F, m, tol, t, g):
    """Slopes of the error inside t, or of its angles' price, into ``g``."""
    if by_angle(F, m, t):
        for i in range(3):
            v, p, q = m.tv[t, i], m.tv[t, (i + 1) % 3], m.tv[t, (i + 2) % 3]
            g[i, 0], g[i, 1] = angle_slope(F, m, v, p, q)
        return
    a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
    x, y = m.ix[t], m.iy[t]
    area = (m.x[b] - m.x[a]) * (m.y[c] - m.y[a]) - (m.y[b] - m.y[a]) * (m.x[c] - m.x[a])
    sign = (1.0 if m.ie[t] > 0.0 else -1.0) * share_inside(m, a, b, c) / (tol * area)
    if m.count[MODEL] == 1 and smooth_inside(m, a, b, c):
        hx, hy = inner_gradient(m, a, b, c, x, y)
    else:
        hx, hy = gradient(F, x, y)
    for i in range(3):
        v, p, q = m.tv[t, i], m.tv[t, (i + 1) % 3], m.tv[t, (i + 2) % 3]
        weight = (m.x[p] - x) * (m.y[q] - y) - (m.y[p] - y) * (m.x[q] - x)
        g[i, 0], g[i, 1] = _slope(F, m, v, sign * weight, hx, hy)


@compiled
def _project(m, t, g):
    """Take from slopes (3, 2) by the places of t's corners what these cannot give way to."""
    for i in range(3):
        v = m.tv[t, i]
        if m.kind[v] == FIXED:
            g[i, 0] = g[i, 1] = 0.0
        elif m.kind[v] == SLIDES:
            side = m.sides[m.side[v]]
            ux, uy = side[2] - side[0], side[3] - side[1]
            along = (g[i, 0] * ux + g[i, 1] * uy) / (ux * ux + uy * uy)
            g[i, 0], g[i, 1] = along * ux, along * uy


@compiled
def _slopes(F, m, tol, first, last, before, slopes, shares):
    """Slopes (., 4, 3, 2) of the errors of three edges and the inside of triangles ``first`` ...
    ``last``, and the first and second derivative (., 4, 2) of their energies, 0 for what another
    triangle has. Rows are numbered from the triangle ``before``."""
    for t in range(first, last):
        stiff = not _gives_way(m, t)
        for k in range(4):
            shares[t - before, k, 0] = shares[t - before, k, 1] = 0.0
            if stiff or (k < 3 and m.tn[t, k] > t):
                continue
            share, e = 1.0, abs(m.ie[t])
            g = slopes[t - before, k]
            if k < 3:
                e = abs(m.ee[t, k])
                share = 0.5 if m.tn[t, k] < 0 else 1.0
                _edge_slopes(F, m, tol, t, k, g)
            elif e >= _SLIGHT:
                _inner_slopes(F, m, tol, t, g)
            else:
                continue
            _project(m, t, g)
            by, by_twice = _derivatives(m, e)
            shares[t - before, k, 0], shares[t - before, k, 1] = share * by, share * by_twice


@inlined
def _add_corner(m, t, i, by, by_twice, g, diagonal, downhill):
    v = m.tv[t, i]
    downhill[v, 0] -= by * g[i, 0]
    downhill[v, 1] -= by * g[i, 1]
    diagonal[v, 0] += by_twice * g[i, 0] * g[i, 0]
    diagonal[v, 1] += by_twice * g[i, 0] * g[i, 1]
    diagonal[v, 2] += by_twice * g[i, 1] * g[i, 1]


@inlined
def _add_side(m, t, i, by_twice, g, number, places, blocks):
    j, n = (i + 1) % 3, number[t, i]
    low, high = (i, j) if m.tv[t, i] < m.tv[t, j] else (j, i)
    for side in range(2):
        block = blocks[places[n, side]]
        row, column = (low, high) if side == 0 else (high, low)
        for p in range(2):
            block[2 * p] += by_twice * g[row, p] * g[column, 0]
            block[2 * p + 1] += by_twice * g[row, p] * g[column, 1]


@compiled
def _add(m, first, last, slopes, shares, number, of, downhill, what):
    """The parts of triangles ``first`` ... ``last`` in the gradient and in the vertices' blocks
    (``what`` 0) or in the edges' (1)."""
    for t in range(first, last):
        for k in range(4):
            by, by_twice = shares[t - first, k, 0], shares[t - first, k, 1]
            if by == 0.0:
                continue
            g = slopes[t - first, k]
            for i in range(3):
                # An edge's error has no slope at the corner across, so two sides have none.
                if what == 0 and (k == 3 or i != (k + 2) % 3):
                    _add_corner(m, t, i, by, by_twice, g, of.diagonal, downhill)
                elif what == 1 and (k == 3 or i == k):
                    _add_side(m, t, i, by_twice, g, number, of.places, of.blocks)


@compiled
def _assemble_alone(F, m, tol, slopes, shares, number, of, downhill):
    """``System.assemble`` in one thread, for a mesh of one block."""
    of.diagonal[:] = 0.0
    of.blocks[:] = 0.0
    downhill[:] = 0.0
    last = number.shape[0]
    _slopes(F, m, tol, 0, last, 0, slopes, shares)
    for what in range(2):
        _add(m, 0, last, slopes, shares, number, of, downhill, what)


class System:
    """Gauss-Newton's matrix and the negative gradient for a mesh that keeps its connectivity."""

    def __init__(self, mesh: Mesh) -> None:
        vertices, triangles = int(mesh.count[VERTICES]), int(mesh.count[TRIANGLES])
        self.number = np.zeros((triangles, 3), np.int64)  # of the edge at each side
        ends = np.zeros((3 * triangles, 2), np.int64)
        ends = ends[: _number_edges(mesh, self.number, ends)]
        self.matrix = matrix(vertices, ends)
        self.downhill = np.zeros((vertices, 2))
        block = min(_BLOCK, triangles)
        self._slopes, self._shares = np.zeros((block, 4, 3, 2)), np.zeros((block, 4, 2))

    def assemble(self, field: KernelField, mesh: Mesh, tol: float) -> None:
        """Both for the places and the errors that the mesh has now."""
        of = self.matrix
        if len(self.number) <= ALONE:
            _assemble_alone(
                field, mesh, tol, self._slopes, self._shares, self.number, of, self.downhill
            )
            return
        of.diagonal[:], of.blocks[:], self.downhill[:] = 0.0, 0.0, 0.0
        for start in range(0, len(self.number), _BLOCK):
            stop = min(start + _BLOCK, len(self.number))
            self._slope_block(field, mesh, tol, start, stop)
            self._add_block(mesh, start, stop)

    def _slope_block(
        self, field: KernelField, mesh: Mesh, tol: float, start: int, stop: int
    ) -> None:
        def work(first: int, last: int) -> None:
            _slopes(
                field, mesh, tol, start + first, start + last, start, self._slopes, self._shares
            )

        in_ranges(work, stop - start, _RANGE)

    def _add_block(self, mesh: Mesh, start: int, stop: int) -> None:
        of = self.matrix

        def work(first: int, last: int) -> None:
            for what in range(first, last):
                _add(
                    mesh, start, stop, self._slopes, self._shares, self.number, of,
                    self.downhill, what,
                )  # fmt: skip

        in_ranges(work, 2, 1 if stop - start >= _RANGE else 2)


@compiled
def _number_edges(m, number, ends):
    """Number every edge: ``number`` (t, 3); ``ends`` (e, 2), the lower vertex first."""
    n = 0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        for k in range(3):
            u, a, b = m.tn[t, k], m.tv[t, k], m.tv[t, (k + 1) % 3]
            if u > t:
                continue
            number[t, k] = n
            ends[n, 0], ends[n, 1] = min(a, b), max(a, b)
            for j in range(3):
                if u >= 0 and m.tn[u, j] == t and m.tv[u, (j + 1) % 3] == a:
                    number[u, j] = n
            n += 1
    return n
