"""Files in and out: what is written comes back, and what is broken is refused in one sentence."""

import contextlib
import io
import json
import pickle
import sys
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest
import rasterio
import rasterio.transform
import trimesh
from rasterio.transform import Affine

import equimesh
import equimesh_adapters
from equimesh import formats
from equimesh.errors import InputError
from equimesh.fields.raster import Raster
from equimesh.fields.surface import Surface
from equimesh.outputs import staged
from equimesh_adapters import meshio as meshio_adapter
from equimesh_adapters import trimesh as trimesh_adapter

DOUBLE = (".ply", ".obj", ".off", ".vtu", ".vtk", ".msh", ".xdmf", ".npz")
SINGLE = (".stl", ".glb")


@pytest.fixture(scope="module")
def result():
    """Coordinates with all digits in use: a wave far from the origin."""
    return equimesh.remesh(
        "sin(x*y/1e6)/3", tol=0.02, domain=(1000 + 1 / 3, 2000 + 1 / 7, 1005, 2004)
    )


def corners(points, triangles):
    """(m, 9) corners of every triangle in a canonical order, whatever vertices are called."""
    shape = np.asarray(points)[np.asarray(triangles)]
    first = np.lexsort(shape.transpose(2, 0, 1)[::-1], axis=-1)[:, 0]
    turned = np.take_along_axis(shape, ((first[:, None] + np.arange(3)) % 3)[..., None], axis=1)
    flat = turned.reshape(-1, 9)
    return flat[np.lexsort(flat.T[::-1])]


@pytest.mark.parametrize("suffix", DOUBLE)
def test_double_precision_formats_give_every_bit_back(suffix, result, tmp_path, capfd):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    points, triangles = equimesh_adapters.load_mesh(path)
    np.testing.assert_array_equal(
        corners(points, triangles), corners(result.points, result.triangles)
    )
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", SINGLE)
def test_single_precision_formats_round_and_keep_the_connections(suffix, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    points, triangles = equimesh_adapters.load_mesh(path)
    assert points.shape == result.points.shape  # the soup was sewn
    np.testing.assert_allclose(
        corners(points, triangles), corners(result.points, result.triangles), rtol=1e-7
    )


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".off", ".glb"])
def test_trimesh_reopens_what_was_written(suffix, result, tmp_path):
    equimesh_adapters.save(tmp_path / f"mesh{suffix}", result)
    mesh = trimesh.load_mesh(tmp_path / f"mesh{suffix}")
    assert mesh.faces.shape == result.triangles.shape
    np.testing.assert_allclose(mesh.area, trimesh_adapter.from_result(result).area, rtol=1e-3)


@pytest.mark.parametrize(
    "suffix", [".ply", ".stl", ".obj", ".off", ".vtu", ".vtk", ".msh", ".xdmf"]
)
def test_meshio_reopens_what_was_written(suffix, result, tmp_path):
    equimesh_adapters.save(tmp_path / f"mesh{suffix}", result)
    mesh = meshio.read(tmp_path / f"mesh{suffix}")
    assert len(mesh.get_cells_type("triangle")) == len(result.triangles)


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf"])
def test_the_error_of_every_triangle_goes_along(suffix, result, tmp_path):
    equimesh_adapters.save(tmp_path / f"mesh{suffix}", result)
    mesh = meshio.read(tmp_path / f"mesh{suffix}")
    np.testing.assert_array_equal(mesh.cell_data["error"][0], result.profile.errors)
    np.testing.assert_array_equal(mesh.point_data["value"], result.points[:, 2])


def test_gmsh_gets_the_boundary_curves_as_physical_groups(result, tmp_path):
    equimesh_adapters.save(tmp_path / "mesh.msh", result)
    mesh = meshio.read(tmp_path / "mesh.msh")
    for i, name in enumerate(result.boundary.names):
        tag, dimension = mesh.field_data[name]
        assert dimension == 1
        tags = mesh.get_cell_data("gmsh:physical", "line")
        np.testing.assert_array_equal(
            mesh.get_cells_type("line")[tags == tag],
            result.boundary.edges[result.boundary.tags == i],
        )


@pytest.mark.parametrize("suffix", DOUBLE + SINGLE)
def test_the_same_result_gives_the_same_bytes(suffix, result, tmp_path):
    files = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for file in files:
        equimesh_adapters.save(file, result)
    assert files[0].read_bytes() == files[1].read_bytes()


