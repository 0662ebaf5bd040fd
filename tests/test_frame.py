"""Local coordinates: where they come from, and that copies of a domain share them."""

import math

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import example, given
from hypothesis import strategies as st
from test_domain import star_polygon

from equimesh.fields import Function
from equimesh.frame import Frame

TILTED = Function("exp(x) + y**2 + x*y")


@given(st.integers(0, 200), st.floats(0, 2 * math.pi))
@example(0, 0.5 * math.pi)
def test_the_first_axis_runs_along_the_line_and_the_longer_extent_is_two(seed, angle):
    points = np.random.default_rng(seed).uniform(-1, 1, (9, 2)) * [3, 1]
    end = points[0] + np.array([math.cos(angle), math.sin(angle)])
    frame = Frame.along(points[0], end, points)
    a, b = frame.to_local(np.array([points[0], end]))
    assert b[0] > a[0]
    assert b[1] == pytest.approx(a[1], abs=1e-12)
    local = frame.to_local(points)
    assert np.ptp(local, axis=0).max() == pytest.approx(2.0)
    np.testing.assert_allclose(local.min(0) + local.max(0), 0.0, atol=1e-12)
    assert frame.determinant > 0.0
    np.testing.assert_allclose(frame.to_user(local), points, atol=1e-12)


def test_an_upright_box_keeps_upright_axes_to_the_last_bit():
    frame = TILTED.frame(shapely.box(0.1, 0.3, 0.7, 0.5))
    assert sorted(np.abs(frame.matrix).ravel())[:2] == [0.0, 0.0]


@given(st.integers(0, 300), st.floats(0, 2 * math.pi), st.floats(1e-3, 1e3))
@example(3, math.pi, 1.0)
def test_copies_of_a_function_and_its_domain_have_the_same_local_coordinates(seed, angle, grow):
    polygon = star_polygon(seed)
    c, s = math.cos(angle), math.sin(angle)
    matrix = grow * np.array([[c, -s], [s, c]])
    copy = shapely.transform(polygon, lambda p: p @ matrix.T)

    def f(x, y):
        return TILTED.value(*(np.linalg.inv(matrix) @ np.stack([x, y])))

    local, turned = (
        field.frame(domain).to_local(shapely.get_coordinates(domain))
        for field, domain in ((TILTED, polygon), (Function(f), copy))
    )
    np.testing.assert_allclose(turned, local, atol=1e-9)


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_of_equal_sides_the_function_chooses(quarters):
    """Whatever side comes first: along the one that starts where the function is the highest."""
    square = shapely.affinity.rotate(shapely.box(0, 0, 1, 1), 90 * quarters, origin=(0.5, 0.5))
    frame = TILTED.frame(square)
    np.testing.assert_allclose(frame.to_user(np.array([[-1.0, -1.0]])), [[1.0, 1.0]], atol=1e-15)
