"""From second derivatives to the local frame of the lattice.

Lengths are scaled so that the tolerance is 1: with ``G = H / (8 tol)`` an edge d has the error
``|d^T G d|`` (in units of tol), a convex triangle ``4 R^2`` with R its circumradius in y-space
(sec. 2 of the paper, H the full Hessian). A *frame* W is the inverse of dy/dx: its columns are the
steps in x that advance y1, y2 by one, so that ``W^T G W = diag(1, eps)``.

Near det H = 0 one eigenvalue says nothing. There the length of an edge is limited by the third
derivative instead: the error of a cubic on an edge of length s is ``|f'''| s^3 / (72 sqrt 3)``.
"""

from __future__ import annotations

import math

from equimesh.fields.compiled import compiled
from equimesh.fields.patch_kernels import derivatives3

__all__ = ["AREA_CONVEX", "AREA_SADDLE", "BOOST_PERIOD", "eigenvalues", "frame_at", "gamma"]

# Area per error of the optimal triangle (sec. 2, App. B) where f must be met at the vertices.
AREA_CONVEX = 3.0 * math.sqrt(3.0) / 4.0
AREA_SADDLE = math.sqrt(5.0)
# A boost by this much maps the lattice of V2 triangles onto itself: it multiplies by the unit
# (1 + sqrt 5) / 2 squared in the ring of integers of Q(sqrt 5), of which the lattice is an image.
BOOST_PERIOD = 2.0 * math.log((1.0 + math.sqrt(5.0)) / 2.0)

_CUBIC = 72.0 * math.sqrt(3.0)


@compiled
def eigenvalues(hxx, hxy, hyy):
    """Both eigenvalues of H, the larger first, and the unit eigenvector of that."""
    mean, half = 0.5 * (hxx + hyy), 0.5 * (hxx - hyy)
    radius = math.hypot(half, hxy)
    vx, vy = 1.0, 0.0
    if radius > 0.0:
        # From the row without cancellation.
        if half >= 0.0:
            vx, vy = radius + half, hxy
        else:
            vx, vy = hxy, radius - half
        norm = math.hypot(vx, vy)
        vx, vy = vx / norm, vy / norm
    return mean + radius, mean - radius, vx, vy


@compiled
def gamma(hxx, hxy, hyy, t111, t112, t122, t222):
    """Gamma of (10): the Gauss curvature of the metric H is ``Gamma / (4 det^2)``."""
    return (
        hxx * (t122 * t122 - t222 * t112)
        + hxy * (t111 * t222 - t112 * t122)
        + hyy * (t112 * t112 - t122 * t111)
    )


@compiled
def cubic_floor(l1, l2, vx, vy, t111, t112, t122, t222, eight_tol):
    """Eigenvalues of H that bound the error of the cubic part along each eigenvector too."""
    c1 = abs(t111 * vx**3 + 3 * t112 * vx * vx * vy + 3 * t122 * vx * vy * vy + t222 * vy**3)
    c2 = abs(-t111 * vy**3 + 3 * t112 * vy * vy * vx - 3 * t122 * vy * vx * vx + t222 * vx**3)
    tol = eight_tol / 8.0
    k1 = eight_tol * (c1 / (_CUBIC * tol)) ** (2.0 / 3.0)
    k2 = eight_tol * (c2 / (_CUBIC * tol)) ** (2.0 / 3.0)
    return k1, k2


@compiled
def frame_at(frame, child, coef, x, y, eight_tol, floor):
    """The eigenframe of the metric at a point.

    Returns ``(e1x, e1y, e2x, e2y, eps, pure)``: steps along the two eigenvectors that advance y by
    one, the signature, and whether H alone decided (True) or the cubic or size limit had a say.
    In the saddle case the first vector belongs to the positive eigenvalue of H. ``floor`` is the
    smallest eigenvalue of H / eight_tol allowed (a longest length).
    """
    hxx, hxy, hyy, t111, t112, t122, t222 = derivatives3(frame, child, coef, x, y)
    l1, l2, vx, vy = eigenvalues(hxx, hxy, hyy)
    eps = 1 if l1 * l2 > 0.0 else -1
    if eps > 0:
        l1, l2 = l1 / frame[3], l2 / frame[3]
    k1, k2 = cubic_floor(l1, l2, vx, vy, t111, t112, t122, t222, eight_tol)
    a1, a2 = abs(l1), abs(l2)
    pure = a1 > 1.5 * k1 and a2 > 1.5 * k2
    m1 = (a1**4 + k1**4) ** 0.25 / eight_tol if not pure else a1 / eight_tol
    m2 = (a2**4 + k2**4) ** 0.25 / eight_tol if not pure else a2 / eight_tol
    if m1 < floor or m2 < floor:
        pure = False
        m1, m2 = max(m1, floor), max(m2, floor)
    if frame.shape[0] > 5 and max(m1, m2) > frame[5] * min(m1, m2):
        pure = False
        m1, m2 = max(m1, m2 / frame[5]), max(m2, m1 / frame[5])
    s1, s2 = 1.0 / math.sqrt(m1), 1.0 / math.sqrt(m2)
    return s1 * vx, s1 * vy, -s2 * vy, s2 * vx, eps, pure
