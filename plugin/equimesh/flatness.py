"""Whether a Hessian is a flat metric on a domain: (10), and what (10) cannot see.

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 3.2.
Theorem 1 asks two things of a domain: that Gamma of (10) is zero, and that det H is not. Where
det H vanishes at a point, curvature may be concentrated there although Gamma is zero all around.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import shapely

from equimesh.collocation import Collocation
from equimesh.errors import InputError
from equimesh.fields import Function, as_field
from equimesh.holonomy import Apex, around_holes, around_vertices, around_zeros
from equimesh.net import Net, as_polygon
from equimesh.signature import Signature, signature_over
from equimesh.transport import Derivatives, curvature, gamma, gamma_error

__all__ = ["Flatness", "derivatives_of", "flatness", "flatness_over"]

# A curvature below this, or this share of the terms that cancel in it, is zero to rounding.
_FLAT_TURN = 1e-6
_FLAT_SHARE = 1e-7
_ROUNDING = 1e-14
# A loop that closes to within this is closed.
_CLOSED = 1e-6

Cause = Literal["", "curvature", "sign", "curve", "singular", "apex", "hole"]


@dataclass(frozen=True)
class Flatness:
    """Whether a metric is flat on a domain, and if not, why, where and how much.

    Flat means that one transform y with ``dy1^2 + eps dy2^2 = dx^T H dx`` covers the domain:
    single- valued, and found by (12) whatever the path. It need not be one-to-one: ``Re z^4`` is
    flat around the origin, with ``y = z^2`` times a constant, while ``Re z^3`` is not: there
    ``y = z^(3/2)`` changes sign on the way around. The domain is closed, and a zero of det H on its
    boundary counts like one inside as long as the function goes on beyond the boundary.

    Parameters
    ----------
    flat
        The verdict.
    cause
        Empty where flat; else, in the order in which they are looked for: ``curvature``: Gamma is
        not zero; ``singular``: second derivatives are not finite; ``sign``: det H changes sign, and
        ``curve``: it vanishes, along a curve, across which no transform leads; ``apex``: it
        vanishes, or the function is not smooth, at a point around which (12) does not come back;
        ``hole``: (12) does not come back around a hole of the domain.
    where
        (x, y) of the cause; for a hole, a point inside it. Where flat, the place of ``gamma``.
    amount
        How much, a pure number that is 0 where flat. Of curvature, ``gamma``; of a change of sign,
        the largest value of the rarer sign over the largest of all, and 0 where det H only touches
        zero; of an apex or hole, by how much (12) comes back changed (see ``Apex``).
    gamma
        ``|Gamma|`` where the curvature is largest, times the domain's area over the cube of the
        largest entry of the Hessian: a pure number, the same at every scale.
    share
        The largest part of Gamma's terms that does not cancel, 0 (flat) to 1.
    apexes
        All isolated zeros of det H with the angle around them, whether (12) comes back or not.
    """

    flat: bool
    cause: Cause
    where: tuple[float, float]
    amount: float
    gamma: float
    share: float
    apexes: tuple[Apex, ...] = ()

    @property
    def verdict(self) -> str:
        """``flat`` or ``not flat``."""
        return "flat" if self.flat else "not flat"

    def __str__(self) -> str:
        x, y = self.where
        at = f"({x:.4g}, {y:.4g})"
        if self.cause in ("", "curvature"):
            return f"{self.verdict}: |Gamma| = {self.gamma:.3g} at {at}"
        if self.cause == "singular":
            return f"not flat: the second derivatives are not finite at {at}"
        if self.cause == "sign":
            return f"not flat: det H changes sign near {at}, by {self.amount:.3g} of its size"
        if self.cause == "curve":
            return f"not flat: det H vanishes along a curve through {at}"
        place = "the hole at" if self.cause == "hole" else "the apex"
        angle = next((a.angle for a in self.apexes if a.where == self.where), math.nan)
        total = "" if math.isnan(angle) else f", a total angle of {math.degrees(angle):.4g} degrees"
        return (
            f"not flat: carried around {place} {at}{total}, the transform comes back changed by "
            f"{self.amount:.3g}"
        )


def flatness(source: Any, domain: Any, cells: int = 32) -> Flatness:
    """Judge the metric of a Hessian over a domain, whatever the sign of det H there.

    Flat, on domains where det H has no zero, are quadratics, harmonic functions and all other
    solutions of ``K1 f_xx + K2 f_xy + K3 f_yy = 0``; sums of a function of x and a function of y;
    and homogeneous functions, whose metric is that of a cone and whose apex is the origin.

    Parameters
    ----------
    source
        A callable f(x, y), a text, or a field with third derivatives.
    domain
        (xmin, ymin, xmax, ymax) or a shapely polygon, with holes or without.
    cells
        Samples along the longer side.

    Raises
    ------
    InputError
        Where a callable is not smooth enough to be differentiated.

    Examples
    --------
    >>> flatness("x**3 - 3*x*y**2", (1, 0, 2, 1)).verdict
    'flat'
    >>> flatness("exp(-x**2 - y**2)", (0, 0, 1, 1)).verdict
    'not flat'
    >>> print(flatness("x**3 - 3*x*y**2", (-1, -1, 1, 1)))
    not flat: carried around the apex (0, 0), a total angle of 540 degrees, the transform comes
    back changed by 2
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


