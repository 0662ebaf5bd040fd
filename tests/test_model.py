"""Errors by Hermite's formula: exact for quintics along edges, for cubics inside triangles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.optimise.mesh import FREE, Mesh, build
from equimesh.optimise.model import (
    edge_gradient,
    inner_gradient,
    model_edge,
    model_inner,
    smooth_edge,
    smooth_inside,
)

seeds = st.integers(0, 2**32 - 1)


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
        m.jet[:3] = [[0, 0, 1, 0, bend] for bend in bends]
        assert smooth_inside(m, 0, 1, 2) == expected


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
