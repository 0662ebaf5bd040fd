"""The smallest tolerance that a number of triangles reaches."""

from __future__ import annotations

from typing import Any

from equimesh.domain import DomainLike, domain_geometry
from equimesh.errors import InputError
from equimesh.fields import Source, as_field
from equimesh.result import Result

__all__ = ["remesh_to_target"]

_RUNS = 9
_CLOSE = 0.985


def remesh_to_target(source: Source, target: int, domain: DomainLike, **options: Any) -> Result:
    """Search the tolerance whose mesh has at most ``target`` triangles and nearly as many.

    The number of triangles goes like 1 / tol; the search brackets it in logarithms.
    """
    from equimesh.remesh import remesh

    geometry = None if domain is None else domain_geometry(domain)
    surface = as_field(source, geometry)
    whole = geometry if geometry is not None else surface.outline(0.0)
    low, high = surface.span(whole)
    if not high > low:
        return remesh(surface, max(abs(high), 1.0) * 1e-9, domain, **options)
    tol = 0.3 * (high - low) / max(target, 2)
    best: Result | None = None
    fine, coarse = 0.0, float("inf")
    for _ in range(_RUNS):
        result = remesh(surface, tol, domain, **options)
        count = len(result.triangles)
        if count <= target:
            coarse = min(coarse, tol)
            if best is None or result.tol < best.tol:
                best = result
            if count >= _CLOSE * target:
                break
        else:
            fine = max(fine, tol)
        step = tol * count / (target * (1.0 + _CLOSE) / 2.0)
        if fine < step < coarse:
            tol = step
        elif coarse == float("inf"):
            tol = max(step, 1.5 * tol)
        elif fine == 0.0:
            tol = min(step, tol / 1.5)
        else:
            tol = (fine * coarse) ** 0.5
    if best is None:
        raise InputError(
            f"No mesh with {target} triangles was found: the domain's outline needs more; raise it."
        )
    return best
