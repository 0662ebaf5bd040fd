"""Kinds of bad input for ``equimesh remesh``: what to put into an empty folder, what to ask."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = ["KINDS", "Kind", "words"]


class Kind(NamedTuple):
    """``prepare`` fills the current folder; ``words`` follow ``equimesh remesh``."""

    name: str
    prepare: Callable[[], object]
    words: list[str]


class _Bomb:
    """Runs when unpickled, which must never happen."""

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (Path("boom"),)


def _heights(values: object) -> Callable[[], object]:
    return lambda: np.save("in.npy", np.asarray(values))


def _surface(points: np.ndarray, triangles: np.ndarray) -> Callable[[], object]:
    return lambda: np.savez("in.npz", points=points, triangles=triangles)


def _grid(n: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = (t.ravel() for t in np.meshgrid(*2 * [np.linspace(0.0, 1.0, n)]))
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower, upper = np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)
    return np.stack([x, y, np.sin(3 * x) * y], 1), np.concatenate([lower, upper])


def _truncated_ply() -> None:
    """Three vertices and one triangle are announced; the last vertex is cut short."""
    names = "".join(f"property float {axis}\n" for axis in "xyz")
    head = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex 3\n{names}"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    Path("in.ply").write_bytes(head.encode() + struct.pack("<8f", *range(8)))


def _pickled() -> None:
    np.savez("in.npz", heights=np.array([[_Bomb()]], dtype=object))


def _nothing() -> None:
    pass


POINTS, TRIANGLES = _grid(6)
PLAIN = np.arange(25.0).reshape(5, 5) ** 2
SPIKED = np.where(np.eye(5) > 0.0, np.inf, PLAIN)
# A tetrahedron: seen from anywhere, one face lies above another.
CLOSED = (
    np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]),
    np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
)
# Three pages of a book at one spine.
BOOK = (
    np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [1, 0, 1.0]]),
    np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]),
)
CROSSED = "POLYGON ((0 0, 1 1, 1 0, 0 1, 0 0))"
HOLE_OUTSIDE = "POLYGON ((0 0, 1 0, 1 1, 0 1, 0 0), (2 2, 3 2, 3 3, 2 3, 2 2))"

RASTER = ["in.npy", "out.ply", "--tol"]
MESH = ["in.npz", "out.ply", "--tol"]
ON_SQUARE = ["out.ply", "--domain", "0,0,1,1", "--tol", "0.1", "--function"]
ON_REGION = ["out.ply", "--function", "x*y", "--tol", "0.1", "--domain"]

KINDS = (
    Kind("only NaN", _heights(np.full((5, 5), np.nan)), [*RASTER, "1%"]),
    Kind("an infinite height", _heights(SPIKED), [*RASTER, "1%"]),
    Kind("no heights", _heights(np.empty((0, 0))), [*RASTER, "1%"]),
    Kind("one height", _heights([[1.0]]), [*RASTER, "1%"]),
    Kind("tolerance 0", _heights(PLAIN), [*RASTER, "0"]),
    Kind("tolerance -1", _heights(PLAIN), [*RASTER, "-1"]),
    Kind("tolerance abc%", _heights(PLAIN), [*RASTER, "abc%"]),
    Kind("tolerance nan", _heights(PLAIN), [*RASTER, "nan"]),
    Kind("a polygon that crosses itself", _nothing, [*ON_REGION, CROSSED]),
    Kind("a hole outside", _nothing, [*ON_REGION, HOLE_OUTSIDE]),
    Kind("a domain without area", _nothing, [*ON_REGION, "0,0,1,0"]),
    Kind("a domain file that is not there", _nothing, [*ON_REGION, "none.geojson"]),
    Kind(
        "a domain that is a line",
        lambda: Path("in.geojson").write_text(
            json.dumps({"type": "LineString", "coordinates": [[0, 0], [1, 1]]})
        ),
        [*ON_REGION, "in.geojson"],
    ),
    Kind("a closed surface", _surface(*CLOSED), [*MESH, "1%"]),
    Kind("three triangles at an edge", _surface(*BOOK), [*MESH, "1%"]),
    Kind("all points the same", _surface(0.0 * POINTS, TRIANGLES), [*MESH, "1%"]),
    Kind("NaN coordinates", _surface(np.nan * POINTS, TRIANGLES), [*MESH, "1%"]),
    Kind("a vertex that does not exist", _surface(POINTS[:9], TRIANGLES), [*MESH, "1%"]),
    Kind("a truncated ply", _truncated_ply, ["in.ply", "out.ply", "--tol", "1%"]),
    Kind("an empty file", lambda: Path("in.ply").touch(), ["in.ply", "out.ply", "--tol", "1%"]),
    Kind("a pickle in an npz", _pickled, [*MESH, "1%"]),
    Kind("a program as expression", _nothing, [*ON_SQUARE, "__import__('os').mkdir('boom')"]),
    Kind("an unknown name", _nothing, [*ON_SQUARE, "x*z"]),
    Kind("a bracket that stays open", _nothing, [*ON_SQUARE, "sin(x"]),
    Kind("a function without values", _nothing, [*ON_SQUARE, "log(-1 - x)"]),
    Kind("an unknown suffix in", lambda: Path("in.xyz").touch(), ["in.xyz", "a.ply", "--tol", "1"]),
    Kind("an unknown suffix out", _heights(PLAIN), ["in.npy", "out.docx", "--tol", "1%"]),
    Kind("a missing file", _nothing, [*RASTER, "1%"]),
    Kind("a missing folder", _heights(PLAIN), ["in.npy", "none/out.ply", "--tol", "1%"]),
    Kind("a folder that refuses", _heights(PLAIN), ["in.npy", "", "--tol", "1%"]),
)


def words(kind: Kind) -> list[str]:
    """The words, with a folder in which nobody may create files: not even root in /proc."""
    refusing = Path("/proc") if Path("/proc").is_dir() else Path(os.devnull)
    return [word or str(refusing / "out.ply") for word in kind.words]
