"""Edges of two triangles against the other diagonal of both."""

from __future__ import annotations

import numpy as np

from equimesh.fields.compiled import compiled, inlined, outlined
from equimesh.fields.kernel import KernelField
from equimesh.fields.workers import in_ranges
from equimesh.optimise.energy import edge_of, inner_of, middle_of, penalty
from equimesh.optimise.mesh import EPOCH, TRIANGLES, Mesh
from equimesh.optimise.topology import flip, flippable

__all__ = ["IDLE", "flip_all", "try_flip"]

IDLE = 1e-3  # edges and insides with a smaller penalty are left alone


@inlined
def _other_diagonal(F, m, tol, t, k):
    """Whether the other diagonal at edge k of t has a lower penalty with the two insides.

    Then also the error and its place along (d, c), and those inside (c, a, d) and (d, b, c).
    """
    none = (False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    u, a, b, c, d = flippable(m, t, k)
    if u < 0:
        return none
    before = penalty(m, m.ee[t, k]) + penalty(m, m.ie[t]) + penalty(m, m.ie[u])
    if before < 1e-5:
        return none
    goal = before * 0.999 - 1e-9
    if penalty(m, middle_of(F, m, tol, d, c)) >= goal:
        return none
    e, s = edge_of(F, m, tol, d, c)
    after = penalty(m, e)
    if after >= goal:
        return none
    e1, x1, y1 = inner_of(F, m, tol, c, a, d)
    after += penalty(m, e1)
    if after >= goal:
        return none
    e2, x2, y2 = inner_of(F, m, tol, d, b, c)
    after += penalty(m, e2)
    return after < goal, e, s, e1, x1, y1, e2, x2, y2


@compiled
def _list_flips(F, m, tol, first, last, worth):
    """Mark edges k of triangles ``first`` ... ``last`` that are worth flipping in ``worth`` (t, 3),
    each on the side of the lower triangle."""
    for t in range(first, last):
        for k in range(3):
            u = m.tn[t, k]
            worth[t, k] = False
            if m.tv[t, 0] >= 0 and u > t:
                slight = penalty(m, m.ee[t, k]) + penalty(m, max(abs(m.ie[t]), abs(m.ie[u])))
                if slight > IDLE:
                    worth[t, k] = _other_diagonal(F, m, tol, t, k)[0]


@outlined
def try_flip(F, m, tol, t, k):
    """Flip edge k of t if that lowers the penalty of the edge and the two insides."""
    worth, e, s, e1, x1, y1, e2, x2, y2 = _other_diagonal(F, m, tol, t, k)
    if not worth:
        return False
    u = flip(m, t, k)
    m.ee[t, 2], m.ep[t, 2] = e, s
    m.ee[u, 2], m.ep[u, 2] = e, 1.0 - s
    m.ie[t], m.ix[t], m.iy[t] = e1, x1, y1
    m.ie[u], m.ix[u], m.iy[u] = e2, x2, y2
    return True


@compiled
def _flip_listed(F, m, tol, worth, passes):
    """Flip the edges marked in ``worth`` (t, 3); then those for which that is a new reason."""
    total = 0
    for number in range(passes):
        seen = m.count[EPOCH]
        m.count[EPOCH] += 1
        made = 0
        for t in range(m.count[TRIANGLES]):
            if m.tv[t, 0] < 0 or (number > 0 and m.mark[t] < seen):
                continue
            for k in range(3):
                u = m.tn[t, k]
                if number == 0:
                    tried = worth[t, k]
                else:
                    tried = penalty(m, m.ee[t, k]) + penalty(m, m.ie[t]) > IDLE
                if tried and try_flip(F, m, tol, t, k):
                    m.mark[t] = m.mark[u] = m.count[EPOCH]
                    made += 1
        total += made
        if made == 0:
            break
    return total


def flip_all(F: KernelField, m: Mesh, tol: float, passes: int) -> int:
    """Sweep over all edges until none is worth flipping; returns the number of flips."""
    n = int(m.count[TRIANGLES])
    worth = np.empty((n, 3), np.bool_)
    in_ranges(lambda first, last: _list_flips(F, m, tol, first, last, worth), n)
    return int(_flip_listed(F, m, tol, worth, passes))
