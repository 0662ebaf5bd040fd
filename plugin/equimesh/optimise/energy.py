"""What the optimiser lowers: how far the errors of edges and insides exceed the tolerance.

The hinge ``h = max(0, e - hinge)``, a little below 1, leaves settled triangles alone. It is linear,
and each violation costs a step besides (``SETTLE``): a convex power would trade a few large
violations for many slight ones and spread them over a settled interior. Where a change is tried and
undone if it fails, that spreading is wanted, and the price is h^2 (``SPREAD``). Where nothing is
violated and must not be, a smooth power brings slack together (``EVEN``). Powers alone bring
crystals about: the higher (``SOFT`` 6, ``FIRM`` 24, ``HARD`` 48, ``HARDER`` 192, ``HARDEST`` 768),
the more do large errors count.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined, outlined
from equimesh.fields.dispatch import edge_error, inner_error, value
from equimesh.fields.kernel import KernelField
from equimesh.fields.patch_kernels import derivatives2
from equimesh.fields.workers import in_ranges
from equimesh.optimise.angles import angle_price
from equimesh.optimise.mesh import (
    EVEN,
    FIRM,
    HARD,
    HARDER,
    HARDEST,
    MANNER,
    MODEL,
    SOFT,
    SPREAD,
    TRIANGLES,
    VERTICES,
    Mesh,
)
from equimesh.optimise.model import (
    climbed,
    halved_edge,
    mixed_inner,
    model_edge,
    model_inner,
    model_middle,
    smooth_edge,
    smooth_inside,
)
from equimesh.optimise.topology import note_triangle, star

__all__ = [
    "DEAREST",
    "ROOM",
    "evaluate",
    "evaluate_all",
    "lift",
    "middle_of",
    "penalty",
    "set_edge",
    "set_inner",
    "set_jet",
    "share_along",
    "share_inside",
    "worst_around",
    "worst_errors",
    "worst_of",
]

ROOM = 0.98  # how far vertices may leave the surface, in units of the tolerance, where they may
_RANGE = 2048  # triangles that a thread evaluates at a time
_SMALL = 0.5  # units of the tolerance: whether an error is less than this matters to nobody
_CEILING = 1e3  # beyond it, more is not worse: keeps sums finite,
DEAREST = 1e70  # and where a power of 48 or more is raised further, beyond this


@compiled
def penalty(m, e):
    """Price of an error e (in units of the tolerance, signed), in the mesh's present manner."""
    e = min(abs(e), _CEILING)
    over = e - m.hinge[0]
    e2 = e * e
    if m.count[MANNER] >= SOFT:
        power = e2 * e2 * e2
        if m.count[MANNER] >= FIRM:
            power *= power
            power *= power
        if m.count[MANNER] >= HARD:
            power *= power
        for manner in (HARDER, HARDEST):
            if m.count[MANNER] >= manner:
                power = min(power, DEAREST)
                power *= power
                power *= power
        return power
    if m.count[MANNER] == EVEN:
        return e2 * e2 + (100.0 if e > 1.0 else 0.0)
    small = 1e-4 * e2 * e2 if e < 1.0 else 1e-4 * e2
    if over <= 0.0:
        return small
    if m.count[MANNER] == SPREAD:
        return small + 20.0 * over * over
    return small + over + (0.05 if e > 1.0 else 0.0)


@compiled
def set_jet(F, m, v, x, y):
    """Store first and second derivatives of a smooth field at (x, y) for v; returns its height."""
    z, gx, gy, hxx, hxy, hyy = derivatives2(F.frame, F.child, F.coef, x, y)
    m.jet[v, 0], m.jet[v, 1] = gx, gy
    m.jet[v, 2], m.jet[v, 3], m.jet[v, 4] = hxx, hxy, hyy
    return z


@outlined
def lift(F, m, v, x, y):
    """Put vertex v at (x, y), its height above the surface kept.

    False, and nothing changed, outside the field.
    """
    if m.count[MODEL] == 1:
        z = set_jet(F, m, v, x, y)
    else:
        z = value(F, x, y)
        if not math.isfinite(z):
            return False
    m.x[v], m.y[v], m.z[v] = x, y, z + m.w[v]
    return True


@inlined
def share_along(m, a, b):
    """By what the error of an edge is multiplied."""
    return 0.5 * (m.share[a] + m.share[b])


@inlined
def share_inside(m, a, b, c):
    """By what the error inside a triangle is multiplied."""
    return (m.share[a] + m.share[b] + m.share[c]) / 3.0


