"""What a MeshLab layer holds, as arrays, and how it gets there.

PyMeshLab gives arrays out but takes them only into new layers. To change a layer in place, as its
filters do, ``overwrite`` calls these filters: the faces are cut apart, sewn anew by numbers that
serve as coordinates for a while, and everything else is carried over vertex by vertex from a layer
that is deleted in the end.
"""

from __future__ import annotations

import faulthandler
import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh_adapters.attributes import Carrier

if TYPE_CHECKING:
    import pymeshlab

__all__ = ["Layer", "custom_names", "overwrite", "to_mesh"]

_KINDS = {
    "__ca_vs__": "vertex_custom_scalar_attribute_array",
    "__ca_vp__": "vertex_custom_point_attribute_matrix",
    "__ca_fs__": "face_custom_scalar_attribute_array",
    "__ca_fp__": "face_custom_point_attribute_matrix",
}


@dataclass(frozen=True, eq=False)
class Layer:
    """The arrays of a layer; of its optional parts those it has, by PyMeshLab's own names.

    ``points`` (n, 3), ``triangles`` (m, 3); ``vertex`` and ``face``: arrays (n, ...) and (m, ...)
    by name: scalar, color (RGBA from 0 to 1), selection, tex_coord, wedge_tex_coord (m, 3, 2);
    ``custom``: by kind, such as ``"__ca_vs__"``, and name.
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    vertex: dict[str, NDArray[Any]] = field(default_factory=dict)
    face: dict[str, NDArray[Any]] = field(default_factory=dict)
    custom: dict[tuple[str, str], NDArray[Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, mesh: pymeshlab.Mesh, names: list[tuple[str, str]]) -> Layer:
        """Read a mesh and its custom attributes, which PyMeshLab names only in a ``MeshSet``."""
        if not mesh.is_compact():
            mesh.compact()
        if not mesh.face_number():
            raise InputError("The layer has no faces: give a triangle mesh.")
        vertex = {"color": mesh.vertex_color_matrix(), "selection": mesh.vertex_selection_array()}
        face = {"selection": mesh.face_selection_array()}
        if mesh.has_vertex_scalar():
            vertex["scalar"] = mesh.vertex_scalar_array()
        if mesh.has_vertex_tex_coord():
            vertex["tex_coord"] = mesh.vertex_tex_coord_matrix()
        if mesh.has_face_scalar():
            face["scalar"] = mesh.face_scalar_array()
        if mesh.has_face_color():
            face["color"] = mesh.face_color_matrix()
        if mesh.has_wedge_tex_coord():
            face["wedge_tex_coord"] = mesh.wedge_tex_coord_matrix().reshape(-1, 3, 2)
        custom = {(kind, name): getattr(mesh, _KINDS[kind])(name) for kind, name in names}
        triangles = np.array(mesh.face_matrix(), np.int64)
        return cls(np.array(mesh.vertex_matrix()), triangles, vertex, face, custom)

    def carried(
        self, points: NDArray[np.float64], triangles: NDArray[np.int64], carrier: Carrier
    ) -> Layer:
        """What this layer knows, on new points and triangles."""
        vertex = {name: carrier.at_vertices(values) for name, values in self.vertex.items()}
        face = {name: carrier.at_triangles(values) for name, values in self.face.items()}
        if "wedge_tex_coord" in face:
            face["wedge_tex_coord"] = carrier.at_corners(
                self.face["wedge_tex_coord"], self.triangles, triangles
            )
        custom = {
            (kind, name): carrier.at_vertices(values)
            if kind.startswith("__ca_v")
            else carrier.at_triangles(values)
            for (kind, name), values in self.custom.items()
        }
        return Layer(points, triangles, vertex, face, custom)


def custom_names(meshset: pymeshlab.MeshSet) -> list[tuple[str, str]]:
    """Kinds and names of the current layer's custom attributes: options of saving a ``.ply``."""
    keys = [key for key in meshset.filter_parameter_values("ply") if key[:9] in _KINDS]
    names = [(key[:9], key[9:]) for key in keys]
    mesh = meshset.current_mesh()
    for kind, name in names:
        try:
            getattr(mesh, _KINDS[kind])(name)
        except Exception:  # noqa: BLE001 its own kind of exception, defined in a binary
            raise InputError(
                f"The custom attribute {name} has blanks or signs in its name, which MeshLab's "
                "filters refuse: give it another name."
            ) from None
    return names


