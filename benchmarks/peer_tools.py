"""Mmg2d, BAMG, Gmsh and greedy insertion, searched for their fewest triangles within a tolerance.

The first three follow a metric: they get |H| / (c tol) from exact Hessians, at their own vertices
in several passes, and c is searched until the largest true error keeps the tolerance. Mmg2d runs
without and with a limit on the growth of edges, BAMG without and with one on the ratio of
neighbours, each in a search of its own. Greedy insertion (pydelatin) knows samples only: its own
tolerance is searched. The best mesh counts.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import independent
import numpy as np
from functions import Case

__all__ = ["TOOLS", "Found", "missing", "searched"]

Array = np.ndarray
Mesh = tuple[Array, Array]  # points (n, 2), triangles (m, 3)

WARM, FRESH, GMSH = 5, 4, 3  # passes for one c: from the last mesh, from a grid
STEPS = 5  # secant steps towards the largest c
AROUND = (1.0, 0.88, 0.94, 1.06, 1.12, 1.2, 1.3)  # errors are noisy: tried around the best c
LOWER = (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2)  # where none of those keeps the tolerance
PATIENCE = 20.0  # seconds for a pass of another program; one that ends takes far less than one
FAILURES = 4  # passes in a row after which a search ends with the best mesh so far
SAMPLES = 1025  # a side, for greedy insertion


@dataclass
class Found:
    """The best mesh of a search: its triangles, its error over the tolerance, and the cost.

    ``seconds`` are those of the tool in the search that found the mesh, ``one`` those of the pass
    that made it; measuring errors is not counted. ``triangles`` is 0 where nothing kept the
    tolerance.
    """

    triangles: int = 0
    error: float = np.nan
    seconds: float = 0.0
    one: float = np.nan
    passes: int = 0
    faults: list[str] = field(default_factory=list)


def missing(tool: str) -> str:
    """What must be installed for a tool; empty if it is there."""
    if tool == "bamg":
        return "" if shutil.which("FreeFem++") else "FreeFem++"
    module = {"mmg2d": "mmgpy", "gmsh": "gmsh", "pydelatin": "pydelatin"}[tool]
    return "" if find_spec(module) else module


def metric(case: Case, points: Array, unit: float) -> Array:
    """(n, 3) m11, m12, m22 of |H| / unit; no edge longer than half of the box."""
    xx, xy, yy = (
        np.broadcast_to(part, len(points)) for part in case.jet(points[:, 0], points[:, 1])[3:]
    )
    values, vectors = np.linalg.eigh(np.stack([xx, xy, xy, yy], 1).reshape(-1, 2, 2))
    least = (0.5 * (case.box[2] - case.box[0])) ** -2.0
    values = np.maximum(np.abs(values) / unit, least)
    m = np.einsum("nik,nk,njk->nij", vectors, values, vectors)
    return np.stack([m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]], 1)


def grid(box: tuple[float, ...], n: int) -> Mesh:
    """A square grid, n cells a side, each cut in two."""
    xmin, ymin, xmax, ymax = box
    x, y = np.meshgrid(np.linspace(xmin, xmax, n + 1), np.linspace(ymin, ymax, n + 1))
    corner = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (
        part.ravel()
        for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x.ravel(), y.ravel()], 1), triangles


def tidy(mesh: Mesh, box: tuple[float, ...]) -> Mesh:
    """Used points only, on the sides to the last bit, counter-clockwise."""
    points, triangles = mesh
    used, index = np.unique(triangles, return_inverse=True)
    points, triangles = points[used].copy(), index.reshape(-1, 3)
    near = 1e-9 * max(box[2] - box[0], box[3] - box[1])
    for axis, level in ((0, box[0]), (0, box[2]), (1, box[1]), (1, box[3])):
        points[np.abs(points[:, axis] - level) < near, axis] = level
    turned = independent.areas(points, triangles) < 0.0
    return points, np.where(turned[:, None], triangles[:, [0, 2, 1]], triangles)


def mmg2d_pass(mesh: Mesh, m: Array, box: tuple[float, ...], growth: float) -> tuple[Mesh, float]:
    """``growth`` of edges from one to the next, -1 for any."""
    import mmgpy

    points, triangles = mesh
    run = mmgpy.MmgMesh2D(np.ascontiguousarray(points), np.ascontiguousarray(triangles, np.int32))
    run["tensor"] = m
    started = time.perf_counter()
    run.remesh(verbose=-1, hgrad=growth)
    seconds = time.perf_counter() - started
    return (np.array(run.get_vertices())[:, :2], np.array(run.get_triangles(), np.int64)), seconds


_SCRIPT = """verbosity=0;
mesh Th=readmesh("in.msh");
fespace Vh(Th,P1); Vh m11,m12,m22;
{ ifstream i("m.txt");
  for(int k=0;k<Th.nv;k++){ real a,b,c; i>>a; i>>b; i>>c; m11[][k]=a; m12[][k]=b; m22[][k]=c; } }
