"""For the Python that has dolfinx: read a ``.msh`` file, tell its tags, solve Poisson's problem.

    /usr/bin/python3 in_dolfinx.py SQUARE.msh GMSH.py OUT.npz

``GMSH.py`` is the Gmsh module of another Python, with which dolfinx reads the file. ``OUT.npz``
gets the L2 error and, under the name of every physical group of curves, (k, 3) middles of its
facets.
"""

import importlib.util
import sys

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem
from mpi4py import MPI


def main(square: str, module: str, out: str) -> None:
    spec = importlib.util.spec_from_file_location("gmsh", module)
    gmsh = sys.modules["gmsh"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(gmsh)
    from dolfinx.io import gmshio

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(square)
    groups = {gmsh.model.getPhysicalName(1, tag): tag for _, tag in gmsh.model.getPhysicalGroups(1)}
    domain, _, tags = gmshio.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
    gmsh.finalize()
    facets = {name: tags.find(tag).astype(np.int32) for name, tag in groups.items()}
    middles = {name: mesh.compute_midpoints(domain, 1, facets[name]) for name in groups}
    np.savez(out, error=_solve(domain, tags, groups, facets), **middles)


def _solve(domain, tags, groups, facets) -> float:
    """The problem of ``poisson.py``."""
    space = fem.FunctionSpace(domain, ("Lagrange", 1))
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    x, y = ufl.SpatialCoordinate(domain)
    exact = ufl.exp(2 * x) * ufl.sin(3 * y)
    side = ufl.Measure("ds", domain, subdomain_data=tags)
    load = 5 * exact * v * ufl.dx + 2 * exact * v * side(groups["right"])
    load += 3 * ufl.exp(2 * x) * ufl.cos(3 * y) * v * side(groups["top"])
    given = fem.Function(space)
    given.interpolate(lambda x: np.exp(2 * x[0]) * np.sin(3 * x[1]))
    sides = np.concatenate([facets["left"], facets["bottom"]])
    fixed = fem.dirichletbc(given, fem.locate_dofs_topological(space, 1, sides))
    direct = {"ksp_type": "preonly", "pc_type": "lu"}
    stiffness = ufl.dot(ufl.grad(u), ufl.grad(v)) * ufl.dx
    solution = LinearProblem(stiffness, load, [fixed], petsc_options=direct).solve()
    return float(np.sqrt(fem.assemble_scalar(fem.form((solution - exact) ** 2 * ufl.dx))))


if __name__ == "__main__":
    main(*sys.argv[1:])
