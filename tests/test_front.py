"""The transported lattice is the paper's lattice where the metric is flat."""

import math

import lattices
import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from equimesh.fields.function import Function
from equimesh.ground import nearest
from equimesh.lattice import lattice_vectors
from equimesh.metric import frame_at
from equimesh.pointtree import insert, make_tree

SQUARE = shapely.box(0, 0, 1, 1)


def map_1(x, y):
    """Example 1: y1 + i y2 is the integral of sqrt(F''), F = -i exp(5 z)."""
    w = 2 * np.exp(-0.25j * math.pi) * np.exp(2.5 * (x + 1j * y))
    return np.stack([w.real, w.imag], -1)


def map_2(x, y):
    """Example 2: sqrt(6) / (z - z0)."""
    w = math.sqrt(6) / (x - 0.5 + 1j * (y + 0.2))
    return np.stack([w.real, w.imag], -1)


def map_4(x, y):
    """Example 4: Example 2 at (x, sqrt(5) y)."""
    return map_2(x, math.sqrt(5) * y)


def map_exponentials(x, y):
    return np.stack([2 * np.exp(x / 2), 2 * np.exp(y)], -1)


FLAT = {
    "example 1": ("exp(5*x)*sin(5*y)", map_1, -1, 0.1379),
    "example 1, finer": ("exp(5*x)*sin(5*y)", map_1, -1, 0.0539),
    "example 2": ("((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2", map_2, -1, 0.0468),
    "example 2, finer": ("((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2", map_2, -1, 0.0201),
    "example 4": (
        "((x-1/2)**2-(sqrt(5)*y+1/5)**2)/((x-1/2)**2+(sqrt(5)*y+1/5)**2)**2",
        map_4,
        -1,
        0.0317,
    ),
    "convex": ("exp(x)+exp(2*y)", map_exponentials, 1, 1e-4),
}


def laid(text, tol, domain=SQUARE, gauge=None):
    """(n, 2) the vertices that the front lays, the first of them its seed."""
    start = None if gauge is None else np.array([[0.05, -0.07, gauge]])
    return lattices.laid(text, tol, domain, 20_000, start=start)


def unit(signature, tol):
    """Length of the lattice's base in y-space."""
    return math.sqrt((6 if signature > 0 else 8) * tol)


def lattice_coordinates(y, seed_basis):
    """Coordinates of y-space points in a lattice, the first point its origin."""
    return (y - y[0]) @ np.linalg.inv(seed_basis)


def basis_at_seed(text, seed, flat_map, signature, tol):
    """(2, 2) rows: the two lattice vectors in y-space, from the eigenframe at the seed.

    The eigenframe is that of H by numpy, the Jacobian of the closed form by central differences.
    """
    h = Function(text).hessian(*seed[:, None])[0]
    values, vectors = np.linalg.eigh(h)
    frame = (vectors / np.sqrt(np.abs(values)))[:, ::-1]
    step = 1e-5
    jacobian = np.stack(
        [(flat_map(*(seed + d)) - flat_map(*(seed - d))) / (2 * step) for d in step * np.eye(2)],
        1,
    )
    return math.sqrt(tol) * lattice_vectors(signature) @ (jacobian @ frame).T


def deep(flat_map, signature, tol, depth=1.3):
    """The image of the square in y-space without a band of ``depth`` spacings."""
    ring = shapely.get_coordinates(shapely.segmentize(SQUARE.exterior, 1 / 400))
    image = shapely.Polygon(flat_map(*ring.T))
    assert image.is_valid
    return image.buffer(-depth * unit(signature, tol))


def deviation(text, flat_map, signature, tol, points):
    """Distance of each deep vertex to the nearest lattice point in spacings, and which that is.

    In the band along the boundary, places that the lattice leaves free have vertices of their own.
    """
    basis = basis_at_seed(text, points[0], flat_map, signature, tol)
    y = flat_map(*points.T)
    steps = lattice_coordinates(y, basis)[shapely.contains_xy(deep(flat_map, signature, tol), *y.T)]
    whole = np.round(steps)
    return np.linalg.norm((steps - whole) @ basis, axis=1) / unit(signature, tol), whole