@outlined
def edge_of(F, m, tol, a, b):
    """(signed error / tol, position) of the segment from vertex a to vertex b."""
    e = s = math.nan
    if m.count[MODEL] == 1:
        e, s = model_edge(m, a, b) if smooth_edge(m, a, b) else halved_edge(F, m, a, b)
    if math.isnan(e):
        e, s = edge_error(F, m.x[a], m.y[a], m.z[a], m.x[b], m.y[b], m.z[b], 1e3 * tol)
    return e * share_along(m, a, b) / tol, s


@outlined
def middle_of(F, m, tol, a, b):
    """Signed error / tol in the middle of the segment from vertex a to vertex b: the largest, which
    takes far longer, is no less. 0 where an end is as far from the surface."""
    if m.count[MODEL] == 1 and smooth_edge(m, a, b):
        e = model_middle(m, a, b)
    else:
        e = value(F, 0.5 * (m.x[a] + m.x[b]), 0.5 * (m.y[a] + m.y[b])) - 0.5 * (m.z[a] + m.z[b])
    if abs(e) <= max(abs(m.w[a]), abs(m.w[b])):
        return 0.0
    return e * share_along(m, a, b) / tol


@compiled
def _inner_error(F, m, tol, a, b, c):
    """(signed error / tol, x, y) inside the triangle a, b, c."""
    if m.count[MODEL] == 0:
        e, x, y = inner_error(
            F, m.x[a], m.y[a], m.z[a], m.x[b], m.y[b], m.z[b], m.x[c], m.y[c], m.z[c], 1e3 * tol
        )
    elif smooth_inside(m, a, b, c):
        e, x, y = model_inner(m, a, b, c)
    else:
        e, x, y = mixed_inner(m, a, b, c, _SMALL * tol)
        if abs(e) > _SMALL * tol:
            e, x, y = climbed(F, m, a, b, c, x, y)
    return e * share_inside(m, a, b, c) / tol, x, y


@outlined
def inner_of(F, m, tol, a, b, c):
    """(signed error / tol, x, y) inside the triangle a, b, c, or its angles' price if larger."""
    e, x, y = _inner_error(F, m, tol, a, b, c)
    if F.shape.shape[0] > 0:
        price = angle_price(F, m, a, b, c)
        if price > abs(e):
            return price, x, y
    return e, x, y


@compiled
def set_edge(m, t, k, e, s):
    """Store an edge's error on both of its sides."""
    m.ee[t, k], m.ep[t, k] = e, s
    u = m.tn[t, k]
    if u >= 0:
        a = m.tv[t, k]
        for j in range(3):
            if m.tn[u, j] == t and m.tv[u, (j + 1) % 3] == a:
                note_triangle(m, u)
                m.ee[u, j], m.ep[u, j] = e, 1.0 - s
                return


@compiled
def set_inner(F, m, tol, t):
    m.ie[t], m.ix[t], m.iy[t] = inner_of(F, m, tol, m.tv[t, 0], m.tv[t, 1], m.tv[t, 2])


@compiled
def evaluate(F, m, tol, moved, first, last):
    """Errors of the edges and insides of triangles ``first`` ... ``last`` with a moved vertex."""
    for t in range(first, last):
        if m.tv[t, 0] < 0:
            continue
        some = False
        for k in range(3):
            a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
            if moved[a] or moved[b]:
                some = True
                if m.tn[t, k] < t:  # border, or first seen from here
                    e, s = edge_of(F, m, tol, a, b)
                    set_edge(m, t, k, e, s)
        if some:
            set_inner(F, m, tol, t)


def evaluate_all(
    F: KernelField, m: Mesh, tol: float, moved: NDArray[np.uint8] | None = None
) -> None:
    """Errors of every edge and inside, or of those at vertices that ``moved`` (v,).

    Each number is written by one thread and depends on no other.
    """
    n = int(m.count[TRIANGLES])
    flags = np.ones(int(m.count[VERTICES]), np.uint8) if moved is None else moved
    in_ranges(lambda first, last: evaluate(F, m, tol, flags, first, last), n, _RANGE)


@compiled
def worst_of(m, t):
    """Largest error of triangle t."""
    return max(abs(m.ee[t, 0]), abs(m.ee[t, 1]), abs(m.ee[t, 2]), abs(m.ie[t]))


@compiled
def worst_around(m, v):
    """The triangle of v's star with the largest error."""
    n, _ = star(m, v)
    worst = m.ring[1, 0]
    for j in range(1, n):
        if worst_of(m, m.ring[1, j]) > worst_of(m, worst):
            worst = m.ring[1, j]
    return worst


@compiled
def _worst_errors(m, out):
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] >= 0:
            out[t] = worst_of(m, t)


def worst_errors(mesh: Mesh) -> NDArray[np.float64]:
    """(t,) largest error of each triangle, in units of the tolerance; 0 for spare slots."""
    out = np.zeros(len(mesh.tv))
    _worst_errors(mesh, out)
    return out
