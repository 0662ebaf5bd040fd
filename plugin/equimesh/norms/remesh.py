"""A mesh for a norm of the error: the metric of that norm, scaled in a few runs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.domain import DomainLike, domain_geometry
from equimesh.errors import InputError
from equimesh.fields import Source, as_field
from equimesh.fields.base import Field
from equimesh.fields.kink_kernels import sharpest
from equimesh.norms.densities import POWERS, constants, least_triangles, patch_hessian
from equimesh.norms.measure import norm_profile
from equimesh.result import Result, Status
from equimesh.riemann.error_metric import limited_tensors
from equimesh.riemann.metric import Metric
from equimesh.riemann.remesh import remesh_metric
from equimesh.target import first_tolerance

__all__ = ["norm_metric", "remesh_norm"]

Array = NDArray[np.float64]

NORMS = ("max", "L1", "L2", "gradient")
_RUNS = 8
_CLOSE, _AIM = 0.97, 0.985  # of the tolerance: near enough, and what a run aims at
_BLEND = 0.1  # of the limited determinant: where det H is as small, its sign counts half
_STALLED = 0.9  # of the last error: with over twice the triangles it should be far less
_LOOK = 1e-2  # of the range of z: the tolerance whose patches are to tell kinks
_SHARP = 3.0  # tolerances: a jump of the gradient that no mesh of any use goes across
_FEWEST = 8.0  # triangles of a first run
_FACTOR = 8.0  # from one run's triangles to the next one's, at most


def remesh_norm(
    source: Source,
    tol: float | str | None,
    domain: DomainLike,
    norm: str,
    *,
    effort: str = "balanced",
    seed: int = 0,
    progress: Callable[[str, float], Any] | None = None,
    **others: Any,
) -> Result:
    """The mesh of a function whose error in a norm is at most ``tol``, and at least nearly that.

    Parameters
    ----------
    norm
        ``"L1"``, ``"L2"`` or ``"gradient"``; see ``NormProfile``. ``tol`` has its units: those of
        z times an area, z times a length, or z over a length.
    others
        Options of ``remesh`` that do not go with a norm; anything but None or () is refused.

    Returns
    -------
    Result
        ``profile`` is a ``NormProfile``, ``lower_bound`` the fewest triangles of that norm.

    Raises
    ------
    InputError
        The source is no function, or the options make no sense for a norm.
    """
    height = _checked(norm, tol, domain, others)
    geometry = domain_geometry(domain)
    surface = as_field(source, geometry)
    if surface.size != "function":
        raise InputError(f"norm={norm!r} is for functions: leave it out for rasters and surfaces.")
    low, high = surface.span(geometry)
    if norm == "gradient" and high > low:
        _refuse_kinks(surface, geometry, height, high - low)
    least = least_triangles(surface, geometry, norm, height)
    count = max(_FEWEST, 1.1 * least)
    metric = norm_metric(surface, geometry, norm, count)
    worth = metric.unit_triangles(geometry)
    rate = 1.0 if norm in POWERS else 2.0
    seconds: dict[str, float] = {}
    best: Result | None = None
    last, stalled = math.inf, 0
    for _ in range(_RUNS):
        mesh = remesh_metric(
            metric, worth / count, domain, effort=effort, seed=seed, progress=progress
        )
        for stage, spent in mesh.timings.items():
            seconds[stage] = seconds.get(stage, 0.0) + spent
        found = _measured(mesh, surface, norm, height, least)
        value = found.profile.bound
        if best is None or _better(found, best):
            best = found
        rounding = 1e-13 * max(abs(low), abs(high)) * shapely.area(geometry)
        if _CLOSE * height <= value <= height or value <= rounding:
            break
        factor = (value / (_AIM * height)) ** rate
        following = max(2.0, count * min(max(factor, 1.0 / _FACTOR), _FACTOR))
        # A gradient that jumps stays wrong however small the triangles are that cross the kink.
        stalled = stalled + 1 if value > _STALLED * last else 0
        if following == count or stalled == 2:
            break
        last = value if following > 2.0 * count else math.inf
        count = following
    assert best is not None
    return dataclasses.replace(best, timings=seconds)


def _checked(norm: str, tol: float | str | None, domain: DomainLike, others: Any) -> float:
    if norm not in NORMS[1:]:
        raise InputError(f"The norm {norm!r} is unknown: choose max, L1, L2 or gradient.")
    for name, value in others.items():
        if value is not None and not (isinstance(value, tuple | list) and len(value) == 0):
            raise InputError(f"norm={norm!r} does not go with {name}=: leave that out.")
    try:
        height = float(tol) if tol is not None else math.nan
    except (TypeError, ValueError):
        height = math.nan
    if not (math.isfinite(height) and height > 0.0):
        raise InputError(
            f"norm={norm!r} needs tol= as a positive number in the norm's own units, not {tol!r}."
        )
    if domain is None:
        raise InputError(
            "A function has no domain of its own: give domain=(xmin, ymin, xmax, ymax)."
        )
    return height


def _refuse_kinks(surface: Field, geometry: shapely.Geometry, tol: float, span: float) -> None:
    """Triangles that cross a kink miss half the gradient's jump, however small they are."""
    kernel, frame = surface.kernel(geometry, _LOOK * span), surface.frame(geometry)
    jump, x, y = sharpest(kernel)
    jump /= math.sqrt(abs(frame.determinant))
    if jump > _SHARP * tol:
        px, py = frame.to_user(np.array([[x, y]]))[0]
        raise InputError(
            f"The function has a kink near ({px:.6g}, {py:.6g}), where its gradient jumps by about "
            f"{jump:.2g}: give norm='max', 'L1' or 'L2', or mesh either side of it by itself."
        )


