"""Medit's meshes and solutions, and Mmg, which works on them (mmgpy, the extra `mmg`).

Functions take a ``MeditMesh``, or one of mmgpy's ``MmgMesh2D`` and ``MmgMeshS``, and give back the
same kind. Boundary edges carry the number of their curve, from 1, and the mesh its name.

Mmg does not see functions: it takes a metric at the vertices of the mesh that it is about to
change, and interpolates in between. ``write_background`` writes both for any of Mmg's programs
(run them with ``-hgrad -1``: the metric is to be followed, not smoothed), and ``adapt`` runs mmgpy.
Both first divide every triangle into four, so that the mesh tells what the metric does inside its
triangles too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh, in_projection
from equimesh_adapters.attributes import Carrier
from equimesh_adapters.borders import border_edges, nearest_edges
from equimesh_adapters.medit_files import (
    MeditMesh,
    read_mesh,
    read_solution,
    write_mesh,
    write_solution,
)
from equimesh_adapters.surfaces import remeshed
from equimesh_adapters.tensors import pack

if TYPE_CHECKING:
    from types import ModuleType

    from equimesh.fields import Source

__all__ = [
    "FORMAT", "MeditMesh", "adapt", "from_mmg", "from_result", "profile", "read_mesh",
    "read_solution", "remesh", "to_field", "to_mmg", "write_background", "write_mesh",
    "write_solution",
]  # fmt: skip

# (x (n,), y (n,)) -> (n, 2, 2): an equimesh.Metric is one.
MetricLike: TypeAlias = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def from_result(result: equimesh.Result, *, dimension: int = 3) -> MeditMesh:
    """A result in space, or its projection with ``dimension=2``, as Mmg2d wants it."""
    boundary, curves = result.boundary, result.curves
    corners = _corners(result.points[:, :2], boundary.edges, boundary.tags)
    return MeditMesh(
        np.ascontiguousarray(result.points[:, :dimension]),
        result.triangles,
        np.ones(len(result.triangles), np.int64),
        curves.edges,
        curves.tags + 1,
        np.union1d(corners, result.constraints.points),
        {number: name for number, name in enumerate(curves.names, 1)},
    )


def to_field(mesh: Any, *, up: Any = None) -> Surface:
    """The triangles of the mesh as a surface, a plane one at height 0."""
    mesh = _known(mesh)
    points = mesh.points
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return Surface(points, mesh.triangles, up=up)


def profile(mesh: Any, against: Source) -> equimesh.Profile:
    """The errors of a mesh against a surface; a plane mesh takes its heights from the surface."""
    mesh = _known(mesh)
    if isinstance(against, Surface) and mesh.points.shape[1] == 3:
        return equimesh.profile(in_projection(mesh.points, against), mesh.triangles, against)
    return equimesh.profile(mesh.points, mesh.triangles, against)


def remesh(
    mesh: Any, tol: float | str | None = None, *, follow: Source | None = None, **options: Any
) -> Any:
    """``equimesh.remesh`` from a mesh to a mesh of the same kind; ``options`` are passed on.

    A mesh in space is itself the surface. A plane mesh gives the domain, and ``follow`` the
    function that the new plane mesh is made for. References are those of the nearest triangle and,
    on the boundary, of the nearest edge.

    Raises InputError for a mesh that is not a graph over any direction, for a plane mesh without
    ``follow``, and where the tolerance is not met.
    """
    old = _known(mesh)
    plane = old.points.shape[1] == 2
    if plane != (follow is not None):
        raise InputError(
            "A plane mesh needs follow=, the function to mesh it for."
            if plane
            else "A mesh in space is itself the surface: leave out follow=."
        )
    if follow is None:
        made = remeshed(old.points, old.triangles, tol, **options)
        points, triangles, faces = made.points, made.triangles, made.carrier.faces
    else:
        result = equimesh.remesh(follow, tol, to_field(old).outline(0.0), **options)
        if not result.status.usable:
            raise InputError(result.status.value)
        points, triangles = np.ascontiguousarray(result.points[:, :2]), result.triangles
        faces = Carrier.between((old.points, old.triangles), (points, triangles)).faces
    edges = border_edges(triangles)
    inherited = _inherited(old, points[edges])
    new = MeditMesh(
        points,
        triangles,
        old.references[faces],
        edges,
        inherited,
        _corners(points[:, :2], edges, inherited),
        dict(old.names),
    )
    return new if isinstance(mesh, MeditMesh) else to_mmg(new)


def write_background(
    path: str | Path,
    metric: MetricLike,
    mesh: MeditMesh | equimesh.Result,
    *,
    isotropic: bool = False,
    divide: int = 1,
) -> tuple[Path, Path]:
    """Write ``path`` (.mesh or .meshb) and the metric at its vertices beside it, for Mmg2d.

    Parameters
    ----------
    metric
        (x, y) -> (n, 2, 2), such as an ``equimesh.Metric``; unit edges are the aim.
    mesh
        The mesh that Mmg starts from; a result is projected.
    isotropic
        Write scalar sizes ``det(M)^(-1/4)`` instead of tensors.
    divide
        How often every triangle is divided into four first.

    Returns
    -------
    The two paths.
    """
    path = Path(path)
    plane = _divided(_plane(mesh), divide)
    tensors = np.asarray(metric(*plane.points.T), float)
    values = np.linalg.det(tensors) ** -0.25 if isotropic else tensors
    beside = path.with_suffix(".solb" if path.suffix.lower() == ".meshb" else ".sol")
    write_mesh(path, plane)
    write_solution(beside, 2, values)
    return path, beside


def adapt(
    metric: MetricLike, mesh: Any, *, passes: int = 1, divide: int = 1, **options: Any
) -> MeditMesh:
    """A plane mesh that Mmg makes unit in the metric, starting from a mesh or a result.

    Parameters
    ----------
    metric
        (x, y) -> (n, 2, 2), such as an ``equimesh.Metric``.
    passes
        How often Mmg runs, each time on its mesh before with the metric evaluated anew: more than
        once for a start that is far too coarse for the metric.
    divide
        How often every triangle is divided into four before each run.
    options
        Mmg's own, such as ``hausd``; ``hgrad=-1`` (follow the metric exactly) unless given.

    Raises InputError where mmgpy is not installed.
    """
    current = _plane(mesh)
    names, corners = current.names, {tuple(p) for p in current.points[current.corners].tolist()}
    for _ in range(passes):
        current = _divided(current, divide)
        started = to_mmg(current, np.asarray(metric(*current.points.T), float))
        started.remesh(**{"hgrad": -1.0, "verbose": -1, **options})
        current = from_mmg(started)
        kept = [i for i, p in enumerate(current.points.tolist()) if tuple(p) in corners]
        current = replace(current, names=names, corners=np.array(kept, np.int64))
    return current


def to_mmg(mesh: MeditMesh, metric: NDArray[np.float64] | None = None) -> Any:
    """A mesh for mmgpy: ``MmgMesh2D`` of a plane mesh, else ``MmgMeshS``.

    ``metric`` (n, d, d) at the vertices. Raises InputError where mmgpy is not installed.
    """
    mmgpy = _mmgpy()
    dimension = mesh.points.shape[1]
    made = mmgpy.MmgMesh2D() if dimension == 2 else mmgpy.MmgMeshS()
    made.set_mesh_size(
        vertices=len(mesh.points), triangles=len(mesh.triangles), edges=len(mesh.edges)
    )
    made.set_vertices(np.ascontiguousarray(mesh.points))
    made.set_triangles(mesh.triangles.astype(np.int32), mesh.references.astype(np.int64))
    if len(mesh.edges):
        made.set_edges(mesh.edges.astype(np.int32), mesh.edge_references.astype(np.int64))
    if len(mesh.corners):
        made.set_corners(mesh.corners.astype(np.int32))
    if metric is not None:
        made.set_field("tensor", pack(metric, "mmg"))
    return made


def from_mmg(mesh: Any) -> MeditMesh:
    """The vertices, triangles and edges of a mesh of mmgpy, with their references."""
    triangles, references = mesh.get_triangles_with_refs()
    edges, edge_references = mesh.get_edges_with_refs()
    return MeditMesh(
        np.array(mesh.get_vertices(), np.float64),
        np.array(triangles, np.int64).reshape(-1, 3),
        np.array(references, np.int64),
        np.array(edges, np.int64).reshape(-1, 2),
        np.array(edge_references, np.int64),
    )


def read(path: Path) -> TriangleMesh:
    mesh = read_mesh(path)
    return TriangleMesh(mesh.points, mesh.triangles)


def write(path: Path, result: equimesh.Result) -> None:
    write_mesh(path, from_result(result))


def _known(mesh: Any) -> MeditMesh:
    if isinstance(mesh, MeditMesh):
        return mesh
    if hasattr(mesh, "get_triangles_with_refs"):
        return from_mmg(mesh)
    raise InputError(
        f"A {type(mesh).__name__} is no Medit mesh: give a MeditMesh, read_mesh(path) or a mesh "
        "of mmgpy."
    )


def _plane(mesh: Any) -> MeditMesh:
    if isinstance(mesh, equimesh.Result):
        return from_result(mesh, dimension=2)
    known = _known(mesh)
    return replace(known, points=np.ascontiguousarray(known.points[:, :2]))


def _divided(mesh: MeditMesh, times: int) -> MeditMesh:
    """Every triangle in four and every edge in two, at the middles of the edges."""
    for _ in range(times):
        count = len(mesh.points)
        sides = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        edges, where = np.unique(_keys(sides, count), return_inverse=True)
        ab, bc, ca = (where.reshape(-1, 3) + count).T
        a, b, c = mesh.triangles.T
        outer = np.isin(_keys(mesh.edges, count), edges)  # an edge of no triangle stays whole
        p, q = mesh.edges[outer].T
        half = np.searchsorted(edges, _keys(mesh.edges[outer], count)) + count
        middles = 0.5 * (mesh.points[edges // count] + mesh.points[edges % count])
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        mesh = replace(
            mesh,
            points=np.concatenate([mesh.points, middles]),
            triangles=np.concatenate([np.stack(part, 1) for part in parts]),
            references=np.tile(mesh.references, 4),
            edges=np.concatenate(
                [np.stack([p, half], 1), np.stack([half, q], 1), mesh.edges[~outer]]
            ),
            edge_references=np.concatenate(
                [np.tile(mesh.edge_references[outer], 2), mesh.edge_references[~outer]]
            ),
        )
    return mesh


def _inherited(old: MeditMesh, edges: NDArray[np.float64]) -> NDArray[np.int64]:
    """(k,) references of the old border for the new one's edges (k, 2, d); 0 where it had none."""
    count = len(old.points)
    outer = np.isin(_keys(old.edges, count), _keys(border_edges(old.triangles), count))
    if not outer.any():
        return np.zeros(len(edges), np.int64)
    nearest = nearest_edges(old.points[old.edges[outer]], edges)
    return np.asarray(old.edge_references[outer][nearest])


