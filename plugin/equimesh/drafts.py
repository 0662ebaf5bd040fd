"""The best of several first meshes, each optimised on cheap errors and the best on the true ones.

A lattice that fits a flat metric is settled at once; on a curved one annealing pays, from a lattice
somewhat denser. Which density ends with the fewest triangles is not known beforehand: ``best``
tries several. Large ones are annealed where they are small and refined from there.
"""

from __future__ import annotations

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numba

from equimesh.domain import Sides
from equimesh.fields.base import Field
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.first_mesh import (
    Coarse,
    FirstMesh,
    aim_for,
    coarse_mesh,
    corners_suffice,
    expected_triangles,
    first_mesh,
)
from equimesh.frame import Frame
from equimesh.integrals import total_curvature
from equimesh.optimise.driver import (
    between_crystals,
    cycled,
    draft,
    finer_draft,
    optimise,
    seam_share,
)
from equimesh.optimise.effort import EFFORTS
from equimesh.optimise.mesh import Mesh, triangles_in
from equimesh.optimise.nested import Nested, nested_for
from equimesh.refinement import refined
from equimesh.stages import Report, between

__all__ = ["best_drafts", "finished"]

_CURVED = 1.0  # total curvature of a metric in which no lattice fits
_FEW = 250  # triangles, most of which are near the border: annealing pays in any case
# Above these shares of violated triangles a lattice had better be annealed, in a small mesh and
# one of so many: there the seams are narrow bands between crystals that are good as they are.
_SEAMS, _SEAMS_LARGE = 0.08, 0.2
_LARGE = 10_000
# Errors to anneal lattices for, in units of the tolerance; the denser the lattice, the lower.
_ERRORS = (0.93, 0.95, 0.94)
_ERRORS_HEATED = (0.97, 0.96, 0.98)  # of large ones, in which no vertex too many may stay
_COARSE = 0.95  # and those that are refined, whose own tolerance is less
_MISSING = 0.008  # of a coarse mesh's triangles: with more its refinements are worse than new ones
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
    job = _Job(surface, kernel, sides, frame, effort, two_sided)
    if kernel.kind != PATCHES:
        return [job.lattice(tol)]
    expected, laid = job.expected(tol), job.fitting(tol)
    how = nested_for(effort, expected)
    if laid is None and how is not None:
        levels = job.levels(tol, math.floor(math.log(expected / how.least, 4.0)))
        if levels > 0:
            return [job.nested(tol, tol * 4.0**levels * how.error, levels, how, report)]
    return job.drafts(tol, laid, report)


