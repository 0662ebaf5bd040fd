"""Remeshing a part of a surface so that it still fits the rest, vertex to vertex."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh_adapters.attributes import Carrier
from equimesh_adapters.borders import border_edges
from equimesh_adapters.surfaces import Remeshed, profiled, remeshed

__all__ = ["Pinned", "remeshed_part"]

# Border vertices on a straight line are no corners of a domain. Bent inwards by so little of the
# line's length they are, and every one of them stays; afterwards they are put back.
_BEND = 1e-7
_STRAIGHT = 1e-10
_NEAR = 1e-4  # of the shortest edge at a border vertex: what lies nearer is this vertex
_FLAT = 1e-6
# Putting the border back may add to errors; then a smaller tolerance makes room.
_SHARES = (1.0, 0.7, 0.4, 0.1)


class Pinned(Surface):
    """A surface whose border keeps every vertex, whatever the tolerance."""

    def outline(self, tol: float = 0.0) -> shapely.Geometry:
        """The exact border; its straight runs are bent inwards by a ten-millionth at most."""
        exact = shapely.orient_polygons(super().outline(0.0))
        rings = [
            shapely.get_coordinates(ring)[:-1]
            for part in shapely.get_parts(exact)
            for ring in (part.exterior, *part.interiors)
        ]
        places, count = np.unique(np.concatenate(rings), axis=0, return_counts=True)
        shared = {tuple(place) for place in places[count > 1].tolist()}
        bent = iter([_bent(ring, shared) for ring in rings])
        parts = [
            shapely.Polygon(next(bent), [next(bent) for _ in part.interiors])
            for part in shapely.get_parts(exact)
        ]
        return parts[0] if len(parts) == 1 else shapely.multipolygons(parts)


def remeshed_part(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    chosen: NDArray[np.bool_],
    tol: float | None,
    **options: Any,
) -> Remeshed:
    """``remeshed`` for the triangles ``chosen`` (m,) bool, the others as they are.

    Every vertex on the border of the chosen part stays. Where the new part has more of them, the
    triangles beyond are divided there, which changes nothing of their shape. Triangles that were
    not chosen come first in the result, with errors, heights and normals of zero. Vertices that no
    triangle uses any more are left out.

    Raises InputError as ``remeshed`` does.
    """
    points, triangles = np.array(points, np.float64), np.array(triangles, np.int64)
    if chosen.all():
        return remeshed(points, triangles, tol, **options)
    if not chosen.any():
        raise InputError("No face is selected: select those to remesh, or all.")
    inner, rest = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    triangles = _welded(points, triangles)
    for share in _SHARES:
        aim = None if tol is None else share * tol
        new, number, chains = _pinned(points, triangles[inner], aim, **options)
        if tol is None or new.bounds.max() <= tol:
            break
    else:
        raise InputError(
            "The tolerance is too small beside the border of the selection: raise it, or remesh "
            "the whole surface."
        )
    made = new.points
    fresh = np.flatnonzero(number < 0)
    number[fresh] = len(points) + np.arange(len(fresh))
    splits = {}
    for (a, b), between in chains.items():
        if len(between):
            splits[b, a], splits[a, b] = number[between[::-1]], number[between]
    kept, owner = _divided(triangles[rest], splits)
    whole = np.concatenate([points, made[fresh]])
    faces = np.concatenate([kept, number[new.triangles]])
    used, faces = np.unique(faces, return_inverse=True)
    heights = np.zeros(len(whole))
    heights[number] = new.heights
    old = new.carrier
    own = np.arange(len(points))
    some = np.zeros(len(points), np.int64)
    some[triangles] = np.arange(len(triangles))[:, None]
    place = np.argmax(triangles[some] == own[:, None], axis=1)
    carrier = Carrier(
        np.concatenate([triangles[some], old.corners[fresh]])[used],
        np.concatenate([np.eye(3)[place], old.weights[fresh]])[used],
        np.concatenate([rest[owner], inner[old.faces]]),
        np.concatenate([some, inner[old.owners[fresh]]])[used],
    )
    still = np.zeros(len(kept))
    return Remeshed(
        whole[used],
        faces.reshape(-1, 3),
        heights[used],
        np.concatenate([np.zeros((len(kept), 3)), new.normals]),
        np.concatenate([still, new.errors]),
        np.concatenate([still, new.bounds]),
        carrier,
        new.tol if tol is None else tol,
        new.notes,
    )


def _pinned(
    points: NDArray[np.float64], triangles: NDArray[np.int64], tol: float | None, **options: Any
) -> tuple[Remeshed, NDArray[np.int64], dict[tuple[int, int], NDArray[np.int64]]]:
    """A part by itself, its border in place: what it is, whose twins its vertices are, its chains.

    See ``_twins`` and ``_chains``. Errors are measured after the border was put back.
    """
    new = remeshed(points, triangles, tol, surface=Pinned, **options)
    number = _twins(points, border_edges(triangles), new)
    chains = _chains(border_edges(new.triangles), number)
    made = new.points.copy()
    made[number >= 0] = points[number[number >= 0]]
    for (a, b), between in chains.items():
        span = points[b] - points[a]
        share = (made[between] - points[a]) @ span / (span @ span)
        made[between] = points[a] + share[:, None] * span
    faces = _without_slivers(made, new.triangles, new.normals)
    found = profiled(made, faces, (points, triangles), up=options.get("up"))
    moved = replace(new, points=made, triangles=faces, errors=found.errors, bounds=found.bounds)
    return moved, number, chains


def _welded(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles with the first vertex at each place instead of others there."""
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[place.reshape(-1)][triangles])


