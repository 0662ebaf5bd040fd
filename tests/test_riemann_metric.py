"""Metrics and their tools against closed forms."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh
from equimesh.errors import InputError
from equimesh.frame import Frame
from equimesh.riemann.boundary import equidistant
from equimesh.riemann.kernels import christoffel, geodesic, metric_at, orthonormal, unit_frame
from equimesh.riemann.metric import Metric
from equimesh.riemann.patches import fit_metric
from equimesh.riemann.tensors import exponential, intersection, logarithm

SQUARE = (0.0, 0.0, 1.0, 1.0)
RNG = np.random.default_rng(5)


def tensors(n, spread=3.0, rng=RNG):
    angle, logs = rng.uniform(0, np.pi, n), rng.uniform(-spread, spread, (n, 2))
    c, s = np.cos(angle), np.sin(angle)
    r = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return np.einsum("nik,nk,njk->nij", r, np.exp(logs), r)


def conformal(factor):
    return Metric(lambda x, y: factor(x, y)[:, None, None] * np.eye(2))


def sphere(radius=1.0):
    """Stereographic coordinates: curvature 1 / radius^2."""
    return conformal(lambda x, y: 4.0 * radius**2 / (1.0 + x * x + y * y) ** 2)


def half_plane():
    """Poincare's half plane: curvature -1."""
    return conformal(lambda x, y: 1.0 / y**2)


def polar():
    """dr^2 + r^2 dangle^2 in x = r, y = angle: flat, with Christoffel symbols."""

    def tensor(x, y):
        m = np.zeros((len(x), 2, 2))
        m[:, 0, 0], m[:, 1, 1] = 1.0, x**2
        return m

    return Metric(tensor)


def test_the_package_offers_it():
    assert equimesh.Metric is Metric


def test_logarithm_and_exponential_are_inverse_and_match_the_eigenvalues():
    m = tensors(200, 10.0)
    values, vectors = np.linalg.eigh(m)
    log = logarithm(m)
    expected = np.einsum("nik,nk,njk->nij", vectors, np.log(values), vectors)
    np.testing.assert_allclose(log, expected, atol=1e-6)
    np.testing.assert_allclose(exponential(log), m, rtol=1e-7, atol=1e-7 * np.abs(m).max())
    np.testing.assert_array_equal(logarithm(np.eye(2)[None]), np.zeros((1, 2, 2)))


def test_complexity_of_metrics_whose_area_is_known():
    assert Metric(np.diag([4.0, 9.0])).complexity(SQUARE) == pytest.approx(6.0)
    assert polar().complexity((1, 0, 2, 1)) == pytest.approx(1.5)
    assert half_plane().complexity((0, 1, 1, 4)) == pytest.approx(0.75)
    disc = shapely.Point(0, 0).buffer(1.0, quad_segs=256)
    assert sphere(3.0).complexity(disc) == pytest.approx(2 * math.pi * 9.0, rel=1e-4)
    holed = shapely.box(0, 0, 3, 3) - shapely.box(1, 1, 2, 2)
    assert Metric(np.eye(2)).complexity(holed) == pytest.approx(8.0)


def test_a_thin_peak_of_the_density_is_not_missed():
    peak = conformal(lambda x, y: 1.0 + 1e6 * np.exp(-(((x - 0.31) ** 2 + (y - 0.7) ** 2) / 1e-4)))
    assert peak.complexity(SQUARE) == pytest.approx(1.0 + 1e6 * math.pi * 1e-4, rel=1e-3)


def test_unit_triangles_normalise_and_scale():
    metric = sphere()
    assert metric.unit_triangles(SQUARE) == pytest.approx(metric.complexity(SQUARE) * 4 / 3**0.5)
    scaled = metric.normalise(SQUARE, 1234.0)
    assert scaled.unit_triangles(SQUARE) == pytest.approx(1234.0)
    assert metric.normalised(SQUARE, 10.0).unit_triangles(SQUARE) == pytest.approx(10.0)
    a, b = RNG.random((50, 2)), RNG.random((50, 2))
    np.testing.assert_allclose(metric.scaled(3.0).lengths(a, b), 3.0 * metric.lengths(a, b))
    np.testing.assert_allclose(metric.scaled(3.0)([0.2], [0.3]), 9.0 * metric([0.2], [0.3]))


