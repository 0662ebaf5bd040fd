"""All vertices at once: Gauss-Newton steps on the energy ``sum phi(e)`` of every error.

Moves of one vertex at a time carry strain one spacing further with each visit, and stop where one
vertex alone gains nothing; around a dislocation a whole neighbourhood has to give way. With slopes
g of the errors by the places of their vertices the matrix is ``sum phi''(e) g g^T``, a 2 x 2 block
for each vertex and each edge; phi is a power, or its logarithm where that is large. Conjugate
gradients solve it well enough (truncated Newton method, Nocedal and Wright, Numerical Optimization,
ch. 7), damped after Levenberg and Marquardt. No step goes far, and vertices around which it does
harm do not take it. The mesh keeps its connectivity.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.dispatch import gradient
from equimesh.fields.kernel import KernelField
from equimesh.optimise.angles import angle_slope, by_angle
from equimesh.optimise.conjugate import solve
from equimesh.optimise.energy import (
    evaluate_all,
    lift,
    penalty,
    share_along,
    share_inside,
)
from equimesh.optimise.mesh import (
    FIRM,
    FIXED,
    FREE,
    MANNER,
    MODEL,
    SLIDES,
    SOFT,
    TRIANGLES,
    VERTICES,
    Mesh,
)
from equimesh.optimise.model import edge_gradient, inner_gradient, smooth_edge, smooth_inside
from equimesh.optimise.topology import ample

__all__ = ["relax_together"]

_ENOUGH = 5e-3  # relative gain of a step below which the next is not worth its time
_REACH = 0.4  # how far a vertex may go in one step, in sizes of its star
_DEAR = 10.0  # powers of errors above this count by their logarithm: else one would hide the rest
# Share of the diagonal that is added to it at first, and how that changes when a step fails or not:
# of what a failed step costs two good ones can be made.
_DAMPING, _HARDER, _EASIER = 0.04, 4.0, 0.7
_TRIES = 3  # of a step, each with fewer vertices that take part


@inlined
def _judged(m, e):
    """The energy of an error; one that is dear counts by its logarithm."""
    return math.log1p(penalty(m, e) / _DEAR)


@compiled
def _price(m, t):
    """Energy of a triangle's inside and of its half of the edges."""
    edges = _judged(m, m.ee[t, 0]) + _judged(m, m.ee[t, 1]) + _judged(m, m.ee[t, 2])
    return _judged(m, m.ie[t]) + 0.5 * edges


@compiled
def _prices(m, out):
    """Energy of each triangle into ``out`` (t,); returns their sum."""
    total = 0.0
    for t in range(m.count[TRIANGLES]):
        out[t] = 0.0
        if m.tv[t, 0] >= 0:
            out[t] = _price(m, t)
            total += out[t]
    return total


@compiled
def _derivatives(m, e):
    """phi'(e) and, but for what would make it negative, phi''(e), for e >= 0."""
    e4 = e * e * e * e
    p, below = 6.0, e4  # the power, and e^(p - 2)
    if m.count[MANNER] != SOFT:
        p, below = 24.0, e4 * e4 * e4 * e4 * e4 * e * e
        if m.count[MANNER] != FIRM:
            p, below = 48.0, below * below * e * e
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
def _assemble(F, m, tol, number, diagonal, beside, downhill, g):
    """Blocks of the matrix and the negative gradient; ``number`` (t, 3) is the edge of a side."""
    for v in range(m.count[VERTICES]):
        diagonal[v, 0] = diagonal[v, 1] = diagonal[v, 2] = 0.0
        downhill[v, 0] = downhill[v, 1] = 0.0
    for n in range(beside.shape[0]):
        beside[n, 0] = beside[n, 1] = beside[n, 2] = beside[n, 3] = 0.0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        for k in range(4):  # three edges and the inside
            share = 1.0
            if k < 3:
                if m.tn[t, k] > t:
                    continue
                e = abs(m.ee[t, k])
                _edge_slopes(F, m, tol, t, k, g)
                share = 0.5 if m.tn[t, k] < 0 else 1.0
            else:
                e = abs(m.ie[t])
                if e < 0.3:
                    continue
                _inner_slopes(F, m, tol, t, g)
            first, second = _derivatives(m, e)
            _add(m, t, share * first, share * second, number, diagonal, beside, downhill, g)


@inlined
def _add(m, t, first, second, number, diagonal, beside, downhill, g):
    """One error's part of the gradient and of the matrix, its slopes being the rows of ``g``."""
    for i in range(3):
        v = m.tv[t, i]
        if m.kind[v] == FIXED:
            g[i, 0] = g[i, 1] = 0.0
        elif m.kind[v] == SLIDES:
            side = m.sides[m.side[v]]
            ux, uy = side[2] - side[0], side[3] - side[1]
            along = (g[i, 0] * ux + g[i, 1] * uy) / (ux * ux + uy * uy)
            g[i, 0], g[i, 1] = along * ux, along * uy
        downhill[v, 0] -= first * g[i, 0]
        downhill[v, 1] -= first * g[i, 1]
        diagonal[v, 0] += second * g[i, 0] * g[i, 0]
        diagonal[v, 1] += second * g[i, 0] * g[i, 1]
        diagonal[v, 2] += second * g[i, 1] * g[i, 1]
    for i in range(3):
        j, n = (i + 1) % 3, number[t, i]
        low, high = (i, j) if m.tv[t, i] < m.tv[t, j] else (j, i)
        beside[n, 0] += second * g[low, 0] * g[high, 0]
        beside[n, 1] += second * g[low, 0] * g[high, 1]
        beside[n, 2] += second * g[low, 1] * g[high, 0]
        beside[n, 3] += second * g[low, 1] * g[high, 1]


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


