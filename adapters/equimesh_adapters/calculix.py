"""CalculiX and Abaqus (``.inp``): plane elements, with sets for every boundary curve by its name.

Of a curve ``hole 1`` there are the node set ``HOLE_1``, for displacements and forces at nodes, the
element set ``HOLE_1`` of the triangles along it, and the surface ``HOLE_1`` of their sides, for
pressures; ``NALL`` and ``EALL`` hold all nodes and triangles. The file is the mesh alone: the
analysis follows it, or takes it in with ``*INCLUDE``.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

import equimesh
from equimesh.formats import Format, TriangleMesh

__all__ = ["FORMAT", "from_result", "number", "set_name"]

PLANE = ("CPS3", "CPE3", "CAX3")
_A_LINE = 12  # CalculiX reads at most 16 entries of a line,
_WIDTH = 20  # and at most 20 characters of a number


def from_result(result: equimesh.Result, element: str = "CPS3") -> str:
    """The text of an ``.inp`` file with one type of element.

    ``CPS3`` (plane stress), ``CPE3`` (plane strain) and ``CAX3`` (axisymmetric) lie in the plane
    z = 0, so that heights are left out; ``S3`` makes a shell of the surface itself.
    """
    points, triangles, boundary = result.points, result.triangles, result.boundary
    z = 0.0 if element in PLANE else points[:, 2]
    nodes = np.column_stack([points[:, :2], np.broadcast_to(z, len(points))])
    lines = ["*NODE, NSET=NALL"]
    lines += [f"{i}, {', '.join(map(number, node))}" for i, node in enumerate(nodes.tolist(), 1)]
    lines.append(f"*ELEMENT, TYPE={element}, ELSET=EALL")
    lines += [f"{i}, {a}, {b}, {c}" for i, (a, b, c) in enumerate((triangles + 1).tolist(), 1)]
    for name in boundary.names:
        edges = boundary.edges_of(name)
        owner, side = _owners(triangles, edges)
        label = set_name(name)
        lines += [f"*NSET, NSET={label}", *_rows(np.unique(edges) + 1)]
        lines += [f"*ELSET, ELSET={label}", *_rows(np.unique(owner) + 1)]
        lines.append(f"*SURFACE, NAME={label}, TYPE=ELEMENT")
        lines += [f"{i}, S{k}" for i, k in zip(owner + 1, side + 1, strict=True)]
    return "\n".join([*lines, ""])


def set_name(curve: str) -> str:
    """What the sets of a boundary curve are called: capitals, digits and underscores.

    >>> set_name("hole 1")
    'HOLE_1'
    """
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in curve.upper())


def number(value: float) -> str:
    """The number in at most 20 characters, all that CalculiX reads: exact, or 14 digits and more.

    >>> number(0.1), number(-1 / 3), number(-1e-16 / 3)
    ('0.1', '-0.3333333333333333', '-3.3333333333333e-17')
    """
    text = repr(value)
    digits = 16
    while len(text) > _WIDTH:
        text = f"{value:.{digits}g}"
        digits -= 1
    return text


def _owners(triangles: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangle of each boundary edge and which of its sides (0, 1, 2) the edge is."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    count = triangles.max() + 1
    keys = np.sort(sides, axis=1) @ [count, 1]
    order = np.argsort(keys)
    wanted = np.sort(edges, axis=1) @ [count, 1]
    slot = order[np.searchsorted(keys, wanted, sorter=order)]
    return slot // 3, slot % 3


def _rows(numbers: Iterable[int]) -> list[str]:
    words = [str(number) for number in numbers]
    return [", ".join(words[i : i + _A_LINE]) + "," for i in range(0, len(words), _A_LINE)]


def read(path: Path) -> TriangleMesh:
    """Every triangle and quadrilateral, through meshio's reader."""
    from equimesh_adapters import meshio

    return meshio.read(path)


def write(path: Path, result: equimesh.Result) -> None:
    path.write_text(from_result(result), encoding="ascii")


FORMAT = Format((".inp",), read, write)