def flatness_over(source: Derivatives, net: Net, determinant: Signature | None = None) -> Flatness:
    """The same on a net that exists, whose ``signature_over`` may be known already."""
    at = np.concatenate([net.points, net.anchors])
    hessian, third = source.hessian(*at.T), source.third(*at.T)
    good = np.isfinite(hessian).all(axis=(1, 2)) & np.isfinite(third).all(axis=1)
    if not good.any():
        return _not_flat("singular", at[0], math.inf, math.nan, math.nan)
    at, hessian, third = at[good], hessian[good], third[good]
    largest = float(np.abs(hessian).max())
    size = np.abs(gamma(hessian, third))
    bent, terms = curvature(hessian, third)
    h = np.nan_to_num(source.hessian(*net.anchors.T), posinf=0.0, neginf=0.0)
    root = np.sqrt(np.abs(h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = bent * float(root @ net.areas)
        share = np.nan_to_num(np.where(terms > 0.0, bent / terms, 0.0))
    trust = float(getattr(source, "accuracy", 0.0))
    known = size > gamma_error(hessian, third, max(_ROUNDING, 1e-4 * trust))
    curved = known & (share > max(_FLAT_SHARE, trust)) & ~(turn <= max(_FLAT_TURN, trust))
    # Where rounding is all there is, the place of the largest Gamma says nothing of interest.
    worst = int(np.argmax(np.where(curved, size, 0.0) if curved.any() else size))
    amount = float(size[worst]) * (net.polygon.area / largest**3 if largest > 0.0 else 0.0)
    rest = amount, float(np.where(known, share, 0.0).max())
    if curved.any():
        return _not_flat("curvature", at[worst], amount, *rest)
    determinant = signature_over(source, net) if determinant is None else determinant
    if determinant.fault:
        return _not_flat(determinant.fault, determinant.where, determinant.depth, *rest)

    closed = max(_CLOSED, 10.0 * trust)
    apexes = around_zeros(source, net, determinant.zeros)
    bad = max(apexes, key=lambda a: a.mismatch, default=None)
    if bad is None or not bad.mismatch > closed:
        bad = around_vertices(source, net, closed)
        apexes = apexes if bad is None else (*apexes, bad)
    if bad is not None:
        return _not_flat("apex", bad.where, bad.mismatch, *rest, apexes)
    holes = around_holes(source, net.polygon)
    bad = max(holes, key=lambda a: a.mismatch, default=None)
    if bad is not None and bad.mismatch > closed:
        return _not_flat("hole", bad.where, bad.mismatch, *rest, (*apexes, bad))
    return Flatness(True, "", (float(at[worst, 0]), float(at[worst, 1])), 0.0, *rest, apexes)


def _not_flat(
    cause: Cause,
    where: Any,
    amount: float,
    largest: float,
    share: float,
    apexes: tuple[Apex, ...] = (),
) -> Flatness:
    return Flatness(
        False, cause, (float(where[0]), float(where[1])), amount, largest, share, apexes
    )
