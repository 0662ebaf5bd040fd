"""Wide meshes, all of whose errors are near the tolerance, brought closer to it.

Their largest errors are at dislocations, where no exchange that must pay at once, and no pressing,
brings them down. Vertices inserted there do, and make slack that vertices pay for which go
elsewhere. What is above the tolerance by a little, over whole regions, takes none: pressed closely
enough it comes down, or the next exchange is for lower errors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.kernel import KernelField
from equimesh.optimise.anneal import VISITS, bowls, exchange_all, press
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.flips import flip_all
from equimesh.optimise.mending import FEW, insert_at, lower_errors, violated
from equimesh.optimise.mesh import FIXED, HARD, Mesh, triangles_in
from equimesh.optimise.regions import expected, largest_around
from equimesh.optimise.relax import Queue
from equimesh.optimise.sweep import split_borders
from equimesh.optimise.trials import mending_round
from equimesh.stages import Report

__all__ = ["close", "tighten"]

# Errors that vertices are exchanged for, in units of the tolerance: high ones at first, for what
# can go. Then the last, and from it such that nearly all errors come to keep the tolerance: those
# where the surface is convex or concave, which hardly any dislocation disturbs, and all others.
_AIMS = (1.1, 1.06, 1.03, 1.01)
_LOWEST, _HIGHEST = 0.98, 1.15
# By what power they follow what nearly all errors are off by: in a crystal an exchange finds room
# at the rim alone.
_EAGER = np.array([4.0, 2.0])
_FEWEST, _ROUNDS = 5, 12  # rounds, and at most so many: the more while much is violated
# Where there is little time: as if after so many rounds, before so many, and for what at first.
_HURRIED, _HURRIED_AIM = (4, 6), 1.0
_NEARLY, _LEVEL = 0.99, 1.0005  # share of the errors that are to be below that
_KNOWN = 500  # triangles of a kind from which on that share is known
_OUTLIERS = (1.02, 1.02, 1.02, 1.01)  # errors above these are at dislocations; the last repeats
_WORST = 0.02  # of the triangles: vertices are inserted in so many. In more it is strain from afar.
_SETTLED = 0.005  # of the triangles: as long as more are violated nobody knows what that takes
# Rounds of pressing while much is still to change, and then; they end with steps that gain little.
_PRESSES, _PRESSES_LAST, _ENOUGH = (1, 2, 2), (1, 3, 6), 1e-4
_PRESSES_HURRIED = (1, 3, 3)  # which end where nothing flips
# Weights of errors: how far they go, and in a round; by what power they follow the mean, of this
# power, of the errors around a vertex; larger ones than the last are no question of forces.
_LEAST, _MOST, _STEP = 0.9, 1.1, 0.01
_GENTLY, _POWER, _ROUGH = 0.8, 192, 1.03
# What is left in the end: rounds, of which the first mend nothing, how weights follow what exceeds
# 1, up to a step, what is mended (errors above the first, and at least such a share of the
# triangles), and pressing before, until steps gain hardly anything.
_CLOSING, _PATIENT, _FIRMLY, _STEP_LAST = 8, 3, 2.0, 5e-3
_APART, _SINGLE = 1.003, 1e-3
_PRESSES_CLOSING, _ENOUGH_CLOSING = (0, 0, 6), 1e-5


def tighten(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    queue: Queue,
    goal: float,
    report: Report,
    narrow: bool = False,
    hurried: bool = False,
) -> tuple[Mesh, Queue]:
    """Vertices to dislocations that lack them, then from wherever slack comes together, in turn.

    Until hardly anything is violated after a few rounds, or in a mesh that promises at most
    ``goal`` triangles. Errors get weights on the way, so that they come to be alike. ``narrow``:
    what can move are bands, in which nothing spreads far, so that everything violated asks for a
    vertex, and no weights; ``hurried``: in two rounds for the last errors alone. Returns the mesh
    (enlarged where it had to be) and a queue for it. The mesh has Hermite's errors.
    """
    first, last = _HURRIED if hurried else (0, _ROUNDS)
    aims = np.full(2, _HURRIED_AIM if hurried else _AIMS[0])
    weight = np.ones(len(mesh.x))
    for number in range(first, last):
        count, over = triangles_in(mesh), len(violated(mesh))
        if over < _SETTLED * count and (number >= _FEWEST or expected(mesh) <= goal):
            break
        if over < FEW * count:
            mending_round(field, mesh, tol, queue, violated(mesh))
        else:
            least = 1.0 if narrow else _OUTLIERS[min(number, len(_OUTLIERS) - 1)]
            worst = violated(mesh, least)[: int(_WORST * count)]
            mesh, queue, _ = insert_at(field, mesh, tol, queue, worst)
            weight = _lengthened(weight, mesh)
        early = number < len(_AIMS) - 1
        _exchange(field, mesh, tol, aims, weight, queue, narrow)
        presses = _PRESSES if early else _PRESSES_LAST
        if hurried:
            presses = _PRESSES_HURRIED
        _press_weighed(field, mesh, tol, weight, presses, None if hurried else _ENOUGH)
        if not narrow and number >= len(_AIMS) - 2:
            weight = _weighed(mesh, weight)
        if early:
            aims[:] = _AIMS[number + 1]
        else:
            aims = np.clip(aims * (_LEVEL / _levels(mesh)) ** _EAGER, _LOWEST, _HIGHEST)
        report((number + 1 - first) / (last - first))
    return mesh, queue


def close(field: KernelField, mesh: Mesh, tol: float, queue: Queue, hurried: bool = False) -> Mesh:
    """The tightened mesh (enlarged where it had to be) without what is violated in it.

    Pressing does for most, with weights that grow where it does not, and a vertex for each would be
    too many: only the worst are mended, and only in the end. ``hurried``: all are mended at once.
    """
    split_borders(field, mesh, tol)
    flip_all(field, mesh, tol, 50)
    weight = np.ones(len(mesh.x))
    for number in range(0 if hurried else _CLOSING):
        if len(violated(mesh)) == 0:
            break
        _press_weighed(field, mesh, tol, weight, _PRESSES_CLOSING, _ENOUGH_CLOSING)
        if number >= _PATIENT:
            least = int(_SINGLE * triangles_in(mesh))
            worst = max(violated(mesh, _APART), violated(mesh)[:least], key=len)
            mending_round(field, mesh, tol, queue, worst)
            mesh, queue, _ = insert_at(field, mesh, tol, queue, worst)
            weight = _lengthened(weight, mesh)
        weight = np.clip(weight * _excess_around(mesh) ** _FIRMLY, _LEAST, _MOST)
    return lower_errors(field, mesh, tol, queue)


def _press_weighed(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    weight: NDArray[np.float64],
    presses: tuple[int, int, int],
    enough: float | None,
) -> None:
    """Press with errors multiplied by ``weight`` (v,); then they are what they are."""
    mesh.share[:] = weight
    evaluate_all(field, mesh, tol)
    press(field, mesh, tol, presses, enough)
    mesh.share[:] = 1.0
    evaluate_all(field, mesh, tol)


def _lengthened(weight: NDArray[np.float64], mesh: Mesh) -> NDArray[np.float64]:
    """(v,) the weights where the mesh was enlarged."""
    return np.concatenate([weight, np.ones(len(mesh.x) - len(weight))])


def _excess_around(mesh: Mesh) -> NDArray[np.float64]:
    """(v,) largest error of a triangle around each vertex; 1 where it keeps the tolerance."""
    over = violated(mesh)
    worst = np.minimum(worst_errors(mesh)[over], 1.0 + _STEP_LAST)
    largest = np.ones(len(mesh.x))
    np.maximum.at(largest, mesh.tv[over], worst[:, None])
    return largest


def _exchange(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    aims: NDArray[np.float64],
    weight: NDArray[np.float64],
    queue: Queue,
    briefly: bool,
) -> None:
    """Exchange vertices for the first of two errors in bowls and for the second elsewhere.

    Errors are multiplied by ``weight`` (v,), and those stored are as they were priced.
    """
    bowl, other = aims
    mesh.share[:] = np.where(bowls(mesh), other / bowl, weight)
    exchange_all(field, mesh, other * tol, queue, VISITS, HARD, briefly)


def _weighed(mesh: Mesh, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """(v,) the next weights of errors: larger where those around a vertex are, for the last.

    The forces of dislocations differ by more than any power can even out: these are the multipliers
    of Lagrange that do (Tseng and Bertsekas 1993). Bowls have theirs from their own aim.
    """
    worst = worst_errors(mesh)
    around = largest_around(mesh, np.minimum(worst, _ROUGH), _POWER, 1)
    there = around > 0.0
    off = np.where(there, around, 1.0) / np.median(around[there])
    step = np.clip(off, 1.0 - _STEP, 1.0 + _STEP) ** _GENTLY
    next_ = np.clip(weight * step, _LEAST, _MOST)
    return np.asarray(np.where(there & ~bowls(mesh), next_, 1.0))


def _levels(mesh: Mesh) -> NDArray[np.float64]:
    """(2,) what nearly all errors in bowls, and nearly all others, are below.

    Where there are too few triangles to tell, as it ought to be.
    """
    corners = mesh.tv[: mesh.count[0]]
    moves = (corners[:, 0] >= 0) & (mesh.kind[corners] != FIXED).any(1)
    corners, worst = corners[moves], worst_errors(mesh)[: len(moves)][moves]
    bowl = bowls(mesh)[corners].sum(1) >= 2
    return np.array([_level(worst[bowl]), _level(worst[~bowl])])


def _level(errors: NDArray[np.float64]) -> float:
    return float(np.quantile(errors, _NEARLY)) if len(errors) >= _KNOWN else _LEVEL
