"""The four strategies of the tables, run on one example."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from adaptive import adapt
from cases import SQUARE, Case, Printed
from measure import integral_of_root, triangle_errors

import equimesh
from equimesh.expression import parse

__all__ = ["Row", "run"]

# Offsets of the lattice that are tried, in fifths of its vectors. V1, V3 and V5 tile the same
# points by the same triangles as V2, V6 and V4, so these three stand for all six shapes.
_OFFSETS = tuple(itertools.product(np.arange(5) / 5, repeat=2))
_SHAPES = (2, 4, 6)


@dataclass(frozen=True)
class Row:
    """One row of a table.

    ``aim`` is the tolerance that was asked for (nan: none was), ``printed`` the paper's row of the
    same strategy, ``constant`` the area covered per error, ``I / (N median)``, and ``efficiency``
    ``N* / N`` at the largest error."""

    strategy: str
    aim: float
    points: np.ndarray
    triangles: np.ndarray
    errors: np.ndarray
    constant: float
    efficiency: float
    printed: Printed | None
    note: str = ""


def run(case: Case) -> list[Row]:
    """All rows of an example: optimal (twice), equilateral, adaptive, certified."""
    f = parse(case.text)
    integral = integral_of_root(f.hessian)

    def row(strategy, aim, points, triangles, printed, note=""):
        errors = triangle_errors(f.value, points, triangles)
        return Row(
            strategy,
            aim,
            points[:, :2],
            triangles,
            errors,
            integral / (len(errors) * float(np.median(errors))),
            integral / (5**0.5 * float(errors.max()) * len(errors)),
            printed,
            note,
        )

    flat_map = equimesh.FlatMap(case.text, SQUARE)
    rows = []
    for printed in case.rows[:2]:
        mesh, note = _best_lattice(flat_map, printed.median)
        rows.append(row("optimal shape (interior)", printed.median, *mesh, printed, note))

    printed = case.rows[2]
    mesh = equimesh.flat_mesh(flat_map, None, printed.median, "equilateral", "full")
    equilateral = row("equilateral (cover)", printed.median, mesh.points, mesh.triangles, printed)
    rows.append(equilateral)

    printed = case.rows[3]
    adapted = adapt(f.value, case.k, printed.triangles)
    rows.append(
        row(
            "adaptive finite elements",
            float("nan"),
            adapted.points,
            adapted.triangles,
            printed,
            f"{adapted.steps} solutions, residual of the equations {_power(adapted.residual)}, "
            f"estimated error in the energy norm {adapted.estimate:.3g}",
        )
    )

    aim = float(equilateral.errors.max())
    result = equimesh.remesh(case.text, aim, SQUARE)
    rows.append(
        row(
            "equimesh (cover, certified)",
            aim,
            result.points,
            result.triangles,
            None,
            f"{result.status.value}; certified bound {result.profile.bound:.4g}",
        )
    )
    return rows


def _best_lattice(flat_map: equimesh.FlatMap, tol: float):
    """The lattice of most triangles inside the square, and which it is."""
    best, name = None, ""
    for variant, offset in itertools.product(_SHAPES, _OFFSETS):
        mesh = equimesh.flat_mesh(flat_map, None, tol, variant=variant, offset=offset)
        if best is None or len(mesh.triangles) > len(best.triangles):
            best = mesh
            name = f"V{variant} at offset ({offset[0]:.1f}, {offset[1]:.1f})"
    return (best.points, best.triangles), name


def _power(value: float) -> str:
    """The next power of ten above: what a residual near rounding means on any machine."""
    return f"below 1e{int(np.ceil(np.log10(max(value, 1e-300))))}"
