"""The border of a triangle surface as polygons, exact or simplified within a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.compiled import allocating
from equimesh.fields.surface_repair import Graph, place
from equimesh.fields.surface_topology import opposites, trace_rings

__all__ = ["Border"]

Flags = NDArray[np.bool_]
Sag = Callable[[Array, Array], Array]

_SAFETY = 0.9  # of the tolerance, between a border's vertices and chords
_LIMIT = 0.98  # the same for chords whose nodes may move up or down to the surface
_HALVINGS = 30  # after so many a ring is kept as it is


@dataclass(frozen=True, eq=False)
class Border:
    """Simple rings around the surface, the surface on their left, sorted by piece.

    Rings meet at single vertices at most. The first ring of a piece goes around it, the others are
    its holes.
    """

    points: Array  # (n, 3): vertices of the surface
    rings: tuple[IntArray, ...]  # vertex numbers, the first not repeated
    piece: IntArray  # (rings,): ascending

    @classmethod
    def of(cls, graph: Graph) -> Border:
        """Trace the border; InputError where it shows that parts of the surface overlap.

        If the rings are simple and neither cross nor hold one another but as holes, then their
        winding numbers add up to one on the surface and to zero elsewhere, which is the number of
        triangles over a point: the surface is a graph if and only if its border is valid.
        """
        chains = trace_rings(graph.triangles, opposites(graph.triangles))
        loops: list[IntArray] = []
        piece: list[int] = []
        for k, triangle in enumerate(chains.triangle):
            chain = chains.vertices[chains.start[k] : chains.start[k + 1]]
            for loop in _simple_loops(chain):
                loops.append(loop)
                piece.append(int(graph.component[triangle]))
        area = np.array([_area(graph.points[loop]) for loop in loops])
        order = np.lexsort((-area, np.array(piece)))
        pieces = np.array(piece)[order]
        outer = np.diff(pieces, prepend=-1) != 0
        # a ring without width is a crack, where vertices of one side hang on edges of the other
        size = float(np.ptp(graph.points[:, :2], axis=0).max())
        crack = ~outer & (np.abs(area[order]) <= 1e-12 * size * size)
        border = cls(graph.points, tuple(loops[k] for k in order[~crack]), pieces[~crack])
        turned = ((area[order] > 0.0) != outer) & ~crack
        if not turned.any() and not border.exact.is_valid:
            border = border._joined(1e-7 * size)
        if turned.any() or not border.exact.is_valid:
            raise InputError(
                f"The surface is no graph: parts of it lie over one another ({_overlap(graph)}); "
                "give up= another direction or split the surface."
            )
        return border

    def _joined(self, gap: float) -> Border:
        """Pieces side by side, joined where they lie within ``gap`` without sharing vertices.

        The border as it was if the pieces do more than touch.
        """
        parts = shapely.get_parts(self.exact)
        union = shapely.unary_union(shapely.make_valid(parts), grid_size=gap)
        along = shapely.length(self.exact)
        if shapely.area(union) < shapely.area(parts).sum() - gap * along:
            return self
        union = shapely.orient_polygons(union)
        rings: list[IntArray] = []
        piece: list[int] = []
        tree = scipy.spatial.cKDTree(self.points[np.concatenate(self.rings), :2])
        for number, part in enumerate(shapely.get_parts(union)):
            for ring in shapely.get_rings(part):
                distance, near = tree.query(shapely.get_coordinates(ring)[:-1])
                if distance.max() > 2.0 * gap:
                    return self
                rings.append(np.concatenate(self.rings)[near])
                piece.append(number)
        return Border(self.points, tuple(rings), np.array(piece))

    @cached_property
    def exact(self) -> shapely.Geometry:
        """Every border vertex, as Polygon or MultiPolygon."""
        return self._polygons(self.rings)

    def simplified(self, tol: float, sag: Sag | None = None) -> shapely.Geometry:
        """Rings with fewer vertices, each border vertex within ``tol`` of its ring in space.

        Vertices where rings meet stay. Where a simplified ring would cross itself or others,
        swallow one or lose its area, its tolerance is halved until it does not.

        ``sag(a, b)`` tells how far the surface falls below and rises above the chords from a to b,
        (n, 2), zero included. With it the border also stays within ``tol`` of chords that nodes on
        the surface divide: whatever nodes, the chord moves within its sag.
        """
        shared = np.bincount(np.concatenate(self.rings), minlength=len(self.points)) > 1
        halvings = np.zeros(len(self.rings), np.int64)
        rings = list(self.rings)
        changed = np.arange(len(rings)) if tol > 0.0 else np.zeros(0, np.int64)
        while len(changed):
            for k in changed:
                ring = self.rings[k]
                if halvings[k] < _HALVINGS:
                    within = tol * 0.5 ** halvings[k]
                    ring = ring[_reduced(self.points[ring], shared[ring], within, sag)]
                rings[k] = ring
            changed = self._to_blame(rings)
            changed = changed[halvings[changed] < _HALVINGS]
            halvings[changed] += 1
        outline = self._polygons(rings)
        return outline if outline.is_valid else self.exact

    def _to_blame(self, rings: Sequence[IntArray]) -> IntArray:
        """Numbers of the rings that make an outline unlike the exact border; none if it is fine."""
        turned = np.array([_area(self.points[ring]) for ring in rings]) * self._sign <= 0.0
        if turned.any():
            return np.flatnonzero(turned)
        filled = _filled(self.points, rings)
        crossed = ~shapely.is_valid(filled)
        if crossed.any():
            return np.flatnonzero(crossed)
        differ = _relations(filled) ^ self._relations
        if differ:
            return np.unique([pair[:2] for pair in differ])
        outline = self._polygons(rings)
        if outline.is_valid:
            return np.zeros(0, np.int64)
        # what is left: rings that share an edge, or meet at vertices where they did not
        touching = np.zeros(len(rings), bool)
        touching[np.unique(shapely.STRtree(filled).query(filled, "touches"))] = True
        return np.flatnonzero(touching) if touching.any() else np.arange(len(rings))

    @property
    def outer(self) -> Flags:
        """(rings,) which go around a piece; the others are holes."""
        return np.asarray(np.diff(self.piece, prepend=-1) != 0)

    @cached_property
    def _sign(self) -> Array:
        """(rings,) 1 for outer rings, -1 for holes."""
        return np.where(self.outer, 1.0, -1.0)

    @cached_property
    def _relations(self) -> set[tuple[int, int, str]]:
        return _relations(_filled(self.points, self.rings))

    def _polygons(self, rings: Sequence[IntArray]) -> shapely.Geometry:
        loops = _loops(self.points, rings)
        first = np.flatnonzero(self._sign > 0.0)
        last = np.append(first[1:], len(rings))
        parts = [
            shapely.Polygon(loops[i], loops[i + 1 : j]) for i, j in zip(first, last, strict=True)
        ]
        return parts[0] if len(parts) == 1 else shapely.multipolygons(parts)


def _simple_loops(chain: IntArray) -> list[IntArray]:
    """Split a closed chain that passes vertices more than once into loops that do not."""
    if len(np.unique(chain)) == len(chain):
        return [chain]
    loops: list[IntArray] = []
    path: list[int] = []
    place: dict[int, int] = {}
    for vertex in chain.tolist():
        if vertex in place:
            loop = path[place[vertex] :]
            loops.append(np.array(loop))
            for passed in loop:
                del place[passed]
            del path[-len(loop) :]
        place[vertex] = len(path)
        path.append(vertex)
    return [*loops, np.array(path)]


def _area(ring: Array) -> float:
    """Signed, in projection."""
    x, y = (ring[:, :2] - ring[0, :2]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _loops(points: Array, rings: Sequence[IntArray]) -> Any:
    """(rings,) shapely LinearRings in projection."""
    number = np.repeat(np.arange(len(rings)), [len(ring) for ring in rings])
    return shapely.linearrings(points[np.concatenate(rings), :2], indices=number)


def _filled(points: Array, rings: Sequence[IntArray]) -> Any:
    """(rings,) shapely Polygons without holes."""
    return shapely.polygons(_loops(points, rings))


def _relations(filled: Any) -> set[tuple[int, int, str]]:
    """Pairs (i, j) of rings whose insides meet: i holds j, or they cross."""
    shapely.prepare(filled)
    i, j = shapely.STRtree(filled).query(filled, "intersects")
    i, j = i[i < j], j[i < j]
    a, b = filled[i], filled[j]
    holds, held, apart = shapely.covers(a, b), shapely.covered_by(a, b), shapely.touches(a, b)
    kind = np.select([apart, holds, held], ["", "holds", "held"], "cross")
    rows = zip(i.tolist(), j.tolist(), kind.tolist(), strict=True)
    return {row for row in rows if row[2]}


def _overlap(graph: Graph) -> str:
    """How much of a surface lies under or over other parts of it, in words."""
    corners = graph.points[graph.triangles[~graph.flat], :2]
    faces = shapely.polygons(corners)
    middles = shapely.points(corners.mean(axis=1))
    middle, face = shapely.STRtree(faces).query(middles, "within")
    over = np.unique(middle[middle != face])
    if not len(over):
        return "along their borders"
    corners = graph.points[graph.triangles[~graph.flat][over[0]]] @ graph.rotation
    share = 100.0 * len(over) / len(faces)
    return f"{len(over):,} triangles, {share:.2g} %, the first near {place(corners)}"


def _reduced(chain: Array, fixed: Flags, tol: float, sag: Sag | None) -> IntArray:
    """Places (ascending) of the vertices to keep of a closed chain (k, 3) within ``tol``."""
    fixed = fixed.copy()
    while True:
        kept = _simplify(chain, fixed, _SAFETY * tol)
        if sag is None:
            return kept
        following = np.roll(kept, -1)
        span = (following - kept) % len(chain)
        chord = np.repeat(np.arange(len(kept)), span - 1)
        place = np.arange(len(chord)) - np.repeat(np.cumsum(span - 1) - span + 1, span - 1)
        vertex = (kept[chord] + place + 1) % len(chain)
        a, b = chain[kept], chain[following]
        gap = _gaps(chain[vertex], a[chord], b[chord])
        low, high = sag(a, b)[chord].T
        gap[:, 2] = np.maximum(gap[:, 2] - low, high - gap[:, 2])
        far = np.sqrt((gap**2).sum(axis=1))
        bad = np.flatnonzero(far > _LIMIT * tol)
        if not len(bad):
            return kept
        worst = bad[np.lexsort((-far[bad], chord[bad]))]
        fixed[vertex[worst[np.diff(chord[worst], prepend=-1) != 0]]] = True
        fixed[kept] = True


def _gaps(p: Array, a: Array, b: Array) -> Array:
    """(n, 3) from the nearest points of segments a-b to points p."""
    step = b - a
    square = np.maximum((step**2).sum(axis=1), 1e-300)
    s = np.clip(((p - a) * step).sum(axis=1) / square, 0.0, 1.0)
    return np.asarray(p - a - s[:, None] * step)


def _simplify(chain: Array, fixed: Flags, tol: float) -> IntArray:
    """Places (ascending) of the vertices to keep of a closed chain (k, 3)."""
    start = int(np.argmax(fixed)) if fixed.any() else int(np.lexsort(chain.T[::-1])[0])
    chain = np.roll(chain, -start, axis=0)
    keep = np.roll(fixed, -start)
    # three vertices stay, so that the ring keeps an area: the start, ...
    reach = chain - chain[0]
    far = int(np.argmax((reach**2).sum(axis=1)))
    aside = int(np.argmax(np.abs(reach[:, 0] * reach[far, 1] - reach[:, 1] * reach[far, 0])))
    keep[[0, far, aside]] = True
    keep = np.append(keep, True)
    _keep_within(np.vstack([chain, chain[:1]]), tol, keep)
    return np.sort((np.flatnonzero(keep[:-1]) + start) % len(chain))


@allocating
def _keep_within(chain: Array, tol: float, keep: Flags) -> None:
    """Douglas-Peucker: flag vertices until all of the chain (k, 3) lies within ``tol`` of them.

    Those already flagged stay, the two ends among them.
    """
    spans = [(0, 0)]
    spans.pop()
    before = 0
    for k in range(1, len(chain)):
        if keep[k]:
            spans.append((before, k))
            before = k
    while len(spans) > 0:
        i, j = spans.pop()
        worst, at = tol * tol, -1
        for k in range(i + 1, j):
            d = _squared_distance(chain[k], chain[i], chain[j])
            if d > worst:
                worst, at = d, k
        if at >= 0:
            keep[at] = True
            spans.append((i, at))
            spans.append((at, j))


@allocating
def _squared_distance(p: Array, a: Array, b: Array) -> float:
    """Of p to the segment a-b, in space."""
    along, length = 0.0, 0.0
    for k in range(3):
        along += (p[k] - a[k]) * (b[k] - a[k])
        length += (b[k] - a[k]) ** 2
    s = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
    out = 0.0
    for k in range(3):
        out += (p[k] - a[k] - s * (b[k] - a[k])) ** 2
    return out
