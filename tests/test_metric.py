"""The frame of the metric and the lower bound, against closed forms."""

import math

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.polynomial.polynomial import polyder, polyval2d
from scipy.integrate import dblquad, quad

from equimesh import integrals
from equimesh.expression import parse
from equimesh.fields.function import Function
from equimesh.fields.kernel import PATCHES, KernelField
from equimesh.fields.patches import fit_patches
from equimesh.integrals import lower_bound, lower_bound_of, total_curvature
from equimesh.lattice import boost
from equimesh.metric import BOOST_PERIOD, frame_at
from equimesh.transport import curvature

SEEDS = st.integers(0, 2**32 - 1)
LOCAL = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
FLOOR = 1e-12


def field_of(f):
    p = fit_patches(f, shapely.box(-1, -1, 1, 1), 1e-9)
    return KernelField(PATCHES, frame=p.frame, child=p.child, coef=p.coef, kinks=p.kinks)


def frame_of(field, x, y, tol, floor=FLOOR):
    e1x, e1y, e2x, e2y, eps, pure = frame_at(
        field.frame, field.child, field.coef, x, y, 8 * tol, floor
    )
    return np.array([[e1x, e2x], [e1y, e2y]]), eps, pure


@given(SEEDS, st.sampled_from([1e-3, 1e-6, 1e-9]))
@example(0, 1e-6)
def test_the_frame_makes_the_metric_diagonal_and_unit(seed, tol):
    c = np.random.default_rng(seed).normal(size=(5, 5))
    field = field_of(lambda x, y: polyval2d(x, y, c))
    for x, y in np.random.default_rng(seed + 1).uniform(-1, 1, (5, 2)):
        xx = float(polyval2d(x, y, polyder(c, 2, axis=0)))
        yy = float(polyval2d(x, y, polyder(c, 2, axis=1)))
        xy = float(polyval2d(x, y, polyder(polyder(c, axis=0), axis=1)))
        hessian = np.array([[xx, xy], [xy, yy]])
        w, eps, pure = frame_of(field, x, y, tol)
        if not pure:
            continue
        assert eps == np.sign(np.linalg.det(hessian))
        form = w.T @ hessian @ w / (8 * tol)
        sign = np.sign(form[0, 0])
        assert form == pytest.approx(sign * np.diag([1, eps]), abs=1e-6)
        # Eigenvectors, the first that of the larger eigenvalue, right-handed.
        assert abs(w[:, 0] @ w[:, 1]) <= 1e-9 * np.abs(w).max() ** 2
        assert np.linalg.det(w) > 0
        if eps < 0:
            assert sign == 1


def test_most_points_are_pure_when_the_tolerance_is_small():
    c = np.random.default_rng(0).normal(size=(5, 5))
    field = field_of(lambda x, y: polyval2d(x, y, c))
    points = np.random.default_rng(1).uniform(-1, 1, (400, 2))
    share = [np.mean([frame_of(field, *p, tol)[2] for p in points]) for tol in (1e-2, 1e-5, 1e-8)]
    assert share[0] < share[1] < share[2]
    assert share[2] > 0.98


@pytest.mark.parametrize("tol", [1e-2, 1e-4])
def test_where_the_curvature_vanishes_the_cubic_bounds_the_step(tol):
    # At the inflection of x**3 the error of an edge of length s is |f'''| s**3 / (72 sqrt 3).
    w, _, pure = frame_of(field_of(parse("x**3+y**2").value), 0.0, 0.3, tol)
    assert not pure
    step = np.abs(w[0]).max()
    s = np.linspace(-0.5, 0.5, 100_001) * step
    error = np.abs(s**3 - s * step**2 / 4).max()
    assert error == pytest.approx(tol, rel=1e-6)
    assert np.abs(w[1]).max() == pytest.approx(math.sqrt(8 * tol / 2), rel=1e-9)


def test_a_plane_takes_the_longest_step_allowed():
    w, _, pure = frame_of(field_of(parse("2*x-y").value), 0.1, 0.2, 1e-3, floor=0.25)
    assert not pure
    assert np.linalg.norm(w, axis=0) == pytest.approx([2.0, 2.0], rel=1e-9)


