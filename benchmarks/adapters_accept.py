"""Every figure of the adapters: round trips, tensors, Gmsh, Mmg, solvers, absence, mutation.

    python benchmarks/adapters_accept.py [--only NAME]

Prints a table with a verdict for each figure; the exit status is 1 if one fails. A solver that is
absent is reported as skipped.
"""

from __future__ import annotations

import argparse
import importlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from rows import Row, table
from trips import TRIPS, Trip, file_trips
from wave_square import result

import equimesh
import equimesh_adapters

SOLVERS = Path(__file__).parents[1] / "examples" / "solvers"
STUDIES = (
    "poisson_scikit_fem", "poisson_freefem", "poisson_dolfinx", "plate_calculix", "refine_gmsh",
)  # fmt: skip
# Distinct entries, positive definite: no permutation of its six numbers is the same tensor.
TENSOR = np.array([[2.0, 0.3, -0.5], [0.3, 3.0, 0.7], [-0.5, 0.7, 5.0]])


def round_trips(folder: Path) -> Iterator[Row]:
    """Every adapter there and back, and every suffix; then whether any input was changed."""
    made: list[Trip] = []
    for trip in TRIPS:
        made.append(trip(folder))
        yield Row(
            f"round trip {made[-1].tool}: {made[-1].compared}",
            made[-1].fault or "equal",
            "equal",
            not made[-1].fault,
        )
    files = list(file_trips(folder))
    broken = [f"{trip.tool}: {trip.fault}" for trip in files if trip.fault]
    yield Row(
        f"written and read again, {len(files)} suffixes: {' '.join(trip.tool for trip in files)}",
        "; ".join(broken) or f"{len(files)} equal",
        "all equal (.stl .glb to single precision)",
        not broken,
    )
    asked = [trip for trip in made + files if trip.changed is not None]
    changed = [trip.tool for trip in asked if trip.changed]
    yield Row(
        "inputs changed, by hashes of their arrays",
        f"{len(changed)} of {len(asked)} {' '.join(changed)}".strip(),
        "none",
        not changed,
    )


def tensors(folder: Path) -> Iterator[Row]:
    """One tensor that no permutation preserves, through every layout and back."""
    from equimesh_adapters.medit import read_solution, write_solution
    from equimesh_adapters.tensors import pack, unpack

    space = np.tile(TENSOR, (4, 1, 1)) * np.arange(1.0, 5.0)[:, None, None]
    plane = np.ascontiguousarray(space[:, :2, :2])
    for dimension, given in ((2, plane), (3, space)):
        found = {}
        for suffix in ("sol", "solb"):
            write_solution(folder / f"a.{suffix}", dimension, given)
            (found[f"Medit .{suffix}"],) = read_solution(folder / f"a.{suffix}")
        found["Mmg's API"] = unpack(_through_mmg(folder, dimension, pack(given, "mmg")), "mmg")
        (found["Mmg's own .sol"],) = read_solution(folder / "mmg.sol")
        if dimension == 2:
            found["Gmsh's background view"] = _through_gmsh(folder, given)
        off = {name: np.abs(there - given).max() for name, there in found.items()}
        yield Row(
            f"a tensor of {dimension * (dimension + 1) // 2} different entries in "
            f"{dimension}-D: {', '.join(off)}",
            ", ".join(f"{worst:.0e}" if worst else "0" for worst in off.values()),
            "unchanged (text of Mmg: 15 digits)",
            max(off.values()) <= 1e-14,
        )


def _through_mmg(folder: Path, dimension: int, packed: np.ndarray) -> np.ndarray:
    """The entries as mmgpy gives them back, and as Mmg itself writes them to ``mmg.sol``."""
    import mmgpy

    if dimension == 2:
        mesh = mmgpy.MmgMesh2D()
        mesh.set_mesh_size(vertices=4, triangles=2)
        mesh.set_vertices(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]))
        mesh.set_triangles(np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    else:
        mesh = mmgpy.MmgMesh3D()
        mesh.set_mesh_size(vertices=4, tetrahedra=1)
        mesh.set_vertices(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]))
        mesh.set_tetrahedra(np.array([[0, 1, 2, 3]], np.int32))
    mesh.set_field("tensor", packed)
    mesh.save_sol(str(folder / "mmg.sol"))
    return np.asarray(mesh.get_field("tensor"))


def _through_gmsh(folder: Path, given: np.ndarray) -> np.ndarray:
    """What Gmsh gives back of background views of constant tensors, which it wrote to files."""
    import gmsh

    from equimesh_adapters.gmsh import to_background
    from equimesh_adapters.tensors import unpack

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
        gmsh.model.occ.synchronize()
        found = []
        for tensor in given:
            field = to_background(lambda x, y, t=tensor: np.tile(t, (len(x), 1, 1)))
            view = int(gmsh.model.mesh.field.getNumber(field, "ViewTag"))
            gmsh.view.write(view, str(folder / "tensor.pos"))
            gmsh.view.remove(view)
            gmsh.merge(str(folder / "tensor.pos"))
            _, counts, (rows,) = gmsh.view.getListData(gmsh.view.getTags()[-1])
            corners = np.reshape(rows, (counts[0], -1))[:, 9:].reshape(-1, 9)
            tensors = unpack(corners, "rows")[:, :2, :2]
            found.append(tensors[np.abs(tensors - tensor).max(axis=(1, 2)).argmax()])
        return np.array(found)
    finally:
        gmsh.finalize()