def test_saving_changes_nothing_in_the_result(result, tmp_path):
    before = pickle.dumps((result.points, result.triangles, result.profile.errors))
    for suffix in DOUBLE + SINGLE:
        equimesh_adapters.save(tmp_path / f"mesh{suffix}", result)
    assert pickle.dumps((result.points, result.triangles, result.profile.errors)) == before


# Meshes from elsewhere


def square(n=6):
    """(n + 1)^2 points on z = x y over the unit square and n^2 quadrilaterals."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    return np.column_stack([x, y, x * y]), np.column_stack([i, i + 1, i + n + 2, i + n + 1])


def area(points, triangles):
    a, b, c = (points[triangles[:, k], :2] for k in range(3))
    return 0.5 * np.sum((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf", ".ply", ".obj", ".off"])
def test_quadrilaterals_become_triangles_of_the_same_area(suffix, tmp_path):
    points, quads = square()
    path = tmp_path / f"mesh{suffix}"
    if suffix in (".ply", ".off"):
        header = {
            ".off": f"OFF\n{len(points)} {len(quads)} 0",
            ".ply": "ply\nformat ascii 1.0\n"
            f"element vertex {len(points)}\nproperty double x\nproperty double y\n"
            f"property double z\nelement face {len(quads)}\n"
            "property list uchar int vertex_indices\nend_header",
        }[suffix]
        rows = [" ".join(map(repr, p)) for p in points.tolist()]
        rows += ["4 " + " ".join(map(str, q)) for q in quads.tolist()]
        path.write_text("\n".join([header, *rows, ""]))
    else:
        options = {"data_format": "XML"} if suffix == ".xdmf" else {}
        meshio.write(path, meshio.Mesh(points, [("quad", quads)]), **options)
    read = equimesh_adapters.load_mesh(path)
    assert len(read.triangles) == 2 * len(quads)
    assert area(*read) == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("kind", sorted(meshio_adapter.SPLITS))
def test_every_kind_of_cell_is_cut_into_triangles_that_cover_it_once(kind):
    corner = np.array(
        [[0, 0], [1, 0], [0, 1]] if "tri" in kind else [[0, 0], [1, 0], [1, 1], [0, 1.0]]
    )
    middles = 0.5 * (corner + np.roll(corner, -1, axis=0))
    nodes = np.vstack([corner, middles, [[0.5, 0.5]]])
    count = {"triangle": 3, "quad": 4, "triangle6": 6, "quad8": 8, "quad9": 9}[kind]
    triangles = np.array(meshio_adapter.SPLITS[kind])
    assert set(triangles.ravel()) == set(range(count))
    signed = [area(nodes, triangle[None]) for triangle in triangles]
    assert min(signed) > 0
    assert sum(signed) == pytest.approx(0.5 if "tri" in kind else 1.0)


def test_polygons_become_fans():
    angle = np.arange(5) * 2 * np.pi / 5
    points = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    mesh = meshio.Mesh(points, [("polygon", np.arange(5)[None])])
    surface = meshio_adapter._triangles(mesh)
    assert area(*surface) == pytest.approx(2.5 * np.sin(2 * np.pi / 5))


def test_a_soup_is_sewn_without_moving_a_vertex(tmp_path):
    points, quads = square()
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    path = tmp_path / "soup.stl"
    trimesh.Trimesh(points, triangles, process=False).export(path)
    read = equimesh_adapters.load_mesh(path)
    assert len(read.points) == len(points)
    assert set(map(tuple, read.points)) == set(map(tuple, points.astype(np.float32).astype(float)))


def test_ply_vertices_are_not_merged(tmp_path):
    mesh = trimesh.Trimesh(np.eye(3)[[0, 1, 2, 0, 1, 2]], [[0, 1, 2], [3, 4, 5]], process=False)
    mesh.export(tmp_path / "twice.ply")
    assert len(equimesh_adapters.load_mesh(tmp_path / "twice.ply").points) == 6


def test_a_scene_of_several_parts_is_one_mesh(tmp_path):
    points, quads = square()
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    scene = trimesh.Scene()
    for shift in (0.0, 2.0):
        part = trimesh.Trimesh(points, triangles, process=False)
        scene.add_geometry(
            part, transform=trimesh.transformations.translation_matrix([shift, 0, 0])
        )
    scene.export(tmp_path / "scene.glb")
    read = equimesh_adapters.load_mesh(tmp_path / "scene.glb")
    assert area(*read) == pytest.approx(2.0)
    assert read.points[:, 0].max() == 3.0


def test_xdmf_with_a_companion_is_read_and_its_extra_is_named(tmp_path, monkeypatch):
    points, quads = square()
    meshio.write(tmp_path / "a.xdmf", meshio.Mesh(points, [("quad", quads)]))
    assert (tmp_path / "a.h5").exists()
    assert area(*equimesh_adapters.load_mesh(tmp_path / "a.xdmf")) == pytest.approx(1.0)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InputError, match=r"equimesh\[hdf\]"):
        equimesh_adapters.load_mesh(tmp_path / "a.xdmf")


def test_meshes_become_surfaces(result, tmp_path):
    equimesh_adapters.save(tmp_path / "mesh.ply", result)
    field = equimesh_adapters.load(tmp_path / "mesh.ply")
    assert isinstance(field, Surface)
    x, y, z = result.points.T
    np.testing.assert_allclose(field.value(x, y), z, atol=1e-12)


def test_objects_of_trimesh_and_meshio_go_in_and_out():
    points, quads = square(20)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    made = trimesh_adapter.remesh(trimesh.Trimesh(points, triangles, process=False), tol=0.05)
    assert isinstance(made, trimesh.Trimesh)
    assert 2 <= len(made.faces) < len(triangles)
    made = meshio_adapter.remesh(meshio.Mesh(points, [("quad", quads)]), tol=0.05)
    assert 2 <= len(made.get_cells_type("triangle")) < len(triangles)
    assert made.cell_data["error"][0].max() <= 0.05


# Rasters


HEIGHTS = np.add.outer(np.arange(4.0) ** 2, 0.5 * np.arange(5))  # [row, column]


def test_arrays_have_columns_as_x_and_rows_as_y(tmp_path):
    np.save(tmp_path / "a.npy", HEIGHTS)
    np.savez(tmp_path / "a.npz", elevation=HEIGHTS, cell=0.5, name="somewhere", edges=np.arange(9))
    for name in ("a.npy", "a.npz"):
        field = equimesh_adapters.load(tmp_path / name)
        assert isinstance(field, Raster)
        assert field.value(np.array([3.0]), np.array([2.0])) == [4 + 1.5]


def ascii_grid(first_lines):
    rows = "\n".join(" ".join(map(str, row)) for row in HEIGHTS.tolist())
    return f"ncols 5\nnrows 4\n{first_lines}\n{rows}\n"


@pytest.mark.parametrize(
    "place",
    [
        "xllcorner 100\nyllcorner 200\ncellsize 10",
        "XLLCENTER 105\nYLLCENTER 205\nCELLSIZE 10\nNODATA_value -1",
        "xllcorner 100\nyllcorner 200\ndx 10\ndy 10",
    ],
)
def test_ascii_grids_start_in_the_north_and_hold_cell_centres(place, tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(ascii_grid(place))
    field = equimesh_adapters.load(path)
    assert field.value(np.array([105.0]), np.array([205.0])) == HEIGHTS[3, 0]
    assert field.value(np.array([145.0]), np.array([235.0])) == HEIGHTS[0, 4]


def test_rasterio_agrees_on_ascii_grids(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(ascii_grid("xllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value 0"))
    field = equimesh_adapters.load(path)
    with rasterio.open(path) as file:
        expected, transform = file.read(1, masked=True).filled(np.nan), file.transform
    row, column = np.indices(expected.shape)
    x, y = rasterio.transform.xy(transform, row.ravel(), column.ravel())
    # The sample without data takes the cell beside it along: only valid cells have heights.
    found = field.value(np.asarray(x), np.asarray(y))
    seen = np.isfinite(found)
    np.testing.assert_allclose(found[seen], expected.ravel()[seen])
    assert not seen[np.isnan(expected.ravel())].any()


def write_tiff(path, heights, **options):
    with rasterio.open(
        path, "w", driver="GTiff", height=4, width=5, count=len(heights), dtype="float32",
        transform=Affine(10.0, 0.0, 100.0, 0.0, -10.0, 240.0), **options,
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32))


def test_geotiff_samples_lie_at_cell_centres(tmp_path):
    write_tiff(tmp_path / "a.tif", HEIGHTS[None])
    field = equimesh_adapters.load(tmp_path / "a.tif")
    assert field.value(np.array([105.0]), np.array([205.0])) == HEIGHTS[3, 0]
    assert field.value(np.array([145.0]), np.array([235.0])) == HEIGHTS[0, 4]


def test_without_rasterio_the_extra_is_named(tmp_path, monkeypatch):
    write_tiff(tmp_path / "a.tif", HEIGHTS[None])
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(InputError, match=r"equimesh\[raster\]"):
        equimesh_adapters.load(tmp_path / "a.tif")


def test_geotiff_nodata_is_left_out(tmp_path):
    heights = HEIGHTS.copy()
    heights[0, 0] = -7
    write_tiff(tmp_path / "a.tif", heights[None], nodata=-7)
    field = equimesh_adapters.load(tmp_path / "a.tif")
    assert np.isnan(field.value(np.array([106.0]), np.array([234.0]))).all()
    assert np.isfinite(field.value(np.array([126.0]), np.array([214.0]))).all()


# Files that are broken, or worse


class Bomb:
    """Unpickling this leaves a file behind."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (self.path, "w")