@given(SEEDS, st.floats(0, math.pi), st.floats(0.1, 3))
@example(0, 0.5, 2.0)
def test_frames_turn_and_grow_with_the_function(seed, angle, grow):
    h = np.random.default_rng(seed).normal(size=3)
    assume(abs(h[0] * h[2] - h[1] ** 2) > 0.01)
    c, s = math.cos(angle), math.sin(angle)

    def f(x, y):
        return h[0] * x * x + 2 * h[1] * x * y + h[2] * y * y

    first, eps, _ = frame_of(field_of(f), 0.0, 0.0, 1e-3)
    turned, same, _ = frame_of(
        field_of(lambda x, y: f((c * x + s * y) / grow, (c * y - s * x) / grow)), 0.0, 0.0, 1e-3
    )
    assert same == eps
    expected = grow * np.array([[c, -s], [s, c]]) @ first
    for k in range(2):  # each axis up to its sign
        gap = min(np.abs(turned[:, k] - expected[:, k]).max(),
                  np.abs(turned[:, k] + expected[:, k]).max())  # fmt: skip
        assert gap <= 1e-6 * np.abs(expected).max()


def test_a_boost_by_the_period_maps_the_saddle_lattice_onto_itself():
    lattice = np.array([[1.0, 0.0], [0.5, 0.5 * math.sqrt(5)]])
    steps = lattice @ boost(BOOST_PERIOD).T @ np.linalg.inv(lattice)
    assert steps == pytest.approx(np.round(steps), abs=1e-12)
    assert abs(np.linalg.det(steps)) == pytest.approx(1.0)
    assert not np.allclose(steps, np.eye(2))
    for part in (2, 3, 4):
        steps = lattice @ boost(BOOST_PERIOD / part).T @ np.linalg.inv(lattice)
        assert np.abs(steps - np.round(steps)).max() > 0.05


# Section 2: area per error of the optimal triangles.
CONVEX, SADDLE = 3 * math.sqrt(3) / 4, math.sqrt(5)


def example_2(y, x):
    return 3 / ((x - 0.5) ** 2 + (y + 0.2) ** 2) ** 2


def example_3(y, x):
    return 10 / ((x - 0.5) ** 2 + (y + 0.2) ** 2) ** 3


INTEGRALS = [
    ("exp(5*x)*sin(5*y)", 2.5 * (math.exp(5) - 1) / SADDLE),
    ("((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2", 51.95 / SADDLE),
    (
        "(((x-1/2)**2+(y+1/5)**2)**2-8*(x-1/2)**2*(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**4",
        1816.0 / SADDLE,
    ),
    ("x**2+y**2", 1 / CONVEX),
    ("3*x*y", 1.5 / SADDLE),
    ("exp(x)+exp(y)", 2 * (math.exp(0.5) - 1) ** 2 / CONVEX),
    ("exp(x)-exp(y)", 2 * (math.exp(0.5) - 1) ** 2 / SADDLE),
    # Convex where x > 1/2, a saddle where x < 1/2: each half with its own constant.
    ("(x-1/2)**3+y**2", math.sqrt(3) * 2 / 3 * 0.5**1.5 * (1 / CONVEX + 1 / SADDLE)),
]


def test_the_integrals_of_the_paper_are_recomputed():
    assert dblquad(example_2, 0, 1, 0, 1)[0] == pytest.approx(51.95, rel=1e-4)
    assert dblquad(example_3, 0, 1, 0, 1)[0] == pytest.approx(1816.0, rel=1e-4)


@pytest.mark.parametrize("text, integral", INTEGRALS)
@pytest.mark.parametrize("tol", [1e-1, 1e-3])
def test_the_lower_bound_is_the_integral_over_the_tolerance(text, integral, tol):
    kernel = Function(text).kernel(shapely.box(0, 0, 1, 1), 1e-4)
    assert lower_bound(kernel, LOCAL, HALVES, tol) == pytest.approx(integral / tol, rel=2e-3)


@pytest.mark.parametrize("text, integral", INTEGRALS)
def test_the_lower_bound_of_hessians_at_points_is_the_same(text, integral):
    middle = (np.arange(800) + 0.5) / 800
    x, y = (a.ravel() for a in np.meshgrid(middle, middle))
    ours = lower_bound_of(parse(text).hessian(x, y), np.full(x.size, 1 / x.size), 0.5)
    assert ours == pytest.approx(integral / 0.5, rel=2e-3)


# det(H / 2) = (1 - 2 x^2) / 4.
ACROSS = "-x**4/12+x**2/4+y**2"


def test_a_change_of_sign_inside_triangles_is_integrated_well():
    """By triangles that do not know where it is, from few to many, as by quadrature in x."""
    kernel = Function(ACROSS).kernel(shapely.box(0, 0, 1, 1), 1e-7)
    root = math.sqrt(0.5)
    below = quad(lambda x: math.sqrt(0.5 - x * x), 0, root)[0]
    above = quad(lambda x: math.sqrt(x * x - 0.5), root, 1)[0]
    exact = root * (below / CONVEX + above / SADDLE)
    for n in (3, 17, 120):
        places = np.linspace(-1, 1, n)
        x, y = (a.ravel() for a in np.meshgrid(places, places))
        corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
        lower = np.stack([corner, corner + 1, corner + n + 1], 1)
        upper = np.stack([corner, corner + n + 1, corner + n], 1)
        bound = lower_bound(kernel, np.stack([x, y], 1), np.vstack([lower, upper]), 1.0)
        assert bound == pytest.approx(exact, rel=2e-4)


