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
from equimesh.optimise.driver import EFFORTS, draft, seam_share

__all__ = ["best_draft"]

_SEAMS = 0.08  # above this share of violated triangles a lattice had better be annealed
_ERRORS = (0.9, 0.87, 0.93, 0.85, 0.95, 0.89, 0.91)  # to anneal for, in units of the tolerance
_LARGE = 40_000  # triangles of all drafts together beyond which one is enough


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
    settled = seam_share(kernel, lattice.mesh, tol) <= _SEAMS
    number = max(1, min(EFFORTS[effort].drafts, _LARGE // size))
    errors: list[float | None] = [None, *_ERRORS] if settled else [_ERRORS[0], None, *_ERRORS[1:]]

    def drafted(error: float | None) -> FirstMesh:
        start = lattice
        if error is not None:
            start = first_mesh(surface, kernel, sides, frame, tol, error, two_sided)
        return dataclasses.replace(start, mesh=draft(kernel, start.mesh, tol, effort, error))

    with ThreadPoolExecutor(min(numba.config.NUMBA_NUM_THREADS, number)) as pool:
        drafts = list(pool.map(drafted, errors[:number]))
    return min(drafts, key=lambda start: int((start.mesh.tv[:, 0] >= 0).sum()))
