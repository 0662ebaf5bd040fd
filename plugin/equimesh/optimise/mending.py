"""Violations of the tolerance mended: moved away where they are few, or vertices inserted there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.greedy import refine
from equimesh.optimise.mesh import MANNER, SETTLE, SPREAD, Mesh, enlarged, is_wide, triangles_in
from equimesh.optimise.relax import Queue, make_queue
from equimesh.optimise.sweep import insert_round, relax_all, split_listed
from equimesh.optimise.trials import mending_round

__all__ = [
    "FEW",
    "STRAINED",
    "insert_at",
    "insert_greedily",
    "lower_errors",
    "mended",
    "repair",
    "spread",
    "violated",
]

FEW = 0.01  # of the triangles: no more violations are mended place by place
STRAINED = 16  # moves of each vertex that strain is evened out by
_INSERTIONS = 39  # rounds of insertion at most
# By how much more than they were underestimated errors beside them are raised.
_BESIDE = 1e-4
_LOUDEST = 2.0  # share by which errors are multiplied, at most, where they were underestimated


def repair(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    slots: NDArray[np.int64],
    errors: NDArray[np.float64],
) -> Mesh:
    """Mend the triangles in ``slots``, whose ``errors`` a closer look found too large.

    ``errors`` in units of the tolerance. From now on errors at their corners count for as much
    more; a triangle that yet seems to keep the tolerance is split.
    """
    if _room(mesh) < 8 * len(slots) + 1000:
        mesh = enlarged(mesh)
    corners = mesh.tv[slots]
    moved = np.zeros(len(mesh.x), np.uint8)
    moved[corners] = 1
    louder = mesh.share[corners] * (errors[:, None] + _BESIDE)
    np.maximum.at(mesh.share, corners, louder.clip(1.0, _LOUDEST))
    evaluate_all(field, mesh, tol, moved)
    queue = make_queue(len(mesh.x))
    split_listed(field, mesh, tol, queue, slots[worst_errors(mesh)[slots] <= 1.0])
    return mended(field, mesh, tol, queue)


def mended(field: KernelField, mesh: Mesh, tol: float, queue: Queue) -> Mesh:
    """The mesh with its few violations of true errors moved away, or vertices inserted there."""
    relax_all(field, mesh, tol, queue, 40)
    return lower_errors(field, mesh, tol, queue)


def spread(field: KernelField, mesh: Mesh, tol: float, queue: Queue, moves: int) -> None:
    """Relax around every violation so that it may spread, by so many moves of each vertex."""
    mesh.count[MANNER] = SPREAD
    relax_all(field, mesh, tol, queue, moves)
    mesh.count[MANNER] = SETTLE


def lower_errors(
    field: KernelField, mesh: Mesh, tol: float, queue: Queue, closely: bool = True
) -> Mesh:
    """Insert vertices until no error exceeds ``tol``.

    ``closely``: a few violations are mended place by place, for where all errors are near the
    tolerance each vertex simply inserted pushes its neighbours above it. Many, and what is left,
    get vertices a few far apart at a time. Flips may push each new vertex aside again: then greedy
    insertion must break the circle, in a wide mesh after what is violated has spread.
    """
    fewest, stalled = len(mesh.tv), 0
    closely = closely and field.kind == PATCHES
    for _ in range(_INSERTIONS):
        order = violated(mesh)
        if closely and 0 < len(order) <= FEW * triangles_in(mesh):
            mending_round(field, mesh, tol, queue, order)
            order = violated(mesh)
        if len(order) == 0:
            return mesh
        stalled = 0 if len(order) < fewest else stalled + 1
        fewest = min(fewest, len(order))
        if stalled > 3:
            break
        mesh, queue, made = insert_at(field, mesh, tol, queue, order)
        relax_all(field, mesh, tol, queue, 12)
        if made == 0:
            break
    if is_wide(mesh):
        spread(field, mesh, tol, queue, STRAINED)
    return insert_greedily(field, mesh, tol)


def violated(mesh: Mesh, error: float = 1.0) -> NDArray[np.int64]:
    """Triangles with an error above the tolerance, or so many times that, the worst first."""
    worst = worst_errors(mesh)
    found = np.flatnonzero(worst > error)
    return np.asarray(found[np.argsort(-worst[found], kind="stable")])


def insert_at(
    field: KernelField, mesh: Mesh, tol: float, queue: Queue, order: NDArray[np.int64]
) -> tuple[Mesh, Queue, int]:
    """A vertex at the worst of each cluster of violated triangles, and the moves they ask for.

    ``order``: these triangles, the worst first. Returns the mesh, enlarged where it had to be, a
    queue for it, and how many were inserted.
    """
    if _room(mesh) < 4 * len(order):
        mesh = enlarged(mesh)
        queue = make_queue(len(mesh.x))
    stamp = np.zeros(len(mesh.x), np.int64)
    return mesh, queue, int(insert_round(field, mesh, tol, queue, stamp, 1, order, 60))


def insert_greedily(field: KernelField, mesh: Mesh, tol: float) -> Mesh:
    """Greedy insertion, in a larger mesh each time the slots run out.

    Data ask for at most a few triangles a sample; where a lattice was laid, for no more than a few
    times its number. Beyond that the surface has a jump, and the rest is left violated.
    """
    if field.kind == PATCHES:
        most = 3 * triangles_in(mesh)
    else:
        most = 8 * (field.grid.size + len(field.triangles))
    while True:
        scratch = 4 * len(mesh.tv) + 10_000
        keys = np.zeros(scratch)
        if refine(field, mesh, tol, np.zeros(scratch, np.int64), keys, most + 20_000):
            return mesh
        mesh = enlarged(mesh)


def _room(mesh: Mesh) -> int:
    """Spare slots for triangles and twice the vertices, whichever is less."""
    c = mesh.count
    return int(min(len(mesh.tv) - c[0], 2 * (len(mesh.x) - c[1])))
