"""The affine change between the user's coordinates and the local ones that kernels work in.

Linear interpolation does not see affine maps, so a mesh may be computed in any affine frame.
Kernels work near the origin with unit-sized numbers: map coordinates of 5e6, cells of 0.1 and
rotated rasters are all undone here, on entry, and redone on exit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["Frame"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Frame:
    """``user = origin + matrix @ local``.

    Parameters
    ----------
    origin
        (2,) float, the user's coordinates of the local origin.
    matrix
        (2, 2) float, its columns the local axes in the user's units.
    snap
        Local coordinates nearer than this to a whole number become that number: what the user's
        large numbers cannot tell from a sample of a raster is that sample.
    """

    origin: Array
    matrix: Array
    snap: float = 0.0

    def __post_init__(self) -> None:
        size = float(np.abs(self.matrix).max())
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.origin).all() and size > 0.0):
            raise InputError("The coordinates are not finite: give finite extents and cell sizes.")
        if abs(self.determinant) <= 1e-14 * size * size:
            raise InputError("The coordinate axes are parallel: give cells with a positive area.")

    @classmethod
    def of_bounds(cls, xmin: float, ymin: float, xmax: float, ymax: float) -> Frame:
        """Centre a box and scale its longer side to length 2 (one scale for both axes)."""
        half = 0.5 * max(xmax - xmin, ymax - ymin)
        origin = np.array([xmin + 0.5 * (xmax - xmin), ymin + 0.5 * (ymax - ymin)])
        return cls(origin, half * np.eye(2))

    @classmethod
    def along(cls, start: Array, end: Array, points: Array) -> Frame:
        """The same for (n, 2) points, with the first axis from ``start`` towards ``end``."""
        u, v = (end - start) / np.hypot(*(end - start))
        turn = np.array([[u, -v], [v, u]])
        turned = (points - start) @ turn
        low, high = turned.min(0), turned.max(0)
        half = 0.5 * float((high - low).max())
        return cls(start + turn @ (low + 0.5 * (high - low)), half * turn)

    @property
    def determinant(self) -> float:
        """Area in the user's units of a local unit square; negative where the axes swap hands."""
        m = self.matrix
        return float(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])

    def to_user(self, local: Array) -> Array:
        """(n, 2) local to (n, 2) user's coordinates."""
        return np.asarray(self.origin + local @ self.matrix.T)

    def to_local(self, user: Array) -> Array:
        """(n, 2) user's to (n, 2) local coordinates."""
        local = np.asarray((user - self.origin) @ np.linalg.inv(self.matrix).T)
        if self.snap > 0.0:
            whole = np.rint(local)
            local = np.where(np.abs(local - whole) <= self.snap, whole, local)
        return local

    def geometry_to_local(self, geometry: shapely.Geometry) -> shapely.Geometry:
        """A shapely geometry in the user's coordinates, carried to local ones."""
        return shapely.transform(geometry, self.to_local)
