"""Gmsh: its files, the models that are open in it, and its own anisotropic mesher.

``.msh`` files are written in format 4.1, binary, which keeps every digit; ``.msh2`` in format 2.2
as text, for programs that read no other (``write(path, result, version=2.2)`` does it under any
name). The surface and every named boundary curve are physical groups. With ``errors=True`` format
4.1 also has a view with the error of each triangle, and on lines that of the triangle beside; not
by default, since Gmsh complains about such views when it refines a mesh. Without the extra `gmsh`,
``.msh`` is format 2.2 too.

The other functions work on the current model of a session that you have opened with
``gmsh.initialize()``; they leave its other models and its options alone, but for ``to_background``,
which sets those by which Gmsh follows a metric.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh, in_projection
from equimesh_adapters import meshio as meshio_adapter
from equimesh_adapters.borders import triangles_beside
from equimesh_adapters.gmsh_model import (
    CHORDS,
    LINE,
    POINT,
    TRIANGLE,
    curves_of,
    library,
    only_surface,
    opened,
    plane_domain,
    scratch,
    surface_mesh,
)
from equimesh_adapters.gmsh_remesh import remesh
from equimesh_adapters.gmsh_views import add_tensors, view_surface

if TYPE_CHECKING:
    from equimesh.fields import Source

__all__ = [
    "FORMAT", "from_result", "profile", "remesh", "to_background", "to_field", "view_surface",
    "write",
]  # fmt: skip

# What Gmsh may have been told about files: here they are written whole and plain.
_PLAIN = {
    "Mesh.Binary": 1.0, "Mesh.MshFileVersion": 4.1, "Mesh.PartitionSplitMeshFiles": 0.0,
    "Mesh.SaveAll": 0.0, "Mesh.SaveParametric": 0.0, "Mesh.ScalingFactor": 1.0,
    "PostProcessing.SaveMesh": 0.0,
}  # fmt: skip
_BAMG = 7
# Sizes come from the background field alone. BAMG does not smooth the metric once more, nothing
# moves nodes to the Euclidean middle of their neighbours, and curves are divided in the metric too,
# which the algorithm of a surface does not decide.
_FOLLOW = {
    "Mesh.Algorithm": _BAMG, "Mesh.AnisoMax": 1e33, "Mesh.MeshSizeExtendFromBoundary": 0.0,
    "Mesh.MeshSizeFactor": 1.0, "Mesh.MeshSizeFromCurvature": 0.0, "Mesh.MeshSizeFromPoints": 0.0,
    "Mesh.MeshSizeMax": 1e22, "Mesh.MeshSizeMin": 0.0, "Mesh.Smoothing": 0.0,
    "Mesh.SmoothRatio": 0.0,
}  # fmt: skip


def from_result(result: equimesh.Result, name: str = "equimesh", *, errors: bool = False) -> int:
    """Add a discrete model of the result, make it the current one, and give the surface's tag.

    Physical groups: ``surface``, every named boundary curve and every name of constraints. With
    ``errors``, a view of that name has the largest error of every triangle.
    """
    gmsh = opened()
    if name in gmsh.model.list():
        raise InputError(f"Gmsh has a model {name!r} already: give another name.")
    gmsh.model.add(name)
    _add(gmsh, result)
    if errors:
        _add_errors(gmsh, result, name)
    return 1


def to_field(tag: int | None = None, *, up: Any = None) -> Surface:
    """The triangles of a surface of the current model, by default its only one."""
    gmsh = opened()
    return Surface(*surface_mesh(gmsh, only_surface(gmsh, tag)), up=up)


def profile(against: Source | int, tag: int | None = None) -> equimesh.Profile:
    """The errors of a surface's mesh against a function, a field or (its tag) a Gmsh view.

    The nodes of a discrete surface are taken as they are, those of a plane one get their heights
    from ``against``.
    """
    gmsh = opened()
    tag = only_surface(gmsh, tag)
    points, triangles = surface_mesh(gmsh, tag)
    source = view_surface(int(against)) if isinstance(against, (int, np.integer)) else against
    if gmsh.model.getType(2, tag) == "Plane":
        return equimesh.profile(points[:, :2], triangles, source)
    if isinstance(source, Surface):
        points = in_projection(points, source)
    return equimesh.profile(points, triangles, source)


def to_background(
    metric: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    tag: int | None = None,
    *,
    mesh: equimesh.Result | None = None,
) -> int:
    """Make Gmsh's BAMG follow a metric: its tensors as a view, and that as background field.

    Sets the algorithm (7, BAMG) and the options by which nothing but the field decides sizes and
    nothing moves nodes afterwards. Then ``gmsh.model.mesh.generate(2)`` makes the mesh.

    Parameters
    ----------
    metric
        (x, y) -> (n, 2, 2), such as an ``equimesh.Metric``; unit edges are the aim.
    tag
        A surface parallel to the xy plane, by default the only one.
    mesh
        A result on whose triangles the view is made. Otherwise a mesh that resolves the metric.
        Gmsh interpolates the tensors' entries linearly on it.

    Returns
    -------
    The tag of the background field; its option ``ViewTag`` tells the view.
    """
    from equimesh.riemann.background import Background

    if not callable(metric):
        raise InputError(
            f"A {type(metric).__name__} is no metric: give equimesh.Metric.of(source, tol)."
        )
    gmsh = opened()
    tag = only_surface(gmsh, tag)
    domain, height = plane_domain(gmsh, tag, curves_of(gmsh, tag, CHORDS))
    if mesh is None:
        resolved = Background.resolving(metric, domain)
        points, triangles = resolved.points, resolved.triangles
    else:
        points, triangles = mesh.points[:, :2], mesh.triangles
    view = add_tensors(gmsh, points, triangles, metric(*points.T), height)
    field = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)
    gmsh.model.mesh.setAlgorithm(2, tag, _BAMG)
    for key, value in _FOLLOW.items():
        gmsh.option.setNumber(key, value)
    return int(field)


def read(path: Path) -> TriangleMesh:
    """All triangles of the file, in its order of nodes."""
    # Gmsh runs what it does not recognise as a script, commands to the system included.
    with path.open("rb") as file:
        if file.readline().strip() != b"$MeshFormat":
            raise InputError(f"{path} is no mesh of Gmsh: its first line is not $MeshFormat.")
    try:
        library()
    except InputError:
        return meshio_adapter.read(path)
    with scratch("equimesh reads", {}) as gmsh:
        gmsh.merge(str(path.resolve()))
        return TriangleMesh(*surface_mesh(gmsh, None))


def write(
    path: Path, result: equimesh.Result, version: float = 4.1, *, errors: bool = False
) -> None:
    """Write format 4.1, or 2.2 for the suffix ``.msh2``, ``version=2.2``, or without Gmsh.

    ``errors`` adds a view with the triangles' errors to format 4.1.
    """
    if version not in (4.1, 2.2):
        raise InputError(f"The version {version} of .msh files is not offered: give 4.1 or 2.2.")
    if version == 2.2 or path.suffix.lower() == ".msh2":
        return meshio_adapter.write_msh2(path, result)
    try:
        library()
    except InputError:
        return meshio_adapter.write_msh2(path, result)
    with scratch("equimesh writes", _PLAIN) as gmsh:
        _add(gmsh, result)
        gmsh.write(str(path.resolve()))
        if errors:
            view = _add_errors(gmsh, result, gmsh.model.getCurrent())
            gmsh.view.write(view, str(path.resolve()), append=True)


def _curves(boundary: equimesh.Boundary) -> dict[int, NDArray[np.int64]]:
    """The edges of each named curve, by tags from 1."""
    return {i + 1: boundary.edges[boundary.tags == i] for i in np.unique(boundary.tags).tolist()}


def _add(gmsh: Any, result: equimesh.Result) -> None:
    """Entities, nodes, elements and groups of the result in the current model.

    Elements have the numbers from 1: lines curve by curve, then triangles.
    """
    model_mesh, boundary, points = gmsh.model.mesh, result.curves, result.points
    curves = _curves(boundary)
    ends = {tag: _open_ends(edges) for tag, edges in curves.items()}
    corners = np.unique(np.concatenate([np.zeros(0, np.int64), *ends.values()]))
    point_of = {int(vertex): number for number, vertex in enumerate(corners, 1)}
    free = np.ones(len(points), bool)

    def put(dimension: int, tag: int, vertices: NDArray[np.int64]) -> None:
        vertices = vertices[free[vertices]]
        free[vertices] = False
        model_mesh.addNodes(dimension, tag, vertices + 1, points[vertices].ravel())

    for vertex, number in point_of.items():
        gmsh.model.addDiscreteEntity(0, number)
        gmsh.model.setCoordinates(number, *points[vertex])
        put(0, number, np.array([vertex]))
    for tag, edges in curves.items():
        gmsh.model.addDiscreteEntity(1, tag, [point_of[int(v)] for v in ends[tag]])
        put(1, tag, np.unique(edges))
    around = [tag for tag in curves if tag <= len(result.boundary.names)]
    gmsh.model.addDiscreteEntity(2, 1, around)
    put(2, 1, np.arange(len(points)))
    next_element = 1
    for tag, edges in curves.items():
        numbers = np.arange(next_element, next_element + len(edges))
        model_mesh.addElementsByType(tag, LINE, numbers, edges.ravel() + 1)
        next_element += len(edges)
    first = next_element
    numbers = np.arange(first, first + len(result.triangles))
    model_mesh.addElementsByType(1, TRIANGLE, numbers, result.triangles.ravel() + 1)
    for vertex, number in point_of.items():
        element = first + len(numbers) + number - 1
        model_mesh.addElementsByType(number, POINT, [element], [vertex + 1])
    for tag in curves:
        gmsh.model.addPhysicalGroup(1, [tag], tag, name=boundary.names[tag - 1])
    gmsh.model.addPhysicalGroup(2, [1], 1, name="surface")


def _add_errors(gmsh: Any, result: equimesh.Result, model: str) -> int:
    """The tag of a new view of the elements that ``_add`` made."""
    edges = np.concatenate([np.zeros((0, 2), np.int64), *_curves(result.curves).values()])
    errors = result.profile.errors
    values = np.concatenate([errors[triangles_beside(result.triangles, edges)], errors])
    view = gmsh.view.add("error")
    numbers = np.arange(1, len(values) + 1)
    gmsh.view.addHomogeneousModelData(view, 0, model, "ElementData", numbers, values)
    return int(view)


def _open_ends(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices at which a curve of directed edges begins or ends; none for a closed one."""
    vertices, inverse = np.unique(edges, return_inverse=True)
    inverse = inverse.reshape(-1, 2)
    balance = np.bincount(inverse[:, 0], minlength=len(vertices)) - np.bincount(
        inverse[:, 1], minlength=len(vertices)
    )
    return vertices[balance != 0]


FORMAT = Format((".msh", ".msh2"), read, write)
