"""meshio objects, and the files that meshio reads: vtu, vtk, xdmf.

A result becomes triangles and, after them, the lines of its boundary and of its constraints. Every
cell belongs to one named group, ``surface`` or a curve: ``cell_sets`` by name, and in
``field_data`` each name's number and dimension, as for Gmsh's physical groups. ``point_data`` has
the ``value`` of every vertex and ``cell_data`` the largest ``error`` of every triangle, on lines
that of the triangle beside. Files of these kinds have no named groups: there, meshio's own
convention is followed, one integer for every cell under the joined names.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh, in_projection
from equimesh_adapters.borders import border_edges, nearest_edges, triangles_beside
from equimesh_adapters.surfaces import remeshed

if TYPE_CHECKING:
    import meshio

    from equimesh.fields import Source

__all__ = ["FORMAT", "from_result", "profile", "remesh", "to_field"]

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
# What meshio keeps about Gmsh's numbering of entities, which a new mesh does not have.
_STALE = ("gmsh:dim_tags", "gmsh:bounding_entities")


def to_field(mesh: meshio.Mesh, *, up: Any = None) -> Surface:
    """The triangles of the mesh as a surface; quadrilaterals are cut along a diagonal.

    Raises InputError where there is nothing that can be cut into triangles.
    """
    return Surface(_in_space(mesh.points), _triangles(mesh)[1], up=up)


def from_result(result: equimesh.Result) -> meshio.Mesh:
    """A result as a meshio mesh with its named groups, values and errors."""
    import meshio

    boundary, count = result.curves, len(result.triangles)
    names = {name: boundary.tags == i for i, name in enumerate(boundary.names)}
    none = np.zeros(0, np.int64)
    cells = [("triangle", result.triangles.copy())]
    sets = {"surface": [np.arange(count)]}
    errors = [result.profile.errors.copy()]
    numbers = {"surface": np.array([1, 2])}
    if len(boundary.edges):
        cells.append(("line", boundary.edges.copy()))
        beside = triangles_beside(result.triangles, boundary.edges)
        errors.append(result.profile.errors[beside])
        sets["surface"].append(none)
        sets |= {name: [none, np.flatnonzero(mine)] for name, mine in names.items()}
        numbers |= {name: np.array([i, 1]) for i, name in enumerate(names, 1)}
    return meshio.Mesh(
        result.points.copy(),
        cells,
        point_data={"value": result.points[:, 2].copy()},
        cell_data={"error": errors},
        field_data=numbers,
        cell_sets=sets,
    )


def profile(mesh: meshio.Mesh, against: Source) -> equimesh.Profile:
    """The errors of the mesh's triangles; points (n, 2) get their heights from ``against``."""
    points, triangles = _triangles(mesh)
    if isinstance(against, Surface) and points.shape[1] == 3:
        points = in_projection(points, against)
    return equimesh.profile(points, triangles, against)


def remesh(mesh: meshio.Mesh, tol: float | str | None = None, **options: Any) -> meshio.Mesh:
    """``equimesh.remesh`` from a meshio mesh to a meshio mesh; ``options`` are passed on.

    Triangles come out, and lines of the boundary where the mesh has lines. ``point_data`` is
    interpolated linearly on the old triangles (whole numbers, flags and texts: from the corner that
    weighs most), ``cell_data`` and ``cell_sets`` are those of the triangle under each new
    triangle's middle and of the line nearest to each new line's. ``field_data`` and ``info`` stay;
    ``cell_data`` gets the new ``error`` as in ``from_result``. Bodies that hang together nowhere
    are meshed one by one.

    Raises InputError for a mesh that is not a graph over any direction, and where the tolerance
    is not met.
    """
    import meshio

    blocks = [(block.type, np.asarray(block.data)) for block in mesh.cells]
    places = _in_space(mesh.points)
    faces, owners = _faces(blocks)
    made = remeshed(places, faces, tol, **options)
    cells = [("triangle", made.triangles)]
    sources = [owners[made.carrier.faces]]  # numbers of the old cells, through all blocks
    errors = [made.errors]
    old_lines, line_owners = _lines(blocks)
    if len(old_lines):
        lines = border_edges(made.triangles)
        nearest = nearest_edges(places[old_lines], made.points[lines])
        cells.append(("line", lines))
        sources.append(line_owners[nearest])
        errors.append(made.errors[triangles_beside(made.triangles, lines)])
    return meshio.Mesh(
        made.points,
        cells,
        point_data={
            key: made.carrier.at_vertices(data)
            for key, data in mesh.point_data.items()
            if key not in _STALE
        },
        cell_data={
            key: [np.concatenate(data)[source] for source in sources]
            for key, data in mesh.cell_data.items()
            if key not in _STALE
        }
        | {"error": errors},
        cell_sets={
            name: [np.flatnonzero(_members(members, blocks)[source]) for source in sources]
            for name, members in mesh.cell_sets.items()
            if name not in _STALE
        },
        field_data={key: np.array(value) for key, value in mesh.field_data.items()},
        info=mesh.info,
    )


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

    mesh = from_result(result)
    with _quiet():
        mesh.cell_sets_to_data()
        match path.suffix.lower():
            case ".xdmf":
                # Numbers inside the XML: one file, with no companion that could get lost.
                meshio.write(path, mesh, file_format="xdmf", data_format="XML")
            case _:
                meshio.write(path, mesh)