def test_lengths_of_straight_edges():
    m = np.array([[5.0, 2.0], [2.0, 3.0]])
    d = np.array([0.3, -0.7])
    assert Metric(m).lengths([[1, 1]], [[1 + d[0], 1 + d[1]]])[0] == pytest.approx(
        math.sqrt(d @ m @ d)
    )
    assert half_plane().lengths([[0, 1]], [[0, 3]])[0] == pytest.approx(math.log(3.0))
    assert polar().lengths([[2, 0]], [[2, 0.5]])[0] == pytest.approx(1.0)
    assert Metric.isotropic(0.25).lengths([[0, 0]], [[1, 0]])[0] == pytest.approx(4.0)
    varying = Metric.isotropic(lambda x, y: 0.1 * np.exp(x))
    assert varying.lengths([[0, 0]], [[1, 0]])[0] == pytest.approx(10.0 * (1 - math.exp(-1)))


def test_gaussian_curvature_of_surfaces_of_constant_curvature():
    unit = math.sqrt(3.0) / 4.0
    x, y = RNG.uniform(-0.8, 0.8, 20), RNG.uniform(0.2, 1.5, 20)
    np.testing.assert_allclose(sphere(2.0).curvature(x, y), unit / 4.0, rtol=1e-3)
    np.testing.assert_allclose(half_plane().curvature(x, y), -unit, rtol=1e-3)
    np.testing.assert_allclose(polar().curvature(x + 2.0, y), 0.0, atol=1e-5)
    harmonic = conformal(lambda x, y: np.exp(2 * (x * x - y * y + x)))
    np.testing.assert_allclose(harmonic.scaled(30.0).curvature(x, y), 0.0, atol=1e-5)
    stretched = Metric(
        lambda x, y: np.diag([1e6, 1.0]) * (4 / (1 + 1e6 * x * x + y * y) ** 2)[:, None, None]
    )
    np.testing.assert_allclose(stretched.curvature(x * 1e-3, y), unit, rtol=1e-3)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 12.0))
def test_the_intersection_is_inside_both_unit_balls_and_touches_them(seed, spread):
    rng = np.random.default_rng(seed)
    m, other = tensors(5, 3.0, rng), tensors(5, spread, rng)
    both = intersection(m, other)
    scale = np.linalg.eigvalsh(m + other)[:, 1]
    for one in (m, other):
        assert (np.linalg.eigvalsh(both - one)[:, 0] >= -1e-9 * scale).all()
    # Along each common conjugate axis it measures what the longer of the two does.
    axes = np.linalg.eig(np.linalg.solve(m, other))[1]
    for v in axes.transpose(2, 0, 1):
        lengths = [np.einsum("ni,nij,nj->n", v, a, v) for a in (m, other, both)]
        np.testing.assert_allclose(lengths[2], np.maximum(*lengths[:2]), rtol=1e-5)


def test_intersecting_metrics():
    first, second = Metric(np.diag([1.0, 1e6])), Metric(np.diag([1e6, 1.0]))
    np.testing.assert_allclose(first.intersect(second)([0.3], [0.1]), [1e6 * np.eye(2)])
    np.testing.assert_allclose(first.intersect(first)([0.3], [0.1]), [np.diag([1.0, 1e6])])
    corners = np.array([[0, 0], [1, 0], [0, 1]])
    on_mesh = Metric.on_mesh(
        corners, np.array([[0, 1, 2]]), np.tile(np.diag([4.0, 1.0]), (3, 1, 1))
    )
    both = on_mesh.intersect(Metric(np.diag([1.0, 9.0])))
    np.testing.assert_allclose(both.scaled(2.0)([0.3], [0.1]), [np.diag([16.0, 36.0])])
    np.testing.assert_allclose(both.gradation(2.0)([0.3], [0.1]), [np.diag([4.0, 9.0])])


def test_a_metric_on_a_mesh_is_the_geometric_mean_in_between():
    m = tensors(4)
    metric = Metric.on_mesh([[0, 0], [1, 0], [1, 1], [0, 1]], np.array([[0, 1, 2], [0, 2, 3]]), m)
    np.testing.assert_allclose(metric([0, 1, 1, 0], [0, 0, 1, 1]), m, rtol=1e-9)
    middle = metric([0.5], [0.0])[0]
    expected = exponential(0.5 * (logarithm(m[:1]) + logarithm(m[1:2])))[0]
    np.testing.assert_allclose(middle, expected, rtol=1e-9)
    assert np.linalg.det(middle) == pytest.approx(math.sqrt(np.linalg.det(m[0] @ m[1])))
    np.testing.assert_allclose(metric([-3.0], [-3.0])[0], m[0], rtol=1e-9)
    isotropic = Metric.on_mesh(
        [[0, 0], [1, 0], [0, 1]],
        np.array([[0, 1, 2]]),
        np.array([1.0, 4.0, 1.0])[:, None, None] * np.eye(2),
    )
    np.testing.assert_allclose(isotropic([0.5], [0.0])[0], 2.0 * np.eye(2))


