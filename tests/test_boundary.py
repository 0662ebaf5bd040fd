"""Nodes on the boundary: equal errors along every side, the same for both who share one."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

from equimesh.boundary import boundary_nodes
from equimesh.domain import Sides, sides_of
from equimesh.expression import parse
from equimesh.fields.function import Function

SQUARE = shapely.box(0, 0, 1, 1)
FLOOR = 1e-9


def nodes_of(text, domain, tol, spacing=1.0, whole=None):
    """Boundary nodes of a domain, in the user's coordinates, with its sides."""
    function = Function(text)
    whole = domain if whole is None else whole
    kernel, frame = function.kernel(whole, tol), function.frame(whole)
    sides = sides_of(domain)
    local = Sides(frame.to_local(sides.corners), sides.following, sides.tags, sides.names)
    nodes = boundary_nodes(kernel, local, tol, FLOOR, spacing)
    return frame.to_user(nodes.points), nodes, sides


def edge_errors(text, points, nodes):
    """(b,) largest |f - chord| of each boundary edge, by dense samples."""
    f = parse(text).value
    a, b = points, points[nodes.following]
    s = np.linspace(0, 1, 201)[:, None]
    za, zb = f(*a.T), f(*b.T)
    p = a[None] + s[..., None] * (b - a)[None]
    return np.abs(f(p[..., 0], p[..., 1]) - (za + s * (zb - za))).max(0)


CONVEX = "exp(2*x+y)+(x-2*y)**2"
HARMONIC = "exp(5*x)*sin(5*y)"


@pytest.mark.parametrize("tol", [1e-3, 1e-4])
def test_errors_along_a_side_of_a_convex_function_are_equal(tol):
    points, nodes, _ = nodes_of(CONVEX, SQUARE, tol)
    errors = edge_errors(CONVEX, points, nodes)
    # An edge of the equilateral triangle has 3/4 of its error; each side rounds its own number.
    assert errors.max() <= 0.8 * tol
    for side in range(4):
        own = errors[nodes.side == side]
        assert len(own) >= 20
        assert own.max() / own.min() <= 1.0 + 20 * math.sqrt(tol)
        assert np.median(own) == pytest.approx(0.75 * tol, rel=2.5 / len(own))


def test_a_convex_side_has_as_many_nodes_as_its_length_in_the_metric():
    # On y = 0 of exp(2x): the integral of sqrt(4 exp(2x) / (8 tol)), over sqrt(3)/2 for each edge.
    tol = 1e-5
    _, nodes, sides = nodes_of("exp(2*x)+exp(2*y)", SQUARE, tol)
    length = 2 * (math.e - 1) / math.sqrt(8 * tol) / math.sqrt(0.75)
    (bottom,) = np.flatnonzero(sides.tags == 0)
    assert (nodes.side == bottom).sum() == pytest.approx(length, abs=1.1)


def test_no_edge_of_a_saddle_exceeds_the_tolerance_and_the_bent_sides_are_equal():
    tol = 2e-3
    points, nodes, sides = nodes_of("x**2-y**2+x*y/9", SQUARE, tol)
    errors = edge_errors("x**2-y**2+x*y/9", points, nodes)
    assert errors.max() <= 1.06 * tol
    for side in range(4):
        own = errors[nodes.side == side]
        assert own.max() == pytest.approx(own.min(), rel=1e-3)
        assert own.max() >= 0.8 * tol
    assert len(sides.corners) == 4


def test_a_side_along_a_null_direction_keeps_a_share_of_nodes():
    # x y is linear along both axes: no error at all, but long edges would make long triangles.
    _, nodes, _ = nodes_of("x*y", SQUARE, 1e-4)
    length = 1 / math.sqrt(8e-4)
    for side in range(4):
        assert (nodes.side == side).sum() == pytest.approx(0.6 * length, abs=1.1)


@pytest.mark.parametrize("text", [CONVEX, HARMONIC])
@pytest.mark.parametrize("spacing", [0.5, 2.0])
def test_spacing_changes_the_number_in_proportion(text, spacing):
    _, one, _ = nodes_of(text, SQUARE, 1e-4)
    _, other, _ = nodes_of(text, SQUARE, 1e-4, spacing)
    assert len(other.points) == pytest.approx(len(one.points) / spacing, rel=0.02)


def test_the_number_goes_like_the_square_root_of_the_tolerance():
    counts = [len(nodes_of(HARMONIC, SQUARE, tol)[0]) for tol in (1e-1, 1e-2, 1e-3)]
    assert counts[1] / counts[0] == pytest.approx(math.sqrt(10), rel=0.06)
    assert counts[2] / counts[1] == pytest.approx(math.sqrt(10), rel=0.02)


def test_nodes_run_around_every_ring_in_order():
    domain = shapely.Polygon(
        [(0, 0), (1, 0), (1, 1), (0, 1)], [[(0.3, 0.3), (0.6, 0.35), (0.55, 0.7)]]
    )
    points, nodes, sides = nodes_of(CONVEX, domain, 1e-3)
    assert nodes.corner.sum() == len(sides.corners) == 7
    assert np.allclose(points[nodes.corner], sides.corners[nodes.side[nodes.corner]], atol=1e-15)
    assert (np.sort(nodes.following) == np.arange(len(points))).all()
    step = points[nodes.following] - points
    assert np.hypot(*step.T).sum() == pytest.approx(domain.length, rel=1e-12)
    twice = points[:, 0] * points[nodes.following, 1] - points[:, 1] * points[nodes.following, 0]
    assert 0.5 * twice.sum() == pytest.approx(domain.area, rel=1e-12)


@given(st.integers(0, 2**32 - 1))
@example(0)
def test_both_owners_of_a_side_put_the_same_nodes_on_it(seed):
    rng = np.random.default_rng(seed)
    p, q = rng.uniform(0.2, 0.8, 2)
    left = shapely.Polygon([(0, 0), (p, 0), (q, 1), (0, 1)])
    right = shapely.Polygon([(p, 0), (1, 0), (1, 1), (q, 1)])
    shared = []
    for domain in (left, right):
        points, _, _ = nodes_of(HARMONIC, domain, 0.05, whole=SQUARE)
        on = np.abs(points[:, 0] - (p + (q - p) * points[:, 1])) < 1e-12
        shared.append(points[on][np.argsort(points[on][:, 1])])
    assert len(shared[0]) > 5
    assert np.array_equal(shared[0], shared[1])


def test_neighbours_with_fields_of_their_own_agree_as_well():
    # Other patches and another frame: the nodes agree as far as the patches do.
    shared = []
    for box in (shapely.box(0, 0, 1, 1), shapely.box(1, 0, 1.7, 1)):
        points, _, _ = nodes_of(HARMONIC, box, 0.05)
        shared.append(np.sort(points[np.abs(points[:, 0] - 1.0) < 1e-9][:, 1]))
    assert len(shared[0]) == len(shared[1]) > 20
    assert np.abs(shared[0] - shared[1]).max() <= 1e-3 * np.diff(shared[0]).min()
