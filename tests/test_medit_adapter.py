"""Medit's files, and Mmg on what is in them."""

import hashlib
import pickle
import struct
import sys

import meshio
import numpy as np
import pytest

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters import medit

SURFACE = "exp(2*x+y) + (x-2*y)**2"
BOX = (0.0, 0.0, 1.0, 1.0)
NAMES = {1: "bottom", 2: "right", 3: "top", 4: "left"}


@pytest.fixture(scope="module")
def result():
    return equimesh.remesh(SURFACE, tol=0.01, domain=BOX)


@pytest.fixture(scope="module")
def metric():
    return equimesh.Metric.of(SURFACE, 0.01, BOX)


@pytest.fixture(scope="module")
def mmgpy():
    return pytest.importorskip("mmgpy")


def parts_of(mesh):
    return [
        mesh.points, mesh.triangles, mesh.references, mesh.edges, mesh.edge_references,
        mesh.corners,
    ]  # fmt: skip


def fingerprint(mesh):
    if not isinstance(mesh, medit.MeditMesh):
        mesh = medit.from_mmg(mesh)
    return hashlib.sha256(pickle.dumps(parts_of(mesh))).hexdigest()


def assert_equal(mesh, other, names=True):
    for part, theirs in zip(parts_of(mesh), parts_of(other), strict=True):
        np.testing.assert_array_equal(part, theirs)
    assert dict(mesh.names) == (dict(other.names) if names else {})


def share(metric, mesh):
    edges = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    lengths = metric.lengths(*(mesh.points[edges[:, k], :2] for k in range(2)))
    return np.mean((lengths >= 0.5**0.5) & (lengths <= 2.0**0.5))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_files_give_every_bit_back(dimension, suffix, result, tmp_path):
    mesh, path = medit.from_result(result, dimension=dimension), tmp_path / f"mesh{suffix}"
    medit.write_mesh(path, mesh)
    assert_equal(medit.read_mesh(path), mesh, names=suffix == ".mesh")


@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_results_are_saved_and_loaded_by_suffix(suffix, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    points, triangles = equimesh_adapters.load_mesh(path)
    np.testing.assert_array_equal(points, result.points)
    np.testing.assert_array_equal(triangles, result.triangles)


@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_meshio_reads_what_is_written_and_writes_what_is_read(suffix, result, tmp_path):
    ours, theirs = tmp_path / f"ours{suffix}", tmp_path / f"theirs{suffix}"
    mesh = medit.from_result(result)
    medit.write_mesh(ours, mesh)
    read = meshio.read(ours)
    np.testing.assert_array_equal(read.points, mesh.points)
    np.testing.assert_array_equal(read.get_cells_type("triangle"), mesh.triangles)
    np.testing.assert_array_equal(read.get_cell_data("medit:ref", "line"), mesh.edge_references)
    read.write(theirs)
    again = medit.read_mesh(theirs)
    for part, other in zip(parts_of(again)[:5], parts_of(mesh)[:5], strict=True):
        np.testing.assert_allclose(part, other, rtol=1e-15)


@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_mmg_reads_edges_and_references(suffix, result, mmgpy, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    for kind, dimension in ((mmgpy.MmgMesh2D, 2), (mmgpy.MmgMeshS, 3)):
        mesh = medit.from_result(result, dimension=dimension)
        medit.write_mesh(path, mesh)
        read = medit.from_mmg(kind(str(path)))
        for part, other in zip(parts_of(read)[:5], parts_of(mesh)[:5], strict=True):
            np.testing.assert_array_equal(part, other)


def test_corners_and_names_of_a_domain_with_a_hole(tmp_path):
    import shapely

    ring = shapely.box(0, 0, 3, 2).difference(shapely.box(1, 0.5, 2, 1.5))
    mesh = medit.from_result(equimesh.remesh("x*x*y", tol=0.02, domain=ring))
    found = {tuple(p) for p in mesh.points[mesh.corners, :2].tolist()}
    assert found == {tuple(p) for p in shapely.get_coordinates(ring).tolist()}
    assert mesh.names == {1: "outline", 2: "hole 1"}
    medit.write_mesh(tmp_path / "a.mesh", mesh)
    assert medit.read_mesh(tmp_path / "a.mesh").names == mesh.names


@pytest.mark.parametrize("version, order", [(1, "<"), (2, ">"), (3, "<"), (4, "<")])
def test_other_versions_of_binary_files(version, order, tmp_path):
    real = "f" if version == 1 else "d"
    place = "q" if version >= 3 else "i"
    whole = "q" if version >= 4 else "i"
    out = struct.pack(order + "2i", 1, version)
    out += struct.pack(order + "i" + place + "i", 3, len(out) + 8 + struct.calcsize(place), 2)
    rows = [(4, (real * 2 + whole), [(0.0, 0.0, 7), (1.0, 0.0, 8), (0.0, 1.0, 9)])]
    rows += [(6, whole * 4, [(1, 2, 3, 5)]), (15, whole, [(1,)]), (5, whole * 3, [(1, 2, 4)])]
    for code, form, table in rows:
        body = b"".join(struct.pack(order + form, *row) for row in table)
        head = struct.pack(order + whole, len(table))
        end = len(out) + 4 + struct.calcsize(order + place) + len(head) + len(body)
        out += struct.pack(order + "i" + place, code, end) + head + body
    path = tmp_path / "mesh.meshb"
    path.write_bytes(out + struct.pack(order + "i" + place, 54, 0))
    mesh = medit.read_mesh(path)
    np.testing.assert_array_equal(mesh.points, [[0, 0], [1, 0], [0, 1]])
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2]])
    assert mesh.references.tolist() == [5]
    assert mesh.edges.tolist() == [[0, 1]]
    assert mesh.edge_references.tolist() == [4]


