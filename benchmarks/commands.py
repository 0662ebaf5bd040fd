"""The acceptance checks that go through the installed command ``equimesh``."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import bad_input
import independent
import matplotlib
import numpy as np
from rows import Record, Row

__all__ = [
    "bad_inputs", "jacksboro", "odd_inputs", "paper", "range_scan", "range_scan_file", "same_bytes",
]  # fmt: skip

EXAMPLE_1 = ["--function", "exp(5*x)*sin(5*y)", "--domain", "0,0,1,1"]


def jacksboro() -> Path:
    """Elevations that ship with matplotlib."""
    return Path(matplotlib.get_data_path()) / "sample_data" / "jacksboro_fault_dem.npz"


def range_scan_file() -> Path | None:
    """A range scan that ships with pymeshlab; None where it is not installed."""
    found = importlib.util.find_spec("pymeshlab")
    for folder in (found and found.submodule_search_locations) or []:
        path = Path(folder) / "tests" / "sample_meshes" / "rangemaps" / "face000.ply"
        if path.is_file():
            return path
    return None


def _run(*words: object, **environment: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("equimesh", path=str(Path(sys.executable).parent))
    start = [program] if program else [sys.executable, "-m", "equimesh"]
    return subprocess.run(
        [*start, *map(str, words)],
        capture_output=True, text=True, check=False, env=os.environ | environment,
    )  # fmt: skip


@contextlib.contextmanager
def _empty_folder() -> Iterator[Path]:
    """A new folder to work in."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        yield Path(name)


def range_scan(record: Record) -> Iterator[Row]:
    """The scan at 1 % from the command line to .ply and .vtu, measured against the file."""
    import meshio
    import trimesh

    path = range_scan_file()
    what = "range scan face000.ply at 1 %"
    if path is None:
        yield Row(what, "pymeshlab, which brings the file, is not installed", "", None)
        return
    scan = trimesh.load(path, process=False)
    vertices, faces = np.array(scan.vertices, float), np.array(scan.faces)
    with _empty_folder():
        runs = [
            _run("remesh", path, f"out.{kind}", "--tol", "1%", "--report", f"{kind}.json")
            for kind in ("ply", "vtu")
        ]
        if any(run.returncode for run in runs):
            yield Row(what, " ".join(run.stderr.strip() for run in runs), "exit status 0", False)
            return
        figures = json.loads(Path("ply.json").read_text())
        ply, also = trimesh.load("out.ply", process=False), meshio.read("out.ply")
        vtu = meshio.read("out.vtu")
    points, triangles = np.array(ply.vertices, float), np.array(ply.faces)
    same = all(
        np.array_equal(points, other.points) and np.array_equal(triangles, other.cells[0].data)
        for other in (also, vtu)
    )
    yield Row(
        f"{what}: {len(faces):,} triangles to",
        f"{len(triangles):,} triangles, in trimesh and meshio",
        "the same mesh from .ply and .vtu",
        same and len(triangles) == figures["triangles"],
    )
    fault = independent.cover_fault(points, triangles, None)
    yield Row(f"{what}: conforming", fault or "yes", "yes", not fault)
    yield from _kept(what, vertices, faces, points, triangles, figures, record)


def _kept(
    what: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    points: np.ndarray,
    triangles: np.ndarray,
    figures: dict[str, float],
    record: Record,
) -> Iterator[Row]:
    tol = figures["tol"]
    used = vertices[np.unique(faces)]
    height = independent.interpolated(points, triangles, used[:, 0], used[:, 1])
    covered = np.isfinite(height)
    vertical = np.abs(height - used[:, 2])[covered]
    off = independent.distance_to_triangles(used[~covered], points, triangles)
    largest = max(vertical.max(), off.max(initial=0.0))
    yield Row(
        f"{what}: every one of {len(used):,} vertices ({(~covered).sum():,} outside)",
        f"within {largest / tol:.4f} of the tolerance",
        "at most 1",
        largest <= tol * (1 + 1e-9),
    )
    before, after = independent.boundary_edges(faces), independent.boundary_edges(triangles)
    share = np.linspace(0.0, 1.0, 5)[:-1, None, None]
    rim = (1 - share) * vertices[before[:, 0]] + share * vertices[before[:, 1]]
    gap = independent.distance_to_segments(
        rim.reshape(-1, 3), points[after[:, 0]], points[after[:, 1]]
    )
    yield Row(
        f"{what}: {len(before):,} boundary edges of the input, {len(after):,} of the result",
        f"within {gap.max() / tol:.4f} of the tolerance",
        "at most 1",
        gap.max() <= tol * (1 + 1e-9),
    )
    at = independent.samples_in(points, triangles, 20)
    surface = independent.interpolated(vertices, faces, at[:, 0], at[:, 1])
    found = max(float(np.nanmax(np.abs(surface - at[:, 2]))), float(vertical.max()))
    record.bound(what, figures["error_bound"], found)


