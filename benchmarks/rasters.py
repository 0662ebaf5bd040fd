"""equimesh, greedy insertion and decimation on real rasters: one table, measured in one run.

    python benchmarks/rasters.py [--only jacksboro volcano ...] [--tools equimesh pydelatin ...]
                                 [--efforts fast balanced best] [--bounds surface samples]
                                 [--fits interpolate best] [--data FOLDER] [--percents 1 2]

Errors are measured here, in units of the tolerance: at the samples, and on the bilinear surface at
8 x 8 points a cell. Decimation has no tolerance: its number of triangles is searched until the
error at the samples fits, with the best of three scales of heights, which quadrics depend on.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from rows import table

import equimesh

Array = np.ndarray
Mesh = tuple[Array, Array]

PER_CELL = 8
SEARCHES = 9
SCALES = (0.01, 0.1, 1.0)  # of the tolerance, in cells
HEAD = (
    "raster", "tool", "triangles", "of pydelatin", "at samples", "between", "uncovered",
    "over gaps", "angle 5 %", "median", "seconds",
)  # fmt: skip


class Case(NamedTuple):
    """A raster of the table with its tolerances in per cent of the range."""

    name: str
    file: str
    key: str
    percents: tuple[float, ...]
    nodata: float = np.nan


CASES = (
    Case("volcano", "volcano.npz", "z", (1, 2)),
    Case("topobathy", "topobathy.npz", "topo", (1, 2)),
    Case("jacksboro", "jacksboro_fault_dem.npz", "elevation", (1, 2, 5)),
    Case("rhine", "rhine_elv.npz", "z", (1,), -9999.0),
    Case("srtm", "srtm_ref1000.npz", "z", (1,)),
)


class Measured(NamedTuple):
    """Largest errors, and samples on the wrong side of the mesh's border."""

    at_samples: float
    between: float
    uncovered: int
    over_gaps: int


def measured(heights: Array, mesh: Mesh) -> Measured:
    """A mesh in (column, row) against heights (rows, columns), NaN where there is none.

    Uncovered are samples of cells with four samples, over gaps are missing samples.
    """
    points, triangles = mesh
    seen = np.zeros(heights.shape, bool)
    samples, between = _largest(
        heights, np.ascontiguousarray(points, float), np.asarray(triangles, np.int64), seen
    )
    there = np.isfinite(heights)
    cell = there[:-1, :-1] & there[1:, :-1] & there[:-1, 1:] & there[1:, 1:]
    around = np.pad(cell, 1)
    used = around[:-1, :-1] | around[1:, :-1] | around[:-1, 1:] | around[1:, 1:]
    return Measured(
        samples, between, int(np.count_nonzero(used & ~seen)), int(np.count_nonzero(seen & ~there))
    )


