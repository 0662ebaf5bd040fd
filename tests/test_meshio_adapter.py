"""meshio meshes in and out, with their data and groups."""

import hashlib
import pickle

import meshio
import numpy as np
import pytest

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters import meshio as adapter

NAMES = ("bottom", "right", "top", "left")


@pytest.fixture(scope="module")
def result():
    return equimesh.remesh("sin(3*x)*y", tol=0.01, domain=(0, 0, 2, 1))


def fingerprint(mesh):
    parts = [
        mesh.points, [(block.type, block.data) for block in mesh.cells], mesh.point_data,
        mesh.cell_data, mesh.cell_sets, mesh.field_data, mesh.point_sets,
    ]  # fmt: skip
    return hashlib.sha256(pickle.dumps(parts)).hexdigest()


def terrain(n=40):
    """z = sin 3x y on (n + 1)^2 points, triangles in two materials and lines around, all named."""
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate(
        [np.column_stack([i, i + 1, i + n + 2]), np.column_stack([i, i + n + 2, i + n + 1])]
    )
    side, above = np.arange(n), n * (n + 1)
    lines = np.concatenate(
        [
            np.column_stack([side, side + 1]),
            np.column_stack([n + side * (n + 1), n + (side + 1) * (n + 1)]),
            np.column_stack([above + n - side, above + n - side - 1]),
            np.column_stack([(n - side) * (n + 1), (n - side - 1) * (n + 1)]),
        ]
    )
    points = np.column_stack([x, y, np.sin(3 * x) * y])
    east = points[triangles].mean(axis=1)[:, 0] > 0.5
    none = np.zeros(0, int)
    sets = {"west": [np.flatnonzero(~east), none], "east": [np.flatnonzero(east), none]}
    sets |= {name: [none, np.arange(k * n, (k + 1) * n)] for k, name in enumerate(NAMES)}
    return meshio.Mesh(
        points,
        [("triangle", triangles), ("line", lines)],
        point_data={
            "linear": 2 * x - y,
            "vector": np.column_stack([x, y, x - y]),
            "flag": x > 0.5,
        },
        cell_data={
            "material": [east.astype(int) + 1, np.repeat([11, 12, 13, 14], n)],
            "half": [east.astype(float), np.full(4 * n, 7.0)],
        },
        cell_sets=sets,
        field_data={"west": np.array([1, 2]), "bottom": np.array([11, 1])},
    )  # fmt: skip


def test_a_result_has_its_groups_values_and_errors(result):
    mesh = adapter.from_result(result)
    np.testing.assert_array_equal(mesh.points, result.points)
    np.testing.assert_array_equal(mesh.get_cells_type("triangle"), result.triangles)
    np.testing.assert_array_equal(mesh.get_cells_type("line"), result.boundary.edges)
    np.testing.assert_array_equal(mesh.point_data["value"], result.points[:, 2])
    np.testing.assert_array_equal(mesh.cell_data["error"][0], result.profile.errors)
    assert tuple(mesh.cell_sets) == ("surface", *NAMES)
    assert len(mesh.cell_sets["surface"][0]) == len(result.triangles)
    for number, name in enumerate(NAMES, 1):
        np.testing.assert_array_equal(mesh.field_data[name], [number, 1])
        lines = mesh.get_cells_type("line")[mesh.cell_sets[name][1]]
        np.testing.assert_array_equal(lines, result.boundary.edges_of(name))
    np.testing.assert_array_equal(mesh.field_data["surface"], [1, 2])


