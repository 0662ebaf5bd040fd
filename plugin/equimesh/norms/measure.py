"""Measuring norms of a mesh's error: integrals cut until two rules agree, gradients bounded."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.base import Field
from equimesh.fields.sampling import sampled_errors
from equimesh.norms.densities import POWERS
from equimesh.norms.profile import NormProfile
from equimesh.riemann.quadrature import POINTS, WEIGHTS, quartered

__all__ = ["norm_profile"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

_ACCURACY = 1e-3  # of an integral: what two rules may differ by in sum
_MOST = 1_000_000  # triangles in one pass
_TIGHT = 0.005  # of the largest gradient: what its bound may exceed it by
_DEPTH = 4
_ROUNDING = 1e-12


def norm_profile(surface: Field, points: Array, triangles: IntArray, norm: str) -> NormProfile:
    """A norm of f less the linear interpolant of points (n, 3) over triangles (m, 3)."""
    if norm in POWERS:
        power = POWERS[norm]
        values, off = _integrals(surface, points[triangles], power)
        whole, spare = float(values.sum()), float(off.sum())
        value = whole ** (1.0 / power)
        bound = (whole + spare) ** (1.0 / power)
        errors, bounds = values ** (1.0 / power), (values + off) ** (1.0 / power)
    else:
        errors, bounds = _gradients(surface, points, triangles)
        value, bound = float(errors.max(initial=0.0)), float(bounds.max(initial=0.0))
    return NormProfile(
        errors=errors, bounds=bounds, points=points, triangles=triangles,
        norm=norm, value=value, value_bound=bound * (1.0 + _ROUNDING),
    )  # fmt: skip


def _integrals(surface: Field, corners: Array, power: int) -> tuple[Array, Array]:
    """(m,) integrals of |e|^power over triangles (m, 3, 3), and (m,) estimates of their errors.

    A rule of degree 5 is compared with itself on the four parts of a triangle; the worst are cut
    further until the differences sum up to little.
    """
    count = len(corners)
    values, off = np.zeros(count), np.zeros(count)
    owner = np.arange(count)
    coarse = _rule(surface, corners, power)
    while len(owner):
        parts = quartered(corners)
        fine = _rule(surface, parts, power).reshape(4, -1)
        together = fine.sum(0)
        difference = np.abs(together - coarse)
        whole = values.sum() + together.sum()
        order = np.argsort(-difference, kind="stable")
        left = off.sum() + difference.sum() - np.cumsum(difference[order])
        number = 0
        if off.sum() + difference.sum() > _ACCURACY * whole:
            number = int(np.searchsorted(-left, -_ACCURACY * whole)) + 1
        if 16 * number > _MOST or whole <= 0.0:
            number = 0
        again = np.zeros(len(owner), bool)
        again[order[:number]] = True
        np.add.at(values, owner[~again], together[~again])
        np.add.at(off, owner[~again], difference[~again])
        corners = parts.reshape(4, -1, 3, 3)[:, again].reshape(-1, 3, 3)
        coarse, owner = fine[:, again].ravel(), np.tile(owner[again], 4)
    return values, off


def _rule(surface: Field, corners: Array, power: int) -> Array:
    """Integrals of |e|^power by seven points."""
    p = np.einsum("qk,tkd->tqd", POINTS, corners)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    z = surface.value(p[..., 0].ravel(), p[..., 1].ravel()).reshape(p.shape[:2])
    return np.asarray(area * (np.abs(z - p[..., 2]) ** power @ WEIGHTS))


def _gradients(surface: Field, points: Array, triangles: IntArray) -> tuple[Array, Array]:
    """(m,) largest lengths of the gradient's error found, and (m,) bounds.

    The gradient is near to its linear interpolant at the corners of a triangle, whose length is
    largest at a corner; what it misses is bounded as the certificate bounds a function's error.
    Triangles are cut in four where that leaves the largest value open.
    """
    corners = points[triangles]
    slopes = _slopes(corners)
    errors, bounds = _at_corners(surface, corners, slopes)
    owner = np.arange(len(triangles))
    parts = corners
    fine, fine_bound = errors.copy(), bounds.copy()
    for _ in range(_DEPTH):
        largest = errors.max(initial=0.0)
        open_case = np.unique(owner[fine_bound > (1.0 + _TIGHT) * largest])
        if len(open_case) == 0:
            break
        todo = np.flatnonzero(np.isin(owner, open_case))
        owner = np.tile(owner[todo], 4)
        parts = quartered(parts[todo])
        fine, fine_bound = _at_corners(surface, parts, slopes[owner])
        errors[open_case] = bounds[open_case] = 0.0
        np.maximum.at(errors, owner, fine)
        np.maximum.at(bounds, owner, fine_bound)
    return errors, np.maximum(bounds, errors)


def _slopes(corners: Array) -> Array:
    """(m, 2) gradients of the linear interpolants."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    x = u[:, 2] * v[:, 1] - v[:, 2] * u[:, 1]
    y = v[:, 2] * u[:, 0] - u[:, 2] * v[:, 0]
    return np.stack([x, y], 1) / double[:, None]


def _at_corners(surface: Field, corners: Array, slopes: Array) -> tuple[Array, Array]:
    flat = corners[..., :2].reshape(-1, 2)
    gradient = surface.gradient(flat[:, 0], flat[:, 1]).reshape(-1, 3, 2)
    length = np.hypot(*(gradient - slopes[:, None]).transpose(2, 0, 1)).max(1)
    missed = np.zeros(len(corners))
    numbers = np.arange(len(flat)).reshape(-1, 3)
    for axis in range(2):
        heights = np.column_stack([flat, gradient[..., axis].ravel()])
        _, bounds = sampled_errors(_component(surface, axis), heights, numbers, 0.0)
        missed = np.hypot(missed, bounds)
    return length, length + missed


def _component(surface: Field, axis: int) -> Callable[[Array, Array], Array]:
    return lambda x, y: surface.gradient(x, y)[:, axis]
