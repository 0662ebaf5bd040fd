"""Gaussian curvature of a metric from differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["gaussian_curvature"]

Array = NDArray[np.float64]

# (offsets) of a nine-point stencil, in an order that the differences below rely on.
_STENCIL = [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)]


def gaussian_curvature(
    metric: Callable[[Array, Array], Array], x: Array, y: Array, step: float
) -> Array:
    """(n,) curvature K by F. Brioschi's formula, in inverse squared units of metric length.

    The stencil lies along the axes of a frame that is orthonormal in M at each point, so that
    strong anisotropy costs no accuracy; ``step`` is its width in metric length.
    """
    x, y = np.ravel(x).astype(float), np.ravel(y).astype(float)
    n = len(x)
    values, vectors = np.linalg.eigh(metric(x, y))
    frame = vectors / np.sqrt(values)[:, None, :]
    offset = step * np.array(_STENCIL, float)
    p = np.stack([x, y], 1)[:, None, :] + np.einsum("nij,qj->nqi", frame, offset)
    m = metric(p[..., 0].ravel(), p[..., 1].ravel()).reshape(n, 9, 2, 2)
    g = np.einsum("nai,nqab,nbj->nqij", frame, m, frame)
    e, f, h = g[:, :, 0, 0], g[:, :, 0, 1], g[:, :, 1, 1]

    def du(a: Array) -> Array:
        return (a[:, 5] - a[:, 3]) / (2.0 * step)

    def dv(a: Array) -> Array:
        return (a[:, 7] - a[:, 1]) / (2.0 * step)

    e0, f0, h0 = e[:, 4], f[:, 4], h[:, 4]
    evv = (e[:, 7] - 2.0 * e0 + e[:, 1]) / step**2
    huu = (h[:, 5] - 2.0 * h0 + h[:, 3]) / step**2
    fuv = (f[:, 8] - f[:, 6] - f[:, 2] + f[:, 0]) / (4.0 * step**2)
    zero = np.zeros(n)
    first = np.array(
        [
            [-0.5 * evv + fuv - 0.5 * huu, 0.5 * du(e), du(f) - 0.5 * dv(e)],
            [dv(f) - 0.5 * du(h), e0, f0],
            [0.5 * dv(h), f0, h0],
        ]
    )
    second = np.array(
        [
            [zero, 0.5 * dv(e), 0.5 * du(h)],
            [0.5 * dv(e), e0, f0],
            [0.5 * du(h), f0, h0],
        ]
    )
    det = e0 * h0 - f0 * f0
    parts = (np.linalg.det(a.transpose(2, 0, 1)) for a in (first, second))
    return np.asarray((next(parts) - next(parts)) / det**2)
