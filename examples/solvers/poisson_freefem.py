"""FreeFEM: Poisson's equation with values on two named sides and slopes on the other two."""

from __future__ import annotations

from pathlib import Path

from poisson import meshes
from study import Study, run, show

import equimesh
from equimesh_adapters.medit import from_result, write_mesh

__all__ = ["study"]

SCRIPT = Path(__file__).with_name("poisson.edp")


def study(folder: Path) -> Study:
    """L2 errors on three meshes, which travel as plane ``.mesh`` files with numbers for names."""
    counts, errors = [], []
    for result in meshes():
        counts.append(len(result.triangles))
        errors.append(_solve(folder / "square.mesh", result))
    return Study("FreeFEM: Poisson, L2 error", tuple(counts), tuple(errors))


def _solve(path: Path, result: equimesh.Result) -> float:
    mesh = from_result(result, dimension=2)
    write_mesh(path, mesh)
    number = {name: str(reference) for reference, name in mesh.names.items()}
    sides = [number[name] for name in ("bottom", "right", "top", "left")]
    command = ["FreeFem++", "-v", "0", "-nw", SCRIPT, path.name, *sides]
    printed = run("freefem++", *command, cwd=path.parent)
    return float(printed.rsplit("error", 1)[1])


if __name__ == "__main__":
    show(study)