def _bent(p: NDArray[np.float64], shared: set[tuple[float, ...]]) -> NDArray[np.float64]:
    """A ring (k, 2), the domain on its left, its straight runs bent to the left as parabolas.

    What is bent is no convex corner, so no triangle without area can arise there. Vertices
    ``shared`` with other rings stay where they are, and turn into corners because the runs on both
    sides bend, if need be at a middle that is added.
    """
    before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    scale = np.hypot(*before.T) * np.hypot(*after.T)
    straight = (np.abs(cross) <= _STRAIGHT * scale) & ((before * after).sum(axis=1) > 0.0)
    pinned = straight & np.array([tuple(place) in shared for place in p.tolist()])
    fixed = np.flatnonzero(~straight | pinned)
    rows = []
    for i, j in zip(fixed, np.roll(fixed, -1), strict=True):
        chord = p[j] - p[i]
        run = p[np.arange(i + 1, j if j > i else j + len(p)) % len(p)]
        if not len(run) and (pinned[i] or pinned[j]):
            run = p[i : i + 1] + 0.5 * chord
        share = (run - p[i]) @ chord / (chord @ chord)
        left = np.array([-chord[1], chord[0]])
        rows += [p[i : i + 1], run + _BEND * (share * (1.0 - share))[:, None] * left]
    return np.concatenate(rows)


def _twins(points: NDArray[np.float64], rim: NDArray[np.int64], new: Remeshed) -> NDArray[np.int64]:
    """(n,) the old border vertex that each new vertex is, or -1."""
    number = np.full(len(new.points), -1, np.int64)
    vertices = np.unique(rim)
    edges = np.linalg.norm(points[rim[:, 1]] - points[rim[:, 0]], axis=1)
    reach = np.full(len(points), np.inf)
    np.minimum.at(reach, rim, edges[:, None])
    border = np.unique(border_edges(new.triangles))
    distance, near = cKDTree(points[vertices]).query(new.points[border])
    same = distance <= _NEAR * reach[vertices[near]]
    number[border[same]] = vertices[near[same]]
    corners = np.sort(np.where(number < 0, -1 - np.arange(len(number)), number)[new.triangles])
    if len(np.unique(near[same])) < len(vertices) or (np.diff(corners, axis=1) == 0).any():
        raise InputError(
            "The border of the selection cannot be kept: select whole parts that are graphs."
        )
    return number


