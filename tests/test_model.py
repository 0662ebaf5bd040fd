"""Errors by Hermite's formula: exact for quintics along edges, for cubics inside triangles."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.fields.dispatch import value as value_at
from equimesh.fields.function import Function
from equimesh.fields.kernel import KernelField
from equimesh.optimise.energy import edge_of, middle_of, set_jet
from equimesh.optimise.mesh import FREE, MODEL, Mesh, build
from equimesh.optimise.model import (
    climbed,
    edge_gradient,
    halved_edge,
    inner_gradient,
    mixed_inner,
    model_edge,
    model_inner,
    smooth_edge,
    smooth_inside,
)

seeds = st.integers(0, 2**32 - 1)
WAVES = Function("sin(5*x)*cos(4*y) + x*y").kernel(shapely.box(-1, -1, 1, 1), 1e-6)
QUARTIC = Function("x^4 + y^4").kernel(shapely.box(-1, -1, 1, 1), 1e-6)
BOWL = Function("2*x^2 + x*y + y^2").kernel(shapely.box(-1, -1, 1, 1), 1e-6)


def one_triangle(rng: np.random.Generator) -> Mesh:
    plane = rng.uniform(-1, 1, (3, 2))
    while abs(np.linalg.det(plane[1:] - plane[0])) < 0.1:
        plane = rng.uniform(-1, 1, (3, 2))
    if np.linalg.det(plane[1:] - plane[0]) < 0:
        plane = plane[::-1]
    return build(
        np.column_stack([plane, np.zeros(3)]), np.array([[0, 1, 2]]), np.full(3, FREE, np.int8),
        np.zeros(3, np.int64), np.zeros((1, 4)),
    )  # fmt: skip


Form = dict[tuple[int, int], float]  # the coefficient of x^i y^j under (i, j)


def form(rng: np.random.Generator, degree: int, least: int = 0) -> Form:
    """A polynomial with random terms of degree ``least`` to ``degree``."""
    orders = [(i, n - i) for n in range(least, degree + 1) for i in range(n + 1)]
    return dict(zip(orders, rng.normal(size=len(orders)), strict=True))


def value(c: Form, x, y):
    return sum(a * x**i * y**j for (i, j), a in c.items())


def slope(c: Form, axis: int) -> Form:
    """The polynomial's derivative by x (axis 0) or y (1)."""
    low = (1, 0) if axis == 0 else (0, 1)
    return {
        (i - low[0], j - low[1]): a * (i, j)[axis] for (i, j), a in c.items() if (i, j)[axis] > 0
    }


def lifted(m: Mesh, c: Form, heights: np.ndarray) -> None:
    """Vertices ``heights`` above the polynomial, with its derivatives."""
    x, y = m.x[:3], m.y[:3]
    fx, fy = slope(c, 0), slope(c, 1)
    parts = fx, fy, slope(fx, 0), slope(fx, 1), slope(fy, 1)
    m.jet[:3] = np.column_stack([value(part, x, y) * np.ones(3) for part in parts])
    m.w[:3] = heights
    m.z[:3] = value(c, x, y) + heights


def laid(field: KernelField, m: Mesh, heights: np.ndarray) -> None:
    """Vertices ``heights`` above a field, with its derivatives."""
    for v in range(3):
        z = set_jet(field, m, v, m.x[v], m.y[v])
        m.w[v], m.z[v] = heights[v], z + heights[v]


def error_at(field: KernelField, m: Mesh, weights: np.ndarray) -> np.ndarray:
    """Errors of the triangle at barycentric coordinates (n, 3)."""
    x, y = weights @ m.x[:3], weights @ m.y[:3]
    surface = np.array([value_at(field, *place) for place in zip(x, y, strict=True)])
    return surface - weights @ m.z[:3]


def weights_of(m: Mesh, x: float, y: float) -> np.ndarray:
    """Barycentric coordinates of a place."""
    return np.linalg.solve(np.vstack([m.x[:3], m.y[:3], np.ones(3)]), [x, y, 1.0])


