"""PyVista: meshes as surfaces, images and grids as height fields, and the accessor ``.equimesh``.

PyVista finds the accessor by itself: ``mesh.equimesh.remesh(...)`` needs no import. The functions
here do the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import equimesh
from equimesh.errors import InputError
from equimesh.fields.base import Field
from equimesh.fields.raster import Raster
from equimesh.fields.surface import Surface
from equimesh.formats import Format, TriangleMesh
from equimesh_adapters.attributes import Carrier
from equimesh_adapters.surfaces import profiled, remeshed

if TYPE_CHECKING:
    import pyvista

__all__ = ["FORMAT", "GRIDS", "Accessor", "from_result", "profile", "remesh", "to_field"]

# VTK's marks of what is there but not shown.
_GHOSTS, _HIDDEN_POINT, _HIDDEN_CELL = "vtkGhostType", 2, 32


def to_field(
    dataset: pyvista.DataSet, *, scalars: str | None = None, up: Any = None
) -> Raster | Surface:
    """A dataset as a field.

    Parameters
    ----------
    dataset
        ``PolyData`` (polygons and strips are cut into triangles) or a ``StructuredGrid`` of one
        layer: a ``Surface``. ``ImageData`` or an equally spaced ``RectilinearGrid`` of one layer in
        x and y: a ``Raster`` with its affine transform; the z of its points does not matter.
    scalars
        The point data with the heights. Without it an image takes its active scalars, and a
        structured grid the z of its points. NaN and hidden points are holes.
    up
        The direction of heights of a surface.

    Raises
    ------
    InputError
        Another dataset, several layers, point data that do not exist, or no graph.
    """
    source = _source(dataset, scalars)
    if isinstance(source, _Grid):
        if up is not None:
            raise InputError("The heights of an image are its scalars: leave out up=.")
        return source.raster
    return Surface(source.points, source.triangles, up=up)


def from_result(result: equimesh.Result, scalars: str = "value") -> pyvista.PolyData:
    """A result as ``PolyData``.

    Point data ``scalars``: the heights; cell data ``error``: the largest error of each triangle;
    field data: what the result's ``metadata`` tells in words.
    """
    mesh = _mesh(result.points, result.triangles, result.profile.errors)
    mesh.point_data[scalars] = result.points[:, 2]
    for name, value in result.metadata.items():
        if isinstance(value, str):
            mesh.field_data[name] = [value]
    return mesh


def remesh(
    dataset: pyvista.DataSet,
    tol: float | str | None = None,
    *,
    scalars: str | None = None,
    up: Any = None,
    **options: Any,
) -> pyvista.PolyData:
    """``equimesh.remesh`` from a dataset to new ``PolyData``, which keep what the old one knew.

    Point data are linear on the old triangles, or bilinear on the cells of an image; whole numbers,
    flags and texts come from the nearest corner, colours (three or four bytes) are blended. Cell
    data are those of the cell under the centroid. Field data, names and the active scalars stay.
    Cell data ``error`` are the largest errors of the triangles, and point data by the name of
    ``scalars``, else ``value``, the heights. Bodies of ``PolyData`` are meshed one by one.

    ``dataset``, ``scalars`` and ``up`` are those of ``to_field``, ``options`` those of
    ``equimesh.remesh``. Raises InputError as both do, and where the tolerance is not met.
    """
    source = _source(dataset, scalars)
    if isinstance(source, _Grid):
        result = equimesh.remesh(to_field(dataset, scalars=scalars, up=up), tol, **options)
        if not result.status.usable:
            raise InputError(result.status.value)
        new = from_result(result, source.scalars)
        carrier = source.carrier(result.points, result.triangles)
        heights = {source.scalars}
    else:
        made = remeshed(source.points, source.triangles, tol, up=up, **options)
        new = _mesh(made.points, made.triangles, made.errors)
        new.point_data[scalars or "value"] = made.heights
        carrier = replace(made.carrier, faces=source.cells[made.carrier.faces])
        heights = {scalars} if scalars else set()
    _carry(source.dataset, new, carrier, without=heights)
    return new


def profile(
    mesh: pyvista.DataSet, against: Any, *, scalars: str | None = None, up: Any = None
) -> equimesh.Profile:
    """The error of every triangle of ``PolyData`` against another dataset or any source.

    ``scalars`` and ``up`` tell how to see ``against``, as in ``to_field``. Where polygons are cut,
    a profile has more triangles than the mesh has cells.
    """
    own = _source(mesh, None)
    if isinstance(own, _Grid):
        raise InputError("An image is no mesh: give the PolyData to be measured first.")
    if hasattr(against, "point_data") and hasattr(against, "n_points"):
        source = _source(against, scalars)
        flat = isinstance(source, _Grid)
        against = source.raster if flat else (source.points, source.triangles)
    return profiled(own.points, own.triangles, against, up=up)


class Accessor:
    """What ``dataset.equimesh`` offers: the functions of this module, the dataset given."""

    def __init__(self, dataset: pyvista.DataSet) -> None:
        self._dataset = dataset

    def remesh(self, tol: float | str | None = None, **options: Any) -> pyvista.PolyData:
        """See ``equimesh_adapters.pyvista.remesh``."""
        return remesh(self._dataset, tol, **options)

    def profile(self, against: Any, **options: Any) -> equimesh.Profile:
        """See ``equimesh_adapters.pyvista.profile``."""
        return profile(self._dataset, against, **options)

    def to_field(self, **options: Any) -> Raster | Surface:
        """See ``equimesh_adapters.pyvista.to_field``."""
        return to_field(self._dataset, **options)


def read(path: Path) -> TriangleMesh | Field:
    source = _source(_library().read(path), None)
    if isinstance(source, _Grid):
        return source.raster
    return TriangleMesh(source.points, source.triangles)


def write(path: Path, result: equimesh.Result) -> None:
    from_result(result).save(path)


@dataclass(frozen=True, eq=False)
class _Triangles:
    """A dataset as ``points`` (n, 3), its points, and ``triangles`` (m, 3) of ``cells`` (m,)."""

    dataset: pyvista.DataSet
    points: NDArray[np.float64]
    triangles: NDArray[np.int64]
    cells: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Grid:
    """An image as a raster of the point data ``scalars``."""

    dataset: pyvista.DataSet
    raster: Raster
    scalars: str

    def carrier(self, points: NDArray[np.float64], triangles: NDArray[np.int64]) -> Carrier:
        """Bilinear weights at points, cells under centroids."""
        columns = self.dataset.dimensions[0]
        cell, inside = self._places(points[:, :2])
        (s, t), one = inside.T, 1.0 - inside.T
        weights = np.stack([one[0] * one[1], s * one[1], one[0] * t, s * t], axis=1)
        corners = (cell @ [1, columns])[:, None] + [0, 1, columns, columns + 1]
        middle, _ = self._places(points[triangles, :2].mean(axis=1))
        return Carrier(corners, weights, middle @ [1, columns - 1], cell @ [1, columns - 1])

    def _places(self, xy: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """(n, 2) columns and rows of cells and the places inside them, from 0 to 1."""
        a, b, c, d, e, f = self.raster.transform or (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        index = np.linalg.solve([[a, b], [d, e]], (xy - [c, f]).T).T
        last = np.array(self.dataset.dimensions[:2]) - 2
        cell = np.clip(np.floor(index).astype(np.int64), 0, last)
        return cell, np.clip(index - cell, 0.0, 1.0)


def _library() -> ModuleType:
    try:
        import pyvista
    except ImportError:
        raise InputError("PyVista is not installed: pip install 'equimesh[pyvista]'.") from None
    return pyvista


def _source(dataset: pyvista.DataSet, scalars: str | None) -> _Triangles | _Grid:
    library = _library()
    if isinstance(dataset, library.PolyData):
        if scalars is not None:
            raise InputError("The heights of PolyData are coordinates: leave out scalars=.")
        cut = dataset.triangulate()
        triangles = np.array(cut.regular_faces, np.int64).reshape(-1, 3)
        return _Triangles(cut, np.array(cut.points, np.float64), triangles, np.arange(cut.n_cells))
    if isinstance(dataset, library.StructuredGrid):
        return _structured(dataset, scalars)
    if isinstance(dataset, library.RectilinearGrid):
        _one_layer(dataset)
        x, y = np.asarray(dataset.x, np.float64), np.asarray(dataset.y, np.float64)
        steps = [(axis[-1] - axis[0]) / (len(axis) - 1) for axis in (x, y)]
        even = [np.allclose(np.diff(axis), step, rtol=1e-9, atol=0.0)
                for axis, step in zip((x, y), steps, strict=True)]  # fmt: skip
        name = _height_name(dataset, scalars)
        if not all(even):
            return _structured(dataset.cast_to_structured_grid(), name)
        return _image(dataset, name, (steps[0], 0.0, x[0], 0.0, steps[1], y[0]))
    if isinstance(dataset, library.ImageData):
        _one_layer(dataset)
        turn = np.array(dataset.direction_matrix, np.float64)
        step, corner = turn[:, :2] * dataset.spacing[:2], np.array(dataset.GetPoint(0))
        if np.abs(turn[2, :2]).max() > 1e-12:
            raise InputError("The image is tilted: give one that lies in a plane of constant z.")
        (a, b), (d, e) = step[:2]
        return _image(dataset, _height_name(dataset, scalars), (a, b, corner[0], d, e, corner[1]))
    raise InputError(
        f"A {type(dataset).__name__} is no height field: give PolyData (extract_surface() makes "
        "it), ImageData, a RectilinearGrid or a StructuredGrid."
    )


def _one_layer(grid: Any) -> None:
    columns, rows, layers = grid.dimensions
    if layers != 1 or min(columns, rows) < 2:
        raise InputError(
            f"The grid has {columns} x {rows} x {layers} points: give one layer in x and y."
        )


def _height_name(grid: Any, scalars: str | None) -> str:
    """The point data with the heights: those named, else the active ones, else the only ones."""
    names = [name for name in grid.point_data if name != _GHOSTS]
    if scalars is None and grid.point_data.active_scalars_name in names:
        scalars = grid.point_data.active_scalars_name
    if scalars is None and len(names) == 1:
        scalars = names[0]
    if scalars not in names:
        chosen = f"no point data {scalars!r}" if scalars else "no active point data"
        choice = f"one of {', '.join(names)}" if names else "them, by cell_data_to_point_data()"
        raise InputError(f"The grid has {chosen} to take heights from: choose scalars= {choice}.")
    if grid.point_data[scalars].ndim != 1:
        raise InputError(f"The point data {scalars!r} have several components: choose scalars=.")
    return scalars


def _image(grid: Any, scalars: str, transform: tuple[float, ...]) -> _Grid:
    columns, rows, _ = grid.dimensions
    heights = np.array(grid.point_data[scalars], np.float64)
    if _GHOSTS in grid.point_data:
        heights[np.asarray(grid.point_data[_GHOSTS]) & _HIDDEN_POINT > 0] = np.nan
    return _Grid(grid, Raster(heights.reshape(rows, columns), transform=transform), scalars)


def _structured(grid: Any, scalars: str | None) -> _Triangles:
    """Every cell as two triangles, without those that are hidden or lack a height."""
    _one_layer(grid)
    columns, rows, _ = grid.dimensions
    points = np.array(grid.points, np.float64)
    if scalars is not None:
        points[:, 2] = grid.point_data[_height_name(grid, scalars)]
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    quads = first[:, None] + [0, 1, columns + 1, columns]
    hidden = ~np.isfinite(points).all(axis=1)
    if _GHOSTS in grid.point_data:
        hidden |= np.asarray(grid.point_data[_GHOSTS]) & _HIDDEN_POINT > 0
    seen = ~hidden[quads].any(axis=1)
    if _GHOSTS in grid.cell_data:
        seen &= np.asarray(grid.cell_data[_GHOSTS]) & _HIDDEN_CELL == 0
    points[hidden] = 0.0
    triangles = quads[seen][:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return _Triangles(grid, points, triangles, np.repeat(np.flatnonzero(seen), 2))


def _mesh(points: NDArray[Any], triangles: NDArray[Any], errors: NDArray[Any]) -> Any:
    mesh = _library().PolyData.from_regular_faces(points, triangles)
    mesh.cell_data["error"] = errors
    return mesh


def _carry(old: Any, new: Any, carrier: Carrier, without: set[str]) -> None:
    normals = old.point_data.active_normals_name
    for name in old.point_data:
        if name in without or name == _GHOSTS:
            continue
        values = np.asarray(old.point_data[name])
        colour = values.dtype == np.uint8 and values.ndim == 2 and values.shape[1] in (3, 4)
        carried = carrier.colours_at_vertices(values) if colour else carrier.at_vertices(values)
        if name == normals:
            lengths = np.linalg.norm(carried, axis=1, keepdims=True)
            carried = carried / np.where(lengths > 0.0, lengths, 1.0)
        new.point_data[name] = carried
    for name in old.cell_data:
        if name not in ("error", _GHOSTS):
            new.cell_data[name] = carrier.at_triangles(old.cell_data[name])
    for name in old.field_data:
        new.field_data[name] = np.array(old.field_data[name])
    new.point_data.active_normals_name = normals
    new.point_data.active_texture_coordinates_name = old.point_data.active_texture_coordinates_name
    for data, place in ((old.point_data, "point"), (old.cell_data, "cell")):
        if data.active_scalars_name and old.active_scalars_info.association == data.association:
            new.set_active_scalars(data.active_scalars_name, preference=place)


FORMAT = Format(
    (".vtp",), read, write,
    types=tuple(f"pyvista.{name}" for name in
                ("PolyData", "ImageData", "RectilinearGrid", "StructuredGrid")),
    to_field=to_field, remesh=remesh,
)  # fmt: skip
GRIDS = Format((".vti", ".vtr", ".vts"), read)