def to_mesh(layer: Layer) -> pymeshlab.Mesh:
    """A mesh with all but the selection, which PyMeshLab takes from filters alone."""
    import pymeshlab

    none, plane = np.zeros(0), np.zeros((0, 2))
    wedge = layer.face.get("wedge_tex_coord", plane).reshape(-1, 2)
    mesh = pymeshlab.Mesh(
        vertex_matrix=layer.points,
        face_matrix=layer.triangles.astype(np.int32),
        v_scalar_array=layer.vertex.get("scalar", none),
        f_scalar_array=layer.face.get("scalar", none),
        v_color_matrix=layer.vertex.get("color", np.zeros((0, 4))),
        f_color_matrix=layer.face.get("color", np.zeros((0, 4))),
        v_tex_coords_matrix=layer.vertex.get("tex_coord", plane),
        w_tex_coords_matrix=wedge,
    )
    adders = {
        "__ca_vs__": mesh.add_vertex_custom_scalar_attribute,
        "__ca_vp__": mesh.add_vertex_custom_point_attribute,
        "__ca_fs__": mesh.add_face_custom_scalar_attribute,
        "__ca_fp__": mesh.add_face_custom_point_attribute,
    }
    for (kind, name), values in layer.custom.items():
        adders[kind](values, name)
    return mesh


def overwrite(meshset: pymeshlab.MeshSet, layer: Layer, *, new: bool = False) -> None:
    """Make the current layer equal to ``layer``, its vertices in some other order.

    Its number, label, matrix and textures stay; ``new`` leaves it alone and does so with a copy,
    the current layer afterwards.

    Raises InputError where the layer is damaged: PyMeshLab's filters write beyond custom attributes
    of vertices that a mesh had before ``MeshSet.add_mesh`` copied it.
    """
    matrix = meshset.current_mesh().transform_matrix()
    if not _sane(meshset, layer):
        raise InputError(
            "PyMeshLab's filters crash on custom vertex attributes from before add_mesh(): add "
            "them to current_mesh() afterwards."
        )
    if new:
        label = meshset.current_mesh().label()
        meshset.generate_copy_of_current_mesh()  # without custom attributes
        meshset.current_mesh().set_label(f"{label} (equimesh)")
    meshset.set_matrix(transformmatrix=np.eye(4), freeze=False)
    writer = _Writer(meshset)
    writer.cut_apart(len(layer.triangles))
    writer.faces(layer)
    writer.sew(layer.triangles)
    writer.vertices(layer)
    meshset.set_matrix(transformmatrix=matrix, freeze=False)


def _sane(meshset: pymeshlab.MeshSet, layer: Layer) -> bool:
    """Whether a filter on vertices survives this layer; a child process finds out."""
    if not any(kind.startswith("__ca_v") for kind, _ in layer.custom) or not hasattr(os, "fork"):
        return True
    child = os.fork()
    if child == 0:
        faulthandler.disable()
        try:
            meshset.compute_selection_by_condition_per_vertex(condselect="(1 < 0)")
        finally:
            os._exit(0)
    return os.waitpid(child, 0)[1] == 0


