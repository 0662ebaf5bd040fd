"""trimesh objects, and the files that trimesh reads: ply, stl, obj, off, glb.

ply, obj and off are written here in full double precision; stl and glb hold single precision by
their definition, about seven digits of each coordinate.
"""

from __future__ import annotations

import copy
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh
from equimesh_adapters.attributes import Carrier
from equimesh_adapters.surfaces import profiled, remeshed
from equimesh_adapters.welding import welded

if TYPE_CHECKING:
    import trimesh

__all__ = ["FORMAT", "from_result", "profile", "remesh", "to_field"]

SOUP = (".stl", ".obj", ".glb")  # a vertex may be stored once for each triangle or texture seam


def to_field(mesh: trimesh.Trimesh, *, up: Any = None) -> Surface:
    """The mesh as a surface seen along ``up``; its own arrays stay as they are.

    Raises InputError for a mesh that is no graph in this direction.
    """
    return Surface(np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64), up=up)


def from_result(result: equimesh.Result) -> trimesh.Trimesh:
    """A result as a trimesh, vertices and triangles in the same order.

    The face attribute ``error`` is the largest error of each triangle.
    """
    mesh = _mesh(result.points, result.triangles, result.profile.errors)
    mesh.metadata.update(result.metadata)
    return mesh


def remesh(
    mesh: trimesh.Trimesh, tol: float | str | None = None, *, up: Any = None, **options: Any
) -> trimesh.Trimesh:
    """``equimesh.remesh`` from a trimesh to a new trimesh, which keeps what the old one knew.

    Vertex attributes and texture coordinates are linear on the old triangles, vertex colours too
    (rounded); vertex attributes of whole numbers, flags or texts come from the nearest corner of
    the old triangle. Face attributes and face colours are those of the old face under the centroid.
    Metadata (with ``units``) and material are copied, triangles wound as before, and the face
    attribute ``error`` holds the largest error of each. Vertices are merged neither before nor
    after (``process=False``).

    Parameters
    ----------
    mesh
        One or several bodies: each is meshed for itself, in the order of their first faces.
    tol
        As in ``equimesh.remesh``; a share means that of the body with the largest range of heights.
    up
        The direction of heights, ``"x"``, ``"y"``, ``"z"`` or three numbers, for all bodies.
        Without it every body has its own.
    options
        ``target`` (divided among the bodies), ``effort``, ``seed``, ... of ``equimesh.remesh``.

    Raises
    ------
    InputError
        A body that is not a graph, with the share of its triangles to blame; a tolerance that is
        not met.
    """
    made = remeshed(mesh.vertices, mesh.faces, tol, up=up, **options)
    new = _mesh(made.points, made.triangles, made.errors)
    carrier = made.carrier
    for name, values in mesh.vertex_attributes.items():
        new.vertex_attributes[name] = carrier.at_vertices(values)
    for name, values in mesh.face_attributes.items():
        if name != "error":
            new.face_attributes[name] = carrier.at_triangles(values)
    new.metadata = copy.deepcopy(mesh.metadata)
    _carry_visual(mesh, new, carrier)
    return new


def profile(mesh: trimesh.Trimesh, against: Any, *, up: Any = None) -> equimesh.Profile:
    """The error of every face of a mesh, whichever program made it, against another surface.

    ``against`` is a trimesh, whose bodies are found again if there are as many, or anything that
    ``equimesh.profile`` takes.
    """
    if hasattr(against, "vertices") and hasattr(against, "faces"):
        against = (against.vertices, against.faces)
    return profiled(mesh.vertices, mesh.faces, against, up=up)


def _mesh(points: np.ndarray, triangles: np.ndarray, errors: np.ndarray) -> trimesh.Trimesh:
    try:
        import trimesh
    except ImportError:
        raise InputError("trimesh is not installed: pip install trimesh.") from None
    attributes = {"error": errors}
    return trimesh.Trimesh(points, triangles, face_attributes=attributes, process=False)


def _carry_visual(old: trimesh.Trimesh, new: trimesh.Trimesh, carrier: Carrier) -> None:
    visual = old.visual
    match visual.kind:
        case "vertex":
            new.visual.vertex_colors = carrier.colours_at_vertices(visual.vertex_colors)
        case "face":
            new.visual.face_colors = carrier.at_triangles(visual.face_colors)
        case "texture":
            texture = type(visual)
            uv = None if visual.uv is None else carrier.at_vertices(visual.uv)
            new.visual = texture(uv=uv, material=copy.deepcopy(visual.material))


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


FORMAT = Format(
    (".ply", ".stl", ".obj", ".off", ".glb"), read, write,
    types=("trimesh.Trimesh",), to_field=to_field, remesh=remesh,
)  # fmt: skip