def test_quadrilaterals_are_cut_and_other_words_passed_over(tmp_path):
    path = tmp_path / "mesh.mesh"
    path.write_text(
        "MeshVersionFormatted 1\nDimension\n3\n# a remark with Triangles 5\nVertices 4\n"
        "0 0 0 0\n1 0 0 0\n1 1 1 0\n0 1 0 0\nQuadrilaterals\n1\n1 2 3 4 6\n"
        "Ridges\n2\n1 2\nTangents 1\n0 nan 1\nEnd\n"
    )
    mesh = medit.read_mesh(path)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.references.tolist() == [6, 6]
    assert medit.to_field(mesh).span(medit.to_field(mesh).outline()) == (0.0, 1.0)


@pytest.mark.parametrize("suffix", [".sol", ".solb"])
def test_solutions_of_scalars_and_tensors_together(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    scalar, tensor = np.array([1 / 3, 2 / 7]), np.array([[[2.0, 0.1], [0.1, 3.0]]] * 2)
    medit.write_solution(path, 2, scalar, tensor)
    read = medit.read_solution(path)
    np.testing.assert_array_equal(read[0], scalar)
    np.testing.assert_array_equal(read[1], tensor)


@pytest.mark.parametrize(
    "content",
    ["", "solid cube\n", "MeshVersionFormatted 2\nDimension 2\nVertices\n3\n0 0 0\n1 0\n",
     "MeshVersionFormatted 2\nDimension 2\n", "MeshVersionFormatted 2\nDimension 5\nVertices 0\n"],
)  # fmt: skip
def test_damaged_files_are_refused(content, tmp_path):
    for name in ("a.mesh", "a.meshb"):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError):
            medit.read_mesh(tmp_path / name)


@pytest.mark.parametrize("suffix", [".mesh", ".meshb"])
def test_mmg_follows_the_written_metric_and_is_profiled(suffix, result, metric, mmgpy, tmp_path):
    paths = medit.write_background(tmp_path / f"in{suffix}", metric, result)
    run = mmgpy.MmgMesh2D(str(paths[0]))
    run.load_sol(str(paths[1]))
    run.remesh(hgrad=-1.0, verbose=-1)
    mesh = medit.from_mmg(run)
    assert share(metric, mesh) >= 0.95
    profile = medit.profile(run, SURFACE)
    assert profile.points.shape == (len(mesh.points), 3)
    assert 0.5 * 0.01 < profile.max < 4 * 0.01
    # Each side of the square is still the one that it was.
    middles = mesh.points[mesh.edges].mean(axis=1)
    for number, (axis, value) in {1: (1, 0), 2: (0, 1), 3: (1, 1), 4: (0, 0)}.items():
        on = np.flatnonzero(middles[:, axis] == value)
        np.testing.assert_array_equal(np.flatnonzero(mesh.edge_references == number), on)


