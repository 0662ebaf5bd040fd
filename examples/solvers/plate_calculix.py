"""CalculiX: a plate with a hole under tension, plane stress, against Kirsch's solution.

The hole is free, its rim's node and element sets come from the boundary curve ``hole 1``; the outer
square, the curve ``outline``, moves as in the infinite plate. The hole's polygon gets twice as
many sides each time. The plate is thin: CalculiX gives plane elements their thickness and solves in
space.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import shapely
from study import Study, run, show, tolerances

import equimesh
import equimesh_adapters
from equimesh_adapters.calculix import number, set_name

__all__ = ["kirsch", "study"]

# Its second derivatives fall as those of the displacements do and are nowhere degenerate.
SIZES = "1/sqrt(x**2 + y**2)"
YOUNG, POISSON, HALF_SIDE = 1.0, 0.3, 3.0

SIX_POINTS = ((0.223381589678011, 0.445948490915965), (0.109951743655322, 0.091576213509771))

DECK = """\
*INCLUDE, INPUT=plate.inp
*MATERIAL, NAME=PLATE
*ELASTIC
{young}, {poisson}
*SOLID SECTION, ELSET=EALL, MATERIAL=PLATE
0.01
*STEP
*STATIC
*BOUNDARY
{moved}
*NODE PRINT, NSET=NALL
U
*EL PRINT, ELSET={rim}
S
*END STEP
"""


def kirsch(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(..., 2) displacements around a hole of radius 1 under a unit tension along x."""
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    k = (3.0 - POISSON) / (1.0 + POISSON)
    cos, sin = np.cos(angle), np.sin(angle)
    cos3, sin3 = np.cos(3.0 * angle), np.sin(3.0 * angle)
    along = r * (k + 1.0) * cos + 2.0 / r * ((1.0 + k) * cos + cos3) - 2.0 / r**3 * cos3
    across = r * (k - 3.0) * sin + 2.0 / r * ((1.0 - k) * sin + sin3) - 2.0 / r**3 * sin3
    shear = 0.5 * YOUNG / (1.0 + POISSON)
    return np.stack([along, across], -1) / (8.0 * shear)


def study(folder: Path) -> Study:
    """L2 errors of the displacement on three meshes, which travel as ``.inp`` files."""
    counts, errors, peak = [], [], 0.0
    for i, tol in enumerate(tolerances(0.004)):
        result = equimesh.remesh(SIZES, tol, _plate(24 * 2**i))
        moved, peak = _solve(folder, result)
        counts.append(len(result.triangles))
        errors.append(_error(result, moved))
    return Study(
        "CalculiX: plate with a hole, L2 error of displacements",
        tuple(counts),
        tuple(errors),
        f"largest stress at the hole {peak:.2f}, 3 in the closed form",
    )


def _plate(sides: int) -> shapely.Polygon:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    square = shapely.box(-HALF_SIDE, -HALF_SIDE, HALF_SIDE, HALF_SIDE)
    return square - shapely.Polygon(np.column_stack([np.cos(angle), np.sin(angle)]))


def _solve(folder: Path, result: equimesh.Result) -> tuple[np.ndarray, float]:
    """(n, 2) displacements of the nodes, and the largest stress along the load at the hole."""
    equimesh_adapters.save(folder / "plate.inp", result)
    outline = np.unique(result.boundary.edges_of("outline"))
    values = kirsch(*result.points[outline, :2].T).tolist()
    moved = [
        f"{node + 1}, {axis}, {axis}, {number(value)}"
        for node, pair in zip(outline, values, strict=True)
        for axis, value in enumerate(pair, 1)
    ]
    deck = DECK.format(young=YOUNG, poisson=POISSON, moved="\n".join(moved), rim=set_name("hole 1"))
    (folder / "job.inp").write_text(deck)
    run("calculix-ccx", "ccx", "-i", "job", cwd=folder)
    printed = (folder / "job.dat").read_text()
    _, displacements, stresses = re.split(r"^ (?:displacements|stresses).*$", printed, flags=re.M)
    table = np.array([line.split() for line in displacements.split("\n") if line.strip()], float)
    assert (table[:, 0] == np.arange(len(result.points)) + 1).all()
    sigma = np.array([line.split() for line in stresses.split("\n") if line.strip()], float)
    return table[:, 1:3], float(sigma[:, 2].max())


def _error(result: equimesh.Result, moved: np.ndarray) -> float:
    """The L2 norm of the error, by six points in every triangle (Strang and Fix, degree 4)."""
    corners = result.points[result.triangles, :2]
    (bx, by), (cx, cy) = (corners[:, 1:] - corners[:, :1]).transpose(1, 2, 0)
    area = 0.5 * (bx * cy - cx * by)
    total = 0.0
    for weight, inner in SIX_POINTS:
        for k in range(3):
            shares = np.roll([1.0 - 2.0 * inner, inner, inner], k)
            x, y = np.tensordot(shares, corners, (0, 1)).T
            off = np.tensordot(shares, moved[result.triangles], (0, 1)) - kirsch(x, y)
            total += weight * float(area @ (off**2).sum(1))
    return float(np.sqrt(total))


if __name__ == "__main__":
    show(study)
