"""Rasters in the world: affine grids, reference systems, bands, holes, and xarray's arrays."""

import subprocess
import sys

import numpy as np
import pytest
import rasterio
import rioxarray
import shapely
import xarray
from rasterio.crs import CRS
from rasterio.transform import Affine

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters.raster import from_result, profile, remesh, to_field

UTM = CRS.from_epsg(32617)
COS, SIN = np.cos(np.pi / 6), np.sin(np.pi / 6)
TURNED = Affine(30.0 * COS, 10.0 * SIN, 5e5, 30.0 * SIN, -10.0 * COS, 4.1e6)


def hills(rows=24, columns=31):
    """A smooth surface with digits in all places."""
    row, column = np.indices((rows, columns))
    return 100 / 3 * np.sin(0.21 * column) * np.cos(0.17 * row) + column / 7


def write_tiff(path, bands, transform=TURNED, **options):
    options = {"crs": UTM, "dtype": str(bands.dtype)} | options
    count, height, width = bands.shape
    with rasterio.open(
        path, "w", driver="GTiff", height=height, width=width, count=count, transform=transform,
        **options,
    ) as file:  # fmt: skip
        file.write(bands)
    return path


def dataarray(heights, x=None, y=None, **options):
    rows, columns = heights.shape
    x = 5e5 + 30.0 * np.arange(columns) if x is None else x
    y = 4.1e6 - 10.0 * np.arange(rows) if y is None else y
    return xarray.DataArray(heights, coords={"y": y, "x": x}, dims=("y", "x"), **options)


def at_samples(field, transform, heights):
    """The field at the centres of the cells, as rasterio places them."""
    row, column = (index.ravel() for index in np.indices(heights.shape))
    x, y = rasterio.transform.xy(transform, row, column)
    return field.value(np.asarray(x), np.asarray(y)).reshape(heights.shape)


# Files


@pytest.mark.parametrize(
    "transform",
    [
        TURNED,
        Affine(10.0, 0.0, 100.0, 0.0, -2.5, 240.0),
        Affine(0.0, 3.0, 7.0, 2.0, 0.0, -5.0),
        Affine(2.0, 1.0, 0.0, 0.0, 3.0, 0.0),
    ],
    ids=["turned", "anisotropic", "transposed", "sheared"],
)
def test_samples_lie_where_rasterio_puts_them(transform, tmp_path):
    heights = hills()
    path = write_tiff(tmp_path / "a.tif", heights[None], transform)
    found = at_samples(equimesh_adapters.load(path), transform, heights)
    seen = np.isfinite(found)  # a sample on the rim may round to outside
    assert seen[1:-1, 1:-1].all()
    np.testing.assert_allclose(found[seen], heights[seen], atol=1e-6)


def test_the_mesh_of_a_turned_raster_covers_its_samples_within_the_tolerance(tmp_path):
    heights = hills()
    field = equimesh_adapters.load(write_tiff(tmp_path / "a.tif", heights[None]))
    result = equimesh.remesh(field, tol="2%")
    assert result.status.ok
    area = abs(TURNED.determinant) * (heights.shape[0] - 1) * (heights.shape[1] - 1)
    a, b, c = result.points[result.triangles, :2].transpose(1, 0, 2)
    found = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert found.min() > 0
    assert found.sum() == pytest.approx(area, rel=1e-9)


def test_the_reference_system_travels_with_the_result_into_a_prj_file(tmp_path):
    field = equimesh_adapters.load(write_tiff(tmp_path / "a.tif", hills()[None]))
    result = equimesh.remesh(field, tol="5%")
    assert CRS.from_wkt(result.metadata["crs"]) == UTM
    equimesh_adapters.save(tmp_path / "mesh.ply", result)
    text = (tmp_path / "mesh.prj").read_text()
    assert text == UTM.to_wkt(version="WKT1_ESRI")
    assert text.startswith('PROJCS["WGS_1984_UTM_Zone_17N"')
    assert CRS.from_wkt(text, morph_from_esri_dialect=True).to_epsg() == 32617


def test_without_a_reference_system_there_is_no_prj_file(tmp_path):
    field = equimesh_adapters.load(write_tiff(tmp_path / "a.tif", hills()[None], crs=None))
    equimesh_adapters.save(tmp_path / "mesh.ply", equimesh.remesh(field, tol="5%"))
    assert {path.name for path in tmp_path.iterdir()} == {"a.tif", "mesh.ply"}


