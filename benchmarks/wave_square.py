"""What goes on round trips: a wave over the unit square that carries what can be told on any mesh.

A value linear in x and y at the vertices and a label of the two halves of the square on the
triangles have one right answer on every other mesh too.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import independent
import numpy as np

import equimesh

__all__ = [
    "BOX", "TOL", "N", "Trip", "digest", "halves", "linear", "mesh_fault", "result", "same",
    "surface",
]  # fmt: skip

N, TOL, BOX = 40, 0.01, (0.0, 0.0, 1.0, 1.0)

Array = np.ndarray


@dataclass(frozen=True)
class Trip:
    """What was compared, what was not equal (nothing: ""), and whether the input was changed.

    ``changed`` is None where the tool works in place.
    """

    tool: str
    compared: str
    fault: str
    changed: bool | None


def digest(*arrays: Array) -> str:
    """The same for the same bytes in arrays of the same shapes and types."""
    state = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        state.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return state.hexdigest()


def surface() -> tuple[Array, Array]:
    """A wave over the unit square: (n, 3) points and (m, 3) triangles."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0.0, 1.0, N + 1)]))
    i = (np.arange(N)[:, None] * (N + 1) + np.arange(N)).ravel()
    halves = [[i, i + 1, i + N + 2], [i, i + N + 2, i + N + 1]]
    z = 0.3 * np.sin(5.0 * x) * np.cos(4.0 * y)
    return np.column_stack([x, y, z]), np.concatenate([np.stack(half, 1) for half in halves])


def linear(points: Array) -> Array:
    return 2.0 * points[:, 0] - points[:, 1] + 0.5


def halves(points: Array, triangles: Array) -> Array:
    """1 and 2 for triangles on the left and on the right of x = 1/2."""
    return 1 + (points[triangles, 0].mean(axis=1) > 0.5)


def result() -> equimesh.Result:
    """A mesh with four named sides."""
    return equimesh.remesh("sin(5*x)*cos(4*y)/3", TOL, BOX)


def mesh_fault(points: Array, triangles: Array, values: Array, labels: Array) -> str:
    """Whether a mesh stands for the wave within the tolerance and carries what it should."""
    points, triangles = np.asarray(points, float), np.asarray(triangles)
    old, _ = surface()
    fault = independent.cover_fault(points, triangles, BOX)
    heights = independent.interpolated(points, triangles, old[:, 0], old[:, 1])
    if not fault and np.abs(heights - old[:, 2]).max() > TOL * (1.0 + 1e-9):
        fault = "an old vertex is farther away than the tolerance"
    if not fault and len(triangles) >= 2 * N * N:
        fault = "no fewer triangles"
    if not fault and np.abs(np.ravel(values) - linear(points)).max() > 1e-9:
        fault = "a linear value at vertices is not the same"
    if not fault and (np.ravel(labels) != halves(points, triangles)).any():
        fault = "labels of triangles are not the same"
    return fault


def same(points: Array, triangles: Array, made: equimesh.Result, rounding: float = 0.0) -> str:
    """Whether triangles are those of a result: bit for bit in whatever order of vertices, or in
    the same order up to rounding. Plane points are compared in the plane."""
    kept = made.points * [1, 1, int(points.shape[1] == 3 and points[:, 2].any())]
    found = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    if len(triangles) != len(made.triangles):
        return f"{len(triangles)} triangles of {len(made.triangles)}"
    if rounding:
        off = np.abs(found[triangles] - kept[made.triangles]).max()
        return "" if off <= rounding else f"corners are off by {off:.0e}"
    equal = (_corners(found, triangles) == _corners(kept, made.triangles)).all()
    return "" if equal else "corners are not the same"


def _corners(points: Array, triangles: Array) -> Array:
    """(m, 9) corners of all triangles in an order that only they decide."""
    shape = np.asarray(points, float)[np.asarray(triangles)]
    first = np.lexsort(shape.transpose(2, 0, 1)[::-1], axis=-1)[:, 0]
    turned = np.take_along_axis(shape, ((first[:, None] + np.arange(3)) % 3)[..., None], axis=1)
    flat = turned.reshape(-1, 9)
    return flat[np.lexsort(flat.T[::-1])]
