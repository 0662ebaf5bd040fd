"""The best of several first meshes, each optimised on cheap errors and the best on the true ones.

A lattice that fits a flat metric is settled at once; on a curved one annealing pays, from a lattice
somewhat denser. Which density ends with the fewest triangles is not known beforehand: small meshes
try several.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numba

from equimesh.domain import Sides
from equimesh.fields.base import Field
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.first_mesh import FirstMesh, first_mesh
from equimesh.frame import Frame
from equimesh.optimise.driver import (
    EFFORTS,
    Report,
    cycled,
    draft,
    optimise,
    seam_share,
    triangles_in,
)
from equimesh.optimise.mesh import Mesh

__all__ = ["best_drafts", "finished"]

_SEAMS = 0.08  # above this share of violated triangles a lattice had better be annealed
# Errors to anneal lattices for, in units of the tolerance; the denser the lattice, the lower.
_ERRORS = (0.93, 0.95, 0.94)
_FITTING = 4  # as many lattices cost what one that must be annealed does


def best_drafts(
    surface: Field,
    kernel: KernelField,
    sides: Sides,
    frame: Frame,
    tol: float,
    effort: str,
    two_sided: bool,
    report: Report,
) -> list[FirstMesh]:
    """First meshes with their drafts in place, the best first; on data the bare outline.

    ``report`` hears how far they are, in the caller's own thread, which may be the only one to show
    progress.
    """
    lattice = first_mesh(surface, kernel, sides, frame, tol, two_sided=two_sided)
    size = int(lattice.mesh.count[0])
    if kernel.kind != PATCHES or lattice.settled:
        return [lattice]
    settled = seam_share(kernel, lattice.mesh, lattice.aim) <= _SEAMS
    how = EFFORTS[effort]
    number, cost = how.drafts, float(size)
    if settled:
        number, cost = how.lattices, cost / _FITTING
    number = max(1, min(number, int(how.triangles // cost)))
    fitting = [lattice] if settled else []
    del lattice  # it may be large

    def drafted(turn: int, report: Report = lambda _: None) -> FirstMesh:
        error = None if settled else _ERRORS[turn % len(_ERRORS)]
        if turn == 0 and fitting:
            start = fitting[0]
        else:
            start = first_mesh(surface, kernel, sides, frame, tol, error, two_sided, turn)
        mesh = draft(kernel, start.mesh, start.aim, effort, error, report)
        return dataclasses.replace(start, mesh=mesh)

    best: list[FirstMesh] = []
    with ThreadPoolExecutor(min(numba.config.NUMBA_NUM_THREADS, number)) as pool:
        if number == 1:
            best.append(drafted(0, report))
        else:
            for done, start in enumerate(pool.map(drafted, range(number)), 1):
                best = sorted([*best, start], key=_size)[: how.kept]
                report(done / number)
        meshes = pool.map(lambda start: cycled(kernel, start.mesh, start.aim, effort), best)
        best = [
            dataclasses.replace(start, mesh=mesh) for start, mesh in zip(best, meshes, strict=True)
        ]
    return sorted(best, key=_size)


def _size(start: FirstMesh) -> int:
    return triangles_in(start.mesh)


def finished(
    kernel: KernelField, starts: list[FirstMesh], effort: str, report: Report, most: float
) -> tuple[FirstMesh, Mesh, bool]:
    """The draft that needs the fewest triangles on the true errors, its mesh and if that is good.

    Drafts that Hermite's errors rank first need not end there. ``most``: see ``driver.optimise``.
    """

    def optimised(number: int) -> tuple[Mesh, bool]:
        start = starts[number]
        told = report if number == 0 else lambda _: None
        return optimise(kernel, start.mesh, start.aim, effort, told, most)

    if len(starts) == 1:  # in the caller's own thread
        return starts[0], *optimised(0)
    with ThreadPoolExecutor(min(numba.config.NUMBA_NUM_THREADS, len(starts))) as pool:
        ends = list(pool.map(optimised, range(len(starts))))
    number = min(range(len(ends)), key=lambda n: (not ends[n][1], triangles_in(ends[n][0])))
    return starts[number], *ends[number]
