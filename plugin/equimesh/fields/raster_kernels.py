"""The bilinear surface of a raster, for compiled loops.

Coordinates are (column, row) of the nodes; ``F.grid[row, column]`` holds heights, NaN where no
valid cell ends. In the cell (i, j), with u = x - i and v = y - j, the surface is

    f = h00 + u (h10 - h00) + v (h01 - h00) + u v w,      w = h00 - h10 - h01 + h11,

so f minus a linear function has no extremum inside a cell (its Hessian is indefinite): the largest
error over a triangle is attained at a sample or on an edge of the triangle, and along an edge it is
a quadratic with second derivative 2 w dx dy in every cell that the edge crosses.
``F.frame[0]`` is the rounding of coordinates, in cells: the field is closed within it.
``F.frame[1]`` is 1 where errors count at the samples only: then edges have none, and the samples on
them are found with those inside.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField

__all__ = [
    "edge_error",
    "gradient",
    "inner_error",
    "value",
]

Array = NDArray[np.float64]


@compiled
def _twist(grid: Array, i: int, j: int) -> float:
    """The coefficient of u v in a cell: NaN where the cell is not valid."""
    return grid[j, i] - grid[j, i + 1] - grid[j + 1, i] + grid[j + 1, i + 1]  # type: ignore[no-any-return]


@compiled
def _valid_cell(grid: Array, i: int, j: int) -> bool:
    rows, columns = grid.shape
    if i < 0 or j < 0 or i > columns - 2 or j > rows - 2:
        return False
    return not math.isnan(_twist(grid, i, j))


@compiled
def _cell_along(
    grid: Array, slack: float, i: int, j: int, x0: float, y0: float, x1: float, y1: float
) -> tuple[int, int]:
    """A valid cell whose closure, within ``slack``, holds the segment (x0, y0)-(x1, y1).

    The segment lies in the closure of cell (i, j); neighbours are tried where it runs along a side.
    (-1, -1) if there is none.
    """
    if _valid_cell(grid, i, j):
        return i, j
    across_i = 0
    if max(x0, x1) <= i + slack:
        across_i = -1
    elif min(x0, x1) >= i + 1 - slack:
        across_i = 1
    across_j = 0
    if max(y0, y1) <= j + slack:
        across_j = -1
    elif min(y0, y1) >= j + 1 - slack:
        across_j = 1
    if across_i != 0 and _valid_cell(grid, i + across_i, j):
        return i + across_i, j
    if across_j != 0 and _valid_cell(grid, i, j + across_j):
        return i, j + across_j
    if across_i != 0 and across_j != 0 and _valid_cell(grid, i + across_i, j + across_j):
        return i + across_i, j + across_j
    return -1, -1


@compiled
def _cell_of(grid: Array, slack: float, x: float, y: float) -> tuple[int, int]:
    """The valid cell of a point; (-1, -1) outside the field."""
    rows, columns = grid.shape
    inside = -slack <= x <= columns - 1 + slack and -slack <= y <= rows - 1 + slack
    if not inside:
        return -1, -1
    i = min(max(math.floor(x), 0), columns - 2)
    j = min(max(math.floor(y), 0), rows - 2)
    return _cell_along(grid, slack, i, j, x, y, x, y)  # type: ignore[no-any-return]


@inlined
def value(F: KernelField, x: float, y: float) -> float:
    """Height of the bilinear surface; NaN outside the valid cells."""
    return _height(F.grid, F.frame[0], x, y)  # type: ignore[no-any-return]


@compiled
def _height(grid: Array, slack: float, x: float, y: float) -> float:
    i, j = _cell_of(grid, slack, x, y)
    if i < 0:
        return math.nan
    u, v = x - i, y - j
    low = grid[j, i] + u * (grid[j, i + 1] - grid[j, i])
    high = grid[j + 1, i] + u * (grid[j + 1, i + 1] - grid[j + 1, i])
    return low + v * (high - low)  # type: ignore[no-any-return]


@inlined
def gradient(F: KernelField, x: float, y: float) -> tuple[float, float]:
    """Gradient of the bilinear surface in the point's cell (jumps at grid lines); NaN outside."""
    return _slopes(F.grid, F.frame[0], x, y)  # type: ignore[no-any-return]


