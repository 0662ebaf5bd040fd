"""From a first mesh to one that keeps the tolerance with few triangles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.optimise.anneal import VISITS, anneal, exchange, heat, press
from equimesh.optimise.crystals import anneal_between
from equimesh.optimise.effort import EFFORTS
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.flips import flip_all
from equimesh.optimise.mending import (
    FEW,
    STRAINED,
    insert_greedily,
    lower_errors,
    mended,
    spread,
)
from equimesh.optimise.mesh import (
    EVEN,
    FREE,
    GONE,
    MANNER,
    MODEL,
    SETTLE,
    WIDE,
    Mesh,
    copied,
    is_wide,
    movable,
    triangles_in,
)
from equimesh.optimise.nested import Nested, settle
from equimesh.optimise.regions import even_out, expected
from equimesh.optimise.relax import Queue, make_queue
from equimesh.optimise.search import search_all
from equimesh.optimise.sweep import (
    lift_all,
    relax_all,
    relax_everything,
    split_borders,
    thin_out,
    vertex_waste,
    violations,
)
from equimesh.optimise.tighten import close, tighten
from equimesh.optimise.trials import removal_round
from equimesh.stages import Report, between

__all__ = [
    "between_crystals",
    "cycled",
    "draft",
    "finer_draft",
    "optimise",
    "seam_share",
]

# Hardly any removal succeeds around a vertex that could spare fewer triangles than the first; where
# there is but one round the second finds as many in less time.
_WORTH, _WORTH_ONCE = 1.5, 1.9
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)  # the aims of cycles follow a sequence that repeats none
_PRESSES = (4, 2, 2)  # rounds of pressing on Hermite's errors, which are cheap,
_AGAIN = (1, 1, 1)  # of a wide mesh that was pressed as hard just now,
_EVENING, _EVENING_FINER = (2, 1, 2), (1, 3, 0)  # and between rounds of regions
_AIMS = (0.93, 1.0)  # errors that cycles aim at, in units of the tolerance
_SMALL = 1_500  # triangles below which more trials of an exchange do not pay
_HEATED_FOR = 0.95  # error that is, and then as few rounds of regions begin with
# Where all errors are at the tolerance one vertex for a true error above it pushes others above it:
# these are tightened for a little less.
_SPARED = 0.9995
_LARGE = 50_000  # triangles of a lattice above which its bands must have more to gain
_IDLE = 20  # cycles without a gain after which there is no more
# Rounds of removal and visits on data, which have no Hermite's formula.
_ON_DATA = {"fast": (1, 12), "balanced": (3, 60), "best": (3, 60)}


@contextmanager
def modelled(field: KernelField, mesh: Mesh) -> Iterator[None]:
    """Within it errors are those of Hermite's formula wherever that is good (``model.py``)."""
    lift_all(field, mesh)
    mesh.count[MODEL] = 1
    yield
    mesh.count[MODEL] = 0


def seam_share(field: KernelField, mesh: Mesh, tol: float) -> float:
    """The share of triangles above the tolerance among those that do not touch the boundary."""
    with modelled(field, mesh):
        evaluate_all(field, mesh, tol)
        flip_all(field, mesh, tol, 50)
    n = int(mesh.count[0])
    inner = (mesh.kind[mesh.tv[:n]] == FREE).all(1) & (mesh.tv[:n, 0] >= 0)
    worst = worst_errors(mesh)[:n][inner]
    return float((worst > 1.0).mean()) if len(worst) else 0.0


def draft(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    effort: str,
    annealed: float | None,
    report: Report,
    least: float,
    finer: bool = False,
) -> Mesh:
    """A mesh with few triangles whose errors by Hermite's formula keep the tolerance.

    ``annealed``: error to anneal the mesh for at first; None leaves the lattice as it is laid.
    ``least``: N*; with 0 no number of triangles is good enough. ``finer``: the mesh is to be
    refined, so that single errors above the tolerance do not matter.
    """
    how = EFFORTS[effort]
    goal = how.promise(least)
    with modelled(field, mesh):
        if annealed is not None:
            queue = make_queue(len(mesh.x))
            anneal(field, mesh, tol, annealed, queue, how.trials)
            report(0.1)
            evened = _EVENING_FINER if finer else _EVENING

            def even(error: float, report: Report) -> None:
                trials = how.trials if triangles_in(mesh) < _SMALL else VISITS
                even_out(field, mesh, tol, error, queue, trials, how.evenings, evened, goal, report)

            even(annealed, between(report, 0.1, 0.3))
            if not finer and triangles_in(mesh) >= how.heated and expected(mesh) > goal:
                heat(field, mesh, tol, _HEATED_FOR, queue, between(report, 0.3, 0.45))
                even(_HEATED_FOR, between(report, 0.45, 0.6))
            report(0.6)
        if finer:
            return mesh
        evaluate_all(field, mesh, tol)
        wide = WIDE <= triangles_in(mesh) <= how.tightened
        if annealed is not None and wide and expected(mesh) > goal:
            less = _SPARED * tol
            evaluate_all(field, mesh, less)
            mesh, queue = tighten(field, mesh, less, queue, goal, between(report, 0.6, 0.9))
            mesh = close(field, mesh, less, queue)
            evaluate_all(field, mesh, tol)
            report(0.97)
            return _thinned(field, mesh, tol, effort, least)
        split_borders(field, mesh, tol)
        flip_all(field, mesh, tol, 50)
        if annealed is not None:
            again = how.evenings > 0 and is_wide(mesh)
            _even_strain(field, mesh, tol, _AGAIN if again else _PRESSES)
            report(0.9)
        return _completed(field, mesh, tol, effort, least, closely=annealed is not None)


