"""Section 2, equation (4) and Appendix A against brute force and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from equimesh import local
from equimesh.errors import InputError
from equimesh.lattice import boost, optimal_triangle

NUMBER = st.floats(-3.0, 3.0).map(lambda v: round(v, 3))
FORM = st.tuples(NUMBER, NUMBER, NUMBER).map(lambda v: np.array([[v[0], v[1]], [v[1], v[2]]]))
TRIANGLE = st.lists(NUMBER, min_size=6, max_size=6).map(lambda v: np.reshape(v, (3, 2)))


def sampled_errors(triangle, form, n):
    """Interpolant minus x^T H x at a barycentric grid of n subdivisions."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    keep = i + j <= n
    weights = np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n
    at = weights @ triangle
    corner = np.einsum("ni,ij,nj->n", triangle, form, triangle)
    return weights @ corner - np.einsum("ni,ij,nj->n", at, form, at)


@given(TRIANGLE, FORM)
def test_largest_error_is_the_maximum_over_a_dense_grid(triangle, form):
    assume(abs(local.area(triangle)) > 1e-2)
    n = 120
    dense = np.abs(sampled_errors(triangle, form, n)).max()
    exact = local.largest_error(triangle[None], form)[0]
    # Between samples E moves by at most half the form times the squared spacing.
    reach = np.linalg.norm(form, 2) * (8.0 / n) ** 2
    assert dense <= exact + 1e-12 * (1 + exact)
    assert exact <= dense + reach


@given(TRIANGLE, FORM)
def test_error_is_a_conic_about_its_centre(triangle, form):
    assume(abs(local.area(triangle)) > 1e-1)
    assume(abs(np.linalg.det(form)) > 1e-1)
    c, e = local.centre(triangle[None], form)[0], local.error_at_centre(triangle[None], form)[0]
    off = triangle - c
    scale = max(1.0, abs(e), float(np.abs(off).max() ** 2 * np.abs(form).max()))
    # (1) at the three corners, where the error is zero, and at the middles of the edges.
    assert e == pytest.approx(np.einsum("ni,ij,nj->n", off, form, off), abs=1e-10 * scale)
    middle = 0.5 * (triangle + np.roll(triangle, -1, axis=0)) - c
    at_edges = e - np.einsum("ni,ij,nj->n", middle, form, middle)
    assert local.edge_error(triangle[None], form)[0] == pytest.approx(at_edges, abs=1e-10 * scale)


@given(TRIANGLE)
def test_error_of_a_round_form_is_half_the_squared_circumradius_or_that_of_the_longest_edge(t):
    assume(abs(local.area(t)) > 1e-2)
    sides = np.sort(np.linalg.norm(np.roll(t, -1, axis=0) - t, axis=1))
    radius = sides.prod() / (4 * abs(local.area(t)))
    acute = sides[2] ** 2 <= sides[0] ** 2 + sides[1] ** 2
    form = local.quadratic_form(np.eye(2))
    expected = 0.5 * radius**2 if acute else sides[2] ** 2 / 8
    assert local.largest_error(t[None], form)[0] == pytest.approx(expected, rel=1e-9)


@given(TRIANGLE, FORM)
def test_no_triangle_covers_more_per_error_than_the_optimal_shapes(triangle, form):
    assume(abs(local.area(triangle)) > 1e-2)
    assume(abs(np.linalg.det(form)) > 1e-2)
    best = math.sqrt(5) if np.linalg.det(form) < 0 else 3 * math.sqrt(3) / 4
    assert local.area_per_error(triangle[None], form)[0] <= best * (1 + 1e-9)


@given(FORM, st.integers(1, 6), st.floats(0.0, 6.28))
def test_optimal_shapes_stay_optimal_under_the_map_of_any_form(form, variant, theta):
    assume(abs(np.linalg.det(form)) > 1e-2)
    assume(abs(math.cos(2 * theta)) > 1e-2)
    values, vectors = np.linalg.eigh(form)
    order = np.argsort(-values)
    to_y = np.sqrt(np.abs(values[order]))[:, None] * vectors[:, order].T
    signature = 1 if values.prod() > 0 else -1
    triangle = optimal_triangle(signature, variant, theta) @ np.linalg.inv(to_y).T
    best = math.sqrt(5) if signature < 0 else 3 * math.sqrt(3) / 4
    assert local.area_per_error(triangle[None], form)[0] == pytest.approx(best, rel=1e-7)


@given(TRIANGLE, st.floats(-2.0, 2.0))
def test_a_boost_keeps_every_error_of_a_saddle(triangle, rapidity):
    form = np.diag([1.0, -1.0])
    moved = triangle @ boost(rapidity).T
    scale = float(np.abs(moved).max() ** 2)
    expected = local.edge_error(triangle[None], form)
    assert local.edge_error(moved[None], form) == pytest.approx(expected, abs=1e-12 * scale + 1e-12)


def test_coordinates_far_from_zero_keep_their_digits():
    triangle = np.array([[0.0, 0.0], [1.0, 0.25], [0.25, 1.0]])
    far = triangle + np.array([5e6, -4e6])
    form = np.array([[1.0, 0.25], [0.25, 2.0]])
    assert local.error_at_centre(far[None], form) == local.error_at_centre(triangle[None], form)
    shift = local.centre(far[None], form) - local.centre(triangle[None], form)
    assert shift[0] == pytest.approx([5e6, -4e6], abs=1e-8)


def test_a_form_for_each_triangle_and_one_for_all_agree():
    rng = np.random.default_rng(1)
    triangles, form = rng.normal(size=(7, 3, 2)), np.array([[2.0, 0.5], [0.5, 1.0]])
    many = np.broadcast_to(form, (7, 2, 2))
    for measure in (local.centre, local.error_at_centre, local.largest_error, local.area_per_error):
        assert np.array_equal(measure(triangles, form), measure(triangles, many))


def test_a_flat_triangle_has_the_error_of_its_edges():
    triangle = np.array([[[0.0, 0.0], [2.0, 0.0], [1.0, 0.0]]])
    assert local.largest_error(triangle, np.eye(2)) == pytest.approx([1.0])
    assert local.area_per_error(triangle, np.eye(2)) == pytest.approx([0.0])


@pytest.mark.parametrize("power", [2.5, 3.0, 4.0, 6.0])
def test_equidistribution_of_a_power_is_its_closed_form(power):
    # f = x^p: sqrt(f'') has the integral x^(p / 2), so the nodes are (i / n)^(2 / p).
    def density(x):
        return np.sqrt(0.5 * power * (power - 1.0) * x ** (power - 2.0))

    nodes = local.equidistribute(density, 0.0, 1.0, 20)
    assert nodes == pytest.approx((np.arange(21) / 20) ** (2 / power), abs=1e-11)


@given(st.floats(0.1, 8.0), st.integers(1, 60))
def test_equidistribution_of_an_exponential_is_its_closed_form(rate, n):
    nodes = local.equidistribute(lambda x: np.exp(rate * x), 1.0, -1.0, n)
    levels = np.linspace(math.exp(rate), math.exp(-rate), n + 1)
    assert nodes == pytest.approx(np.log(levels) / rate, abs=1e-10)


def test_equidistribution_levels_the_interpolation_errors():
    nodes = local.equidistribute(lambda x: np.sqrt(0.5 * np.exp(x)), 0.0, 4.0, 200)
    a, b = nodes[:-1], nodes[1:]
    t = a[:, None] + (b - a)[:, None] * np.linspace(0, 1, 201)
    chord = np.exp(a)[:, None] + (np.exp(b) - np.exp(a))[:, None] * np.linspace(0, 1, 201)
    errors = (chord - np.exp(t)).max(axis=1)
    total = math.sqrt(2.0) * (math.exp(2.0) - 1.0)
    assert errors == pytest.approx((total / 200) ** 2 / 4, rel=2e-4)


def test_equidistribution_crosses_kinks_and_gaps():
    def density(x):
        return np.where(np.abs(x) < 0.25, 0.0, np.abs(np.abs(x) - 0.25))

    nodes = local.equidistribute(density, -1.0, 1.0, 9)
    assert (np.diff(nodes) > 0).all()
    assert nodes == pytest.approx(-nodes[::-1], abs=1e-9)
    mass = np.sign(nodes) * np.maximum(np.abs(nodes) - 0.25, 0.0) ** 2
    assert np.diff(mass) == pytest.approx(2 * 0.75**2 / 9, abs=1e-9)


def test_a_density_of_zero_gives_equal_intervals():
    assert np.array_equal(local.equidistribute(np.zeros_like, 0.0, 2.0, 4), np.linspace(0, 2, 5))


def test_a_density_that_is_negative_or_not_finite_is_refused():
    for density in (lambda x: x, lambda x: 1.0 / x):
        with pytest.raises(InputError, match="nowhere below zero"), np.errstate(divide="ignore"):
            local.equidistribute(density, -1.0, 1.0, 4)
    with pytest.raises(InputError, match="at least one"):
        local.equidistribute(np.ones_like, 0.0, 1.0, 0)
