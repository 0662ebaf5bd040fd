"""dolfinx: tags of a ``.msh`` file compared edge by edge, and Poisson's equation solved with them.

Debian's dolfinx belongs to the system's Python, which runs ``in_dolfinx.py``.
"""

from __future__ import annotations

import importlib.util
import subprocess
from pathlib import Path

import numpy as np
from poisson import meshes
from study import Absent, Study, run, show

import equimesh
import equimesh_adapters

__all__ = ["study"]

PYTHON = "/usr/bin/python3"
READER = Path(__file__).with_name("in_dolfinx.py")


def study(folder: Path) -> Study:
    """L2 errors on three meshes, after every side was found again with all its edges."""
    asked = [PYTHON, "-c", "import dolfinx, petsc4py"]
    if subprocess.run(asked, capture_output=True, check=False).returncode:
        raise Absent(f"{PYTHON} has no dolfinx: apt-get install python3-dolfinx")
    gmsh = importlib.util.find_spec("gmsh")
    if gmsh is None or gmsh.origin is None:
        raise Absent("Gmsh is not installed: pip install 'equimesh[gmsh]'")
    counts, errors = [], []
    for result in meshes():
        equimesh_adapters.save(folder / "square.msh", result)
        command = [PYTHON, READER, "square.msh", gmsh.origin, "found.npz"]
        run("python3-dolfinx", *command, cwd=folder)
        with np.load(folder / "found.npz") as found:
            for name in result.boundary.names:
                _compare(found[name], result, name)
            errors.append(float(found["error"]))
        counts.append(len(result.triangles))
    return Study("dolfinx: Poisson, L2 error", tuple(counts), tuple(errors))


def _compare(middles: np.ndarray, result: equimesh.Result, name: str) -> None:
    """The same edges, by their middles, whatever their order."""
    edges = result.points[result.boundary.edges_of(name), :2].mean(axis=1)
    assert len(middles) == len(edges), name
    there, here = (points[np.lexsort(points[:, :2].round(9).T)] for points in (middles, edges))
    assert np.abs(there[:, :2] - here).max() < 1e-12, name


if __name__ == "__main__":
    show(study)
