"""Triangle surfaces of any library, as arrays: body by body to new arrays, attributes along.

A body is what hangs together at vertices, equal coordinates counting as one vertex. Every body is
seen, meshed and certified for itself, so bodies may lie over one another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import in_projection, in_space
from equimesh_adapters.attributes import Carrier

__all__ = ["Body", "Remeshed", "bodies_of", "profiled", "remeshed"]


@dataclass(frozen=True, eq=False)
class Body:
    """One body: ``vertices`` and ``faces`` are its numbers in the whole, ``triangles`` its own."""

    vertices: NDArray[np.int64]
    faces: NDArray[np.int64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Remeshed:
    """New arrays: ``points`` (n, 3), ``triangles`` (m, 3), wound as the old ones.

    ``heights`` (n,) along the direction in which each body is seen; ``normals`` (m, 3) that
    direction, turned to the side of a triangle's own normal; ``errors`` and ``bounds`` (m,)
    as in a ``Profile``; ``carrier`` leads attributes over; ``tol`` the largest tolerance of a body;
    ``notes`` what was done to the input.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    heights: NDArray[np.float64]
    normals: NDArray[np.float64]
    errors: NDArray[np.float64]
    bounds: NDArray[np.float64]
    carrier: Carrier
    tol: float
    notes: tuple[str, ...]


def bodies_of(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> list[Body]:
    """Bodies in the order of their first triangles.

    >>> line = np.arange(6.0)[:, None] * [1, 0, 0]
    >>> [body.faces for body in bodies_of(line, np.array([[0, 1, 2], [3, 4, 5], [2, 0, 1]]))]
    [array([0, 2]), array([1])]
    """
    _, place = np.unique(points, axis=0, return_inverse=True)
    corners = place.reshape(-1)[triangles]
    ends = corners[:, [0, 1]].ravel(), corners[:, [1, 2]].ravel()
    graph = sparse.coo_matrix((np.ones(len(ends[0]), bool), ends), shape=2 * (len(points),))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    _, first, body = np.unique(label[corners[:, 0]], return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))[body.reshape(-1)]
    faces = np.argsort(order, kind="stable")
    parts = np.split(faces, np.cumsum(np.bincount(order))[:-1])
    return [_body(triangles, part) for part in parts]


def _body(triangles: NDArray[np.int64], faces: NDArray[np.int64]) -> Body:
    vertices, own = np.unique(triangles[faces], return_inverse=True)
    return Body(vertices, faces, own.reshape(-1, 3))


def remeshed(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    tol: float | str | None = None,
    *,
    up: Any = None,
    surface: Callable[..., Surface] = Surface,
    **options: Any,
) -> Remeshed:
    """``equimesh.remesh`` on every body.

    A share of the range of heights means that of the body with the largest range; ``target`` and
    ``max_triangles`` are divided among the bodies in the proportion of their triangles.

    Raises
    ------
    InputError
        A body that is no graph, or whose tolerance is not met.
    """
    points, triangles = _arrays(points, triangles)
    bodies = bodies_of(points, triangles)
    parts = [_named(k, bodies, surface, points[b.vertices], b.triangles, up=up)
             for k, b in enumerate(bodies)]  # fmt: skip
    if len(bodies) > 1:
        tol = _shared_tolerance(tol, parts)
    counts = {name: options.pop(name) for name in ("target", "max_triangles") if name in options}
    results = []
    for k, (body, field) in enumerate(zip(bodies, parts, strict=True)):
        for name, count in counts.items():
            share = len(body.faces) / len(triangles)
            whole = count is None or len(bodies) == 1
            options[name] = count if whole else max(2, int(count * share))
        result = _named(k, bodies, equimesh.remesh, field, tol, **options)
        if not result.status.usable:
            raise InputError(result.status.value)
        results.append(_placed(result, field, body, points[body.vertices]))
    return _joined(results)


