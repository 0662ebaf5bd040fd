"""A triangulation that compiled kernels change in place, with a journal to undo what did not help.

Triangles are counter-clockwise; edge k of a triangle runs from its vertex k to its vertex k + 1,
and ``tn[t, k]`` is the triangle beyond it (-1 at the border). Errors are in units of the tolerance.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.reference import by_reference
from equimesh.fields.workers import apart

__all__ = [
    "FIXED",
    "FREE",
    "SLIDES",
    "WIDE",
    "Mesh",
    "build",
    "compact",
    "copied",
    "enlarged",
    "is_wide",
    "movable",
    "restore",
    "triangles_in",
]

WIDE = 4_000  # triangles

FREE, SLIDES, FIXED, GONE = 0, 1, 2, -1
HELD = 4  # on top of the kind of a vertex that stays where it is while a mesh is in parts,
SEAM = 2  # and on that of an edge that stays between them
# How errors are priced (``energy.penalty``).
SETTLE, SPREAD, EVEN, SOFT, FIRM, HARD, HARDER, HARDEST = range(8)

# Positions in Mesh.count.
(
    TRIANGLES,
    VERTICES,
    FREE_TRIANGLES,
    FREE_VERTICES,
    LOG_T,
    LOG_V,
    RECORDING,
    LOST_T,
    LOST_V,
    EPOCH,
    MANNER,
    MODEL,
    HEIGHTS,
) = range(13)


# Journal and scratch, which mean nothing between two changes.
PASSING = {
    "log_ti", "log_tf", "log_vi", "log_vf", "lost_t", "lost_v", "ring", "work", "hole_i", "hole_f",
}  # fmt: skip


@by_reference
class Mesh(NamedTuple):
    """Arrays of a mesh in local coordinates; slots beyond ``count`` are spare."""

    x: NDArray[np.float64]  # (v,)
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    w: NDArray[np.float64]  # (v,) height above the surface; may differ from 0 where count[HEIGHTS]
    jet: NDArray[np.float64]  # (v, 5) f_x, f_y, f_xx, f_xy, f_yy, where count[MODEL] is on
    share: NDArray[np.float64]  # (v,) factor of errors nearby; 1 but in exchanges and repairs
    kind: NDArray[np.int8]  # FREE, SLIDES along its side, FIXED, GONE; with HELD on top
    side: NDArray[np.int64]  # row of ``sides`` on which a sliding vertex lies
    v2t: NDArray[np.int64]  # one triangle of each vertex
    tv: NDArray[np.int64]  # (t, 3) vertices; -1 in the first for a spare slot
    tn: NDArray[np.int64]  # (t, 3) neighbours
    wall: NDArray[np.uint8]  # (t, 3) 1 where the edge must stay; with SEAM on top
    ee: NDArray[np.float64]  # (t, 3) signed largest error of each edge
    ep: NDArray[np.float64]  # (t, 3) where along the edge
    ie: NDArray[np.float64]  # (t,) signed largest error inside
    ix: NDArray[np.float64]
    iy: NDArray[np.float64]
    mark: NDArray[np.int64]  # (t,) equal to count[EPOCH] where already seen in a walk
    sides: NDArray[np.float64]  # (s, 4) segments on which vertices slide
    spare_t: NDArray[np.int64]  # stacks of spare slots
    spare_v: NDArray[np.int64]
    count: NDArray[np.int64]  # type: ignore[assignment]  # hides tuple.count, which is not used
    log_ti: NDArray[np.int64]  # journal: triangle, vertices, neighbours, walls
    log_tf: NDArray[np.float64]  # errors
    log_vi: NDArray[np.int64]  # vertex, kind, side, triangle
    log_vf: NDArray[np.float64]  # position, height above the surface, jet
    lost_t: NDArray[np.int64]  # slots given up while recording
    lost_v: NDArray[np.int64]
    ring: NDArray[np.int64]  # (4, 512) scratch: vertices, triangles and indices of a star; a copy
    work: NDArray[np.float64]  # (9, 1024) scratch: a star's tentative errors, spokes and insides
    hinge: NDArray[np.float64]  # (1,) errors below it cost nothing (``energy.penalty``)
    hole_i: NDArray[np.int64]  # (3, 64, 24) scratch of vertex removal
    hole_f: NDArray[np.float64]  # (4, 24, 24)


def build(
    points: NDArray[np.float64],
    triangles: NDArray[np.int64],
    kind: NDArray[np.int8],
    side: NDArray[np.int64],
    sides: NDArray[np.float64],
    walls: NDArray[np.int64] | None = None,
    room: float = 1.0,
) -> Mesh:
    """A mesh from points (n, 3), counter-clockwise triangles (m, 3) and vertex kinds.

    ``walls`` (c, 2) are inner edges that must stay; ``room`` is the share of spare slots.
    """
    n, m = len(points), len(triangles)
    nv, nt = int((1 + room) * n) + 1000, int((1 + room) * m) + 2000

    def padded(a: NDArray[np.float64], size: int) -> NDArray[np.float64]:
        out = np.zeros(size)
        out[: len(a)] = a
        return out

    kinds, side_of = np.full(nv, GONE, np.int8), np.zeros(nv, np.int64)
    kinds[:n], side_of[:n] = kind, side
    tv, tn = np.full((nt, 3), -1, np.int64), np.full((nt, 3), -1, np.int64)
    tv[:m] = triangles
    first = np.concatenate([[0], np.cumsum(np.bincount(triangles.ravel(), minlength=n))])
    _link(tv[:m], first[:-1].copy(), first, np.zeros(3 * m, np.int64), tn)
    wall = np.zeros((nt, 3), np.uint8)
    if walls is not None and len(walls):
        start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
        low, high = np.minimum(start, end), np.maximum(start, end)
        kept = np.sort(walls.min(1) * n + walls.max(1))
        found = np.minimum(np.searchsorted(kept, low * n + high), len(kept) - 1)
        wall[:m] = (kept[found] == low * n + high).reshape(m, 3)
    v2t = np.full(nv, -1, np.int64)
    v2t[triangles.ravel()] = np.repeat(np.arange(m, dtype=np.int64), 3)
    count = apart(np.zeros(13, np.int64))
    count[TRIANGLES], count[VERTICES] = m, n
    log = 20_000
    return Mesh(
        padded(points[:, 0], nv), padded(points[:, 1], nv), padded(points[:, 2], nv),
        np.zeros(nv),
        np.zeros((nv, 5)), np.ones(nv),
        kinds, side_of, v2t, tv, tn, wall,
        np.zeros((nt, 3)), np.zeros((nt, 3)), np.zeros(nt), np.zeros(nt), np.zeros(nt),
        np.zeros(nt, np.int64), np.ascontiguousarray(sides, float),
        np.zeros(nt, np.int64), np.zeros(nv, np.int64), count,
        np.zeros((log, 10), np.int64), np.zeros((log, 9)),
        np.zeros((log, 4), np.int64), np.zeros((log, 9)),
        np.zeros(log, np.int64), np.zeros(log, np.int64),
        np.zeros((4, 512), np.int64), np.zeros((9, 1024)), np.array([0.985]),
        np.zeros((3, 64, 24), np.int64), np.zeros((4, 24, 24)),
    )  # fmt: skip


@compiled
def _link(triangles, free, first, leaving, tn):
    """Neighbours (t, 3) by buckets of the sides that leave each vertex.

    ``first`` (v + 1,) are the buckets' bounds in ``leaving`` (3 t,), and ``free`` (v,) their
    beginnings once more; the last two are written over.
    """
    for t in range(triangles.shape[0]):
        for k in range(3):
            v = triangles[t, k]
            leaving[free[v]] = 3 * t + k
            free[v] += 1
    for t in range(triangles.shape[0]):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            for i in range(first[b], first[b + 1]):
                u, j = leaving[i] // 3, leaving[i] % 3
                if triangles[u, (j + 1) % 3] == a:
                    tn[t, k] = u
                    break


def compact(
    mesh: Mesh,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int8], NDArray[np.int64]]:
    """Points (n, 3), triangles (m, 3), kind (n,) and side (n,) without the spare slots."""
    live_t = mesh.tv[:, 0] >= 0
    triangles = mesh.tv[live_t].astype(np.int64)
    live_v = mesh.kind != GONE
    index = np.cumsum(live_v) - 1
    points = np.stack([mesh.x[live_v], mesh.y[live_v], mesh.z[live_v]], 1)
    return points, index[triangles], mesh.kind[live_v], mesh.side[live_v]


def movable(mesh: Mesh) -> NDArray[np.int64]:
    """The vertices that may move and go."""
    return np.asarray(np.flatnonzero((mesh.kind == FREE) | (mesh.kind == SLIDES)))


def triangles_in(mesh: Mesh) -> int:
    """How many triangles a mesh has."""
    return int((mesh.tv[:, 0] >= 0).sum())


def is_wide(mesh: Mesh) -> bool:
    """Whether a mesh is so large that strain has where to go (``anneal.press``)."""
    return triangles_in(mesh) >= WIDE


def copied(mesh: Mesh) -> Mesh:
    """The same mesh in arrays of its own, but for journal and scratch.

    So no two of them may change at once.
    """
    own = {name: part.copy() for name, part in _kept(mesh)}
    return mesh._replace(**own | {"count": apart(mesh.count)})


def restore(mesh: Mesh, kept: Mesh) -> None:
    """Make the mesh in place what another with as many slots is."""
    for name, part in _kept(mesh):
        np.copyto(part, getattr(kept, name))


def _kept(mesh: Mesh) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays that mean something between two changes."""
    for name, part in mesh._asdict().items():
        if name not in PASSING:
            yield name, part


def enlarged(mesh: Mesh) -> Mesh:
    """The same mesh with twice the slots."""
    grown = {}
    for name in ("tv", "tn", "wall", "ee", "ep", "ie", "ix", "iy", "spare_t", "mark"):
        old = getattr(mesh, name)
        new = np.zeros((2 * old.shape[0], *old.shape[1:]), old.dtype)
        if name in ("tv", "tn"):
            new[:] = -1
        new[: len(old)] = old
        grown[name] = new
    for name in ("x", "y", "z", "w", "jet", "share", "kind", "side", "v2t", "spare_v"):
        old = getattr(mesh, name)
        new = np.full((2 * len(old), *old.shape[1:]), GONE if name == "kind" else 0, old.dtype)
        new[: len(old)] = old
        grown[name] = new
    return mesh._replace(**grown)