@pytest.mark.parametrize("case", FLAT)
def test_on_a_flat_metric_all_vertices_lie_on_the_papers_lattice(case):
    text, flat_map, signature, tol = FLAT[case]
    points = laid(text, tol)
    gap, whole = deviation(text, flat_map, signature, tol, points)
    assert len(gap) > 0.6 * len(points) > 60
    assert gap.max() <= 0.03
    # No place is taken twice.
    assert len(np.unique(whole, axis=0)) == len(whole)


@pytest.mark.parametrize("case, fine", [("example 1", 4), ("example 2", 8), ("example 4", 16)])
def test_the_deviation_falls_with_the_square_of_the_tolerance(case, fine):
    # A step of order 4 has a relative error of the fourth power of its length, tol squared.
    text, flat_map, signature, tol = FLAT[case]
    middle = []
    for part in (1, fine):
        points = laid(text, tol / part)
        gap, _ = deviation(text, flat_map, signature, tol / part, points)
        middle.append(np.median(gap))
    assert gap.max() <= 1e-3
    assert math.log(middle[0] / middle[1]) / math.log(fine) == pytest.approx(2.0, abs=0.5)


@pytest.mark.parametrize("case", FLAT)
def test_the_lattice_covers_the_domain_without_a_gap(case):
    text, flat_map, signature, tol = FLAT[case]
    points = laid(text, tol)
    y = flat_map(*points.T)
    basis = basis_at_seed(text, points[0], flat_map, signature, tol)
    steps = lattice_coordinates(y, basis)
    low, high = np.floor(steps.min(0)), np.ceil(steps.max(0))
    i, j = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    expected = y[0] + np.stack([i.ravel(), j.ravel()], 1) @ basis
    expected = expected[shapely.contains_xy(deep(flat_map, signature, tol), *expected.T)]
    distance, _ = cKDTree(y).query(expected)
    assert len(expected) > 30
    assert distance.max() <= 0.03 * unit(signature, tol)


@pytest.mark.parametrize("case", ["example 1", "convex"])
def test_a_cell_of_the_lattice_is_two_optimal_triangles(case):
    text, flat_map, signature, tol = FLAT[case]
    points = laid(text, tol)
    basis = basis_at_seed(text, points[0], flat_map, signature, tol)
    # Area of y-space is the integral of sqrt |det H|; C tol of section 2 is twice that.
    constant = 3 * math.sqrt(3) / 4 if signature > 0 else math.sqrt(5)
    assert abs(np.linalg.det(basis)) == pytest.approx(2 * 2 * constant * tol, rel=1e-6)
    edges = np.array([basis[0], basis[1], basis[1] - basis[0]])
    errors = np.abs(edges[:, 0] ** 2 + signature * edges[:, 1] ** 2) / 8
    assert errors == pytest.approx(tol if signature < 0 else 0.75 * tol, rel=1e-6)


@given(st.floats(-0.48, 0.48))  # half a period of the boost either way
@example(0.0)
@example(0.45)
@settings(max_examples=8)
def test_any_gauge_of_the_seed_lays_a_lattice(gauge):
    text, flat_map, signature, tol = FLAT["example 1"]
    points = laid(text, tol, gauge=gauge)
    basis = basis_at_seed(text, points[0], flat_map, signature, tol)
    boost = np.array([[math.cosh(gauge), math.sinh(gauge)], [math.sinh(gauge), math.cosh(gauge)]])
    inner = math.sqrt(tol) * lattice_vectors(signature)
    turn = np.linalg.solve(inner, basis)
    # Which way the second eigenvector points is free: it decides the sense of the boost.
    y = flat_map(*points.T)
    far = shapely.contains_xy(deep(flat_map, signature, tol, 2.0), *y.T)
    gaps = []
    for sense in (boost, np.linalg.inv(boost)):
        steps = lattice_coordinates(y, inner @ sense @ turn)[far]
        gaps.append(np.quantile(np.abs(steps - np.round(steps)).max(1), 0.95))
    assert min(gaps) <= 0.02
    assert len(points) > 500