def test_a_line_has_the_error_of_its_triangle(result):
    lines = adapter.from_result(result).cell_data["error"][1]
    for edge, error in zip(result.boundary.edges, lines, strict=True):
        (beside,) = np.flatnonzero(np.isin(result.triangles, edge).sum(axis=1) == 2)
        assert error == result.profile.errors[beside]


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf"])
def test_files_give_everything_back(suffix, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    equimesh_adapters.save(path, result)
    mesh, sent = meshio.read(path), adapter.from_result(result)
    np.testing.assert_array_equal(mesh.points, sent.points)
    for block, other in zip(mesh.cells, sent.cells, strict=True):
        assert block.type == other.type
        np.testing.assert_array_equal(block.data, other.data)
    np.testing.assert_array_equal(mesh.point_data["value"], sent.point_data["value"])
    for data, other in zip(mesh.cell_data["error"], sent.cell_data["error"], strict=True):
        np.testing.assert_array_equal(data, other)
    (joined,) = mesh.cell_data.keys() - {"error"}
    mesh.cell_data_to_sets(joined)
    for name, members in sent.cell_sets.items():
        for inside, other in zip(mesh.cell_sets[name], members, strict=True):
            np.testing.assert_array_equal(inside, other)


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf", ".inp", ".mesh", ".obj", ".off"])
def test_what_meshio_writes_and_reads_is_a_field_again(suffix, result, tmp_path):
    path = tmp_path / f"mesh{suffix}"
    triangles = meshio.Mesh(result.points, [("triangle", result.triangles)])
    triangles.write(path)
    profile = adapter.profile(meshio.read(path), "sin(3*x)*y")
    assert profile.bound <= result.tol * (1 + 1e-6)


def test_remeshing_carries_data_and_groups():
    fine = terrain()
    before = fingerprint(fine)
    coarse = equimesh_adapters.remesh(fine, tol="1%")
    assert fingerprint(fine) == before
    assert type(coarse) is meshio.Mesh
    triangles, lines = coarse.get_cells_type("triangle"), coarse.get_cells_type("line")
    assert 5 * len(triangles) < len(fine.get_cells_type("triangle"))
    assert adapter.profile(coarse, adapter.to_field(fine)).bound <= 0.01 * np.ptp(fine.points[:, 2])
    x, y, _ = coarse.points.T
    np.testing.assert_allclose(coarse.point_data["linear"], 2 * x - y, atol=1e-12)
    np.testing.assert_allclose(coarse.point_data["vector"][:, 2], x - y, atol=1e-12)
    assert coarse.point_data["flag"].dtype == bool
    assert coarse.cell_data["error"][0].max() <= 0.01 * np.ptp(fine.points[:, 2])
    assert len(coarse.cell_data["error"][1]) == len(lines)
    material, edge_material = coarse.cell_data["material"]
    middle = coarse.points[triangles].mean(axis=1)
    np.testing.assert_array_equal(material, 1 + (middle[:, 0] > 0.5))
    np.testing.assert_array_equal(coarse.cell_data["half"][0], middle[:, 0] > 0.5)
    np.testing.assert_array_equal(coarse.cell_data["half"][1], 7.0)
    np.testing.assert_array_equal(coarse.cell_sets["east"][0], np.flatnonzero(middle[:, 0] > 0.5))
    places = coarse.points[lines]
    flat = {"bottom": (1, 0.0), "right": (0, 1.0), "top": (1, 1.0), "left": (0, 0.0)}
    for number, (name, (axis, value)) in enumerate(flat.items()):
        on = (places[:, :, axis] == value).all(axis=1)
        np.testing.assert_array_equal(coarse.cell_sets[name][1], np.flatnonzero(on))
        np.testing.assert_array_equal(edge_material[on], 11 + number)
    assert coarse.field_data.keys() == fine.field_data.keys()
    for key, value in fine.field_data.items():
        np.testing.assert_array_equal(coarse.field_data[key], value)


def test_a_mesh_without_lines_gets_none_and_quadrilaterals_lead_to_their_cells():
    x, y = (grid.ravel() for grid in np.meshgrid(*2 * [np.linspace(0, 1, 9)]))
    i = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    quads = np.column_stack([i, i + 1, i + 10, i + 9])
    mesh = meshio.Mesh(
        np.column_stack([x, y, x * y]),
        [("vertex", [[0]]), ("quad", quads)],
        cell_data={"column": [[-1], np.tile(np.arange(8), 8)]},
    )
    coarse = adapter.remesh(mesh, tol=0.02)
    assert [block.type for block in coarse.cells] == ["triangle"]
    middle = coarse.points[coarse.get_cells_type("triangle")].mean(axis=1)
    np.testing.assert_array_equal(coarse.cell_data["column"][0], (8 * middle[:, 0]).astype(int))


def test_a_mesh_of_no_surface_is_refused():
    with pytest.raises(InputError, match="no triangles but tetra"):
        adapter.to_field(meshio.Mesh(np.eye(4)[:, :3], [("tetra", [[0, 1, 2, 3]])]))
    with pytest.raises(InputError, match="no triangles but no cells"):
        adapter.remesh(meshio.Mesh(np.eye(3), []), 0.1)
