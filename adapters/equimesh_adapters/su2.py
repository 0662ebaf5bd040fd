"""SU2's native meshes (``.su2``): plane, with every boundary curve as a marker by its name."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.formats import Format, TriangleMesh

__all__ = ["FORMAT", "from_result", "markers", "to_mesh"]

LINE, TRIANGLE, QUADRILATERAL = 3, 5, 9  # VTK's numbers of cell types
CORNERS = {LINE: 2, TRIANGLE: 3, QUADRILATERAL: 4}


def from_result(result: equimesh.Result) -> str:
    """The text of a ``.su2`` file.

    The mesh lies in the plane: SU2 solves there, and heights only told equimesh where to put
    triangles. Blanks in names become underscores.
    """
    points, triangles, boundary = result.points, result.triangles, result.boundary
    lines = ["NDIME= 2", f"NELEM= {len(triangles)}"]
    lines += [f"{TRIANGLE} {a} {b} {c} {i}" for i, (a, b, c) in enumerate(triangles.tolist())]
    lines.append(f"NPOIN= {len(points)}")
    lines += [f"{x!r} {y!r} {i}" for i, (x, y) in enumerate(points[:, :2].tolist())]
    lines.append(f"NMARK= {len(boundary.names)}")
    for name in boundary.names:
        edges = boundary.edges_of(name)
        lines += [f"MARKER_TAG= {'_'.join(name.split())}", f"MARKER_ELEMS= {len(edges)}"]
        lines += [f"{LINE} {a} {b}" for a, b in edges.tolist()]
    return "\n".join([*lines, ""])


def to_mesh(text: str) -> TriangleMesh:
    """The triangles of a plane ``.su2`` file; quadrilaterals are cut along a diagonal.

    Raises InputError for a mesh in space.
    """
    triangles: list[list[int]] = []
    points = np.empty((0, 2))
    for name, count, lines in _sections(text):
        if name == "NDIME" and count != 2:
            raise InputError("The SU2 mesh lies in space: give a plane one (NDIME= 2).")
        if name == "NELEM":
            for corners in _cells(lines):
                triangles += [[corners[0], *corners[i : i + 2]] for i in range(1, len(corners) - 1)]
        elif name == "NPOIN":
            points = np.array([line.split()[:2] for line in lines], np.float64)
    return TriangleMesh(points, np.array(triangles, np.int64).reshape(-1, 3))


def markers(text: str) -> dict[str, np.ndarray]:
    """The (k, 2) edges of every marker of a plane ``.su2`` file, by name."""
    found: dict[str, np.ndarray] = {}
    tag = ""
    for name, value, lines in _sections(text):
        if name == "MARKER_TAG":
            tag = str(value)
        elif name == "MARKER_ELEMS":
            found[tag] = np.array(_cells(lines), np.int64).reshape(-1, 2)
    return found


def _sections(text: str) -> list[tuple[str, int | str, list[str]]]:
    """Every ``NAME= value`` with the lines that follow it."""
    sections: list[tuple[str, int | str, list[str]]] = []
    for line in text.splitlines():
        line = line.split("%")[0].strip()
        name, equals, value = (word.strip() for word in line.partition("="))
        if equals:
            sections.append((name, value if name == "MARKER_TAG" else int(value.split()[0]), []))
        elif line and sections:
            sections[-1][2].append(line)
    for name, count, lines in sections:
        if name in ("NELEM", "NPOIN", "MARKER_ELEMS") and len(lines) != count:
            raise InputError(
                f"The SU2 mesh announces {name}= {count} but holds {len(lines)}: it is cut short."
            )
    announced = sum(int(count) for name, count, _ in sections if name == "NMARK")
    markers = sum(name == "MARKER_ELEMS" for name, _, _ in sections)
    if markers != announced or not any(name == "NMARK" for name, _, _ in sections):
        raise InputError(
            f"The SU2 mesh announces NMARK= {announced} but holds {markers}: it is cut short."
        )
    return sections


def _cells(lines: list[str]) -> list[list[int]]:
    cells = [[int(word) for word in line.split()] for line in lines]
    for numbers in cells:
        if len(numbers) <= CORNERS[numbers[0]]:
            raise InputError("An element of the SU2 mesh lacks corners: the file is cut short.")
    return [numbers[1 : 1 + CORNERS[numbers[0]]] for numbers in cells]


def read(path: Path) -> TriangleMesh:
    return to_mesh(path.read_text(encoding="utf-8"))


def write(path: Path, result: equimesh.Result) -> None:
    path.write_text(from_result(result), encoding="utf-8")


FORMAT = Format((".su2",), read, write)
