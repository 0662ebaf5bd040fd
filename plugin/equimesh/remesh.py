"""The whole method: field and domain, first mesh, optimisation, certificate."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import numpy as np
import shapely

from equimesh.angles import AngleFloor, checked_angle
from equimesh.constraints import with_constraints
from equimesh.domain import DomainLike, domain_geometry, sides_of
from equimesh.drafts import best_drafts, finished
from equimesh.errors import InputError
from equimesh.fields import Bound, Field, Source, as_field
from equimesh.fields.raster import Raster
from equimesh.integrals import lower_bound
from equimesh.optimise.effort import EFFORTS
from equimesh.optimise.mending import repair
from equimesh.optimise.mesh import Mesh
from equimesh.outcome import tagged_constraints, user_mesh
from equimesh.profile import profile_again, profile_of
from equimesh.result import Result, Status
from equimesh.riemann.metric import Metric
from equimesh.stages import Stages

__all__ = ["Effort", "Fit", "Progress", "remesh"]

Progress: TypeAlias = Callable[[str, float], Any]
Fit: TypeAlias = Literal["interpolate", "best"]
Effort: TypeAlias = Literal["fast", "balanced", "best"]
Norm: TypeAlias = Literal["max", "L1", "L2", "gradient"]

_REPAIRS = 8
_EXACT = 0.9999  # of the tolerance: what rounding leaves where errors are exact


def remesh(
    source: Source | Metric,
    tol: float | str | None = None,
    domain: DomainLike = None,
    *,
    target: int | None = None,
    max_triangles: int | None = None,
    fit: Fit = "interpolate",
    effort: Effort = "balanced",
    seed: int = 0,
    progress: Progress | None = None,
    constraints: Any = (),
    bound: Bound | None = None,
    min_angle: float | None = None,
    norm: Norm = "max",
) -> Result:
    """The mesh with few triangles that represents a surface to within a tolerance.

    Parameters
    ----------
    source
        A vectorised callable ``f(x, y)``, an expression in x and y, a 2-D array of heights (rows
        are y) or a field.
    tol
        Largest vertical distance between surface and mesh: a number in units of z or a share of the
        range of z such as ``"1%"``.
    domain
        ``(xmin, ymin, xmax, ymax)`` or a shapely polygon with holes; rasters and triangle surfaces
        have an outline of their own, which a domain cuts.
    target
        A number of triangles instead of ``tol``: the smallest tolerance that it reaches.
    max_triangles
        With ``tol``: where so many triangles do not reach it, the mesh with the smallest tolerance
        that they reach. Then the status is ``LIMITED``, which is not ``ok``, and ``result.tol`` is
        the certified tolerance.
    fit
        ``"interpolate"``: vertices lie on the surface. ``"best"``: they may leave it by up to the
        tolerance, which saves up to half the triangles where the surface is convex or concave.
    effort
        ``"fast"``, ``"balanced"`` or ``"best"``: time against triangles.
    seed
        Same input and seed give the same bytes.
    progress
        Called as ``progress(stage, fraction)``; returning False cancels (``Cancelled`` is raised).
    constraints
        Lines that must be edges of the mesh and points that must be vertices: shapely geometries
        or (n, 2) arrays in a sequence, a mapping ``{name: lines}``, or a GeoJSON file. Lines may
        cross; what lies outside the domain is cut off. ``result.constraints`` has their edges.
    bound
        For rasters: ``"surface"``, the error counts everywhere on the bilinear surface (so it does
        if nothing is said), or ``"samples"``, at the samples only.

    min_angle
        Degrees, at most 30: no angle of a triangle, seen from above, is smaller, except at vertices
        where sides of the domain or constraints meet at a smaller one. A note tells the price in
        triangles.
    norm
        What ``tol`` bounds: ``"max"``, the largest error; of functions also ``"L1"``, the integral
        of |f - f_h|; ``"L2"``, the root of the integral of its square; ``"gradient"``, the largest
        Euclidean length of the gradient of f - f_h. Then ``profile`` is a ``NormProfile`` and
        ``lower_bound`` that norm's.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        The input cannot be meshed; the message says what to do.

    Examples
    --------
    >>> result = remesh("x*y", tol=0.01, domain=(0, 0, 1, 1))
    >>> result.status.ok, result.profile.bound <= 0.01
    (True, True)
    """
    if isinstance(source, Metric):
        from equimesh.riemann.remesh import remesh_metric

        if max_triangles is not None:
            raise InputError("A metric takes no max_triangles=: give target=, or tol= alone.")
        if min_angle is not None:
            raise InputError("A metric takes no min_angle=: its triangles are equilateral in it.")
        if norm != "max":
            raise InputError("A metric takes no norm=: it has no error to measure.")
        return remesh_metric(
            source, tol, domain, target=target, fit=fit, effort=effort, seed=seed,
            progress=progress, constraints=constraints,
        )  # fmt: skip
    if norm != "max":
        from equimesh.norms import remesh_norm

        return remesh_norm(
            source, tol, domain, norm, effort=effort, seed=seed, progress=progress, target=target,
            max_triangles=max_triangles, fit=None if fit == "interpolate" else fit,
            constraints=constraints, bound=bound, min_angle=min_angle,
        )  # fmt: skip
    _check_options(tol, target, max_triangles, fit, effort, seed)
    angle = None if min_angle is None else checked_angle(min_angle)
    most = max_triangles if target is None else target
    if most is not None:
        from equimesh.target import remesh_to_target

        return remesh_to_target(
            source, most, domain, tol, fit=fit, effort=effort, seed=seed, progress=progress,
            bound=bound, constraints=constraints, min_angle=min_angle,
        )  # fmt: skip
    assert tol is not None
    stages = Stages(progress)
    with stages.stage("field"):
        geometry = None if domain is None else domain_geometry(domain)
        surface = as_field(source, geometry, bound)
        whole = geometry if geometry is not None else surface.outline(0.0)
        height = tolerance(tol, surface, whole)
        covered = _covered(surface, geometry, height)
        meshed, unit, lowest = surface, 1.0, 0.0
        if isinstance(surface, Raster):
            (meshed, lowest), unit = surface.in_tolerances(height), height
        kernel = meshed.kernel(covered, height / unit)
        if fit == "best":
            kernel = kernel.two_sided()
        frame = surface.frame(covered)
    with stages.stage("seed") as report:
        sides = with_constraints(sides_of(covered), constraints, covered, frame)
        floor = None if angle is None else AngleFloor.of(angle, sides)
        if floor is not None:
            kernel = floor.kept_by(kernel, frame)
        starts = best_drafts(
            meshed, kernel, sides, frame, height / unit, effort, fit == "best", report
        )
    with stages.stage("optimise") as report:
        start, mesh, good = finished(kernel, starts, effort, report, _EXACT * height / unit)
    with stages.stage("certify"):
        points, triangles, boundary, slots = user_mesh(mesh, start, frame, surface, unit, lowest)
        profile = profile_of(surface, points, triangles, height)
    for _ in range(_REPAIRS if good else 0):
        bad = np.flatnonzero(profile.bounds > height)
        if len(bad) == 0:
            break
        with stages.stage("optimise"):
            errors = profile.bounds[bad] / height
            mesh = repair(kernel, mesh, start.aim, slots[bad], errors)
        with stages.stage("certify"):
            row = np.full(len(mesh.tv), -1)
            row[slots] = np.arange(len(slots))
            points, triangles, boundary, slots = user_mesh(
                mesh, start, frame, surface, unit, lowest
            )
            profile = profile_again(surface, points, triangles, height, profile, row[slots])
    least = math.nan
    if surface.smooth:
        least = _lower_bound(surface, kernel, mesh, height)
    status = Status.CONVERGED if profile.bound <= height else Status.NOT_CONVERGED
    notes = (*getattr(surface, "notes", ()), *sides.lines.notes)
    if floor is not None:
        if status.ok and len(floor.missed(points, triangles)):
            status = Status.SHARP
        notes = (*notes, floor.note(profile, least, kernel, mesh))
    return Result(
        points=points,
        triangles=triangles,
        boundary=boundary,
        profile=profile,
        tol=height,
        lower_bound=least,
        status=status,
        seed=seed,
        input_size=surface.size,
        timings=stages.seconds,
        notes=notes,
        metadata=dict(getattr(surface, "metadata", {})),
        constraints=tagged_constraints(mesh, start),
    )


def _check_options(
    tol: float | str | None,
    target: int | None,
    max_triangles: int | None,
    fit: str,
    effort: str,
    seed: int,
) -> None:
    if (tol is None) == (target is None):
        raise InputError("Give either tol= or target=, one of the two.")
    if target is not None and max_triangles is not None:
        raise InputError("max_triangles= goes with tol=: leave it out beside target=.")
    counts: dict[str, Any] = {"target": target, "max_triangles": max_triangles}
    for name, count in counts.items():
        whole = isinstance(count, int | np.integer) and not isinstance(count, bool)
        if count is not None and not (whole and count >= 2):
            raise InputError(f"{name}={count!r} is no number of triangles: give 2 or more.")
    if effort not in EFFORTS:
        raise InputError(f"The effort {effort!r} is unknown: choose fast, balanced or best.")
    if fit not in ("interpolate", "best"):
        raise InputError(f"The fit {fit!r} is unknown: use interpolate or best.")
    if isinstance(seed, bool) or int(seed) != seed or seed < 0:
        raise InputError(f"The seed is {seed!r}: give an integer of 0 or more.")


def tolerance(tol: float | str, surface: Field, domain: shapely.Geometry) -> float:
    """The tolerance in units of z, from a number or a text such as ``"1%"`` of the range of z."""
    share = None
    text = tol
    if isinstance(text, str):
        stripped = text.strip()
        if stripped.endswith("%"):
            share, stripped = 0.01, stripped[:-1]
        try:
            value = float(stripped)
        except ValueError:
            raise InputError(
                f"The tolerance {tol!r} is no number: give one such as 0.01 or 1%."
            ) from None
    else:
        try:
            value = float(tol)
        except (TypeError, ValueError):
            raise InputError(
                f"The tolerance {tol!r} is no number: give one such as 0.01 or '1%'."
            ) from None
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"The tolerance is {tol}: it must be a positive, finite number.")
    low, high = surface.span(domain)
    rounding = 1e-12 * max(abs(low), abs(high))
    height = value if share is None else max(value * share * (high - low), rounding, 1e-300)
    if height < rounding:
        raise InputError(
            f"The tolerance {height:.3g} is below the rounding of heights near {high:.3g}: "
            "raise it."
        )
    return height


def _covered(surface: Field, geometry: shapely.Geometry | None, height: float) -> shapely.Geometry:
    """The part of the plane that the mesh will cover."""
    if surface.size == "function":
        if geometry is None:
            surface.outline(height)
        assert geometry is not None
        return geometry
    outline = surface.outline(height)
    if geometry is None:
        return outline
    both = shapely.intersection(outline, geometry)
    parts = [p for p in shapely.get_parts(both) if p.geom_type == "Polygon" and p.area > 0.0]
    if not parts:
        raise InputError(
            "The domain does not meet the surface: give one that overlaps its outline."
        )
    return domain_geometry(parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts))


def _lower_bound(surface: Field, kernel: Any, mesh: Mesh, height: float) -> float:
    live = mesh.tv[:, 0] >= 0
    plane = np.stack([mesh.x, mesh.y], 1)
    if surface.size == "function":
        return lower_bound(kernel, plane, mesh.tv[live].astype(np.int64), height)
    return math.nan