@compiled
def _shorten(m, step, reach, spread):
    """Limit every vertex's step to ``reach`` times the size of its star in that direction.

    ``spread`` (v, 4) is scratch: the second moments of the spokes and their number.
    """
    for v in range(step.shape[0]):
        for i in range(4):
            spread[v, i] = 0.0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        for k in range(3):
            a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
            dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
            for v in (a, b):
                spread[v, 0] += dx * dx
                spread[v, 1] += dx * dy
                spread[v, 2] += dy * dy
                spread[v, 3] += 1.0
    for v in range(step.shape[0]):
        xx, xy, yy, n = spread[v, 0], spread[v, 1], spread[v, 2], spread[v, 3]
        det = xx * yy - xy * xy
        if det > 0.0:
            sx, sy = step[v, 0], step[v, 1]
            far = n * (yy * sx * sx - 2.0 * xy * sx * sy + xx * sy * sy) / det
            if far > reach * reach:
                share = reach / math.sqrt(far)
                step[v, 0] *= share
                step[v, 1] *= share


@compiled
def _walk(F, m, old, step):
    """Put every vertex at its old place plus the step, except where a triangle would turn over."""
    for v in range(m.count[VERTICES]):
        if m.kind[v] != FREE and m.kind[v] != SLIDES:
            continue
        x, y = old[v, 0] + step[v, 0], old[v, 1] + step[v, 1]
        if m.kind[v] == SLIDES:
            side = m.sides[m.side[v]]
            ux, uy = side[2] - side[0], side[3] - side[1]
            along = ((x - side[0]) * ux + (y - side[1]) * uy) / (ux * ux + uy * uy)
            x, y = side[0] + along * ux, side[1] + along * uy
            if not 0.0 < along < 1.0:
                x, y = old[v, 0], old[v, 1]
        if not (math.isfinite(x) and math.isfinite(y) and lift(F, m, v, x, y)):
            lift(F, m, v, old[v, 0], old[v, 1])
    turned = True
    while turned:
        turned = False
        for t in range(m.count[TRIANGLES]):
            a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
            if a < 0 or ample(m.x[a], m.y[a], m.x[b], m.y[b], m.x[c], m.y[c]):
                continue
            for k in range(3):
                v = m.tv[t, k]
                if (m.kind[v] == FREE or m.kind[v] == SLIDES) and (
                    m.x[v] != old[v, 0] or m.y[v] != old[v, 1]
                ):
                    lift(F, m, v, old[v, 0], old[v, 1])
                    turned = True


@compiled
def _hold_back(m, before, after, step, rise):
    """Take the steps from vertices around which errors have become dearer.

    ``before`` and ``after`` (t,): price of each triangle at the old places and now; ``rise`` (v,)
    is scratch. So one bad spot does not spoil the step of all others.
    """
    for v in range(rise.shape[0]):
        rise[v] = 0.0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] >= 0:
            for k in range(3):
                rise[m.tv[t, k]] += after[t] - before[t]
    for v in range(rise.shape[0]):
        if rise[v] > 0.0:
            step[v, 0] = step[v, 1] = 0.0


def _moved(
    field: KernelField, mesh: Mesh, tol: float, old: NDArray[np.float64], step: NDArray[np.float64]
) -> None:
    """The mesh a step from ``old``, and its errors where a vertex is not where it was."""
    n = len(old)
    x, y = mesh.x[:n].copy(), mesh.y[:n].copy()
    _walk(field, mesh, old, step)
    moved = (mesh.x[:n] != x) | (mesh.y[:n] != y)
    evaluate_all(field, mesh, tol, moved.view(np.uint8))


def _tried(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    old: NDArray[np.float64],
    step: NDArray[np.float64],
    energy: float,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> float:
    """The energy after a step from ``old``, taken by fewer vertices until it is below ``energy``.

    ``before`` and ``after`` (t,): energies of the triangles, the second written.
    """
    now, rise = math.inf, np.zeros(len(old))
    for _ in range(_TRIES):
        _moved(field, mesh, tol, old, step)
        now = _prices(mesh, after)
        if now < energy:
            break
        _hold_back(mesh, before, after, step, rise)
    return now


def relax_together(field: KernelField, mesh: Mesh, tol: float, rounds: int) -> int:
    """Up to ``rounds`` steps in the mesh's manner, a power; returns how many lowered the energy.

    The errors that the mesh has stored must be those of its vertices.
    """
    n = int(mesh.count[VERTICES])
    number = np.zeros((int(mesh.count[TRIANGLES]), 3), np.int64)
    ends = np.zeros((3 * len(number), 2), np.int64)
    ends = ends[: _number_edges(mesh, number, ends)]
    diagonal, beside = np.zeros((n, 3)), np.zeros((len(ends), 4))
    downhill, step, work = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((4, n, 2))
    spread = np.zeros((n, 4))
    before, after = np.zeros(len(number)), np.zeros(len(number))
    energy, damping = _prices(mesh, before), _DAMPING
    for done in range(rounds):
        _assemble(field, mesh, tol, number, diagonal, beside, downhill, np.zeros((3, 2)))
        old = np.stack([mesh.x[:n], mesh.y[:n]], 1)
        now = math.inf
        for _ in range(4):
            solve(diagonal, beside, ends, damping, downhill, step, work)
            _shorten(mesh, step, _REACH, spread)
            now = _tried(field, mesh, tol, old, step, energy, before, after)
            if now < energy:
                break
            damping *= _HARDER
        if not now < energy:
            _moved(field, mesh, tol, old, np.zeros((n, 2)))
            return done
        damping = max(_EASIER * damping, 1e-6)
        if energy - now < _ENOUGH * energy:
            return done + 1
        energy, before, after = now, after, before
    return rounds
