"""The sign of det H over a domain, and the places where Theorem 1 of the paper does not hold.

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 3.2: a
symmetric tensor can only be reduced to constants where its determinant is not zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from equimesh.net import Net
from equimesh.transport import Array, Derivatives

__all__ = ["Signature", "circle", "loops", "rounding_of", "signature_over"]

_MOST_PLACES = 32
_STEPS = 400
# "Circles" about a point, in shares of the domain's width and height, that tell a zero from a small
# value, and those that are tried to see what surrounds it.
_NEAR, _LESS_NEAR = 1e-10, 1e-7
_RADII = (1e-3, 1e-2, 3e-2, 1e-1)
_TOUCHES = 1e-10


@dataclass(frozen=True, eq=False)
class Signature:
    """What det H does on a closed domain.

    Parameters
    ----------
    sign
        +1 or -1; 0 where there is a ``fault``.
    fault
        ``sign``: det H changes sign; ``curve``: it vanishes along a curve or everywhere;
        ``singular``: it is not finite somewhere; empty: none of these.
    where
        (x, y) of the fault.
    depth
        Of a change of sign: the largest value of the rarer sign, as a share of the largest of all.
    zeros
        (k, 2) isolated zeros of det H, in the domain or on its boundary.
    """

    sign: int
    fault: Literal["", "sign", "curve", "singular"]
    where: tuple[float, float]
    depth: float
    zeros: Array

    @property
    def regular(self) -> bool:
        """Whether Theorem 1 holds on all of the domain."""
        return not self.fault and len(self.zeros) == 0

    @property
    def irregular(self) -> tuple[float, float]:
        """(x, y) of a place where it does not hold; NaN where it does everywhere."""
        if self.fault or len(self.zeros) == 0:
            return self.where
        return float(self.zeros[0, 0]), float(self.zeros[0, 1])


def signature_over(source: Derivatives, net: Net) -> Signature:
    """Sample det H at the vertices and anchors of a net and look closer where it is extreme."""
    at = np.concatenate([net.points, net.anchors])
    det, size = _measure(source, at)
    bad = ~np.isfinite(det)
    if bad.any():
        return _fault("singular", at[np.argmax(bad)], np.inf)
    largest = float(size.max())
    noise = rounding_of(source) * largest
    clear = np.abs(det) > noise * size
    if not clear.any():
        return _fault("curve", at[np.argmin(np.abs(det))], 0.0)
    up, down = clear & (det > 0.0), clear & (det < 0.0)
    if up.any() and down.any():
        depth = min(float(det[up].max()), float(-det[down].min())) / float(np.abs(det).max())
        first, second = _opposites(net, np.where(clear, det, 0.0))
        return _fault("sign", _crossing(source, net, at[first], at[second]), depth)
    sign = 1 if up.any() else -1
    return _closer(source, net, sign, float(np.abs(det).max()), noise)


def _closer(source: Derivatives, net: Net, sign: int, height: float, noise: float) -> Signature:
    """Zeros and poles between the samples show where |det H| has local extrema."""

    def low(points: Array) -> Array:
        det = sign * _measure(source, points)[0]
        return np.where(np.isfinite(det), det, np.inf)

    def high(points: Array) -> Array:
        det = sign * _measure(source, points)[0]
        return np.where(np.isfinite(det), -det, -np.inf)

    start = _extreme(net, low(net.points))
    lowest, value = _descend(low, start, net)
    below = value < -noise * _measure(source, lowest)[1]
    if below.any():
        worst = int(np.argmin(value))
        where = _crossing(source, net, start[worst], lowest[worst])
        return _fault("sign", where, float(-value[worst]) / height)
    peaks, _ = _descend(high, _extreme(net, high(net.points)), net)
    poles = ~np.isfinite(high(peaks))
    near, less = (_around(source, peaks, r * net.extent) for r in (_NEAR, _LESS_NEAR))
    poles |= near.max(axis=1) > 2.0 * less.max(axis=1)
    if poles.any():
        return _fault("singular", _tidy(peaks[np.argmax(poles)], net.extent), np.inf)

    near, less = (_around(source, lowest, r * net.extent) for r in (_NEAR, _LESS_NEAR))
    gone = near.max(axis=1) <= 0.5 * less.max(axis=1)
    # Polynomials in powers of x and y meet their own rounding before they reach a zero.
    gone |= np.ptp(less, axis=1) > 0.5 * less.max(axis=1)
    zeros = _distinct(_tidy(lowest[gone], net.extent), 1e-6 * net.extent)
    for k, zero in enumerate(zeros):
        fault, depth = _surroundings(source, zero, loops(source, net, zeros, k)[0], sign)
        if fault:
            return _fault(fault, zero, depth)
    return Signature(sign, "", (np.nan, np.nan), 0.0, zeros)


def rounding_of(source: Derivatives) -> float:
    """Second derivatives below this share of their largest are rounding."""
    return max(1e-12, 1e-5 * float(getattr(source, "accuracy", 0.0)))


def circle(middle: Array, radius: Array, count: int) -> Array:
    """(count, 2) points of an ellipse with half-axes (2,), counter-clockwise."""
    angle = 2.0 * np.pi * (np.arange(count) + 0.25) / count
    return np.asarray(middle + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def loops(source: Derivatives, net: Net, zeros: Array, k: int) -> list[Array]:
    """(2,) half-axes of ellipses about a zero that hold no other, where H is above rounding.

    The narrowest first; the widest whatever H may be on it."""
    largest = float(_measure(source, np.concatenate([net.points, net.anchors]))[1].max())
    room = np.linalg.norm((zeros - zeros[k]) / net.extent, axis=1)
    room[k] = np.inf
    shares = np.unique(np.minimum(_RADII, 0.45 * float(room.min())))
    sizes = [_measure(source, circle(zeros[k], s * net.extent, 32))[1] for s in shares]
    clear = [bool(np.nanmax(z, initial=0.0) > rounding_of(source) * largest) for z in sizes]
    clear[-1] = True
    return [s * net.extent for s, good in zip(shares, clear, strict=True) if good]


def _measure(source: Derivatives, at: Array) -> tuple[Array, Array]:
    """(n,) det H and (n,) largest entry of H."""
    h = source.hessian(*at.T)
    with np.errstate(invalid="ignore", over="ignore"):
        return h[:, 0, 0] * h[:, 1, 1] - h[:, 0, 1] ** 2, np.abs(h).max(axis=(1, 2))


def _around(source: Derivatives, middles: Array, radius: Array) -> Array:
    """(k, 16) |det H| on ellipses; where it is not defined, the largest on the same one."""
    at = np.concatenate([circle(m, radius, 16) for m in middles])
    det = np.abs(_measure(source, at)[0]).reshape(-1, 16)
    det[~np.isfinite(det)] = -1.0
    highest = np.maximum(det.max(axis=1, keepdims=True), 0.0)
    return np.asarray(np.where(det < 0.0, highest, det))


def _tidy(points: Array, extent: Array) -> Array:
    """Coordinates without the digits that a search cannot know."""
    unit = np.power(10.0, np.ceil(np.log10(extent)) - 12.0)
    return np.asarray(np.round(points / unit) * unit + 0.0)


def _extreme(net: Net, value: Array) -> Array:
    """(k, 2) vertices where a value is lowest among its neighbours, the lowest first."""
    a, b = net.triangles.ravel(), np.roll(net.triangles, -1, axis=1).ravel()
    lowest = value.copy()
    np.minimum.at(lowest, a, value[b])
    np.minimum.at(lowest, b, value[a])
    places = np.flatnonzero(lowest == value)
    return net.points[places[np.argsort(value[places], kind="stable")][:_MOST_PLACES]]


def _descend(value: Callable[[Array], Array], start: Array, net: Net) -> tuple[Array, Array]:
    """Compass search inside the domain, to rounding where the value keeps falling."""
    angle = 0.25 * np.pi * np.arange(8)
    compass = net.extent * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reach = 1.0 / 32.0
    x, v = start.copy(), value(start)
    first, step = v.copy(), np.full(len(start), reach)
    open_ = np.arange(len(start))
    for _ in range(_STEPS):
        if not open_.size:
            break
        trial = x[open_, None] + step[open_, None, None] * compass
        trial = net.into(trial.reshape(-1, 2))
        height = value(trial).reshape(-1, 8)
        pick, row = height.argmin(axis=1), np.arange(len(open_))
        better = height[row, pick] < v[open_]
        x[open_[better]] = trial.reshape(-1, 8, 2)[row, pick][better]
        v[open_[better]] = height[row, pick][better]
        step[open_[~better]] *= 0.5
        # A plain extremum: the value has settled far from zero and from infinity.
        plain = np.abs(v - first) <= 0.5 * np.abs(first)
        done = (step < 1e-15) | ((step < 1e-4 * reach) & plain & (v != 0.0))
        open_ = open_[~(done | ~np.isfinite(v) | (v == 0.0))[open_]]
    return x, v


def _opposites(net: Net, det: Array) -> tuple[int, int]:
    """Two samples of opposite sign, of one triangle if there are any: the clearest pair."""
    anchor = len(net.points) + np.arange(len(net.triangles))
    a = np.concatenate([net.triangles.ravel(), net.triangles.ravel()])
    b = np.concatenate([np.roll(net.triangles, -1, axis=1).ravel(), np.repeat(anchor, 3)])
    gap = np.where(det[a] * det[b] < 0.0, np.minimum(np.abs(det[a]), np.abs(det[b])), 0.0)
    best = int(np.argmax(gap))
    if gap[best] > 0.0:
        return int(a[best]), int(b[best])
    return int(np.argmax(det)), int(np.argmin(det))


def _crossing(source: Derivatives, net: Net, a: Array, b: Array) -> Array:
    """A point of the domain where det H changes sign, near the segment from a to b."""
    before = _measure(source, a[None])[0][0]
    for _ in range(60):
        middle = 0.5 * (a + b)
        det = _measure(source, middle[None])[0][0]
        if np.sign(det) == np.sign(before):
            a = middle
        else:
            b = middle
    return np.asarray(net.into(b[None])[0])


def _distinct(points: Array, room: Array) -> Array:
    """The points without those that lie within ``room`` (2,) of an earlier one."""
    kept: list[Array] = []
    for p in points:
        if all((np.abs(p - q) > room).any() for q in kept):
            kept.append(p)
    return np.array(kept).reshape(-1, 2)


def _surroundings(
    source: Derivatives, zero: Array, radius: Array, sign: int
) -> tuple[Literal["", "sign", "curve"], float]:
    """Whether a curve of zeros passes through a zero, from det H on a circle about it."""

    def height(angle: Array) -> Array:
        at = zero + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return sign * _measure(source, at)[0]

    count = 96
    angle = 2.0 * np.pi * (np.arange(count) + 0.25) / count
    det = height(angle)
    known: NDArray[np.bool_] = np.isfinite(det)
    if not known.any():
        return "", 0.0
    largest = float(np.abs(det[known]).max())
    least = float(det[known].min())
    if least < -1e-9 * largest:
        return "sign", -least / largest
    here = np.where(known, det, np.inf)
    lows = np.flatnonzero((here <= np.roll(here, 1)) & (here <= np.roll(here, -1)) & known)
    gap, golden = 2.0 * np.pi / count, 0.5 * (np.sqrt(5.0) - 1.0)
    low, high = angle[lows] - gap, angle[lows] + gap
    for _ in range(60):
        p, q = high - golden * (high - low), low + golden * (high - low)
        left = np.abs(height(p)) < np.abs(height(q))
        low, high = np.where(left, low, p), np.where(left, q, high)
    bottom = np.fmin(np.abs(height(0.5 * (low + high))), here[lows])
    return ("curve", 0.0) if (bottom <= _TOUCHES * largest).any() else ("", 0.0)


def _fault(fault: Literal["sign", "curve", "singular"], where: Array, depth: float) -> Signature:
    return Signature(0, fault, (float(where[0]), float(where[1])), depth, np.zeros((0, 2)))
