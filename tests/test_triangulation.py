"""Constrained Delaunay triangulation: cover, constraints, empty circles."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st

from equimesh.domain import sides_of
from equimesh.errors import InputError
from equimesh.triangulation import constrained_delaunay

SEEDS = st.integers(0, 2**32 - 1)
DOMAINS = {
    "square": shapely.box(0, 0, 1, 1),
    "hole": shapely.Polygon(
        [(0, 0), (1, 0), (1, 1), (0, 1)], [[(0.3, 0.3), (0.6, 0.35), (0.55, 0.7), (0.3, 0.6)]]
    ),
    "comb": shapely.Polygon(
        [(0, 0), (1, 0), (1, 1), (0.8, 1), (0.8, 0.2), (0.6, 0.2), (0.6, 1), (0, 1)]
    ),
    "two": shapely.MultiPolygon([shapely.box(0, 0, 0.4, 0.5), shapely.box(0.6, 0.4, 1, 1)]),
    "island": shapely.MultiPolygon(
        [
            shapely.box(0, 0, 1, 1).difference(shapely.box(0.2, 0.2, 0.8, 0.8)),
            shapely.box(0.3, 0.3, 0.7, 0.7),
        ]
    ),
    "touching": shapely.MultiPolygon([shapely.box(0, 0, 0.5, 0.5), shapely.box(0.5, 0.5, 1, 1)]),
}


def outline(domain):
    """Distinct corners and directed boundary edges."""
    sides = sides_of(domain)
    points, number = np.unique(sides.corners, axis=0, return_inverse=True)
    number = number.ravel()
    return points, np.stack([number, number[sides.following]], 1)


def with_inner_points(domain, seed, n=40):
    points, edges = outline(domain)
    xy = np.random.default_rng(seed).uniform(0, 1, (n, 2))
    # Well inside: a point on an edge would split it.
    keep = shapely.contains_xy(domain, *xy.T) & (
        shapely.distance(domain.boundary, shapely.points(xy)) > 1e-3
    )
    return np.vstack([points, xy[keep]]), edges


def areas_of(points, triangles):
    a, b, c = points[triangles].transpose(1, 0, 2)
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def edges_of(triangles):
    return {(int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3)}


@pytest.mark.parametrize("name", DOMAINS)
@given(SEEDS)
@example(0)
def test_triangles_cover_the_domain_once_and_nothing_else(name, seed):
    domain = DOMAINS[name]
    points, boundary = with_inner_points(domain, seed)
    triangles = constrained_delaunay(points, boundary)
    areas = areas_of(points, triangles)
    assert areas.min() > 0
    assert math.fsum(areas) == pytest.approx(domain.area, rel=1e-13)
    edges = edges_of(triangles)
    assert len(edges) == 3 * len(triangles)
    border = {e for e in edges if e[::-1] not in edges}
    assert border == {(int(a), int(b)) for a, b in boundary}
    middle = points[triangles].mean(1)
    assert shapely.contains_xy(domain, *middle.T).all()
    assert len(np.unique(triangles)) == len(points)


@given(SEEDS)
@example(3)
def test_every_circle_is_empty_of_what_its_triangle_sees(seed):
    points, boundary = with_inner_points(DOMAINS["square"], seed, 60)
    triangles = constrained_delaunay(points, boundary)
    for t in triangles:
        a, b, c = points[t]
        m = np.linalg.solve(2 * np.stack([b - a, c - a]), [b @ b - a @ a, c @ c - a @ a])
        others = np.delete(np.arange(len(points)), t)
        assert np.linalg.norm(points[others] - m, axis=1).min() >= np.linalg.norm(a - m) - 1e-9


@given(SEEDS)
@example(0)
def test_constraint_lines_are_edges(seed):
    points, boundary = with_inner_points(DOMAINS["hole"], seed, 60)
    # Longest first, far from Delaunay: a chain of segments that do not cross.
    rng = np.random.default_rng(seed)
    first = len(points) - 20
    kept, lines = [], []
    for a, b in rng.permutation(np.array(np.triu_indices(20, 1)).T)[:60] + first:
        line = shapely.LineString(points[[a, b]])
        near = shapely.distance(line, shapely.points(np.delete(points, [a, b], axis=0))).min()
        free = near > 1e-6 and DOMAINS["hole"].contains(line)
        if free and not any(line.crosses(other) for other in lines):
            lines.append(line)
            kept.append((a, b))
    triangles = constrained_delaunay(points, boundary, np.array(kept, np.int64).reshape(-1, 2))
    edges = edges_of(triangles)
    assert kept
    assert all((a, b) in edges or (b, a) in edges for a, b in kept)
    assert math.fsum(areas_of(points, triangles)) == pytest.approx(DOMAINS["hole"].area, rel=1e-13)


def test_a_long_constraint_holds_against_delaunay():
    points = np.array([[0, 0], [10, 0], [10, 1], [0, 1], [5, 0.45], [5, 0.55]], float)
    boundary = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    loose = edges_of(constrained_delaunay(points, boundary))
    held = edges_of(constrained_delaunay(points, boundary, np.array([[0, 5]])))
    assert not {(0, 5), (5, 0)} & loose
    assert (0, 5) in held
    assert (5, 0) in held


def test_the_corners_alone_have_the_fewest_triangles():
    for name, count in (("square", 2), ("comb", 6), ("hole", 8), ("two", 4), ("touching", 4)):
        points, boundary = outline(DOMAINS[name])
        assert len(constrained_delaunay(points, boundary)) == count


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5], [0.5, 0.5]],
        [[0, 0], [1, 1], [1, 0], [0, 1]],
    ],
)
def test_duplicates_and_crossings_are_refused_in_one_sentence(points):
    boundary = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    with pytest.raises(InputError, match=r"^[^\n]*\.$"):
        constrained_delaunay(np.array(points, float), boundary)
