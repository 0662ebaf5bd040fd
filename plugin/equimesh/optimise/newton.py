"""All vertices at once: Gauss-Newton steps on the energy ``sum phi(e)`` of every error.

Moves of one vertex at a time carry strain one spacing further with each visit, and stop where one
vertex alone gains nothing; around a dislocation a whole neighbourhood has to give way. Conjugate
gradients solve the system (``system.py``) well enough (truncated Newton method, Nocedal and Wright,
Numerical Optimization, ch. 7), damped after Levenberg and Marquardt. No step goes far, and vertices
around which it does harm do not take it. The mesh keeps its connectivity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.kernel import KernelField
from equimesh.fields.reference import by_reference
from equimesh.fields.workers import in_ranges
from equimesh.optimise.conjugate import solve, solve_alone
from equimesh.optimise.energy import evaluate, evaluate_all, lift
from equimesh.optimise.mesh import FREE, SLIDES, TRIANGLES, Mesh
from equimesh.optimise.system import ALONE, System, prices, prices_alone
from equimesh.optimise.topology import ample

__all__ = ["relax_together"]

# Relative gain of a step below which the next is not worth its time, in large meshes and small.
_ENOUGH, _ENOUGH_ALONE = 1e-2, 2e-2
_REACH = 0.4  # how far a vertex may go in one step, in sizes of its star
# Share of the diagonal that is added to it at first, and how that changes when a step fails or not:
# of what a failed step costs two good ones can be made.
_DAMPING, _HARDER, _EASIER = 0.04, 4.0, 0.7
# Of the square of the residual, where conjugate gradients end: in large meshes strain comes from
# afar, in small ones steps that are found more closely take twice as long and lead to none better.
_LEFT, _LEFT_ALONE = 1e-2, 0.1
_TRIES = 3  # of a step, each with fewer vertices that take part
_RANGE = 4096  # vertices, or triangles, that a thread works on at a time


@compiled
def _shorten(m, step, reach, spread):
    """Limit every vertex's step to ``reach`` times the size of its star in that direction.

    ``spread`` (v, 4) is scratch: the second moments of the spokes and their number.
    """
    for v in range(step.shape[0]):
        for i in range(4):
            spread[v, i] = 0.0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] < 0:
            continue
        for k in range(3):
            a, b = m.tv[t, k], m.tv[t, (k + 1) % 3]
            dx, dy = m.x[b] - m.x[a], m.y[b] - m.y[a]
            for v in (a, b):
                spread[v, 0] += dx * dx
                spread[v, 1] += dx * dy
                spread[v, 2] += dy * dy
                spread[v, 3] += 1.0
    for v in range(step.shape[0]):
        xx, xy, yy, n = spread[v, 0], spread[v, 1], spread[v, 2], spread[v, 3]
        det = xx * yy - xy * xy
        if det > 0.0:
            sx, sy = step[v, 0], step[v, 1]
            far = n * (yy * sx * sx - 2.0 * xy * sx * sy + xx * sy * sy) / det
            if far > reach * reach:
                share = reach / math.sqrt(far)
                step[v, 0] *= share
                step[v, 1] *= share


@compiled
def _step_from(F, m, old, step, first, last):
    """Put vertices ``first`` ... ``last`` at their old places plus the step."""
    for v in range(first, last):
        if m.kind[v] != FREE and m.kind[v] != SLIDES:
            continue
        x, y = old[v, 0] + step[v, 0], old[v, 1] + step[v, 1]
        if m.kind[v] == SLIDES:
            side = m.sides[m.side[v]]
            ux, uy = side[2] - side[0], side[3] - side[1]
            along = ((x - side[0]) * ux + (y - side[1]) * uy) / (ux * ux + uy * uy)
            x, y = side[0] + along * ux, side[1] + along * uy
            if not 0.0 < along < 1.0:
                x, y = old[v, 0], old[v, 1]
        if not (math.isfinite(x) and math.isfinite(y) and lift(F, m, v, x, y)):
            lift(F, m, v, old[v, 0], old[v, 1])


@compiled
def _list_turned(m, first, last, turned):
    """Whether each of the triangles ``first`` ... ``last`` has turned over."""
    for t in range(first, last):
        a, b, c = m.tv[t, 0], m.tv[t, 1], m.tv[t, 2]
        turned[t] = a >= 0 and not ample(m.x[a], m.y[a], m.x[b], m.y[b], m.x[c], m.y[c])


@compiled
def _take_back(F, m, old, turned):
    """Put the vertices of turned triangles back; returns whether any had moved."""
    moved = False
    for t in range(turned.shape[0]):
        if turned[t]:
            for k in range(3):
                v = m.tv[t, k]
                if (m.kind[v] == FREE or m.kind[v] == SLIDES) and (
                    m.x[v] != old[v, 0] or m.y[v] != old[v, 1]
                ):
                    lift(F, m, v, old[v, 0], old[v, 1])
                    moved = True
    return moved


@compiled
def _hold_back(m, before, after, step, rise):
    """Take the steps from vertices around which errors have become dearer.

    ``before`` and ``after`` (t,): price of each triangle at the old places and now; ``rise`` (v,)
    is scratch. So one bad spot does not spoil the step of all others.
    """
    for v in range(rise.shape[0]):
        rise[v] = 0.0
    for t in range(m.count[TRIANGLES]):
        if m.tv[t, 0] >= 0:
            for k in range(3):
                rise[m.tv[t, k]] += after[t] - before[t]
    for v in range(rise.shape[0]):
        if rise[v] > 0.0:
            step[v, 0] = step[v, 1] = 0.0


@by_reference
class _Room(NamedTuple):
    """What a step is made of."""

    old: NDArray[np.float64]  # (v, 2) places before the step,
    last: NDArray[np.float64]  # and before its last trial;
    moved: NDArray[np.uint8]  # (v,) whether that moved the vertex
    step: NDArray[np.float64]  # (v, 2)
    before: NDArray[np.float64]  # (t,) price of each triangle before the step,
    after: NDArray[np.float64]  # and after it
    turned: NDArray[np.uint8]  # (t,) scratch
    rise: NDArray[np.float64]  # (v,)
    spread: NDArray[np.float64]  # (v, 4)
    work: NDArray[np.float64]  # (4, v, 2)


def _room(vertices: int, triangles: int) -> _Room:
    v, t = vertices, triangles
    return _Room(
        np.zeros((v, 2)), np.zeros((v, 2)), np.zeros(v, np.uint8), np.zeros((v, 2)),
        np.zeros(t), np.zeros(t), np.zeros(t, np.uint8),
        np.zeros(v), np.zeros((v, 4)), np.zeros((4, v, 2)),
    )  # fmt: skip


@compiled
def _note_places(m, places):
    for v in range(places.shape[0]):
        places[v, 0], places[v, 1] = m.x[v], m.y[v]


@compiled
def _note_moves(m, places, moved):
    for v in range(places.shape[0]):
        moved[v] = m.x[v] != places[v, 0] or m.y[v] != places[v, 1]


@compiled
def _move_alone(F, m, tol, room):
    """``_Steps.moved`` in one thread."""
    triangles = room.turned.shape[0]
    _note_places(m, room.last)
    _step_from(F, m, room.old, room.step, 0, room.old.shape[0])
    _list_turned(m, 0, triangles, room.turned)
    while _take_back(F, m, room.old, room.turned):
        _list_turned(m, 0, triangles, room.turned)
    _note_moves(m, room.last, room.moved)
    evaluate(F, m, tol, room.moved, 0, triangles)


@compiled
def _try_alone(F, m, tol, room, matrix, downhill, damping, energy):
    """``_Steps.tried`` in one thread: on a small mesh Python between the kernels would take as long
    as many of them do."""
    solve_alone(matrix, damping, downhill, room.step, room.work, _LEFT_ALONE)
    _shorten(m, room.step, _REACH, room.spread)
    now = math.inf
    for _ in range(_TRIES):
        _move_alone(F, m, tol, room)
        now = prices_alone(m, 0, room.after.shape[0], room.after)
        if now < energy:
            break
        _hold_back(m, room.before, room.after, room.step, room.rise)
    return now


class _Steps:
    """Steps of a mesh from where its vertices are, and back."""

    def __init__(self, field: KernelField, mesh: Mesh, tol: float) -> None:
        self.field, self.mesh, self.tol = field, mesh, tol
        self.system = System(mesh)
        self.vertices, self.triangles = len(self.system.downhill), len(self.system.number)
        self.room = _room(self.vertices, self.triangles)
        self.energy = prices(mesh, self.room.before)
        _note_places(mesh, self.room.old)

    def tried(self, damping: float) -> float:
        """The energy after a step, taken by fewer vertices until it is below what it was."""
        room, system = self.room, self.system
        if self.triangles <= ALONE:
            return float(
                _try_alone(
                    self.field, self.mesh, self.tol, room, system.matrix, system.downhill, damping,
                    self.energy,
                )
            )  # fmt: skip
        solve(system.matrix, damping, system.downhill, room.step, room.work, _LEFT)
        _shorten(self.mesh, room.step, _REACH, room.spread)
        now = math.inf
        for _ in range(_TRIES):
            self.moved()
            now = prices(self.mesh, room.after)
            if now < self.energy:
                break
            _hold_back(self.mesh, room.before, room.after, room.step, room.rise)
        return now

    def moved(self) -> None:
        """The mesh a step from the start, except where a triangle would turn over, and its errors
        where a vertex is not where it was."""
        field, mesh, room = self.field, self.mesh, self.room
        _note_places(mesh, room.last)
        in_ranges(
            lambda u, v: _step_from(field, mesh, room.old, room.step, u, v), self.vertices, _RANGE
        )
        again = True
        while again:
            in_ranges(lambda t, u: _list_turned(mesh, t, u, room.turned), self.triangles, _RANGE)
            again = bool(room.turned.any()) and _take_back(field, mesh, room.old, room.turned)
        _note_moves(mesh, room.last, room.moved)
        evaluate_all(field, mesh, self.tol, room.moved)

    def kept(self, energy: float) -> None:
        """The step is good: the next begins at its end."""
        self.energy = energy
        self.room = self.room._replace(before=self.room.after, after=self.room.before)
        _note_places(self.mesh, self.room.old)


def relax_together(
    field: KernelField, mesh: Mesh, tol: float, rounds: int, enough: float | None = None
) -> int:
    """Up to ``rounds`` steps in the mesh's manner, a power; returns how many lowered the energy.

    They end with one that lowers it by a smaller share than ``enough``, which where it is not given
    depends on the size of the mesh. The errors that the mesh has stored must be those of its
    vertices.
    """
    steps, damping = _Steps(field, mesh, tol), _DAMPING
    if enough is None:
        enough = _ENOUGH_ALONE if steps.triangles <= ALONE else _ENOUGH
    for done in range(rounds):
        steps.system.assemble(field, mesh, tol)
        now = math.inf
        for _ in range(4):
            now = steps.tried(damping)
            if now < steps.energy:
                break
            damping *= _HARDER
        if not now < steps.energy:
            steps.room.step[:] = 0.0
            steps.moved()
            return done
        damping = max(_EASIER * damping, 1e-6)
        if steps.energy - now < enough * steps.energy:
            return done + 1
        steps.kept(now)
    return rounds
