"""Medit's files: meshes (``.mesh``) and values at their vertices (``.sol``), and both in binary.

The binary kinds (``.meshb``, ``.solb``) are those of libMeshb: an integer 1 that tells the order of
bytes, a version, then for each keyword its code, the position after it, a count and the numbers.
Version 1 holds single precision, 2 double, 3 positions and 4 all integers of eight bytes. Version 2
is written.

Medit has numbers, not names, for groups. In a ``.mesh`` file equimesh tells the names in comments,
``# edges 1: bottom``, which other readers pass over; ``.meshb`` has no comments and no names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh_adapters.tensors import pack, unpack

__all__ = ["MeditMesh", "read_mesh", "read_solution", "write_mesh", "write_solution"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

CODES = {
    "Dimension": 3, "Vertices": 4, "Edges": 5, "Triangles": 6, "Quadrilaterals": 7, "Corners": 13,
    "SolAtVertices": 62,
}  # fmt: skip
END = 54
NAME = re.compile(r"#\s*edges\s+(-?\d+)\s*:\s*(.*\S)")


def _none(*shape: int) -> IntArray:
    return np.zeros(shape, np.int64)


@dataclass(frozen=True, eq=False)
class MeditMesh:
    """What equimesh knows of a Medit mesh.

    Parameters
    ----------
    points
        (n, 2) or (n, 3) vertices.
    triangles, references
        (m, 3) vertex numbers from 0, and (m,) the triangles' references.
    edges, edge_references
        (k, 2) and (k,): pieces of named curves.
    corners
        (c,) vertices that a remesher must keep.
    names
        Names of the edges' references.
    """

    points: Array
    triangles: IntArray
    references: IntArray = field(default_factory=lambda: _none(0))
    edges: IntArray = field(default_factory=lambda: _none(0, 2))
    edge_references: IntArray = field(default_factory=lambda: _none(0))
    corners: IntArray = field(default_factory=lambda: _none(0))
    names: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.references) != len(self.triangles):
            object.__setattr__(self, "references", _none(len(self.triangles)))


def read_mesh(path: str | Path) -> MeditMesh:
    """The triangles and edges of a ``.mesh`` or ``.meshb`` file; quadrilaterals are cut in two.

    Raises InputError where the file is not one.
    """
    path = Path(path)
    blocks, names, dimension = _blocks(path)
    if "Vertices" not in blocks:
        raise InputError(f"{path} has no vertices: give a Medit mesh.")
    width = {"Vertices": dimension + 1, "Edges": 3, "Triangles": 4, "Quadrilaterals": 5}
    table = {
        key: np.asarray(blocks.get(key, ()), float).reshape(-1, count)
        for key, count in width.items()
    }
    faces = table["Triangles"].astype(np.int64)
    quads = table["Quadrilaterals"].astype(np.int64)
    halves = quads[:, [0, 1, 2, 4, 0, 2, 3, 4]].reshape(-1, 4)
    faces = np.concatenate([faces, halves])
    edges = table["Edges"].astype(np.int64)
    corners = np.asarray(blocks.get("Corners", ()), float).astype(np.int64).reshape(-1)
    return MeditMesh(
        np.ascontiguousarray(table["Vertices"][:, :dimension]),
        np.ascontiguousarray(faces[:, :3]) - 1,
        np.ascontiguousarray(faces[:, 3]),
        np.ascontiguousarray(edges[:, :2]) - 1,
        np.ascontiguousarray(edges[:, 2]),
        corners - 1,
        names,
    )


def write_mesh(path: str | Path, mesh: MeditMesh) -> None:
    """Write a ``.mesh`` file, every digit of the coordinates kept, or a ``.meshb`` file."""
    path = Path(path)
    dimension = mesh.points.shape[1]
    blocks = {
        "Vertices": (mesh.points, _none(len(mesh.points), 1)),
        "Corners": (mesh.corners[:, None] + 1,),
        "Edges": (mesh.edges + 1, mesh.edge_references[:, None]),
        "Triangles": (mesh.triangles + 1, mesh.references[:, None]),
    }
    if path.suffix.lower() == ".meshb":
        path.write_bytes(_binary(dimension, blocks))
        return
    names = [f"# edges {number}: {name}" for number, name in mesh.names.items()]
    lines = ["MeshVersionFormatted 2", *names, f"Dimension {dimension}"]
    for key, columns in blocks.items():
        if len(columns[0]):
            lines += [key, str(len(columns[0])), *_rows(columns)]
    path.write_text("\n".join([*lines, "End", ""]), encoding="utf-8")


def read_solution(path: str | Path) -> list[Array]:
    """The fields at the vertices: (n,) scalars, (n, d) vectors, (n, d, d) symmetric tensors."""
    path = Path(path)
    blocks, _, dimension = _blocks(path)
    if "SolAtVertices" not in blocks:
        raise InputError(f"{path} has no values at vertices: give a Medit .sol file.")
    flat = np.asarray(blocks["SolAtVertices"], float)
    count = int(flat[0])
    sizes = [_width(int(kind), dimension) for kind in flat[1 : 1 + count]]
    columns = flat[1 + count :].reshape(-1, sum(sizes))
    parts = np.split(columns, np.cumsum(sizes)[:-1], axis=1)
    tensor = dimension * (dimension + 1) // 2
    return [
        part[:, 0] if size == 1 else unpack(part, "medit") if size == tensor else part
        for part, size in zip(parts, sizes, strict=True)
    ]


def write_solution(path: str | Path, dimension: int, *fields: Array) -> None:
    """Write (n,) scalars and (n, d, d) tensors at the vertices as ``.sol`` or ``.solb``."""
    path = Path(path)
    columns = [f[:, None] if f.ndim == 1 else pack(f, "medit") for f in map(np.asarray, fields)]
    kinds = [1 if f.shape[1] == 1 else 3 for f in columns]
    if path.suffix.lower() == ".solb":
        path.write_bytes(_binary(dimension, {"SolAtVertices": tuple(columns)}, kinds))
        return
    head = [
        "MeshVersionFormatted 2", f"Dimension {dimension}", "SolAtVertices", str(len(columns[0])),
        " ".join(map(str, [len(kinds), *kinds])),
    ]  # fmt: skip
    path.write_text("\n".join([*head, *_rows(columns), "End", ""]), encoding="ascii")


def _width(kind: int, dimension: int) -> int:
    return {1: 1, 2: dimension, 3: dimension * (dimension + 1) // 2}[kind]


def _rows(columns: Sequence[NDArray[np.generic]]) -> Iterator[str]:
    """Seventeen digits give every double back."""
    listed = [column.tolist() for column in columns]
    for parts in zip(*listed, strict=True):
        yield " ".join(f"{v:.17g}" for part in parts for v in part)


def _blocks(path: Path) -> tuple[dict[str, Array], dict[int, str], int]:
    """The numbers after each keyword without their count, the names of edges, the dimension."""
    names: dict[int, str] = {}
    try:
        if path.suffix.lower() in (".meshb", ".solb"):
            blocks, dimension = _parsed(path.read_bytes())
        else:
            text = path.read_text(encoding="utf-8")
            names = {int(m[1]): m[2] for m in map(NAME.match, text.splitlines()) if m}
            blocks, dimension = _spelt(re.sub(r"#.*", "", text).split())
    except InputError:
        raise
    except (ValueError, IndexError) as error:
        raise InputError(f"{path} is no Medit file or is cut short: give another one.") from error
    if dimension not in (2, 3):
        raise InputError(f"{path} has the dimension {dimension}: give 2 or 3.")
    return blocks, names, dimension


def _spelt(words: list[str]) -> tuple[dict[str, Array], int]:
    """The tables of a text."""
    if words[0] != "MeshVersionFormatted":
        raise InputError("The file is no Medit file: its first word is not MeshVersionFormatted.")
    keys = [
        i
        for i, word in enumerate(words)
        if word[0].isalpha() and word.lower() not in ("nan", "inf", "infinity")
    ]
    blocks: dict[str, Array] = {}
    for start, stop in zip(keys, [*keys[1:], len(words)], strict=True):
        if words[start] in CODES:
            blocks[words[start]] = np.array(words[start + 1 : stop], float)
    dimension = int(blocks.pop("Dimension", np.array([3.0]))[0])
    for key, numbers in blocks.items():
        count, blocks[key] = int(numbers[0]), numbers[1:]
        head = 1 + int(numbers[1]) if key == "SolAtVertices" else 0
        rows = len(numbers) - 1 - head
        if (count == 0) != (rows == 0) or (count and rows % count):
            raise InputError(f"The file announces {count} {key} but holds others: it is damaged.")
    return blocks, dimension


def _binary(
    dimension: int, blocks: Mapping[str, Sequence[NDArray[np.generic]]], kinds: Sequence[int] = ()
) -> bytes:
    out = bytearray(np.array([1, 2, CODES["Dimension"], 20, dimension], "<i4").tobytes())
    for key, columns in blocks.items():
        count = len(columns[0])
        if not count:
            continue
        head = [count, *([len(kinds), *kinds] if kinds else [])]
        layout = [
            ("<f8" if column.dtype.kind == "f" else "<i4", column.shape[1:]) for column in columns
        ]
        table = np.empty(count, [(f"c{i}", *kind) for i, kind in enumerate(layout)])
        for i, column in enumerate(columns):
            table[f"c{i}"] = column
        following = len(out) + 4 * (2 + len(head)) + table.nbytes
        if following >= 2**31:
            raise InputError("The mesh is too large for a binary Medit file: write .mesh instead.")
        out += np.array([CODES[key], following, *head], "<i4").tobytes() + table.tobytes()
    return bytes(out + np.array([END, 0], "<i4").tobytes())


def _parsed(data: bytes) -> tuple[dict[str, Array], int]:
    """The tables of a binary file, all numbers as float64."""
    order = {1: "<", 1 << 24: ">"}.get(int.from_bytes(data[:4], "little"))
    if order is None or len(data) < 20:
        raise InputError("The file is no binary Medit file: it does not begin with the number 1.")
    version = int(np.frombuffer(data, order + "i4", 1, 4)[0])
    real = order + ("f4" if version == 1 else "f8")
    place = order + ("i8" if version >= 3 else "i4")
    whole = order + ("i8" if version >= 4 else "i4")
    names = {code: key for key, code in CODES.items()}
    blocks: dict[str, Array] = {}
    at, dimension = 8, 3
    integers = {"Edges": 3, "Triangles": 4, "Quadrilaterals": 5, "Corners": 1}
    while at + 4 + np.dtype(place).itemsize <= len(data):
        code = int(np.frombuffer(data, order + "i4", 1, at)[0])
        following = int(np.frombuffer(data, place, 1, at + 4)[0])
        at += 4 + np.dtype(place).itemsize
        key = names.get(code)
        if code == END:
            break
        if key == "Dimension":
            dimension = int(np.frombuffer(data, order + "i4", 1, at)[0])
        elif key is not None:
            count = int(np.frombuffer(data, whole, 1, at)[0])
            at += np.dtype(whole).itemsize
            if key == "Vertices":
                row = np.dtype([("x", real, dimension), ("r", whole)])
                table = np.frombuffer(data, row, count, at)
                blocks[key] = np.column_stack([table["x"], table["r"]]).astype(float)
            elif key == "SolAtVertices":
                number = int(np.frombuffer(data, order + "i4", 1, at)[0])
                kinds = np.frombuffer(data, order + "i4", number, at + 4)
                width = sum(_width(int(kind), dimension) for kind in kinds)
                values = np.frombuffer(data, real, count * width, at + 4 * (1 + number))
                blocks[key] = np.concatenate([[number], kinds, values]).astype(float)
            else:
                numbers = np.frombuffer(data, whole, count * integers[key], at)
                blocks[key] = numbers.astype(float)
        if following <= at:
            break
        at = following
    return blocks, dimension
