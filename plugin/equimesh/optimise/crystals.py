"""What lies between the crystals of a wide lattice, annealed while these stay as they were laid.

Where the metric is flat a lattice is settled but for bands along the border and along lines where
det H vanishes. Annealed as a whole it would take up the strain of the bands, and every triangle
would lose what a few need. So vertices away from them are held, and what it takes follows the
length of the bands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from equimesh.fields.kernel import KernelField
from equimesh.optimise.anneal import VISITS, exchange, press
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.mesh import FIXED, FREE, GONE, Mesh
from equimesh.optimise.relax import make_queue
from equimesh.optimise.tighten import close, tighten
from equimesh.stages import Report, between

__all__ = ["anneal_between"]

_SETTLED = 0.98  # error of a triangle, in units of the tolerance, below which it is not
_RINGS = 8  # of triangles around those that give way with them
_ROUNDS = 2  # of exchange and press,
_PRESSES = (4, 2, 2)  # of so many rounds


def anneal_between(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    hurried: bool,
    goal: float,
    report: Report,
) -> Mesh:
    """Exchange vertices between crystals of a lattice that keeps ``tol``, so that it keeps it
    again.

    ``hurried`` and ``goal``: as far as ``tighten`` goes. The mesh has Hermite's errors. Returns
    it, enlarged where it had to be.
    """
    evaluate_all(field, mesh, tol)
    held = _crystals(mesh)
    mesh.kind[held] = FIXED
    queue = make_queue(len(mesh.x))
    for number in range(_ROUNDS):
        exchange(field, mesh, tol, 1.0, queue, VISITS, briefly=True)
        evaluate_all(field, mesh, tol)
        press(field, mesh, tol, _PRESSES)
        report(0.1 * (number + 1))
    mesh, queue = tighten(
        field, mesh, tol, queue, goal, between(report, 0.2, 0.9), narrow=True, hurried=hurried
    )
    mesh = close(field, mesh, tol, queue, hurried)
    mesh.kind[held] = FREE
    return mesh


def _crystals(mesh: Mesh) -> NDArray[np.int64]:
    """The free vertices that are far from the border and from what is not settled."""
    triangles = mesh.tv[mesh.tv[:, 0] >= 0]
    near = (mesh.kind != FREE) & (mesh.kind != GONE)
    near[triangles[worst_errors(mesh)[mesh.tv[:, 0] >= 0] < _SETTLED]] = True
    for _ in range(_RINGS):
        near[triangles[near[triangles].any(1)]] = True
    return np.flatnonzero((mesh.kind == FREE) & ~near)
