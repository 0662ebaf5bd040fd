"""Round trips: an object of a tool, equimesh, and an object of the tool again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import independent
import numpy as np
from wave_square import BOX, TOL, N, Trip, digest, halves, linear, mesh_fault, result, same, surface

import equimesh
import equimesh_adapters
from equimesh.formats import formats

__all__ = ["TRIPS", "Trip", "file_trips"]

ROUNDED = {".stl": 1e-7, ".glb": 1e-7, ".inp": 1e-13}  # single precision; twenty characters

Array = np.ndarray


def of_trimesh(folder: Path) -> Trip:
    import trimesh

    from equimesh_adapters.trimesh import from_result, remesh, to_field

    points, triangles = surface()
    mesh = trimesh.Trimesh(
        points, triangles, process=False, metadata={"name": "wave", "units": "mm"},
        vertex_attributes={"linear": linear(points)},
        face_attributes={"half": halves(points, triangles)},
    )  # fmt: skip
    mesh.visual.vertex_colors = np.tile([10, 20, 30, 255], (len(points), 1)).astype(np.uint8)

    def state() -> str:
        attributes = mesh.vertex_attributes["linear"], mesh.face_attributes["half"]
        return digest(mesh.vertices, mesh.faces, *attributes, mesh.visual.vertex_colors)

    before = state()
    new = remesh(mesh, TOL)
    fault = mesh_fault(
        new.vertices, new.faces, new.vertex_attributes["linear"], new.face_attributes["half"]
    )
    if (new.metadata, new.units) != (mesh.metadata, "mm"):
        fault = fault or "metadata or units are lost"
    if (np.asarray(new.visual.vertex_colors) != [10, 20, 30, 255]).any():
        fault = fault or "colours changed"
    made = result()
    field = to_field(from_result(made))
    fault = fault or same(field.points, field.triangles, made)
    return Trip("trimesh", "attributes, colours, metadata", fault, state() != before)


def of_meshio(folder: Path) -> Trip:
    import meshio

    from equimesh_adapters.meshio import from_result, remesh, to_field

    points, triangles = surface()
    half = halves(points, triangles)
    rim = independent.boundary_edges(triangles)
    low = points[rim, 1].max(axis=1) == 0.0
    mesh = meshio.Mesh(
        points, [("triangle", triangles), ("line", rim)], {"linear": linear(points)},
        {"half": [half, np.zeros(len(rim), int)]}, field_data={"low": np.array([7, 1])},
        cell_sets={"left": [np.flatnonzero(half == 1), []], "low": [[], np.flatnonzero(low)]},
    )  # fmt: skip

    def state() -> str:
        data = mesh.point_data["linear"], *mesh.cell_data["half"]
        return digest(mesh.points, *(block.data for block in mesh.cells), *data)

    before = state()
    new = remesh(mesh, TOL)
    faces = new.get_cells_type("triangle")
    labels = new.get_cell_data("half", "triangle")
    fault = mesh_fault(new.points, faces, new.point_data["linear"], labels)
    if (np.asarray(new.cell_sets_dict["left"]["triangle"]) != np.flatnonzero(labels == 1)).any():
        fault = fault or "a set of triangles is not the same"
    lines = new.get_cells_type("line")
    lowest = np.flatnonzero(new.points[lines, 1].max(axis=1) == 0.0)
    if set(new.cell_sets_dict["low"]["line"]) != set(lowest):
        fault = fault or "a set of lines is not the same"
    if (new.field_data["low"] != [7, 1]).any():
        fault = fault or "field data are lost"
    made = result()
    back = from_result(made)
    field = to_field(back)
    fault = fault or same(field.points, field.triangles, made)
    fault = fault or _names_fault(
        made, lambda name: back.get_cells_type("line")[back.cell_sets_dict[name]["line"]]
    )
    return Trip("meshio", "point and cell data, sets, names", fault, state() != before)


def of_gmsh(folder: Path) -> Trip:
    import gmsh

    from equimesh_adapters.gmsh import from_result, remesh, to_field

    made = result()
    before = digest(made.points, made.triangles, made.profile.errors, made.boundary.edges)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        from_result(made)
        field = to_field()
        fault = same(field.points, field.triangles, made)
        groups = _gmsh_groups(gmsh)
        if groups != {(2, "surface"), *((1, name) for name in made.boundary.names)}:
            fault = fault or f"groups are {sorted(groups)}"
        coarse = remesh(tol=4.0 * TOL)
        fault = fault or independent.cover_fault(coarse.points, coarse.triangles, BOX)
        if not len(coarse.triangles) < len(made.triangles):
            fault = fault or "no fewer triangles"
        if _gmsh_groups(gmsh) != groups:
            fault = fault or "groups changed in place"
    finally:
        gmsh.finalize()
    after = digest(made.points, made.triangles, made.profile.errors, made.boundary.edges)
    return Trip("Gmsh model", "triangles, physical groups, in place", fault, after != before)


def _gmsh_groups(gmsh) -> set[tuple[int, str]]:
    groups = gmsh.model.getPhysicalGroups()
    return {(dimension, gmsh.model.getPhysicalName(dimension, tag)) for dimension, tag in groups}


def of_medit(folder: Path) -> Trip:
    from equimesh_adapters.medit import (
        MeditMesh,
        from_mmg,
        from_result,
        read_mesh,
        remesh,
        to_mmg,
        write_mesh,
    )  # fmt: skip

    points, triangles = surface()
    mesh = MeditMesh(points, triangles, halves(points, triangles))
    before = digest(mesh.points, mesh.triangles, mesh.references)
    new = remesh(mesh, TOL)
    fault = mesh_fault(new.points, new.triangles, linear(new.points), new.references)
    changed = digest(mesh.points, mesh.triangles, mesh.references) != before
    made = result()
    back = from_result(made)
    write_mesh(folder / "a.mesh", back)
    write_mesh(folder / "a.meshb", back)
    text, binary = read_mesh(folder / "a.mesh"), read_mesh(folder / "a.meshb")
    for other in (text, binary, from_mmg(to_mmg(back))):
        for name in ("points", "triangles", "references", "edges", "edge_references"):
            if (getattr(other, name) != getattr(back, name)).any():
                fault = fault or f"{name} are not the same"
    if dict(text.names) != dict(enumerate(made.boundary.names, 1)):
        fault = fault or "names are lost"
    return Trip("Medit and mmgpy", "references, edges, names", fault, changed)


def of_polydata(folder: Path) -> Trip:
    import pyvista

    from equimesh_adapters.pyvista import from_result, to_field

    points, triangles = surface()
    mesh = pyvista.PolyData.from_regular_faces(points, triangles)
    mesh.point_data["linear"] = linear(points)
    mesh.cell_data["half"] = halves(points, triangles)
    mesh.field_data["name"] = ["wave"]

    def state() -> str:
        data = mesh.point_data["linear"], mesh.cell_data["half"]
        return digest(mesh.points, mesh.faces, *data)

    before = state()
    new = mesh.equimesh.remesh(TOL)  # the accessor, which PyVista finds by itself
    faces = new.regular_faces
    fault = mesh_fault(new.points, faces, new.point_data["linear"], new.cell_data["half"])
    if list(new.field_data["name"]) != ["wave"]:
        fault = fault or "field data are lost"
    made = result()
    field = to_field(from_result(made))
    fault = fault or same(field.points, field.triangles, made)
    return Trip("PyVista PolyData", "point, cell and field data", fault, state() != before)


def of_grids(folder: Path) -> Trip:
    """Here the wave is an image and a grid, and its mesh always PolyData."""
    import pyvista

    points, _ = surface()
    image = pyvista.ImageData(dimensions=(N + 1, N + 1, 1), spacing=(1.0 / N, 1.0 / N, 1.0))
    image.point_data["height"] = points[:, 2]
    image.point_data["linear"] = linear(points)
    grid = pyvista.StructuredGrid(
        *(points[:, k].reshape(N + 1, N + 1, 1, order="F") for k in range(3))
    )
    grid.point_data["linear"] = linear(np.asarray(grid.points))
    fault, changed = "", False
    for dataset in (image, grid):
        before = digest(dataset.points, *dataset.point_data.values())
        new = dataset.equimesh.remesh(TOL)
        found = np.asarray(new.points, float)
        labels = halves(found, new.regular_faces)
        made = mesh_fault(found, new.regular_faces, new.point_data["linear"], labels)
        fault = fault or made
        changed |= digest(dataset.points, *dataset.point_data.values()) != before
    return Trip("PyVista ImageData, StructuredGrid", "heights, point data", fault, changed)


def of_pymeshlab(folder: Path) -> Trip:
    import pymeshlab

    from equimesh_adapters.pymeshlab import register

    register()
    points, triangles = surface()
    layers = pymeshlab.MeshSet(verbose=False)
    layers.add_mesh(
        pymeshlab.Mesh(points, triangles, v_scalar_array=linear(points),
                       f_scalar_array=halves(points, triangles).astype(float)), "wave",
    )  # fmt: skip
    layers.add_mesh(layers.current_mesh(), "old")
    layers.set_current_mesh(0)
    layers.meshing_equimesh_remeshing(maxerror=pymeshlab.PureValue(TOL))
    new = layers.current_mesh()
    fault = mesh_fault(
        new.vertex_matrix(), new.face_matrix(), new.vertex_scalar_array(), new.face_scalar_array()
    )
    told = layers.get_error_profile(referencemesh=1)
    if not 0.0 < told["max"] <= TOL:
        fault = fault or f"the profile tells {told}"
    layers.compute_scalar_by_interpolation_error_per_face(referencemesh=1)
    if not np.isclose(layers.current_mesh().face_scalar_array().max(), told["max"]):
        fault = fault or "the scalars of the faces are not the errors"
    if digest(layers.mesh(1).vertex_matrix()) != digest(points):
        fault = fault or "the other layer changed"
    return Trip("PyMeshLab layer", "scalars, profile, errors by face", fault, None)


def of_xarray(folder: Path) -> Trip:
    import xarray

    from equimesh_adapters.raster import remesh

    x, y = 5e5 + 30.0 * np.arange(60), 4e6 - 10.0 * np.arange(50)
    heights = np.sin(0.13 * np.arange(60)) * np.cos(0.11 * np.arange(50))[:, None]
    heights[20:24, 30:35] = np.nan
    array = xarray.DataArray(
        heights, {"y": y, "x": x}, ("y", "x"), "elevation", {"units": "m", "crs": "EPSG:32617"}
    )
    before = digest(array.values, array.x.values, array.y.values)
    new = remesh(array, TOL)
    fault = "" if np.nanmax(np.abs(new.values - heights)) <= TOL * (1.0 + 1e-9) else "off"
    if (np.isnan(new.values) != np.isnan(heights)).any():
        fault = fault or "missing samples are others"
    if (new.dims, new.name, new.attrs) != (array.dims, array.name, array.attrs):
        fault = fault or "dimensions, name or attributes are lost"
    if not (new.x.equals(array.x) and new.y.equals(array.y)):
        fault = fault or "coordinates changed"
    changed = digest(array.values, array.x.values, array.y.values) != before
    return Trip("xarray", "coordinates, attributes, holes, heights", fault, changed)


def of_rasterio(folder: Path) -> Trip:
    import rasterio
    from rasterio.transform import Affine

    heights = np.sin(0.13 * np.arange(60)) * np.cos(0.11 * np.arange(50))[:, None]
    heights[20:24, 30:35] = -9.0
    turned = Affine(8.0, 3.0, 5e5, 6.0, -4.0, 4e6)
    with rasterio.open(
        folder / "a.tif", "w", driver="GTiff", width=60, height=50, count=2, dtype="float64",
        transform=turned, crs="EPSG:32617", nodata=-9.0,
    ) as file:  # fmt: skip
        file.write(np.stack([0.0 * heights, heights]))
    before = digest(np.frombuffer((folder / "a.tif").read_bytes(), np.uint8))
    field = equimesh_adapters.load(folder / "a.tif", band=2)
    made = equimesh.remesh(field, TOL)
    row, column = np.nonzero(heights != -9.0)
    x, y = rasterio.transform.xy(turned, row, column)
    inner = (row % 49 > 0) & (column % 59 > 0)  # a sample on the rim may round to outside
    found = independent.interpolated(made.points, made.triangles, np.array(x), np.array(y))
    off = np.abs(found - heights[row, column])[inner]
    fault = "" if np.nanmax(off) <= TOL * (1.0 + 1e-9) else "farther away than the tolerance"
    equimesh_adapters.save(folder / "a.ply", made)
    with rasterio.open(folder / "a.tif") as file:
        if (folder / "a.prj").read_text() != file.crs.to_wkt(version="WKT1_ESRI"):
            fault = fault or "the .prj file is another"
    changed = digest(np.frombuffer((folder / "a.tif").read_bytes(), np.uint8)) != before
    return Trip("GeoTIFF, turned, band 2", "heights, CRS as .prj", fault, changed)


def of_su2(folder: Path) -> Trip:
    from equimesh_adapters.su2 import markers

    made = result()
    equimesh_adapters.save(folder / "a.su2", made)
    mesh = equimesh_adapters.load_mesh(folder / "a.su2")
    fault = same(mesh.points, mesh.triangles, made)
    found = markers((folder / "a.su2").read_text())
    return Trip("SU2", "markers", fault or _names_fault(made, found.__getitem__), None)


def of_calculix(folder: Path) -> Trip:
    import meshio

    made = result()
    equimesh_adapters.save(folder / "a.inp", made)
    mesh = meshio.read(folder / "a.inp")
    fault = "" if (mesh.get_cells_type("triangle") == made.triangles).all() else "triangles"
    for name in made.boundary.names:
        nodes = np.unique(made.boundary.edges_of(name))
        if not np.array_equal(mesh.point_sets[name.upper()], nodes):
            fault = fault or f"the node set {name} is another"
        if name.upper() not in mesh.cell_sets:
            fault = fault or f"the element set {name} is missing"
    return Trip("CalculiX", "node and element sets", fault, None)


def _names_fault(made: equimesh.Result, edges: Callable[[str], Array]) -> str:
    for name in made.boundary.names:
        if not np.array_equal(edges(name), made.boundary.edges_of(name)):
            return f"the curve {name} is another"
    return ""


TRIPS: tuple[Callable[[Path], Trip], ...] = (
    of_trimesh, of_pymeshlab, of_polydata, of_grids, of_meshio, of_gmsh, of_medit, of_xarray,
    of_rasterio, of_su2, of_calculix,
)  # fmt: skip


def file_trips(folder: Path) -> Iterator[Trip]:
    """Every suffix that can be written: saved, loaded, compared."""
    made = result()
    before = digest(made.points, made.triangles, made.profile.errors, made.boundary.edges)
    for suffix, family in sorted(formats().items()):
        if family.write is None:
            continue
        path = folder / f"mesh{suffix}"
        try:
            equimesh_adapters.save(path, made)
            mesh = equimesh_adapters.load_mesh(path)
            fault = same(mesh.points, mesh.triangles, made, ROUNDED.get(suffix, 0.0))
        except equimesh.InputError as refusal:
            fault = str(refusal)
        after = digest(made.points, made.triangles, made.profile.errors, made.boundary.edges)
        yield Trip(suffix, "triangles", fault, after != before)