@compiled
def _slopes(grid: Array, slack: float, x: float, y: float) -> tuple[float, float]:
    i, j = _cell_of(grid, slack, x, y)
    if i < 0:
        return math.nan, math.nan
    w = _twist(grid, i, j)
    gx = grid[j, i + 1] - grid[j, i] + (y - j) * w
    gy = grid[j + 1, i] - grid[j, i] + (x - i) * w
    return gx, gy


@compiled
def _clip(p: float, d: float, low: float, high: float, t0: float, t1: float) -> tuple[float, float]:
    """The part of [t0, t1] in which low <= p + t d <= high; empty (t0 > t1) if there is none."""
    if d == 0.0:
        return (t0, t1) if low <= p <= high else (1.0, 0.0)
    ta, tb = (low - p) / d, (high - p) / d
    if d < 0.0:
        ta, tb = tb, ta
    return max(t0, ta), min(t1, tb)


@inlined
def edge_error(
    F: KernelField,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    stop: float,
) -> tuple[float, float]:
    """Signed surface minus chord of largest magnitude on a-b, and where in [0, 1].

    Exact up to rounding. Parts over invalid cells are ignored. Returns early with any point whose
    |error| exceeds ``stop``.
    """
    return _edge_error(F.grid, F.frame[0], F.frame[1], ax, ay, az, bx, by, bz, stop)  # type: ignore[no-any-return]


@compiled
def _edge_error(
    grid: Array,
    slack: float,
    at_samples: float,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    stop: float,
) -> tuple[float, float]:
    """Walks the cells that the segment crosses."""
    if at_samples != 0.0:
        return 0.0, 0.5
    rows, columns = grid.shape
    dx, dy, dz = bx - ax, by - ay, bz - az
    t, end = 0.0, 1.0
    if (
        min(ax, bx) < -slack
        or max(ax, bx) > columns - 1 + slack
        or min(ay, by) < -slack
        or max(ay, by) > rows - 1 + slack
    ):
        t, end = _clip(ax, dx, -slack, columns - 1 + slack, t, end)
        t, end = _clip(ay, dy, -slack, rows - 1 + slack, t, end)
        if t > end:
            return 0.0, 0.5
    x, y = ax + t * dx, ay + t * dy
    # a start on a grid line belongs to the cell ahead
    i = math.floor(x) if dx >= 0.0 else math.ceil(x) - 1
    j = math.floor(y) if dy >= 0.0 else math.ceil(y) - 1
    i = min(max(i, 0), columns - 2)
    j = min(max(j, 0), rows - 2)
    step_i = 1 if dx > 0.0 else -1
    step_j = 1 if dy > 0.0 else -1
    line_i = i + (1 if dx > 0.0 else 0)
    line_j = j + (1 if dy > 0.0 else 0)
    per_dx = 1.0 / dx if dx != 0.0 else math.inf
    per_dy = 1.0 / dy if dy != 0.0 else math.inf
    tx = (line_i - ax) * per_dx if dx != 0.0 else math.inf
    ty = (line_j - ay) * per_dy if dy != 0.0 else math.inf
    best, worst, where = 0.0, 0.0, 0.5
    known = False  # whether e0 is the error at t, from the cell before
    e0 = 0.0
    while True:
        t1 = max(min(tx, ty, end), t)
        x1, y1 = ax + t1 * dx, ay + t1 * dy
        ci, cj = i, j
        h00 = grid[cj, ci]
        w = h00 - grid[cj, ci + 1] - grid[cj + 1, ci] + grid[cj + 1, ci + 1]
        if math.isnan(w):
            known = False
            ci, cj = _cell_along(grid, slack, i, j, x, y, x1, y1)
            if ci >= 0:
                h00 = grid[cj, ci]
                w = _twist(grid, ci, cj)
            else:  # an end of the edge may still touch a valid cell
                if t == 0.0:
                    e0 = _height(grid, slack, ax, ay) - az
                    if abs(e0) > worst:
                        best, worst, where = e0, abs(e0), 0.0
                if t1 == 1.0:
                    e1 = _height(grid, slack, bx, by) - bz
                    if abs(e1) > worst:
                        best, worst, where = e1, abs(e1), 1.0
        if ci >= 0:
            sx, sy = grid[cj, ci + 1] - h00, grid[cj + 1, ci] - h00
            if not known:
                u, v = x - ci, y - cj
                e0 = h00 + u * sx + v * (sy + u * w) - (az + t * dz)
                if abs(e0) > worst:
                    best, worst, where = e0, abs(e0), t
            u, v = x1 - ci, y1 - cj
            e1 = h00 + u * sx + v * (sy + u * w) - (az + t1 * dz)
            if abs(e1) > worst:
                best, worst, where = e1, abs(e1), t1
            # e(s) = e0 + (e1 - e0) s - k s (1 - s) on the piece
            k = w * dx * dy * (t1 - t) * (t1 - t)
            rise = e1 - e0
            if abs(rise) < abs(k):
                peak = 0.5 * (e0 + e1) - 0.25 * k - 0.25 * rise * rise / k
                if abs(peak) > worst:
                    best, worst = peak, abs(peak)
                    where = t + 0.5 * (1.0 - rise / k) * (t1 - t)
            if worst > stop:
                return best, where
            known = ci == i and cj == j
            e0 = e1
        if t1 >= end:
            return best, where
        t, x, y = t1, x1, y1
        if tx <= ty:
            i += step_i
            line_i += step_i
            tx = (line_i - ax) * per_dx
            if i < 0 or i > columns - 2:
                return best, where
        else:
            j += step_j
            line_j += step_j
            ty = (line_j - ay) * per_dy
            if j < 0 or j > rows - 2:
                return best, where