def test_gradation_limits_growth_and_never_coarsens():
    raw = Metric.isotropic(lambda x, y: np.where(np.hypot(x - 0.4, y - 0.6) < 0.05, 0.01, 1.0))
    graded = raw.gradation(1.3, SQUARE)
    x, y = RNG.random(500), RNG.random(500)
    before, after = raw(x, y), graded(x, y)
    size = np.linalg.det(after) ** -0.25
    outside = np.abs(np.hypot(x - 0.4, y - 0.6) - 0.05) > 0.02
    assert (np.linalg.eigvalsh(after - before)[outside, 0] > -1e-6 * 1e4).all()
    # From a fine spot of size h, sizes grow by ln(rate) per unit of length, in every direction.
    r = np.hypot(x - 0.4, y - 0.6) - 0.05
    assert (size[outside] <= 0.01 + np.maximum(r[outside] + 0.02, 0) * math.log(1.3) * 1.2).all()
    np.testing.assert_allclose(sphere().gradation(1e9, SQUARE)(x, y), sphere()(x, y), rtol=0.05)


def test_gradation_on_the_metrics_own_mesh():
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41)))
    from scipy.spatial import Delaunay

    p = np.stack([x, y], 1)
    h = np.where(x < 0.01, 0.01, 1.0)
    metric = Metric.on_mesh(p, Delaunay(p).simplices, h[:, None, None] ** -2.0 * np.eye(2))
    graded = metric.gradation(1.5)
    sizes = graded(np.linspace(0, 1, 41), np.full(41, 0.5))[:, 0, 0] ** -0.5
    growth = np.diff(sizes) / 0.025
    assert sizes[0] == pytest.approx(0.01)
    assert growth.max() <= math.log(1.5) * 1.01
    assert growth[:20].min() >= math.log(1.5) * 0.9


def test_the_metric_of_a_quadratic_makes_its_optimal_triangles_unit():
    tol = 0.01
    metric = Metric.of("3*x**2 + x*y + 2*y**2", tol, SQUARE)
    m = metric([0.5], [0.5])[0]
    np.testing.assert_allclose(m, np.array([[6.0, 1.0], [1.0, 4.0]]) / (6 * tol), rtol=1e-6)
    # Equilateral in m with unit edges: the error is tol.
    w = np.linalg.inv(np.linalg.cholesky(m)).T
    corners = (w @ np.array([[0, 1, 0.5], [0, 0, math.sqrt(0.75)]])).T
    found = equimesh.profile(corners, [[0, 1, 2]], "3*x**2 + x*y + 2*y**2")
    assert found.max == pytest.approx(tol, rel=1e-6)


def test_the_metric_of_a_function_stays_positive_where_det_h_vanishes():
    metric = Metric.of("x**3 + 0.1*y**4", 1e-3, (-1, -1, 1, 1))
    m = metric(np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.3, 0.0]))
    assert (np.linalg.eigvalsh(m)[:, 0] >= 0.25 * (1 - 1e-9)).all()
    # A cubic's error on an edge of length l is 6 l^3 / (72 sqrt 3); their squares are 3/4 of that,
    # as everywhere: 6 tol in |H| instead of 8 tol.
    length = (4.0 / 3.0 / m[1, 0, 0]) ** 0.5
    assert 6 * length**3 / (72 * 3**0.5) == pytest.approx(1e-3, rel=0.02)


def patches_of(metric, box):
    frame = Frame(np.zeros(2), np.eye(2))
    return fit_metric(metric, shapely.box(*box), frame)


def test_patches_stand_in_for_the_metric_in_every_direction():
    def swirl(x, y):
        a = 3 * np.hypot(x, y) + np.arctan2(y, x)
        c, s = np.cos(a), np.sin(a)
        r = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
        return r @ np.diag([1.0, 1e6]) @ r.transpose(0, 2, 1)

    patches = patches_of(Metric(swirl), (0.3, 0.3, 1, 1))
    for x, y in RNG.uniform(0.3, 1.0, (200, 2)):
        a, b, d = metric_at(patches, x, y)
        ratio = np.linalg.eigvals(
            np.linalg.solve(swirl(np.array([x]), np.array([y]))[0], np.array([[a, b], [b, d]]))
        )
        np.testing.assert_allclose(ratio, 1.0, atol=5e-3)


def test_christoffel_symbols_of_known_metrics():
    box = (0.5, 0.5, 1.5, 1.5)
    x, y = 0.9, 1.2
    found = christoffel(patches_of(polar(), box), x, y)
    np.testing.assert_allclose(found, [0, 0, -x, 0, 1 / x, 0], atol=5e-3)
    found = christoffel(patches_of(half_plane(), box), x, y)
    np.testing.assert_allclose(found, [0, -1 / y, 0, 1 / y, 0, -1 / y], atol=5e-3)


