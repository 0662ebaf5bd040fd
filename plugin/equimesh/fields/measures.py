"""What is asked of a field at many places: heights, errors of triangles, extremes on a domain."""

from __future__ import annotations

import math

import numpy as np
import shapely

from equimesh.fields.base import Array, IntArray
from equimesh.fields.compiled import compiled
from equimesh.fields.dispatch import edge_error, inner_error, value
from equimesh.fields.kernel import KernelField
from equimesh.fields.workers import in_ranges

__all__ = ["border_heights", "chord_spans", "heights", "triangle_errors"]


def heights(F: KernelField, points: Array) -> Array:
    """(n,) heights at (n, 2) points, local coordinates; NaN outside the field."""
    out = np.full(len(points), np.nan)
    _heights(F, np.ascontiguousarray(points), out)
    return out


def triangle_errors(F: KernelField, points: Array, triangles: IntArray) -> Array:
    """(m,) largest |field - triangle| anywhere on each triangle.

    ``points`` (n, 3) with local coordinates and heights, ``triangles`` (m, 3) wound either way.
    """
    out = np.zeros(len(triangles))
    points = np.ascontiguousarray(points)
    triangles = np.ascontiguousarray(triangles, np.int64)
    in_ranges(
        lambda start, end: _triangle_errors(F, points, triangles, start, end, out), len(triangles)
    )
    return out


def chord_spans(F: KernelField, a: Array, b: Array, low: float, high: float) -> Array:
    """(n, 2) least and largest of field - chord, or 0, on edges from ``a`` to ``b``.

    ``a`` and ``b`` (n, 3), local, with heights; ``low`` and ``high`` bound these and the field's.
    """
    out = np.zeros((len(a), 2))
    _chord_spans(F, np.ascontiguousarray(a), np.ascontiguousarray(b), _reach(low, high), out)
    return out


def border_heights(F: KernelField, domain: shapely.Geometry, low: float, high: float) -> Array:
    """Extremes along every ring of a domain, in local coordinates; empty where it meets no field.

    ``low`` and ``high`` bound all heights of the field.
    """
    rings = shapely.get_rings(shapely.get_parts(domain))
    spans = [_chain_span(F, shapely.get_coordinates(ring), low, high) for ring in rings]
    found = np.ravel(spans)
    return np.asarray(found[np.isfinite(found)], np.float64)


@compiled
def _reach(low: float, high: float) -> float:
    """A height that is larger than nothing, in the units of the field's own heights."""
    if high > low:
        return 2.0 * (high - low)
    return abs(high) if high != 0.0 else 1.0


@compiled
def _heights(F: KernelField, points: Array, out: Array) -> None:
    for k in range(len(points)):
        out[k] = value(F, points[k, 0], points[k, 1])


@compiled
def _chord_spans(F: KernelField, a: Array, b: Array, reach: float, out: Array) -> None:
    """Against a chord so far below or above, the largest error is an extreme."""
    for k in range(len(a)):
        for side in range(2):
            lift = reach if side == 0 else -reach
            p, q = a[k, 2] + lift, b[k, 2] + lift
            e, _ = edge_error(F, a[k, 0], a[k, 1], p, b[k, 0], b[k, 1], q, math.inf)
            if e != 0.0:
                out[k, side] = e + lift
        out[k, 0] = min(out[k, 0], 0.0)
        out[k, 1] = max(out[k, 1], 0.0)


@compiled
def _triangle_errors(
    F: KernelField, points: Array, triangles: IntArray, start: int, end: int, out: Array
) -> None:
    for t in range(start, end):
        worst = 0.0
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            # both triangles of an edge walk it the same way and see the same rounding
            p, q = points[min(a, b)], points[max(a, b)]
            e, _ = edge_error(F, p[0], p[1], p[2], q[0], q[1], q[2], math.inf)
            worst = max(worst, abs(e))
        p, q, r = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        if (q[0] - p[0]) * (r[1] - p[1]) < (q[1] - p[1]) * (r[0] - p[0]):
            q, r = r, q
        e, _, _ = inner_error(F, p[0], p[1], p[2], q[0], q[1], q[2], r[0], r[1], r[2], math.inf)
        out[t] = max(worst, abs(e))


@compiled
def _chain_span(F: KernelField, chain: Array, low: float, high: float) -> tuple[float, float]:
    """Against a level chord below or above all heights, the largest error is an extreme."""
    reach = _reach(low, high)
    bottom, top = math.nan, math.nan
    for k in range(len(chain) - 1):
        ax, ay, bx, by = chain[k, 0], chain[k, 1], chain[k + 1, 0], chain[k + 1, 1]
        e, _ = edge_error(F, ax, ay, low - reach, bx, by, low - reach, math.inf)
        if e == 0.0:  # nothing of the field on this segment
            continue
        if not top >= low - reach + e:
            top = low - reach + e
        e, _ = edge_error(F, ax, ay, high + reach, bx, by, high + reach, math.inf)
        if not bottom <= high + reach + e:
            bottom = high + reach + e
    return bottom, top
