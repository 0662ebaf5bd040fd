"""Where a Hessian may serve as a flat metric: the sign of det H and the curvature (10).

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from equimesh.collocation import Collocation
from equimesh.errors import InputError
from equimesh.fields import Function, as_field
from equimesh.net import Net, as_polygon
from equimesh.transport import Array, Derivatives, curvature, gamma

__all__ = ["Flatness", "derivatives_of", "flatness", "flatness_over", "signature_over"]

# A curvature below this, or this share of the terms that cancel in it, is zero to rounding.
_FLAT_TURN = 1e-6
_FLAT_SHARE = 1e-7


@dataclass(frozen=True)
class Flatness:
    """Whether a metric is flat, from (10).

    Parameters
    ----------
    gamma
        The largest ``|Gamma|`` over the samples, times the domain's area over the cube of the
        largest entry of the Hessian: a pure number, the same at every scale.
    where
        (x, y) where it is attained.
    share
        The largest part of Gamma's terms that does not cancel, 0 (flat) to 1.
    flat
        Whether Gamma is zero to rounding everywhere.
    """

    gamma: float
    where: tuple[float, float]
    share: float
    flat: bool

    @property
    def verdict(self) -> str:
        """``flat`` or ``not flat``."""
        return "flat" if self.flat else "not flat"

    def __str__(self) -> str:
        x, y = self.where
        return f"{self.verdict}: |Gamma| = {self.gamma:.3g} at ({x:.4g}, {y:.4g})"


def flatness(source: Any, domain: Any, cells: int = 32) -> Flatness:
    """Measure (10) over a domain, whatever the sign of det H there.

    Flat are quadratics, harmonic functions and all other solutions of ``K1 f_xx + K2 f_xy + K3 f_yy
    = 0``; sums of a function of x and a function of y; and homogeneous functions, whose metric is
    that of a cone.

    Parameters
    ----------
    source
        A callable f(x, y), a text, or a field with third derivatives.
    domain
        (xmin, ymin, xmax, ymax) or a shapely polygon, with holes or without.
    cells
        Samples along the longer side.

    Examples
    --------
    >>> print(flatness("x**3 - 3*x*y**2", (0, 0, 1, 1)).verdict)
    flat
    >>> print(flatness("exp(-x**2 - y**2)", (0, 0, 1, 1)).verdict)
    not flat
    """
    polygon = as_polygon(domain)
    return flatness_over(derivatives_of(source, polygon), Net.of(polygon, cells))


def derivatives_of(source: Any, domain: shapely.Polygon) -> Derivatives:
    """A source that answers ``hessian`` and ``third`` on a domain: itself, or the field of it."""
    if not hasattr(source, "hessian"):
        source = as_field(source, domain)
    if isinstance(source, Function) and source.third_of is None:
        return Collocation.of(source.value, domain)
    if not hasattr(source, "third"):
        raise InputError(
            "This surface has no third derivatives, which a transform needs: give a function or "
            "an expression."
        )
    return source  # type: ignore[no-any-return]


def flatness_over(source: Derivatives, net: Net) -> Flatness:
    """Measure (10) at the vertices and anchors of a net."""
    at = np.concatenate([net.points, net.anchors])
    hessian, third = source.hessian(at[:, 0], at[:, 1]), source.third(at[:, 0], at[:, 1])
    size = np.abs(gamma(hessian, third))
    bent, terms = curvature(hessian, third)
    h = source.hessian(*net.anchors.T)
    root = np.sqrt(np.abs(h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2))
    turn = bent * float(root @ net.areas)
    with np.errstate(invalid="ignore"):
        share = np.where(terms > 0.0, bent / terms, 0.0)
    trust = float(getattr(source, "accuracy", 0.0))
    curved = np.nan_to_num(share) > max(_FLAT_SHARE, trust)
    curved &= ~(turn <= max(_FLAT_TURN, trust))
    # Where rounding is all there is, the place of the largest Gamma says nothing of interest.
    worst = int(np.nanargmax(np.where(curved, size, 0.0) if curved.any() else size))
    largest = float(np.nanmax(np.abs(hessian)))
    scale = net.polygon.area / largest**3 if largest > 0.0 else 0.0
    return Flatness(
        gamma=float(size[worst] * scale),
        where=(float(at[worst, 0]), float(at[worst, 1])),
        share=float(np.nanmax(np.where(curved, share, 0.0) if curved.any() else share)),
        flat=not bool(curved.any()),
    )


def signature_over(source: Derivatives, net: Net) -> int:
    """The sign of det H, which must be the same everywhere and stay away from zero."""

    def determinant(points: Array) -> Array:
        h = source.hessian(points[:, 0], points[:, 1])
        with np.errstate(invalid="ignore"):
            return np.asarray(h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2)

    at, before = net.points, determinant(net.points)
    sign = np.sign(before[0]) if np.isfinite(before[0]) else 0.0
    bad = ~np.isfinite(before) | (np.sign(before) != sign) | (before == 0.0)
    if bad.any():
        raise _no_signature(at[np.argmax(bad)])
    # Zeros between the samples show where |det H| has local minima: look closer there.
    a, b = net.triangles.ravel(), np.roll(net.triangles, -1, axis=1).ravel()
    lowest = np.abs(before).copy()
    np.minimum.at(lowest, a, np.abs(before[b]))
    np.minimum.at(lowest, b, np.abs(before[a]))
    places = np.flatnonzero(lowest == np.abs(before))
    places = places[np.argsort(np.abs(before[places]), kind="stable")][:32]
    best, value = at[places], np.abs(before[places])
    reach = net.size / 32.0
    grid = np.linspace(-1.0, 1.0, 5)
    star = np.stack([v.ravel() for v in np.meshgrid(grid, grid)], axis=1)
    for _ in range(30):
        around = best[:, None, :] + reach * star
        flat = net.into(around.reshape(-1, 2))
        det = determinant(flat)
        bad = ~np.isfinite(det) | (np.sign(det) != sign)
        if bad.any():
            raise _no_signature(flat[np.argmax(bad)])
        size = np.abs(det).reshape(len(places), -1)
        pick = size.argmin(axis=1)
        best, value = flat.reshape(len(places), -1, 2)[np.arange(len(places)), pick], size.min(1)
        reach *= 0.6
    gone = value <= 1e-9 * np.abs(before[places])
    if gone.any():
        raise _no_signature(best[np.argmax(gone)])
    return int(sign)


def _no_signature(at: Array) -> InputError:
    return InputError(
        f"det H changes sign, vanishes or is not finite near ({at[0]:.6g}, {at[1]:.6g}): a flat "
        "transform needs a domain where it does not, so cut the domain there."
    )
