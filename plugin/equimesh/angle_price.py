"""What a floor for the angles costs: the fewest triangles with it, as the tolerance goes to 0.

Where the surface is quadratic the largest triangle within the tolerance whose angles keep the floor
depends on the ratio of the two eigenvalues of the Hessian alone. Areas are in units of
``8 tol / |l1|``, l1 the eigenvalue that is larger in size: without a floor they are
``3 sqrt(3) / 16`` where the surface is convex and ``sqrt(5) / 4`` where it is a saddle, times
``sqrt|l1 / l2|`` (``metric.py``); with one they are found by trying all shapes and directions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import allocating
from equimesh.fields.kernel import KernelField
from equimesh.fields.patch_kernels import derivatives2

__all__ = ["largest_areas", "price_of_floor"]

_CONVEX, _SADDLE = 3.0 * math.sqrt(3.0) / 16.0, math.sqrt(5.0) / 4.0
_ANGLES, _TURNS = 40, 90  # steps of two angles and of the direction: areas to about one per cent
# Logarithms of the ratio |l2 / l1| from 1 downwards; beyond the last one areas hardly change.
_STEP, _RATIOS = 0.35, 32


@allocating
def _largest_area(ratio: float, floor: float, angles: int, turns: int) -> float:
    """Area of the largest triangle of error 1 for the Hessian diag(1, ratio) in units of 8 tol."""
    largest = 0.0
    spare = math.pi - 3.0 * floor
    root = math.sqrt(max(ratio, 0.0))
    for i in range(angles + 1):
        for j in range(min(i, angles - i) + 1):
            a, b = floor + spare * i / angles, floor + spare * j / angles
            c = math.pi - a - b
            if c > a + 1e-9:  # the largest of the three comes first
                continue
            side = math.sin(b) / math.sin(c)
            cx, cy = side * math.cos(a), side * math.sin(a)
            area = 0.5 * cy
            # Directions all around, and those with an edge along an axis.
            for k in range(turns + 6):
                turn = math.pi * k / turns
                if k >= turns:
                    edge = (0.0, a, math.pi - b)[k % 3]
                    turn = (0.5 * math.pi if k < turns + 3 else 0.0) - edge
                co, si = math.cos(turn), math.sin(turn)
                vx, vy = co * cx - si * cy, si * cx + co * cy
                p = co * co + ratio * si * si
                q = vx * vx + ratio * vy * vy
                r = (vx - co) ** 2 + ratio * (vy - si) ** 2
                error = max(abs(p), abs(q), abs(r))
                if ratio > 0.0 and p + q > r and q + r > p and r + p > q:
                    error = p * q * r / (4.0 * (root * area) ** 2)  # 4 R^2, R = circumradius
                largest = max(largest, area / error)
    return largest


def largest_areas(floor: float) -> NDArray[np.float64]:
    """(2, k) largest areas for a floor in radians, saddle and convex, by falling ratio."""
    ratios = np.exp(-_STEP * np.arange(_RATIOS))
    found = np.empty((2, _RATIOS))
    for row, (sign, free) in enumerate(((-1.0, _SADDLE), (1.0, _CONVEX))):
        found[row] = [_largest_area(sign * r, floor, _ANGLES, _TURNS) for r in ratios]
        found[row] /= free / np.sqrt(ratios)
    # The finite number of shapes loses a little of what needs no floor at all.
    return np.minimum(found / found[:, :1], 1.0)


@allocating
def _both(
    frame: NDArray[np.float64],
    child: NDArray[np.int32],
    coef: NDArray[np.float64],
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    depth: int,
    shares: NDArray[np.float64],
    step: float,
) -> tuple[float, float]:
    """Integrals of the density of optimal triangles without and with the floor, alike scaled."""
    free = kept = 0.0
    n = 2**depth
    last = shares.shape[1] - 1
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        area = 0.5 * (ux * vy - uy * vx) / (n * n)
        for i in range(n):
            for j in range(n - i):
                for half in range(2):
                    if half == 1 and i + j >= n - 1:
                        continue
                    u = (i + (1.0 + half) / 3.0) / n
                    v = (j + (1.0 + half) / 3.0) / n
                    _, _, _, hxx, hxy, hyy = derivatives2(
                        frame, child, coef,
                        points[a, 0] + u * ux + v * vx, points[a, 1] + u * uy + v * vy,
                    )  # fmt: skip
                    mean, radius = 0.5 * (hxx + hyy), math.hypot(0.5 * (hxx - hyy), hxy)
                    l1, l2 = abs(mean) + radius, abs(mean) - radius
                    if not l1 > 0.0:
                        continue
                    row = 1 if l2 > 0.0 else 0
                    # Below the last ratio the area is that at the last one, not smaller.
                    ratio = max(abs(l2) / l1, math.exp(-step * last))
                    place = min(-math.log(ratio) / step, last - 1e-9)
                    k = int(place)
                    share = shares[row, k] + (place - k) * (shares[row, k + 1] - shares[row, k])
                    constant = _CONVEX if row == 1 else _SADDLE
                    free += area * math.sqrt(abs(l2) * l1) / constant
                    kept += area * l1 * math.sqrt(ratio) / (constant * share)
    return free, kept


def price_of_floor(
    field: KernelField, points: NDArray[np.float64], triangles: NDArray[np.int64], degrees: float
) -> float:
    """The fewest triangles with a floor over the fewest without, as the tolerance goes to 0.

    ``points`` (n, 2) or (n, 3) in the field's local coordinates, whose axes must be the user's up
    to a similarity; ``triangles`` (m, 3) cover the domain. 1 where the floor costs nothing; nan
    where the surface is flat.
    """
    depth = max(0, math.ceil(0.5 * math.log2(1e5 / max(len(triangles), 1))))
    shares = largest_areas(math.radians(degrees))
    plane = np.ascontiguousarray(points[:, :2])
    free, kept = _both(field.frame, field.child, field.coef, plane, triangles, depth, shares, _STEP)
    return float(kept / free) if free > 0.0 else math.nan