def profiled(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    against: Any,
    *,
    up: Any = None,
) -> equimesh.Profile:
    """The errors of a mesh against another one, (points, triangles), or against any source.

    Two meshes of as many bodies are compared body by body, each with the one whose box is most like
    its own; others as a whole. The errors keep the order of the triangles.
    """
    points, triangles = _arrays(points, triangles)
    if not isinstance(against, tuple):
        seen = in_projection(points, against) if isinstance(against, Surface) else points
        return equimesh.profile(seen, triangles, against)
    old = _arrays(*against)
    ours, theirs = bodies_of(points, triangles), bodies_of(*old)
    if len(ours) != len(theirs) or len(ours) == 1:
        return profiled(points, triangles, Surface(*old, up=up))
    boxes = [_boxes(points, ours), _boxes(old[0], theirs)]
    _, partner = optimize.linear_sum_assignment(np.abs(boxes[0][:, None] - boxes[1]).sum(axis=2))
    errors, bounds = np.zeros((2, len(triangles)))
    for k, body in enumerate(ours):
        other = theirs[partner[k]]
        field = _named(k, ours, Surface, old[0][other.vertices], other.triangles, up=up)
        part = profiled(points[body.vertices], body.triangles, field)
        errors[body.faces], bounds[body.faces] = part.errors, part.bounds
    return equimesh.Profile(errors, bounds, points, triangles)


def _boxes(points: NDArray[np.float64], bodies: list[Body]) -> NDArray[np.float64]:
    corners = [points[body.vertices] for body in bodies]
    return np.array([np.concatenate([p.min(axis=0), p.max(axis=0)]) for p in corners])


def _arrays(points: Any, triangles: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if not len(triangles):
        raise InputError("The mesh has no triangles: give a triangulated surface.")
    points = np.array(points, np.float64)
    if not np.isfinite(points).all():
        raise InputError("The mesh has NaN or infinite coordinates: remove such vertices.")
    return points, np.array(triangles, np.int64)


def _named(k: int, bodies: list[Body], action: Callable[..., Any], *args: Any, **more: Any) -> Any:
    """What an action gives; of several bodies its refusal tells which one it is about."""
    try:
        return action(*args, **more)
    except InputError as error:
        if len(bodies) == 1:
            raise
        raise InputError(f"Body {k + 1} of {len(bodies)}: {error}") from None


def _shared_tolerance(tol: float | str | None, parts: list[Surface]) -> float | str | None:
    if not (isinstance(tol, str) and tol.strip().endswith("%")):
        return tol
    largest = max(float(np.ptp(part.points[:, 2])) for part in parts)
    try:
        height = 0.01 * float(tol.strip()[:-1]) * largest
    except ValueError:
        return tol
    return height if height > 0.0 else tol


def _placed(
    result: equimesh.Result, field: Surface, body: Body, points: NDArray[np.float64]
) -> Remeshed:
    """One body's result with the winding of its input, its carrier in numbers of the whole."""
    seen = in_projection(points, field)[:, :2]
    old = seen, body.triangles
    carrier = Carrier.between(old, (result.points[:, :2], result.triangles))
    carrier = Carrier(
        body.vertices[carrier.corners],
        carrier.weights,
        body.faces[carrier.faces],
        body.faces[carrier.owners],
    )
    a, b, c = seen[body.triangles].transpose(1, 0, 2)
    u, v = b - a, c - a
    downward = float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])) < 0.0
    triangles = result.triangles[:, ::-1] if downward else result.triangles
    return Remeshed(
        in_space(result, field).points,
        np.ascontiguousarray(triangles),
        result.points[:, 2],
        np.tile(
            field.to_input(np.array([[0.0, 0.0, -1.0 if downward else 1.0]])), (len(triangles), 1)
        ),
        result.profile.errors,
        result.profile.bounds,
        carrier,
        result.tol,
        tuple(dict.fromkeys((*getattr(field, "notes", ()), *result.notes))),
    )


def _joined(parts: list[Remeshed]) -> Remeshed:
    start = np.cumsum([0] + [len(part.points) for part in parts])
    triangles = [part.triangles + i for part, i in zip(parts, start[:-1], strict=True)]
    carriers = [part.carrier for part in parts]
    return Remeshed(
        np.concatenate([part.points for part in parts]),
        np.concatenate(triangles),
        np.concatenate([part.heights for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.errors for part in parts]),
        np.concatenate([part.bounds for part in parts]),
        Carrier(
            np.concatenate([c.corners for c in carriers]),
            np.concatenate([c.weights for c in carriers]),
            np.concatenate([c.faces for c in carriers]),
            np.concatenate([c.owners for c in carriers]),
        ),
        max(part.tol for part in parts),
        tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )
