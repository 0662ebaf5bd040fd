"""Appendix B for every theta, and tilings of the plane."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from equimesh import lattice, local
from equimesh.errors import InputError

SADDLE = np.diag([1.0, -1.0])
THETAS = [t for t in np.linspace(0.0, 2.0 * math.pi, 73) if abs(math.cos(2 * t)) > 0.01]
RESIDUES = {1: (-1, -1), 2: (-1, -1), 3: (1, -1), 4: (1, -1), 5: (-1, 1), 6: (-1, 1)}


@pytest.mark.parametrize("variant", lattice.VARIANTS)
@pytest.mark.parametrize("theta", THETAS)
def test_every_shape_has_equal_edge_errors_and_the_area_sqrt5_per_error(variant, theta):
    triangle = lattice.optimal_triangle(-1, variant, theta)
    errors = np.abs(local.edge_error(triangle, SADDLE))
    assert errors == pytest.approx(abs(math.cos(2 * theta)) / 4, abs=1e-14)
    assert local.area_per_error(triangle, SADDLE) == pytest.approx(math.sqrt(5), rel=1e-11)


@pytest.mark.parametrize("variant", lattice.VARIANTS)
@pytest.mark.parametrize("theta", THETAS)
def test_shapes_solve_24_and_25_with_the_signs_of_table_5(variant, theta):
    x, y = lattice.optimal_triangle(-1, variant, theta)[2]
    first, second = RESIDUES[variant]
    unit = math.cos(2 * theta)
    assert x * x - y * y == pytest.approx(first * unit, abs=1e-14)
    off = (x - math.cos(theta)) ** 2 - (y - math.sin(theta)) ** 2
    assert off == pytest.approx(second * unit, abs=1e-14)


def test_the_six_shapes_are_table_5_with_the_slip_in_v1_mended():
    t, r = 0.3, math.sqrt(5) / 2
    s, c = math.sin(t), math.cos(t)
    table = {
        1: (-r * s + c / 2, -r * c + s / 2),
        2: (r * s + c / 2, r * c + s / 2),
        3: (-r * s + 3 / 2 * c, 3 / 2 * s - r * c),
        4: (r * s + 3 / 2 * c, 3 / 2 * s + r * c),
        5: (-r * s - c / 2, -s / 2 - r * c),
        6: (r * s - c / 2, -s / 2 + r * c),
    }
    for variant, apex in table.items():
        assert lattice.optimal_triangle(-1, variant, t)[2] == pytest.approx(apex, abs=1e-15)


def test_v1_as_printed_is_not_optimal():
    t, r = 0.3, math.sqrt(5) / 2
    s, c = math.sin(t), math.cos(t)
    for apex in ((r * s + c / 2, -r * c / 2 + s / 2), (r * s + c / 2, -r * c + s / 2)):
        triangle = np.array([[0.0, 0.0], [c, s], apex])
        assert local.area_per_error(triangle, SADDLE) < 2.0


@given(st.integers(0, 2**32 - 1))
def test_no_saddle_triangle_near_an_optimal_one_is_better(seed):
    rng = np.random.default_rng(seed)
    triangle = lattice.optimal_triangle(-1, 2) + 0.2 * rng.normal(size=(3, 2))
    assert local.area_per_error(triangle, SADDLE) <= math.sqrt(5) + 1e-12


@pytest.mark.parametrize("signature", [1, -1])
@pytest.mark.parametrize("variant", lattice.VARIANTS)
@pytest.mark.parametrize("theta", [0.0, 0.3, -0.7, 1.2])
def test_lattice_vectors_have_unit_error_in_the_scale_of_section_3(signature, variant, theta):
    v = lattice.lattice_vectors(signature, variant, theta)
    form = local.quadratic_form(np.diag([1.0, signature]))
    triangle = np.vstack([np.zeros(2), v])
    assert local.largest_error(triangle, form) == pytest.approx(1.0, rel=1e-12)


def test_the_default_lattices_are_those_of_the_paper():
    base = 2 * math.sqrt(2)
    expected = base * np.array([[1.0, 0.0], [0.5, math.sqrt(5) / 2]])
    assert lattice.lattice_vectors(-1) == pytest.approx(expected)
    sides = lattice.lattice_vectors(1)
    assert np.linalg.norm(sides, axis=1) == pytest.approx(math.sqrt(3) * math.sqrt(2))


def test_an_equilateral_lattice_on_a_saddle_covers_sqrt3_per_error():
    triangle = np.vstack([np.zeros(2), lattice.equilateral_vectors(-1)])
    form = local.quadratic_form(SADDLE)
    assert local.largest_error(triangle, form) == pytest.approx(1.0)
    assert local.area_per_error(triangle, form) == pytest.approx(math.sqrt(3))


def test_boosts_form_a_group_that_keeps_the_saddle():
    a, b = lattice.boost(0.7), lattice.boost(-1.9)
    assert a @ b == pytest.approx(lattice.boost(-1.2))
    assert a.T @ SADDLE @ a == pytest.approx(SADDLE)


def test_a_turned_base_is_a_boosted_lattice():
    theta = 0.4
    expected = lattice.lattice_vectors(-1) @ lattice.boost(math.atanh(math.tan(theta))).T
    assert lattice.lattice_vectors(-1, 2, theta) == pytest.approx(expected)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([1, -1]),
    st.integers(1, 6),
    st.floats(-0.75, 0.75),
    st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0, 25), st.floats(0, 25)),
    st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
)
def test_a_tiling_covers_the_box_once_with_congruent_triangles(sign, variant, theta, box, offset):
    vectors = lattice.lattice_vectors(sign, variant, theta)
    bounds = (box[0], box[1], box[0] + box[2], box[1] + box[3])
    points, triangles = lattice.tile(vectors, bounds, offset)
    assert np.unique(triangles).size == len(points)
    areas = local.area(points[triangles])
    # Every triangle is as large as the two vectors say, and counter-clockwise.
    assert areas == pytest.approx(abs(np.linalg.det(vectors)) / 2, rel=1e-6)
    together = shapely.union_all(shapely.polygons(points[triangles]), grid_size=1e-9)
    assert together.area == pytest.approx(areas.sum(), rel=1e-6)
    assert together.buffer(1e-6).covers(shapely.box(*bounds))
    steps = points @ np.linalg.inv(vectors) - offset
    assert steps == pytest.approx(np.round(steps), abs=1e-6)


def test_a_tiling_of_a_large_box_has_few_triangles_to_spare():
    vectors = lattice.lattice_vectors(-1, 2, 0.7)
    _, triangles = lattice.tile(vectors, (0.0, 0.0, 400.0, 400.0))
    needed = 400.0**2 / (abs(np.linalg.det(vectors)) / 2)
    assert needed <= len(triangles) <= 1.1 * needed


def test_what_is_no_lattice_is_refused():
    with pytest.raises(InputError, match="V1 to V6"):
        lattice.optimal_triangle(-1, 7)
    with pytest.raises(InputError, match="null direction"):
        lattice.optimal_triangle(-1, 2, math.pi / 4)
    with pytest.raises(InputError, match=r"\+1 or -1"):
        lattice.lattice_vectors(0)
    with pytest.raises(InputError, match="skew"):
        lattice.tile([[1.0, 2.0], [2.0, 4.0]], (0, 0, 1, 1))
    with pytest.raises(InputError, match="finite"):
        lattice.tile(np.eye(2), (0, 0, math.inf, 1))


def test_the_six_shapes_tile_one_set_of_points_in_three_ways():
    base = np.array([1.0, 0.0])
    ways = {}
    for variant in lattice.VARIANTS:
        a, b = lattice.optimal_triangle(-1, variant)[1:]
        edges = [v if (v[1], v[0]) > (0, 0) else -v for v in (a, b, b - a)]
        ways[variant] = frozenset((round(x, 9), round(y, 9)) for x, y in edges)
        steps = np.stack([a, b]) @ np.linalg.inv([base, lattice.optimal_triangle(-1, 2)[2]])
        assert steps == pytest.approx(np.round(steps), abs=1e-12)
        assert abs(np.linalg.det(steps)) == pytest.approx(1.0)
    assert ways[1] == ways[2]
    assert ways[4] == ways[5]
    assert ways[3] == ways[6]
    assert len(set(ways.values())) == 3