def paper(quick: bool) -> Iterator[Row]:
    """The paper's tables by one command: time, repetition, and who needs fewest triangles."""
    if quick:
        return
    with _empty_folder():
        pages, seconds = [], []
        for name in "ab":
            started = time.perf_counter()
            done = _run("paper", name)
            seconds.append(time.perf_counter() - started)
            if done.returncode:
                yield Row("equimesh paper", done.stderr.strip(), "exit status 0", False)
                return
            pages.append(Path(name, "README.md").read_text(encoding="utf-8"))
    yield Row(
        "equimesh paper, Tables 1 to 4 with pictures",
        f"{max(seconds):.0f} s, {'the same' if pages[0] == pages[1] else 'other'} tables again",
        "at most 180 s, the same tables",
        max(seconds) <= 180.0 and pages[0] == pages[1],
    )
    strategies = ("equilateral (cover)", "adaptive finite elements", "equimesh (cover, certified)")
    counts = [_counts(pages[0], name) for name in strategies]
    yield Row(
        "triangles in Tables 1 to 4: equilateral; adaptive finite elements; certified",
        "; ".join(" ".join(map(str, row)) for row in counts),
        "certified the fewest",
        len(counts[2]) == 4 and all(c < min(a, b) for a, b, c in zip(*counts, strict=True)),
    )


def _counts(page: str, strategy: str) -> list[int]:
    """The numbers of triangles in the rows of a strategy."""
    rows = [line.split("|") for line in page.splitlines() if line.startswith(f"| **{strategy}**")]
    return [int(row[7]) for row in rows]


def same_bytes(quick: bool) -> Iterator[Row]:
    """Three runs of the command, two of them with one and two threads."""
    inputs = {"Example 1, .npz": [*EXAMPLE_1, "out.npz", "--tol", "0.0539"]}
    if not quick:
        inputs["jacksboro at 5 %, .ply"] = [jacksboro(), "out.ply", "--tol", "5%"]
        scan = range_scan_file()
        if scan:
            inputs["face000.ply at 5 %, .vtu"] = [scan, "out.vtu", "--tol", "5%"]
    for name, words in inputs.items():
        results = set()
        for threads in ({}, {"NUMBA_NUM_THREADS": "1"}, {"NUMBA_NUM_THREADS": "2"}):
            with _empty_folder():
                done = _run("remesh", *words, **threads)
                files = list(Path.cwd().iterdir())
                results.add(files[0].read_bytes() if files else done.stderr.encode())
        yield Row(
            f"same bytes twice, with 1 and 2 threads: {name}",
            f"{len(results)} different",
            "1",
            len(results) == 1 and bool(files),
        )


def bad_inputs(quick: bool) -> Iterator[Row]:
    """Every kind through the command: exit status, lines on stderr, files left."""
    kinds = bad_input.KINDS[:: 4 if quick else 1]
    wrong = []
    for kind in kinds:
        with _empty_folder() as folder:
            with warnings.catch_warnings(action="ignore"):
                kind.prepare()
            before = {path: path.read_bytes() for path in folder.iterdir()}
            done = _run("remesh", *bad_input.words(kind))
            after = {path: path.read_bytes() for path in folder.iterdir()}
            left = sorted(path.name for path in after.keys() - before.keys())
            lines = done.stderr.splitlines()
            fine = done.returncode == 1 and len(lines) == 1 and not done.stdout and before == after
            print(
                f"    {kind.name}: exit {done.returncode}, {len(lines)} line on stderr, "
                f"{len(left)} files left: {' / '.join(lines)[:110]}",
                flush=True,
            )
            if not fine:
                wrong.append(kind.name)
    yield Row(
        f"bad input, {len(kinds)} kinds: one sentence on stderr, exit 1, no file left",
        f"{len(kinds) - len(wrong)} of {len(kinds)}{': not ' if wrong else ''}{', '.join(wrong)}",
        "all",
        not wrong,
    )


def odd_inputs() -> Iterator[Row]:
    """Inputs that are sound but flat, small or stored twice: two triangles are enough."""
    square = np.array([[0, 0, 1], [2, 0, 1], [2, 1, 1], [0, 1, 1.0]])
    cut = np.array([[0, 1, 2], [4, 6, 7]])
    inputs = {
        "a constant": ["--function", "3", "--domain", "0,0,2,1"],
        "a plane": ["--function", "2*x - 5*y + 7", "--domain", "0,0,2,1"],
        "a flat raster": ["flat.npy"],
        "one cell": ["cell.npy"],
        "a flat surface with every point stored twice": ["twice.npz"],
    }
    for name, words in inputs.items():
        with _empty_folder():
            np.save("flat.npy", np.full((20, 30), 7.0))
            np.save("cell.npy", np.array([[0.0, 1.0], [1.0, 2.0]]))
            np.savez("twice.npz", points=np.vstack([square, square]), triangles=cut)
            done = _run("remesh", *words, "out.npz", "--tol", "0.1")
            count = len(np.load("out.npz")["triangles"]) if done.returncode == 0 else 0
        yield Row(f"triangles of {name}", str(count) + done.stderr.strip(), "2", count == 2)
