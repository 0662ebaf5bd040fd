"""The error profile of any mesh."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import equimesh
from equimesh.errors import InputError

TRIANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
ONE = np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    "text, error",
    [
        ("x**2", 1 / 4),
        ("x*y", 1 / 4),
        ("x**2+y**2", 1 / 2),
        ("3+2*x-y", 0.0),
        # A cubic on an edge of length 1 from its inflection: largest where x = 1 / sqrt 3.
        ("x**3", 2 / (3 * math.sqrt(3))),
    ],
)
def test_one_triangle_has_its_closed_form(text, error):
    p = equimesh.profile(TRIANGLE, ONE, text)
    assert p.max == pytest.approx(error, rel=2e-3, abs=1e-15)
    assert error * (1 - 1e-12) <= p.bound <= error * 1.005 + 1e-14


def test_an_acute_triangle_of_a_convex_function_has_half_its_circumradius_squared():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, math.sqrt(0.75)]])
    p = equimesh.profile(corners, ONE, "(x**2+y**2)/2")
    assert p.max == pytest.approx(1 / 6, rel=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_quantiles_are_the_share_of_triangles_below(seed):
    rng = np.random.default_rng(seed)
    points, triangles = rng.uniform(size=(60, 2)), np.arange(60).reshape(20, 3)
    p = equimesh.profile(points, triangles, "exp(x)*cos(3*y)")
    assert p.quantile(0.0) == p.errors.min()
    assert p.quantile(1.0) == p.errors.max() == p.max
    assert p.quantile(0.5) == pytest.approx(np.median(p.errors))
    assert p.bound == p.bounds.max()
    assert (p.bounds >= p.errors).all()


@given(st.integers(0, 2**32 - 1), st.floats(-10, 10))
def test_orientation_order_and_a_plane_added_to_both_do_not_matter(seed, slope):
    rng = np.random.default_rng(seed)
    points, triangles = rng.uniform(size=(30, 2)), np.arange(30).reshape(10, 3)
    first = equimesh.profile(points, triangles, "sin(3*x)*y")
    turned = equimesh.profile(points, triangles[:, [1, 0, 2]], "sin(3*x)*y")
    assert turned.errors == pytest.approx(first.errors, rel=0.02, abs=1e-12)
    tilted = equimesh.profile(points, triangles, lambda x, y: np.sin(3 * x) * y + slope * x - y)
    assert tilted.errors == pytest.approx(first.errors, rel=1e-6, abs=1e-12)
    order = rng.permutation(10)
    shuffled = equimesh.profile(points, triangles[order], "sin(3*x)*y")
    assert shuffled.errors == pytest.approx(first.errors[order], rel=1e-12)


def test_heights_of_the_mesh_count_where_they_are_given():
    flat = np.column_stack([TRIANGLE, [0.5, 0.5, 0.5]])
    assert equimesh.profile(flat, ONE, "0*x").max == 0.5
    assert equimesh.profile(TRIANGLE, ONE, "0*x").max == 0.0


def test_what_is_measured_is_not_changed():
    points = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    triangles = np.array([[0, 1, 2]])
    p = equimesh.profile(points, triangles, "x*y")
    assert (points == [[0, 0], [0, 1], [1, 0]]).all()
    assert (triangles == [[0, 1, 2]]).all()
    # What is kept is the mesh with heights, counter-clockwise.
    assert p.points.shape == (3, 3)
    a, b, c = p.points[p.triangles[0], :2]
    assert (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0] > 0


def test_a_raster_is_measured_between_its_samples():
    x, y = np.meshgrid(np.arange(5.0), np.arange(4.0))
    heights = x * y
    corners = np.array([[0, 0], [4, 0], [4, 3], [0, 3]])
    # The bilinear surface of x y is x y itself; the diagonal halves the square.
    p = equimesh.profile(corners, np.array([[0, 1, 2], [0, 2, 3]]), heights)
    assert p.errors == pytest.approx(3.0, rel=1e-12)


def test_the_same_result_as_remesh_reports():
    r = equimesh.remesh("x**2+x*y+2*y**2", 0.01, (0, 0, 1, 1))
    again = equimesh.profile(r.points, r.triangles, "x**2+x*y+2*y**2")
    assert again.max == pytest.approx(r.profile.max, rel=1e-9)
    assert again.bound <= r.tol


@pytest.mark.parametrize(
    "points, triangles",
    [
        ([], [[0, 1, 2]]),
        ([[0], [1], [2]], [[0, 1, 2]]),
        (TRIANGLE, []),
        (TRIANGLE, [[0, 1]]),
        (TRIANGLE, [[0.0, 1.0, 2.0]]),
        (TRIANGLE, [[0, 1, 3]]),
        (TRIANGLE, [[0, 1, -1]]),
        ([[0, 0], [1, 0], [0, math.nan]], [[0, 1, 2]]),
        ([[0, 0], [1, 0], [0, math.inf]], [[0, 1, 2]]),
    ],
)
def test_what_is_no_mesh_is_refused_in_one_sentence(points, triangles):
    with pytest.raises(InputError, match=r"^[^\n]*\.$"):
        equimesh.profile(points, triangles, "x")


def test_a_vertex_without_height_is_named():
    with pytest.raises(InputError, match="no height at vertex 0"):
        equimesh.profile([[-1, 0], [1, 0], [1, 1]], ONE, "sqrt(x)")
