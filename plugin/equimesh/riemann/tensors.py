"""Fields of symmetric positive definite 2 x 2 tensors: logarithm, exponential, intersection.

Closed forms for a symmetric L = a I + B with B free of trace and B^2 = b^2 I:
``exp L = e^a (cosh b I + sinh b / b B)``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["checked", "exponential", "intersection", "logarithm", "packed", "reduction", "unpacked"]

Array = NDArray[np.float64]


def checked(tensors: Any, x: Array, y: Array) -> Array:
    """``tensors`` as (n, 2, 2) symmetric positive definite float for points x, y (n,).

    Raises
    ------
    InputError
        Wrong shape, not finite, not symmetric or not positive definite somewhere; the message tells
        where.
    """
    m = np.asarray(tensors, float)
    if m.shape == (2, 2):
        m = np.broadcast_to(m, (len(x), 2, 2))
    if m.shape != (len(x), 2, 2):
        raise InputError(
            f"The metric has the shape {m.shape} at {len(x)} points: give (n, 2, 2) tensors."
        )

    def refuse(bad: NDArray[np.bool_], what: str) -> None:
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            raise InputError(
                f"The metric is not {what} at ({x[i]:.6g}, {y[i]:.6g}): "
                "give symmetric positive definite tensors on the whole domain."
            )

    refuse(~np.isfinite(m).all(axis=(1, 2)), "finite")
    a, b, c, d = m[:, 0, 0], m[:, 0, 1], m[:, 1, 0], m[:, 1, 1]
    refuse(np.abs(b - c) > 1e-9 * (np.abs(a) + np.abs(d)), "symmetric")
    off = 0.5 * (b + c)
    refuse(~((a > 0.0) & (d > 0.0) & (a * d - off * off > 0.0)), "positive definite")
    return np.stack([np.stack([a, off], 1), np.stack([off, d], 1)], 1)


def packed(m: Array) -> Array:
    """(..., 2, 2) symmetric to (..., 3): xx, xy, yy."""
    return np.stack([m[..., 0, 0], m[..., 0, 1], m[..., 1, 1]], -1)


def unpacked(p: Array) -> Array:
    """(..., 3) xx, xy, yy to (..., 2, 2)."""
    return np.stack(
        [np.stack([p[..., 0], p[..., 1]], -1), np.stack([p[..., 1], p[..., 2]], -1)], -2
    )


def logarithm(m: Array) -> Array:
    """Symmetric logarithm (n, 2, 2) of positive definite tensors (n, 2, 2)."""
    a, b, d = m[:, 0, 0], m[:, 0, 1], m[:, 1, 1]
    half, radius = 0.5 * (a - d), np.hypot(0.5 * (a - d), b)
    large = 0.5 * (a + d) + radius
    # The small eigenvalue without cancellation.
    with np.errstate(all="ignore"):
        small = (a * d - b * b) / large
        top, low = np.log(large), np.log(small)
        share = np.where(radius > 0.0, 0.5 * (top - low) / radius, 1.0 / large)
    mean = 0.5 * (top + low)
    return unpacked(np.stack([mean + share * half, share * b, mean - share * half], 1))


def exponential(log: Array) -> Array:
    """Positive definite exponential (n, 2, 2) of symmetric tensors (n, 2, 2)."""
    a, half = 0.5 * (log[:, 0, 0] + log[:, 1, 1]), 0.5 * (log[:, 0, 0] - log[:, 1, 1])
    off = log[:, 0, 1]
    b = np.hypot(half, off)
    scale = np.exp(a)
    c = scale * np.cosh(b)
    s = scale * np.where(b > 1e-4, np.sinh(b) / np.maximum(b, 1e-300), 1.0 + b * b / 6.0)
    return unpacked(np.stack([c + s * half, s * off, c - s * half], 1))


def reduction(m: Array, other: Array) -> tuple[Array, Array]:
    """Common basis P (n, 2, 2), columns: P^T M P = I, P^T other P = diag(l); and l (n, 2)."""
    factor = np.linalg.cholesky(m)
    inverse = np.linalg.inv(factor)
    values, vectors = np.linalg.eigh(inverse @ other @ inverse.transpose(0, 2, 1))
    return inverse.transpose(0, 2, 1) @ vectors, values


def intersection(m: Array, other: Array) -> Array:
    """The largest ellipse in both unit balls that has their common conjugate axes (n, 2, 2).

    Simultaneous reduction: in a basis in which both tensors are diagonal, the larger entry of each.
    """
    basis, values = reduction(m, other)
    back = np.linalg.inv(basis)
    joined = back.transpose(0, 2, 1) @ (np.maximum(values, 1.0)[:, :, None] * back)
    return np.asarray(0.5 * (joined + joined.transpose(0, 2, 1)))
