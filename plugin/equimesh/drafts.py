"""The best of several first meshes, each optimised on cheap errors.

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
from equimesh.optimise.driver import EFFORTS, cycled, draft, seam_share, triangles_in

__all__ = ["best_draft"]

_SEAMS = 0.08  # above this share of violated triangles a lattice had better be annealed
# What to try, the most promising first: the error to anneal for in units of the tolerance (None:
# leave the lattice as it is laid), and where and how turned the lattice starts.
_FLAT = ((None, 0), (0.93, 0), (0.9, 0), (None, 1), (None, 2), (None, 3), (None, 4), (None, 5))
_CURVED = (
    (0.93, 0), (0.9, 0), (0.93, 1), (0.9, 1), (0.93, 2), (0.87, 0), (0.9, 2), (0.93, 3),
)  # fmt: skip


def best_draft(
    surface: Field,
    kernel: KernelField,
    sides: Sides,
    frame: Frame,
    tol: float,
    effort: str,
    two_sided: bool,
) -> FirstMesh:
    """The first mesh with its draft in place; on data the bare outline."""
    lattice = first_mesh(surface, kernel, sides, frame, tol, two_sided=two_sided)
    size = int(lattice.mesh.count[0])
    if kernel.kind != PATCHES or lattice.settled:
        return lattice
    settled = seam_share(kernel, lattice.mesh, lattice.aim) <= _SEAMS
    how = EFFORTS[effort]
    most = 2 * how.triangles if settled else how.triangles  # lattices that fit cost little
    number = max(1, min(how.drafts, most // size))

    def drafted(what: tuple[float | None, int]) -> FirstMesh:
        error, turn = what
        start = lattice
        if what != (None, 0):
            start = first_mesh(surface, kernel, sides, frame, tol, error, two_sided, turn)
        return dataclasses.replace(start, mesh=draft(kernel, start.mesh, start.aim, effort, error))

    workers = min(numba.config.NUMBA_NUM_THREADS, number)
    with ThreadPoolExecutor(workers) as pool:
        drafts = list(pool.map(drafted, (_FLAT if settled else _CURVED)[:number]))
        drafts.sort(key=lambda start: triangles_in(start.mesh))
        meshes = pool.map(
            lambda start: cycled(kernel, start.mesh, start.aim, effort), drafts[: how.kept]
        )
        drafts = [
            dataclasses.replace(start, mesh=mesh)
            for start, mesh in zip(drafts[: how.kept], meshes, strict=True)
        ]
    return min(drafts, key=lambda start: triangles_in(start.mesh))