def along_first_edge(m: Mesh, c: Form, t: np.ndarray) -> np.ndarray:
    """Error of the chord from vertex 0 to vertex 1 at shares ``t``."""
    x, y, z = m.x[:2], m.y[:2], m.z[:2]
    there = value(c, x[0] + t * (x[1] - x[0]), y[0] + t * (y[1] - y[0]))
    return np.asarray(there - z[0] - t * (z[1] - z[0]))


def peaks(errors: np.ndarray) -> np.ndarray:
    """Where samples have an extremum between the ends."""
    return 1 + np.flatnonzero((np.diff(errors[:-1]) > 0) != (np.diff(errors[1:]) > 0))


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_edges_are_exact_for_cubics_with_heights_at_their_ends(seed):
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 3)
    lifted(m, c, 0.1 * rng.normal(size=3))
    t = np.linspace(0, 1, 4001)
    errors = along_first_edge(m, c, t)
    e, s = model_edge(m, 0, 1)
    found = peaks(errors)
    if len(found):
        assert abs(e) == pytest.approx(np.abs(errors[found]).max(), abs=1e-6)
        assert np.interp(s, t, errors) == pytest.approx(e, abs=1e-6)
    else:
        assert e == 0.0 or abs(e) <= np.abs(errors[1:-1]).max() + 1e-9


@settings(max_examples=300, deadline=None)
@given(seeds, st.floats(0.05, 1.0))
def test_edges_follow_quintics_where_they_say_so(seed, size):
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 5)
    m.x[:3] *= size
    m.y[:3] *= size
    lifted(m, c, np.zeros(3))
    if not smooth_edge(m, 0, 1):
        return
    t = np.linspace(0, 1, 4001)
    errors = along_first_edge(m, c, t)
    e, s = model_edge(m, 0, 1)
    assert np.interp(s, t, errors) == pytest.approx(e, rel=1e-4, abs=1e-9)
    assert abs(e) == pytest.approx(np.abs(errors[peaks(errors)]).max(), rel=0.03)


@settings(max_examples=300, deadline=None)
@given(seeds, st.floats(0.05, 1.0), st.sampled_from([0.0, 0.01]), st.sampled_from([0, 1]))
@example(1705, 0.25, 0.01, 1)
def test_no_edge_has_less_error_than_in_its_middle(seed, size, height, model):
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    m.x[:3] *= size
    m.y[:3] *= size
    laid(WAVES, m, height * rng.normal(size=3))
    m.count[MODEL] = model
    middle, (most, _) = middle_of(WAVES, m, 1.0, 0, 1), edge_of(WAVES, m, 1.0, 0, 1)
    assert abs(middle) <= 1.01 * abs(most) + 1e-9
    true = error_at(WAVES, m, np.array([[0.5, 0.5, 0.0]]))[0]
    if middle != 0.0 and not (model and smooth_edge(m, 0, 1)):
        assert middle == pytest.approx(true, abs=1e-9)