def _keys(edges: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    low, high = np.sort(edges, axis=1).T
    return low * count + high


def _corners(
    plane: NDArray[np.float64], edges: NDArray[np.int64], tags: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Boundary vertices where the direction or the curve changes."""
    ahead = np.full(len(plane), -1)
    ahead[edges[:, 0]] = np.arange(len(edges))
    following = ahead[edges[:, 1]]
    ends = following >= 0
    a, b = edges[ends], edges[following[ends]]
    u, v = plane[a[:, 1]] - plane[a[:, 0]], plane[b[:, 1]] - plane[b[:, 0]]
    cross = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    bent = (cross > 1e-9 * np.hypot(*u.T) * np.hypot(*v.T)) | ((u * v).sum(1) < 0.0)
    changed = tags[ends] != tags[following[ends]]
    return np.unique(a[bent | changed, 1])


def _mmgpy() -> ModuleType:
    try:
        import mmgpy
    except ImportError:
        raise InputError("mmgpy is not installed: pip install 'equimesh[mmg]'.") from None
    return mmgpy


FORMAT = Format(
    (".mesh", ".meshb"), read, write,
    types=("equimesh_adapters.medit_files.MeditMesh", "mmgpy.MmgMesh2D", "mmgpy.MmgMeshS"),
    to_field=to_field, remesh=remesh,
)  # fmt: skip
