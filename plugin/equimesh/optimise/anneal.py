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

from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.exchange import exchange_once
from equimesh.optimise.flips import flip_all
from equimesh.optimise.mesh import (
    FIRM,
    HARD,
    HARDER,
    HARDEST,
    HEIGHTS,
    MANNER,
    SETTLE,
    SOFT,
    TRIANGLES,
    WIDE,
    Mesh,
    is_wide,
    triangles_in,
)
from equimesh.optimise.newton import relax_together
from equimesh.optimise.relax import Queue
from equimesh.optimise.sweep import relax_everything
from equimesh.stages import Report

__all__ = [
    "VISITS", "anneal", "bowls", "exchange", "exchange_all", "heat", "press", "relief", "shares",
]  # fmt: skip

VISITS = 60  # of vertices around an exchange of a mesh that was annealed
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
# Passes in the heat, what it is at first (at .3 strips become grains, at 1 crystals melt), and
# triangles too few or too many around a vertex that make an exchange worth a trial.
_PASSES, _HOTTEST, _OFF_HOT = 30, 0.12, 0.5


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


def heat(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    error: float,
    queue: Queue,
    report: Report,
) -> None:
    """Passes of exchanges at the lowest power and a temperature that falls.

    Dislocations of a large mesh are far from where they cost least, and each step on the way would
    have to pay.
    """
    mesh.share[:] = shares(mesh, error)
    aim, unseen = error * tol, np.zeros(len(mesh.x), np.int64)
    mesh.count[MANNER] = SOFT
    evaluate_all(field, mesh, aim)
    _give_way(field, mesh, aim, _LASTING_WIDE)
    for number in range(_PASSES):
        now = _HOTTEST * (1.0 - number / _PASSES)
        unseen[:] = number
        exchange_once(field, mesh, aim, queue, VISITS, unseen, number + 1, _OFF_HOT, now)
        relax_together(field, mesh, aim, _STEPS)
        flip_all(field, mesh, aim, 50)
        report((number + 1) / _PASSES)
    _give_way(field, mesh, aim, _LASTING_WIDE)
    mesh.count[MANNER] = SETTLE
    mesh.share[:] = 1.0


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
