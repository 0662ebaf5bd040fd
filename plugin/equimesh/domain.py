"""The domain of a mesh: a polygon with holes, its straight sides and their names."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError

__all__ = ["DomainLike", "Lines", "Sides", "domain_geometry", "sides_of", "strips_of"]

DomainLike: TypeAlias = Sequence[float] | shapely.Geometry | None

_RECTANGLE = ("bottom", "right", "top", "left")


def domain_geometry(domain: DomainLike) -> shapely.Geometry:
    """A rectangle ``(xmin, ymin, xmax, ymax)`` or a shapely polygon as a valid geometry.

    Raises
    ------
    InputError
        Not four finite numbers in order, not a polygon, crossing itself, empty or without area.

    Examples
    --------
    >>> domain_geometry((0, 0, 2, 1)).area
    2.0
    """
    if isinstance(domain, shapely.Geometry):
        geometry = domain
        if geometry.geom_type not in ("Polygon", "MultiPolygon"):
            raise InputError(
                f"The domain is a {geometry.geom_type}: give a Polygon or MultiPolygon."
            )
        if geometry.is_empty:
            raise InputError("The domain is empty: give a polygon with a positive area.")
        if not np.isfinite(shapely.get_coordinates(geometry)).all():
            raise InputError("The domain has coordinates that are not finite: correct them.")
        if not geometry.is_valid:
            reason = shapely.is_valid_reason(geometry)
            raise InputError(
                f"The domain polygon is not valid ({reason}): "
                "rings may not cross and holes must lie inside."
            )
        geometry = shapely.force_2d(geometry)
    else:
        try:
            xmin, ymin, xmax, ymax = (float(v) for v in domain or ())
        except (TypeError, ValueError):
            raise InputError(
                "The domain must be four numbers (xmin, ymin, xmax, ymax) or a shapely Polygon."
            ) from None
        if not all(map(math.isfinite, (xmin, ymin, xmax, ymax))):
            raise InputError("The domain has numbers that are not finite: give finite extents.")
        if not (xmin < xmax and ymin < ymax):
            raise InputError(
                "The domain is empty: xmin must be less than xmax and ymin less than ymax."
            )
        geometry = shapely.box(xmin, ymin, xmax, ymax)
    box = shapely.bounds(geometry)
    extent = max(box[2] - box[0], box[3] - box[1])
    if not geometry.area > 1e-12 * extent * extent:
        raise InputError("The domain has no area: give a polygon with a positive area.")
    return geometry


def _no_points() -> NDArray[np.float64]:
    return np.empty((0, 2))


def _no_pairs() -> NDArray[np.int64]:
    return np.empty((0, 2), np.int64)


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines inside a domain that must be edges of its mesh, and points in it.

    ``nodes`` (n, 2) are inner points that must be vertices; vertices are numbered corners first,
    nodes after them. ``edges`` (e, 2) join them and meet in common ends only. Rows of ``edge_tags``
    (edge, name), ``side_tags`` (side, name) and ``point_tags`` (vertex, name) tell what was asked
    for by which of the ``names``.
    """

    nodes: NDArray[np.float64] = field(default_factory=_no_points)
    edges: NDArray[np.int64] = field(default_factory=_no_pairs)
    edge_tags: NDArray[np.int64] = field(default_factory=_no_pairs)
    side_tags: NDArray[np.int64] = field(default_factory=_no_pairs)
    point_tags: NDArray[np.int64] = field(default_factory=_no_pairs)
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Sides:
    """The straight sides of a domain.

    ``corners`` (k, 2); side i runs from corner ``i`` to corner ``following[i]`` with the domain on
    its left (outer rings counter-clockwise, holes clockwise); ``tags`` (k,) index ``names``;
    ``lines`` are the constraints inside.
    """

    corners: NDArray[np.float64]
    following: NDArray[np.int64]
    tags: NDArray[np.int64]
    names: tuple[str, ...]
    lines: Lines = field(default_factory=Lines)

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(k + n, 2) corners and, after them, the nodes of the lines."""
        return np.vstack([self.corners, self.lines.nodes])

    @property
    def segments(self) -> NDArray[np.float64]:
        """(k + e, 4) ends of the sides and, after them, of the lines."""
        sides = np.hstack([self.corners, self.corners[self.following]])
        return np.vstack([sides, self.vertices[self.lines.edges].reshape(-1, 4)])


@functools.lru_cache(2)  # one call of remesh asks several times
def sides_of(geometry: shapely.Geometry) -> Sides:
    """Sides of a domain; vertices on a straight line between their neighbours are left out.

    An upright rectangle has the names bottom, right, top, left; any other domain ``outline`` and
    ``hole 1``, ``hole 2``, ... (``outline 1``, ... where it has several parts).
    """
    parts = shapely.get_parts(shapely.orient_polygons(geometry))
    corners: list[NDArray[np.float64]] = []
    following: list[NDArray[np.int64]] = []
    tags: list[NDArray[np.int64]] = []
    names: list[str] = []
    start = holes = 0
    for number, part in enumerate(parts, 1):
        for k, ring in enumerate([part.exterior, *part.interiors]):
            if k == 0:
                names.append("outline" if len(parts) == 1 else f"outline {number}")
            else:
                holes += 1
                names.append(f"hole {holes}")
            points = _without_collinear(shapely.get_coordinates(ring)[:-1])
            n = len(points)
            corners.append(points)
            following.append(start + (np.arange(n) + 1) % n)
            tags.append(np.full(n, len(names) - 1))
            start += n
    all_corners = np.concatenate(corners)
    all_tags = np.concatenate(tags)
    if start == 4 and len(names) == 1 and _is_upright(all_corners):
        first = int(np.lexsort((all_corners[:, 0], all_corners[:, 1]))[0])
        all_corners = np.roll(all_corners, -first, axis=0)
        return Sides(all_corners, (np.arange(4) + 1) % 4, np.arange(4), _RECTANGLE)
    return Sides(all_corners, np.concatenate(following), all_tags, tuple(names))


def _without_collinear(points: NDArray[np.float64]) -> NDArray[np.float64]:
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    scale = np.hypot(*before.T) * np.hypot(*after.T)
    straight = (np.abs(cross) <= 1e-14 * scale) & ((before * after).sum(1) > 0.0)
    return points[~straight] if (~straight).sum() >= 3 else points


def _is_upright(corners: NDArray[np.float64]) -> bool:
    step = np.roll(corners, -1, axis=0) - corners
    return bool(((step[:, 0] == 0.0) ^ (step[:, 1] == 0.0)).all())


def strips_of(
    segments: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.float64]]:
    """Bucket segments (s, 4) by horizontal strips, for point-in-polygon tests.

    Returns ``start`` (k + 1,) and ``items`` of a sparse row format, and ``box`` = (lowest y,
    height).
    """
    low = np.minimum(segments[:, 1], segments[:, 3])
    high = np.maximum(segments[:, 1], segments[:, 3])
    bottom, height = float(low.min()), float(high.max() - low.min())
    count = int(np.clip(len(segments) // 2, 1, 4096))
    first = np.clip(((low - bottom) / height * count).astype(np.int64) - 1, 0, count - 1)
    last = np.clip(((high - bottom) / height * count).astype(np.int64) + 1, 0, count - 1)
    span = last - first + 1
    owner = np.repeat(np.arange(len(segments)), span)
    strip = np.arange(span.sum()) - np.repeat(np.cumsum(span) - span, span) + first[owner]
    order = np.argsort(strip, kind="stable")
    start = np.searchsorted(strip[order], np.arange(count + 1)).astype(np.int32)
    return start, owner[order].astype(np.int32), np.array([bottom, height])
