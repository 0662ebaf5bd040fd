"""Meshes whose every triangle was cut in four: what strain is left, and vertices where they lack.

Nested iteration, as multigrid begins (Brandt 1977): what is far apart was settled on the smaller
mesh, and a few steps of all vertices together do for the rest. Where the quarters' errors are
large or small over whole regions, and at dislocations, which have grown with the triangles,
vertices come and go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.fields.kernel import KernelField
from equimesh.optimise.anneal import VISITS
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.exchange import exchange_once
from equimesh.optimise.flips import flip_all
from equimesh.optimise.mesh import FIRM, HARD, MANNER, SETTLE, SOFT, Mesh
from equimesh.optimise.newton import relax_together
from equimesh.optimise.regions import regional_shares
from equimesh.optimise.relax import make_queue
from equimesh.stages import Report

__all__ = ["Nested", "nested_for", "settle"]


_EXCHANGE = -1  # a pass of vertices that come and go; other steps are manners of all vertices


@dataclass(frozen=True)
class Nested:
    """How a large mesh is made from smaller ones.

    ``above``: triangles from which on that pays; ``least``: below which the smallest is not to
    fall; ``error``: what it is annealed for, in units of its tolerance; ``between``: steps after a
    refinement that others follow; ``last``: after the last. ``thorough``: at last what is
    violated is mended closely, and vertices are removed.
    """

    above: float
    least: float
    error: float
    between: tuple[int, ...]
    last: tuple[int, ...]
    thorough: bool


_NESTED = {
    "fast": (
        Nested(40_000, 4_000, 0.92, (SOFT, SOFT), (SOFT, FIRM), thorough=False),
        Nested(150_000, 4_000, 0.89, (SOFT, SOFT), (SOFT, FIRM), thorough=False),
    ),
    "balanced": (
        Nested(
            120_000, 4_000, 0.96,
            (SOFT, SOFT, HARD, _EXCHANGE, HARD, _EXCHANGE, HARD, HARD, HARD),
            (SOFT, HARD, _EXCHANGE, HARD, HARD, HARD),
            thorough=True,
        ),
    ),
    "best": (),
}  # fmt: skip
_STEPS = 4  # of all vertices before edges flip
_AIM = 0.98  # what vertices are exchanged for
_OFF = 1.5  # triangles too few or too many around a vertex that make an exchange worth a trial


def nested_for(effort: str, triangles: float) -> Nested | None:
    """How a mesh of about so many triangles is made from smaller ones; None where it is not."""
    return next((how for how in reversed(_NESTED[effort]) if how.above <= triangles), None)


def settle(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    steps: tuple[int, ...],
    report: Report,
) -> None:
    """Bring the errors of a mesh that was just refined close together.

    The mesh has Hermite's errors.
    """
    evaluate_all(field, mesh, tol)
    for number, step in enumerate(steps, 1):
        if step == _EXCHANGE:
            _exchange(field, mesh, tol)
        else:
            mesh.count[MANNER] = step
            relax_together(field, mesh, tol, _STEPS)
            flip_all(field, mesh, tol, 50)
        report(number / len(steps))
    mesh.count[MANNER] = SETTLE


def _exchange(field: KernelField, mesh: Mesh, tol: float) -> None:
    """Vertices to regions with large errors, and to dislocations, from where they are too many."""
    mesh.share[:] = regional_shares(mesh, mesh.share)
    mesh.count[MANNER] = SOFT
    evaluate_all(field, mesh, _AIM * tol)
    queue, stamp = make_queue(len(mesh.x)), np.zeros(len(mesh.x), np.int64)
    exchange_once(field, mesh, _AIM * tol, queue, VISITS, stamp, 1, _OFF)
    mesh.share[:] = 1.0
    evaluate_all(field, mesh, tol)