real t=clock();
mesh Tn=adaptmesh(Th,m11,m12,m22,IsMetric=1,iso=false,ratio=RATIO,anisomax=1e6,hmin=1e-8,hmax=1e3,
  nbvx=400000,splitin2=false,splitpbedge=false,maxsubdiv=10,inquire=false);
{ ofstream o("t.txt"); o << clock()-t << endl; }
savemesh(Tn,"out.msh");
"""


def bamg_pass(mesh: Mesh, m: Array, box: tuple[float, ...], ratio: int) -> tuple[Mesh, float]:
    """Through FreeFem++; seconds are those of its ``adaptmesh`` alone. ``ratio`` 0: any."""
    points, triangles = mesh
    edges = independent.boundary_edges(triangles)
    middle = 0.5 * (points[edges[:, 0]] + points[edges[:, 1]])
    gaps = np.abs(middle[:, [1, 0, 1, 0]] - np.array([box[1], box[2], box[3], box[0]]))
    side = gaps.argmin(axis=1) + 1
    at = np.zeros(len(points), int)
    at[edges[:, 0]] = side
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open(folder / "in.msh", "w", encoding="ascii") as out:
            out.write(f"{len(points)} {len(triangles)} {len(edges)}\n")
            np.savetxt(out, np.column_stack([points, at]), fmt="%.17g %.17g %d")
            np.savetxt(out, np.column_stack([triangles + 1, 0 * triangles[:, 0]]), fmt="%d")
            np.savetxt(out, np.column_stack([edges + 1, side]), fmt="%d")
        np.savetxt(folder / "m.txt", m, fmt="%.12g")
        (folder / "a.edp").write_text(_SCRIPT.replace("RATIO", str(ratio)), encoding="ascii")
        subprocess.run(
            ["FreeFem++", "-nw", "-v", "0", "a.edp"],
            cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True,
            timeout=PATIENCE,
        )  # fmt: skip
        seconds = float((folder / "t.txt").read_text())
        words = np.array((folder / "out.msh").read_text().split(), float)
    n, k = int(words[0]), int(words[1])
    rows = words[3 + 3 * n : 3 + 3 * n + 4 * k].reshape(-1, 4)
    return (words[3 : 3 + 3 * n].reshape(-1, 3)[:, :2], rows[:, :3].astype(np.int64) - 1), seconds


def gmsh_pass(mesh: Mesh, m: Array, box: tuple[float, ...]) -> tuple[Mesh, float]:
    """Its algorithm 7, with the metric as a view of tensors on the last mesh."""
    import gmsh

    points, triangles = mesh
    if not gmsh.isInitialized():
        gmsh.initialize(readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
    gmsh.clear()
    gmsh.model.add("box")
    corner = points[triangles]
    places = np.concatenate([corner, np.zeros((*corner.shape[:2], 1))], 2).transpose(0, 2, 1)
    tensor = np.zeros((len(points), 9))
    tensor[:, 0], tensor[:, 4], tensor[:, 8] = m[:, 0], m[:, 2], 1.0
    tensor[:, 1] = tensor[:, 3] = m[:, 1]
    rows = np.concatenate([places.reshape(-1, 9), tensor[triangles].reshape(-1, 27)], 1)
    view = gmsh.view.add("metric")
    gmsh.view.addListData(view, "TT", len(triangles), rows.ravel())
    xmin, ymin, xmax, ymax = box
    geo = gmsh.model.geo
    p = [geo.addPoint(*q, 0) for q in ((xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax))]
    lines = [geo.addLine(p[k], p[(k + 1) % 4]) for k in range(4)]
    geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    field = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)
    options = {
        "General.Terminal": 0, "General.NumThreads": 1, "Mesh.MeshSizeExtendFromBoundary": 0,
        "Mesh.MeshSizeFromPoints": 0, "Mesh.MeshSizeFromCurvature": 0, "Mesh.Algorithm": 7,
        "Mesh.SmoothRatio": 1.8, "Mesh.AnisoMax": 1e33, "Mesh.MeshSizeMin": 0,
        "Mesh.MeshSizeMax": 1e22,
    }  # fmt: skip
    for name, value in options.items():
        gmsh.option.setNumber(name, value)
    started = time.perf_counter()
    gmsh.model.mesh.generate(2)
    seconds = time.perf_counter() - started
    tags, places, _ = gmsh.model.mesh.getNodes()
    _, nodes = gmsh.model.mesh.getElementsByType(2)
    index = np.zeros(int(tags.max()) + 1, np.int64)
    index[tags.astype(int)] = np.arange(len(tags))
    return (places.reshape(-1, 3)[:, :2], index[nodes.astype(int)].reshape(-1, 3)), seconds


Pass = Callable[[Mesh, Array, tuple[float, ...]], tuple[Mesh, float]]


@dataclass
class _Search:
    """Meshes for a case and a tolerance, made by passes for one c after another."""

    case: Case
    tol: float
    step: Pass
    passes: int
    fresh: bool  # from a grid each time
    found: Found = field(default_factory=Found)
    best: float = np.nan  # its c
    mesh: Mesh | None = None
    failed: int = 0  # passes in a row

    def start(self) -> Mesh:
        n = int(np.clip(0.7 * (0.5 * self.case.least(self.tol, 300)) ** 0.5, 10, 60))
        return grid(self.case.box, n)

    def attempt(self, c: float) -> float:
        """The largest error over the tolerance after all passes for ``c``.

        NaN if one fails, or if too many have failed in a row.
        """
        if self.failed >= FAILURES:
            return np.nan
        mesh = self.start() if self.fresh or self.mesh is None else self.mesh
        error = np.nan
        for _ in range(self.passes):
            try:
                m = metric(self.case, mesh[0], c * self.tol)
                raw, seconds = self.step(mesh, m, self.case.box)
            except Exception as problem:  # noqa: BLE001 - whatever another program dies of
                self.found.faults.append(str(problem)[:80])
                self.mesh = None
                self.failed += 1
                return np.nan
            self.failed = 0
            mesh = tidy(raw, self.case.box)
            self.found.seconds += seconds
            self.found.passes += 1
            error = self.judge(mesh, c, seconds)
        self.mesh = mesh
        return error

    def judge(self, mesh: Mesh, c: float, seconds: float) -> float:
        points, triangles = mesh
        error = independent.function_error(self.case, points, triangles) / self.tol
        fewest = self.found.triangles
        if error <= 1.0 and (not fewest or len(triangles) < fewest):
            fault = independent.cover_fault(points, triangles, self.case.box)
            if fault:
                self.found.faults.append(fault)
            else:
                self.found.triangles, self.found.error = len(triangles), error
                self.found.one, self.best = seconds, c
        return error

    def run(self) -> Found:
        c = 4.0
        for _ in range(STEPS):
            error = self.attempt(c)
            if np.isfinite(error) and abs(np.log(error)) < 0.04:
                break
            c *= np.clip(1.0 / error, 0.25, 4.0) if np.isfinite(error) else 0.8
        middle = self.best if self.found.triangles else c
        for factor in AROUND:
            self.attempt(middle * factor)
        for factor in LOWER:
            if self.found.triangles:
                break
            self.attempt(middle * factor)
        return self.found


def greedy(case: Case, tol: float) -> Found:
    """Delatin on samples of a square grid, its tolerance lowered until the true error fits."""
    from pydelatin import Delatin

    xmin, ymin, xmax, ymax = case.box
    x, y = np.linspace(xmin, xmax, SAMPLES), np.linspace(ymin, ymax, SAMPLES)
    heights = case(*np.meshgrid(x, y)).astype(np.float32)
    found, own = Found(), tol
    for k in range(10):
        started = time.perf_counter()
        made = Delatin(heights, max_error=own)
        corners, triangles = np.array(made.vertices, float), np.array(made.triangles, np.int64)
        seconds = time.perf_counter() - started
        found.seconds += seconds
        found.passes += 1
        column, row = corners[:, 0].astype(int), (SAMPLES - 1 - corners[:, 1]).astype(int)
        points, triangles = tidy((np.stack([x[column], y[row]], 1), triangles), case.box)
        error = independent.function_error(case, points, triangles) / tol
        fits = error <= 1.0 and not independent.cover_fault(points, triangles, case.box)
        if fits and (not found.triangles or len(triangles) < found.triangles):
            found.triangles, found.error, found.one = len(triangles), error, seconds
        if 0.97 < error <= 1.0:
            break
        own *= float(np.clip((0.985 - 0.01 * k) / error, 0.3, 2.0))
    return found


# Passes for one c, from a grid each time or from the last mesh, and the ways to make one. BAMG
# keeps vertices of a mesh that is too fine.
_FOLLOWERS: dict[str, tuple[int, bool, tuple[Pass, ...]]] = {
    "mmg2d": (WARM, False, (partial(mmg2d_pass, growth=-1.0), partial(mmg2d_pass, growth=2.0))),
    "bamg": (FRESH, True, (partial(bamg_pass, ratio=0), partial(bamg_pass, ratio=2))),
    "gmsh": (GMSH, False, (gmsh_pass,)),
}
TOOLS = (*_FOLLOWERS, "pydelatin")


def searched(tool: str, case: Case, tol: float) -> Found:
    """The best that a tool does on a case."""
    if tool == "pydelatin":
        return greedy(case, tol)
    passes, fresh, ways = _FOLLOWERS[tool]
    made = [_Search(case, tol, way, passes, fresh).run() for way in ways]
    best = min(made, key=lambda found: found.triangles or math.inf)
    return replace(best, faults=[fault for found in made for fault in found.faults])
