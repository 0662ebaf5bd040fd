"""Section 3: the flat-space transform against closed forms, on every kind of domain."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from equimesh.errors import InputError
from equimesh.transform import FlatMap
from equimesh.transport import christoffel, harmonic_christoffel

ROOT_5 = 5**0.5
SQUARE = (0.0, 0.0, 1.0, 1.0)
HOLED = shapely.Polygon(
    [(0, 0), (1, 0), (1, 1), (0, 1)], [[(0.3, 0.3), (0.6, 0.35), (0.55, 0.7), (0.3, 0.6)]]
)
L_SHAPE = shapely.Polygon([(0, 0), (1, 0), (1, 0.3), (0.4, 0.3), (0.4, 1), (0, 1)])
# The L-shaped path of (14), (15) leaves it for most targets.
COMB = shapely.Polygon(
    np.array(
        [0, 0, 10, 0, 10, 10, 9, 10, 9, 1, 6, 1, 6, 10, 5, 10, 5, 1, 1, 1, 1, 10, 0, 10]
    ).reshape(-1, 2)
    / 10
)

EXAMPLES = {
    1: "exp(5*x)*sin(5*y)",
    2: "((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2",
    3: "(((x-1/2)**2+(y+1/5)**2)**2-8*(x-1/2)**2*(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**4",
    4: "((x-1/2)**2-(sqrt(5)*y+1/5)**2)/((x-1/2)**2+(sqrt(5)*y+1/5)**2)**2",
}
# Example 4 is not conformal: its closed form has the eigenvectors' axes only on x = 1/2.
ORIGINS = {1: (0.0, 0.0), 2: (0.25, 0.5), 3: (0.75, 0.25), 4: (0.5, 0.0)}
FRANKE = (
    "0.75*exp(-((9*x-2)**2+(9*y-2)**2)/4)+0.75*exp(-(9*x+1)**2/49-(9*y+1)/10)"
    "+0.5*exp(-((9*x-7)**2+(9*y-3)**2)/4)-0.2*exp(-(9*x-4)**2-(9*y-7)**2)"
)


@dataclass(frozen=True)
class Holomorphic:
    """f(x, y) = Re F(x + w y), from the second and third derivatives of F."""

    second: Callable
    third_: Callable
    w: complex = 1j

    def hessian(self, x, y):
        d = self.second(x + self.w * y)
        xx, xy, yy = d.real, (d * self.w).real, (d * self.w**2).real
        return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)

    def third(self, x, y):
        d = self.third_(x + self.w * y)
        return np.stack([(d * self.w**i).real for i in range(4)], axis=-1)


@dataclass(frozen=True)
class Waves:
    """f(x, y) = sum of F(a x + b y), from (a, b, F'', F''')."""

    terms: tuple[tuple[float, float, Callable, Callable], ...]

    def hessian(self, x, y):
        outer = np.multiply.outer
        return sum(outer(f(a * x + b * y), outer([a, b], [a, b])) for a, b, f, _ in self.terms)

    def third(self, x, y):
        outer = np.multiply.outer
        powers = [[a**3, a * a * b, a * b * b, b**3] for a, b, _, _ in self.terms]
        return sum(
            outer(t[3](t[0] * x + t[1] * y), p) for t, p in zip(self.terms, powers, strict=True)
        )


def closed_form(example, x, y):
    """(2, n) the paper's (y1, y2)."""
    if example == 1:
        e = 2 / 2**0.5 * np.exp(2.5 * x)
        c, s = np.cos(2.5 * y), np.sin(2.5 * y)
        return np.stack([e * (c + s) - 2 / 2**0.5, e * (c - s) - 2 / 2**0.5])
    u, v = x - 0.5, (ROOT_5 if example == 4 else 1.0) * y + 0.2
    r = u * u + v * v
    if example == 3:
        return np.stack([ROOT_5 * (1 + (v * v - u * u) / r**2), 2 * ROOT_5 * u * v / r**2])
    return 6**0.5 * np.stack([1 - u / r, v / r])


def difference_up_to_axes(ours, theirs):
    """Largest difference over the size, up to constants and the sign and order of the axes."""
    size = np.ptp(theirs, axis=1).max()
    best = math.inf
    for order, signs in itertools.product(([0, 1], [1, 0]), itertools.product([1, -1], repeat=2)):
        gap = theirs[order] * np.array(signs)[:, None] - ours
        best = min(best, np.abs(gap - gap[:, :1]).max() / size)
    return best


def points_in(domain, n, seed=0):
    """(2, n) random points of a domain."""
    rng = np.random.default_rng(seed)
    polygon = domain if isinstance(domain, shapely.Polygon) else shapely.box(*domain)
    xmin, ymin, xmax, ymax = polygon.bounds
    x, y = rng.uniform(xmin, xmax, 8 * n), rng.uniform(ymin, ymax, 8 * n)
    inside = np.flatnonzero(shapely.contains_xy(polygon, x, y))[:n]
    return np.stack([x[inside], y[inside]])


def metric_defect(flat_map, source, points):
    """Largest relative difference of dy1^2 + eps dy2^2 from the Hessian's form."""
    jacobian = flat_map.jacobian(*points)
    pulled = np.einsum("nki,k,nkj->nij", jacobian, [1.0, flat_map.signature], jacobian)
    hessian = source.hessian(*points)
    if flat_map.signature > 0:
        hessian = hessian * np.sign(hessian[:, :1, :1])
    # In the frame of y the form is diag(1, eps) whatever the units of x.
    back = np.linalg.inv(jacobian)
    form = back.transpose(0, 2, 1) @ hessian @ back
    direct = np.abs(pulled - hessian).max(axis=(1, 2)) / np.abs(hessian).max(axis=(1, 2))
    return max(np.abs(form - np.diag([1.0, flat_map.signature])).max(), direct.max())


@pytest.mark.parametrize("example", EXAMPLES)
def test_forward_is_the_closed_form_of_the_paper_and_inverse_undoes_it(example):
    flat_map = FlatMap(EXAMPLES[example], SQUARE, origin=ORIGINS[example])
    points = points_in(SQUARE, 10_000)
    image = np.stack(flat_map.forward(*points))
    assert difference_up_to_axes(image, closed_form(example, *points)) <= 1e-12
    assert np.abs(np.stack(flat_map.inverse(*image)) - points).max() <= 1e-11
    assert flat_map.signature == -1
    assert flat_map.flatness.flat
    assert flat_map.flatness.gamma <= 1e-11
    assert flat_map.residual <= 1e-12


CALLABLES = {
    1: lambda x, y: np.exp(5 * x) * np.sin(5 * y),
    2: lambda x, y: (1 / (x - 0.5 + 1j * (y + 0.2)) ** 2).real,
    3: lambda x, y: (1 / (x - 0.5 + 1j * (y + 0.2)) ** 4).real,
    4: lambda x, y: (1 / (x - 0.5 + 1j * (ROOT_5 * y + 0.2)) ** 2).real,
}


@pytest.mark.parametrize("example", CALLABLES)
def test_a_bare_callable_has_the_closed_form_too(example):
    flat_map = FlatMap(CALLABLES[example], SQUARE, origin=ORIGINS[example])
    points = points_in(SQUARE, 2000)
    image = np.stack(flat_map.forward(*points))
    assert difference_up_to_axes(image, closed_form(example, *points)) <= 1e-8
    assert np.abs(np.stack(flat_map.inverse(*image)) - points).max() <= 1e-9
    assert flat_map.flatness.flat
    assert flat_map.residual <= 1e-6


def test_a_callable_may_be_singular_in_a_hole_but_not_rough_in_the_domain():
    ring = shapely.Point(0, 0).buffer(1.0).difference(shapely.Point(0, 0).buffer(0.4))
    flat_map = FlatMap(lambda x, y: 1.0 / (x * x + y * y), ring)
    # Homogeneous: y runs along a cone, so its values differ around the hole.
    assert flat_map.flatness.cause == "hole"
    assert flat_map.flatness.share < 1e-6
    assert flat_map.residual > 1e-2
    half = ring.intersection(shapely.box(-1, 0, 1, 1))
    assert FlatMap(lambda x, y: 1.0 / (x * x + y * y), half).flatness.flat
    with pytest.raises(InputError, match="three derivatives"):
        FlatMap(lambda x, y: np.abs(x - 0.3) - y * y, SQUARE)


@pytest.mark.parametrize("example", EXAMPLES)
@pytest.mark.parametrize("domain", [HOLED, L_SHAPE, COMB], ids=["hole", "L", "comb"])
def test_polygons_have_the_transform_of_the_square(example, domain):
    origin = (0.05, 0.05) if example != 4 else (0.5, 0.05)
    flat_map = FlatMap(EXAMPLES[example], domain, origin=origin)
    points = points_in(domain, 3000)
    image = np.stack(flat_map.forward(*points))
    assert difference_up_to_axes(image, closed_form(example, *points)) <= 1e-12
    assert np.abs(np.stack(flat_map.inverse(*image)) - points).max() <= 1e-11
    assert flat_map.residual <= 1e-12


@pytest.mark.parametrize("domain", [HOLED, L_SHAPE], ids=["hole", "L"])
def test_points_outside_the_domain_or_its_image_are_nan(domain):
    whole, part = FlatMap(EXAMPLES[2], SQUARE), FlatMap(EXAMPLES[2], domain, origin=(0.1, 0.1))
    points = points_in(SQUARE, 4000, seed=3)
    inside = shapely.contains_xy(domain, *points)
    assert np.array_equal(np.isnan(part.forward(*points)[0]), ~inside)
    assert np.array_equal(np.isnan(part.jacobian(*points)).any(axis=(1, 2)), ~inside)
    # The image of a point outside, in the part's own coordinates: both maps are conformal.
    here, there = (np.stack(m.forward(*points[:, inside])) for m in (whole, part))
    scale = np.sign(((here - here[:, :1]) * (there - there[:, :1])).sum(axis=1))[:, None]
    shift = there[:, :1] - scale * here[:, :1]
    assert scale * here + shift == pytest.approx(there, abs=1e-10)
    x, y = part.inverse(*(scale * np.stack(whole.forward(*points)) + shift))
    assert np.array_equal(np.isnan(x), ~inside)
    assert np.array_equal(np.isnan(y), ~inside)


def test_inverse_of_corners_edges_and_far_away():
    flat_map = FlatMap(EXAMPLES[1], SQUARE)
    t = np.linspace(0.0, 1.0, 101)
    for x, y in ((t, 0 * t), (t, 0 * t + 1), (0 * t, t), (0 * t + 1, t)):
        back = np.stack(flat_map.inverse(*flat_map.forward(x, y)))
        assert np.abs(back - [x, y]).max() <= 1e-11
    y1, y2 = flat_map.forward(t, 0 * t)
    x, _ = flat_map.inverse(np.array([1e6, np.nan, y1[3]]), np.array([0.0, 0.0, y2[3]]))
    assert np.isnan(x[:2]).all()
    assert x[2] == pytest.approx(t[3])


def test_shapes_of_arguments_are_kept():
    flat_map = FlatMap("x**2+3*y**2", SQUARE)
    x, y = np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 30))
    y1, y2 = flat_map.forward(x, y)
    assert y1.shape == y2.shape == (30, 40)
    assert flat_map.inverse(y1, y2)[0] == pytest.approx(x, abs=1e-12)
    assert flat_map.forward(0.5, 0.5)[0].shape == ()
    assert flat_map.forward([], [])[0].shape == (0,)
    assert flat_map.inverse([], [])[0].shape == (0,)


@pytest.mark.parametrize("example", [1, 2, 3, 4])
def test_the_net_of_paths_and_the_l_shaped_path_agree(example):
    flat_map = FlatMap(EXAMPLES[example], SQUARE)
    a, b = flat_map.origin
    for x, y in points_in(SQUARE, 5, seed=7).T:
        here = np.array(flat_map.forward(x, y))
        jacobian = flat_map.jacobian(x, y)[0]
        size = np.abs(jacobian).max()
        for path in ([(x, b), (x, y)], [(a, y), (x, y)], [(x, y)]):
            image, carried = flat_map.along(path)
            assert image == pytest.approx(here, abs=1e-11 * (1 + np.abs(here).max()))
            assert carried == pytest.approx(jacobian, abs=1e-11 * size)


@pytest.mark.parametrize("example", [1, 2, 3])
def test_the_harmonic_short_form_13_is_12(example):
    flat_map = FlatMap(EXAMPLES[example], SQUARE)
    for x, y in points_in(SQUARE, 4, seed=8).T:
        path = [(x, flat_map.origin[1]), (x, y)]
        general, short = flat_map.along(path), flat_map.along(path, harmonic_christoffel)
        assert short[0] == pytest.approx(general[0], rel=1e-10, abs=1e-11)
        assert short[1] == pytest.approx(general[1], rel=1e-10, abs=1e-10)


def test_christoffel_symbols_are_those_printed():
    rng = np.random.default_rng(5)
    g11, g12, g22 = rng.normal(size=3)
    g111, g112, g122, g222 = rng.normal(size=4)
    twice = 2 * (g11 * g22 - g12**2)
    printed = {
        (1, 1, 1): (g22 * g111 - g12 * g112) / twice,
        (2, 1, 1): (g11 * g112 - g12 * g111) / twice,
        (1, 1, 2): (g22 * g112 - g12 * g122) / twice,
        (1, 2, 2): (g22 * g122 - g12 * g222) / twice,
        (2, 2, 2): (g11 * g222 - g12 * g122) / twice,
        (2, 1, 2): (g11 * g122 - g12 * g112) / twice,
    }
    hessian = np.array([[[g11, g12], [g12, g22]]])
    third = np.array([[g111, g112, g122, g222]])
    for i, step in ((1, [[1.0, 0.0]]), (2, [[0.0, 1.0]])):
        matrix = christoffel(hessian, third, np.array(step))[0]
        for k, j in itertools.product((1, 2), repeat=2):
            assert matrix[k - 1, j - 1] == pytest.approx(printed[k, min(i, j), max(i, j)])


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_quadratics_are_flat(entries):
    a, b, c = (round(v, 2) for v in entries)
    assume(abs(4 * a * c - b * b) > 0.05)
    source = f"({a})*x**2+({b})*x*y+({c})*y**2+x-2*y"
    flat_map = FlatMap(source, HOLED)
    assert flat_map.signature == (1 if 4 * a * c > b * b else -1)
    assert flat_map.flatness.flat
    points = points_in(HOLED, 200)
    hessian = np.tile([[2 * a, b], [b, 2 * c]], (points.shape[1], 1, 1))
    assert metric_defect(flat_map, Constant(hessian), points) <= 1e-10
    assert np.abs(np.stack(flat_map.inverse(*flat_map.forward(*points))) - points).max() <= 1e-9


@dataclass(frozen=True)
class Constant:
    matrix: np.ndarray

    def hessian(self, x, y):
        return self.matrix


@settings(max_examples=25, deadline=None)
@given(
    st.integers(3, 8),
    st.lists(st.floats(-1, 1), min_size=18, max_size=18),
    st.complex_numbers(max_magnitude=3, allow_nan=False),
)
def test_harmonic_polynomials_are_flat_and_conformal(degree, numbers, shift):
    coefficients = np.round(
        np.array(numbers[: degree + 1]) + 1j * np.array(numbers[9 : 10 + degree]), 3
    )
    polynomial = (
        np.polynomial.Polynomial(coefficients)
        + 0.5 * np.polynomial.Polynomial([shift, 1.0]) ** degree
    )
    second, third = polynomial.deriv(2), polynomial.deriv(3)
    zeros = second.roots()
    assume(np.hypot(np.abs(zeros.real - 0.5), np.abs(zeros.imag - 0.5)).min(initial=9) > 0.9)
    source = Holomorphic(second, third)
    flat_map = FlatMap(source, SQUARE)
    points = points_in(SQUARE, 300)
    assert flat_map.signature == -1
    assert flat_map.flatness.verdict == "flat"
    assert flat_map.residual <= 1e-9
    assert metric_defect(flat_map, source, points) <= 1e-9
    jacobian = flat_map.jacobian(*points)
    u, v = jacobian[:, 0], jacobian[:, 1]
    size = np.abs(jacobian).max(axis=(1, 2))
    # The map keeps orientation, so (20) holds rather than (21).
    assert (np.abs(u[:, 0] - v[:, 1]) / size).max() <= 1e-8
    assert (np.abs(u[:, 1] + v[:, 0]) / size).max() <= 1e-8


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-2, 2)),
    st.tuples(st.floats(0.3, 2), st.floats(0.3, 2)),
    st.sampled_from([1.0, -1.0]),
)
def test_solutions_of_a_second_order_equation_are_flat(k, rates, sign):
    k1, k2, k3 = (round(v, 2) for v in k)
    discriminant = k2 * k2 - 4 * k1 * k3
    assume(abs(k1) > 0.2)
    assume(abs(discriminant) > 0.1)
    p, q = (round(v, 2) for v in rates)
    if discriminant < 0.0:
        # f = Re F(x + w y) with K1 + K2 w + K3 w^2 = 0 conjugate: w is complex, det H < 0.
        assume(abs(k3) > 0.2)
        w = complex(-k2, math.sqrt(-discriminant)) / (2 * k3)
        source = Holomorphic(lambda z: p * p * np.exp(p * z) + q, lambda z: p**3 * np.exp(p * z), w)
        xs = np.add.outer(np.linspace(0, 1, 30), w * np.linspace(0, 1, 30))
        assume(np.abs(source.second(xs)).min() > 0.05)
    else:
        # Two waves f = F(a x + b y) + G(c x + d y), with K1 a^2 + K2 a b + K3 b^2 = 0.
        slopes = np.roots([k1, k2, k3]).real if k3 != 0.0 else np.array([-k2 / k1, 0.0])
        source = Waves(
            (
                (slopes[0], 1.0, lambda t: np.exp(p * t), lambda t: p * np.exp(p * t)),
                (
                    slopes[1],
                    1.0,
                    lambda t: sign * (1.0 + q * t * t),
                    lambda t: sign * 2.0 * q * t,
                ),
            )
        )
    hessian = source.hessian(*points_in(SQUARE, 50))
    satisfied = k1 * hessian[:, 0, 0] + k2 * hessian[:, 0, 1] + k3 * hessian[:, 1, 1]
    assert np.abs(satisfied).max() <= 1e-9 * np.abs(hessian).max()
    flat_map = FlatMap(source, SQUARE)
    points = points_in(SQUARE, 200)
    assert flat_map.flatness.flat
    assert flat_map.residual <= 1e-9
    assert metric_defect(flat_map, source, points) <= 1e-8


@settings(max_examples=15, deadline=None)
@given(st.floats(-3.1, 3.1), st.floats(-6, 6), st.tuples(st.floats(-9, 9), st.floats(-9, 9)))
def test_the_transform_moves_with_the_function_and_scales_with_its_root(angle, power, shift):
    c, s, scale = math.cos(angle), math.sin(angle), 10.0**power
    source = Holomorphic(lambda z: np.exp(2 * z), lambda z: 2 * np.exp(2 * z))
    turned = Holomorphic(
        lambda z: scale * np.exp(2 * (c - 1j * s) * (z - complex(*shift))) * (c - 1j * s) ** 2,
        lambda z: 2 * scale * np.exp(2 * (c - 1j * s) * (z - complex(*shift))) * (c - 1j * s) ** 3,
    )
    box = shapely.box(-0.5, -0.5, 0.5, 0.5)
    rotation = np.array([[c, -s], [s, c]])
    moved = shapely.transform(box, lambda p: p @ rotation.T + shift)
    points = points_in(box, 100)
    there = rotation @ points + np.array(shift)[:, None]
    first = FlatMap(source, box, origin=(0, 0)).forward(*points)
    second = FlatMap(turned, moved, origin=shift).forward(*there)
    ours, theirs = np.stack(second) / math.sqrt(scale), np.stack(first)
    assert difference_up_to_axes(ours, theirs) <= 1e-9


def test_map_coordinates_lose_only_their_own_digits():
    source = "exp((x-5e6)/1e5)*sin((y-4e6)/1e5)"
    flat_map = FlatMap(source, (5e6, 4e6, 5.1e6, 4.1e6))
    points = points_in((5e6, 4e6, 5.1e6, 4.1e6), 500)
    assert flat_map.flatness.flat
    back = np.stack(flat_map.inverse(*flat_map.forward(*points)))
    assert np.abs(back - points).max() <= 1e-13 * 5e6


def test_a_concave_function_is_treated_as_its_negative():
    up, down = FlatMap("exp(x)+y**2", SQUARE), FlatMap("-exp(x)-y**2", SQUARE)
    points = points_in(SQUARE, 50)
    assert down.signature == up.signature == 1
    ours, theirs = np.stack(down.forward(*points)), np.stack(up.forward(*points))
    assert difference_up_to_axes(ours, theirs) <= 1e-13


def test_frankes_function_is_not_flat():
    patch = FlatMap(FRANKE, (0.2, 0.15, 0.25, 0.25))
    assert patch.flatness.verdict == "not flat"
    assert patch.residual > 1e-4


def test_a_quartic_with_a_quadratic_is_not_flat_and_its_gamma_is_the_closed_form():
    source = "x**4+y**4+x**2*y**2+x**2+y**2"
    result = FlatMap(source, (0.5, 0.0, 1.5, 1.0)).flatness
    assert result.verdict == "not flat"
    x, y = result.where
    g11, g12, g22 = 12 * x * x + 2 * y * y + 2, 4 * x * y, 2 * x * x + 12 * y * y + 2
    g111, g112, g122, g222 = 24 * x, 4 * y, 4 * x, 24 * y
    expected = (
        g11 * (g122**2 - g222 * g112)
        + g12 * (g111 * g222 - g112 * g122)
        + g22 * (g112**2 - g122 * g111)
    )
    largest = 12 * 1.5**2 + 2 + 2
    assert result.gamma == pytest.approx(abs(expected) / largest**3, rel=1e-12)


def test_a_hole_around_a_branch_point_shows_in_the_residual():
    ring = shapely.Point(0, 0).buffer(1.0).difference(shapely.Point(0, 0).buffer(0.3))
    # y = z^(n / 2): two-valued for odd n; y = log z gains 2 pi i; y = z^2 closes.
    for source in ("x**3-3*x*y**2", "log(x**2+y**2)"):
        flat_map = FlatMap(source, ring)
        assert flat_map.residual > 0.5
        assert flat_map.flatness.cause == "hole"
        assert shapely.Point(0, 0).buffer(0.3).contains(shapely.Point(flat_map.flatness.where))
    assert FlatMap("x**4-6*x**2*y**2+y**4", ring).residual < 1e-12
    assert FlatMap("x**4-6*x**2*y**2+y**4", ring).flatness.flat


@pytest.mark.parametrize(
    "source",
    ["x+y", "x**2", "x**3+y**2", "(x-0.31234)**3-3*(x-0.31234)*(y-0.4567)**2", FRANKE, "1/(x-y)"],
)
def test_a_determinant_that_vanishes_or_changes_sign_is_refused(source):
    # The fourth vanishes at one point only, which no grid meets.
    with pytest.raises(InputError, match="det H changes sign, vanishes or is not finite near"):
        FlatMap(source, (0.0, -0.5, 1.0, 1.0))


def test_an_origin_outside_is_refused():
    with pytest.raises(InputError, match="origin"):
        FlatMap("x*y", L_SHAPE, origin=(0.9, 0.9))


def test_a_domain_in_several_pieces_is_refused():
    pieces = shapely.union_all([shapely.box(0, 0, 1, 1), shapely.box(2, 0, 3, 1)])
    with pytest.raises(InputError, match="pieces"):
        FlatMap("x*y", pieces)


def test_a_surface_without_third_derivatives_is_refused():
    class Rough:
        def hessian(self, x, y):
            raise AssertionError

    with pytest.raises(InputError):
        FlatMap(Rough(), SQUARE)
