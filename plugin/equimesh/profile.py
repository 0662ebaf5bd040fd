"""The error profile of a mesh: each triangle's largest error and a bound that holds everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError
from equimesh.fields import as_field
from equimesh.fields.base import Field

if TYPE_CHECKING:
    from equimesh.fields import Bound, Source

__all__ = ["Profile", "profile", "profile_again", "profile_of"]


@dataclass(frozen=True, eq=False)
class Profile:
    """Errors of a mesh against a surface.

    Attributes
    ----------
    errors
        (m,) largest |f - linear| over each triangle, in units of z.
    bounds
        (m,) upper bounds of the same.
    points, triangles
        (n, 3) and (m, 3), the mesh that was measured.
    over
        Where errors count: ``"surface"``, everywhere, or ``"samples"``, at a raster's samples.

    Examples
    --------
    >>> import equimesh
    >>> p = equimesh.profile([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "x**2")
    >>> p.max
    0.25
    """

    errors: NDArray[np.float64]
    bounds: NDArray[np.float64]
    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    over: str = "surface"

    @property
    def max(self) -> float:
        """The largest error found."""
        return float(self.errors.max(initial=0.0))

    @property
    def bound(self) -> float:
        """What the error nowhere exceeds."""
        return float(self.bounds.max(initial=0.0))

    def quantile(self, q: float) -> float:
        """The error that a share ``q`` of the triangles does not exceed (0.5: the median)."""
        return float(np.quantile(self.errors, q)) if len(self.errors) else 0.0

    @cached_property
    def angles(self) -> NDArray[np.float64]:
        """(m,) the smallest angle of each triangle seen from above, in degrees."""
        corners = self.points[self.triangles, :2]
        one = np.roll(corners, -1, axis=1) - corners
        other = np.roll(corners, 1, axis=1) - corners
        cross = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
        angles = np.arctan2(cross, (one * other).sum(axis=-1))
        return np.asarray(np.degrees(angles.min(axis=1, initial=np.pi)))

    def plot(self, ax: Any = None) -> Any:
        """Draw errors in ascending order, as the paper does; returns the matplotlib axes."""
        from equimesh.plot import plot_profile

        return plot_profile(self, ax=ax)


def profile_of(
    field: Field,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    limit: float = np.inf,
) -> Profile:
    """The profile of a mesh with heights (n, 3) against a field, told apart at ``limit``."""
    errors, bounds = field.errors(points, triangles, limit)
    over = getattr(field, "bound", "surface")
    return Profile(errors, np.maximum(bounds, errors), points, triangles, over)


def profile_again(
    field: Field,
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    limit: float,
    before: Profile,
    row: NDArray[np.int64],
) -> Profile:
    """The profile of a mesh most of whose triangles another profile knows.

    ``row`` (m,): where they may be found in it, negative for none. What moved is measured anew.
    """
    old = np.maximum(row, 0)
    corners, known = points[triangles], before.points[before.triangles[old]]
    new = np.flatnonzero((row < 0) | (corners != known).any(axis=(1, 2)))
    errors, bounds = before.errors[old], before.bounds[old]
    if len(new):
        part = profile_of(field, points, triangles[new], limit)
        errors[new], bounds[new] = part.errors, part.bounds
    return Profile(errors, bounds, points, triangles, before.over)


def profile(
    points: ArrayLike,
    triangles: ArrayLike,
    source: Source,
    bound: Bound | None = None,
    limit: float = np.inf,
) -> Profile:
    """Measure any triangle mesh against a surface.

    Parameters
    ----------
    points
        (n, 3) vertices; (n, 2) take their heights from the surface.
    triangles
        (m, 3) indices, in either orientation.
    source
        What ``remesh`` takes: callable, expression, 2-D array or field.
    bound
        For rasters: ``"surface"`` or ``"samples"``, see ``Raster``.
    limit
        An error in units of z, such as a tolerance: the bounds of functions are tightened wherever
        they leave open whether it is exceeded.

    Raises
    ------
    InputError
        Shapes, indices or coordinates that make no mesh; a vertex on which the surface is
        undefined.
    """
    p, t = np.array(points, float), np.asarray(triangles)
    if p.ndim != 2 or p.shape[1] not in (2, 3) or len(p) == 0:
        raise InputError(f"Points have the shape {p.shape}: give (n, 2) or (n, 3) coordinates.")
    if t.ndim != 2 or t.shape[1] != 3 or len(t) == 0 or not np.issubdtype(t.dtype, np.integer):
        raise InputError(f"Triangles have the shape {t.shape}: give (m, 3) integer indices.")
    if t.min() < 0 or t.max() >= len(p):
        raise InputError(f"A triangle refers to vertex {t.max()} of {len(p)}: correct the indices.")
    t = t.astype(np.int64)
    used = np.unique(t)
    if not np.isfinite(p[used]).all():
        raise InputError("The mesh has coordinates that are not finite: remove those vertices.")
    box = shapely.box(*p[used, :2].min(0), *p[used, :2].max(0))
    field = as_field(source, box, bound)
    if p.shape[1] == 2:
        z = np.zeros(len(p))
        z[used] = field.value(p[used, 0], p[used, 1])
        if not np.isfinite(z).all():
            k = int(np.flatnonzero(~np.isfinite(z))[0])
            raise InputError(
                f"The surface has no height at vertex {k} ({p[k, 0]:.6g}, {p[k, 1]:.6g}): "
                "give points (n, 3), or a mesh inside the surface's domain."
            )
        p = np.column_stack([p, z])
    a, b, c = p[t[:, 0], :2], p[t[:, 1], :2], p[t[:, 2], :2]
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0
    t[turned] = t[turned][:, ::-1]
    return profile_of(field, p, t, limit)