@given(st.floats(0, math.pi), st.floats(0.3, 3), st.sampled_from([1, -1]))
@example(0.4, 2.0, -1)
@settings(max_examples=12)
def test_a_quadratic_has_a_straight_lattice(angle, ratio, signature):
    assume(abs(ratio - 1) > 1e-3 or signature < 0)  # else any direction is an eigenvector
    c, s = math.cos(angle), math.sin(angle)

    def f(x, y):
        return 0.5 * ((c * x + s * y) ** 2 + signature * ratio * (c * y - s * x) ** 2)

    tol = 1e-3
    points = laid(f, tol)
    frame = np.array([[c, s], [-s, c]]) * np.array([[1.0], [math.sqrt(ratio)]])
    if ratio > 1 and signature > 0:
        frame = frame[::-1]  # the first axis is that of the larger eigenvalue

    def straight(x, y):
        return np.stack([x, y], -1) @ frame.T

    y = straight(*points.T)
    lattice = math.sqrt(tol) * lattice_vectors(signature)
    far = shapely.contains_xy(deep(straight, signature, tol, 2.0), *y.T)
    # The mirror image of the lattice is the same set of points.
    for basis in (lattice, lattice * [1.0, -1.0]):
        steps = lattice_coordinates(y, basis)[far]
        assert np.abs(steps - np.round(steps)).max() <= 1e-6


@pytest.mark.parametrize("text", ["exp(2*x+y)+(x-2*y)**2", "sin(4*x)*cos(3*y)"])
def test_on_a_curved_metric_no_two_vertices_are_close_and_no_place_is_empty(text):
    tol = 2e-3
    points = laid(text, tol)
    function = Function(text)
    kernel, frame = function.kernel(SQUARE, tol), function.frame(SQUARE)
    local = frame.to_local(points)
    # Distances in the metric of each vertex to the others, and of random places to the nearest.
    rng = np.random.default_rng(0)
    for p in local[rng.choice(len(local), min(80, len(local)), replace=False)]:
        e = frame_at(kernel.frame, kernel.child, kernel.coef, *p, 8 * tol, 0.25)
        if not e[5]:
            continue
        w = np.array([[e[0], e[2]], [e[1], e[3]]])
        d = np.sort(np.linalg.norm(np.linalg.solve(w, (local - p).T), axis=0))
        assert d[1] >= 0.4
    for p in rng.uniform(-0.75, 0.75, (80, 2)):
        e = frame_at(kernel.frame, kernel.child, kernel.coef, *p, 8 * tol, 0.25)
        w = np.array([[e[0], e[2]], [e[1], e[3]]])
        if e[5]:
            assert np.linalg.norm(np.linalg.solve(w, (local - p).T), axis=0).min() <= 1.4


@given(
    seed=st.integers(0, 2**32 - 1),
    number=st.integers(1, 200),
    first=st.integers(0, 20),
    stretch=st.floats(-6, 6),
    angle=st.floats(0, math.pi),
    radius=st.floats(0.01, 2),
)
@example(seed=0, number=200, first=0, stretch=6.0, angle=0.8, radius=1.0)
def test_neighbours_in_a_metric_are_those_of_a_search_through_all(
    seed, number, first, stretch, angle, radius
):
    random = np.random.default_rng(seed)
    px, py = random.random((2, number))
    tree, link, used = make_tree(number)
    box = np.array([0.0, 0.0, 1.0])
    for i in range(number):
        insert(tree, link, used, box, px, py, i)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    w = 0.1 * turn @ np.diag([math.exp(stretch / 2), math.exp(-stretch / 2)])
    x, y = random.random(2)
    offsets = np.linalg.solve(w, np.stack([px - x, py - y]))[:, first:]
    distances = np.hypot(*offsets)
    assume(not np.isclose(distances, radius).any())
    found = [
        nearest(tree, link, box, px, py, x, y, w.ravel(), radius, first, number, any_one)
        for any_one in (False, True)
    ]
    if (distances < radius).any():
        assert found[0] == first + distances.argmin()
        assert found[1] >= first
        assert distances[found[1] - first] < radius
    else:
        assert found == [-1, -1]
