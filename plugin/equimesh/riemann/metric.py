"""A Riemannian metric on the plane, with the field's tools: complexity, normalise, intersect,
gradation.

A metric M(x) measures an edge d by sqrt(d^T M d), a pure number. A mesh is unit if all its edges
measure one; its triangles then are equilateral in the metric and there are
``4 / sqrt(3) * integral of sqrt(det M)`` of them (A. Loseille and F. Alauzet, "Continuous mesh
framework", SIAM J. Numer. Anal. 49 (2011)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from equimesh.domain import DomainLike, domain_geometry
from equimesh.errors import InputError
from equimesh.riemann.background import Background
from equimesh.riemann.quadrature import POINTS, WEIGHTS, integral
from equimesh.riemann.tensors import checked, intersection

if TYPE_CHECKING:
    from equimesh.fields import Source

__all__ = ["Metric"]

Array = NDArray[np.float64]
UNIT_AREA = math.sqrt(3.0) / 4.0

_GAUSS, _WEIGHT = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, eq=False)
class Metric:
    """A field of symmetric positive definite tensors.

    Parameters
    ----------
    tensor
        Callable (x (n,), y (n,)) -> (n, 2, 2), or one (2, 2) for a constant metric. Lengths in the
        metric are pure numbers: M has the unit one over length squared.
    background
        The mesh that a metric was given on, for ``gradation``; see ``on_mesh``.

    Raises
    ------
    InputError
        ``tensor`` is neither; when called: a tensor is not finite, symmetric, positive definite.

    Examples
    --------
    >>> metric = Metric.isotropic(0.1)
    >>> round(metric.unit_triangles((0, 0, 1, 1)), 3)
    230.94
    """

    tensor: Callable[[Array, Array], Any] | ArrayLike
    background: Background | None = None

    def __post_init__(self) -> None:
        if not callable(self.tensor):
            try:
                constant = np.array(self.tensor, float)
            except (TypeError, ValueError):
                constant = np.empty(0)
            if constant.shape != (2, 2):
                raise InputError(
                    "A metric must be a callable (x, y) -> (n, 2, 2) or one 2 x 2 tensor."
                )
            object.__setattr__(self, "tensor", lambda x, y: constant)
            self(np.zeros(1), np.zeros(1))

    @classmethod
    def on_mesh(cls, points: ArrayLike, triangles: ArrayLike, tensors: ArrayLike) -> Metric:
        """Tensors (n, 2, 2) at the vertices (n, 2) of a mesh with triangles (m, 3).

        In between the logarithms are interpolated linearly (V. Arsigny et al., "Log-Euclidean
        metrics for fast and simple calculus on diffusion tensors", 2006); beyond the mesh the
        metric is that of the nearest triangle, with barycentric coordinates cut off at zero.
        """
        background = Background.of(points, triangles, tensors)
        return cls(background, background)

    @classmethod
    def isotropic(cls, size: Callable[[Array, Array], Any] | float) -> Metric:
        """The metric of a size field, a callable or a number: M = I / size^2."""
        if not callable(size):
            h = float(size)
            if not (math.isfinite(h) and h > 0.0):
                raise InputError(f"The size is {size}: give a positive, finite length.")
            return cls(np.eye(2) / h**2)

        def tensor(x: Array, y: Array) -> Array:
            h = np.broadcast_to(np.asarray(size(x, y), float), x.shape)
            with np.errstate(divide="ignore"):
                return np.where(h > 0.0, 1.0 / h**2, np.nan)[:, None, None] * np.eye(2)

        return cls(tensor)

    @classmethod
    def of(cls, source: Source, tol: float, domain: DomainLike = None) -> Metric:
        """The error metric of a surface for the tolerance ``tol`` (see ``error_metric``)."""
        from equimesh.riemann.error_metric import error_metric

        return cls(error_metric(source, tol, domain))

    def __call__(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(n, 2, 2) tensors at points x, y (n,)."""
        px, py = (np.ascontiguousarray(v, float).ravel() for v in np.broadcast_arrays(x, y))
        assert callable(self.tensor)
        try:
            with np.errstate(all="ignore"):
                found = np.asarray(self.tensor(px, py), float)
        except InputError:
            raise
        except (TypeError, ValueError, IndexError) as error:
            raise InputError(
                f"The metric failed on arrays x and y ({error}): write it with NumPy so that it "
                "gives (n, 2, 2) tensors."
            ) from error
        return checked(found, px, py)

    def lengths(self, a: ArrayLike, b: ArrayLike) -> Array:
        """(n,) lengths of straight edges from a (n, 2) to b (n, 2), by Gauss quadrature."""
        start, end = np.asarray(a, float), np.asarray(b, float)
        d = end - start
        s = 0.5 * (1.0 + _GAUSS)
        p = start[:, None, :] + s[None, :, None] * d[:, None, :]
        m = self(p[..., 0].ravel(), p[..., 1].ravel()).reshape(len(d), len(s), 2, 2)
        speed = np.sqrt(np.einsum("ni,nqij,nj->nq", d, m, d))
        return np.asarray(speed @ (0.5 * _WEIGHT))

    def means(self, corners: Array) -> Array:
        """(m, 2, 2) mean tensors over triangles with corners (m, 3, 2)."""
        p = np.einsum("qk,tkd->tqd", POINTS, corners)
        m = self(p[..., 0].ravel(), p[..., 1].ravel()).reshape(len(corners), -1, 2, 2)
        return np.asarray(np.einsum("tqij,q->tij", m, WEIGHTS))

    def density(self, x: Array, y: Array) -> Array:
        """(n,) sqrt(det M)."""
        m = self(x, y)
        return np.sqrt(m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] ** 2)

    def complexity(self, domain: DomainLike) -> float:
        """The integral of sqrt(det M) over a domain: its area in the metric."""
        return integral(self.density, domain_geometry(domain))

    def unit_triangles(self, domain: DomainLike) -> float:
        """How many equilateral triangles of unit edges a domain's area in the metric is worth."""
        return self.complexity(domain) / UNIT_AREA

    def scaled(self, factor: float) -> Metric:
        """Lengths multiplied by ``factor``."""
        return self._like(lambda m: factor * factor * m)

    def normalise(self, domain: DomainLike, count: float) -> Metric:
        """The multiple of this metric of which the domain is worth ``count`` unit triangles."""
        if not (math.isfinite(count) and count > 0.0):
            raise InputError(f"The number of triangles is {count}: give a positive one.")
        return self.scaled(math.sqrt(count / self.unit_triangles(domain)))

    normalised = normalise

    def intersect(self, other: Metric) -> Metric:
        """The metric whose unit balls lie in those of both, by simultaneous reduction.

        No edge is shorter in it than in either.
        """

        def tensor(x: Array, y: Array) -> Array:
            return intersection(self(x, y), other(x, y))

        return Metric(tensor, self.background or other.background)

    def gradation(self, rate: float, domain: DomainLike = None) -> Metric:
        """The largest metric sizes that nowhere grow faster than ``rate`` from edge to edge.

        Unit lengths may grow by ``1 + l ln(rate)`` over a metric distance l (F. Alauzet, "Size
        gradation control of anisotropic meshes", 2010), here along the edges of a background mesh:
        that of the metric, or one that resolves it over ``domain``.
        """
        from equimesh.riemann.gradation import graded

        if not (math.isfinite(rate) and rate > 1.0):
            raise InputError(f"The gradation is {rate}: give a growth above 1, such as 1.3.")
        background = self.background
        if background is None:
            if domain is None:
                raise InputError("A metric without a mesh needs domain= for its gradation.")
            background = Background.resolving(self, domain_geometry(domain))
        background = background.with_tensors(self(*background.points.T))
        limited = graded(background, rate)
        return Metric(limited, limited)

    def curvature(self, x: ArrayLike, y: ArrayLike, step: float = 1e-3) -> Array:
        """(n,) Gaussian curvature times the area of a unit triangle: 0 where the metric is flat.

        By central differences over ``step`` units of length in the metric, affinely scaled.
        """
        from equimesh.riemann.curvature import gaussian_curvature

        return UNIT_AREA * gaussian_curvature(self, np.asarray(x), np.asarray(y), step)

    def _like(self, change: Callable[[Array], Array]) -> Metric:
        if isinstance(self.tensor, Background):
            changed = self.tensor.with_tensors(change(self.tensor.tensors))
            return Metric(changed, changed)
        return Metric(lambda x, y: change(self(x, y)), self.background)
