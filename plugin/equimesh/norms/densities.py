"""How many triangles a norm of the error asks for where the surface is quadratic.

With H = diag(l1, l2), |l1| >= |l2|, and triangles of area A:

- the L1 norm of the error over one triangle is at least ``C1 sqrt|det H| A^2``, its L2 norm
  ``C2 sqrt|det H| A^(3/2)``. Edges with the squares p, q, r in the quadratic form of H have the
  error ``-(p v w + q w u + r u v) / 2`` in barycentric coordinates, and ``2 (p^2 + q^2 + r^2) -
  (p + q + r)^2 = -16 det(H) A^2``. Where H is definite the equilateral triangle is best: C1 =
  1 / (2 sqrt 3), C2 = sqrt(4 / 45). Where it is not, every triangle with p + q + r = 0 is best for
  L2, C2 = 1 / sqrt(90), and of these the one with an edge of square 0 for L1, C1 = 1 / 12 (found
  by trying all). Summed over the domain and minimised over the density of triangles that gives
  ``N* = (integral of g^(p / (p + 1)))^((p + 1) / p) / tol`` with ``g = Cp sqrt|det H|`` (L. Chen,
  P. Sun and J. Xu, "Optimal anisotropic meshes for minimizing interpolation errors in L^p-norm",
  2007).
- the gradient's error is largest at a vertex. The best triangle is isosceles, its base along the
  stronger direction (E. F. D'Azevedo and R. B. Simpson, "On optimal triangular meshes for
  minimizing the gradient error", 1991, treat the same problem): with the ratio r = l2 / l1 > 0 it
  has the area ``a tol^2 / |det H|``, a from ``gradient_area``; where H is indefinite a = 1 (found
  by trying all).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.fields.base import Field
from equimesh.fields.compiled import allocating
from equimesh.fields.patch_kernels import derivatives2
from equimesh.riemann.quadrature import integral

__all__ = ["POWERS", "constants", "gradient_area", "least_triangles", "patch_hessian"]

Array = NDArray[np.float64]

POWERS = {"L1": 1, "L2": 2}
# Cp squared where H is indefinite, and where it is definite.
_SQUARES = {"L1": (1.0 / 144.0, 1.0 / 12.0), "L2": (1.0 / 90.0, 4.0 / 45.0)}
_ACCURACY = 1e-3  # of N*
_PATCHES = 1e-3  # of the range of heights: the tolerance of polynomials for second derivatives


def constants(norm: str, definite: Array) -> Array:
    """Cp for (n,) numbers from -1 (H is indefinite) to 1 (definite); mean squares in between."""
    low, high = _SQUARES[norm]
    return np.sqrt(0.5 * (low + high) + 0.5 * (high - low) * definite)


def gradient_area(ratio: Array) -> Array:
    """The number a for ratios l2 / l1 from -1 to 1: from 1 at 0 to 3 sqrt(3) / 4 at 1.

    With base 2 b and height h, B = b^2 and K = (r h)^2 for l1 = 1 and tol = 1, the gradient's error
    at the ends of the base is ``B + (K - r B)^2 / (4 K) = 1``; a = sqrt(B K) is largest at
    ``B / K = 2 / (c + sqrt(c^2 + 12 r^2))``, c = 4 - 2 r.
    """
    r = np.maximum(ratio, 0.0)
    c = 4.0 - 2.0 * r
    share = 2.0 / (c + np.sqrt(c * c + 12.0 * r * r))
    return np.asarray(4.0 * np.sqrt(share) / (1.0 + c * share + (r * share) ** 2))


@allocating
def _hessians(frame: Array, child: NDArray[np.int32], coef: Array, local: Array) -> Array:
    """(n, 2, 2) second derivatives at local points (n, 2)."""
    out = np.empty((local.shape[0], 2, 2))
    for i in range(local.shape[0]):
        _, _, _, hxx, hxy, hyy = derivatives2(frame, child, coef, local[i, 0], local[i, 1])
        out[i, 0, 0], out[i, 1, 1] = hxx, hyy
        out[i, 0, 1] = out[i, 1, 0] = hxy
    return out


def patch_hessian(
    surface: Field, geometry: shapely.Geometry, tol: float
) -> Callable[[Array, Array], Array]:
    """(n, 2, 2) second derivatives at x, y (n,) of polynomials within tol / 1000 of a function."""
    kernel, frame = surface.kernel(geometry, tol), surface.frame(geometry)
    inverse = np.linalg.inv(frame.matrix)

    def hessian(x: Array, y: Array) -> Array:
        local = np.ascontiguousarray(frame.to_local(np.stack([x, y], 1)))
        h = _hessians(kernel.frame, kernel.child, kernel.coef, local)
        return np.asarray(inverse.T @ h @ inverse)

    return hessian


def least_triangles(surface: Field, geometry: shapely.Geometry, norm: str, tol: float) -> float:
    """N*: the fewest triangles whose error in the norm is ``tol``, as tol goes to 0."""
    low, high = surface.span(geometry)
    if not high > low:
        return 0.0
    hessian = patch_hessian(surface, geometry, _PATCHES * (high - low))

    def density(x: Array, y: Array) -> Array:
        h = hessian(x, y)
        det = h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2
        if norm in POWERS:
            p = POWERS[norm]
            g = constants(norm, np.sign(det)) * np.sqrt(np.abs(det))
            return np.asarray(g ** (p / (p + 1.0)))
        mean = 0.5 * np.abs(h[:, 0, 0] + h[:, 1, 1])
        radius = np.hypot(0.5 * (h[:, 0, 0] - h[:, 1, 1]), h[:, 0, 1])
        ratio = (mean - radius) / np.maximum(mean + radius, 1e-300)
        return np.asarray(np.abs(det) / gradient_area(ratio))

    whole = integral(density, geometry, _ACCURACY)
    if norm in POWERS:
        p = POWERS[norm]
        return float(whole ** ((p + 1.0) / p) / tol)
    return whole / tol**2
