"""Holes of a triangle surface, closed by triangles between the vertices of their rims."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import scipy
import shapely
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.surface_repair import Graph, count

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["HoleSize", "filled", "hole_size"]

Flags = NDArray[np.bool_]
HoleSize = tuple[float, int]


def hole_size(size: float | str) -> HoleSize:
    """The largest area and the largest number of edges of holes that are to be closed.

    A number is an area seen from above, text such as ``"40 edges"`` a number of edges, and
    ``"all"`` closes every hole.

    >>> hole_size(2.5), hole_size("40 edges")
    ((2.5, 9223372036854775807), (inf, 40))
    """
    most = int(np.iinfo(np.int64).max)
    words = size.split() if isinstance(size, str) else []
    if words == ["all"]:
        return math.inf, most
    try:
        if len(words) == 2 and words[1] in ("edge", "edges"):
            return math.inf, int(words[0])
        area = float(size)
    except (TypeError, ValueError):
        area = math.nan
    if not area >= 0.0:
        raise InputError(
            f"fill_holes={size!r} is not known: give an area, a text such as '40 edges', or 'all'."
        )
    return area, most


def filled(graph: Graph, rings: Sequence[IntArray], outer: Flags, size: HoleSize) -> Graph:
    """The surface with its smaller holes closed, and a note of how many.

    ``rings``: vertex numbers of simple closed chains, the surface on their left; ``outer`` flags
    those around a piece, the others are holes. A hole with another piece inside stays.
    """
    holes = [ring for ring, around in zip(rings, outer, strict=True) if not around]
    rims = [shapely.Polygon(graph.points[ring, :2]) for ring in holes]
    pieces = [ring for ring, around in zip(rings, outer, strict=True) if around]
    tree = shapely.STRtree([shapely.Polygon(graph.points[ring, :2]) for ring in pieces])
    added: list[IntArray] = []
    for ring, rim in zip(holes, rims, strict=True):
        fits = rim.area <= size[0] and len(ring) <= size[1]
        if fits and rim.is_valid and not len(tree.query(rim, "covers")):
            added.append(_cover(graph.points, ring, rim))
    if not added:
        return graph
    triangles = np.concatenate([graph.triangles, *added])
    new = len(triangles) - len(graph.triangles)
    note = f"closed {count(len(added), 'hole')} with {count(new, 'triangle')}"
    return graph._replace(
        triangles=triangles,
        flat=np.append(graph.flat, np.zeros(new, bool)),
        notes=(*graph.notes, note),
    )


def _cover(points: Array, ring: IntArray, rim: shapely.Polygon) -> IntArray:
    """(k, 3) counter-clockwise triangles of a ring's vertices that fill it."""
    pieces = shapely.get_parts(shapely.constrained_delaunay_triangles(rim))
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    _, near = scipy.spatial.cKDTree(points[ring, :2]).query(corners.reshape(-1, 2))
    triangles = ring[near].reshape(-1, 3)
    a, b, c = points[triangles, :2].transpose(1, 0, 2)
    turned = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[turned] = triangles[turned][:, ::-1]
    return np.asarray(triangles)