def test_mmg_runs_from_here_too(result, metric, mmgpy):
    mesh = medit.adapt(metric, result)
    assert share(metric, mesh) >= 0.95
    assert dict(mesh.names) == NAMES
    assert {tuple(p) for p in mesh.points[mesh.corners].tolist()} == {
        (0, 0),
        (1, 0),
        (1, 1),
        (0, 1),
    }
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    coarse = medit.MeditMesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    assert share(metric, medit.adapt(metric, coarse, passes=5)) >= 0.95


def test_scalar_sizes_for_an_isotropic_metric(result, mmgpy, tmp_path):
    metric = equimesh.Metric.isotropic(lambda x, y: 0.03 + 0.1 * x)
    paths = medit.write_background(tmp_path / "in.mesh", metric, result, isotropic=True)
    mesh, sizes = medit.read_mesh(paths[0]), medit.read_solution(paths[1])[0]
    np.testing.assert_allclose(sizes, 0.03 + 0.1 * mesh.points[:, 0], rtol=1e-12)
    run = mmgpy.MmgMesh2D(str(paths[0]))
    run.load_sol(str(paths[1]))
    run.remesh(hgrad=-1.0, verbose=-1)
    assert share(metric, medit.from_mmg(run)) >= 0.95


def test_remeshing_in_space_keeps_references_names_and_the_input(result, mmgpy):
    mesh = medit.from_result(result)
    halves = (mesh.points[mesh.triangles].mean(axis=1)[:, 0] > 0.5).astype(int) + 5
    mesh = medit.MeditMesh(
        mesh.points, mesh.triangles, halves, mesh.edges, mesh.edge_references, mesh.corners,
        mesh.names,
    )  # fmt: skip
    for kind in (lambda m: m, medit.to_mmg):
        given = kind(mesh)
        before = fingerprint(given)
        made = equimesh_adapters.remesh(given, tol=0.05)
        assert fingerprint(given) == before
        assert type(made) is type(given)
        field = medit.to_field(mesh)
        assert medit.profile(made, field).bound <= 0.05 * (1 + 1e-9)
        made = made if isinstance(made, medit.MeditMesh) else medit.from_mmg(made)
        assert 2 * len(made.triangles) < len(mesh.triangles)
        assert set(made.references.tolist()) == {5, 6}
        middles = made.points[made.edges].mean(axis=1)
        for number, (axis, value) in {1: (1, 0), 2: (0, 1), 3: (1, 1), 4: (0, 0)}.items():
            on = np.flatnonzero(middles[:, axis] == value)
            np.testing.assert_array_equal(np.flatnonzero(made.edge_references == number), on)
    assert dict(medit.remesh(mesh, tol=0.05).names) == NAMES


def test_a_plane_mesh_is_made_for_a_function(result):
    plane = medit.from_result(result, dimension=2)
    made = medit.remesh(plane, tol=0.03, follow=SURFACE)
    assert made.points.shape[1] == 2
    assert medit.profile(made, SURFACE).bound <= 0.03
    assert dict(made.names) == NAMES
    assert np.unique(made.edge_references).tolist() == [1, 2, 3, 4]
    with pytest.raises(InputError, match="follow="):
        medit.remesh(plane, tol=0.03)
    with pytest.raises(InputError, match="leave out follow="):
        medit.remesh(medit.from_result(result), tol=0.03, follow=SURFACE)
    with pytest.raises(InputError, match="no Medit mesh"):
        medit.remesh(result.points, tol=0.03)


def test_without_mmg_the_files_still_work(result, metric, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mmgpy", None)
    medit.write_background(tmp_path / "in.mesh", metric, result)
    with pytest.raises(InputError, match=r"pip install 'equimesh\[mmg\]'"):
        medit.adapt(metric, result)
