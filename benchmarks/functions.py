"""Eight test functions with exact Hessians, and the least number of triangles that each needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["FUNCTIONS", "Case"]

Array = np.ndarray
Jet = tuple[Array | float, ...]  # value, x, y, xx, xy, yy

CONVEX, SADDLE = 3 * 3**0.5 / 4, 5**0.5  # area in the metric that a triangle of error 1 can have


@dataclass(frozen=True)
class Case:
    """A function with the rectangle ``box`` (xmin, ymin, xmax, ymax) and its tolerances.

    ``jet`` gives value, f_x, f_y, f_xx, f_xy, f_yy; gradients that nobody needs are left out as 0.
    """

    name: str
    jet: Callable[[Array, Array], Jet]
    tolerances: tuple[float, ...]
    box: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)

    def __call__(self, x: Array, y: Array) -> Array:
        return np.asarray(self.jet(np.asarray(x, float), np.asarray(y, float))[0])

    def least(self, tol: float, cells: int = 1500) -> float:
        """N*: the integral of sqrt|det(H / 2)| / (C tol) by the midpoint rule."""
        xmin, ymin, xmax, ymax = self.box
        t = (np.arange(cells) + 0.5) / cells
        total = 0.0
        for y in ymin + (ymax - ymin) * t:
            x = xmin + (xmax - xmin) * t
            xx, xy, yy = self.jet(x, np.full(cells, y))[3:]
            det = 0.25 * (xx * yy - xy * xy)
            total += float((np.sqrt(np.abs(det)) / np.where(det > 0.0, CONVEX, SADDLE)).sum())
        return total * (xmax - xmin) * (ymax - ymin) / cells**2 / tol


def _times_exp(p: Jet, q: Jet) -> Jet:
    """The jet of p exp(q)."""
    v, x, y, xx, xy, yy = p
    w, a, b, aa, ab, bb = q
    e = np.exp(w)
    return (
        v * e,
        (x + v * a) * e,
        (y + v * b) * e,
        (xx + 2 * x * a + v * (aa + a * a)) * e,
        (xy + x * b + y * a + v * (ab + a * b)) * e,
        (yy + 2 * y * b + v * (bb + b * b)) * e,
    )


def _sum(*jets: Jet) -> Jet:
    return tuple(sum(parts) for parts in zip(*jets, strict=True))


def _constant(c: float) -> Jet:
    return (c, 0.0, 0.0, 0.0, 0.0, 0.0)


def _bowl(x: Array, y: Array, a: float, b: float) -> Jet:
    """-a x^2 - b y^2 with its derivatives."""
    return (-a * x * x - b * y * y, -2 * a * x, -2 * b * y, -2 * a, 0.0, -2 * b)


def _wave(x: Array, y: Array) -> Jet:
    e, s, c = np.exp(5 * x), np.sin(5 * y), np.cos(5 * y)
    return e * s, 5 * e * s, 5 * e * c, 25 * e * s, 25 * e * c, -25 * e * s


def _pole(power: int, stretch: float) -> Callable[[Array, Array], Jet]:
    """Re 1 / (z - z0)^power at z = x + i stretch y, z0 = 1/2 - i/5."""

    def jet(x: Array, y: Array) -> Jet:
        w = 1.0 / (x - 0.5 + 1j * (stretch * y + 0.2))
        d1, d2 = -power * w ** (power + 1), power * (power + 1) * w ** (power + 2)
        first = (w**power).real, d1.real, -stretch * d1.imag
        return *first, d2.real, -stretch * d2.imag, -(stretch**2) * d2.real

    return jet


def _convex(x: Array, y: Array) -> Jet:
    e, u = np.exp(2 * x + y), x - 2 * y
    return e + u * u, 2 * e + 2 * u, e - 4 * u, 4 * e + 2, 2 * e - 4, e + 8


def _franke(x: Array, y: Array) -> Jet:
    u, v = 9 * x, 9 * y
    ramp = _bowl(u + 1, v + 1, 1 / 49, 0.0)
    ramp = (ramp[0] - (v + 1) / 10, ramp[1], ramp[2] - 0.1, *ramp[3:])
    f = _sum(
        _times_exp(_constant(0.75), _bowl(u - 2, v - 2, 0.25, 0.25)),
        _times_exp(_constant(0.75), ramp),
        _times_exp(_constant(0.5), _bowl(u - 7, v - 3, 0.25, 0.25)),
        _times_exp(_constant(-0.2), _bowl(u - 4, v - 7, 1.0, 1.0)),
    )
    return tuple(part * 9.0**order for part, order in zip(f, (0, 1, 1, 2, 2, 2), strict=True))


def _layer(x: Array, y: Array) -> Jet:
    turn = 2 * np.pi
    t = np.tanh(20 * (x - 0.5 + 0.2 * np.sin(turn * y)))
    slope, bend = 1 - t * t, -2 * t * (1 - t * t)
    a, b, bb = 20.0, 4 * turn * np.cos(turn * y), -4 * turn**2 * np.sin(turn * y)
    return t, slope * a, slope * b, bend * a * a, bend * a * b, bend * b * b + slope * bb


def _peaks(x: Array, y: Array) -> Jet:
    zero, xx, yy = np.zeros_like(x), x * x, y * y  # powers of negative numbers take long
    hill = (3 * (1 - x) ** 2, -6 * (1 - x), zero, 6.0, 0.0, 0.0)
    middle = (
        10 * x * xx + 10 * y * yy * yy - 2 * x, 30 * xx - 2, 50 * yy * yy,
        60 * x, zero, 200 * y * yy,
    )  # fmt: skip
    return _sum(
        _times_exp(hill, _bowl(x, y + 1, 1.0, 1.0)),
        _times_exp(middle, _bowl(x, y, 1.0, 1.0)),
        _times_exp(_constant(-1 / 3), _bowl(x + 1, y, 1.0, 1.0)),
    )


FUNCTIONS = (
    Case("exp(5x) sin(5y)", _wave, (0.1379, 0.0664, 0.0539)),
    Case("Re 1/(z - z0)^2", _pole(2, 1.0), (0.0468, 0.0201)),
    Case("Re 1/(z - z0)^4", _pole(4, 1.0), (2.0, 0.5)),
    Case("Re 1/(z - z0)^2, y times sqrt(10)", _pole(2, 10**0.5), (0.1246, 0.0317)),
    Case("exp(2x + y) + (x - 2y)^2", _convex, (1e-2, 1e-3)),
    Case("Franke", _franke, (5e-3, 1e-3)),
    Case("tanh layer", _layer, (1e-2, 2e-3)),
    Case("peaks", _peaks, (0.05, 0.01), (-3.0, -3.0, 3.0, 3.0)),
)
