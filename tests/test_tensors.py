"""Symmetric tensors through the layouts of other programs and back, with those programs."""

import meshio
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from equimesh.errors import InputError
from equimesh_adapters import medit_files
from equimesh_adapters.tensors import in_plane, in_space, pack, unpack

# Six different entries, so that no permutation of them preserves it; positive definite.
SPACE = np.array([[11.0, 1.25, -2.5], [1.25, 23.0, 3.75], [-2.5, 3.75, 37.0]])
PLANE = np.array([[11.0, 1.25], [1.25, 23.0]])
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])


def many(tensor, count=4):
    """Different tensors at different vertices, of few digits: Mmg writes fifteen in text."""
    return tensor * (1.0 + 0.25 * np.arange(count))[:, None, None]


@pytest.fixture
def gmsh():
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    yield gmsh
    gmsh.finalize()


@given(
    arrays(float, (3, 6), elements=st.floats(-1e6, 1e6)),
    st.sampled_from(["medit", "mmg", "vtk", "rows"]),
)
def test_every_layout_gives_back_what_it_took(entries, layout):
    full = np.empty((3, 3, 3))
    rows, columns = np.triu_indices(3)
    full[:, rows, columns] = full[:, columns, rows] = entries
    np.testing.assert_array_equal(unpack(pack(full, layout), layout), full)
    plane = in_plane(full)
    back = unpack(pack(plane, layout), layout)
    np.testing.assert_array_equal(back[:, :2, :2], plane)


@pytest.mark.parametrize(
    "layout, entries",
    [
        ("medit", [11, 1.25, 23, -2.5, 3.75, 37]),
        ("mmg", [11, 1.25, -2.5, 23, 3.75, 37]),
        ("vtk", [11, 23, 37, 1.25, 3.75, -2.5]),
        ("rows", [11, 1.25, -2.5, 1.25, 23, 3.75, -2.5, 3.75, 37]),
    ],
)
def test_entries_stand_where_each_program_has_them(layout, entries):
    np.testing.assert_array_equal(pack(SPACE[None], layout), [entries])


def test_the_plane_in_space_measures_the_plane_alike():
    edge = np.array([0.3, -0.7])
    lifted = np.append(edge, 0.0)
    assert lifted @ in_space(PLANE[None])[0] @ lifted == edge @ PLANE @ edge
    np.testing.assert_array_equal(in_plane(in_space(PLANE[None], 5.0)), PLANE[None])


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("suffix", [".sol", ".solb"])
def test_medit_files_and_mmg_tell_the_same_tensor(dimension, suffix, tmp_path):
    mmgpy = pytest.importorskip("mmgpy")
    tensors = many(SPACE if dimension == 3 else PLANE)
    # Mmg 5.8 puts a line end after every tensor of a .solb, so that it cannot read its own.
    path, back = tmp_path / f"ours{suffix}", tmp_path / "theirs.sol"
    if dimension == 3:
        mesh = mmgpy.MmgMesh3D(TETRAHEDRON, np.array([[0, 1, 2, 3]], np.int32))
    else:
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
        mesh = mmgpy.MmgMesh2D(square, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    medit_files.write_solution(path, dimension, tensors)
    mesh.load_sol(str(path))
    np.testing.assert_array_equal(unpack(mesh.get_field("tensor"), "mmg"), tensors)
    mesh.set_field("tensor", pack(tensors, "mmg"))
    mesh.save_sol(str(back))
    np.testing.assert_array_equal(medit_files.read_solution(back)[0], tensors)


def test_gmsh_views_keep_it_in_memory_and_in_files(gmsh, tmp_path):
    from equimesh_adapters.gmsh_views import add_tensors

    points = np.array([[0, 0], [1, 0], [0.25, 1]])
    view = add_tensors(gmsh, points, np.array([[0, 1, 2]]), many(PLANE, 3), 0.5)
    path = tmp_path / "view.pos"
    gmsh.view.write(view, str(path))
    gmsh.merge(str(path))
    for tag in gmsh.view.getTags():
        kinds, _, data = gmsh.view.getListData(tag)
        assert kinds == ["TT"]
        row = np.asarray(data[0]).reshape(-1, 36)[0]
        np.testing.assert_array_equal(row[:9].reshape(3, 3)[:2].T, points)
        tensors = unpack(row[9:].reshape(3, 9), "rows")
        np.testing.assert_allclose(in_plane(tensors), many(PLANE, 3), rtol=1e-15)
    assert len(gmsh.view.getTags()) == 2


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf"])
@pytest.mark.parametrize("layout", ["rows", "vtk"])
def test_vtk_files_keep_it(suffix, layout, tmp_path):
    path = tmp_path / f"tensors{suffix}"
    packed = pack(many(SPACE), layout)
    meshio.Mesh(TETRAHEDRON, [("tetra", [[0, 1, 2, 3]])], point_data={"metric": packed}).write(path)
    read = np.asarray(meshio.read(path).point_data["metric"]).reshape(4, -1)
    np.testing.assert_array_equal(unpack(read, layout), many(SPACE))


def test_a_trip_through_all_of_them_changes_nothing(gmsh, tmp_path):
    mmgpy = pytest.importorskip("mmgpy")
    sol, vtu = tmp_path / "a.sol", tmp_path / "a.vtu"
    medit_files.write_solution(sol, 3, many(SPACE))
    mesh = mmgpy.MmgMesh3D(TETRAHEDRON, np.array([[0, 1, 2, 3]], np.int32))
    mesh.load_sol(str(sol))
    nine = pack(unpack(mesh.get_field("tensor"), "mmg"), "rows")
    view = gmsh.view.add("metric")
    gmsh.view.addListData(view, "TS", 1, np.concatenate([TETRAHEDRON.T.ravel(), nine.ravel()]))
    nine = np.asarray(gmsh.view.getListData(view)[2][0])[12:].reshape(4, 9)
    meshio.Mesh(TETRAHEDRON, [("tetra", [[0, 1, 2, 3]])], point_data={"metric": nine}).write(vtu)
    back = unpack(meshio.read(vtu).point_data["metric"].reshape(4, 9), "rows")
    mesh.set_field("tensor", pack(back, "mmg"))
    mesh.save_sol(str(sol))
    np.testing.assert_array_equal(medit_files.read_solution(sol)[0], many(SPACE))


@pytest.mark.parametrize(
    "wrong, words",
    [
        (np.eye(3), "shape"),
        (np.ones((2, 2, 3)), "shape"),
        (np.array([[[1.0, 2.0], [0.0, 1.0]]]), "symmetric"),
    ],
)
def test_what_is_no_symmetric_tensor_is_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        pack(wrong, "medit")


@pytest.mark.parametrize("count", [1, 4, 5, 7])
def test_a_wrong_number_of_entries_is_refused(count):
    with pytest.raises(InputError, match="layout"):
        unpack(np.ones((2, count)), "medit")
