"""The flat-space transform: coordinates y(x) in which a function's Hessian is diag(1, eps).

E. F. D'Azevedo, "Optimal triangular mesh generation by coordinate transformation", section 3.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import shapely
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError
from equimesh.flatness import Flatness, derivatives_of, flatness_over
from equimesh.holonomy import frame_of
from equimesh.net import Net, as_polygon
from equimesh.signature import Signature, signature_over
from equimesh.transport import Array, Derivatives, carry, christoffel, compose, invert

__all__ = ["FlatMap"]

Symbols = Callable[[Array, Array, Array], Array]


class FlatMap:
    """The transform y(x) with ``dy1^2 + eps dy2^2 = dx^T H dx``, integrated by (12).

    It starts from ``y = 0`` at the origin with the scaled eigenvectors (16), (17) of the Hessian,
    the positive eigenvalue first where they differ in sign, and y keeps the orientation of x.
    A function with a negative definite Hessian is treated as its negative. Where the metric is not
    flat (see ``flatness``) the result depends on the path and ``residual`` says how much.

    Parameters
    ----------
    source
        A callable f(x, y), a text, or a field: anything with ``hessian(x, y) -> (n, 2, 2)`` and
        ``third(x, y) -> (n, 4)`` (fxxx, fxxy, fxyy, fyyy).
    domain
        (xmin, ymin, xmax, ymax) or a shapely polygon, with holes or without.
    origin
        (x, y) where the integration starts; the domain's middle unless given.

    Raises
    ------
    InputError
        Where det H changes sign or vanishes on the domain, or the origin lies outside.

    Examples
    --------
    >>> flat_map = FlatMap("2*x**2 - y**2/2", (0, 0, 1, 1), origin=(0, 0))
    >>> y1, y2 = flat_map.forward(0.5, 0.5)
    >>> round(float(y1), 12), round(float(y2), 12)
    (1.0, 0.5)
    >>> flat_map.inverse(1.0, 0.5)[0].round(12)
    np.float64(0.5)
    """

    def __init__(self, source: Any, domain: Any, origin: tuple[float, float] | None = None) -> None:
        self.domain: shapely.Polygon = as_polygon(domain)
        self.given = source
        self.source: Derivatives = derivatives_of(source, self.domain)
        self._net = Net.of(self.domain)
        self._determinant: Signature = signature_over(self.source, self._net)
        if not self._determinant.regular:
            x, y = self._determinant.irregular
            raise InputError(
                f"det H changes sign, vanishes or is not finite near ({x:.6g}, {y:.6g}), where no "
                "flat transform leads across: cut the domain there, or use remesh."
            )
        self.signature: int = self._determinant.sign
        if origin is None:
            middle = self.domain.centroid
            inside = middle if self.domain.contains(middle) else self.domain.representative_point()
            origin = (inside.x, inside.y)
        self.origin: tuple[float, float] = (float(origin[0]), float(origin[1]))
        self._root = int(self._net.locate(np.array([self.origin]))[0])
        if self._root < 0:
            raise InputError(
                f"The origin ({origin[0]:g}, {origin[1]:g}) lies outside the domain: choose a "
                "point inside."
            )

    @property
    def start(self) -> Array:
        """(2, 2) Jacobian at the origin: the rows are the starting values (16) and (17)."""
        x, y = np.array([self.origin[0]]), np.array([self.origin[1]])
        return frame_of(self.source.hessian(x, y)[0])

    @cached_property
    def flatness(self) -> Flatness:
        """The verdict on the metric, with Gamma of (10) over the domain."""
        return flatness_over(self.source, self._net, self._determinant)

    @cached_property
    def _anchored(self) -> tuple[Array, Array, float, Array]:
        """The y (m, 2) and J (m, 2, 2) of the anchors, the residual and the triangles' y-sizes.

        The propagators to all edge middles come first, at once; paths are products of them."""
        net = self._net
        m = len(net.triangles)
        ends = net.middles.reshape(-1, 2)
        turn, shift = carry(self.source, np.repeat(net.anchors, 3, axis=0), ends)
        out = turn.reshape(m, 3, 2, 2), shift.reshape(m, 3, 2)
        (a, b), (side_a, side_b) = net.links.T, net.sides.T
        there = out[0][a, side_a], out[1][a, side_a]
        back = out[0][b, side_b], out[1][b, side_b]
        forth = compose(there, invert(back))
        reverse = compose(back, invert(there))

        order, entered, before = net.walk(self._root)
        y, jacobian = np.zeros((m, 2)), np.zeros((m, 2, 2))
        first = carry(self.source, np.array([self.origin]), net.anchors[[self._root]])
        jacobian[self._root] = self.start @ first[0][0]
        y[self._root] = self.start @ first[1][0]
        depth = np.zeros(m, dtype=np.int64)
        for i in order[1:]:
            depth[i] = depth[before[i]] + 1
        for level in range(1, int(depth.max()) + 1):
            here = np.flatnonzero(depth == level)
            link, start = entered[here], before[here]
            straight = (a[link] == start)[:, None]
            u = np.where(straight[..., None], forth[0][link], reverse[0][link])
            w = np.where(straight, forth[1][link], reverse[1][link])
            y[here] = y[start] + np.einsum("nij,nj->ni", jacobian[start], w)
            jacobian[here] = jacobian[start] @ u

        steps = np.einsum("nij,nkj->nki", jacobian, out[1])
        radius = 2.0 * np.linalg.norm(steps, axis=2).max(axis=1)
        extent = max(float(np.ptp(y, axis=0).max()), float(radius.max()))
        loop_y = y[a] + np.einsum("nij,nj->ni", jacobian[a], forth[1]) - y[b]
        loop_j = jacobian[a] @ forth[0] - jacobian[b]
        size = np.abs(jacobian[b]).max(axis=(1, 2), initial=0.0)
        residual = max(
            float(np.abs(loop_y).max(initial=0.0)) / extent,
            float((np.abs(loop_j).max(axis=(1, 2)) / size).max(initial=0.0)),
        )
        return y, jacobian, residual, radius

    @property
    def residual(self) -> float:
        """Largest relative difference in y or J between two paths to the same point.

        Over every closed loop of the net, those around holes included. It is zero to rounding
        where the metric is flat and the transform single-valued around the holes."""
        return self._anchored[2]

    @property
    def image_bounds(self) -> tuple[float, float, float, float]:
        """(y1min, y2min, y1max, y2max) of a box that holds the domain's image."""
        image, _, _, radius = self._anchored
        low = (image - radius[:, None]).min(axis=0)
        high = (image + radius[:, None]).max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def forward(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """(y1, y2) at points of any common shape; NaN outside the domain."""
        points, shape = _points(x, y)
        image = self._at(points)[0]
        return image[:, 0].reshape(shape), image[:, 1].reshape(shape)

    def jacobian(self, x: ArrayLike, y: ArrayLike) -> Array:
        """(n, 2, 2) matrices dy/dx: the rows are (u1, u2) of y1 and of y2; NaN outside."""
        return self._at(_points(x, y)[0])[1]

    def inverse(self, y1: ArrayLike, y2: ArrayLike) -> tuple[Array, Array]:
        """(x, y) of points of y-space; NaN where they lie outside the domain's image.

        Newton's method with the exact Jacobian from the nearest anchors; iterates that leave the
        domain are put back on its boundary. Where the image overlaps itself, one of the preimages.
        """
        targets, shape = _points(y1, y2)
        found = np.full(targets.shape, np.nan)
        image, _, _, radius = self._anchored
        able = np.flatnonzero(np.isfinite(targets).all(axis=1))
        count = min(8, len(image))
        distance, anchor = self._image_tree.query(targets[able], k=count)
        distance, anchor = distance.reshape(-1, count), anchor.reshape(-1, count)
        nearness = distance / radius[anchor]
        rank = np.argsort(nearness, axis=1, kind="stable")
        for k in range(count):
            pick = rank[:, k]
            row = np.arange(len(able))
            near = (nearness[row, pick] <= 2.0) & np.isnan(found[able, 0])
            if not near.any():
                break
            which = able[near]
            found[which] = self._newton(targets[which], anchor[row, pick][near])
        return found[:, 0].reshape(shape), found[:, 1].reshape(shape)

    def along(self, path: ArrayLike, symbols: Symbols = christoffel) -> tuple[Array, Array]:
        """The y (2,) and J (2, 2) at the end of a polyline that starts at the origin.

        (12) as it stands, by scipy's Runge-Kutta method of order 8 with variable steps; with
        ``symbols=harmonic_christoffel`` the short form (13). Independent of ``forward``.

        Parameters
        ----------
        path
            (k, 2) corners after the origin, such as ``[(x1, b), (x1, x2)]`` for (14), (15). The
            function must be defined along it; the domain does not matter.
        symbols
            The Christoffel symbols, ``christoffel`` or ``harmonic_christoffel``.
        """
        state = np.concatenate([np.zeros(2), self.start.ravel()])
        corners = np.vstack([self.origin, np.asarray(path, dtype=np.float64).reshape(-1, 2)])
        for p, q in itertools.pairwise(corners):
            step = (q - p)[None]

            def rate(t: float, s: Array, p: Array = p, step: Array = step) -> Array:
                at = p + t * step
                x, y = at[:, 0], at[:, 1]
                symbol = symbols(self.source.hessian(x, y), self.source.third(x, y), step)[0]
                jacobian = s[2:].reshape(2, 2)
                return np.concatenate([jacobian @ step[0], (jacobian @ symbol).ravel()])

            size = float(np.abs(state).max())
            solution = scipy.integrate.solve_ivp(
                rate, (0.0, 1.0), state, method="DOP853", rtol=1e-13, atol=1e-15 * size
            )
            if not solution.success:
                raise InputError(
                    "The transform cannot be integrated along this path, where det H vanishes: "
                    "choose a path away from it."
                )
            state = solution.y[:, -1]
        return state[:2], state[2:].reshape(2, 2)

    @cached_property
    def _image_tree(self) -> Any:
        return scipy.spatial.cKDTree(self._anchored[0])

    def _at(self, points: Array) -> tuple[Array, Array]:
        """The y (n, 2) and J (n, 2, 2), each carried from the anchor that the point sees."""
        image, jacobian, _, _ = self._anchored
        y, j = np.full(points.shape, np.nan), np.full((len(points), 2, 2), np.nan)
        triangle = self._net.locate(points)
        inside = np.flatnonzero(triangle >= 0)
        if inside.size:
            at = triangle[inside]
            turn, shift = carry(self.source, self._net.anchors[at], points[inside])
            y[inside] = image[at] + np.einsum("nij,nj->ni", jacobian[at], shift)
            j[inside] = jacobian[at] @ turn
        return y, j

    def _newton(self, targets: Array, anchor: NDArray[np.int64]) -> Array:
        """(n, 2) preimages, NaN where the iteration ends elsewhere."""
        image, jacobians, _, _ = self._anchored
        size, rounding = self._net.size, 8e-16 * float(np.abs(image).max())
        answer = np.full(targets.shape, np.nan)
        rows = np.arange(len(targets))
        x, y, j = self._net.anchors[anchor], image[anchor], jacobians[anchor]
        share, pinned = np.ones(len(targets)), np.zeros(len(targets), dtype=np.int64)
        for _ in range(60):
            miss = targets[rows] - y
            step = np.linalg.solve(j, miss[:, :, None])[:, :, 0]
            length = np.linalg.norm(step, axis=1)
            distance = np.linalg.norm(miss, axis=1)
            done = (length <= 1e-13 * size) | (distance <= rounding)
            answer[rows[done]] = x[done]
            step *= np.minimum(1.0, 0.25 * size / np.maximum(length, 1e-300))[:, None]
            wish = x + share[:, None] * step
            new = self._net.into(wish)
            # Towards a target outside, iterates are put back again and again and creep along the
            # boundary; towards one inside, this happens once or twice.
            pinned += (new != wish).any(axis=1)
            go = ~(done | (pinned > 4) | (share < 1e-3))
            if not go.any():
                break
            rows, share, pinned, new = rows[go], share[go], pinned[go], new[go]
            x, y, j, distance = x[go], y[go], j[go], distance[go]
            new_y, new_j = self._at(new)
            better = np.linalg.norm(targets[rows] - new_y, axis=1) < distance
            x = np.where(better[:, None], new, x)
            y = np.where(better[:, None], new_y, y)
            j = np.where(better[:, None, None], new_j, j)
            share = np.where(better, np.minimum(1.0, 4.0 * share), 0.25 * share)
        return answer


def _points(x: ArrayLike, y: ArrayLike) -> tuple[Array, tuple[int, ...]]:
    a, b = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    return np.stack([a.ravel(), b.ravel()], axis=1), a.shape