def norm_metric(surface: Field, geometry: shapely.Geometry, norm: str, count: float) -> Metric:
    """The metric in which the best mesh of about ``count`` triangles has unit edges, up to scale.

    Triangles are equilateral in |H|, its eigenvalues limited near det H = 0 as for the largest
    error of such a mesh. That is the best shape for L1 and L2 where H is definite, and for L2
    anywhere. The gradient's error of longer ones depends on how they are turned, which a metric
    does not tell: equilateral ones in |H| have the area ``3 sqrt(3) / 4 tol^2 sqrt(r) / det`` at
    least however they lie, r = |l2 / l1|, and no other diagonal metric does much better.
    """
    tol = first_tolerance(surface, geometry, int(count))
    kernel, frame = surface.kernel(geometry, tol), surface.frame(geometry)
    hessian = patch_hessian(surface, geometry, tol)
    inverse = np.linalg.inv(frame.matrix)
    extent = float(np.ptp(frame.to_local(np.reshape(geometry.bounds, (2, 2))), axis=0).max())

    def tensor(x: Array, y: Array) -> Array:
        local = np.ascontiguousarray(frame.to_local(np.stack([x, y], 1)))
        m = limited_tensors(
            kernel.frame, kernel.child, kernel.coef, local, 8.0 * tol, 1.0 / extent**2
        )
        det = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] ** 2
        root = np.sqrt(det)
        if norm in POWERS:
            p = POWERS[norm]
            h = hessian(x, y)
            true = (h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2) * frame.determinant**2
            # -1 or 1 where the limits have no say, and smooth in between.
            definite = true / (np.abs(true) + _BLEND * (6.0 * tol) ** 2 * det)
            density = (constants(norm, definite) * root) ** (p / (p + 1.0))
        else:
            mean = 0.5 * (m[:, 0, 0] + m[:, 1, 1])
            radius = np.hypot(0.5 * (m[:, 0, 0] - m[:, 1, 1]), m[:, 0, 1])
            density = root * (mean + radius)  # det / sqrt(r)
        return np.asarray(inverse.T @ ((density / root)[:, None, None] * m) @ inverse)

    return Metric(tensor)


def _measured(mesh: Result, surface: Field, norm: str, tol: float, least: float) -> Result:
    points = mesh.points.copy()
    points[:, 2] = surface.value(points[:, 0], points[:, 1])
    profile = norm_profile(surface, points, mesh.triangles, norm)
    return dataclasses.replace(
        mesh,
        points=points,
        profile=profile,
        tol=tol,
        lower_bound=least,
        status=Status.CONVERGED if profile.bound <= tol else Status.NOT_CONVERGED,
        input_size=surface.size,
    )


def _better(one: Result, other: Result) -> bool:
    if one.status.ok != other.status.ok:
        return one.status.ok
    if one.status.ok:
        return len(one.triangles) < len(other.triangles)
    return one.profile.bound < other.profile.bound