@dataclasses.dataclass(frozen=True, eq=False)
class _Job:
    """A smooth surface over a domain, to be meshed with some effort."""

    surface: Field
    kernel: KernelField
    sides: Sides
    frame: Frame
    effort: str
    two_sided: bool
    sizes: dict[float, float] = dataclasses.field(default_factory=dict)  # by tolerance

    @cached_property
    def coarse(self) -> Coarse:
        return coarse_mesh(self.sides, self.frame)

    def expected(self, tol: float) -> float:
        """About how many triangles a lattice has."""
        if tol not in self.sizes:
            self.sizes[tol] = expected_triangles(self.kernel, self.coarse, tol)
        return self.sizes[tol]

    def levels(self, tol: float, most: int) -> int:
        """How often a mesh may be refined for ``tol``, at most ``most`` times.

        The smallest mesh must be small beside what it shows. If it is, a quarter of the tolerance
        takes four times the triangles. How many are missing halves with every refinement: they are
        the triangles along lines where det H = 0, which is no line in the limited metric.
        """
        if most < 1:
            return 0
        size = self.expected(tol)
        fewer = 1.0 - size / (4.0**most * self.expected(4.0**most * tol))
        missing = fewer / (1.0 - 0.5**most)  # of the smallest; the largest lacks some as well
        while most > 0 and missing > _MISSING:
            most, missing = most - 1, 0.5 * missing
        return most

    def lattice(
        self, tol: float, error: float | None = None, turn: int = 0, bare: bool = False
    ) -> FirstMesh:
        return first_mesh(
            self.surface, self.kernel, self.sides, self.frame, tol, error, self.two_sided, turn,
            self.expected(tol) if self.kernel.kind == PATCHES else None, bare,
        )  # fmt: skip

    @cached_property
    def curved(self) -> bool:
        """Whether no lattice fits, however it is laid."""
        return total_curvature(self.kernel, *self.coarse) > _CURVED

    def fitting(self, tol: float) -> FirstMesh | None:
        """The lattice if it fits, so that annealing it would not pay; or the corners if they do."""
        if corners_suffice(self.surface, self.coarse, self.frame, tol):
            return self.lattice(tol, bare=True)
        if self.expected(tol) < _FEW or self.curved:
            return None
        lattice = self.lattice(tol)
        share = seam_share(self.kernel, lattice.mesh, lattice.aim)
        most = _SEAMS if self.expected(tol) < _LARGE else _SEAMS_LARGE
        return lattice if share <= most else None

    def drafts(self, tol: float, laid: FirstMesh | None, report: Report) -> list[FirstMesh]:
        """The best drafts from as many lattices as the effort has time for.

        ``laid``: the lattice where one fits. Where no further vertex is needed, that itself.
        """
        if laid is not None and laid.settled:
            return [laid]
        how, cost, fits = EFFORTS[self.effort], self.expected(tol), laid is not None
        number, most = how.drafts, how.cycled[1]
        if fits:
            number, most = how.lattices, how.cycled[0]
            cost /= _FITTING
        number = max(1, min(number, int(how.triangles // max(cost, 1.0))))
        errors = _ERRORS_HEATED if cost >= how.heated else _ERRORS

        def drafted(turn: int, report: Report = lambda _: None) -> FirstMesh:
            error = None if fits else errors[turn % len(errors)]
            start = laid if turn == 0 and laid is not None else self.lattice(tol, error, turn)
            return _with(start, draft(*self.given(start), error, report, start.least))

        def improved(start: FirstMesh, report: Report = lambda _: None) -> FirstMesh:
            cycles = min(how.cycles, most // _size(start))
            if fits and cycles == 0:
                mesh = between_crystals(*self.given(start), start.least, report)
                return _with(start, mesh)
            return self.cycled(start, cycles)

        if number == 1:
            return [improved(drafted(0, report), report)]
        # Where all are kept none has to wait for the others.
        first = (lambda turn: improved(drafted(turn))) if number <= how.kept else drafted
        best: list[FirstMesh] = []
        with ThreadPoolExecutor(min(numba.config.NUMBA_NUM_THREADS, number)) as pool:
            for done, start in enumerate(pool.map(first, range(number)), 1):
                best = sorted([*best, start], key=_size)[: how.kept]
                report(done / number)
            if number > how.kept:
                best = list(pool.map(improved, best))
        return sorted(best, key=_size)

    def cycled(self, start: FirstMesh, most: int) -> FirstMesh:
        """The best of a draft and up to ``most`` more that are made from it."""
        return _with(start, cycled(*self.given(start), start.least, most))

    def nested(
        self, tol: float, coarse: float, levels: int, how: Nested, report: Report
    ) -> FirstMesh:
        """The draft for ``tol`` from one for ``coarse`` that is refined ``levels`` times."""
        start = self.lattice(coarse, _COARSE)
        mesh = draft(*self.given(start), _COARSE, between(report, 0.0, 0.4), 0.0, finer=True)
        start = _with(start, mesh)
        for left in range(levels - 1, -1, -1):
            aim = aim_for(tol * 4.0**left, 4 * _size(start))
            start = refined(start, self.surface, self.frame, aim)
            share = 0.6 * 0.25**left  # of the time, with all levels before
            told = between(report, 0.4 + 0.25 * share, 0.4 + share)
            start = _with(
                start, finer_draft(self.kernel, start.mesh, aim, how, told, last=left == 0)
            )
        return start

    def given(self, start: FirstMesh) -> tuple[KernelField, Mesh, float, str]:
        """What every draft is made from."""
        return self.kernel, start.mesh, start.aim, self.effort


def _with(start: FirstMesh, mesh: Mesh) -> FirstMesh:
    return dataclasses.replace(start, mesh=mesh)


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
        return optimise(kernel, start.mesh, start.aim, effort, told, most, start.least)

    if len(starts) == 1:  # in the caller's own thread
        return starts[0], *optimised(0)
    with ThreadPoolExecutor(min(numba.config.NUMBA_NUM_THREADS, len(starts))) as pool:
        ends = list(pool.map(optimised, range(len(starts))))
    number = min(range(len(ends)), key=lambda n: (not ends[n][1], triangles_in(ends[n][0])))
    return starts[number], *ends[number]
