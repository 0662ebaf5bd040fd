"""meshio objects, and the files that meshio reads: vtu, vtk, msh (Gmsh 2.2), xdmf."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh, in_space

if TYPE_CHECKING:
    import meshio

__all__ = ["FORMAT", "from_result", "remesh", "to_field"]

# How a cell falls into triangles, by its corners and, in the second-order cells, its edge nodes.
SPLITS: dict[str, list[list[int]]] = {
    "triangle": [[0, 1, 2]],
    "quad": [[0, 1, 2], [0, 2, 3]],
    "triangle6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad8": [[0, 4, 7], [4, 1, 5], [5, 2, 6], [6, 3, 7], [4, 5, 6], [4, 6, 7]],
    "quad9": [
        [0, 4, 8], [0, 8, 7], [4, 1, 5], [4, 5, 8], [8, 5, 2], [8, 2, 6], [7, 8, 6], [7, 6, 3],
    ],
}  # fmt: skip


def to_field(mesh: meshio.Mesh, *, up: Any = None) -> Surface:
    """The triangles of the mesh as a surface; quadrilaterals are cut along a diagonal.

    Raises InputError where there is nothing that can be cut into triangles.
    """
    points, triangles = _triangles(mesh)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return Surface(points, triangles, up=up)


def from_result(result: equimesh.Result) -> meshio.Mesh:
    """A result as a meshio mesh with the largest error of each triangle as cell data ``error``."""
    import meshio

    return meshio.Mesh(
        result.points,
        [("triangle", result.triangles)],
        point_data={"z": result.points[:, 2]},
        cell_data={"error": [result.profile.errors]},
    )


def remesh(mesh: meshio.Mesh, tol: float | str | None = None, **options: Any) -> meshio.Mesh:
    """``equimesh.remesh`` from a meshio mesh to a meshio mesh; ``options`` are passed on.

    Raises InputError for a mesh that is not a graph over any direction, and where the tolerance
    is not met.
    """
    field = to_field(mesh, up=options.pop("up", None))
    result = equimesh.remesh(field, tol, **options)
    if not result.status.ok:
        raise InputError(result.status.value)
    return from_result(in_space(result, field))


def read(path: Path) -> TriangleMesh:
    import meshio

    try:
        with _quiet():
            mesh = meshio.read(path)
    except ImportError:
        raise InputError(
            f"{path} keeps its numbers in a .h5 file: run pip install 'equimesh[hdf]'."
        ) from None
    return _triangles(mesh)


def write(path: Path, result: equimesh.Result) -> None:
    import meshio

    with _quiet():
        match path.suffix.lower():
            case ".msh":
                meshio.write(path, _with_boundary(result), file_format="gmsh22", binary=False)
            case ".xdmf":
                # Numbers inside the XML: one file, with no companion that could get lost.
                meshio.write(path, from_result(result), file_format="xdmf", data_format="XML")
            case _:
                meshio.write(path, from_result(result))


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without meshio's own remarks: it prints what it raises."""
    with (
        io.StringIO() as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        yield


def _triangles(mesh: meshio.Mesh) -> TriangleMesh:
    parts = []
    for block in mesh.cells:
        if block.type in SPLITS:
            parts.append(np.asarray(block.data)[:, SPLITS[block.type]].reshape(-1, 3))
        elif block.type.startswith("polygon"):
            parts.append(_fan(np.asarray(block.data)))
    if not parts or not sum(map(len, parts)):
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "no cells"
        raise InputError(f"The mesh has no triangles but {kinds}: give a surface mesh.")
    return TriangleMesh(np.array(mesh.points, np.float64), np.concatenate(parts).astype(np.int64))


def _fan(polygons: np.ndarray) -> np.ndarray:
    """(k, n) corners of polygons as (k (n - 2), 3) triangles around their first corner."""
    count = polygons.shape[1]
    corners = [[0, i, i + 1] for i in range(1, count - 1)]
    return polygons[:, corners].reshape(-1, 3)


def _with_boundary(result: equimesh.Result) -> meshio.Mesh:
    """For Gmsh: the surface is one physical group, every named boundary curve another.

    Without the errors: meshio 5.3.5 cannot read data on a mesh of both triangles and lines.
    """
    import meshio

    boundary = result.boundary
    groups = [np.ones(len(result.triangles), np.int32), np.asarray(boundary.tags, np.int32) + 1]
    names = {"surface": np.array([1, 2])}
    names |= {name: np.array([i + 1, 1]) for i, name in enumerate(boundary.names)}
    return meshio.Mesh(
        result.points,
        [("triangle", result.triangles), ("line", boundary.edges)],
        cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data=names,
    )


FORMAT = Format((".vtu", ".vtk", ".msh", ".xdmf"), read, write)