@compiled
def _inverse(length: float) -> float:
    """1 / length, or 0 where there is no length to divide."""
    return 1.0 / length if length > 1e-290 else 0.0


@inlined
def inner_error(
    F: KernelField,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    cx: float,
    cy: float,
    cz: float,
    stop: float,
) -> tuple[float, float, float]:
    """Signed surface minus triangle of largest magnitude at the samples inside, and its place.

    Samples on the edges, within rounding, count as inside. (0.0, centroid) if there is none.
    """
    return _inner_error(  # type: ignore[no-any-return]
        F.grid, F.frame[0], ax, ay, az, bx, by, bz, cx, cy, cz, stop
    )


@compiled
def _inner_error(
    grid: Array,
    slack: float,
    ax: float,
    ay: float,
    az: float,
    bx: float,
    by: float,
    bz: float,
    cx: float,
    cy: float,
    cz: float,
    stop: float,
) -> tuple[float, float, float]:
    """Every row is cut by two edges, and heights are interpolated between the two cuts, which stays
    accurate for slivers. Both triangles of an edge cut it alike: no sample falls between them."""
    rows, columns = grid.shape
    px, py = (ax + bx + cx) / 3.0, (ay + by + cy) / 3.0
    best, worst = 0.0, 0.0
    # from now on a, b, c by rising y
    if by < ay:
        ax, ay, az, bx, by, bz = bx, by, bz, ax, ay, az
    if cy < by:
        bx, by, bz, cx, cy, cz = cx, cy, cz, bx, by, bz
        if by < ay:
            ax, ay, az, bx, by, bz = bx, by, bz, ax, ay, az
    per_ac, per_ab, per_bc = _inverse(cy - ay), _inverse(by - ay), _inverse(cy - by)
    thin = 64.0 * slack
    for j in range(max(math.ceil(ay), 0), min(math.floor(cy), rows - 1) + 1):
        p = min((j - ay) * per_ac, 1.0)
        x0, z0 = ax + p * (cx - ax), az + p * (cz - az)
        if j < by:
            q = min((j - ay) * per_ab, 1.0)
            x1, z1 = ax + q * (bx - ax), az + q * (bz - az)
        else:
            q = min((j - by) * per_bc, 1.0)
            x1, z1 = bx + q * (cx - bx), bz + q * (cz - bz)
        if x1 < x0:
            x0, z0, x1, z1 = x1, z1, x0, z0
        first = max(math.ceil(x0 - slack), 0)
        last = min(math.floor(x1 + slack), columns - 1)
        if first > last:
            continue
        width = x1 - x0
        slope = (z1 - z0) / width if width > thin else 0.0
        for i in range(first, last + 1):
            e = grid[j, i] - (z0 + (i - x0) * slope)
            if abs(e) > worst:
                worst, best, px, py = abs(e), e, float(i), float(j)
                if worst > stop:
                    return best, px, py
    return best, px, py
