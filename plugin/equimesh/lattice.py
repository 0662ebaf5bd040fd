"""The optimal triangles and the lattices that they tile, in y-space.

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 2 and
Appendix B. In y-space the Hessian's form is ``dy1^2 + eps dy2^2``. Shapes are the paper's own, with
a base of length one (:func:`optimal_triangle`); lattices are scaled to unit tolerance in the scale
of section 3, where a chord d of a function with Hessian diag(1, eps) has the error
``|d1^2 + eps d2^2| / 8``: multiply them by ``sqrt(tol)``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError

__all__ = [
    "VARIANTS",
    "boost",
    "equilateral_vectors",
    "lattice_vectors",
    "optimal_triangle",
    "tile",
]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

VARIANTS = (1, 2, 3, 4, 5, 6)

_HALF_ROOT_5 = 0.5 * math.sqrt(5.0)

# Table 5: the third vertex is `along (cos, sin) + across (sin, cos)`, the two solutions of (24) and
# (26). In print V1 reads (+sqrt5/2 sin + 1/2 cos, -sqrt5/2 cos/2 + 1/2 sin): its first sign and its
# second division by two are slips, for the errors of the edges would differ.
_TABLE_5 = {
    1: (0.5, -_HALF_ROOT_5),
    2: (0.5, +_HALF_ROOT_5),
    3: (1.5, -_HALF_ROOT_5),
    4: (1.5, +_HALF_ROOT_5),
    5: (-0.5, -_HALF_ROOT_5),
    6: (-0.5, +_HALF_ROOT_5),
}


def optimal_triangle(signature: int, variant: int = 2, theta: float = 0.0) -> Array:
    """(3, 2) an optimal triangle with its base from (0, 0) to (cos theta, sin theta).

    For ``signature`` +1 the equilateral triangle (``variant`` does not matter). For -1 the shapes
    V1 to V6 of Table 5: the edges have equal errors ``|cos(2 theta)| / 4`` in section 2's scale,
    and the area is sqrt(5) times the error.

    Raises
    ------
    InputError
        For an unknown variant, or a base along a null direction (theta an odd multiple of 45
        degrees), where a saddle has no error and no triangle is best.
    """
    c, s = math.cos(theta), math.sin(theta)
    base = np.array([c, s])
    if _sign(signature) > 0:
        apex = 0.5 * base + 0.5 * math.sqrt(3.0) * np.array([-s, c])
    else:
        if variant not in _TABLE_5:
            raise InputError(f"There is no optimal shape V{variant}: choose V1 to V6.")
        if abs(math.cos(2.0 * theta)) < 1e-12:
            raise InputError(
                "The base lies along a null direction of the saddle: turn theta off 45 degrees."
            )
        along, across = _TABLE_5[variant]
        apex = along * base + across * np.array([s, c])
    return np.stack([np.zeros(2), base, apex])


def boost(rapidity: float) -> Array:
    """(2, 2) Lorentz boost: keeps ``dy1^2 - dy2^2``, and so the errors of every saddle."""
    c, s = math.cosh(rapidity), math.sinh(rapidity)
    return np.array([[c, s], [s, c]])


def lattice_vectors(signature: int, variant: int = 2, theta: float = 0.0) -> Array:
    """(2, 2) rows: two edges of an optimal triangle whose largest error is 1 (section 3's scale).

    The saddle's V2 has its base ``2 sqrt(2)`` along y1 and its apex at (1/2, sqrt(5)/2) of that;
    the convex triangle is equilateral with circumradius ``sqrt(2)``.
    """
    triangle = optimal_triangle(signature, variant, theta)
    square = 6.0 if signature > 0 else 8.0 / abs(math.cos(2.0 * theta))
    return np.asarray(math.sqrt(square) * triangle[1:])


def equilateral_vectors(signature: int) -> Array:
    """(2, 2) rows: an equilateral triangle with one side along y1 and largest error 1.

    On a saddle it covers sqrt(3) per error instead of sqrt(5): the paper's second strategy.
    """
    if _sign(signature) > 0:
        return lattice_vectors(1)
    return math.sqrt(8.0) * optimal_triangle(1)[1:]


def tile(
    vectors: ArrayLike,
    bounds: tuple[float, float, float, float],
    offset: tuple[float, float] = (0.0, 0.0),
) -> tuple[Array, IntArray]:
    """Points (n, 2) and triangles (m, 3) of a lattice, counter-clockwise, covering a box.

    Parameters
    ----------
    vectors
        (2, 2) rows a and b: the triangles are (0, a, b) and its mirror image (a, a + b, b).
    bounds
        (xmin, ymin, xmax, ymax) of y-space; every triangle that meets the box is there.
    offset
        Position of one lattice point, in units of a and b: (0, 0) puts it at y = 0.

    Raises
    ------
    InputError
        Where the vectors are parallel or the box is not finite.
    """
    v = np.asarray(vectors, dtype=np.float64)
    xmin, ymin, xmax, ymax = bounds
    twist = float(v[0, 0] * v[1, 1] - v[0, 1] * v[1, 0])
    if not np.isfinite(bounds).all() or not abs(twist) > 1e-14 * float(np.abs(v).max()) ** 2:
        raise InputError("The lattice cannot cover the box: give a finite box and skew vectors.")
    corners = np.array([[xmin, ymin], [xmax, ymin], [xmax, ymax], [xmin, ymax]])
    # In units of a and b the box is a parallelogram. Its cells are listed row by row, so that long
    # thin vectors do not ask for a huge block of which little meets the box.
    first, last, lowest = _cells(corners @ np.linalg.inv(v) - np.asarray(offset))
    count = last - first + 1
    j = np.repeat(np.arange(count.size), count)
    i = np.arange(j.size) - np.repeat(np.cumsum(count) - count - first, count)
    column, height = i - first.min(), int(first.size) + 1
    corner = np.stack(
        [(column + di) * height + j + dj for di, dj in ((0, 0), (1, 0), (0, 1), (1, 1))], axis=1
    )
    used, number = np.unique(corner, return_inverse=True)
    number = number.reshape(corner.shape)
    steps = np.stack([used // height + first.min(), used % height + lowest], axis=1)
    points = (steps + np.asarray(offset, dtype=np.float64)) @ v
    triangles = np.concatenate([number[:, [0, 1, 2]], number[:, [1, 3, 2]]])
    if twist < 0.0:
        triangles = triangles[:, [0, 2, 1]]
    return points, triangles.astype(np.int64)


def _cells(corners: Array) -> tuple[IntArray, IntArray, int]:
    """First and last unit cell in each row that a convex quadrangle meets; the lowest row."""
    lowest = math.floor(corners[:, 1].min())
    row = np.arange(lowest, math.floor(corners[:, 1].max()) + 1, dtype=np.float64)
    low, high = np.full(row.size, np.inf), np.full(row.size, -np.inf)
    for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        bottom, top = (p, q) if p[1] <= q[1] else (q, p)
        rise = top[1] - bottom[1]
        # The part of this side between the lines `row` and `row + 1`.
        meets = (bottom[1] <= row + 1.0) & (top[1] >= row)
        for level in (row, row + 1.0):
            t = np.clip((level - bottom[1]) / rise, 0.0, 1.0) if rise > 0.0 else 0.0 * row
            x = bottom[0] + t * (top[0] - bottom[0])
            low = np.where(meets, np.minimum(low, x), low)
            high = np.where(meets, np.maximum(high, x), high)
        if rise == 0.0:
            low = np.where(meets, np.minimum(low, top[0]), low)
            high = np.where(meets, np.maximum(high, top[0]), high)
    return np.floor(low).astype(np.int64), np.floor(high).astype(np.int64), lowest


def _sign(signature: int) -> int:
    if signature not in (1, -1):
        raise InputError(f"A signature is +1 or -1, not {signature!r}.")
    return signature
