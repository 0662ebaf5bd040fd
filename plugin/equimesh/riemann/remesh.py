"""A unit mesh in a given metric: boundary nodes, lattice, triangulation, relaxation, profile."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.boundary import BoundaryNodes
from equimesh.domain import DomainLike, Sides, domain_geometry, sides_of
from equimesh.errors import InputError
from equimesh.frame import Frame
from equimesh.optimise.mesh import FIXED, FREE, Mesh, build, compact
from equimesh.optimise.relax import make_queue
from equimesh.result import Boundary, Result, Status
from equimesh.riemann.boundary import boundary_nodes
from equimesh.riemann.kernels import metric_at, unit_frame
from equimesh.riemann.lattice import lattice_points
from equimesh.riemann.metric import Metric
from equimesh.riemann.patches import MetricPatches, fit_metric
from equimesh.riemann.profile import metric_profile
from equimesh.riemann.relax import improve, relax_all, set_energies
from equimesh.riemann.tensors import exponential, logarithm
from equimesh.stages import Report, Stages
from equimesh.triangulation import constrained_delaunay

__all__ = ["remesh_metric"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNIT_SHARE = 0.98  # of the edges, for the status
_MOST = 2e7  # triangles that memory is meant to hold
_VISITS, _IDLE = 40, 1e-4  # of a vertex in relaxation; smaller gains wake nobody
_STRETCH = 1e8  # of the eigenvalues of the mean metric that coordinates undo
# Steps of a sequence without clusters in the square: powers of the plastic number (M. Roberts).
_SPREAD = np.array([0.7548776662466927, 0.5698402909980532])
_CLOSE, _AIM = (0.97, 1.0), 0.99  # triangles over a target
_RUNS = 6


@dataclass(frozen=True)
class _Effort:
    """Lengths of edges below and above which collapses and splits are tried; rounds of them."""

    low: float
    high: float
    rounds: int


_EFFORTS = {
    "fast": _Effort(0.7, 1.4, 1),
    "balanced": _Effort(0.8, 1.25, 1),
    "best": _Effort(1.0, 1.0, 4),
}


def remesh_metric(
    metric: Metric,
    tol: float | str | None = None,
    domain: DomainLike = None,
    *,
    target: int | None = None,
    fit: str = "interpolate",
    effort: str = "balanced",
    seed: int = 0,
    progress: Callable[[str, float], Any] | None = None,
    constraints: Sequence[Any] = (),
) -> Result:
    """A mesh whose edges have the length one in a metric.

    Parameters
    ----------
    tol
        Scales the metric as a tolerance does that of an error, ``M / tol``: at 4 edges are twice as
        long and triangles a quarter as many. 1 where left out.
    domain
        ``(xmin, ymin, xmax, ymax)`` or a shapely polygon with holes.
    target
        A number of triangles instead: the metric is scaled so that the mesh has at most as many,
        and at least 97 % where the domain's outline lets it.
    fit, constraints
        Not for metrics.
    effort, seed, progress
        As for ``remesh``.

    Returns
    -------
    Result
        Heights are zero; ``profile`` is a ``MetricProfile``, ``lower_bound`` the number of unit
        triangles ``4 / sqrt(3)`` times the integral of sqrt(det M), and the status ok if at least
        98 % of the edges have a length from 1/sqrt(2) to sqrt(2). There is no error to certify.

    Raises
    ------
    InputError
        No metric on the whole domain, or options that make no sense for one.
    """
    stages = Stages(progress)
    with stages.stage("field"):
        if fit != "interpolate" or len(constraints):
            raise InputError("A metric takes neither fit= nor constraints=: leave them out.")
        geometry, scale = _checked(metric, tol, domain, target, effort)
    if target is None:
        return _unit_mesh(metric, scale, geometry, effort, stages, seed)
    best: Result | None = None
    for _ in range(_RUNS):
        result = _unit_mesh(metric, scale, geometry, effort, stages, seed)
        count = len(result.triangles)
        if count <= target and (best is None or count > len(best.triangles)):
            best = result
        if _CLOSE[0] * target <= count <= _CLOSE[1] * target:
            break
        scale *= count / (_AIM * target)
    if best is None:
        raise InputError(
            f"No mesh with {target} triangles was found: the domain's outline needs more; raise it."
        )
    return best


def _checked(
    metric: Metric, tol: float | str | None, domain: DomainLike, target: int | None, effort: str
) -> tuple[shapely.Geometry, float]:
    """The domain and the number by which the metric is to be divided."""
    if domain is None:
        raise InputError("A metric has no domain of its own: give domain=(xmin, ymin, xmax, ymax).")
    if effort not in _EFFORTS:
        raise InputError(f"The effort {effort!r} is unknown: choose fast, balanced or best.")
    if tol is not None and target is not None:
        raise InputError("Give either tol= or target=, one of the two.")
    geometry = domain_geometry(domain)
    if target is not None:
        if int(target) < 2:
            raise InputError(f"The target is {target} triangles: give 2 or more.")
        return geometry, metric.unit_triangles(geometry) / (_AIM * int(target))
    try:
        scale = 1.0 if tol is None else float(tol)
    except (TypeError, ValueError):
        scale = math.nan
    if not (math.isfinite(scale) and scale > 0.0):
        raise InputError(
            f"The tolerance {tol!r} scales the metric: give a positive number such as 1."
        )
    return geometry, scale


def _unit_mesh(
    metric: Metric,
    scale: float,
    geometry: shapely.Geometry,
    effort: str,
    stages: Stages,
    seed: int,
) -> Result:
    with stages.stage("field"):
        if scale != 1.0:
            metric = metric.scaled(scale**-0.5)
        expected = metric.unit_triangles(geometry)
        if not expected <= _MOST:
            raise InputError(
                f"The metric asks for about {expected:.1e} triangles: scale it, or mesh the domain "
                "in parts."
            )
        frame = _frame(metric, geometry)
        patches = fit_metric(metric, frame.geometry_to_local(geometry), frame)
    with stages.stage("seed"):
        sides = sides_of(geometry)
        nodes = boundary_nodes(metric, sides)
        border, place = _without_doubles(nodes)
        # Where sides are shorter than a unit edge, each node that is too many costs a triangle.
        length = metric.lengths(nodes.points, nodes.points[nodes.following]).sum()
        goal = expected + max(0.0, len(nodes.points) - float(length))
        mesh = _first_mesh(patches, sides, nodes, border, frame, goal)
    with stages.stage("optimise") as report:
        mesh = _optimise(patches, mesh, _EFFORTS[effort], goal, report)
    with stages.stage("certify"):
        local, triangles, _, _ = compact(mesh)
        points = frame.to_user(local[:, :2])
        points[: len(place)] = nodes.points[place]
        profile = metric_profile(metric, points, triangles)
        edges = np.stack([border, border[nodes.following]], 1)
    return Result(
        points=profile.points,
        triangles=triangles,
        boundary=Boundary(edges, sides.tags[nodes.side], sides.names),
        profile=profile,
        tol=scale,
        lower_bound=expected,
        status=Status.UNIT if profile.share >= UNIT_SHARE else Status.NOT_UNIT,
        seed=seed,
        input_size="metric",
        timings=stages.seconds,
    )


def _frame(metric: Metric, geometry: shapely.Geometry) -> Frame:
    """Coordinates in which the mean of the metric is isotropic."""
    xmin, ymin, xmax, ymax = shapely.bounds(geometry)
    grid = np.meshgrid(np.linspace(xmin, xmax, 33), np.linspace(ymin, ymax, 33))
    x, y = (a.ravel() for a in grid)
    shapely.prepare(geometry)
    inside = shapely.contains_xy(geometry, x, y)
    corners = shapely.get_coordinates(geometry)
    x, y = np.append(x[inside], corners[:, 0]), np.append(y[inside], corners[:, 1])
    mean = exponential(logarithm(metric(x, y)).mean(0)[None])[0]
    values, vectors = np.linalg.eigh(mean)
    values = np.maximum(values, values.max() / _STRETCH)
    root = vectors @ np.diag(values**-0.5) @ vectors.T
    origin = np.array([0.5 * (xmin + xmax), 0.5 * (ymin + ymax)])
    extent = np.ptp((corners - origin) @ np.linalg.inv(root).T, axis=0).max()
    return Frame(origin, 0.5 * extent * root)


def _without_doubles(nodes: BoundaryNodes) -> tuple[IntArray, IntArray]:
    """(b,) vertex of every node and (k,) one node of every vertex: rings may touch in a corner."""
    _, first, index = np.unique(nodes.points, axis=0, return_index=True, return_inverse=True)
    order = np.sort(first)
    return np.searchsorted(order, first)[index.ravel()], order


def _first_mesh(
    patches: MetricPatches,
    sides: Sides,
    nodes: BoundaryNodes,
    border: IntArray,
    frame: Frame,
    goal: float,
) -> Mesh:
    local = Sides(frame.to_local(sides.corners), sides.following, sides.tags, sides.names)
    nodes = BoundaryNodes(frame.to_local(nodes.points), nodes.side, nodes.corner, nodes.following)
    edges = np.stack([border, border[nodes.following]], 1)
    outline = np.empty((border.max() + 1, 2))
    outline[border] = nodes.points
    # Euler's formula for a polygon: triangles = 2 inner + outer vertices - 2 (parts - holes).
    fewest = len(constrained_delaunay(outline, edges))
    wanted = max(1, round(0.5 * (goal - fewest)))
    inner = lattice_points(patches, local, nodes, _starts(patches, local, nodes, wanted), wanted)
    points = np.vstack([outline, inner])
    triangles = constrained_delaunay(points, edges)
    kind = np.full(len(points), FREE, np.int8)
    kind[: len(outline)] = FIXED
    segments = np.hstack([local.corners, local.corners[local.following]])
    return build(
        np.column_stack([points, np.zeros(len(points))]),
        triangles, kind, np.zeros(len(points), np.int64), segments,
    )  # fmt: skip


def _starts(
    patches: MetricPatches, sides: Sides, nodes: BoundaryNodes, count: int
) -> tuple[Array, Array]:
    """(k, 3) places and angles: aligned with the sides, most nodes first, or spread out."""
    tally = np.bincount(nodes.side, minlength=len(sides.corners))
    rows = []
    for s in np.argsort(-tally, kind="stable"):
        own = np.flatnonzero(nodes.side == s)
        a = nodes.points[own[len(own) // 2]]
        b = nodes.points[nodes.following[own[len(own) // 2]]]
        w = np.reshape(unit_frame(*metric_at(patches, *(0.5 * (a + b)))), (2, 2))
        step = np.linalg.solve(w, b - a)
        apex = 0.5 * (a + b) + w @ (0.5 * math.sqrt(3.0) * np.array([-step[1], step[0]]))
        rows.append([*apex, math.atan2(step[1], step[0])])
    low, high = sides.corners.min(0), sides.corners.max(0)
    place = (0.5 + np.arange(2 * count + 64)[:, None] * _SPREAD) % 1.0
    spread = np.column_stack([low + place * (high - low), np.zeros(len(place))])
    return np.vstack([np.array(rows), spread]), spread


def _optimise(
    patches: MetricPatches,
    mesh: Mesh,
    effort: _Effort,
    goal: float,
    report: Report,
) -> Mesh:
    set_energies(patches, mesh)
    queue, todo = make_queue(len(mesh.x)), make_queue(len(mesh.x))
    relax_all(patches, mesh, queue, _VISITS, _IDLE)
    report(0.3)
    for k in range(effort.rounds):
        kept = improve(patches, mesh, queue, todo, effort.low, effort.high, goal)
        relax_all(patches, mesh, queue, _VISITS, _IDLE)
        report(0.3 + 0.7 * (k + 1) / effort.rounds)
        if kept == 0:
            break
    return mesh
