"""Functions as piecewise polynomials, and the errors that compiled kernels find on them."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyder, polyval2d
from surfaces import FRANKE

from equimesh.errors import InputError
from equimesh.expression import parse
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.fields.patch_kernels import (
    derivatives2,
    derivatives3,
    edge_error,
    gradient,
    inner_error,
    value,
)
from equimesh.fields.patches import fit_patches

SEEDS = st.integers(0, 2**32 - 1)
SQUARE = shapely.box(-1, -1, 1, 1)
TEXTS = ["exp(3*x)*sin(3*y)", "1/(x**2+y**2+1/4)", "tanh(8*(x-y**2))", FRANKE]


def field_of(f, tol, domain=SQUARE):
    p = fit_patches(f, domain, tol)
    return KernelField(PATCHES, frame=p.frame, child=p.child, coef=p.coef, kinks=p.kinks)


def polynomial(seed, degree=5):
    """A random polynomial, which patches of degree 7 hold exactly, as field and coefficients."""
    c = np.random.default_rng(seed).normal(size=(degree + 1, degree + 1))
    return field_of(lambda x, y: polyval2d(x, y, c), 1e-9), c


def sample(n, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (2, n))


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("tol", [1e-3, 1e-6])
def test_values_are_within_the_tolerance(text, tol):
    f = parse(text).value
    field = field_of(f, tol)
    x, y = sample(3000)
    ours = np.array([value(field, *p) for p in zip(x, y, strict=True)])
    assert np.abs(ours - f(x, y)).max() <= tol


@pytest.mark.parametrize("text", TEXTS)
def test_derivatives_close_in_on_those_of_the_function(text):
    expression = parse(text)
    x, y = sample(500)
    h, t = expression.hessian(x, y), expression.third(x, y)
    exact = np.column_stack([h[:, 0, 0], h[:, 0, 1], h[:, 1, 1], t])
    scale = np.abs(exact).max(0)
    gaps = []
    for tol in (1e-4, 1e-7, 1e-10):
        field = field_of(expression.value, tol)
        ours = [
            derivatives3(field.frame, field.child, field.coef, *p) for p in zip(x, y, strict=True)
        ]
        gaps.append((np.abs(np.array(ours) - exact) / scale).max())
    # A cell's third derivatives lose three powers of its width, values have eight.
    assert gaps[1] <= gaps[0] * (1e-3 ** (5 / 8)) * 5
    assert gaps[2] <= gaps[1] * (1e-3 ** (5 / 8)) * 5
    assert gaps[2] <= 1e-4


@given(SEEDS)
@example(0)
def test_polynomials_are_held_with_all_their_derivatives(seed):
    field, c = polynomial(seed, 7)
    args = field.frame, field.child, field.coef
    for x, y in sample(10, seed).T:
        exact = {
            (i, j): float(polyval2d(x, y, polyder(polyder(c, i, axis=0), j, axis=1)))
            for i in range(4)
            for j in range(4 - i)
        }
        first = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
        last = [(2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]
        assert value(field, x, y) == pytest.approx(exact[0, 0], abs=1e-10)
        assert gradient(field, x, y) == pytest.approx([exact[1, 0], exact[0, 1]], abs=1e-9)
        assert derivatives2(*args, x, y) == pytest.approx([exact[k] for k in first], abs=1e-8)
        assert derivatives3(*args, x, y) == pytest.approx([exact[k] for k in last], abs=1e-6)


def test_cells_are_small_only_along_a_layer():
    # A layer four times as thin has four times as many cells along it, not sixteen times.
    count = [
        len(fit_patches(lambda x, y, k=k: np.tanh(k * x) + 0 * y, SQUARE, 1e-6).coef)
        for k in (1, 30, 120)
    ]
    assert count[0] <= 16
    assert 3 * count[1] < count[2] < 7 * count[1]


def test_a_jump_is_no_kink():
    jump = fit_patches(lambda x, y: (x > 0.3) * 1.0, SQUARE, 1e-6, max_depth=7)
    assert np.isfinite(jump.coef).all()
    assert jump.smooth == len(jump.coef)  # no kink: nothing is gained by a close look at it
    assert not jump.kinks.any()


def test_a_function_that_ends_at_the_outline_is_fitted_inside():
    angle = 2 * math.pi * np.arange(24) / 24
    disc = shapely.Polygon(0.98 * np.stack([np.cos(angle), np.sin(angle)], 1))

    def dome(x, y):
        return np.sqrt(1 - x * x - y * y)

    with np.errstate(invalid="ignore"):
        field = field_of(dome, 1e-6, disc)
    x, y = sample(3000)
    inside = shapely.contains_xy(disc, x, y)
    ours = np.array([value(field, *p) for p in zip(x[inside], y[inside], strict=True)])
    assert np.abs(ours - dome(x[inside], y[inside])).max() <= 1e-5


def test_a_hole_in_the_function_inside_the_domain_is_named():
    def holed(x, y):
        return np.where(np.hypot(x - 0.3, y + 0.2) < 0.1, np.nan, x)

    with pytest.raises(InputError, match="not finite at"):
        fit_patches(holed, SQUARE, 1e-6)


def lifted(field, points):
    return np.column_stack([points, [value(field, *p) for p in points]])


@given(SEEDS)
@example(0)
def test_errors_of_edges_are_those_of_dense_samples(seed):
    rng = np.random.default_rng(seed)
    field, c = polynomial(seed)
    s = np.linspace(0, 1, 2001)
    for _ in range(12):
        a, b = lifted(field, rng.uniform(-1, 1, (2, 2)) * rng.uniform(0.05, 0.6))
        e, place = edge_error(field, *a, *b, math.inf)
        p = a + s[:, None] * (b - a)
        exact = polyval2d(p[:, 0], p[:, 1], c) - p[:, 2]
        worst = np.abs(exact).max()
        assert abs(e) <= worst * (1 + 1e-5) + 1e-12
        assert abs(e) >= 0.985 * worst - 1e-12
        # The error is that of the point at which it is said to lie, sign included.
        x, y, z = a + place * (b - a)
        assert e == pytest.approx(float(polyval2d(x, y, c)) - z, abs=1e-10)
        back, there = edge_error(field, *b, *a, math.inf)
        assert back == pytest.approx(e, abs=0.015 * worst + 1e-12)
        assert abs(there - (1 - place)) < 0.1 or abs(abs(back) - abs(e)) < 0.015 * worst + 1e-12


@given(SEEDS)
@example(0)
def test_errors_inside_triangles_are_those_of_dense_samples(seed):
    rng = np.random.default_rng(seed)
    field, c = polynomial(seed, 3)
    i, j = np.meshgrid(np.arange(61), np.arange(61), indexing="ij")
    weights = np.stack([60 - i - j, i, j], -1)[i + j <= 60] / 60
    for _ in range(12):
        corners = 0.4 * rng.uniform(-1, 1, (3, 2)) + rng.uniform(-0.5, 0.5, 2)
        u, v = corners[1] - corners[0], corners[2] - corners[0]
        if u[0] * v[1] < u[1] * v[0]:
            corners = corners[::-1]
        a, b, d = lifted(field, corners)
        e, x, y = inner_error(field, *a, *b, *d, math.inf)
        edges = [abs(edge_error(field, *p, *q, math.inf)[0]) for p, q in ((a, b), (b, d), (d, a))]
        p = weights @ np.stack([a, b, d])
        worst = np.abs(polyval2d(p[:, 0], p[:, 1], c) - p[:, 2]).max()
        assert max(*edges, abs(e)) >= 0.97 * worst - 1e-12
        assert max(*edges, abs(e)) <= 1.01 * worst + 1e-12
        if e != 0.0:
            share = np.linalg.solve(np.stack([a, b, d])[:, :2].T @ [[-1, -1], [1, 0], [0, 1]],
                                    np.array([x, y]) - a[:2])  # fmt: skip
            assert share.min() >= -1e-9
            assert share.sum() <= 1 + 1e-9
            plane = a[2] + share @ [b[2] - a[2], d[2] - a[2]]
            assert e == pytest.approx(float(polyval2d(x, y, c)) - plane, abs=1e-9)


def test_a_saddle_has_no_error_inside_beyond_its_edges():
    field = field_of(parse("x*y+x**2/3-y**2/2").value, 1e-9)
    a, b, c = lifted(field, np.array([[-0.5, -0.4], [0.6, -0.3], [0.1, 0.7]]))
    assert inner_error(field, *a, *b, *c, math.inf)[0] == 0.0


@pytest.mark.parametrize("size", [0.1, 0.5])
def test_the_optimal_convex_triangle_has_half_its_circumradius_squared_inside(size):
    field = field_of(parse("(x**2+y**2)/2").value, 1e-9)
    angle = 0.3 + 2 * math.pi * np.arange(3) / 3
    a, b, c = lifted(field, size * np.stack([np.cos(angle), np.sin(angle)], 1))
    e, x, y = inner_error(field, *a, *b, *c, math.inf)
    assert e == pytest.approx(-(size**2) / 2, rel=1e-12)
    assert (x, y) == pytest.approx((0, 0), abs=1e-12)
    assert edge_error(field, *a, *b, math.inf)[0] == pytest.approx(-3 * size**2 / 8, rel=1e-12)


def test_two_peaks_of_opposite_sign_on_an_edge_are_both_seen():
    # x**3 on an edge whose middle is a little off the inflection: unequal peaks.
    field = field_of(parse("x**3").value, 1e-9)
    for shift in (-0.02, 0.0, 0.02):
        a, b = lifted(field, np.array([[-0.5 + shift, 0.0], [0.5 + shift, 0.2]]))
        s = np.linspace(0, 1, 4001)
        exact = np.abs((a[0] + s) ** 3 - (a[2] + s * (b[2] - a[2]))).max()
        assert abs(edge_error(field, *a, *b, math.inf)[0]) == pytest.approx(exact, rel=5e-3)
