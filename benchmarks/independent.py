"""Errors and covers, measured by nothing that equimesh itself uses: NumPy and dense samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

__all__ = [
    "areas", "bilinear_samples", "boundary_edges", "cover_fault", "distance_to_segments",
    "distance_to_triangles", "function_error", "interpolated", "samples_in",
]  # fmt: skip

Array = np.ndarray
Function = Callable[[Array, Array], Array]

_CHUNK = 2_000_000


def areas(points: Array, triangles: Array) -> Array:
    """(m,) signed areas, seen from above."""
    a, b, c = (points[triangles[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def boundary_edges(triangles: Array) -> Array:
    """(k, 2) edges of one triangle only, as that triangle runs along them."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    _, first, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True
    )
    return edges[np.sort(first[count == 1])]


def cover_fault(points: Array, triangles: Array, box: tuple[float, ...] | None) -> str:
    """What keeps a mesh from being a conforming cover of a rectangle; empty if nothing does.

    Positive triangles whose areas add up to the rectangle's, no more than two at an edge (one in
    each direction), and a boundary that is the rectangle's: then every point is covered once.
    Without a box the mesh must be conforming only.
    """
    area = areas(points, triangles)
    if not (area > 0.0).all():
        return f"{(area <= 0.0).sum()} triangles are not counter-clockwise"
    if len(np.unique(triangles)) != len(points):
        return "some points belong to no triangle"
    if len(np.unique(points[:, :2], axis=0)) != len(points):
        return "some points occur twice"
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    if len(np.unique(edges, axis=0)) != len(edges):
        return "an edge has two triangles on the same side"
    if box is None:
        return ""
    xmin, ymin, xmax, ymax = box
    whole = (xmax - xmin) * (ymax - ymin)
    if abs(area.sum() - whole) > 1e-9 * whole:
        return f"the areas add up to {area.sum() / whole:.12f} of the rectangle"
    a, b = (points[boundary_edges(triangles)[:, k], :2] for k in range(2))
    on = np.zeros(len(a), bool)
    for axis, level in ((0, xmin), (0, xmax), (1, ymin), (1, ymax)):
        on |= (a[:, axis] == level) & (b[:, axis] == level)
    return "" if on.all() else f"{(~on).sum()} boundary edges leave the rectangle's sides"


def function_error(f: Function, points: Array, triangles: Array) -> float:
    """Largest |f - linear interpolant of f| at 20 subdivisions, 80 on the 200 worst triangles."""
    coarse = _at_subdivisions(f, points, triangles, 20)
    worst = np.argsort(coarse)[-200:]
    return float(max(coarse.max(), _at_subdivisions(f, points, triangles[worst], 80).max()))


