"""equimesh and decimation on a range scan at the same largest vertical error: one table.

    python benchmarks/scans.py [--percents 1 0.5 0.2] [--efforts fast balanced best]

The error is measured here at all vertices of the scan over the mesh and at points of the mesh over
the scan, in units of the tolerance, a share of the range of heights. Decimation has no tolerance:
its number of triangles is searched until that error fits; its borders may shrink or overhang
unpunished.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial

import independent
import numpy as np
import trimesh
from commands import range_scan_file
from rasters import SIMPLIFIERS, Mesh
from rows import table

import equimesh

SEARCHES = 10
HEAD = ("tolerance", "tool", "triangles", "of the better decimation", "error", "seconds")


def largest_error(scan: Mesh, mesh: Mesh) -> float:
    """Vertical, at the scan's vertices and at 4 subdivisions of the mesh, where both are."""
    points, triangles = scan
    there = independent.interpolated(*mesh, points[:, 0], points[:, 1]) - points[:, 2]
    at = independent.samples_in(*mesh, 4)
    here = independent.interpolated(points, triangles, at[:, 0], at[:, 1]) - at[:, 2]
    return float(max(np.nanmax(np.abs(there)), np.nanmax(np.abs(here))))


def decimated(simplify: Callable[[Mesh, int], Mesh], scan: Mesh, tol: float) -> Mesh:
    """The coarsest mesh found that keeps ``tol``, by bisection of the logarithm."""
    best, low, high = scan, 50.0, float(len(scan[1]))
    for _ in range(SEARCHES):
        count = round((low * high) ** 0.5)
        found = simplify(scan, count)
        if largest_error(scan, found) <= tol:
            high, best = count, min(best, found, key=lambda mesh: len(mesh[1]))
        else:
            low = count
    return best


def by_equimesh(surface: equimesh.Surface, tol: float, effort: str) -> Mesh:
    result = equimesh.remesh(surface, tol, effort=effort)
    if not result.status.ok:
        raise equimesh.InputError(result.status.value)
    return result.points, result.triangles


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--percents", nargs="+", type=float, default=[1.0, 0.5, 0.2])
    efforts = ["fast", "balanced", "best"]
    parser.add_argument("--efforts", nargs="+", choices=efforts, default=efforts)
    options = parser.parse_args()
    path = range_scan_file()
    if path is None:
        print("pymeshlab, which brings the scan, is not installed", file=sys.stderr)
        return 1
    read = trimesh.load(path, process=False)
    surface = equimesh.Surface(np.array(read.vertices, float), np.array(read.faces))
    scan = surface.points, surface.triangles
    by_equimesh(surface, 0.2 * np.ptp(scan[0][:, 2]), "fast")  # compiles
    rows = []
    for percent in options.percents:
        tol = 0.01 * percent * float(np.ptp(scan[0][:, 2]))
        tools = {name: partial(decimated, way, scan, tol) for name, way in SIMPLIFIERS.items()}
        for effort in options.efforts:
            tools[f"equimesh {effort}"] = partial(by_equimesh, surface, tol, effort)
        counts: list[int] = []
        for name, make in tools.items():
            started = time.perf_counter()
            mesh = make()
            seconds = time.perf_counter() - started
            counts.append(len(mesh[1]))
            better = min(counts[: len(SIMPLIFIERS)])
            share = "" if name in SIMPLIFIERS else f"{counts[-1] / better:.3f}"
            error = largest_error(scan, mesh) / tol
            row = (
                f"{percent:g} %",
                name,
                f"{counts[-1]:,}",
                share,
                f"{error:.4f}",
                f"{seconds:.1f}",
            )
            print("  ".join(row), flush=True)
            rows.append(row)
    print("\n" + table(HEAD, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
