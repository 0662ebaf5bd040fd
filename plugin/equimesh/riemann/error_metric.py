"""The metric of a surface's interpolation error."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from equimesh.domain import DomainLike, domain_geometry
from equimesh.errors import InputError
from equimesh.fields import Source, as_field
from equimesh.fields.compiled import allocating
from equimesh.fields.kernel import PATCHES
from equimesh.metric import frame_at

__all__ = ["error_metric", "limited_tensors"]

Array = NDArray[np.float64]

# Equilateral in |H| with the circumradius sqrt(2 tol), thus squared edges 6 tol: the largest error
# is tol where H is definite (sec. 2 of the paper), and at most that elsewhere. The frames of
# ``frame_at`` measure in units of 8 tol.
_SHARE = 8.0 / 6.0


@allocating
def limited_tensors(frame, child, coef, local, eight_tol, floor):
    """(n, 2, 2) limited |H| / (6 tol) at local points (n, 2)."""
    out = np.empty((local.shape[0], 2, 2))
    for i in range(local.shape[0]):
        ax, ay, bx, by, _, _ = frame_at(
            frame, child, coef, local[i, 0], local[i, 1], eight_tol, floor
        )
        a, b = _SHARE / (ax * ax + ay * ay) ** 2, _SHARE / (bx * bx + by * by) ** 2
        out[i, 0, 0] = a * ax * ax + b * bx * bx
        out[i, 0, 1] = out[i, 1, 0] = a * ax * ay + b * bx * by
        out[i, 1, 1] = a * ay * ay + b * by * by
    return out


def error_metric(
    source: Source, tol: float, domain: DomainLike = None
) -> Callable[[Array, Array], Array]:
    """|H| / (6 tol), its eigenvalues limited near det H = 0.

    A cubic ``c s^3 / 6`` along an eigenvector has the error ``|c| l^3 / (72 sqrt 3)`` on an edge of
    length l; each eigenvalue is kept so large that this stays below ``tol`` too, and no unit edge
    is longer than the domain. Second derivatives are those of the piecewise polynomials that stand
    in for the function over the domain's box.

    Raises
    ------
    InputError
        ``tol`` is not positive; the source has no second derivatives or no domain.
    """
    if not (math.isfinite(tol) and tol > 0.0):
        raise InputError(f"The tolerance is {tol}: it must be a positive, finite number.")
    geometry = None if domain is None else domain_geometry(domain)
    surface = as_field(source, geometry)
    if geometry is None:
        geometry = surface.outline(tol)
    frame = surface.frame(geometry)
    kernel = surface.kernel(geometry, tol)
    if kernel.kind != PATCHES:
        raise InputError(
            f"A surface of {surface.size} has no second derivatives to make a metric of: "
            "give a smooth function."
        )
    inverse = np.linalg.inv(frame.matrix)
    extent = float(np.ptp(frame.to_local(np.reshape(geometry.bounds, (2, 2))), axis=0).max())
    floor = 1.0 / (_SHARE * extent**2)

    def tensor(x: Array, y: Array) -> Array:
        local = np.ascontiguousarray(frame.to_local(np.stack([x, y], 1)))
        m = limited_tensors(kernel.frame, kernel.child, kernel.coef, local, 8.0 * tol, floor)
        return np.asarray(inverse.T @ m @ inverse)

    return tensor