def test_a_mesh_and_its_prj_appear_together_or_not_at_all(tmp_path):
    field = equimesh_adapters.load(write_tiff(tmp_path / "a.tif", hills()[None]))
    result = equimesh.remesh(field, tol="5%")
    (tmp_path / "mesh.prj").mkdir()
    with pytest.raises(InputError, match=r"mesh\.prj cannot be written"):
        equimesh_adapters.save(tmp_path / "mesh.ply", result)
    assert {path.name for path in tmp_path.iterdir()} == {"a.tif", "mesh.prj"}


def test_one_of_several_bands_is_chosen(tmp_path):
    bands = np.stack([hills(), 2.0 * hills(), 3.0 * hills()])
    path = write_tiff(tmp_path / "a.tif", bands)
    with pytest.raises(InputError, match=r"has 3 bands: choose one with band=1 to 3\.$"):
        equimesh_adapters.load(path)
    for band in (1, 2, 3):
        found = equimesh_adapters.load(path, band=band).heights
        np.testing.assert_array_equal(found, bands[band - 1])
    with pytest.raises(InputError, match=r"has no band 4: choose one from 1 to 3\.$"):
        equimesh_adapters.load(path, band=4)


def test_only_rasters_have_bands(tmp_path):
    equimesh_adapters.save(tmp_path / "a.ply", equimesh.remesh("x*y", 0.1, (0, 0, 1, 1)))
    with pytest.raises(InputError, match="has no bands"):
        equimesh_adapters.load(tmp_path / "a.ply", band=1)
    np.save(tmp_path / "a.npy", hills())
    equimesh_adapters.load(tmp_path / "a.npy", band=1)
    with pytest.raises(InputError, match="has no band 2"):
        equimesh_adapters.load(tmp_path / "a.npy", band=2)


