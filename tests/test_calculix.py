"""CalculiX's files: sets by name, read again by meshio, and sides that are those of the curve."""

import re

import meshio
import numpy as np
import pytest
import shapely

import equimesh
import equimesh_adapters
from equimesh_adapters.calculix import from_result

PLATE = shapely.box(0, 0, 1, 1) - shapely.box(0.3, 0.4, 0.5, 0.7)
CURVES = {"OUTLINE": "outline", "HOLE_1": "hole 1"}


@pytest.fixture(scope="module")
def result():
    return equimesh.remesh("sin(3*x)*y*y/3", 0.002, PLATE)


@pytest.fixture
def reread(result, tmp_path):
    equimesh_adapters.save(tmp_path / "mesh.inp", result)
    return meshio.read(tmp_path / "mesh.inp")


def test_the_mesh_comes_back_in_the_plane(result, reread, tmp_path):
    np.testing.assert_allclose(reread.points[:, :2], result.points[:, :2], rtol=1e-13)
    assert not reread.points[:, 2].any()
    np.testing.assert_array_equal(reread.get_cells_type("triangle"), result.triangles)
    ours = equimesh_adapters.load_mesh(tmp_path / "mesh.inp")
    np.testing.assert_array_equal(ours.triangles, result.triangles)


def test_curves_are_node_and_element_sets(result, reread):
    assert reread.point_sets.keys() == CURVES.keys()
    for label, name in CURVES.items():
        edges = result.boundary.edges_of(name)
        np.testing.assert_array_equal(reread.point_sets[label], np.unique(edges))
        (inside,) = reread.cell_sets[label]
        touched = np.isin(result.triangles, edges)
        assert (touched[inside].sum(axis=1) >= 2).all()
    assert len(reread.cell_sets["EALL"][0]) == len(result.triangles)


def test_surfaces_are_the_sides_of_triangles_along_the_curve(result):
    text = from_result(result)
    for label, name in CURVES.items():
        block = text.split(f"*SURFACE, NAME={label}, TYPE=ELEMENT\n")[1].split("*")[0]
        found = [(int(i) - 1, int(k) - 1) for i, k in re.findall(r"(\d+), S(\d)", block)]
        sides = [result.triangles[i][[k, (k + 1) % 3]].tolist() for i, k in found]
        assert sides == result.boundary.edges_of(name).tolist()  # both have the domain on the left


def test_shells_keep_their_heights_and_other_elements_lie_in_the_plane(result):
    for element, flat in (("CPE3", True), ("S3", False)):
        text = from_result(result, element)
        assert f"*ELEMENT, TYPE={element}, ELSET=EALL" in text
        block = text.split("*NODE, NSET=NALL\n")[1].split("*")[0]
        nodes = np.array([line.split(",") for line in block.splitlines()], float)
        heights = 0.0 * result.points[:, 2] if flat else result.points[:, 2]
        np.testing.assert_allclose(nodes[:, 3], heights, rtol=1e-13)


def test_no_line_is_longer_than_calculix_reads(result):
    far = equimesh.remesh("sin(x*y/1e9)", 0.3, (-1e5 - 1 / 3, 1e-9 / 3, 1e5, 1e5 + 1e-7 / 3))
    for text in (from_result(result), from_result(far)):
        for line in text.splitlines():
            words = [word.strip() for word in line.split(",")]
            assert len(words) <= 16
            assert line.startswith("*") or max(map(len, words)) <= 20
