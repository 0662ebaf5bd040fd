"""Adaptive finite elements, in place of PLTMG: solve, estimate, mark, refine.

The example's function is never looked at except through its values on the boundary: linear elements
solve ``k1 u_xx + k2 u_yy = 0``, and the jumps of the flux across edges say where to refine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import spsolve
from scipy.spatial import Delaunay
from skfem import (
    Basis,
    BilinearForm,
    ElementTriP1,
    Functional,
    InteriorFacetBasis,
    MeshTri,
    condense,
)

__all__ = ["Adapted", "adapt"]

_START = 1  # uniform refinements before the first estimate
_SHARE = 0.7  # elements within this share of the worst estimate are refined


@dataclass(frozen=True)
class Adapted:
    """A mesh after adaptive refinement.

    Parameters
    ----------
    points, triangles
        (n, 2) and (m, 3): the nodes, triangulated anew by Delaunay as in the paper.
    refined
        Triangles of the refined mesh itself.
    estimate
        The solver's own estimate of its error in the energy norm.
    residual
        ``|K u - b| / |b|`` of the linear equations.
    steps
        Times that the equations were solved.
    """

    points: np.ndarray
    triangles: np.ndarray
    refined: int
    estimate: float
    residual: float
    steps: int


def adapt(
    f: Callable[[np.ndarray, np.ndarray], np.ndarray], k: tuple[float, float], wanted: int
) -> Adapted:
    """Refine the unit square until the mesh has about ``wanted`` triangles."""
    mesh = MeshTri().refined(_START)
    steps = 0
    while True:
        estimates, residual = _estimate(mesh, f, k)
        steps += 1
        if mesh.t.shape[1] >= wanted:
            break
        worst = np.argsort(-estimates, kind="stable")
        marked = worst[estimates[worst] >= _SHARE * estimates.max()]
        finer = mesh.refined(np.sort(marked))
        while finer.t.shape[1] > 1.02 * wanted and marked.size > 1:
            # The last step takes only so many of the worst as the count allows.
            marked = marked[: int(0.8 * marked.size)]
            finer = mesh.refined(np.sort(marked))
        mesh = finer
    points = mesh.p.T.copy()
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[twice < 0.0] = triangles[twice < 0.0][:, [0, 2, 1]]
    return Adapted(
        points,
        triangles[np.abs(twice) > 1e-14],
        mesh.t.shape[1],
        float(np.sqrt((estimates**2).sum())),
        residual,
        steps,
    )


def _estimate(
    mesh: MeshTri, f: Callable[[np.ndarray, np.ndarray], np.ndarray], k: tuple[float, float]
) -> tuple[np.ndarray, float]:
    """(m,) residual estimates: root of half the sum of h |[k grad u . n]|^2 over the edges."""

    @BilinearForm
    def stiffness(u, v, _):
        return k[0] * u.grad[0] * v.grad[0] + k[1] * u.grad[1] * v.grad[1]

    @Functional
    def jump(w):
        d = w["one"].grad - w["two"].grad
        return w.h * (k[0] * d[0] * w.n[0] + k[1] * d[1] * w.n[1]) ** 2

    element = ElementTriP1()
    basis = Basis(mesh, element)
    matrix = stiffness.assemble(basis)
    known = mesh.boundary_nodes()
    u = np.zeros(basis.N)
    u[known] = f(*mesh.p[:, known])
    left, right, u, unknown = condense(matrix, np.zeros(basis.N), x=u, D=known)
    u[unknown] = spsolve(left.tocsc(), right)
    residual = float(np.linalg.norm(left @ u[unknown] - right) / np.linalg.norm(right))

    sides = [InteriorFacetBasis(mesh, element, side=i) for i in (0, 1)]
    squares = np.zeros(mesh.facets.shape[1])
    squares[sides[0].find] = jump.elemental(
        sides[0], one=sides[0].interpolate(u), two=sides[1].interpolate(u)
    )
    return np.sqrt(0.5 * squares[mesh.t2f].sum(axis=0)), residual