def finer_draft(
    field: KernelField, mesh: Mesh, tol: float, how: Nested, report: Report, last: bool
) -> Mesh:
    """The draft for ``tol`` from one for four times as much whose triangles were cut in four.

    ``last``: the mesh is not to be refined again, so its errors must keep ``tol``.
    """
    with modelled(field, mesh):
        settle(field, mesh, tol, how.last if last else how.between, between(report, 0.0, 0.4))
        if not last:
            return mesh
        mesh = _closed(field, mesh, tol, make_queue(len(mesh.x)), how.thorough)
        report(0.95)
        if how.thorough and violations(mesh, 1.0)[0] == 0:
            _remove(field, mesh, tol, 1, VISITS, between(report, 0.95, 1.0))
        return mesh


def _closed(field: KernelField, mesh: Mesh, tol: float, queue: Queue, closely: bool) -> Mesh:
    """A large mesh, well pressed, made to keep the tolerance; ``closely``: see ``lower_errors``."""
    split_borders(field, mesh, tol)
    flip_all(field, mesh, tol, 50)
    return lower_errors(field, mesh, tol, queue, closely)


def cycled(
    field: KernelField, mesh: Mesh, tol: float, effort: str, least: float, most: int
) -> Mesh:
    """The best of a row of up to ``most`` drafts, each made from the best by exchanging vertices.

    Exchanges for an error near ``tol`` put vertices where errors are large and take them where
    there is slack, over all the mesh at once; pressing and repair make it keep ``tol`` again. The
    error differs from cycle to cycle, so that a mesh that did not get better is tried anew.
    ``least``: N*.
    """
    how = EFFORTS[effort]
    best, size, idle = mesh, triangles_in(mesh), 0
    for number in range(most):
        if size <= how.goal(least):
            break
        low, high = _AIMS
        error = low + (high - low) * math.fmod(_GOLDEN * (number + 1), 1.0)
        mesh = copied(best)
        with modelled(field, mesh):
            exchange(field, mesh, tol, error, make_queue(len(mesh.x)), how.visits)
            evaluate_all(field, mesh, tol)
            _even_strain(field, mesh, tol, _PRESSES)
            mesh = _completed(field, mesh, tol, effort, least, closely=True)
            good = violations(mesh, 1.0)[0] == 0
        idle += 1
        if good and triangles_in(mesh) <= size:
            if triangles_in(mesh) < size:
                idle = 0
            best, size = mesh, triangles_in(mesh)
        if idle > _IDLE:
            break
    return best


def between_crystals(
    field: KernelField, mesh: Mesh, tol: float, effort: str, least: float, report: Report
) -> Mesh:
    """A wide lattice with its bands between crystals annealed, where that leaves fewer triangles.

    ``least``: N*.
    """
    how, size = EFFORTS[effort], triangles_in(mesh)
    goal = how.goal(least, hurried=size > _LARGE)
    if how.tightened == 0 or not is_wide(mesh) or size <= goal:
        return mesh
    trial = copied(mesh)
    with modelled(field, trial):
        hurried = size > how.tightened
        trial = anneal_between(field, trial, tol, hurried, how.promise(least), report)
        trial = _thinned(field, trial, tol, effort, least)
        good = violations(trial, 1.0)[0] == 0
    return trial if good and triangles_in(trial) < size else mesh