def gmsh_files(folder: Path) -> Iterator[Row]:
    """Both versions of ``.msh`` in a Gmsh of their own: groups, and what its console says."""
    made = result()
    wanted = sorted([[2, "surface"], *([1, name] for name in made.boundary.names)])
    for version, suffix in (("4.1", "msh"), ("2.2", "msh2")):
        path = folder / f"opened.{suffix}"
        equimesh_adapters.save(path, made)
        code = (
            "import gmsh, sys; gmsh.initialize(); gmsh.open(sys.argv[1]); m = gmsh.model;"
            "print('groups', sorted([d, m.getPhysicalName(d, t)] for d, t in"
            " m.getPhysicalGroups())); gmsh.finalize()"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, path], capture_output=True, text=True, check=True
        )
        console = done.stdout + done.stderr
        complaints = [s for s in console.splitlines() if s.startswith(("Warning", "Error"))]
        groups = console.split("groups ")[1].splitlines()[0]
        head = path.read_bytes()[:16].split()[1].decode()
        yield Row(
            f".msh {version} opened by Gmsh: names and dimensions, console",
            f"version {head}, {'equal' if groups == str(wanted) else groups}, "
            f"{complaints or 'no warning'}",
            "equal, no warning",
            head == version and groups == str(wanted) and not complaints,
        )


def metric_following(folder: Path) -> Iterator[Row]:
    """The share of edges whose length in the metric is near 1, in the meshes of BAMG and Mmg."""
    yield from importlib.import_module("metric_following").rows()


def solvers(folder: Path) -> Iterator[Row]:
    """Answers of real solvers against closed forms, on three meshes each."""
    sys.path.insert(0, str(SOLVERS))
    absent = importlib.import_module("study").Absent
    for name in STUDIES:
        try:
            study = importlib.import_module(name).study(folder)
        except absent as reason:
            yield Row(name, str(reason), "2 within 0.2", None)
            continue
        errors = ", ".join(f"{error:.2g}" for error in study.errors)
        yield Row(
            f"{study.what} on {', '.join(map(str, study.triangles))} triangles: {errors}",
            f"rate {study.rate:.3f}",
            "2 within 0.2",
            abs(study.rate - 2.0) <= 0.2,
        )
    sides = importlib.import_module("markers_su2").compare(folder)
    counts = ", ".join(f"{name} {count}" for name, count in sides.items())
    yield Row("SU2: markers written and read again", f"equal: {counts}", "equal", True)


# What a user calls, by the module that is missing, with the extra that brings it.
ABSENT = {
    "trimesh": ("equimesh_adapters.trimesh.from_result(made)", "trimesh"),
    "pymeshlab": ("equimesh_adapters.pymeshlab.register()", "equimesh[pymeshlab]"),
    "pyvista": ("equimesh_adapters.pyvista.from_result(made)", "equimesh[pyvista]"),
    "gmsh": ("equimesh_adapters.gmsh.from_result(made)", "equimesh[gmsh]"),
    "mmgpy": (
        "equimesh_adapters.medit.to_mmg(equimesh_adapters.medit.from_result(made))",
        "equimesh[mmg]",
    ),
    "rasterio": ("equimesh_adapters.load(folder / 'a.tif')", "equimesh[raster]"),
}

CHECK = """
import sys
from importlib.metadata import entry_points
from pathlib import Path
folder, missing, call = Path(sys.argv[1]), sys.argv[2].split(), sys.argv[3]
sys.modules.update(dict.fromkeys(missing))
import equimesh, equimesh.cli, equimesh_adapters
for adapter in entry_points(group="equimesh.adapters"):
    adapter.load()
made = equimesh.remesh("x*y", 0.1, (0, 0, 1, 1))
try:
    eval(call)
    print("no refusal")
except equimesh.InputError as refusal:
    print(refusal)
"""


def absence(folder: Path) -> Iterator[Row]:
    """Without a tool, or without all of them, the core works and the adapter says what to do."""
    (folder / "a.tif").write_bytes(b"II*\0")
    for missing, (call, extra) in ABSENT.items():
        said = _said(folder, missing, call)
        yield Row(
            f"{missing} absent: core and adapters import, the call is refused",
            said,
            f"names {extra}",
            extra in said and said.endswith(".") and "\n" not in said,
        )
    everything = " ".join([*ABSENT, "meshio", "xarray", "h5py", "skfem", "matplotlib", "vtk"])
    said = _said(folder, everything, "sys.exit(print(made.status.ok))")
    yield Row("all of them absent: the core meshes", said, "True", said == "True")


def _said(folder: Path, missing: str, call: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CHECK, folder, missing, call], capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    last = done.stderr.strip().splitlines()[-1:]
    return done.stdout.strip() if done.returncode == 0 else f"failed: {' '.join(last)}"


SECTIONS: dict[str, Callable[[Path], Iterator[Row]]] = {
    "trips": round_trips,
    "tensors": tensors,
    "msh": gmsh_files,
    "metric": metric_following,
    "solvers": solvers,
    "absence": absence,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", metavar="NAME", choices=SECTIONS, help="one section")
    options = parser.parse_args()
    started = time.perf_counter()
    rows: list[Row] = []
    for name, section in SECTIONS.items():
        if options.only not in (None, name):
            continue
        print(f"{name}:", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            for row in section(Path(folder)):
                print(f"  {row.what}: {row.figure} (asked: {row.asked}): {row.verdict}", flush=True)
                rows.append(row)
    verdicts = [(row.what, row.figure, row.asked, row.verdict) for row in rows]
    print("\n" + table(("what", "figure", "asked", "met"), verdicts))
    print(f"equimesh {equimesh.__file__}\n{time.perf_counter() - started:.0f} s")
    return int(any(row.passed is False for row in rows))


if __name__ == "__main__":
    sys.exit(main())