@settings(max_examples=300, deadline=None)
@given(seeds, st.floats(0.1, 0.6))
def test_halves_of_edges_follow_waves_where_they_say_so(seed, size):
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    m.x[:3] *= size
    m.y[:3] *= size
    laid(WAVES, m, 0.01 * rng.normal(size=3))
    e, s = halved_edge(WAVES, m, 0, 1)
    if math.isnan(e):
        return
    t = np.linspace(0, 1, 2001)
    errors = error_at(WAVES, m, np.stack([1 - t, t, 0 * t], 1))
    most = np.abs(errors - np.interp(t, [0, 1], errors[[0, -1]])).max()  # without the heights
    if e != 0.0:
        assert np.interp(s, t, errors) == pytest.approx(e, abs=0.02 * most)
    if len(found := peaks(errors)):
        assert abs(e) == pytest.approx(np.abs(errors[found]).max(), abs=0.03 * most)


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_gradients_are_exact_for_quartics_along_edges_and_cubics_inside(seed):
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 4)
    lifted(m, c, np.zeros(3))
    s = rng.uniform()
    x, y = m.x[0] + s * (m.x[1] - m.x[0]), m.y[0] + s * (m.y[1] - m.y[0])
    expected = [value(slope(c, axis), x, y) for axis in range(2)]
    assert edge_gradient(m, 0, 1, s) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    c = form(rng, 3)
    lifted(m, c, np.zeros(3))
    x, y = rng.dirichlet(np.ones(3)) @ np.stack([m.x[:3], m.y[:3]], 1)
    expected = [value(slope(c, axis), x, y) for axis in range(2)]
    assert inner_gradient(m, 0, 1, 2, x, y) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_insides_are_exact_for_quadratics_with_heights_at_their_corners(seed):
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 2)
    lifted(m, c, 0.1 * rng.normal(size=3))
    x, y, z = m.x[:3], m.y[:3], m.z[:3]
    e, px, py = model_inner(m, 0, 1, 2)
    hessian = np.array([[2 * c[2, 0], c[1, 1]], [c[1, 1], 2 * c[0, 2]]])
    tilt = np.linalg.solve(np.stack([x[1:] - x[0], y[1:] - y[0]], 1), z[1:] - z[0])
    place = np.linalg.solve(hessian, tilt - [c[1, 0], c[0, 1]])
    weights = np.linalg.solve(np.vstack([x, y, np.ones(3)]), [*place, 1.0])
    if np.linalg.det(hessian) > 1e-3 and weights.min() > 1e-9:
        plane = z[0] + tilt @ (place - [x[0], y[0]])
        assert e == pytest.approx(value(c, *place) - plane, rel=1e-9, abs=1e-12)
        assert [px, py] == pytest.approx(place, abs=1e-7)
    elif np.linalg.det(hessian) < 0 or weights.min() < -1e-9:
        assert e == 0.0


@settings(max_examples=200, deadline=None)
@given(seeds, st.sampled_from([0.4, 0.2, 0.1]))
def test_insides_approach_the_true_peak_with_the_fourth_power_of_their_size(seed, size):
    """Against a bowl's error 1 the third derivatives are of order h, what is left of order h^2."""
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 4, least=3)
    c[2, 0], c[1, 1], c[0, 2] = 2.0, rng.uniform(-1, 1), 1.5
    m.x[:3], m.y[:3] = size * m.x[:3], size * m.y[:3]
    lifted(m, c, np.zeros(3))
    if not smooth_inside(m, 0, 1, 2):
        return
    e, px, py = model_inner(m, 0, 1, 2)
    if e == 0.0:
        return
    corners = np.stack([m.x[:3], m.y[:3], m.z[:3]], 1)
    weights = np.linalg.solve(np.vstack([corners[:, :2].T, np.ones(3)]), [px, py, 1.0])
    assert e == pytest.approx(value(c, px, py) - weights @ corners[:, 2], abs=size**4)


@settings(max_examples=300, deadline=None)
@given(seeds)
def test_insides_across_a_change_of_sign_are_exact_for_cubics_where_they_say(seed):
    rng = np.random.default_rng(seed)
    m, c = one_triangle(rng), form(rng, 3)
    lifted(m, c, 0.1 * rng.normal(size=3))
    e, x, y = mixed_inner(m, 0, 1, 2, 0.0)
    weights = weights_of(m, x, y)
    assert weights.min() > -1e-9
    if e != 0.0:
        assert e == pytest.approx(value(c, x, y) - weights @ m.z[:3], rel=1e-7, abs=1e-9)
        middle = np.full(3, 1 / 3)
        at_middle = value(c, middle @ m.x[:3], middle @ m.y[:3]) - middle @ m.z[:3]
        assert abs(e) >= abs(at_middle) * (1 - 1e-9)


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_one_step_leads_to_the_peak_of_a_quadratic(seed):
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    laid(BOWL, m, np.zeros(3))
    hessian = np.array([[4.0, 1.0], [1.0, 2.0]])
    corners = np.stack([m.x[:3], m.y[:3]], 1)
    tilt = np.linalg.solve(corners[1:] - corners[0], m.z[1:3] - m.z[0])
    peak = np.linalg.solve(hessian, tilt)
    at_peak, start = weights_of(m, *peak), rng.dirichlet(np.ones(3))
    if at_peak.min() > 0.0:
        start = 0.7 * at_peak + 0.3 * start  # as near as a first guess leads
    e, x, y = climbed(BOWL, m, 0, 1, 2, *(start @ corners))
    if at_peak.min() > 1e-6:
        assert [x, y] == pytest.approx(list(peak), abs=1e-6)
        assert e == pytest.approx(error_at(BOWL, m, at_peak[None])[0], rel=1e-6)
    elif at_peak.min() < -1e-6:
        assert [x, y] == pytest.approx(list(start @ corners))
        assert e == pytest.approx(error_at(BOWL, m, start[None])[0], rel=1e-9, abs=1e-12)


def test_smooth_edges_are_so_whatever_their_size_and_sign():
    m = one_triangle(np.random.default_rng(0))
    for scale in (1e-9, 1.0, -1e9):
        lifted(m, {(2, 0): scale, (3, 0): 0.2 * scale, (0, 2): scale}, np.zeros(3))
        assert smooth_edge(m, 0, 1)
        m.z[1] += scale  # a step between flat ends
        m.jet[:2] = 0.0
        assert not smooth_edge(m, 0, 1)


def test_triangles_across_a_change_of_sign_are_not_smooth():
    m = one_triangle(np.random.default_rng(0))
    for bends, expected in (((1, 1, 1), True), ((-1, -1, -1), True), ((1, 1, -1), False)):
        m.jet[:3] = [
            [x, bend * y, 1, 0, bend] for x, y, bend in zip(m.x[:3], m.y[:3], bends, strict=True)
        ]
        assert smooth_inside(m, 0, 1, 2) == expected


@settings(max_examples=300, deadline=None)
@given(seeds)
@example(1302)
def test_insides_are_smooth_only_where_nothing_vanishes_between_their_corners(seed):
    """Across x = 0 the Hessian of x^4 + y^4 is alike at the corners and singular between them."""
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    m.x[:3], m.y[:3] = 0.1 * m.x[:3], 0.8 + 0.02 * m.y[:3]
    laid(QUARTIC, m, np.zeros(3))
    if not smooth_inside(m, 0, 1, 2):
        return
    e, x, y = model_inner(m, 0, 1, 2)
    if e != 0.0:
        assert e == pytest.approx(error_at(QUARTIC, m, weights_of(m, x, y)[None])[0], rel=0.05)
        shares = np.linspace(0.025, 0.95, 38)
        u, v = (a.ravel() for a in np.meshgrid(shares, shares))
        sampled = np.stack([u, v, 1 - u - v], 1)[u + v < 1]
        assert np.abs(error_at(QUARTIC, m, sampled)).max() <= 1.05 * abs(e)


def test_a_paraboloid_needs_half_the_triangles_if_vertices_may_leave_it():
    runs = [
        equimesh.remesh("x^2 + y^2", 2e-3, (0, 0, 1, 1), fit=fit, effort="fast")
        for fit in ("interpolate", "best")
    ]
    assert all(run.status.ok and run.profile.bound <= 2e-3 for run in runs)
    assert len(runs[1].triangles) < 0.62 * len(runs[0].triangles)
    on, beside = (run.points[:, 2] - (run.points[:, :2] ** 2).sum(1) for run in runs)
    assert np.abs(on).max() < 1e-12
    assert beside.max() <= 2e-3
    assert beside.mean() < -1e-3  # chords lie above a convex surface, so vertices go below


def test_vertices_on_a_plane_stay_there():
    result = equimesh.remesh("3*x - y", 1e-3, (0, 0, 1, 1), fit="best", effort="fast")
    assert len(result.triangles) == 2
