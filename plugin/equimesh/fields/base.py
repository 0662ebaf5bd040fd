"""What every surface z = f(x, y) can be asked."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.fields.kernel import KernelField
from equimesh.frame import Frame

__all__ = ["Array", "Field", "IntArray"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]


@runtime_checkable
class Field(Protocol):
    """A surface that is a graph, in the user's coordinates unless said otherwise."""

    @property
    def size(self) -> str:
        """The input's size in words, such as ``344 x 403 samples``."""

    @property
    def smooth(self) -> bool:
        """Whether second derivatives mean something at a mesh's scale (False: noise, kinks)."""

    def value(self, x: Array, y: Array) -> Array:
        """(n,) heights at (n,) points; NaN where the field is not defined."""

    def gradient(self, x: Array, y: Array) -> Array:
        """(n, 2) first derivatives."""

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives."""

    def outline(self, tol: float) -> shapely.Geometry:
        """The field's own domain, Polygon or MultiPolygon; its curve may be simplified within tol.

        Raises InputError where a field has no domain of its own (a function)."""

    def span(self, domain: shapely.Geometry) -> tuple[float, float]:
        """The smallest and largest height over the domain."""

    def frame(self, domain: shapely.Geometry) -> Frame:
        """The local coordinates in which the kernels of this field work."""

    def kernel(self, domain: shapely.Geometry, tol: float) -> KernelField:
        """The field for compiled kernels, in the coordinates of ``frame(domain)``."""

    def errors(self, points: Array, triangles: IntArray, limit: float = ...) -> tuple[Array, Array]:
        """(m,) largest error of each triangle and (m,) bounds that it never exceeds.

        Where bounds cost work, they need be tight only near the largest error and near ``limit``.

        ``points`` (n, 3), ``triangles`` (m, 3): the error is |f - linear| over the whole triangle,
        heights taken from ``points``."""