class _Writer:
    """Filters applied to one layer, with arrays as their arguments."""

    def __init__(self, meshset: pymeshlab.MeshSet) -> None:
        self.set = meshset
        self.number = meshset.current_mesh_id()
        self.mesh = meshset.current_mesh()

    def cut_apart(self, count: int) -> None:
        """Exactly ``count`` faces, each with three vertices of its own."""
        self.set.meshing_poly_to_tri()  # no side of a face is to be hidden any more
        while True:
            # vertices are divided where the normals of their faces differ, and now all do
            self.set.compute_normal_by_function_per_face(x="fi", y="1", z="0")
            self.set.meshing_vertex_attribute_seam(normalmode="Face")
            self.mesh.compact()
            if self.mesh.face_number() >= count:
                break
            self._spread()
            self._divide()
            self.mesh.compact()
        self.set.set_selection_none()
        self.set.compute_selection_by_condition_per_face(condselect=f"(fi >= {count})")
        self.set.meshing_remove_selected_faces()
        self.set.meshing_remove_unreferenced_vertices()
        self.mesh.compact()
        self._spread()

    def faces(self, layer: Layer) -> None:
        """What belongs to faces, while each has its own vertices."""
        corners = self.mesh.face_matrix()
        for (kind, name), values in layer.custom.items():
            if kind == "__ca_fs__":
                self._send(np.repeat(values, 3), corners.ravel())
                self.set.compute_new_custom_scalar_attribute_per_face(name=name, expr="nx0")
            elif kind == "__ca_fp__":
                self._send(np.repeat(values, 3, axis=0), corners.ravel())
                self.set.compute_new_custom_point_attribute_per_face(
                    name=name, x_expr="nx0", y_expr="ny0", z_expr="nz0"
                )
        if "wedge_tex_coord" in layer.face:
            self._send(layer.face["wedge_tex_coord"].reshape(-1, 2), corners.ravel())
            self.set.compute_texcoord_by_function_per_wedge(
                u0="nx0", v0="ny0", u1="nx1", v1="ny1", u2="nx2", v2="ny2"
            )
        if "color" in layer.face:
            bytes_ = np.repeat(np.rint(255.0 * layer.face["color"]), 3, axis=0)
            self._send(bytes_[:, :3], corners.ravel(), bytes_[:, 3])
            self.set.compute_color_by_function_per_face(r="nx0", g="ny0", b="nz0", a="q0")
        self._send(np.repeat(layer.face["selection"], 3), corners.ravel())
        self.set.compute_selection_by_condition_per_face(condselect="(nx0 > 0.5)")
        if "scalar" in layer.face:
            self._send(np.repeat(layer.face["scalar"], 3), corners.ravel())
            self.set.compute_scalar_by_function_per_face(q="nx0")

    def sew(self, triangles: NDArray[np.int64]) -> None:
        """One vertex for each number in ``triangles`` (m, 3); it lies at (number, 0, 0)."""
        self._send(triangles.ravel(), self.mesh.face_matrix().ravel())
        self.set.compute_coord_by_function(x="nx", y="0", z="0")
        self.set.meshing_remove_duplicate_vertices()
        self.mesh.compact()

    def vertices(self, layer: Layer) -> None:
        """What belongs to vertices, and last of all where they lie."""
        places = np.arange(len(layer.points))
        for (kind, name), values in layer.custom.items():
            if kind == "__ca_vs__":
                self._send(values, places)
                self.set.compute_new_custom_scalar_attribute_per_vertex(name=name, expr="nx")
            elif kind == "__ca_vp__":
                self._send(values, places)
                self.set.compute_new_custom_point_attribute_per_vertex(
                    name=name, x_expr="nx", y_expr="ny", z_expr="nz"
                )
        if "tex_coord" in layer.vertex:
            self._send(layer.vertex["tex_coord"], places)
            self.set.compute_texcoord_by_function_per_vertex(u="nx", v="ny")
        if "color" in layer.vertex:
            bytes_ = np.rint(255.0 * layer.vertex["color"])
            self._send(bytes_[:, :3], places, bytes_[:, 3])
            self.set.compute_color_by_function_per_vertex(x="nx", y="ny", z="nz", a="q")
        self._send(layer.vertex["selection"], places)
        self.set.compute_selection_by_condition_per_vertex(condselect="(nx > 0.5)")
        self._send(layer.points, places, layer.vertex.get("scalar", np.zeros(len(places))))
        self.set.compute_coord_by_function(x="nx", y="ny", z="nz")

    def _spread(self) -> None:
        """Every vertex to its own place, (index, 0, 0)."""
        self.set.compute_coord_by_function(x="vi", y="0", z="0")

    def _divide(self) -> None:
        import pymeshlab

        self.set.meshing_surface_subdivision_midpoint(
            iterations=1, threshold=pymeshlab.PureValue(0)
        )
        self.mesh.compact()

    def _send(
        self,
        values: NDArray[Any],
        places: NDArray[np.int64],
        scalar: NDArray[Any] | None = None,
    ) -> None:
        """Up to three numbers to the normal of the vertex at (place, 0, 0), one to its scalar."""
        import pymeshlab

        rows = np.asarray(values, np.float64).reshape(len(places), -1)
        normals, at = np.zeros((2, len(places), 3))
        normals[:, : rows.shape[1]] = rows
        at[:, 0] = places
        q = np.zeros(len(places)) if scalar is None else np.asarray(scalar, np.float64)
        mesh = pymeshlab.Mesh(vertex_matrix=at, v_normals_matrix=normals, v_scalar_array=q)
        self.set.add_mesh(mesh, "", set_as_current=True)
        source = self.set.current_mesh_id()
        self.set.transfer_attributes_per_vertex(
            sourcemesh=source, targetmesh=self.number, colortransfer=False,
            normaltransfer=True, qualitytransfer=True, upperbound=pymeshlab.PercentageValue(100),
        )  # fmt: skip
        self.set.delete_current_mesh()
        self.set.set_current_mesh(self.number)
