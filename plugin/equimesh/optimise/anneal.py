"""Annealing: vertices come, go and move until a smooth energy of all errors is low.

Where the metric is curved a lattice must have dislocations, and one laid along geodesics has them
in long seams. The energy ``sum e^p + mu * triangles`` (edges count half from each side) favours
crystals: its power spreads strain over many triangles, and the price of a triangle makes an error
of 1 the best one. The steps are those of a grand canonical ensemble at temperature zero: all
vertices move together and edges flip until nothing gives, then single vertices are exchanged. The
power rises on the way, since in the end only the largest error counts.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled, inlined
from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import evaluate_all, penalty, worst_around
from equimesh.optimise.flips import flip_all
from equimesh.optimise.mesh import (
    EPOCH,
    FIRM,
    FREE,
    HARD,
    HARDER,
    HARDEST,
    HEIGHTS,
    LOG_T,
    MANNER,
    SETTLE,
    SLIDES,
    SOFT,
    TRIANGLES,
    WIDE,
    Mesh,
    is_wide,
    movable,
    triangles_in,
)
from equimesh.optimise.newton import relax_together
from equimesh.optimise.parts import in_parts
from equimesh.optimise.relax import Queue, clear, push, push_star, relax
from equimesh.optimise.removal import remove_vertex
from equimesh.optimise.sweep import (
    relax_everything,
    split_at_worst,
    vertex_waste,
)
from equimesh.optimise.topology import begin, commit, rollback, room_left, stamp_touched

__all__ = [
    "VISITS", "anneal", "bowls", "exchange", "exchange_all", "exchange_once", "press", "relief",
    "shares",
]  # fmt: skip

# For each power p: (p - 1) times the energy of a lattice triangle of error 1, in the mean of the
# convex and the saddle lattice. Then an error of 1 has the least energy in a given area.
_PRICE = {SOFT: 7.0, FIRM: 28.0, HARD: 58.0}
VISITS = 60  # of vertices around an exchange of a mesh that was annealed
_OFF = 1.0  # triangles too few or too many around a vertex that make an exchange worth a trial
# Energy above what would pay, in prices of a triangle, that removals and insertions which are kept
# still have after a fifth of the visits, and by what it falls in the next fifths (a thousand trials
# on four functions).
_HOPE_OUT, _HOPE_IN, _FALL = 9.0, 1.0, 1 / 3
_TRIED = 0.2  # of an exchange's visits, at least, are made
_STEPS = 8  # of all vertices between rounds of flips
_ROUNDS = 2  # of exchanges
# Flips for each triangle below which steps of all vertices no longer matter, in small meshes and in
# wide ones, where much strain is left if they end too soon.
_LASTING, _LASTING_WIDE = 1e-2, 1e-3
_PATIENCE = 40  # rounds of steps and flips, at most
_LAST = 0.97  # the least error to anneal for in the end
# Where a surface is convex or concave one crystal fills it, with hardly a dislocation: its errors
# may be this large while others are still annealed for less, in small meshes and wide.
_CRYSTAL, _CRYSTAL_WIDE = 0.97, 0.99


@compiled
def _energy(m, e0, e1, e2, inner):
    return 0.5 * (penalty(m, e0) + penalty(m, e1) + penalty(m, e2)) + penalty(m, inner)


@compiled
def _energy_change(m):
    """Energy of the journal's triangles now, less what it was."""
    m.count[EPOCH] += 1
    epoch = m.count[EPOCH]
    total = 0.0
    for i in range(m.count[LOG_T]):
        t = m.log_ti[i, 0]
        if m.mark[t] != epoch:
            m.mark[t] = epoch
            if m.log_ti[i, 1] >= 0:
                old = m.log_tf[i]
                total -= _energy(m, old[0], old[1], old[2], old[6])
            if m.tv[t, 0] >= 0:
                total += _energy(m, m.ee[t, 0], m.ee[t, 1], m.ee[t, 2], m.ie[t])
    return total