def text(content):
    return lambda path: path.write_text(content)


def archive(**arrays):
    return lambda path: np.savez(path, **arrays)


def pickled(path):
    bomb = np.array([[Bomb(str(path.parent / "boom"))]], dtype=object)
    saver = np.save if path.suffix == ".npy" else np.savez
    saver(path, bomb, **({"allow_pickle": True} if path.suffix == ".npy" else {}))


def bare_pickle(path):
    path.write_bytes(pickle.dumps(Bomb(str(path.parent / "boom"))))


def big_header(path):
    path.write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999999\n"
        "property double x\nproperty double y\nproperty double z\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )


def big_array(path):
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**7, 10**7)}
    np.lib.format.write_array_header_1_0(header, shape)
    path.write_bytes(header.getvalue())


def only_lines(path):
    meshio.write(path, meshio.Mesh(np.eye(3), [("line", np.array([[0, 1], [1, 2]]))]))


def three_bands(path):
    write_tiff(path, np.stack([HEIGHTS] * 3))


def points_only(path):
    trimesh.PointCloud(np.eye(3)).export(path)


BROKEN = {
    "empty.ply": text(""),
    "empty.npy": text(""),
    "nonsense.ply": text("nonsense\n" * 50),
    "nonsense.stl": text("nonsense\n" * 50),
    "nonsense.obj": text("nonsense\n" * 50),
    "nonsense.off": text("nonsense\n" * 50),
    "nonsense.glb": text("nonsense\n" * 50),
    "nonsense.vtu": text("nonsense\n" * 50),
    "nonsense.vtk": text("nonsense\n" * 50),
    "nonsense.msh": text("nonsense\n" * 50),
    "nonsense.xdmf": text("nonsense\n" * 50),
    "nonsense.npz": text("nonsense\n" * 50),
    "nonsense.npy": text("nonsense\n" * 50),
    "nonsense.asc": text("nonsense\n" * 50),
    "nonsense.tif": text("nonsense\n" * 50),
    "pickled.npy": pickled,
    "pickled.npz": pickled,
    "bare_pickle.npy": bare_pickle,
    "bare_pickle.npz": bare_pickle,
    "huge.ply": big_header,
    "huge.npy": big_array,
    "lines.vtu": only_lines,
    "points.ply": points_only,
    "bands.tif": three_bands,
    "none.npz": archive(a=np.arange(3)),
    "two.npz": archive(a=np.eye(3), b=np.eye(3)),
    "outside.npz": archive(points=np.eye(3), triangles=[[0, 1, 3]]),
    "negative.npz": archive(points=np.eye(3), triangles=[[0, 1, -1]]),
    "nan.npz": archive(points=np.full((3, 3), np.nan), triangles=[[0, 1, 2]]),
    "inf.npz": archive(points=np.diag([1, 1, np.inf]), triangles=[[0, 1, 2]]),
    "flatland.npz": archive(points=np.zeros((3, 1)), triangles=[[0, 1, 2]]),
    "fractions.npz": archive(points=np.eye(3), triangles=[[0.5, 1, 2]]),
    "words.npz": archive(points=np.array([["a"] * 3] * 3), triangles=[[0, 1, 2]]),
    "no_triangles.npz": archive(points=np.eye(3), triangles=np.empty((0, 3), int)),
    "complex.npy": lambda path: np.save(path, 1j * HEIGHTS),
    "words.npy": lambda path: np.save(path, HEIGHTS.astype(str)),
    "cube.npy": lambda path: np.save(path, np.zeros((3, 3, 3))),
    "cell.npy": lambda path: np.save(path, np.zeros((1, 1))),
    "nan.npy": lambda path: np.save(path, np.full((4, 4), np.nan)),
    "inf.npy": lambda path: np.save(path, np.full((4, 4), np.inf)),
    "short.asc": text(ascii_grid("cellsize 1")[:-8]),
    "header.asc": text("cellsize 1\n1 2 3\n"),
    "letters.asc": text(ascii_grid("cellsize 1") + "x"),
    "zero.asc": text(ascii_grid("cellsize 0")),
    "mesh": text("without a suffix"),
    "mesh.docx": text("of no kind"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_one_sentence_and_runs_nothing(name, tmp_path, capfd):
    path = tmp_path / name
    BROKEN[name](path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError) as refusal:
        equimesh_adapters.load(path)
    sentence = str(refusal.value)
    assert sentence.endswith(".")
    assert "\n" not in sentence
    assert sorted(tmp_path.iterdir()) == before
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", DOUBLE + SINGLE)
@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9])
def test_a_truncated_mesh_is_refused_or_still_a_mesh(suffix, kept, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    if suffix == ".obj":  # text without a count may end anywhere
        with contextlib.suppress(InputError):
            points, triangles = equimesh_adapters.load_mesh(path)
            assert triangles.max() < len(points)
    else:
        with pytest.raises(InputError, match=r"\.$"):
            equimesh_adapters.load_mesh(path)


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(InputError, match=r"There is no file .*none\.ply"):
        equimesh_adapters.load(tmp_path / "none.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(InputError, match="is a folder"):
        equimesh_adapters.load(tmp_path / "folder.ply")


def test_an_unknown_suffix_lists_those_that_are_known(result, tmp_path):
    (tmp_path / "a.xyz").touch()
    with pytest.raises(InputError, match=r"\.xyz is not known here: use one of .*\.npy .*\.vtu"):
        equimesh_adapters.load(tmp_path / "a.xyz")
    with pytest.raises(InputError, match=r"\.npy is not known here") as refusal:
        equimesh_adapters.save(tmp_path / "a.npy", result)
    assert ".tif" not in str(refusal.value)


def test_a_raster_holds_no_triangles_and_has_no_other_up(tmp_path):
    np.save(tmp_path / "a.npy", HEIGHTS)
    with pytest.raises(InputError, match="no triangles"):
        equimesh_adapters.load_mesh(tmp_path / "a.npy")
    with pytest.raises(InputError, match="up"):
        formats.load(tmp_path / "a.npy", up=(0.0, 0.0, 1.0))


def test_an_obj_file_cannot_pull_in_other_files(tmp_path):
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd secret.png\n")
    lines = ["mtllib secret.mtl", "usemtl a", "v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 3"]
    (tmp_path / "a.obj").write_text("\n".join(lines))
    assert len(equimesh_adapters.load_mesh(tmp_path / "a.obj").triangles) == 1


# Writing


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_else(tmp_path):
    old = tmp_path / "mesh.ply"
    old.write_text("old")

    def half_way():
        with staged([old]) as (draft,):
            draft.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        half_way()
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


def test_files_appear_together_or_not_at_all(tmp_path, monkeypatch):
    targets = [tmp_path / name for name in ("a", "b", "c")]
    targets[0].write_text("old")

    def fill(fail_on=None):
        with staged(targets) as drafts:
            for draft in drafts:
                if draft.name != fail_on:
                    draft.write_text("new")

    with pytest.raises(InputError, match="c cannot be written"):
        fill(fail_on="c")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert targets[0].read_text() == "old"
    fill()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b", "c"]
    assert {path.read_text() for path in targets} == {"new"}


def test_a_folder_that_is_none_cannot_be_written_to(result, tmp_path):
    (tmp_path / "file").touch()
    for folder in ("file", "missing"):
        with pytest.raises(InputError, match="is not a folder"):
            equimesh_adapters.save(tmp_path / folder / "mesh.ply", result)


# Other people's formats


def test_another_package_adds_a_suffix_through_an_entry_point(result, tmp_path, monkeypatch):
    def write(path, result):
        path.write_text(json.dumps(result.triangles.tolist()))

    def read(path):
        triangles = np.array(json.loads(path.read_text()))
        return formats.TriangleMesh(np.zeros((triangles.max() + 1, 2)), triangles)

    entries = [
        SimpleNamespace(name="mine", load=lambda: formats.Format((".mine",), read, write)),
        SimpleNamespace(name="broken", load=lambda: __import__("no_such_module")),
    ]
    monkeypatch.setattr(formats, "entry_points", lambda group: entries)
    path = Path(tmp_path / "mesh.mine")
    with pytest.warns(UserWarning, match="broken is left out"):
        equimesh_adapters.save(path, result)
    with pytest.warns(UserWarning, match="broken is left out"):
        loaded = equimesh_adapters.load_mesh(path)
    np.testing.assert_array_equal(loaded.triangles, result.triangles)