def test_the_command_line_takes_a_band_and_writes_the_prj(tmp_path):
    path = write_tiff(tmp_path / "a.tif", np.stack([hills(), np.zeros_like(hills())]))
    command = [sys.executable, "-m", "equimesh", "remesh", path, tmp_path / "m.vtu", "--tol", "5%"]
    refused = subprocess.run(command, capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "choose one with band=1 to 2" in " ".join(refused.stderr.split())
    subprocess.run([*command, "--band", "2"], capture_output=True, check=True)
    assert len(equimesh_adapters.load_mesh(tmp_path / "m.vtu").triangles) == 2
    assert (tmp_path / "m.prj").read_text() == UTM.to_wkt(version="WKT1_ESRI")


@pytest.mark.parametrize("dtype", ["int16", "float32", "float64"])
def test_missing_samples_are_holes(dtype, tmp_path):
    heights = hills().astype(dtype)
    heights[8:12, 10:15] = -9999
    path = write_tiff(tmp_path / "a.tif", heights[None], nodata=-9999)
    field = equimesh_adapters.load(path)
    assert np.isnan(field.heights[9:11, 11:14]).all()
    outline = field.outline(0.0)
    assert len(outline.interiors) == 1
    hole = shapely.Polygon(outline.interiors[0])
    assert hole.area == pytest.approx(abs(TURNED.determinant) * 5 * 6)
    result = equimesh.remesh(field, tol="10%")
    assert any(name.startswith("hole") for name in result.boundary.names)


def test_scale_and_offset_of_a_band_are_applied(tmp_path):
    stored = np.round(hills()).astype(np.int16)
    stored[0, 0] = -1
    path = write_tiff(tmp_path / "a.tif", stored[None], nodata=-1)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = [0.25], [1000.0]
    found = equimesh_adapters.load(path).heights
    seen = np.isfinite(found)
    np.testing.assert_array_equal(found[seen], (0.25 * stored + 1000.0)[seen])
    assert not seen[0, 0]


def test_ascii_grids_keep_every_digit_and_their_prj(tmp_path):
    heights = hills(5, 6)
    rows = "\n".join(" ".join(map(repr, row)) for row in heights.tolist())
    header = "ncols 6\nnrows 5\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\n"
    (tmp_path / "a.asc").write_text(header + rows)
    (tmp_path / "a.prj").write_text(UTM.to_wkt(version="WKT1_ESRI"))
    field = equimesh_adapters.load(tmp_path / "a.asc")
    np.testing.assert_array_equal(field.heights, heights)
    with rasterio.open(tmp_path / "a.asc") as file:
        theirs = to_field(file)
        assert file.crs == CRS.from_wkt(field.metadata["crs"], morph_from_esri_dialect=True)
    np.testing.assert_allclose(theirs.heights, heights, rtol=1e-6)
    np.testing.assert_allclose(theirs.transform, field.transform)
    equimesh_adapters.save(tmp_path / "mesh.off", equimesh.remesh(field, tol="5%"))
    assert (tmp_path / "mesh.prj").read_text() == (tmp_path / "a.prj").read_text()


# Objects


def test_a_dataset_goes_to_a_field_and_back_within_the_tolerance(tmp_path):
    heights = hills()
    heights[4:6, 5:8] = np.nan
    with rasterio.open(write_tiff(tmp_path / "a.tif", heights[None], nodata=np.nan)) as file:
        field = to_field(file)
        result = equimesh.remesh(field, tol=1.0)
        back = from_result(result, file)
        again = remesh(file, tol=1.0)
        measured = profile(result, file)
    assert isinstance(back, np.ma.MaskedArray)
    np.testing.assert_array_equal(back.mask, np.isnan(field.heights))
    assert np.abs(back - field.heights).max() <= 1.0
    np.testing.assert_array_equal(again.filled(np.nan), back.filled(np.nan))
    np.testing.assert_array_equal(measured.errors, result.profile.errors)


def test_a_dataarray_goes_to_a_field_and_back_within_the_tolerance():
    heights = hills()
    heights[10:13, 20:22] = np.nan
    array = dataarray(heights, name="elevation", attrs={"units": "m"})
    before = array.copy(deep=True)
    made = remesh(array, tol=0.5)
    assert isinstance(made, xarray.DataArray)
    assert (made.name, made.dims, made.attrs) == ("elevation", ("y", "x"), {"units": "m"})
    xarray.testing.assert_equal(made.coords.to_dataset(), array.coords.to_dataset())
    kept = np.isfinite(to_field(array).heights)
    np.testing.assert_array_equal(np.isfinite(made.values), kept)
    assert np.nanmax(np.abs(made.values - heights)) <= 0.5
    xarray.testing.assert_identical(array, before)


def test_the_adapter_is_found_by_the_type_of_an_object(tmp_path):
    heights = hills()
    array = dataarray(heights)
    np.testing.assert_array_equal(equimesh_adapters.load(array).heights, heights)
    made = equimesh_adapters.remesh(array, tol=1.0)
    xarray.testing.assert_identical(made, remesh(array, tol=1.0))
    with rasterio.open(write_tiff(tmp_path / "a.tif", np.stack([heights, -heights]))) as file:
        np.testing.assert_array_equal(equimesh_adapters.load(file, band=2).heights, -heights)
        assert isinstance(equimesh_adapters.remesh(file, 1.0, band=1), np.ma.MaskedArray)


def test_coordinates_are_the_affine_grid():
    heights = hills()
    field = to_field(dataarray(heights))
    assert field.transform == pytest.approx((30.0, 0.0, 5e5, 0.0, -10.0, 4.1e6))
    assert field.value(np.array([5e5 + 60.0]), np.array([4.1e6 - 30.0])) == heights[3, 2]
    bare = to_field(xarray.DataArray(heights, dims=("y", "x")))
    assert bare.transform == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)


@pytest.mark.parametrize("names", [("y", "x"), ("lat", "lon"), ("northing", "easting")])
def test_dimensions_come_in_any_order(names):
    heights = hills()
    array = dataarray(heights).rename(dict(zip("yx", names, strict=True)))
    turned = to_field(array.transpose())
    np.testing.assert_array_equal(turned.heights, heights)
    assert turned.transform == to_field(array).transform
    assert remesh(array.transpose(), tol=1.0).dims == names[::-1]


def test_the_axis_is_known_by_its_attributes_or_else_by_its_place():
    heights = hills()
    array = xarray.DataArray(heights, dims=("a", "b"))
    np.testing.assert_array_equal(to_field(array).heights, heights)
    named = array.assign_coords(a=("a", 2.0 * np.arange(24), {"axis": "X"}))
    np.testing.assert_array_equal(to_field(named).heights, heights.T)
    assert to_field(named).transform == (2.0, 0.0, 0.0, 0.0, 1.0, 0.0)


