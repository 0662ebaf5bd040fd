"""Breaklines and points that a mesh must contain, noded with each other and with its domain."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from equimesh.constraint_files import read_constraints
from equimesh.domain import Lines, Sides
from equimesh.errors import InputError
from equimesh.frame import Frame
from equimesh.noding import noded

__all__ = ["NAME", "named_shapes", "with_constraints"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The name of constraints that have none of their own.
NAME = "breaklines"
_LINES = ("LineString", "LinearRing")
_REACH = 1e-12  # of the domain's size: nearer points are the same


def named_shapes(constraints: Any) -> list[tuple[str, shapely.Geometry]]:
    """Single lines and points with their names.

    Parameters
    ----------
    constraints
        Lines and points of shapely, alone, in collections or in a sequence; (n, 2) arrays of
        points along a line; a mapping from names to such; or the name of a file with them.

    Raises
    ------
    InputError
        Something else, nothing, or coordinates that are not finite.

    Examples
    --------
    >>> [(name, str(shape)) for name, shape in named_shapes({"road": [[(0, 0), (1, 2)]]})]
    [('road', 'LINESTRING (0 0, 1 2)')]
    """
    if isinstance(constraints, (str, Path)):
        return [
            (name or NAME, part)
            for name, shape in read_constraints(Path(constraints))
            for part in _single(shape)
        ]
    if isinstance(constraints, Mapping):
        return [(str(name), part) for name, some in constraints.items() for part in _parts(some)]
    return [(NAME, part) for part in _parts(constraints)]


def _parts(some: Any) -> list[shapely.Geometry]:
    if isinstance(some, shapely.Geometry):
        return _single(some)
    if isinstance(some, np.ndarray) and some.dtype.kind in "iuf":
        return _single(_polyline(some))
    if not isinstance(some, Iterable) or isinstance(some, (str, bytes)):
        raise InputError(
            f"A constraint is a {type(some).__name__}: give lines, points or (n, 2) arrays."
        )
    found: list[shapely.Geometry] = []
    for one in some:
        found += _single(one if isinstance(one, shapely.Geometry) else _polyline(one))
    return found


def _polyline(points: Any) -> shapely.Geometry:
    """A line through (n, 2) points; a point where there is one."""
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.ndim != 2 or array.shape[1] not in (2, 3) or len(array) == 0:
        raise InputError(
            "A constraint is no line and no point: give shapely geometries or (n, 2) arrays."
        )
    if not np.isfinite(array).all():
        raise InputError("A constraint has coordinates that are not finite: correct them.")
    return shapely.Point(array[0]) if len(array) == 1 else shapely.LineString(array)


def _single(shape: shapely.Geometry) -> list[shapely.Geometry]:
    """The lines and points of a geometry, one by one."""
    if shape is None or shape.is_empty:
        raise InputError("A constraint is empty: leave it out.")
    if shape.geom_type.startswith("Multi") or shape.geom_type == "GeometryCollection":
        return [single for part in shapely.get_parts(shape) for single in _single(part)]
    if shape.geom_type not in ("Point", *_LINES):
        raise InputError(
            f"A constraint is a {shape.geom_type}: give lines and points, of a polygon its "
            "boundary."
        )
    if not np.isfinite(shapely.get_coordinates(shape)).all():
        raise InputError("A constraint has coordinates that are not finite: correct them.")
    return [shapely.force_2d(shape)]


def with_constraints(
    sides: Sides, constraints: Any, domain: shapely.Geometry, frame: Frame
) -> Sides:
    """The sides of a domain with the part of the constraints that lies in it.

    Lines are cut where they cross each other or a side; what lies along a side or ends on it gives
    the side further corners. The ends of what is left, its bends and crossings and all points must
    become vertices.

    Raises
    ------
    InputError
        The constraints cannot be understood, or none of them meets the domain.
    """
    shapes = named_shapes(constraints)
    if not shapes:
        return sides
    names = tuple(dict.fromkeys(name for name, _ in shapes))
    taken = [name for name in names if name in sides.names]
    if taken:
        raise InputError(
            f"A constraint has the name {taken[0]!r} of a side of the domain: give it another."
        )
    given, segments, dots, label, origin = _gathered(sides, shapes, names)
    k, count = len(sides.corners), len(sides.corners)
    points = frame.to_local(given)
    places, index, pieces, owner = noded(points, segments, _reach(frame, points[:k], given))
    user = np.vstack([given, frame.to_user(places[len(given) :])])

    border = owner < count
    cut, point = _cut_sides(sides, user, index[:k], pieces[border], owner[border])
    place = np.full(len(user), -1, np.int64)
    place[point[::-1]] = np.arange(len(point))[::-1]
    along = np.stack([point, point[cut.following]], 1)
    side_of = {_key(piece): number for number, piece in enumerate(along)}
    inner, own = pieces[~border], owner[~border] - count
    on_side = np.array([side_of.get(_key(piece), -1) for piece in inner], np.int64)
    middle = frame.to_user(0.5 * (places[inner[:, 0]] + places[inner[:, 1]]))
    shapely.prepare(domain)
    within = (on_side < 0) & shapely.contains_xy(domain, *middle.T)
    dot = index[dots[:, 0]]
    kept = (place[dot] >= 0) | shapely.contains_xy(domain, *user[dot].T)

    wanted = np.unique(np.concatenate([inner[within].ravel(), dot[kept]]))
    nodes = wanted[place[wanted] < 0]
    place[nodes] = len(cut.corners) + np.arange(len(nodes))
    edges, number = np.unique(np.sort(place[inner[within]], 1), axis=0, return_inverse=True)
    met = np.zeros(len(shapes), bool)
    met[origin[own[within | (on_side >= 0)]]] = True
    met[dots[kept, 2]] = True
    if not met.any():
        raise InputError("The constraints lie outside the domain: give some that meet it.")
    lost = int((~met).sum())
    lines = Lines(
        nodes=user[nodes],
        edges=edges.reshape(-1, 2),
        edge_tags=_pairs(number.ravel(), label[own[within]]),
        side_tags=_pairs(on_side[on_side >= 0], label[own[on_side >= 0]]),
        point_tags=_pairs(place[dot[kept]], dots[kept, 1]),
        names=names,
        notes=(f"{lost} of {len(met)} constraints lie outside the domain",) if lost else (),
    )
    return dataclasses.replace(cut, lines=lines)


def _gathered(
    sides: Sides, shapes: list[tuple[str, shapely.Geometry]], names: tuple[str, ...]
) -> tuple[Array, IntArray, IntArray, IntArray, IntArray]:
    """All points (corners, then points, then those of lines) and segments (sides first).

    ``dots`` (d, 3): point, name and number of every single point; ``label`` and ``origin``: name
    and number of every line's segment.
    """
    k = len(sides.corners)
    number_of = {name: number for number, name in enumerate(names)}
    points = [sides.corners]
    segments = [np.stack([np.arange(k), sides.following], 1)]
    dots: list[tuple[int, int, int]] = []
    label, origin = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    start = k
    for number, (name, shape) in enumerate(shapes):
        if shape.geom_type == "Point":
            points.append(shapely.get_coordinates(shape))
            dots.append((start, number_of[name], number))
            start += 1
    for number, (name, shape) in enumerate(shapes):
        if shape.geom_type != "Point":
            line = _without_straight(shapely.get_coordinates(shape))
            steps = np.arange(start, start + len(line) - 1)
            points.append(line)
            segments.append(np.stack([steps, steps + 1], 1))
            label.append(np.full(len(steps), number_of[name]))
            origin.append(np.full(len(steps), number))
            start += len(line)
    return (
        np.vstack(points),
        np.vstack(segments),
        np.array(dots, np.int64).reshape(-1, 3),
        np.concatenate(label),
        np.concatenate(origin),
    )


def _without_straight(line: Array) -> Array:
    """A polyline without repeated points and without those on the straight way to the next."""
    line = line[np.append(True, (np.diff(line, axis=0) != 0.0).any(1))]
    if len(line) < 3:
        return line
    before, after = np.diff(line, axis=0)[:-1], np.diff(line, axis=0)[1:]
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    scale = np.hypot(*before.T) * np.hypot(*after.T)
    straight = (np.abs(turn) <= 1e-14 * scale) & ((before * after).sum(1) > 0.0)
    return np.asarray(line[np.concatenate([[True], ~straight, [True]])])


def _reach(frame: Frame, corners: Array, given: Array) -> float:
    """The distance in local coordinates below which points are the same."""
    rounding = 4.0 * np.spacing(np.abs(given).max()) / np.linalg.svd(frame.matrix)[1].min()
    return float(max(_REACH * np.ptp(corners, axis=0).max(), rounding, 2.0 * frame.snap))


def _cut_sides(
    sides: Sides, user: Array, corner: IntArray, pieces: IntArray, owner: IntArray
) -> tuple[Sides, IntArray]:
    """The sides cut into their pieces, and (c,) which point each of the new corners is.

    ``corner`` (k,) is the point that stands for each corner. On an upright side the new corners
    have that side's own coordinate.
    """
    k = len(sides.corners)
    later = owner[1:] == owner[:-1]
    old = np.concatenate([np.arange(k), owner[1:][later]])
    point = np.concatenate([corner, pieces[1:, 0][later]])
    a, b = sides.corners[old[k:]], sides.corners[sides.following[old[k:]]]
    row, axis = np.nonzero(a == b)
    user[point[k + row], axis] = a[row, axis]
    coordinates = np.vstack([sides.corners, user[point[k:]]])
    order = np.argsort(old, kind="stable")
    old, point, coordinates = old[order], point[order], coordinates[order]
    start = np.searchsorted(old, np.arange(k))
    following = np.arange(1, len(old) + 1)
    following[np.append(start[1:], len(old)) - 1] = start[sides.following]
    return Sides(coordinates, following, sides.tags[old], sides.names), point


def _key(piece: IntArray) -> tuple[int, int]:
    a, b = piece.tolist()
    return (a, b) if a < b else (b, a)


def _pairs(what: IntArray, tag: IntArray) -> IntArray:
    return np.unique(np.stack([what, tag], 1), axis=0).reshape(-1, 2)
