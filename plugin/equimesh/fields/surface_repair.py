"""From triangles as they come to a surface that is a graph over a plane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from equimesh.errors import InputError
from equimesh.fields.base import Array, IntArray
from equimesh.fields.surface_topology import (
    consistent_winding,
    crowded_edges,
    opposites,
)

__all__ = ["Graph", "as_graph", "count", "joined", "place"]

Flags = NDArray[np.bool_]

_EPS = float(np.finfo(np.float64).eps)


class Graph(NamedTuple):
    """A triangle surface over the plane of its first two coordinates."""

    points: Array  # (n, 3): x, y, height
    triangles: IntArray  # (m, 3): counter-clockwise in projection, neighbours wound alike
    flat: Flags  # (m,): without area, kept only to close the surface between their neighbours
    component: IntArray  # (m,): edge-connected pieces
    rotation: Array  # (3, 3): graph coordinates = rotation @ input coordinates
    notes: tuple[str, ...]


def as_graph(points: ArrayLike, triangles: ArrayLike, up: Any = None) -> Graph:
    """Weld, wind, turn and check.

    Raises
    ------
    InputError
        Arrays of the wrong shape, not finite, indices out of range, no triangle with an area, edges
        of more than two triangles, one-sided surfaces, triangles turned over in projection.
    """
    notes: list[str] = []
    p, t = _arrays(points, triangles)
    p, t = _weld(p, t, notes)
    t = _without_flaps(p, t, notes)
    component, turn, twisted = consistent_winding(t, opposites(t))
    if twisted >= 0:
        raise InputError(
            "The surface is one-sided (a Moebius band), seen going around from "
            f"{place(p[t[twisted]])}: cut it so that it has a top and a bottom."
        )
    if turn.any():
        t[turn] = t[turn][:, ::-1]
        notes.append(f"turned {_count(turn, 'triangle')} wound against the neighbours")
    rotation = _rotation(p, t, component, up, notes)
    p = np.ascontiguousarray(p @ rotation.T)
    double_area, rounding = _projected(p, t, exact=bool((rotation == np.eye(3)).all()))
    below = np.bincount(component, weights=double_area)[component] < 0.0
    t[below] = t[below][:, ::-1]
    double_area[below] *= -1.0
    t, flat = _without_flat(p, t, double_area, rounding, rotation, notes)
    component, _, _ = consistent_winding(t, opposites(t))
    used, t = np.unique(t, return_inverse=True)
    return Graph(p[used], t.reshape(-1, 3), flat, component, rotation, tuple(notes))


def joined(graph: Graph) -> Graph:
    """The same with its edge-connected pieces counted anew, after triangles were added."""
    component, _, _ = consistent_winding(graph.triangles, opposites(graph.triangles))
    return graph._replace(component=component)


def place(points: Array) -> str:
    """The middle of some points (k, 3), in words."""
    x, y, z = points.mean(axis=0)
    return f"({x:.6g}, {y:.6g}, {z:.6g})"


def _count(flags: Flags, noun: str) -> str:
    return count(int(np.count_nonzero(flags)), noun)


def count(number: int, noun: str) -> str:
    """Such as ``1 triangle`` or ``1,024 vertices``."""
    plural = "vertices" if noun == "vertex" else noun + "s"
    return f"{number:,} {noun if number == 1 else plural}"


def _arrays(points: ArrayLike, triangles: ArrayLike) -> tuple[Array, IntArray]:
    p, t = np.asarray(points), np.asarray(triangles)
    if p.dtype.kind not in "iuf" or p.ndim != 2 or p.shape[1] != 3:
        raise InputError(f"The points have shape {p.shape}: give (n, 3) real numbers.")
    if t.dtype.kind not in "iu" or t.ndim != 2 or t.shape[1] != 3:
        raise InputError(f"The triangles have shape {t.shape}: give (m, 3) integer vertex numbers.")
    if not len(t):
        raise InputError("The surface has no triangles: give at least one.")
    p, t = p.astype(np.float64), t.astype(np.int64)
    if t.min() < 0 or t.max() >= len(p):
        raise InputError(
            f"The triangles name vertex {t.min() if t.min() < 0 else t.max()}, but there are "
            f"{len(p)} points: number vertices from 0."
        )
    wild = ~np.isfinite(p[t]).all(axis=(1, 2))
    if wild.any():
        raise InputError(
            f"The surface has {_count(wild, 'triangle')} with coordinates that are not finite, the "
            f"first is number {int(np.argmax(wild))}: remove these."
        )
    return p, t


def _weld(p: Array, t: IntArray, notes: list[str]) -> tuple[Array, IntArray]:
    """One vertex per place, no vertex without a triangle, no triangle twice or without corners."""
    used = np.zeros(len(p), bool)
    used[t] = True
    if not used.all():
        notes.append(f"left out {_count(~used, 'vertex')} of no triangle")
    kept = np.flatnonzero(used)
    _, first, place = np.unique(p[kept], axis=0, return_index=True, return_inverse=True)
    if len(first) < len(kept):
        notes.append(f"merged {len(kept) - len(first):,} vertices with others at the same place")
    order = np.argsort(first)  # vertices stay in the order of the input
    number = np.zeros(len(p), np.int64)
    number[kept] = np.argsort(order)[place.reshape(-1)]
    p, t = p[kept[first[order]]], number[t]
    pointed = (t != np.roll(t, 1, axis=1)).all(axis=1)
    if not pointed.all():
        notes.append(f"left out {_count(~pointed, 'triangle')} with two corners at the same place")
        t = t[pointed]
    _, first = np.unique(np.sort(t, axis=1), axis=0, return_index=True)
    if len(first) < len(t):
        notes.append(f"left out {len(t) - len(first):,} triangles given twice")
        t = t[np.sort(first)]
    if not len(t):
        raise InputError("The surface has no triangle with an area: give at least one.")
    return p, t


def _without_flaps(p: Array, t: IntArray, notes: list[str]) -> IntArray:
    """No edge of more than two triangles: those that hang on such an edge alone are left out.

    Where that leaves two others the surface goes on as if the flap had never been; elsewhere nobody
    can tell which triangles are the surface.
    """
    crowded, member = crowded_edges(t)
    if not len(crowded):
        return t
    alone = (opposites(t) < 0).reshape(-1, 3).sum(axis=1) == 2
    edge, around = member[:, 0], member[:, 1] // 3
    staying = np.bincount(edge, weights=~alone[around])
    if (staying != 2).any():
        first = int(np.argmax(staying != 2))
        raise InputError(
            f"The surface has {len(crowded)} edge(s) shared by more than two triangles, the first "
            f"near {place(p[crowded[first]])}: split the surface there or delete the extra "
            "triangles."
        )
    hangs = np.zeros(len(t), bool)
    hangs[around[alone[around]]] = True
    notes.append(f"left out {_count(hangs, 'triangle')} hanging on an edge of two others")
    return t[~hangs]


def _rotation(p: Array, t: IntArray, component: IntArray, up: Any, notes: list[str]) -> Array:
    """The rotation that takes the direction of heights to z."""
    if up is not None:
        return _to_z(_direction(up))
    area, rounding = _projected(p, t, exact=True)
    parts = int(component.max()) + 1
    above = np.bincount(component[area > rounding], minlength=parts) > 0
    below = np.bincount(component[area < -rounding], minlength=parts) > 0
    a, b, c = p[t].transpose(1, 0, 2)
    in_space = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
    upright = float(np.abs(area).sum()) <= 1e-9 * in_space
    if not upright and not (above & below).any() and (above | below).any():
        return np.eye(3)
    normal = np.cross(b - a, c - a).sum(axis=0)
    length = float(np.linalg.norm(normal))
    if length <= 1e-9 * in_space:
        share = 100.0 * min(np.mean(area <= rounding), np.mean(area >= -rounding))
        raise InputError(
            "The surface is closed or folded, so it is a graph in no direction: seen along z, "
            f"{share:.2g} % of its triangles are upright or turned over; give up= for an open "
            "surface or split it into parts that are graphs."
        )
    normal /= length
    notes.append("heights along the mean normal ({:.4g}, {:.4g}, {:.4g})".format(*normal))
    return _to_z(normal)


def _direction(up: Any) -> Array:
    if isinstance(up, str) and up in ("x", "y", "z"):
        return np.asarray(np.eye(3)["xyz".index(up)])
    try:
        vector = np.asarray(up, np.float64)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise InputError("The direction up is no vector: give three numbers, or 'x', 'y' or 'z'.")
    return np.asarray(vector / length)


def _to_z(up: Array) -> Array:
    """A rotation that takes a unit vector to z (Rodrigues' formula)."""
    if up[2] < 0.0:  # by way of the half turn about x, away from the division by zero
        half_turn = np.diag([1.0, -1.0, -1.0])
        return np.asarray(_to_z(half_turn @ up) @ half_turn)
    x, y, z = up
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def _projected(p: Array, t: IntArray, *, exact: bool) -> tuple[Array, Array]:
    """(m,) twice the signed area in projection and (m,) what rounding may make of it.

    ``exact``: the coordinates are the input's own, not the rounded result of a rotation.
    """
    a, b, c = p[t].transpose(1, 0, 2)
    u, v = (b - a)[:, :2], (c - a)[:, :2]
    left, right = u[:, 0] * v[:, 1], u[:, 1] * v[:, 0]
    rounding = 8.0 * _EPS * (np.abs(left) + np.abs(right))
    if not exact:
        reach = 8.0 * _EPS * np.abs(p[t]).max(axis=(1, 2))
        rounding += reach * (np.abs(u).sum(axis=1) + np.abs(v).sum(axis=1))
    return left - right, rounding


def _without_flat(
    p: Array,
    t: IntArray,
    double_area: Array,
    rounding: Array,
    rotation: Array,
    notes: list[str],
) -> tuple[IntArray, Flags]:
    """Check that no triangle is turned over, and take away those without area on the border.

    Triangles without any area (in space) do no harm: between others they are kept to close the
    surface, on the border they are left out. Triangles that stand upright do no harm on the border.
    """
    flat = np.abs(double_area) <= rounding
    a, b, c = p[t].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(((b - a) ** 2).sum(1), ((c - a) ** 2).sum(1))
    thin = flat & (area <= 1e-12 * longest)
    kept = np.arange(len(t))
    if flat.any():
        border = (opposites(t) < 0).reshape(-1, 3).any(axis=1)
        outer = flat & border
        upright = outer & ~thin
        if upright.any():
            notes.append(f"left out {_count(upright, 'upright triangle')} on the border")
        while outer.any():
            kept = kept[~outer]
            border = (opposites(t[kept]) < 0).reshape(-1, 3).any(axis=1)
            outer = thin[kept] & border
        thin_count = int(np.count_nonzero(thin))
        if thin_count:
            notes.append(f"ignored {_count(thin, 'triangle')} without area")
    t, flat, thin = t[kept], flat[kept], thin[kept]
    if flat.all():
        raise InputError("The surface has no area in projection: give up= another direction.")
    offends = (double_area[kept] < 0.0) & ~flat | flat & ~thin
    if offends.any():
        along = ", ".join(f"{number:.3g}" for number in rotation[2])
        share = 100.0 * np.count_nonzero(offends) / len(t)
        first = place(p[t[int(np.argmax(offends))]] @ rotation)
        raise InputError(
            f"The surface is no graph: seen along ({along}), {_count(offends, 'triangle')} "
            f"({share:.2g} %) are upright or turned over, the first near {first}; give up= another "
            "direction or split the surface into parts that are graphs."
        )
    return t, flat
