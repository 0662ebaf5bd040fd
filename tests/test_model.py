"""Errors by Taylor's formula: exact for cubics along edges and quadratics inside triangles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.optimise.mesh import FREE, Mesh, build
from equimesh.optimise.model import alike, model_edge, model_inner

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


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_edges_are_exact_for_cubics_with_heights_at_their_ends(seed):
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    c = rng.normal(size=4)  # a cubic form
    m.w[:3] = 0.1 * rng.normal(size=3)
    x, y = m.x[:3], m.y[:3]
    m.h[:3] = np.column_stack(
        [6 * c[0] * x + 2 * c[1] * y, 2 * c[1] * x + 2 * c[2] * y, 2 * c[2] * x + 6 * c[3] * y]
    )

    def f(x, y):
        return c[0] * x**3 + c[1] * x * x * y + c[2] * x * y * y + c[3] * y**3

    e, s = model_edge(m, 0, 1)
    t = np.linspace(0, 1, 4001)
    z = f(x, y) + m.w[:3]
    errors = f(x[0] + t * (x[1] - x[0]), y[0] + t * (y[1] - y[0])) - z[0] - t * (z[1] - z[0])
    inner = errors[1:-1]
    turns = np.flatnonzero((np.diff(errors[:-1]) > 0) != (np.diff(errors[1:]) > 0))
    if len(turns):  # the largest of the extrema between the ends
        assert abs(e) == pytest.approx(np.abs(errors[turns + 1]).max(), abs=1e-6)
        assert np.interp(s, t, errors) == pytest.approx(e, abs=1e-6)
    else:
        assert e == 0.0 or abs(e) <= np.abs(inner).max() + 1e-9


@settings(max_examples=200, deadline=None)
@given(seeds)
def test_insides_are_exact_for_quadratics_with_heights_at_their_corners(seed):
    rng = np.random.default_rng(seed)
    m = one_triangle(rng)
    h = rng.normal(size=3)
    m.h[:3] = h
    m.w[:3] = 0.1 * rng.normal(size=3)
    x, y = m.x[:3], m.y[:3]
    z = 0.5 * (h[0] * x * x + 2 * h[1] * x * y + h[2] * y * y) + m.w[:3]
    e, px, py = model_inner(m, 0, 1, 2)
    hessian = np.array([[h[0], h[1]], [h[1], h[2]]])
    slope = np.linalg.solve(np.stack([x[1:] - x[0], y[1:] - y[0]], 1), z[1:] - z[0])
    place = np.linalg.solve(hessian, slope)
    weights = np.linalg.solve(np.vstack([x, y, np.ones(3)]), [*place, 1.0])
    if np.linalg.det(hessian) > 1e-3 and weights.min() > 1e-9:
        plane = z[0] + slope @ (place - [x[0], y[0]])
        assert e == pytest.approx(0.5 * place @ hessian @ place - plane, rel=1e-9, abs=1e-12)
        assert [px, py] == pytest.approx(place, abs=1e-7)
    elif np.linalg.det(hessian) < 0 or weights.min() < -1e-9:
        assert e == 0.0


def test_second_derivatives_are_alike_whatever_their_size_and_sign():
    m = one_triangle(np.random.default_rng(0))
    for scale in (1e-9, 1.0, -1e9):
        m.h[0], m.h[1] = [scale, 0, scale], [1.1 * scale, 0, 0.95 * scale]
        assert alike(m, 0, 1)
        m.h[1] = [-scale, 0, scale]
        assert not alike(m, 0, 1)


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