@inlined
def _pays(F, m, tol, q, visits, price, triangles):
    """Whether the neighbourhood, relaxed, has less energy than that of what the change saves.

    What is far from it after some of the visits never gets there: then the rest are not made.
    """
    done, hope = 0, (_HOPE_OUT if triangles < 0 else _HOPE_IN) * price
    while done < visits:
        made = relax(F, m, tol, q, visits // 5, 12)
        if made == 0:
            break
        done += made
        if _energy_change(m) + price * triangles > hope:
            return False
        hope *= _FALL
    return _energy_change(m) + price * triangles < 0.0


@compiled
def _exchange(F, m, tol, q, candidates, waste, visits, stamp, number, price):
    """Remove each candidate whose waste is positive, or insert beside it; keep what pays.

    A triangle costs ``price``. Vertices around what was kept get the stamp ``number``. Returns how
    many changes were kept.
    """
    kept = 0
    for i in range(candidates.shape[0]):
        v = candidates[i]
        if (m.kind[v] != FREE and m.kind[v] != SLIDES) or not room_left(m):
            continue
        begin(m)
        clear(q)
        if waste[i] > 0.0:
            triangles = -2 if push_star(m, q, v) else -1
            if remove_vertex(F, m, tol, v, 1e30) < 0.0:
                rollback(m)
                continue
        else:
            v = split_at_worst(F, m, tol, worst_around(m, v))
            if v < 0:
                rollback(m)
                continue
            push(q, v)
            triangles = 2 if push_star(m, q, v) else 1
        if _pays(F, m, tol, q, visits, price, triangles):
            stamp_touched(m, stamp, number)
            commit(m)
            kept += 1
        else:
            rollback(m)
    return kept


def anneal(
    field: KernelField, mesh: Mesh, tol: float, error: float, queue: Queue, visits: int
) -> None:
    """From a lattice to crystals with few dislocations, for ``error`` (units of ``tol``) at first.

    As the power rises the errors come closer together, and their mean may come closer to ``tol``.
    ``visits``: how many moves of vertices around an exchange may make it pay.
    """
    mesh.count[MANNER] = SOFT
    mesh.share[:] = shares(mesh, error)
    evaluate_all(field, mesh, error * tol)
    flip_all(field, mesh, error * tol, 50)
    relax_everything(field, mesh, error * tol, queue, 10)
    mesh.count[MANNER] = SETTLE
    for manner, aim in ((SOFT, error), (FIRM, max(error, _LAST))):
        exchange(field, mesh, tol, aim, queue, visits, manner)


def exchange(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    error: float,
    queue: Queue,
    visits: int,
    manner: int = FIRM,
    briefly: bool = False,
) -> None:
    """Rounds of exchanges for ``error`` in one manner, all vertices relaxed before and after.

    ``visits``: how many moves of vertices around an exchange may make it pay. ``briefly``: see
    ``exchange_all``.
    """
    mesh.share[:] = shares(mesh, error)
    exchange_all(field, mesh, error * tol, queue, visits, manner, briefly)
    mesh.share[:] = 1.0


def exchange_all(
    field: KernelField,
    mesh: Mesh,
    aim: float,
    queue: Queue,
    visits: int,
    manner: int,
    briefly: bool = False,
) -> None:
    """The same with the shares that the mesh has, for an error in units of z.

    ``briefly``: a wide mesh is relaxed no longer than a small one, for strain ends near by.
    """
    lasting = _LASTING_WIDE if is_wide(mesh) and not briefly else _LASTING
    mesh.count[MANNER] = manner
    evaluate_all(field, mesh, aim)
    _give_way(field, mesh, aim, lasting)
    stamp = np.zeros(len(mesh.x), np.int64)
    for number in range(1, _ROUNDS + 1):
        if exchange_once(field, mesh, aim, queue, visits, stamp, number) == 0:
            break
    _give_way(field, mesh, aim, lasting)
    mesh.count[MANNER] = SETTLE


def exchange_once(
    field: KernelField,
    mesh: Mesh,
    aim: float,
    queue: Queue,
    visits: int,
    stamp: NDArray[np.int64],
    number: int,
    off: float = _OFF,
) -> int:
    """One pass in the mesh's manner over the vertices whose ``stamp`` (v,) is the last pass's.

    ``off``: triangles too few or too many around a vertex that make an exchange worth a trial.
    Vertices around what was kept get the stamp ``number``. Returns how many changes were kept.
    """
    candidates = movable(mesh)
    candidates = candidates[stamp[candidates] == number - 1]
    waste = vertex_waste(field, mesh, aim, candidates)
    chosen = np.flatnonzero(np.abs(waste) > off)
    order = chosen[np.argsort(-np.abs(waste[chosen]), kind="stable")]
    price = _PRICE[int(mesh.count[MANNER])]
    candidates, waste = candidates[order], waste[order]

    def work(mesh: Mesh, queue: Queue, rows: NDArray[np.int64]) -> int:
        return int(
            _exchange(
                field, mesh, aim, queue, candidates[rows], waste[rows], visits, stamp, number, price
            )
        )

    return in_parts(mesh, queue, candidates, work, _TRIED * visits)


def relief(error: float, two_sided: bool, triangles: float) -> float:
    """How many times larger than ``error`` errors may be where the surface is convex or concave.

    ``two_sided``: vertices may leave the surface; then they are all alike. ``triangles``: of the
    mesh.
    """
    largest = _CRYSTAL_WIDE if triangles >= WIDE else _CRYSTAL
    return 1.0 if two_sided else max(1.0, largest / error)


def shares(mesh: Mesh, error: float) -> NDArray[np.float64]:
    """(v,) by what errors near a vertex are multiplied in an exchange for ``error``: by less than 1
    where the surface is convex or concave there, as far as ``relief`` goes."""
    most = relief(error, bool(mesh.count[HEIGHTS]), triangles_in(mesh))
    return np.where(bowls(mesh), 1.0 / most, 1.0)


def bowls(mesh: Mesh) -> NDArray[np.bool_]:
    """(v,) whether the surface is convex or concave at each vertex."""
    _, _, xx, xy, yy = mesh.jet.T
    return np.asarray(xx * yy > xy * xy)


def press(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    rounds: tuple[int, int, int],
    enough: float | None = None,
) -> None:
    """Lower the largest errors as far as moves and flips alone can.

    In up to so many ``rounds`` at each of three powers. The second and the third, which bring the
    errors around dislocations close to all others, are for wide meshes. A power ends when nothing
    flips; with ``enough``, a share of the energy, only when no step lowers it by that either.
    """
    for manner, most in zip((HARD, HARDER, HARDEST), rounds, strict=True):
        if manner != HARD and not is_wide(mesh):
            break
        mesh.count[MANNER] = manner
        for _ in range(most):
            steps = relax_together(field, mesh, tol, _STEPS, enough)
            if flip_all(field, mesh, tol, 50) == 0 and (enough is None or steps < _STEPS):
                break
    mesh.count[MANNER] = SETTLE


def _give_way(field: KernelField, mesh: Mesh, tol: float, lasting: float) -> None:
    """Steps of all vertices and flips in turn until no more than ``lasting`` of a triangle flip."""
    for _ in range(_PATIENCE):
        relax_together(field, mesh, tol, _STEPS)
        if flip_all(field, mesh, tol, 50) <= lasting * mesh.count[TRIANGLES]:
            break