def _weights(n: int) -> Array:
    """(k, 3) barycentric coordinates of all points at n subdivisions, edges and corners too."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    keep = i + j <= n
    return np.stack([i[keep], j[keep], (n - i - j)[keep]], axis=1) / n


def _at_subdivisions(f: Function, points: Array, triangles: Array, n: int) -> Array:
    weights = _weights(n)
    errors = np.empty(len(triangles))
    values = f(points[:, 0], points[:, 1])
    size = max(1, _CHUNK // len(weights))
    for start in range(0, len(triangles), size):
        part = triangles[start : start + size]
        x, y = (points[part][:, :, k] @ weights.T for k in range(2))
        linear = values[part] @ weights.T
        errors[start : start + size] = np.abs(f(x, y) - linear).max(axis=1)
    return errors


def samples_in(points: Array, triangles: Array, n: int) -> Array:
    """(m k, 3) points on the mesh: n subdivisions of every triangle."""
    return np.einsum("wi,tik->twk", _weights(n), points[triangles]).reshape(-1, 3)


def bilinear_samples(heights: Array, per_cell: int) -> tuple[Array, Array, Array]:
    """x, y, z of the bilinear surface at ``per_cell`` steps in each cell and at all samples."""
    rows, columns = heights.shape
    x = np.arange((columns - 1) * per_cell + 1) / per_cell
    y = np.arange((rows - 1) * per_cell + 1) / per_cell
    j, i = np.minimum(x.astype(int), columns - 2), np.minimum(y.astype(int), rows - 2)
    u, v = x - j, (y - i)[:, None]
    z = np.asarray(heights, float)
    low = (1 - u) * z[i][:, j] + u * z[i][:, j + 1]
    high = (1 - u) * z[i + 1][:, j] + u * z[i + 1][:, j + 1]
    x, y = np.meshgrid(x, y)
    return x.ravel(), y.ravel(), ((1 - v) * low + v * high).ravel()


def interpolated(points: Array, triangles: Array, x: Array, y: Array) -> Array:
    """(n,) heights of a mesh at points of the plane; NaN where no triangle is.

    The points are sorted into the cells of a grid, row by row. In each row a triangle may hold the
    points of a run of cells, which lie one after the other.
    """
    low = np.array([x.min(), y.min()])
    size = max(float(np.ptp(x)), float(np.ptp(y)), 1e-300) / max(1.0, (len(x) / 4) ** 0.5)
    columns = int(np.ptp(x) / size) + 1
    cell = ((y - low[1]) / size).astype(int) * columns + ((x - low[0]) / size).astype(int)
    order = np.argsort(cell, kind="stable")
    start = np.searchsorted(cell[order], np.arange(cell.max() + 2))
    z = np.full(len(x), np.nan)
    for triangle, at in _pairs(points, triangles, low, size, columns, start, order):
        a, b, c = (points[triangles[triangle, k]] for k in range(3))
        p = np.stack([x[at], y[at]], axis=1)
        whole = _cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = _cross(b[:, :2] - p, c[:, :2] - p) / whole
            v = _cross(c[:, :2] - p, a[:, :2] - p) / whole
        w = 1 - u - v
        inside = np.minimum(np.minimum(u, v), w) >= -1e-12
        z[at[inside]] = (u * a[:, 2] + v * b[:, 2] + w * c[:, 2])[inside]
    return z


def _pairs(
    points: Array,
    triangles: Array,
    low: Array,
    size: float,
    columns: int,
    start: Array,
    order: Array,
) -> Iterator[tuple[Array, Array]]:
    """Triangles with points that their boxes may hold, in portions."""
    rows = (len(start) - 2) // columns + 1
    corners = points[triangles][:, :, :2]
    first = np.floor((corners.min(axis=1) - low) / size).astype(int)
    last = np.floor((corners.max(axis=1) - low) / size).astype(int)
    touched = (last >= 0).all(axis=1) & (first[:, 0] < columns) & (first[:, 1] < rows)
    which = np.flatnonzero(touched)
    first = np.maximum(first[which], 0)
    last = np.minimum(last[which], [columns - 1, rows - 1])
    height = last[:, 1] - first[:, 1] + 1
    strip, row = _runs(height)
    row = row + first[strip, 1]
    begin = start[np.minimum(row * columns + first[strip, 0], len(start) - 1)]
    end = start[np.minimum(row * columns + last[strip, 0] + 1, len(start) - 1)]
    total = np.concatenate([[0], np.cumsum(end - begin)])
    cut = 0
    while cut < len(strip):
        stop = max(cut + 1, int(np.searchsorted(total, total[cut] + _CHUNK)))
        run, step = _runs((end - begin)[cut:stop])
        yield which[strip[cut:stop][run]], order[begin[cut:stop][run] + step]
        cut = stop


def _runs(lengths: Array) -> tuple[Array, Array]:
    """For runs of these lengths: each member's run, and its place in it."""
    run = np.repeat(np.arange(len(lengths)), lengths)
    return run, np.arange(len(run)) - np.repeat(np.cumsum(lengths) - lengths, lengths)


def _cross(u: Array, v: Array) -> Array:
    return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]


def distance_to_segments(at: Array, a: Array, b: Array) -> Array:
    """(n,) distances in space from points to the nearest of the segments a-b."""
    nearest = np.full(len(at), np.inf)
    step = b - a
    square = np.maximum((step**2).sum(axis=1), 1e-300)
    for part in _portions(len(at), len(a)):
        p = at[part, None]
        t = np.clip(((p - a) * step).sum(axis=2) / square, 0.0, 1.0)
        gap = p - a - t[..., None] * step
        nearest[part] = np.sqrt((gap**2).sum(axis=2).min(axis=1))
    return nearest


def distance_to_triangles(at: Array, points: Array, triangles: Array) -> Array:
    """(n,) distances in space from points to the nearest triangle."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    normal = np.cross(u, v)
    square = (normal**2).sum(axis=1)
    nearest = np.full(len(at), np.inf)
    edges = np.unique(
        np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1), axis=0
    )
    for part in _portions(len(at), len(triangles)):
        w = at[part, None] - a
        s = (np.cross(w, v) * normal).sum(axis=2) / square
        t = (np.cross(u, w) * normal).sum(axis=2) / square
        above = np.minimum(np.minimum(s, t), 1.0 - s - t) >= 0.0
        height = np.abs((w * normal).sum(axis=2)) / np.sqrt(square)
        nearest[part] = np.where(above, height, np.inf).min(axis=1)
    return np.minimum(nearest, distance_to_segments(at, points[edges[:, 0]], points[edges[:, 1]]))


def _portions(n: int, m: int) -> Iterator[slice]:
    size = max(1, _CHUNK // max(m, 1))
    return (slice(start, start + size) for start in range(0, n, size))
