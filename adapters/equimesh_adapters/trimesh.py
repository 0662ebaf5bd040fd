"""trimesh objects, and the files that trimesh reads: ply, stl, obj, off, glb.

ply, obj and off are written here in full double precision; stl and glb hold single precision by
their definition, about seven digits of each coordinate.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh, in_space
from equimesh_adapters.welding import welded

if TYPE_CHECKING:
    import trimesh

__all__ = ["FORMAT", "from_result", "remesh", "to_field"]

SOUP = (".stl", ".obj", ".glb")  # a vertex may be stored once for each triangle or texture seam


def to_field(mesh: trimesh.Trimesh, *, up: Any = None) -> Surface:
    """The mesh as a surface; vertices stay as they are, unmerged."""
    return Surface(np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64), up=up)


def from_result(result: equimesh.Result) -> trimesh.Trimesh:
    """A result as a trimesh, vertices and triangles in the same order."""
    import trimesh

    return trimesh.Trimesh(result.points, result.triangles, process=False)


def remesh(
    mesh: trimesh.Trimesh, tol: float | str | None = None, **options: Any
) -> trimesh.Trimesh:
    """``equimesh.remesh`` from a trimesh to a trimesh; ``options`` are passed on.

    Raises InputError for a mesh that is not a graph over any direction, and where the tolerance
    is not met.
    """
    field = to_field(mesh, up=options.pop("up", None))
    result = equimesh.remesh(field, tol, **options)
    if not result.status.ok:
        raise InputError(result.status.value)
    return from_result(in_space(result, field))


def read(path: Path) -> TriangleMesh:
    """Every triangle of the file; a scene of several parts becomes one mesh."""
    import trimesh

    suffix = path.suffix.lower()
    options = {"skip_materials": True} if suffix == ".obj" else {}
    # From memory, not by name: what the file refers to (textures, buffers) is then not opened.
    loaded = trimesh.load_scene(
        io.BytesIO(path.read_bytes()), file_type=suffix[1:], process=False, **options
    ).to_mesh()
    mesh = TriangleMesh(np.array(loaded.vertices, np.float64), np.array(loaded.faces, np.int64))
    return welded(mesh) if suffix in SOUP else mesh


def write(path: Path, result: equimesh.Result) -> None:
    points, triangles = result.points, result.triangles
    match path.suffix.lower():
        case ".ply":
            _write_ply(path, points, triangles)
        case ".off":
            header = f"OFF\n{len(points)} {len(triangles)} 0"
            _write_text(path, header, points, np.insert(triangles, 0, 3, axis=1))
        case ".obj":
            _write_text(path, "# equimesh", points, triangles + 1, "v ", "f ")
        case suffix:
            path.write_bytes(from_result(result).export(file_type=suffix[1:]))


def _write_ply(path: Path, points: np.ndarray, triangles: np.ndarray) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment equimesh\n"
        f"element vertex {len(points)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    path.write_bytes(header.encode() + points.astype("<f8").tobytes() + faces.tobytes())


def _write_text(
    path: Path,
    header: str,
    points: np.ndarray,
    faces: np.ndarray,
    vertex_mark: str = "",
    face_mark: str = "",
) -> None:
    """Seventeen digits give every double back."""
    vertices = (f"{vertex_mark}{x:.17g} {y:.17g} {z:.17g}" for x, y, z in points.tolist())
    corners = (face_mark + " ".join(map(str, face)) for face in faces.tolist())
    path.write_text("\n".join([header, *vertices, *corners, ""]), encoding="ascii")


FORMAT = Format((".ply", ".stl", ".obj", ".off", ".glb"), read, write)
