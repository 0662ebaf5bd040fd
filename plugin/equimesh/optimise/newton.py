"""All vertices at once: Gauss-Newton steps on the energy ``sum phi(e)`` of every error.

Moves of one vertex at a time carry strain one spacing further with each visit, and stop where one
vertex alone gains nothing; around a dislocation a whole neighbourhood has to give way. Conjugate
gradients solve the system (``system.py``) well enough (truncated Newton method, Nocedal and Wright,
Numerical Optimization, ch. 7), damped after Levenberg and Marquardt. No step goes far, and vertices
around which it does harm do not take it. The mesh keeps its connectivity.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.compiled import compiled
from equimesh.fields.kernel import KernelField
from equimesh.fields.workers import in_ranges
from equimesh.optimise.conjugate import solve
from equimesh.optimise.energy import evaluate_all, lift
from equimesh.optimise.mesh import FREE, SLIDES, TRIANGLES, Mesh
from equimesh.optimise.system import System, prices
from equimesh.optimise.topology import ample

__all__ = ["relax_together"]

_ENOUGH = 5e-3  # relative gain of a step below which the next is not worth its time
_REACH = 0.4  # how far a vertex may go in one step, in sizes of its star
# Share of the diagonal that is added to it at first, and how that changes when a step fails or not:
# of what a failed step costs two good ones can be made.
_DAMPING, _HARDER, _EASIER = 0.04, 4.0, 0.7
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


def _walk(
    field: KernelField,
    mesh: Mesh,
    old: NDArray[np.float64],
    step: NDArray[np.float64],
    turned: NDArray[np.uint8],
) -> None:
    """Put every vertex at its old place plus the step, except where a triangle would turn over.

    ``turned`` (t,) is scratch.
    """
    in_ranges(lambda u, v: _step_from(field, mesh, old, step, u, v), len(old), _RANGE)
    again = True
    while again:
        in_ranges(lambda t, u: _list_turned(mesh, t, u, turned), len(turned), _RANGE)
        again = bool(turned.any()) and _take_back(field, mesh, old, turned)


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


class _Steps:
    """Steps of a mesh from where its vertices are, and back."""

    def __init__(self, field: KernelField, mesh: Mesh, tol: float) -> None:
        self.field, self.mesh, self.tol = field, mesh, tol
        self.system = System(mesh)
        triangles, self.vertices = self.system.number.shape[0], len(self.system.downhill)
        self.before, self.after = np.zeros(triangles), np.zeros(triangles)
        self.turned = np.zeros(triangles, np.uint8)
        self.step, self.spread = np.zeros((self.vertices, 2)), np.zeros((self.vertices, 4))
        self.work = np.zeros((4, self.vertices, 2))
        self.energy = prices(mesh, self.before)
        self.old = np.empty((self.vertices, 2))
        self.start()

    def start(self) -> None:
        """Steps begin where the vertices are now."""
        self.old[:, 0], self.old[:, 1] = self.mesh.x[: self.vertices], self.mesh.y[: self.vertices]

    def tried(self, damping: float) -> float:
        """The energy after a step, taken by fewer vertices until it is below what it was."""
        solve(self.system.matrix, damping, self.system.downhill, self.step, self.work)
        _shorten(self.mesh, self.step, _REACH, self.spread)
        now, rise = math.inf, np.zeros(self.vertices)
        for _ in range(_TRIES):
            self.moved()
            now = prices(self.mesh, self.after)
            if now < self.energy:
                break
            _hold_back(self.mesh, self.before, self.after, self.step, rise)
        return now

    def moved(self) -> None:
        """The mesh a step from the start, and its errors where a vertex is not where it was."""
        x, y = self.mesh.x[: self.vertices].copy(), self.mesh.y[: self.vertices].copy()
        _walk(self.field, self.mesh, self.old, self.step, self.turned)
        moved = (self.mesh.x[: self.vertices] != x) | (self.mesh.y[: self.vertices] != y)
        evaluate_all(self.field, self.mesh, self.tol, moved.view(np.uint8))

    def kept(self, energy: float) -> None:
        """The step is good: the next begins at its end."""
        self.energy, self.before, self.after = energy, self.after, self.before
        self.start()


def relax_together(field: KernelField, mesh: Mesh, tol: float, rounds: int) -> int:
    """Up to ``rounds`` steps in the mesh's manner, a power; returns how many lowered the energy.

    The errors that the mesh has stored must be those of its vertices.
    """
    steps, damping = _Steps(field, mesh, tol), _DAMPING
    for done in range(rounds):
        steps.system.assemble(field, mesh, tol)
        now = math.inf
        for _ in range(4):
            now = steps.tried(damping)
            if now < steps.energy:
                break
            damping *= _HARDER
        if not now < steps.energy:
            steps.step[:] = 0.0
            steps.moved()
            return done
        damping = max(_EASIER * damping, 1e-6)
        if steps.energy - now < _ENOUGH * steps.energy:
            return done + 1
        steps.kept(now)
    return rounds