def test_geodesics_of_the_sphere_are_great_circles_and_carry_frames_along():
    patches = patches_of(sphere(), (-1, -1, 1, 1))
    out = np.empty(6)
    geodesic(patches, 0.0, 0.0, np.array([0.5, 0.0, 0.0, 0.5]), 0.6, 0.8, 8, out)
    # From the pole along a meridian: a metric length s ends at tan(s / 2).
    np.testing.assert_allclose(out[:2], math.tan(0.5) * np.array([0.6, 0.8]), atol=1e-3)
    m = sphere()(out[:1], out[1:2])[0]
    w = out[2:].reshape(2, 2)
    np.testing.assert_allclose(w.T @ m @ w, np.eye(2), atol=2e-3)


def test_a_frame_carried_around_an_octant_of_the_sphere_turns_by_its_area():
    patches = patches_of(sphere(), (-0.2, -0.2, 1.2, 1.2))
    state = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.5])
    direction = np.array([1.0, 0.0])
    for _ in range(3):  # legs of length pi / 2 that meet at right angles
        out = np.empty(6)
        geodesic(patches, *state[:2], state[2:].copy(), *(direction * math.pi / 2), 32, out)
        state = out
        direction = np.array([-direction[1], direction[0]])
    np.testing.assert_allclose(state[:2], 0.0, atol=5e-3)
    w = state[2:].reshape(2, 2) / 0.5
    angle = math.atan2(w[1, 0], w[0, 0])
    assert angle == pytest.approx(math.pi / 2, abs=1e-2)


def test_frames_are_orthonormal():
    for m in tensors(20, 8.0):
        packed = m[0, 0], m[0, 1], m[1, 1]
        w = np.reshape(unit_frame(*packed), (2, 2))
        np.testing.assert_allclose(w.T @ m @ w, np.eye(2), atol=1e-8)
        out = np.empty(4)
        turn = np.array([[0.6, -0.8], [0.8, 0.6]])
        orthonormal(*packed, (w @ turn * 1.1).ravel(), out)
        np.testing.assert_allclose(out.reshape(2, 2), w @ turn, rtol=1e-7, atol=1e-9)


def test_boundary_nodes_are_equidistant_and_depend_on_the_side_alone():
    metric = half_plane().scaled(10.0)
    a, b = np.array([0.0, 1.0]), np.array([0.0, 5.0])
    s = np.concatenate([[0.0], equidistant(metric, a, b), [1.0]])
    y = 1.0 + 4.0 * s
    assert len(s) - 1 == round(10 * math.log(5.0))
    np.testing.assert_allclose(np.diff(np.log(y)), np.diff(np.log(y)).mean(), rtol=1e-3)


@pytest.mark.parametrize(
    "tensor, words",
    [
        (lambda x, y: np.zeros((len(x), 2, 2)), "not positive definite at"),
        (lambda x, y: np.full((len(x), 2, 2), np.nan), "not finite at"),
        (lambda x, y: np.tile([[2.0, 1.0], [0.0, 2.0]], (len(x), 1, 1)), "not symmetric at"),
        (lambda x, y: np.ones(len(x)), "the shape"),
        (lambda x, y: "metric", "failed on arrays"),
        (lambda x: x, "failed on arrays"),
    ],
)
def test_what_is_no_metric_is_refused_in_one_sentence(tensor, words):
    with pytest.raises(InputError, match=words) as error:
        Metric(tensor)(np.array([0.5]), np.array([0.5]))
    assert str(error.value).count(".") - str(error.value).count("0.5") <= 1


def test_other_refusals():
    with pytest.raises(InputError, match="callable"):
        Metric([1.0, 2.0])
    with pytest.raises(InputError, match="positive definite"):
        Metric(-np.eye(2))
    with pytest.raises(InputError, match="size"):
        Metric.isotropic(0.0)
    with pytest.raises(InputError, match="domain"):
        sphere().gradation(1.3)
    with pytest.raises(InputError, match="growth above 1"):
        sphere().gradation(1.0, SQUARE)
    with pytest.raises(InputError, match="positive"):
        sphere().normalise(SQUARE, 0)
    with pytest.raises(InputError, match="tolerance"):
        Metric.of("x*y", -1.0, SQUARE)
    with pytest.raises(InputError, match="second derivatives"):
        Metric.of(np.zeros((4, 4)), 0.1)
    with pytest.raises(InputError, match="do not exist"):
        Metric.on_mesh(
            [[0, 0], [1, 0], [0, 1]], np.array([[0, 1, 3]]), np.tile(np.eye(2), (3, 1, 1))
        )
    with pytest.raises(InputError, match="on 3 vertices"):
        Metric.on_mesh([[0, 0], [1, 0], [0, 1]], np.array([[0, 1, 2]]), np.eye(2))
