"""PyVista in, PyVista out: arrays, names and the accessor; nothing is rendered."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest
import pyvista
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters.pyvista import from_result, profile, remesh, to_field


def quads(n=12, height=lambda x, y: x * y):
    """Quadrilaterals over the unit square."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.column_stack([i, i + 1, i + n + 2, i + n + 1])
    return pyvista.PolyData.from_regular_faces(np.column_stack([x, y, height(x, y)]), cells)


def rich():
    mesh = quads()
    x, y = mesh.points[:, :2].T
    mesh.point_data["slope"] = 2 * x - y + 0.25
    mesh.point_data["flow"] = np.column_stack([x + y, x - 3 * y, 0 * x]).astype(np.float32)
    mesh.point_data["label"] = (x > 0.5).astype(np.int32) * 7
    mesh.point_data["paint"] = np.rint(np.column_stack([240 * x, 240 * y, 0 * x])).astype(np.uint8)
    middle = mesh.cell_centers().points
    mesh.cell_data["zone"] = (middle[:, 0] > 0.5).astype(np.int16)
    mesh.cell_data["weight"] = np.floor(3 * middle[:, 1])
    mesh.field_data["survey"] = ["north ridge"]
    mesh.field_data["offsets"] = np.array([1.5, 2.5])
    mesh.set_active_scalars("slope")
    return mesh


def image(columns=21, rows=16, height=lambda x, y: x * y, **place):
    grid = pyvista.ImageData(dimensions=(columns, rows, 1), **place)
    x, y, _ = grid.points.T
    grid.point_data["dem"] = height(x, y)
    return grid


def ground(mesh):
    """The area in the plane."""
    flat = mesh.copy()
    flat.points[:, 2] = 0
    return flat.area


def fingerprint(dataset):
    """Of points, cells and all arrays by name."""
    code = hashlib.sha256(np.ascontiguousarray(dataset.points).tobytes())
    if isinstance(dataset, pyvista.PolyData):
        code.update(dataset.faces.tobytes())
    code.update(str(dataset.active_scalars_name).encode())
    for data in (dataset.point_data, dataset.cell_data, dataset.field_data):
        for name in data:
            code.update(name.encode() + np.asarray(data[name]).tobytes())
    return code.hexdigest()


def test_linear_arrays_come_back_exactly_with_all_names():
    mesh = rich()
    before = fingerprint(mesh)
    made = mesh.equimesh.remesh(0.01)
    assert fingerprint(mesh) == before
    assert isinstance(made, pyvista.PolyData)
    assert made.n_cells < 2 * mesh.n_cells
    assert set(made.point_data) == {*mesh.point_data, "value"}
    assert set(made.cell_data) == {*mesh.cell_data, "error"}
    assert made.active_scalars_name == "slope"
    x, y, z = np.array(made.points).T
    np.testing.assert_allclose(made["slope"], 2 * x - y + 0.25, atol=1e-6)
    np.testing.assert_allclose(made["flow"], np.column_stack([x + y, x - 3 * y, 0 * x]), atol=1e-6)
    assert made["flow"].dtype == np.float32
    assert made["label"].dtype == np.int32
    far = np.abs(x - 0.5) > 1 / 12
    np.testing.assert_array_equal(made["label"][far], 7 * (x[far] > 0.5))
    assert np.abs(made["paint"] - np.column_stack([240 * x, 240 * y, 0 * x])).max() <= 1.0
    assert made["paint"].dtype == np.uint8
    np.testing.assert_allclose(made.point_data["value"], z, atol=1e-12)
    middle = made.cell_centers().points
    np.testing.assert_array_equal(made.cell_data["zone"], middle[:, 0] > 0.5)
    np.testing.assert_array_equal(made.cell_data["weight"], np.floor(3 * middle[:, 1]))
    assert made.cell_data["error"].max() <= 0.01
    assert list(made.field_data["survey"]) == ["north ridge"]
    np.testing.assert_array_equal(made.field_data["offsets"], [1.5, 2.5])