def _chains(
    edges: NDArray[np.int64], number: NDArray[np.int64]
) -> dict[tuple[int, int], NDArray[np.int64]]:
    """For each old border edge (a, b) the new vertices between its ends, in order."""
    following = {a: b for a, b in edges.tolist() if number[a] < 0}
    chains: dict[tuple[int, int], NDArray[np.int64]] = {}
    for a, b in edges.tolist():
        if number[a] < 0:
            continue
        between = []
        while number[b] < 0:
            between.append(b)
            b = following[b]
        chains[int(number[a]), int(number[b])] = np.array(between, np.int64)
    return chains


def _without_slivers(
    points: NDArray[np.float64], triangles: NDArray[np.int64], normals: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Triangles that putting the border back has flattened, flipped with those at their long sides.

    The middle corner of a flat triangle lies on its long side, so it divides the triangle beyond.
    """
    faces = triangles.copy()
    flat = np.flatnonzero(_flatness(points, faces, normals) <= _FLAT)
    if not len(flat):
        return faces
    beyond = {
        (a, b): k for k, face in enumerate(faces.tolist())
        for a, b in zip(face, np.roll(face, -1).tolist(), strict=True)
    }  # fmt: skip
    for _ in range(len(flat)):
        worst = np.flatnonzero(_flatness(points, faces, normals) <= _FLAT)
        if not len(worst):
            break
        k = int(worst[0])
        face = faces[k].tolist()
        sides = points[np.roll(face, -1)] - points[face]
        i = int(np.argmax((sides**2).sum(axis=1)))
        a, c, b = (face[(i + step) % 3] for step in range(3))
        other = beyond.get((c, a))
        if other is None:
            break
        d = next(v for v in faces[other].tolist() if v not in (a, c))
        faces[k], faces[other] = (b, a, d), (c, b, d)
        for n in (k, other):
            row = faces[n].tolist()
            beyond |= {(row[0], row[1]): n, (row[1], row[2]): n, (row[2], row[0]): n}
    if (_flatness(points, faces, normals) <= 0.0).any():
        raise InputError(
            "The border of the selection cannot be kept: select a few faces more or less."
        )
    return faces


def _flatness(
    points: NDArray[np.float64], triangles: NDArray[np.int64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(m,) twice the area as seen over the square of the longest side; negative if turned over."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    area = (np.cross(b - a, c - a) * normals).sum(axis=1)
    sides = np.stack([b - a, c - b, a - c])
    sides = sides - (sides * normals).sum(axis=2, keepdims=True) * normals
    return np.asarray(area / (sides**2).sum(axis=2).max(axis=0))


def _divided(
    triangles: NDArray[np.int64], splits: dict[tuple[int, int], NDArray[np.int64]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles with nodes put on some edges, keyed in the triangles' own direction, and owners."""
    kept: list[list[int]] = []
    owner: list[int] = []
    touched = np.zeros(len(triangles), bool)
    if splits:
        key = triangles[:, [[0, 1], [1, 2], [2, 0]]]
        wide = int(triangles.max()) + 1
        wanted = np.array(list(splits))
        wanted = wanted[(wanted < wide).all(axis=1)]
        touched = np.isin(key @ [wide, 1], wanted @ [wide, 1]).any(axis=1)
    for k in np.flatnonzero(touched).tolist():
        pieces = [triangles[k].tolist()]
        for i in range(3):
            a, b = int(triangles[k, i]), int(triangles[k, (i + 1) % 3])
            for node in splits.get((a, b), np.zeros(0, np.int64)).tolist():
                at = next(n for n, piece in enumerate(pieces) if {a, b} <= {*piece})
                piece = pieces.pop(at)
                c = next(v for v in piece if v not in (a, b))
                pieces += [[a, node, c], [node, b, c]]
                a = node
        kept += pieces
        owner += [k] * len(pieces)
    plain = np.flatnonzero(~touched)
    divided = np.array(kept, np.int64).reshape(-1, 3)
    owners = np.concatenate([plain, np.array(owner, np.int64)])
    order = np.argsort(owners, kind="stable")
    return np.concatenate([triangles[plain], divided])[order], owners[order]
