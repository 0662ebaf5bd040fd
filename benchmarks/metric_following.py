"""Do Gmsh's BAMG and Mmg follow the metrics that equimesh hands them?

    python benchmarks/metric_following.py

Both get the error metric of a surface (``equimesh.Metric.of``), once: BAMG as a background field of
tensors, Mmg as ``.mesh`` and ``.sol`` of equimesh's own mesh for that surface, every triangle
divided into four. Lengths of all edges, the border's too, are integrated in the very metric that
was handed over, not in its interpolation.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from rows import Row, table

import equimesh
from equimesh_adapters import gmsh as gmsh_adapter
from equimesh_adapters import medit

SHARE = 0.95
BOX = (0.0, 0.0, 1.0, 1.0)
FRANKE = (
    "3/4*exp(-((9*x-2)**2 + (9*y-2)**2)/4) + 3/4*exp(-(9*x+1)**2/49 - (9*y+1)/10)"
    " + 1/2*exp(-((9*x-7)**2 + (9*y-3)**2)/4) - 1/5*exp(-(9*x-4)**2 - (9*y-7)**2)"
)
CASES = {
    "convex exp(2x + y) + (x - 2y)^2": ("exp(2*x+y) + (x-2*y)**2", 1e-3),
    "Franke": (FRANKE, 1e-3),
    "stretched saddle exp(5x) sin(5 sqrt(10) y)": ("exp(5*x)*sin(5*sqrt(10)*y)", 0.1),
    "peaks": (
        "3*(1-6*x+3)**2*exp(-(6*x-3)**2 - (6*y-2)**2)"
        " - 10*((6*x-3)/5 - (6*x-3)**3 - (6*y-3)**5)*exp(-(6*x-3)**2 - (6*y-3)**2)"
        " - exp(-(6*x-2)**2 - (6*y-3)**2)/3",
        0.02,
    ),
}  # fmt: skip


def share(metric: equimesh.Metric, points: np.ndarray, triangles: np.ndarray) -> float:
    """Of all edges, those with a length in the metric from 1/sqrt 2 to sqrt 2."""
    edges = np.unique(
        np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0
    )
    lengths = metric.lengths(points[edges[:, 0], :2], points[edges[:, 1], :2])
    return float(np.mean((lengths >= 0.5**0.5) & (lengths <= 2.0**0.5)))


def bamg(metric: equimesh.Metric) -> tuple[np.ndarray, np.ndarray]:
    """Gmsh's own mesh of the unit square, in one run."""
    import gmsh

    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(BOX[0], BOX[1], 0.0, BOX[2] - BOX[0], BOX[3] - BOX[1])
        gmsh.model.occ.synchronize()
        gmsh_adapter.to_background(metric)
        gmsh.model.mesh.generate(2)
        field = gmsh_adapter.to_field()
        return field.points, field.triangles
    finally:
        gmsh.finalize()


def mmg(
    metric: equimesh.Metric, start: equimesh.Result, folder: Path
) -> tuple[np.ndarray, np.ndarray]:
    """What Mmg makes of the files that equimesh writes."""
    import mmgpy

    grid, tensors = medit.write_background(folder / "in.mesh", metric, start)
    run = mmgpy.MmgMesh2D(str(grid))
    run.load_sol(str(tensors))
    run.remesh(hgrad=-1.0, verbose=-1)
    run.save(str(folder / "out.mesh"))
    mesh = medit.read_mesh(folder / "out.mesh")
    return mesh.points, mesh.triangles


def rows() -> list[Row]:
    """One for each metric and mesher."""
    found = []
    for name, (surface, tol) in CASES.items():
        metric = equimesh.Metric.of(surface, tol, BOX)
        start = equimesh.remesh(surface, tol, BOX, effort="fast")
        with tempfile.TemporaryDirectory() as folder:
            meshes = {
                "BAMG on the background field": bamg(metric),
                "Mmg on .mesh and .sol": mmg(metric, start, Path(folder)),
            }
        for tool, (points, triangles) in meshes.items():
            part = share(metric, points, triangles)
            found.append(
                Row(
                    f"{tool}, metric of {name}: edges of length 1/sqrt 2 to sqrt 2",
                    f"{100.0 * part:.1f} % ({len(triangles):,} triangles)",
                    f"at least {100.0 * SHARE:.0f} %",
                    part >= SHARE,
                )
            )
    return found


if __name__ == "__main__":
    lines = [(row.what, row.figure, row.asked, row.verdict) for row in rows()]
    print(table(("what", "figure", "asked", "met"), lines))
    raise SystemExit(any(line[3] == Row("", "", "", False).verdict for line in lines))
