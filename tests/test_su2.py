"""SU2's files: markers by name, and what is damaged is refused."""

import numpy as np
import pytest
import shapely

import equimesh
import equimesh_adapters
from equimesh.errors import InputError
from equimesh_adapters.su2 import from_result, markers, to_mesh

PLATE = (
    shapely.box(0, 0, 1, 1) - shapely.box(0.25, 0.25, 0.5, 0.5) - shapely.box(0.6, 0.6, 0.8, 0.9)
)


@pytest.fixture(scope="module")
def result():
    return equimesh.remesh("x*x/3 + x*y", 0.01, PLATE)


def test_the_mesh_comes_back_bit_for_bit_in_the_plane(result, tmp_path):
    path = tmp_path / "mesh.su2"
    equimesh_adapters.save(path, result)
    mesh = equimesh_adapters.load_mesh(path)
    np.testing.assert_array_equal(mesh.points, result.points[:, :2])
    np.testing.assert_array_equal(mesh.triangles, result.triangles)


def test_every_curve_is_a_marker_by_its_name(result):
    found = markers(from_result(result))
    assert list(found) == ["outline", "hole_1", "hole_2"]
    for name, edges in found.items():
        np.testing.assert_array_equal(edges, result.boundary.edges_of(name.replace("_", " ")))


def test_comments_quadrilaterals_and_missing_numbers_are_understood():
    text = """% a square
    NDIME= 2
    NELEM= 2
    9 0 1 2 3 0
    5 1 4 2
    NPOIN= 5 5
    0 0 0
    1 0 1
    1 1 % the corner
    0 1 3
    2 0.5 4
    NMARK= 1
    MARKER_TAG= far field
    MARKER_ELEMS= 1
    3 0 1
    """
    mesh = to_mesh(text)
    np.testing.assert_array_equal(mesh.triangles, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])
    np.testing.assert_array_equal(mesh.points[[2, 4]], [[1, 1], [2, 0.5]])
    assert {name: edges.tolist() for name, edges in markers(text).items()} == {
        "far field": [[0, 1]]
    }


def test_what_is_cut_short_or_lies_in_space_is_refused(result, tmp_path):
    text = from_result(result)
    path = tmp_path / "mesh.su2"
    for kept in (0.1, 0.5, 0.9):
        path.write_text(text[: int(kept * len(text))])
        with pytest.raises(InputError, match=r"\.$"):
            equimesh_adapters.load_mesh(path)
    path.write_text(text.replace("NDIME= 2", "NDIME= 3"))
    with pytest.raises(InputError, match="lies in space"):
        equimesh_adapters.load_mesh(path)
