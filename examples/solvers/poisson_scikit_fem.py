"""scikit-fem: Poisson's equation with values on two named sides and slopes on the other two."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from poisson import meshes
from study import Absent, Study, show

import equimesh
import equimesh_adapters

__all__ = ["study"]


def study(folder: Path) -> Study:
    """L2 errors on three meshes, which travel as ``.msh`` files."""
    counts, errors = [], []
    for result in meshes():
        path = folder / "square.msh"
        equimesh_adapters.save(path, result)
        counts.append(len(result.triangles))
        errors.append(_solve(path, result))
    return Study("scikit-fem: Poisson, L2 error", tuple(counts), tuple(errors))


def _solve(path: Path, result: equimesh.Result) -> float:
    try:
        import skfem
        from skfem.helpers import dot, grad
    except ImportError:
        raise Absent("scikit-fem is not installed: pip install 'equimesh[paper]'") from None

    mesh = skfem.MeshTri.load(path)
    for name in result.boundary.names:  # every side came along, edge by edge
        sides = mesh.facets[:, mesh.boundaries[name]]
        assert sides.shape[1] == len(result.boundary.edges_of(name))

    def exact(x):
        return np.exp(2.0 * x[0]) * np.sin(3.0 * x[1])

    basis = skfem.Basis(mesh, skfem.ElementTriP1(), intorder=6)
    stiffness = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(basis)
    load = skfem.LinearForm(lambda v, w: 5.0 * exact(w.x) * v).assemble(basis)
    right = basis.boundary("right")
    load += skfem.LinearForm(lambda v, w: 2.0 * exact(w.x) * v).assemble(right)
    top = basis.boundary("top")
    slope = skfem.LinearForm(lambda v, w: 3.0 * np.exp(2.0 * w.x[0]) * np.cos(3.0 * w.x[1]) * v)
    load += slope.assemble(top)
    fixed = basis.get_dofs({"left", "bottom"})
    solution = skfem.solve(*skfem.condense(stiffness, load, x=exact(mesh.p), D=fixed))
    square = skfem.Functional(lambda w: (w["u"] - exact(w.x)) ** 2)
    return float(np.sqrt(square.assemble(basis, u=solution)))


if __name__ == "__main__":
    show(study)