def test_coordinates_in_single_precision_or_rounded_are_equally_spaced():
    heights = hills()
    lon = (-80.0 + np.arange(31) / 120.0).astype(np.float32)
    lat = np.round(37.0 + np.arange(24) / 1200.0, 8)
    field = to_field(dataarray(heights, x=lon, y=lat))
    assert field.transform[0] == pytest.approx(1 / 120, rel=1e-4)
    assert field.transform[4] == pytest.approx(1 / 1200, rel=1e-6)


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda a: a.assign_coords(x=a.x**2), "coordinate x .* is not equally spaced"),
        (lambda a: a.assign_coords(y=0 * a.y), "coordinate y .* is not equally spaced"),
        (lambda a: a.assign_coords(x=a.x.astype("M8[s]")), "coordinate x .* is no number"),
        (lambda a: a.to_dataset(name="z"), "A Dataset is no raster"),
        (lambda a: a.isel(y=0), "1 dimensions"),
        (lambda a: a.expand_dims(t=2, band=3), "the dimensions t, band beside x and y"),
        (lambda a: a.expand_dims(band=3), "has 3 bands: choose one with band=1 to 3"),
        (lambda a: a.values, "A ndarray is no raster"),
        (
            lambda a: a.drop_vars(["x", "y"]).assign_coords(lon=(("y", "x"), a.values)),
            "lon of the DataArray are curved",
        ),
    ],
)  # fmt: skip
def test_what_is_no_affine_grid_is_refused_in_one_sentence(change, sentence):
    with pytest.raises(InputError, match=sentence) as refusal:
        to_field(change(dataarray(hills())))
    assert str(refusal.value).endswith(".")


def test_layers_of_a_dataarray_are_bands():
    array = dataarray(hills())
    stack = xarray.concat([array, 2 * array], dim="band")
    np.testing.assert_array_equal(to_field(stack, band=2).heights, 2 * hills())
    np.testing.assert_array_equal(to_field(stack[:1]).heights, hills())
    assert remesh(stack, tol=1.0, band=2).dims == ("y", "x")


def test_packed_values_are_unpacked_and_missing_ones_are_holes():
    heights = np.round(hills()).astype(np.int32)
    heights[5, 5] = -32768
    packed = {"_FillValue": np.int32(-32768), "scale_factor": 0.5, "add_offset": 10.0}
    array = dataarray(heights, attrs=packed | {"units": "m"})
    field = to_field(array)
    assert np.isnan(field.value(np.array([5e5 + 150.0]), np.array([4.1e6 - 50.0]))).all()
    assert field.heights[7, 7] == 0.5 * heights[7, 7] + 10.0
    made = remesh(array, tol=1.0)
    assert made.attrs == {"units": "m"}
    assert np.isnan(made[5, 5])
    assert np.nanmax(np.abs(made - (0.5 * heights + 10.0))) <= 1.0


def test_reference_systems_of_dataarrays_are_found():
    by_rio = dataarray(hills()).rio.write_crs(UTM)
    by_convention = by_rio.drop_vars("spatial_ref").assign_coords(
        crs=((), 0, {"crs_wkt": UTM.to_wkt()})
    )
    by_convention.attrs["grid_mapping"] = "crs"
    by_attribute = dataarray(hills(), attrs={"crs": "EPSG:32617"})
    for array in (by_rio, by_convention, by_attribute):
        metadata = to_field(array).metadata
        assert CRS.from_wkt(metadata["crs"]) == UTM
        assert metadata["prj"] == UTM.to_wkt(version="WKT1_ESRI")
    assert to_field(dataarray(hills())).metadata == {}


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")  # rioxarray's own
def test_what_rioxarray_reads_is_what_the_file_holds(tmp_path):
    """A turned raster, whose DataArray has a transform in place of coordinates."""
    heights = hills()
    heights[3:5, 4:9] = -1.0
    path = write_tiff(tmp_path / "a.tif", heights[None], nodata=-1.0)
    ours = equimesh_adapters.load(path)
    for masked in (False, True):
        with rioxarray.open_rasterio(path, masked=masked) as array:
            theirs = to_field(array)
        np.testing.assert_array_equal(theirs.heights, ours.heights)
        np.testing.assert_allclose(theirs.transform, ours.transform, rtol=1e-14)
        assert CRS.from_wkt(theirs.metadata["crs"]) == UTM


def test_without_rasterio_the_text_of_a_reference_system_still_travels(monkeypatch):
    array = dataarray(hills(), attrs={"crs": "EPSG:32617"})
    monkeypatch.setitem(sys.modules, "rasterio.crs", None)
    metadata = to_field(array).metadata
    assert metadata.keys() == {"crs"}
    assert CRS.from_user_input(metadata["crs"]) == UTM
