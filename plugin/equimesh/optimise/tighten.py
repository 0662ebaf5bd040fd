"""Wide meshes, all of whose errors are near the tolerance, brought closer to it.

Their largest errors are at dislocations, where no exchange that must pay at once, and no pressing,
brings them down. Vertices inserted there do, and make slack that vertices pay for which go
elsewhere. What is violated in the end is mended place by place.
"""

from __future__ import annotations

from collections.abc import Callable

from equimesh.fields.kernel import KernelField
from equimesh.optimise.anneal import VISITS, exchange, press
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.mending import FEW, insert_at, spread, violated
from equimesh.optimise.mesh import HARD, Mesh, triangles_in
from equimesh.optimise.regions import expected
from equimesh.optimise.relax import Queue
from equimesh.optimise.trials import mending_round

__all__ = ["tighten"]

# Errors that vertices are exchanged for, in units of the tolerance: high ones at first, for what
# can go, then lower ones, for what is missed. The last is repeated.
_AIMS = (1.1, 1.06, 1.03, 1.01, 1.0, 0.99)
_HURRIED = (4, 6)  # from which of these, and before which, where there is little time
_ROUNDS = 9  # at most; then violations are left to insertion alone
_WORST = 0.02  # of the triangles: vertices are inserted in so many. In more it is strain from afar.
_LOCAL = 0.1  # of the triangles: where more are violated, nothing is gained by spreading that
_SPREADING = 8  # moves of each vertex that they are spread by
_SETTLED = 0.005  # of the triangles: as long as more are violated nobody knows what that takes
_PRESSES = (1, 3, 3)  # rounds of pressing: the mesh is near its end


def tighten(
    field: KernelField,
    mesh: Mesh,
    tol: float,
    queue: Queue,
    goal: float,
    report: Callable[[float], None],
    hurried: bool = False,
) -> tuple[Mesh, Queue]:
    """Vertices to dislocations that lack them, then from wherever slack comes together, in turn.

    Until the mesh promises at most ``goal`` triangles, or hardly anything is violated after a few
    rounds; ``hurried``: in the last of these alone. Returns the mesh (enlarged where it had to be)
    and a queue for it. The mesh has Hermite's errors.
    """
    first, last = _HURRIED if hurried else (0, _ROUNDS)
    for number in range(first, last):
        count, over = triangles_in(mesh), len(violated(mesh))
        if over < _SETTLED * count and (number >= len(_AIMS) or expected(mesh) <= goal):
            break
        error = _AIMS[min(number, len(_AIMS) - 1)]
        if over < FEW * count:
            mending_round(field, mesh, tol, queue, violated(mesh))
        else:
            if over < _LOCAL * count:
                spread(field, mesh, tol, queue, _SPREADING)
            worst = violated(mesh)[: int(_WORST * count)]
            mesh, queue, _ = insert_at(field, mesh, tol, queue, worst)
        exchange(field, mesh, tol, error, queue, VISITS, HARD)
        evaluate_all(field, mesh, tol)
        press(field, mesh, tol, _PRESSES)
        report((number + 1 - first) / (last - first))
    return mesh, queue
