"""A surface of the model that is open in Gmsh, meshed anew in place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import in_projection
from equimesh_adapters.borders import border_edges
from equimesh_adapters.gmsh_curved import chain_of, on_curves
from equimesh_adapters.gmsh_fit import SAME, Curve, Patch, fitted
from equimesh_adapters.gmsh_model import (
    CHORDS,
    boundary_tags,
    curves_of,
    only_surface,
    opened,
    plane_domain,
    replace_mesh,
    surface_mesh,
)
from equimesh_adapters.gmsh_views import view_surface

if TYPE_CHECKING:
    from equimesh.fields import Source

__all__ = ["remesh"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ROUNDS = 5
_NEAR = 1e-3  # of the surface's size: how far nodes may move to a curved border


def remesh(
    tag: int | None = None,
    tol: float | str | None = None,
    *,
    follow: Source | equimesh.Metric | int | None = None,
    up: Any = None,
    **options: Any,
) -> equimesh.Result:
    """Mesh a surface of the current model anew, in place, and tell what was done.

    A discrete surface is meshed for itself: its own triangles are the surface z = f(x, y), or a
    graph along ``up``. A plane surface, parallel to the xy plane, is meshed for another function:
    ``follow``. Nodes and elements of the surface and of its boundary curves are replaced;
    entities, physical groups and the nodes at points stay. Curved boundary curves are followed
    by nodes that lie on them. New elements are of first order.

    Parameters
    ----------
    tag
        The surface; not needed where there is one only.
    tol, options
        As in ``equimesh.remesh``.
    follow
        What ``equimesh.remesh`` takes, a metric too, or the tag of a Gmsh view with a scalar on
        triangles or quadrilaterals.

    Returns
    -------
    Result
        In the coordinates of the model; on a plane surface its third one is the function.
        ``boundary`` has the names of the curves' physical groups.

    Raises
    ------
    InputError
        The surface is neither, is no graph, shares nodes or curves with other meshed parts of the
        model, or the tolerance is not met. The model is then as it was.
    """
    gmsh = opened()
    tag = only_surface(gmsh, tag)
    kind = gmsh.model.getType(2, tag)
    if kind not in ("Plane", "Discrete surface"):
        raise InputError(
            f"Surface {tag} is of the kind {kind.lower()}: only plane and discrete surfaces can be "
            "meshed."
        )
    if kind == "Plane" and follow is None:
        raise InputError(f"Surface {tag} is plane: give follow=, the function to mesh it for.")
    held = _held(gmsh, tag)
    if follow is None:
        job = _discrete(gmsh, tag, tol, up, held, options)
    else:
        job = _plane(gmsh, tag, tol, follow, options)
    if not job.result.status.usable:
        raise InputError(job.result.status.value)
    replace_mesh(gmsh, tag, job.curves, job.patch)
    return job.result


@dataclass(frozen=True, eq=False)
class _Job:
    """What is about to be put into the model."""

    result: equimesh.Result
    curves: Sequence[Curve]
    patch: Patch


def _discrete(
    gmsh: Any, tag: int, tol: Any, up: Any, held: set[int], options: dict[str, Any]
) -> _Job:
    points, triangles = surface_mesh(gmsh, tag)
    field = Surface(points, triangles, up=up)
    result = equimesh.remesh(field, tol, **options)
    curves = curves_of(gmsh, tag, 0.0)
    ends = _ends(gmsh, curves)
    seen = in_projection(points, field)
    flat = {end: in_projection(place[None], field)[0] for end, place in ends.items()}
    pieces = [in_projection(c.pieces.reshape(-1, 3), field).reshape(-1, 2, 3) for c in curves]
    laid = fitted(result.points, result.triangles, pieces, curves, flat)
    result = _described(gmsh, result, laid, curves, field)
    a, b, c = (seen[triangles[:, i], :2] for i in range(3))
    turned = float(((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum()) < 0.0
    patch = replace(
        laid,
        points=field.to_input(laid.points),
        triangles=laid.triangles[:, ::-1] if turned else laid.triangles,
    )
    for point, vertex in patch.corners.items():
        gap = np.linalg.norm(patch.points[vertex] - ends[point])
        if point in held and gap > SAME * np.ptp(points, axis=0).max():
            raise InputError(
                f"Point {point} would move, and other meshed parts of the model hang on it: "
                "lower the tolerance."
            )
    return _Job(replace(result, points=patch.points), curves, patch)


def _plane(gmsh: Any, tag: int, tol: Any, follow: Source | int, options: dict[str, Any]) -> _Job:
    if gmsh.model.mesh.getEmbedded(2, tag):
        raise InputError(
            f"Surface {tag} has points or curves embedded in it: cut the surface along them."
        )
    curves = curves_of(gmsh, tag, CHORDS)
    domain, height = plane_domain(gmsh, tag, curves)
    source = view_surface(int(follow)) if isinstance(follow, (int, np.integer)) else follow
    ends = _ends(gmsh, curves)
    size = float(np.ptp(shapely.get_coordinates(domain), axis=0).max())
    pinned = "constraints" not in options and not isinstance(source, equimesh.Metric)
    for _ in range(_ROUNDS):
        if pinned:
            options = {**options, "constraints": _pins(ends, domain, SAME * size)}
        result = equimesh.remesh(source, tol, domain, **options)
        laid = fitted(result.points, result.triangles, [c.pieces for c in curves], curves, ends)
        laid, moved = on_curves(gmsh, laid, curves, height)
        whole = moved == 0.0 or _areas(laid).min() > 0.0
        chain, crowded = chain_of(gmsh, laid, curves, height)
        if whole and not crowded and moved <= _NEAR * size:
            described = _described(gmsh, result, laid, curves, source, flat=True)
            if described.status.ok or moved == 0.0:
                break
        # Once more, between nodes that lie on the curves as densely as this mesh needs them.
        domain = shapely.build_area(shapely.MultiLineString(chain))
    else:
        raise InputError(
            f"The curved border of surface {tag} cannot be followed: raise the tolerance, or "
            "replace the curves by polygons."
        )
    plane = laid.points.copy()
    plane[:, 2] = height
    triangles = laid.triangles
    if gmsh.model.getType(2, tag) == "Plane":
        at = gmsh.model.getParametrization(2, tag, [*plane[0]])
        if gmsh.model.getNormal(tag, at)[2] < 0.0:
            triangles = triangles[:, ::-1]
    patch = replace(laid, points=plane, triangles=triangles)
    return _Job(described, curves, patch)


def _ends(gmsh: Any, curves: Sequence[Curve]) -> dict[int, Array]:
    """Where curves end, by the tags of points; ends without a point have numbers below zero."""
    ends = {end: gmsh.model.getValue(0, end, []) for curve in curves for end in curve.ends}
    loose = np.unique(np.concatenate([np.zeros((0, 3)), *(c.loose for c in curves)]), axis=0)
    return ends | {-1 - k: place for k, place in enumerate(loose)}


def _pins(ends: dict[int, Array], domain: shapely.Geometry, same: float) -> list[shapely.Point]:
    """The ends of curves as vertices that a mesh must have: those on straight borders are no
    corners of its domain, and put in later they would change its errors."""
    corners = shapely.MultiPoint(shapely.get_coordinates(domain))
    return [shapely.snap(shapely.Point(place[:2]), corners, same) for place in ends.values()]


def _areas(patch: Patch) -> Array:
    """Twice the areas in the plane."""
    a, b, c = (patch.points[patch.triangles[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def _described(
    gmsh: Any,
    result: equimesh.Result,
    patch: Patch,
    curves: Sequence[Curve],
    source: Any,
    *,
    flat: bool = False,
) -> equimesh.Result:
    """The result of the fitted mesh: curves by their names, errors measured on it."""
    profile = result.profile
    if isinstance(source, equimesh.Metric):
        profile = _in_metric(result, patch, source)
    elif flat or len(patch.points) != len(result.points):
        points = patch.points[:, :2] if flat else patch.points
        profile = equimesh.profile(points, patch.triangles, source, limit=result.tol)
    boundary = result.boundary
    if curves:
        named = {curve.tag: _name(gmsh, curve.tag) for curve in curves}
        names = tuple(dict.fromkeys(named.values()))
        owner = np.array([names.index(named[tag]) for tag in patch.owners.tolist()], np.int64)
        boundary = equimesh.Boundary(border_edges(patch.triangles), owner, names)
    status = equimesh.Status.CONVERGED
    if not isinstance(source, equimesh.Metric) and profile.bound > result.tol * (1.0 + 1e-9):
        status = equimesh.Status.NOT_CONVERGED
    return replace(
        result,
        points=profile.points,
        triangles=profile.triangles,
        boundary=boundary,
        profile=profile,
        status=status if result.status.ok else result.status,
    )


def _in_metric(result: equimesh.Result, patch: Patch, metric: equimesh.Metric) -> equimesh.Profile:
    """The lengths on the fitted mesh, in the multiple of the metric that the result is unit in."""
    from equimesh.riemann.profile import MetricProfile, metric_profile

    assert isinstance(result.profile, MetricProfile)
    plain = metric_profile(metric, result.points, result.triangles)
    scale = float(result.profile.lengths.sum() / plain.lengths.sum())
    flat = np.column_stack([patch.points[:, :2], np.zeros(len(patch.points))])
    return metric_profile(metric.scaled(scale), flat, patch.triangles)


def _name(gmsh: Any, tag: int) -> str:
    for group in gmsh.model.getPhysicalGroupsForEntity(1, tag):
        name = gmsh.model.getPhysicalName(1, group)
        if name:
            return str(name)
    return f"curve {tag}"


def _held(gmsh: Any, tag: int) -> set[int]:
    """Points at the surface on which other meshed parts of the model hang.

    Raises InputError where others hang on more than that: on nodes or curves to be replaced.
    """
    curves = boundary_tags(gmsh, tag)
    mine = {(2, tag), *((1, number) for number in curves)}
    points = {number: _numbers(gmsh.model.mesh.getNodes(0, number)[0]) for _, number in
              gmsh.model.getEntities(0)}  # fmt: skip
    fixed = np.concatenate([np.zeros(0, np.int64), *points.values()])
    doomed = [gmsh.model.mesh.getNodes(*entity)[0] for entity in mine]
    doomed += [nodes for entity in mine for nodes in gmsh.model.mesh.getElements(*entity)[2]]
    replaced = np.setdiff1d(np.concatenate([_numbers(nodes) for nodes in doomed]), fixed)
    beside = {
        (2, int(number)) for curve in curves for number in gmsh.model.getAdjacencies(1, curve)[0]
    } | {(3, int(number)) for number in gmsh.model.getAdjacencies(2, tag)[0]}
    used = [np.zeros(0, np.int64)]
    for entity in gmsh.model.getEntities():
        if entity in mine or entity[0] == 0:
            continue
        nodes = [_numbers(c) for c in gmsh.model.mesh.getElements(*entity)[2]]
        if (nodes and entity in beside) or any(np.isin(n, replaced).any() for n in nodes):
            what = {1: "curve", 2: "surface", 3: "volume"}[entity[0]]
            raise InputError(
                f"Surface {tag} shares its border with the mesh of {what} {entity[1]}: clear that "
                "mesh first with gmsh.model.mesh.clear, and mesh it again afterwards."
            )
        used += nodes
    if any(gmsh.model.mesh.getPeriodic(1, [curve])[0] != curve for curve in curves):
        raise InputError(f"Surface {tag} has periodic curves: remove the periodicity first.")
    return {
        number for number, nodes in points.items() if np.isin(nodes, np.concatenate(used)).any()
    }


def _numbers(nodes: Any) -> IntArray:
    return np.asarray(nodes, np.int64)
