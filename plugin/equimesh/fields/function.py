"""Functions z = f(x, y): callables and text."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shapely

from equimesh.domain import sides_of
from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.differences import stencil_derivatives
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.fields.patches import fit_patches
from equimesh.fields.sampling import sampled_errors
from equimesh.frame import Frame

__all__ = ["Function"]

# Share of the tolerance to which piecewise polynomials stand in for f inside the optimiser.
_PATCH_SHARE = 2e-4
_GRID, _FINER = 65, 9  # samples across the domain, and across two cells around an extreme
_TIED = 1e-9  # relative difference of what is alike but for rounding


@dataclass(frozen=True, eq=False)
class Function:
    """A function of x and y.

    Parameters
    ----------
    f
        A vectorised callable ``f(x, y) -> z`` on (n,) arrays, or an arithmetic expression in x, y.
    gradient_of, hessian_of
        Callables for (n, 2) first and (n, 2, 2) second derivatives, where you have them. Text is
        differentiated symbolically; otherwise derivatives come from high-order differences.
    box
        (xmin, ymin, xmax, ymax) that differences may use; set by ``on``.

    Raises
    ------
    InputError
        The text is not an expression of x and y.

    Examples
    --------
    >>> Function("x**2 * y").gradient(np.array([1.0]), np.array([3.0]))
    array([[6., 1.]])
    """

    f: Callable[[Array, Array], Array] | str
    gradient_of: Callable[[Array, Array], Array] | None = None
    hessian_of: Callable[[Array, Array], Array] | None = None
    third_of: Callable[[Array, Array], Array] | None = None
    box: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.f, str):
            from equimesh.expression import parse  # SymPy takes a while to load

            expression = parse(self.f)
            object.__setattr__(self, "f", expression.value)
            object.__setattr__(self, "gradient_of", expression.gradient)
            object.__setattr__(self, "hessian_of", expression.hessian)
            object.__setattr__(self, "third_of", expression.third)
        elif not callable(self.f):
            raise InputError("A function must be a callable f(x, y) or an expression in x and y.")

    @property
    def size(self) -> str:
        return "function"

    @property
    def smooth(self) -> bool:
        return True

    def on(self, domain: shapely.Geometry) -> Function:
        """The same function, its differences kept inside the box of ``domain``."""
        xmin, ymin, xmax, ymax = (float(v) for v in shapely.bounds(domain))
        return replace(self, f=self.f, box=(xmin, ymin, xmax, ymax))

    def value(self, x: Array, y: Array) -> Array:
        """(n,) heights.

        Raises
        ------
        InputError
            The callable does not take arrays, or gives back another number of values.
        """
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        assert callable(self.f)
        with np.errstate(all="ignore"):
            try:
                z = np.asarray(self.f(x, y), float)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"The function failed on arrays x and y ({error}): "
                    "write it with NumPy, or wrap it in numpy.vectorize."
                ) from error
        if z.ndim == 0:
            z = np.full(x.shape, float(z))
        if z.shape != x.shape:
            raise InputError(
                f"The function gave {z.shape} values for {x.shape} points: "
                "it must work elementwise on arrays."
            )
        return z

    def gradient(self, x: Array, y: Array) -> Array:
        """(n, 2) first derivatives."""
        if self.gradient_of is not None:
            return np.asarray(self.gradient_of(x, y), float)
        return stencil_derivatives(self.value, x, y, self.box, 1)

    def hessian(self, x: Array, y: Array) -> Array:
        """(n, 2, 2) second derivatives."""
        if self.hessian_of is not None:
            return np.asarray(self.hessian_of(x, y), float)
        h = stencil_derivatives(self.value, x, y, self.box, 2)
        return np.stack([h[:, [0, 1]], h[:, [1, 2]]], 1)

    def third(self, x: Array, y: Array) -> Array:
        """(n, 4) third derivatives f_xxx, f_xxy, f_xyy, f_yyy."""
        if self.third_of is not None:
            return np.asarray(self.third_of(x, y), float)
        return stencil_derivatives(self.value, x, y, self.box, 3)

    def outline(self, tol: float) -> shapely.Geometry:
        raise InputError(
            "A function has no domain of its own: give domain=(xmin, ymin, xmax, ymax)."
        )

    def span(self, domain: shapely.Geometry) -> tuple[float, float]:
        """Smallest and largest of samples over the domain: its corners and a grid of its box, which
        is finer around the extremes."""
        box = shapely.bounds(domain)
        places, z = self._sampled(domain, box, _GRID, shapely.get_coordinates(domain))
        cell = (box[2:] - box[:2]) / (_GRID - 1)
        extremes = {int(z.argmin()), int(z.argmax())}
        finer = [
            self._sampled(domain, np.append(at - cell, at + cell), _FINER, at[None])[1]
            for at in places[sorted(extremes)]
        ]
        every = np.concatenate([z, *finer])
        return float(every.min()), float(every.max())

    def _sampled(
        self, domain: shapely.Geometry, box: Array, n: int, more: Array
    ) -> tuple[Array, Array]:
        """Those of n x n points of a box that lie in the domain, and ``more``, with f there.

        Raises InputError where f is not finite.
        """
        grid = np.meshgrid(np.linspace(box[0], box[2], n), np.linspace(box[1], box[3], n))
        places = np.stack([a.ravel() for a in grid], 1)
        if not shapely.covers(domain, shapely.box(*box)):
            places = places[shapely.intersects_xy(domain, *places.T)]
        places = np.vstack([places, more])
        z = self.value(*places.T)
        if not np.isfinite(z).all():
            px, py = places[np.flatnonzero(~np.isfinite(z))[0]]
            raise InputError(
                f"The function is not finite at ({px:.6g}, {py:.6g}): "
                "choose a domain on which it is defined."
            )
        return places, z

    def frame(self, domain: shapely.Geometry) -> Frame:
        """Along the longest side of the domain; of several that from whose start, middle and end
        the function is the highest. So a turned copy of both has the same local coordinates."""
        sides = sides_of(domain)
        start, end = sides.corners, sides.corners[sides.following]
        size = np.hypot(*(end - start).T)
        choice = np.flatnonzero(size >= (1.0 - _TIED) * size.max())
        along = (end - start)[choice]
        x, y = np.concatenate([start[choice] + share * along for share in (0.0, 0.5, 1.0)]).T
        heights = np.nan_to_num(self.value(x, y), nan=-np.inf).reshape(3, -1)
        best = np.arange(len(choice))
        for z in heights:
            best = best[z[best] >= z[best].max() - _TIED * np.abs(z).max()]
        side = choice[best[0]]
        return Frame.along(start[side], end[side], sides.corners)

    def kernel(self, domain: shapely.Geometry, tol: float) -> KernelField:
        """Piecewise polynomials within ``tol / 5000`` of f over the domain."""
        frame = self.frame(domain)

        def local(u: Array, v: Array) -> Array:
            points = frame.to_user(np.stack([u, v], 1))
            return self.value(points[:, 0], points[:, 1])

        patches = fit_patches(local, frame.geometry_to_local(domain), _PATCH_SHARE * tol)
        return KernelField(
            PATCHES,
            frame=patches.frame,
            child=patches.child,
            coef=patches.coef,
            kinks=patches.kinks,
        )

    def errors(
        self, points: Array, triangles: IntArray, limit: float = np.inf
    ) -> tuple[Array, Array]:
        """(m,) largest errors and (m,) bounds, from samples of f itself (see ``sampling``)."""
        return sampled_errors(self.value, points, triangles, limit)