def write_msh2(path: Path, result: equimesh.Result) -> None:
    """Gmsh's format 2.2 as text: the surface is one physical group, every named curve another.

    Without the errors: meshio 5.3.5 cannot read data on a mesh of both triangles and lines from it.
    """
    import meshio

    boundary = result.curves
    groups = [np.ones(len(result.triangles), np.int32), np.asarray(boundary.tags, np.int32) + 1]
    names = {"surface": np.array([1, 2])}
    names |= {name: np.array([i + 1, 1]) for i, name in enumerate(boundary.names)}
    mesh = meshio.Mesh(
        result.points,
        [("triangle", result.triangles), ("line", boundary.edges)],
        cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data=names,
    )
    with _quiet():
        meshio.write(path, mesh, file_format="gmsh22", binary=False)


Blocks: TypeAlias = list[tuple[str, np.ndarray]]


def _faces(blocks: Blocks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All triangles (m, 3), and (m,) the number of the cell that each is a part of."""
    parts, owners, start = [], [], 0
    for kind, cells in blocks:
        faces = _split(kind, cells)
        if faces is not None and len(cells):
            parts.append(faces)
            owners.append(start + np.repeat(np.arange(len(cells)), len(faces) // len(cells)))
        start += len(cells)
    if not parts:
        kinds = ", ".join(sorted({kind for kind, _ in blocks})) or "no cells"
        raise InputError(f"The mesh has no triangles but {kinds}: give a surface mesh.")
    return np.concatenate(parts), np.concatenate(owners)


def _lines(blocks: Blocks) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The ends (k, 2) of all lines, and (k,) their numbers as cells."""
    ends, numbers, start = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)], 0
    for kind, cells in blocks:
        if kind.startswith("line"):
            ends.append(cells[:, :2].astype(np.int64))
            numbers.append(start + np.arange(len(cells)))
        start += len(cells)
    return np.concatenate(ends), np.concatenate(numbers)


def _members(sets: Any, blocks: Blocks) -> NDArray[np.bool_]:
    """Of every cell, whether it belongs to a set, which is told block by block."""
    belongs, start = np.zeros(sum(len(cells) for _, cells in blocks), bool), 0
    for inside, (_, cells) in zip(sets, blocks, strict=True):
        if inside is not None:
            belongs[start + np.asarray(inside, np.int64)] = True
        start += len(cells)
    return belongs


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without meshio's own remarks: it prints what it raises."""
    with (
        io.StringIO() as nowhere,
        contextlib.redirect_stdout(nowhere),
        contextlib.redirect_stderr(nowhere),
    ):
        yield


def _in_space(points: np.ndarray) -> NDArray[np.float64]:
    points = np.array(points, np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return points


def _split(kind: str, cells: np.ndarray) -> NDArray[np.int64] | None:
    """The triangles of cells, in their order; None for a kind that has no such parts."""
    if kind in SPLITS:
        return cells[:, SPLITS[kind]].reshape(-1, 3).astype(np.int64)
    if kind.startswith("polygon"):
        return _fan(cells).astype(np.int64)
    return None


def _triangles(mesh: meshio.Mesh) -> TriangleMesh:
    faces, _ = _faces([(block.type, np.asarray(block.data)) for block in mesh.cells])
    return TriangleMesh(np.array(mesh.points, np.float64), faces)


def _fan(polygons: np.ndarray) -> np.ndarray:
    """(k, n) corners of polygons as (k (n - 2), 3) triangles around their first corner."""
    count = polygons.shape[1]
    corners = [[0, i, i + 1] for i in range(1, count - 1)]
    return polygons[:, corners].reshape(-1, 3)


FORMAT = Format(
    (".vtu", ".vtk", ".xdmf"), read, write,
    types=("meshio.Mesh",), to_field=to_field, remesh=remesh,
)  # fmt: skip
