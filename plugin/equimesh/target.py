"""The smallest tolerance that a number of triangles reaches."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.domain import DomainLike, domain_geometry
from equimesh.errors import InputError
from equimesh.fields import Source, as_field
from equimesh.fields.base import Field
from equimesh.integrals import lower_bound_of
from equimesh.metric import AREA_CONVEX, AREA_SADDLE
from equimesh.result import Result, Status

__all__ = ["first_tolerance", "remesh_to_target", "smallest_tolerance"]

Array = NDArray[np.float64]
Run = Callable[[float], Result]

_RUNS = 6
_CLOSE, _AIM = 0.97, 0.985  # of the number of triangles: near enough, and what a run aims at
_ABOVE_BOUND = 1.08  # triangles of a usual mesh over N*
_OF_DIFFERENCES = 2.0  # usual tolerance of data over that of their differences at a mesh's scale
_GRID = 256  # cells a side for second derivatives
_SLOPES = (0.3, 4.0)  # of log count against -log tol; 1 for a smooth surface
_FAR = 0.05  # logarithms of tolerances: nearer than this, chance decides which mesh has more
_APART = 2e-3  # logarithms of tolerances that are tried
_FACTOR = 8.0  # from one tolerance to the next, at most
_LEAST = 0.02  # first tolerance times triangles over the range of heights; usual are 0.5 to 100
_ROUNDING = 1e-9


@dataclass(frozen=True)
class _Trial:
    """A tolerance that was tried, its number of triangles, and the bound on their errors."""

    tol: float
    count: int
    bound: float

    @property
    def met(self) -> bool:
        return self.bound <= self.tol


@dataclass
class _Search:
    """For the smallest tolerance, down to ``finest``, that ``most`` triangles reach."""

    most: int
    finest: float
    trials: list[_Trial] = field(default_factory=list)
    best: Result | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    def take(self, result: Result) -> bool:
        """Note a result; whether no better one is to be hoped for."""
        count = len(result.triangles)
        self.trials.append(_Trial(result.tol, count, result.profile.bound))
        for stage, spent in result.timings.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent
        if not self._fits(self.trials[-1]):
            return False
        if self.best is None or result.profile.bound < self.best.profile.bound:
            self.best = result
        settled = min(result.tol, result.profile.bound) <= self.finest
        return settled or count >= _CLOSE * self.most

    def _fits(self, trial: _Trial) -> bool:
        return trial.met and trial.count <= self.most

    def following(self) -> float:
        """The next tolerance: a secant in logarithms, kept between those that bracket it."""
        met = [trial for trial in self.trials if trial.met]
        if not met:
            last = self.trials[-1]
            return max(_FACTOR * last.tol, 1.01 * last.bound)
        logs = np.log([trial.tol for trial in met])
        excess = np.log([trial.count / (_AIM * self.most) for trial in met])
        k = int(np.abs(excess).argmin())
        near = np.abs(logs - logs[k]) < _FAR
        step = float(np.mean(logs[near] + excess[near] / _slope(logs, excess, k)))
        reach = math.log(_FACTOR)
        step = min(max(step, logs.min() - reach), logs.max() + reach)
        too_fine = [math.log(t.tol) for t in self.trials if not self._fits(t)]
        too_coarse = [math.log(t.tol) for t in self.trials if self._fits(t)]
        low, high = max(too_fine, default=-math.inf), min(too_coarse, default=math.inf)
        if low < high and math.isfinite(high - low):
            step = min(max(step, 0.9 * low + 0.1 * high), 0.1 * low + 0.9 * high)
        elif np.abs(logs - step).min() < _APART:  # another mesh, by chance with fewer triangles
            step += _APART
        return max(math.exp(step), self.finest)

    def answer(self) -> Result | None:
        """The best result with the seconds of all runs.

        Its tolerance is the one that its mesh is certified for: a few triangles may do better than
        what they were made for.
        """
        if self.best is None:
            return None
        tol = min(self.best.tol, self.best.profile.bound * (1.0 + _ROUNDING))
        tol = max(tol, self.finest)
        least = self.best.lower_bound * self.best.tol / tol
        return dataclasses.replace(self.best, tol=tol, lower_bound=least, timings=self.seconds)


def _slope(logs: Array, excess: Array, k: int) -> float:
    """Of -excess against log: from trial ``k`` to the nearest one that is far enough to tell, if
    there is one on the other side of what is aimed at."""
    distance = np.abs(logs - logs[k])
    distance[distance < _FAR] = math.inf
    beyond = np.isfinite(distance) & (excess * excess[k] < 0.0)
    if beyond.any():
        distance[~beyond] = math.inf
    other = int(distance.argmin())
    if not math.isfinite(distance[other]):
        return 1.0
    slope = -(excess[other] - excess[k]) / (logs[other] - logs[k])
    return float(np.clip(slope, *_SLOPES))


def remesh_to_target(
    source: Source,
    target: int,
    domain: DomainLike,
    tol: float | str | None = None,
    **options: Any,
) -> Result:
    """``remesh`` for a number of triangles: at most so many, at the smallest tolerance.

    With ``tol`` no smaller tolerance is asked for. If the triangles do not reach it the status is
    ``LIMITED``, and ``tol`` of the result what is certified.
    """
    from equimesh.remesh import remesh, tolerance

    geometry = None if domain is None else domain_geometry(domain)
    surface = as_field(source, geometry, options.get("bound"))
    whole = surface.outline(0.0) if geometry is None else geometry
    asked = 0.0 if tol is None else tolerance(tol, surface, whole)

    def run(height: float) -> Result:
        return remesh(surface, height, domain, **options)

    found = smallest_tolerance(run, surface, whole, target, asked)
    if not found.status.ok or tol is None or found.tol <= asked:
        return found
    note = (
        f"{target:,} triangles ended the run: the error is certified to be at most {found.tol:.6g},"
        f" not {asked:.6g}"
    )
    return dataclasses.replace(found, status=Status.LIMITED, notes=(*found.notes, note))


def smallest_tolerance(
    run: Run, surface: Field, domain: shapely.Geometry, most: int, finest: float = 0.0
) -> Result:
    """The mesh of at most ``most`` triangles, and nearly as many, of the smallest tolerance.

    The number of triangles goes like 1 / tol where the surface is smooth, and like some other power
    where it is rough; a few runs find it.

    Parameters
    ----------
    run
        Makes a mesh for a tolerance in units of z.
    domain
        The part of the plane to cover.
    finest
        No smaller tolerance is asked for.

    Raises
    ------
    InputError
        The domain's outline alone needs more triangles.
    """
    low, high = surface.span(domain)
    size = max(abs(low), abs(high))
    finest = max(finest, 4e-12 * size, _ROUNDING * (high - low), 1e-299)
    coarsest = max(2.0 * (high - low), finest)
    search = _Search(most, finest)
    tol = min(max(first_tolerance(surface, domain, most), finest), coarsest)
    for k in range(_RUNS):
        result = run(tol)
        if search.take(result):
            break
        if search.best is None and tol >= coarsest:
            if result.status.ok:
                raise InputError(
                    f"The domain's outline takes {len(result.triangles):,} triangles at least: "
                    f"allow more than {most:,}, or give a simpler domain."
                )
            return result
        if not result.status.ok and len(result.triangles) <= most and tol <= finest:
            return result  # more triangles would not help
        # The last run shows whether the outline lets it.
        last = search.best is None and k == _RUNS - 2
        tol = coarsest if last else min(search.following(), coarsest)
    found = search.answer()
    assert found is not None
    return found


def first_tolerance(surface: Field, domain: shapely.Geometry, triangles: int) -> float:
    """About the tolerance that a number of triangles reaches.

    A smooth surface's follows from N*. Where that tells nothing, on data and kinks, differences of
    heights at the distance of a mesh's vertices stand for second derivatives.
    """
    low, high = surface.span(domain)
    tol = 0.0
    if surface.size == "function":
        tol = _ABOVE_BOUND * _bound_of_one(surface, domain) / triangles
    if not tol > _LEAST * (high - low) / triangles:
        tol = _OF_DIFFERENCES * _by_differences(surface, domain, triangles)
    return max(tol, _LEAST * (high - low) / triangles)


def _bound_of_one(surface: Field, domain: shapely.Geometry) -> float:
    """N* times the tolerance, from midpoints of a grid."""
    xmin, ymin, xmax, ymax = shapely.bounds(domain)
    middle = (np.arange(_GRID) + 0.5) / _GRID
    x, y = np.meshgrid(xmin + middle * (xmax - xmin), ymin + middle * (ymax - ymin))
    inside = shapely.contains_xy(domain, x, y)
    if not inside.any():
        return 0.0
    with np.errstate(all="ignore"):
        hessian = surface.hessian(x[inside], y[inside])
    hessian = hessian[np.isfinite(hessian).all((1, 2))]
    areas = np.full(len(hessian), shapely.area(domain) / max(len(hessian), 1))
    return lower_bound_of(hessian, areas, 1.0)


def _by_differences(surface: Field, domain: shapely.Geometry, triangles: int) -> float:
    """The tolerance at which second differences over the edges of a mesh ask for ``triangles``."""
    xmin, ymin, xmax, ymax = shapely.bounds(domain)
    step = math.sqrt(2.0 * shapely.area(domain) / triangles)
    columns, rows = (max(2, round(length / step)) for length in (xmax - xmin, ymax - ymin))
    x, y = np.meshgrid(np.linspace(xmin, xmax, columns + 1), np.linspace(ymin, ymax, rows + 1))
    z = np.full(x.shape, np.nan)
    inside = shapely.intersects_xy(domain, x, y)
    z[inside] = surface.value(x[inside], y[inside])
    xx = z[1:-1, 2:] - 2.0 * z[1:-1, 1:-1] + z[1:-1, :-2]
    yy = z[2:, 1:-1] - 2.0 * z[1:-1, 1:-1] + z[:-2, 1:-1]
    xy = 0.25 * (z[2:, 2:] - z[2:, :-2] - z[:-2, 2:] + z[:-2, :-2])
    det = 0.25 * (xx * yy - xy * xy)
    asked = np.sqrt(np.abs(det)) / np.where(det > 0.0, AREA_CONVEX, AREA_SADDLE)
    return float(asked[np.isfinite(asked)].sum()) / triangles