def test_the_bound_does_not_depend_on_the_triangles_that_cover_the_domain():
    kernel = Function("exp(x)-exp(y)").kernel(shapely.box(0, 0, 1, 1), 1e-4)
    corners = np.vstack([LOCAL, [[0.3, -0.2]]])
    fan = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    assert lower_bound(kernel, corners, fan, 1e-3) == pytest.approx(
        lower_bound(kernel, LOCAL, HALVES, 1e-3), rel=1e-5
    )


@given(st.floats(0, math.pi), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3))
@example(0.4, 1e3, 1e-3)
def test_the_bound_ignores_rotation_and_units(angle, grow, lift):
    c, s = math.cos(angle), math.sin(angle)
    square = shapely.affinity.scale(shapely.box(0, 0, 1, 1), grow, grow, origin=(0, 0))
    square = shapely.affinity.rotate(square, angle, use_radians=True, origin=(0, 0))

    def f(x, y):
        x, y = x / grow, y / grow
        return lift * (np.exp(c * x + s * y) - np.exp(c * y - s * x))

    function = Function(f)
    kernel = function.kernel(square, 1e-4 * lift)
    corners = function.frame(square).to_local(shapely.get_coordinates(square)[:4])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    area = shapely.Polygon(corners).exterior.is_ccw
    triangles = triangles if area else triangles[:, ::-1]
    expected = 2 * (math.exp(0.5) - 1) ** 2 / SADDLE / 1e-2
    assert lower_bound(kernel, corners, triangles, 1e-2 * lift) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("text", ["2*x**2+x*y+y**2", "-x**2-3*y**2"])
def test_vertices_beside_a_convex_surface_see_half_its_metric(text):
    field = field_of(parse(text).value)
    one, _, _ = frame_of(field, 0.1, 0.2, 1e-3)
    two, _, _ = frame_of(field.two_sided(), 0.1, 0.2, 1e-3)
    assert two == pytest.approx(np.sqrt(2) * one)
    saddle = field_of(parse("x*y").value)
    one, _, _ = frame_of(saddle, 0.1, 0.2, 1e-3)
    two, _, _ = frame_of(saddle.two_sided(), 0.1, 0.2, 1e-3)
    assert two == pytest.approx(one)


def curvature_over_the_square(text):
    square = shapely.box(0, 0, 1, 1)
    function = Function(text)
    kernel = function.kernel(square, 1e-6)  # whose local square is the same
    return total_curvature(kernel, LOCAL, HALVES)


@pytest.mark.parametrize(
    "text", ["exp(5*x)*sin(5*y)", "exp(2*x + y) + (x - 2*y)**2", "x**2 + 3*y**2", "sin(x)"]
)
def test_flat_metrics_have_no_total_curvature(text):
    assert curvature_over_the_square(text) < 1e-2


def test_the_total_curvature_is_the_integral_of_that_of_the_metric():
    """By the transport's own formula for K, at many places."""
    text = "exp(x*y) + x**2 + 2*y**2"
    function = Function(text)
    t = (np.arange(60) + 0.5) / 60
    x, y = (a.ravel() for a in np.meshgrid(t, t))
    hessian = function.hessian(x, y)
    bent, _ = curvature(hessian, function.third(x, y))
    expected = (bent * np.sqrt(np.abs(np.linalg.det(hessian)))).mean()
    assert expected > 0.01
    assert curvature_over_the_square(text) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("corners", [(-0.1, 0.1, 0.2), (-1.0, -0.3, 0.5)])
def test_the_mean_density_beside_a_line_where_det_h_vanishes(corners):
    """As by many small triangles."""
    n = 1500
    i, j = np.meshgrid(np.arange(n), np.arange(n))
    p, q = (i + 1 / 3) / n, (j + 1 / 3) / n
    inside = p + q < 1
    d = corners[0] + p * (corners[1] - corners[0]) + q * (corners[2] - corners[0])
    density = np.sqrt(np.abs(d)) / np.where(d > 0, CONVEX, SADDLE)
    assert integrals._mean_beside(*corners, 1.0) == pytest.approx(density[inside].mean(), rel=2e-3)
