"""PyMeshLab: filters on the layers of a ``MeshSet``, with MeshLab's names and kinds of parameters.

>>> import pymeshlab
>>> from equimesh_adapters.pymeshlab import register
>>> register()
>>> layers = pymeshlab.MeshSet()
>>> layers.create_grid(numvertx=9, numverty=9)
>>> layers.meshing_equimesh_remeshing(maxerror=pymeshlab.PercentageValue(1))["face_number"]
2

``register`` adds three methods to ``pymeshlab.MeshSet``; they take keywords only, work on the
current layer and its vertices before its transform matrix is applied, and give dictionaries.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

import equimesh
from equimesh.errors import InputError
from equimesh.fields.surface import Surface
from equimesh.formats import Format
from equimesh_adapters.pymeshlab_layers import Layer, custom_names, overwrite, to_mesh
from equimesh_adapters.stitching import remeshed_part
from equimesh_adapters.surfaces import profiled, remeshed

if TYPE_CHECKING:
    import pymeshlab

__all__ = ["FORMAT", "from_result", "profile", "register", "remesh", "to_field"]

_ERROR = "interpolation_error"


def to_field(mesh: pymeshlab.Mesh | pymeshlab.MeshSet, *, up: Any = None) -> Surface:
    """A mesh, or the current layer of a ``MeshSet``, as a surface seen along ``up``.

    Raises InputError for a mesh that is no graph in this direction.
    """
    layer = Layer.of(_mesh_of(mesh), [])
    return Surface(layer.points, layer.triangles, up=up)


def from_result(result: equimesh.Result) -> pymeshlab.Mesh:
    """A result as a mesh; the scalars of its faces are the largest errors."""
    _library()
    return to_mesh(Layer(result.points, result.triangles, face={"scalar": result.profile.errors}))


def remesh(
    mesh: pymeshlab.Mesh | pymeshlab.MeshSet,
    tol: float | str | None = None,
    *,
    up: Any = None,
    **options: Any,
) -> pymeshlab.Mesh:
    """``equimesh.remesh`` from a mesh to a new one, which keeps what the filter keeps.

    ``tol`` and ``options`` are those of ``equimesh.remesh``. Of a ``MeshSet`` the current layer is
    taken; none is changed. The selection is left behind.

    Raises InputError for a mesh that is no graph, and where the tolerance is not met.
    """
    library = _library()
    if isinstance(mesh, library.MeshSet):
        names = custom_names(mesh)
    else:
        alone = library.MeshSet()
        alone.add_mesh(mesh)
        names = custom_names(alone)
    old = Layer.of(_mesh_of(mesh), names)
    made = remeshed(old.points, old.triangles, tol, up=up, **options)
    return to_mesh(old.carried(made.points, made.triangles, made.carrier))


def profile(
    mesh: pymeshlab.Mesh | pymeshlab.MeshSet, against: Any, *, up: Any = None
) -> equimesh.Profile:
    """The error of every face of a mesh against another mesh or any source."""
    library = _library()
    own = Layer.of(_mesh_of(mesh), [])
    if isinstance(against, (library.Mesh, library.MeshSet)):
        other = Layer.of(_mesh_of(against), [])
        against = (other.points, other.triangles)
    return profiled(own.points, own.triangles, against, up=up)


def register() -> None:
    """Bind the filters to ``pymeshlab.MeshSet``; once more does no harm.

    Raises InputError where PyMeshLab is not installed.
    """
    methods = (
        meshing_equimesh_remeshing,
        compute_scalar_by_interpolation_error_per_face,
        get_error_profile,
    )
    for method in methods:
        setattr(_library().MeshSet, method.__name__, method)


def meshing_equimesh_remeshing(
    self: pymeshlab.MeshSet,
    *,
    maxerror: pymeshlab.PercentageValue | pymeshlab.PureValue | None = None,
    targetfacenum: int = 0,
    fit: str = "interpolate",
    effort: str = "balanced",
    selectedonly: bool = False,
    newlayer: bool = False,
    up: Any = None,
) -> dict[str, Any]:
    """Remesh the current layer with few faces whose error nowhere exceeds a bound.

    Scalars, colours (as numbers from 0 to 1), texture coordinates and custom attributes of vertices
    are linear on the old faces; a vertex is selected if the nearest corner of the old face is. All
    that belongs to faces comes from the old face under the centroid. The layer keeps its number,
    label, matrix and textures; normals are computed anew. Bodies are remeshed one by one, each seen
    along z if it is a graph over x and y, else along its mean normal.

    Parameters
    ----------
    maxerror
        The largest distance, along the direction in which heights run, between the old surface and
        the new one. ``PureValue``: in the units of the layer. ``PercentageValue``: of the diagonal
        of its bounding box, as everywhere in MeshLab (in ``equimesh.remesh``, ``"1%"`` is a share
        of the range of heights). Without it 1 % of the diagonal.
    targetfacenum
        If not 0: this many faces instead of a bound; of the selected faces with ``selectedonly``.
    fit, effort
        As in ``equimesh.remesh``.
    selectedonly
        Remesh the selected faces and stitch them to the rest: all vertices on the border of the
        selection stay, and faces beyond are divided where the border gets further ones.
    newlayer
        Leave the layer as it is and put the result into a new one, the current layer afterwards.
    up
        Where heights run, instead: ``"x"``, ``"y"``, ``"z"`` or three numbers.

    Returns
    -------
    dict
        ``face_number``, ``vertex_number``, ``max_error`` and ``error_bound`` of the new faces, and
        ``tolerance`` in the units of the layer.

    Raises
    ------
    InputError
        Parameters of another kind, a body that is no graph, nothing selected, a bound not met.
    """
    mesh = _current(self)
    old = Layer.of(mesh, custom_names(self))
    options: dict[str, Any] = {"fit": fit, "effort": effort, "up": up}
    tol = None
    if targetfacenum:
        options["target"] = targetfacenum
    else:
        tol = _length(maxerror, mesh)
    if selectedonly:
        made = remeshed_part(old.points, old.triangles, old.face["selection"], tol, **options)
    else:
        made = remeshed(old.points, old.triangles, tol, **options)
    overwrite(self, old.carried(made.points, made.triangles, made.carrier), new=newlayer)
    return {
        "face_number": len(made.triangles),
        "vertex_number": len(made.points),
        "max_error": float(made.errors.max()),
        "error_bound": float(made.bounds.max()),
        "tolerance": made.tol,
    }


def compute_scalar_by_interpolation_error_per_face(
    self: pymeshlab.MeshSet, *, referencemesh: int, up: Any = None
) -> dict[str, float]:
    """Set the scalar of each face of the current layer to its largest error against another layer.

    ``compute_color_from_scalar_per_face`` then shows it. The numbers are kept as a custom
    attribute of the faces too, ``interpolation_error``; as PyMeshLab never overwrites one, further
    calls number it: ``interpolation_error_2``, ...

    ``referencemesh`` is the number of the layer with the surface, ``up`` the direction of heights.
    Gives the dictionary of ``get_error_profile``, without ``errors``.
    """
    figures = get_error_profile(self, referencemesh=referencemesh, up=up)
    errors = figures.pop("errors")
    taken = {name for _, name in custom_names(self)}
    name, count = _ERROR, 1
    while name in taken:
        count += 1
        name = f"{_ERROR}_{count}"
    self.current_mesh().add_face_custom_scalar_attribute(errors, name)
    self.compute_scalar_by_function_per_face(q=name)
    return figures


def get_error_profile(
    self: pymeshlab.MeshSet, *, referencemesh: int, up: Any = None
) -> dict[str, Any]:
    """How far the current layer is from another one, measured over the whole of every face.

    ``referencemesh`` is the number of the layer with the surface, ``up`` the direction of heights.

    Returns
    -------
    dict
        ``max``, ``bound`` (never exceeded), ``avg``, ``RMS``, ``med`` and ``q90``, ``q99`` over the
        faces' largest errors, ``diag_mesh`` (diagonal of the reference's bounding box) and
        ``errors`` (m,), one for each face.
    """
    own = Layer.of(_current(self), [])
    if not self.mesh_id_exists(referencemesh):
        raise InputError(f"There is no layer {referencemesh}: give the number of another one.")
    reference = self.mesh(referencemesh)
    other = Layer.of(reference, [])
    found = profiled(own.points, own.triangles, (other.points, other.triangles), up=up)
    return {
        "max": found.max,
        "bound": found.bound,
        "avg": float(found.errors.mean()),
        "RMS": float(np.sqrt(np.mean(found.errors**2))),
        "med": found.quantile(0.5),
        "q90": found.quantile(0.9),
        "q99": found.quantile(0.99),
        "diag_mesh": float(reference.bounding_box().diagonal()),
        "errors": found.errors,
    }


def _library() -> ModuleType:
    try:
        import pymeshlab
    except ImportError:
        raise InputError("PyMeshLab is not installed: pip install 'equimesh[pymeshlab]'.") from None
    return pymeshlab


def _mesh_of(mesh: pymeshlab.Mesh | pymeshlab.MeshSet) -> pymeshlab.Mesh:
    library = _library()
    if isinstance(mesh, library.MeshSet):
        return _current(mesh)
    if not isinstance(mesh, library.Mesh):
        raise InputError(f"A {type(mesh).__name__} is no mesh: give a pymeshlab.Mesh or MeshSet.")
    return mesh


def _current(meshset: pymeshlab.MeshSet) -> pymeshlab.Mesh:
    if not meshset.mesh_number():
        raise InputError("The MeshSet has no layer: load or add a mesh first.")
    return meshset.current_mesh()


def _length(value: Any, mesh: pymeshlab.Mesh) -> float:
    library = _library()
    if value is None:
        value = library.PercentageValue(1)
    if isinstance(value, library.PercentageValue):
        box = np.ptp(mesh.vertex_matrix(), axis=0)
        return 0.01 * _decimal(value.value()) * float(np.linalg.norm(box))
    if isinstance(value, library.PureValue):
        return _decimal(value.value())
    raise InputError(
        "The maxerror is no length: give pymeshlab.PercentageValue(1) or pymeshlab.PureValue(0.1)."
    )


def _decimal(value: float) -> float:
    """What the user wrote: PyMeshLab keeps such numbers in single precision."""
    return float(str(np.float32(value)))


FORMAT = Format(types=("pymeshlab.Mesh", "pymeshlab.MeshSet"), to_field=to_field, remesh=remesh)