def _pressed(field: KernelField, mesh: Mesh, tol: float, rounds: int) -> Mesh:
    """The mesh pressed, or as it was where that trades few violations for many slight ones."""
    before = violations(mesh, 1.0)[0]
    if rounds == 0 or before <= FEW * triangles_in(mesh):
        return mesh
    trial = copied(mesh)
    press(field, trial, tol, (rounds, rounds // 2, rounds // 2))
    return trial if violations(trial, 1.0)[0] < before else mesh


def _even_strain(field: KernelField, mesh: Mesh, tol: float, presses: tuple[int, int, int]) -> None:
    """Press and relax where strain may spread: in a mesh that is no settled lattice."""
    press(field, mesh, tol, presses)
    spread(field, mesh, tol, make_queue(len(mesh.x)), STRAINED)


def _completed(
    field: KernelField, mesh: Mesh, tol: float, effort: str, least: float, closely: bool
) -> Mesh:
    """Violations mended by moves and insertions; then vertices removed that can be spared.

    ``closely``: see ``lower_errors``; along the seams of lattices one vertex mends several.
    """
    queue = make_queue(len(mesh.x))
    relax_all(field, mesh, tol, queue, 40)
    mesh = lower_errors(field, mesh, tol, queue, closely)
    return _thinned(field, mesh, tol, effort, least)


def _thinned(field: KernelField, mesh: Mesh, tol: float, effort: str, least: float) -> Mesh:
    """Without the vertices that can be spared, as far as the effort goes."""
    if violations(mesh, 1.0)[0] == 0:
        for level, how in EFFORTS.items():  # what less effort removes goes first
            last = level == effort
            if not last or triangles_in(mesh) > how.goal(least):
                _remove(field, mesh, tol, how.rounds, how.visits, lambda _: None)
            if last:
                break
    return mesh


def optimise(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    effort: str,
    report: Report,
    most: float,
    least: float = 0.0,
) -> tuple[Mesh, bool]:
    """Bring every error of the mesh to at most ``tol``, then take out what is not needed.

    The search on data at ``best``, whose errors are exact, goes up to ``most``, a larger tolerance.
    ``least``: N*, see ``draft``.
    Returns the mesh (enlarged where it had to be) and whether every violation is gone.
    """
    how = EFFORTS[effort]
    evaluate_all(field, mesh, tol)
    rounds, visits = how.last_rounds, how.last_visits
    if field.kind == PATCHES:
        queue = make_queue(len(mesh.x))
        split_borders(field, mesh, tol)
        flip_all(field, mesh, tol, 50)
        mesh = _pressed(field, mesh, tol, how.presses)
        report(0.3)
        mesh = mended(field, mesh, tol, queue)
        if triangles_in(mesh) <= how.goal(least):
            rounds = 0
    else:
        rounds, visits = _ON_DATA[effort]
        mesh = insert_greedily(field, mesh, tol)
        report(0.3)
        flip_all(field, mesh, tol, 4)
        for _ in range(6):
            if thin_out(field, mesh, tol) == 0:
                break
    report(0.5)
    good = bool(violations(mesh, 1.0)[0] == 0)
    if good or len(field.shape):  # a few angles may be out of reach of insertion alone
        searched = effort == "best" and field.kind != PATCHES
        end = 0.6 if searched else 1.0
        _remove(field, mesh, tol, rounds, visits, between(report, 0.5, end))
        good = good or bool(violations(mesh, 1.0)[0] == 0)
        if searched and good:
            search_all(field, mesh, most, between(report, 0.6, 1.0))
    return mesh, good


def _remove(
    field: KernelField, mesh: Mesh, tol: float, rounds: int, visits: int, report: Report
) -> None:
    """Rounds of removal with repair.

    After the first only where something changed; where nothing goes any more, errors are evened
    out, so that slack comes together from afar, and everything is tried again.
    """
    queue = make_queue(len(mesh.x))
    stamp = np.zeros(len(mesh.x), np.int64)
    everywhere = True
    for number in range(1, rounds + 1):
        candidates = movable(mesh)
        if not everywhere:
            candidates = candidates[stamp[candidates] == number - 1]
        waste = vertex_waste(field, mesh, tol, candidates)
        wasteful = waste > (_WORTH if rounds > 1 else _WORTH_ONCE)
        order = np.argsort(-waste[wasteful], kind="stable")
        candidates = candidates[wasteful][order]
        removed = 0
        for first in range(0, len(candidates), 2000):
            part = candidates[first : first + 2000]
            removed += removal_round(field, mesh, tol, queue, part, visits, 30.0, stamp, number)
            report((number - 1 + (first + len(part)) / len(candidates)) / rounds)
        if everywhere and number > 1 and removed == 0:
            break
        everywhere = removed <= 0.003 * int((mesh.kind != GONE).sum())
        if everywhere:
            mesh.count[MANNER] = EVEN
            relax_everything(field, mesh, tol, queue, 3)
            mesh.count[MANNER] = SETTLE