def test_results_and_fields_of_polydata():
    result = equimesh.remesh("x*y", tol=0.02, domain=(0, 0, 1, 1))
    made = from_result(result)
    np.testing.assert_array_equal(made.points, result.points)
    np.testing.assert_array_equal(made.regular_faces, result.triangles)
    np.testing.assert_array_equal(made.cell_data["error"], result.profile.errors)
    np.testing.assert_array_equal(made.point_data["value"], result.points[:, 2])
    again = to_field(made)
    np.testing.assert_array_equal(again.points, result.points)
    assert profile(made, "x*y").max == pytest.approx(result.profile.max)
    assert made.equimesh.profile(quads(32)).bound <= 0.02 + 0.25 / 32**2


def test_normals_stay_normals_and_texture_coordinates_stay_so():
    mesh = quads().triangulate().compute_normals(cell_normals=False, point_normals=True)
    mesh.active_texture_coordinates = np.array(mesh.points[:, :2])
    made = remesh(mesh, 0.01)
    assert made.point_data.active_normals_name == "Normals"
    np.testing.assert_allclose(np.linalg.norm(made.point_data["Normals"], axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(made.active_texture_coordinates, made.points[:, :2], atol=1e-6)


def test_bodies_over_one_another_and_along_x():
    low, high = quads(), quads(6, lambda x, y: 3 - x * x)
    both = low.merge(high, merge_points=False)
    made = both.equimesh.remesh(0.02)
    assert made.equimesh.profile(both).bound <= 0.02 * (1 + 1e-9)
    turned = quads().rotate_y(90)
    made = turned.equimesh.remesh(0.02, up="x")
    np.testing.assert_allclose(made.point_data["value"], made.points[:, 0], atol=1e-6)
    assert made.equimesh.profile(turned, up="x").bound <= 0.02 * (1 + 1e-6)


@settings(max_examples=8)
@given(
    st.integers(2, 20), st.integers(2, 20), st.floats(-180, 180),
    st.floats(0.1, 10), st.floats(0.1, 10), st.integers(-3, 3),
)  # fmt: skip
def test_images_of_any_place_become_rasters_there(columns, rows, angle, dx, dy, shift):
    """Turned, stretched and cut out of a larger one: heights at all points, and in between."""
    turn = np.deg2rad(angle)
    matrix = [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    grid = pyvista.ImageData(
        dimensions=(columns, rows, 1), spacing=(dx, dy, 1), origin=(100, -50, 7)
    )
    grid.direction_matrix = matrix
    grid.extent = (shift, shift + columns - 1, 2 * shift, 2 * shift + rows - 1, 0, 0)
    x, y, z = grid.points.T
    grid["dem"] = 3 * x - 2 * y
    assert (z == 7).all()
    field = to_field(grid)
    assert isinstance(field, equimesh.Raster)
    centre = np.array(grid.center)[:2]
    inner = centre + 0.999 * (np.column_stack([x, y]) - centre)
    size = np.abs(grid["dem"]).max()
    found = field.value(*inner.T)
    np.testing.assert_allclose(found, 3 * inner[:, 0] - 2 * inner[:, 1], atol=1e-11 * size)
    made = grid.equimesh.remesh("1%")
    assert made.n_cells == 2
    x, y, z = np.array(made.points).T
    np.testing.assert_allclose(z, 3 * x - 2 * y, atol=1e-11 * size)


def test_images_keep_their_arrays_bilinear_and_their_cells():
    grid = image(spacing=(0.05, 0.1, 1), height=lambda x, y: x * x + y)
    x, y, _ = grid.points.T
    grid.point_data["twist"] = (x * y).astype(np.float32)
    grid.point_data["class"] = (x > 0.5).astype(np.int64)
    middle = grid.cell_centers().points
    grid.cell_data["zone"] = np.floor(10 * middle[:, 1])
    grid.field_data["crs"] = ["EPSG:2056"]
    grid.set_active_scalars("dem")
    before = fingerprint(grid)
    made = grid.equimesh.remesh(0.01)
    assert fingerprint(grid) == before
    x, y, z = np.array(made.points).T
    np.testing.assert_array_equal(made.point_data["dem"], z)
    np.testing.assert_allclose(made.point_data["twist"], x * y, atol=1e-6)
    assert made.point_data["class"].dtype == np.int64
    far = np.abs(x - 0.5) > 0.05
    np.testing.assert_array_equal(made.point_data["class"][far], x[far] > 0.5)
    centre = made.points[made.regular_faces].mean(axis=1)
    off = np.abs(10 * centre[:, 1] - np.rint(10 * centre[:, 1])) > 1e-6
    np.testing.assert_array_equal(made.cell_data["zone"][off], np.floor(10 * centre[off, 1]))
    assert set(made.cell_data) == {"zone", "error"}
    assert made.cell_data["error"].max() <= 0.01
    assert made.active_scalars_name == "dem"
    assert list(made.field_data["crs"]) == ["EPSG:2056"]
    assert made.equimesh.profile(grid).bound <= 0.01


def test_heights_are_chosen_by_name():
    grid = image()
    grid.point_data["rain"] = np.ones(grid.n_points)
    assert to_field(grid, scalars="rain").span(to_field(grid).outline()) == (1.0, 1.0)
    with pytest.raises(InputError, match=r"'snow'.*dem, rain"):
        grid.equimesh.remesh(0.1, scalars="snow")
    grid.point_data["wind"] = np.ones((grid.n_points, 3))
    with pytest.raises(InputError, match="several components"):
        grid.equimesh.remesh(0.1, scalars="wind")
    grid.set_active_scalars(None)
    with pytest.raises(InputError, match="choose scalars= one of dem, rain, wind"):
        grid.equimesh.remesh(0.1)
    bare = pyvista.ImageData(dimensions=(3, 3, 1))
    bare.cell_data["dem"] = np.arange(4.0)
    with pytest.raises(InputError, match="cell_data_to_point_data"):
        bare.equimesh.remesh(0.1)


def test_missing_and_hidden_samples_are_holes():
    grid = image(11, 11)
    grid["dem"][60] = np.nan
    made = grid.equimesh.remesh(0.1)
    assert 95 < ground(made) < 99  # of 100, without a hole around the sample
    hidden = image(11, 11)
    hidden.point_data["vtkGhostType"] = np.where(np.arange(121) == 60, 2, 0).astype(np.uint8)
    hidden.set_active_scalars("dem")
    same = hidden.equimesh.remesh(0.1)
    np.testing.assert_array_equal(same.points, made.points)


def structured(n=12):
    """A curved grid: a quarter of a ring."""
    r, angle = np.meshgrid(np.linspace(1, 2, n), np.linspace(0, np.pi / 2, 2 * n))
    x, y = r * np.cos(angle), r * np.sin(angle)
    return pyvista.StructuredGrid(x, y, 0.1 * x * y)


def test_structured_grids_are_surfaces_of_their_points_or_of_scalars():
    grid = structured()
    x, y, z = np.array(grid.points).T
    grid.point_data["double"] = 2 * z
    grid.cell_data["number"] = np.arange(grid.n_cells)
    before = fingerprint(grid)
    field = to_field(grid)
    assert isinstance(field, equimesh.Surface)
    np.testing.assert_allclose(field.value(x, y)[1:-1], z[1:-1], atol=1e-12)
    np.testing.assert_allclose(to_field(grid, scalars="double").points[:, 2], 2 * z)
    made = grid.equimesh.remesh(0.004, scalars="double")
    assert fingerprint(grid) == before
    np.testing.assert_allclose(made.point_data["double"], made.points[:, 2])
    assert made.equimesh.profile(grid, scalars="double").bound <= 0.004 * (1 + 1e-9)
    centre = made.points[made.regular_faces].mean(axis=1) * [1, 1, 0]
    found = made.cell_data["number"]
    flat = grid.copy()
    flat.points[:, 2] = 0
    for place, cell in zip(centre, found, strict=True):  # on the side of two cells either will do
        corners = flat.get_cell(int(cell)).points[:, :2]
        assert shapely.Polygon(corners).distance(shapely.Point(place[:2])) < 1e-9
    grid.hide_cells([5, 6], inplace=True)
    assert ground(grid.equimesh.remesh(0.05)) < ground(made)


def test_rectilinear_grids_are_rasters_where_equally_spaced():
    even = pyvista.RectilinearGrid(np.arange(5) * 2.0, np.arange(4) * 3.0 + 1)
    even["dem"] = even.points[:, 0] * even.points[:, 1]
    assert isinstance(to_field(even), equimesh.Raster)
    uneven = pyvista.RectilinearGrid(np.array([0, 1, 4.0]), np.arange(4.0))
    uneven["dem"] = uneven.points[:, 0]
    field = to_field(uneven)
    assert isinstance(field, equimesh.Surface)
    assert field.value(np.array([2.5]), np.array([1.5])) == pytest.approx(2.5)
    made = uneven.equimesh.remesh(0.01)
    assert made.n_cells == 2
    np.testing.assert_allclose(made["dem"], made.points[:, 0])


def test_what_is_no_height_field_is_refused_in_one_sentence():
    for wrong, words in [
        (pyvista.ImageData(dimensions=(3, 3, 3)), "one layer"),
        (pyvista.Box().cast_to_unstructured_grid(), "extract_surface"),
    ]:
        with pytest.raises(InputError, match=words):
            remesh(wrong, 0.1)
    with pytest.raises(InputError, match=r"%.*up="):
        pyvista.Sphere().equimesh.remesh(0.1)
    with pytest.raises(InputError, match="leave out scalars="):
        remesh(quads(2), 0.1, scalars="z")
    with pytest.raises(InputError, match="leave out up="):
        remesh(image(), 0.1, up="z")


def test_files_of_pyvista(tmp_path):
    grid = image(spacing=(0.05, 0.1, 1))
    grid.save(tmp_path / "a.vti")
    structured().save(tmp_path / "a.vts")
    field = equimesh_adapters.load(tmp_path / "a.vti")
    assert isinstance(field, equimesh.Raster)
    assert isinstance(equimesh_adapters.load(tmp_path / "a.vts"), equimesh.Surface)
    result = equimesh.remesh(field, tol=0.01)
    equimesh_adapters.save(tmp_path / "a.vtp", result)
    made = pyvista.read(tmp_path / "a.vtp")
    np.testing.assert_array_equal(made.points, result.points)
    np.testing.assert_array_equal(made.cell_data["error"], result.profile.errors)
    points, triangles = equimesh_adapters.load_mesh(tmp_path / "a.vtp")
    np.testing.assert_array_equal(points, result.points)
    np.testing.assert_array_equal(triangles, result.triangles)


def run(code):
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return made.stdout


def test_the_accessor_needs_no_import():
    code = (
        "import sys, pyvista\n"
        "mesh = pyvista.Plane(i_resolution=3, j_resolution=3)\n"
        "assert 'equimesh' not in sys.modules\n"
        "print(mesh.equimesh.remesh(0.1).n_cells)\n"
    )
    assert run(code) == "2\n"


def test_the_core_imports_without_pyvista_and_the_adapter_names_the_extra(tmp_path):
    pyvista.Plane().save(tmp_path / "a.vtp")
    code = (
        "import sys; sys.modules['pyvista'] = None\n"
        "import equimesh, equimesh_adapters, equimesh_adapters.pyvista as adapter\n"
        "result = equimesh.remesh('x*y', tol=0.1, domain=(0, 0, 1, 1))\n"
        "for action in (lambda: adapter.from_result(result), lambda: adapter.remesh(object(), 1),\n"
        f"               lambda: equimesh_adapters.load({str(tmp_path / 'a.vtp')!r})):\n"
        "    try: action()\n"
        "    except equimesh.InputError as error: print(error)\n"
    )
    sentence = "PyVista is not installed: pip install 'equimesh[pyvista]'.\n"
    assert run(code) == 3 * sentence