@njit(cache=True)
def _largest(heights: Array, points: Array, triangles: Array, seen: Array) -> tuple[float, float]:
    """Every triangle against the points of a fine grid in it, its rim with a margin of 1e-9."""
    rows, columns = heights.shape
    n = PER_CELL
    at_samples = between = 0.0
    for t in range(len(triangles)):
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area == 0.0:
            continue
        x0, x1 = min(a[0], b[0], c[0]) * n, max(a[0], b[0], c[0]) * n
        y0, y1 = min(a[1], b[1], c[1]) * n, max(a[1], b[1], c[1]) * n
        for row in range(max(0, np.ceil(y0 - 1e-6)), min((rows - 1) * n, np.floor(y1 + 1e-6)) + 1):
            for column in range(
                max(0, np.ceil(x0 - 1e-6)), min((columns - 1) * n, np.floor(x1 + 1e-6)) + 1
            ):
                x, y = column / n, row / n
                p = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
                q = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
                if min(p, q, 1.0 - p - q) < -1e-9:
                    continue
                j, i = min(row // n, rows - 2), min(column // n, columns - 2)
                v, u = y - j, x - i
                sample = row % n == 0 and column % n == 0
                z = p * a[2] + q * b[2] + (1.0 - p - q) * c[2]
                if sample:
                    seen[row // n, column // n] = True
                    e = abs(heights[row // n, column // n] - z)
                    if e > at_samples:  # false for NaN
                        at_samples = e
                    if e > between:
                        between = e
                low = heights[j, i] + u * (heights[j, i + 1] - heights[j, i])
                high = heights[j + 1, i] + u * (heights[j + 1, i + 1] - heights[j + 1, i])
                e = abs(low + v * (high - low) - z)
                if e > between:
                    between = e
    return at_samples, between


def greedy(heights: Array, tol: float) -> Mesh:
    """pydelatin, which counts rows from below."""
    from pydelatin import Delatin

    tin = Delatin(heights.astype(np.float32), max_error=tol)
    points = np.array(tin.vertices, float)
    points[:, 1] = len(heights) - 1 - points[:, 1]
    return points, np.asarray(tin.triangles, np.int64)


def grid_mesh(heights: Array) -> Mesh:
    """Two triangles a cell, cells with missing samples left out."""
    rows, columns = heights.shape
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    number = np.arange(heights.size).reshape(heights.shape)
    a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    c, d = number[1:, 1:].ravel(), number[1:, :-1].ravel()
    triangles = np.vstack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    z = heights.ravel()
    triangles = triangles[np.isfinite(z[triangles]).all(axis=1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    points = np.column_stack([x.ravel(), y.ravel(), z])[used]
    return points, triangles.reshape(-1, 3)


def by_pymeshlab(mesh: Mesh, count: int) -> Mesh:
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh[0], mesh[1].astype(np.int32)))
    meshes.meshing_decimation_quadric_edge_collapse(
        targetfacenum=count, preserveboundary=True, optimalplacement=True
    )
    found = meshes.current_mesh()
    return found.vertex_matrix(), found.face_matrix().astype(np.int64)


def by_fast_simplification(mesh: Mesh, count: int) -> Mesh:
    import fast_simplification

    points, triangles = fast_simplification.simplify(
        mesh[0], mesh[1].astype(np.int32), target_count=count
    )
    return np.asarray(points, float), np.asarray(triangles, np.int64)


SIMPLIFIERS = {"pymeshlab": by_pymeshlab, "fast-simplification": by_fast_simplification}


def decimated(simplify: Callable[[Mesh, int], Mesh], heights: Array, tol: float) -> Mesh:
    """The coarsest mesh found that keeps ``tol`` at the samples, by bisection of the logarithm."""
    points, triangles = grid_mesh(heights)
    best = points, triangles
    for cells in SCALES:
        units = np.array([1.0, 1.0, cells / tol])
        low, high = 4.0, float(len(triangles))
        for _ in range(SEARCHES):
            count = round((low * high) ** 0.5)
            corners, faces = simplify((points * units, triangles), count)
            found = corners / units, faces
            if measured(heights, found).at_samples <= tol:
                high = count
                best = min(best, found, key=lambda mesh: len(mesh[1]))
            else:
                low = count
    return best


def by_equimesh(heights: Array, tol: float, options: dict[str, str]) -> Mesh:
    result = equimesh.remesh(heights, tol, **options)
    if not result.status.ok:
        raise equimesh.InputError(result.status.value)
    return result.points, result.triangles


def lines(case: Case, folder: Path, options: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    """Rows of the table for one raster."""
    given = np.load(folder / case.file)[case.key].astype(float)
    heights = np.where(given == case.nodata, np.nan, given)
    for percent in case.percents:
        tol = 0.01 * percent * float(np.nanmax(heights) - np.nanmin(heights))
        tools: dict[str, Callable[[], Mesh]] = {}
        if "pydelatin" in options.tools and np.isfinite(heights).all():
            tools["pydelatin"] = partial(greedy, heights, tol)
        if "equimesh" in options.tools:
            for fit in options.fits:
                for bound in options.bounds:
                    for effort in options.efforts:
                        how = {"effort": effort, "bound": bound, "fit": fit}
                        name = f"equimesh {effort}, {bound}" + ", best fit" * (fit == "best")
                        tools[name] = partial(by_equimesh, heights, tol, how)
        for name in SIMPLIFIERS:
            if name in options.tools:
                tools[name] = partial(decimated, SIMPLIFIERS[name], heights, tol)
        base = None
        for name, make in tools.items():
            started = time.perf_counter()
            try:
                mesh = make()
            except equimesh.InputError as error:
                print(f"{case.name} at {percent:g} %, {name}: {error}", flush=True)
                continue
            seconds = time.perf_counter() - started
            count = len(mesh[1])
            base = count if name == "pydelatin" else base
            found = measured(heights, mesh)
            angles = equimesh.Profile(np.zeros(count), np.zeros(count), *mesh).angles
            row = (
                f"{case.name} at {percent:g} %", name, f"{count:,}",
                f"{count / base:.3f}" if base else "", f"{found.at_samples / tol:.4f}",
                f"{found.between / tol:.4f}", str(found.uncovered), str(found.over_gaps),
                f"{np.quantile(angles, 0.05):.1f}", f"{np.median(angles):.1f}", f"{seconds:.1f}",
            )  # fmt: skip
            print("  ".join(row), flush=True)
            yield row


def main() -> None:
    names = [case.name for case in CASES]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = {
        "only": names,
        "tools": ["pydelatin", "equimesh", "pymeshlab", "fast-simplification"],
        "efforts": ["fast", "balanced", "best"],
        "bounds": ["surface", "samples"],
        "fits": ["interpolate", "best"],
    }
    for name, allowed in choices.items():
        parser.add_argument(f"--{name}", nargs="+", choices=allowed, default=allowed)
    parser.add_argument("--data", type=Path, default=Path(), help="the folder with the .npz files")
    parser.add_argument("--percents", nargs="+", type=float, help="instead of the table's own")
    options = parser.parse_args()
    small = np.sin(np.arange(900.0) ** 2).reshape(30, 30)
    for bound in options.bounds:
        equimesh.remesh(small, 0.1, bound=bound, effort="fast")  # compiles
    rows = []
    for case in CASES:
        if case.name in options.only:
            rows += lines(
                case._replace(percents=tuple(options.percents or case.percents)),
                options.data, options,
            )  # fmt: skip
    print("\n" + table(HEAD, rows))


if __name__ == "__main__":
    main()
