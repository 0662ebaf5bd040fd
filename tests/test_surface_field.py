"""Triangle surfaces: the error of a triangle against exact arithmetic, repair, outlines, input."""

from __future__ import annotations

from fractions import Fraction
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from equimesh.errors import InputError
from equimesh.fields import surface_kernels as kernels
from equimesh.fields.base import Field
from equimesh.fields.surface import Surface

few = settings(max_examples=60, deadline=None)

quarters = st.integers(-3, 27).map(lambda k: k / 4)
corner = st.tuples(quarters, quarters, st.integers(-9, 9).map(float))
corners = st.tuples(corner, corner, corner)
seeds = st.integers(0, 2**32 - 1)


def double_area(triangle):
    (ax, ay, *_), (bx, by, *_), (cx, cy, *_) = triangle
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def ragged(seed, count=14, side=7, missing=0.25):
    """Triangles of random points with small integer coordinates, some of them missing."""
    rng = np.random.default_rng(seed)
    places = rng.choice(side * side, count, replace=False)
    points = np.stack([places % side, places // side, rng.integers(-9, 10, count)], 1).astype(float)
    triangles = Delaunay(points[:, :2]).simplices
    area = np.array([double_area(points[t]) for t in triangles])
    triangles = triangles[(area != 0.0) & (rng.random(len(triangles)) >= missing)]
    return points, triangles


def some_surface(seed, **how):
    points, triangles = ragged(seed, **how)
    assume(len(triangles) > 0)
    return Surface(points, triangles)


def wave(n, seed=0, jitter=0.3):
    """A smooth surface over the unit square on n x n shaken points."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n)))
    inner = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    x = x + inner * rng.uniform(-jitter, jitter, n * n) / n
    y = y + inner * rng.uniform(-jitter, jitter, n * n) / n
    z = np.sin(4 * x) * np.exp(y)
    triangles = Delaunay(np.stack([x, y], 1)).simplices
    area = np.array([double_area(t) for t in np.stack([x, y], 1)[triangles]])
    return np.stack([x, y, z], 1), triangles[np.abs(area) > 1e-9]


def plane_through(triangle):
    """The linear function with the triangle's heights."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
    det = double_area(triangle)
    gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / det
    gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / det
    return lambda x, y: az + gx * (x - ax) + gy * (y - ay)


def cut(polygon, a, b):
    """The part of a convex polygon on the left of the line a-b, the line included."""
    out = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        fp, fq = double_area((a, b, p)), double_area((a, b, q))
        if fp >= 0:
            out.append(p)
        if fp * fq < 0:
            s = fp / (fp - fq)
            out.append((p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])))
    return out


def exact_error(surface, triangle):
    """Largest |surface - linear| over the closed triangle, as a Fraction.

    Both are linear where the triangle meets a surface triangle: the corners of that part decide."""
    triangle = [tuple(Fraction(c) for c in p) for p in triangle]
    plane = plane_through(triangle)
    worst = Fraction(0)
    for face in surface.triangles:
        face = [tuple(Fraction(float(c)) for c in p) for p in surface.points[face]]
        height = plane_through(face)
        part = [p[:2] for p in triangle]
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            part = cut(part, a, b) if part else part
        worst = max([worst, *(abs(height(x, y) - plane(x, y)) for x, y in part)])
    return worst


@few
@given(seeds, corners)
def test_error_of_a_triangle_equals_exact_arithmetic(seed, triangle):
    assume(double_area(triangle) != 0.0)
    surface = some_surface(seed)
    errors, bounds = surface.errors(np.array(triangle), np.array([[0, 1, 2]]))
    exact = exact_error(surface, triangle)
    assert errors[0] == pytest.approx(float(exact), rel=1e-11, abs=1e-11)
    assert Fraction(float(bounds[0])) >= exact


@few
@given(seeds, st.permutations(range(14)))
def test_error_equals_exact_arithmetic_for_corners_on_the_surface(seed, pick):
    # edges of the triangle then run through vertices and along edges of the surface
    points, triangles = ragged(seed)
    assume(len(triangles) > 0)
    triangle = [(x, y, z + k) for k, (x, y, z) in enumerate(points[list(pick[:3])])]
    assume(double_area(triangle) != 0.0)
    surface = Surface(points, triangles)
    errors, bounds = surface.errors(np.array(triangle), np.array([[0, 1, 2]]))
    exact = exact_error(surface, triangle)
    assert errors[0] == pytest.approx(float(exact), rel=1e-11, abs=1e-11)
    assert Fraction(float(bounds[0])) >= exact


def in_local(surface, triangle):
    frame = surface.frame()
    point = np.array(triangle, float)
    return np.column_stack([frame.to_local(point[:, :2]), point[:, 2]])


@few
@given(seeds, corners)
def test_edge_error_is_attained_and_never_below_dense_samples(seed, triangle):
    surface = some_surface(seed)
    F = surface.kernel()
    a, b, _ = in_local(surface, triangle)
    e, s = kernels.edge_error(F, *a, *b, np.inf)
    sample = np.linspace(0.0, 1.0, 401)
    at = a + sample[:, None] * (b - a)
    seen = np.array([kernels.value(F, x, y) - z for x, y, z in at])
    assert np.nanmax(np.append(np.abs(seen), 0.0)) <= abs(e) + 1e-9
    if e != 0.0:
        x, y, z = a + s * (b - a)
        assert kernels.value(F, x, y) - z == pytest.approx(e, abs=1e-9)
    early, _ = kernels.edge_error(F, *a, *b, 0.5 * abs(e))
    assert e == 0.0 or abs(early) > 0.5 * abs(e)


@few
@given(seeds, corners)
def test_inner_error_is_the_largest_at_vertices_inside(seed, triangle):
    assume(double_area(triangle) > 0.0)
    surface = some_surface(seed)
    F = surface.kernel()
    local = in_local(surface, triangle)
    e, x, y = kernels.inner_error(F, *local.ravel(), np.inf)
    plane = plane_through(local)
    shape = shapely.Polygon(local[:, :2])
    inside = shapely.contains_xy(shape, F.points[:, 0], F.points[:, 1])
    off = np.abs(F.points[:, 2] - plane(F.points[:, 0], F.points[:, 1]))[inside]
    assert off.max(initial=0.0) <= abs(e) + 1e-10
    if e != 0.0:
        assert shape.buffer(1e-9).contains(shapely.Point(x, y))
        assert kernels.value(F, x, y) - plane(x, y) == pytest.approx(e, abs=1e-9)
    early, *_ = kernels.inner_error(F, *local.ravel(), 0.5 * abs(e))
    assert e == 0.0 or abs(early) > 0.5 * abs(e)


@few
@given(seeds, st.floats(0.0, 6.3), st.floats(0.001, 1000.0), corners)
def test_error_does_not_see_turns_scales_and_shifts(seed, angle, scale, triangle):
    surface = some_surface(seed, missing=0.0)
    # generic corners: on the rim of the surface rounding decides what is over it
    corner = np.array(triangle) + np.random.default_rng(seed).uniform(0.01, 0.1, (3, 3))
    assume(abs(double_area(corner)) > 1e-2)
    matrix = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = scale * np.array([5e4, -4e5])

    def move(points):
        return np.column_stack([points[:, :2] @ matrix.T + shift, points[:, 2]])

    plain, _ = surface.errors(corner, np.array([[0, 1, 2]]))
    moved = Surface(move(surface.points), surface.triangles)
    there, bound = moved.errors(move(corner), np.array([[0, 1, 2]]))
    assert there == pytest.approx(plain, abs=1e-6)
    assert bound + 1e-6 >= plain


def test_error_follows_units_and_tilts():
    points, triangles = wave(12)
    rng = np.random.default_rng(1)
    mesh = np.column_stack([rng.uniform(0, 1, (40, 2)), rng.normal(size=40)])
    faces = rng.permuted(np.tile(np.arange(40), (60, 1)), axis=1)[:, :3]
    errors, _ = Surface(points, triangles).errors(mesh, faces)
    in_feet, _ = Surface(points * 4.0, triangles).errors(mesh * 4.0, faces)
    assert (in_feet == 4.0 * errors).all()
    tilt = np.outer([3.0, -2.0, 0.0], [0, 0, 1]) + np.eye(3)
    tilted, _ = Surface(points @ tilt, triangles).errors(mesh @ tilt, faces)
    assert tilted == pytest.approx(errors, abs=1e-12)


def test_surface_has_no_error_against_itself_and_planes_none_at_all():
    points, triangles = wave(20)
    surface = Surface(points, triangles)
    errors, bounds = surface.errors(surface.points, surface.triangles)
    assert errors.max() < 1e-14
    assert bounds.max() < 1e-12
    points[:, 2] = 3 * points[:, 0] - 2 * points[:, 1]
    square = np.array([[0, 0, 0], [1, 0, 3], [1, 1, 1], [0, 1, -2.0]])
    errors, _ = Surface(points, triangles).errors(square, np.array([[0, 1, 2], [2, 3, 0]]))
    assert errors.max() < 1e-14


def test_value_is_linear_in_every_triangle_and_missing_in_holes():
    points, triangles = wave(16)
    middle = points[triangles].mean(axis=1)
    hole = np.hypot(middle[:, 0] - 0.5, middle[:, 1] - 0.5) < 0.2
    surface = Surface(points, triangles[~hole])
    assert surface.value(*middle[~hole, :2].T) == pytest.approx(middle[~hole, 2], abs=1e-13)
    assert np.isnan(surface.value(*middle[hole, :2].T)).all()
    assert np.isnan(surface.value(np.array([-1.0, 2.0, np.nan]), np.zeros(3))).all()
    used = np.unique(triangles[~hole])
    assert surface.value(*points[used, :2].T) == pytest.approx(points[used, 2], abs=1e-13)
    assert isinstance(surface, Field)
    assert surface.size == f"{len(used)} vertices, {np.count_nonzero(~hole)} triangles"


def test_edges_along_the_border_see_it_from_both_ends():
    points = np.array([[0, 0, 0], [1, 0, 5], [2, 0, 0], [0, 1, 0], [2, 1, 0.0]])
    surface = Surface(points, [[0, 1, 3], [1, 4, 3], [1, 2, 4]])
    F = surface.kernel()
    a, b, _ = in_local(surface, [(0, 0, 0), (2, 0, 0), (0, 0, 0)])
    assert kernels.edge_error(F, *a, *b, np.inf) == pytest.approx((5.0, 0.5))
    assert kernels.edge_error(F, *b, *a, np.inf) == pytest.approx((5.0, 0.5))
    assert kernels.edge_error(F, *a, *a, np.inf) == (0.0, 0.0)
    far = np.array([9.0, 9.0, 0.0])
    assert kernels.edge_error(F, *far, *(far + 1), np.inf) == (0.0, 0.5)


def test_edges_find_their_way_over_gaps():
    rng = np.random.default_rng(5)
    strips = [
        np.array([[k, 0, 0], [k + 0.5, 0, 0], [k, 1, 0], [k + 0.5, 1, 0.0]]) for k in range(9)
    ]
    points = np.concatenate(strips)
    points[:, 2] = rng.normal(size=36)
    faces = np.concatenate([np.array([[0, 1, 3], [0, 3, 2]]) + 4 * k for k in range(9)])
    surface = Surface(points, faces)
    for _ in range(50):
        ends = np.column_stack([rng.uniform(-1, 10, 2), rng.uniform(-0.2, 1.2, 2), [0.0, 0.0]])
        a, b, _ = in_local(surface, [*ends, ends[0]])
        e, _ = kernels.edge_error(surface.kernel(), *a, *b, np.inf)
        at = ends[0] + np.linspace(0, 1, 5001)[:, None] * (ends[1] - ends[0])
        seen = np.abs(surface.value(at[:, 0], at[:, 1]))
        assert np.nanmax(np.append(seen, 0.0)) == pytest.approx(abs(e), abs=5e-3)
        assert np.nanmax(np.append(seen, 0.0)) <= abs(e) + 1e-12


def test_derivatives_reproduce_quadratics_to_the_border():
    points, triangles = wave(14)
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = 1 + 2 * x - y + 3 * x * x - 4 * x * y + 0.5 * y * y
    surface = Surface(points * [1, 1, 1], triangles)
    at = np.random.default_rng(3).uniform(0, 1, (60, 2)).T
    hessian = surface.hessian(*at)
    assert hessian == pytest.approx(np.tile([[6.0, -4.0], [-4.0, 1.0]], (60, 1, 1)), abs=1e-7)
    gradient = np.stack([2 + 6 * at[0] - 4 * at[1], -1 - 4 * at[0] + at[1]], axis=1)
    assert surface.gradient(*at) == pytest.approx(gradient, abs=1e-8)
    assert surface.smooth
    outside = surface.hessian(np.array([1.5]), np.array([-0.5]))[0]
    assert outside == pytest.approx(np.array([[6.0, -4.0], [-4.0, 1.0]]), abs=1e-7)


def test_hessian_converges():
    at = np.random.default_rng(2).uniform(0.2, 0.8, (200, 2)).T
    truth = -16 * np.sin(4 * at[0]) * np.exp(at[1])
    miss = []
    for n in (17, 33, 65):
        found = Surface(*wave(n)).hessian(*at)[:, 0, 0]
        miss.append(np.sqrt(np.mean((found - truth) ** 2)))
    rates = np.log2(np.array(miss[:-1]) / miss[1:])
    assert (rates > 0.8).all()  # first order on irregular points


def test_smooth_tells_waves_from_noise_and_kinks():
    points, triangles = wave(40)
    assert Surface(points, triangles).smooth
    rough = points + np.random.default_rng(0).normal(0, 1, points.shape) * [0, 0, 0.02]
    assert not Surface(rough, triangles).smooth
    kinked = points.copy()
    kinked[:, 2] = np.abs(points[:, 0] - 0.5 + 0.3 * points[:, 1])
    assert not Surface(kinked, triangles).smooth


@pytest.mark.parametrize("up", [(0, 0, 1), "z", (0.3, -0.2, 0.9), "x", (1, 2, 2), (0, 0, -1)])
def test_heights_run_along_up_and_points_go_back(up):
    points, triangles = wave(8)
    direction = np.eye(3)["xyz".index(up)] if isinstance(up, str) else np.array(up, float)
    direction /= np.linalg.norm(direction)
    # a frame whose third axis is up, built another way
    other = np.linalg.qr(np.column_stack([direction, np.eye(3)[:, :2] + 0.1]))[0]
    axes = np.stack([other[:, 1], other[:, 2], direction], axis=1)
    placed = points @ axes.T
    surface = Surface(placed, triangles, up=up)
    assert surface.points[:, 2] == pytest.approx(points[:, 2], abs=1e-12)
    assert surface.to_input(surface.points) == pytest.approx(placed, abs=1e-12)


def test_without_up_heights_run_along_z_or_the_mean_normal():
    points, triangles = wave(10)
    flat = Surface(points, triangles)
    assert (flat.to_input(points) == points).all()
    below = Surface(points, triangles[:, ::-1])
    assert np.array_equal(below.points, flat.points)
    a, b, c = below.points[below.triangles][:, :, :2].transpose(1, 0, 2)
    assert (np.linalg.det(np.stack([b - a, c - a], axis=1)) > 0).all()
    points[:, 2] *= 0.1
    standing = Surface(points @ np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), triangles)
    assert any("mean normal" in note for note in standing.notes)
    assert np.ptp(standing.points[:, 2]) < 0.5
    assert standing.to_input(standing.points) == pytest.approx(points[:, [1, 2, 0]], abs=1e-14)


def test_repairs_are_harmless_and_told():
    points, triangles = wave(9)
    plain = Surface(points, triangles)
    soup = points[triangles].reshape(-1, 3)
    faces = np.arange(len(soup)).reshape(-1, 3)
    wound = faces.copy()
    wound[::7] = wound[::7, ::-1]
    extra = np.array([[0, 0, 1], [0, 0, 0], [2, 1, 0]])
    surface = Surface(np.vstack([soup, [[np.nan, 0, 0]]]), np.vstack([wound, extra]))
    assert shapely.equals(surface.outline(0.0), plain.outline(0.0))
    assert len(surface.triangles) == len(plain.triangles)
    middle = points[triangles].mean(axis=1)
    assert surface.value(*middle[:, :2].T) == pytest.approx(middle[:, 2], abs=1e-13)
    told = " / ".join(surface.notes)
    for words in ("merged", "of no triangle", "same place", "given twice", "wound against"):
        assert words in told


def test_triangles_without_area_close_the_surface_between_others():
    # a vertex hanging on an edge, with a triangle of no area between the two sides
    points = np.array([[0, 0, 0], [2, 0, 2], [1, 0, 1], [1, 1, 0], [1, -1, 0.0]])
    surface = Surface(points, [[0, 2, 3], [2, 1, 3], [0, 1, 2], [1, 0, 4]])
    assert any("without area" in note for note in surface.notes)
    assert len(surface.triangles) == 3
    assert surface.outline(0.0).area == 2.0
    assert len(surface.outline(0.0).interiors) == 0
    F = surface.kernel()
    a, b, _ = in_local(surface, [(1, -1, 0), (1, 1, 0), (0, 0, 0)])
    assert kernels.edge_error(F, *a, *b, np.inf) == pytest.approx((1.0, 0.5))
    on_border = Surface(points, [[0, 2, 3], [2, 1, 3], [0, 1, 2]])
    assert on_border.outline(0.0).area == 1.0
    cracked = Surface(points, [[0, 2, 3], [2, 1, 3], [1, 0, 4]])
    assert cracked.outline(0.0).area == 2.0
    assert len(cracked.outline(0.0).interiors) == 0


def test_pieces_side_by_side_make_one_outline():
    # two tiles that share a side but no vertices on it
    points, triangles = wave(8)
    other, more = wave(11, seed=3)
    other = other * np.array([1, 1, 1]) + np.array([1.0, 0, 0])
    tiles = Surface(np.vstack([points, other]), np.vstack([triangles, more + len(points)]))
    outline = tiles.outline(1e-9)
    assert outline.geom_type == "Polygon"
    assert shapely.equals(outline, shapely.box(0, 0, 2, 1))
    x = np.full(50, 1.0)
    assert np.isfinite(tiles.value(x, np.linspace(0, 1, 50))).all()
    apart = Surface(
        np.vstack([points, other + np.array([0.01, 0, 0])]),
        np.vstack([triangles, more + len(points)]),
    )
    assert len(shapely.get_parts(apart.outline(1e-9))) == 2
    with pytest.raises(InputError, match="lie over one another"):
        Surface(
            np.vstack([points, other - np.array([0.01, 0, 0])]),
            np.vstack([triangles, more + len(points)]),
        )


def test_upright_triangles_are_left_out_on_the_border_only():
    points, triangles = wave(6)
    edge = np.flatnonzero(points[:, 1] == 0.0)[:2]
    top = np.vstack([points, points[edge].mean(axis=0) + np.array([0, 0, 1])])
    surface = Surface(top, np.vstack([triangles, [edge[0], len(points), edge[1]]]))
    assert any("upright" in note for note in surface.notes)
    assert len(surface.triangles) == len(triangles)


def annulus(turns, rise):
    angle = np.linspace(0, 2 * np.pi * turns, 12 * turns + 1)
    inner = np.stack([np.cos(angle), np.sin(angle), rise * angle], axis=1)
    points = np.vstack([inner, inner * [2, 2, 1]])
    k, n = np.arange(12 * turns), 12 * turns + 1
    quads = np.stack([k, k + n, k + n + 1, k + 1], axis=1)
    return points, np.vstack([quads[:, :3], quads[:, [0, 2, 3]]])


def test_surfaces_that_are_no_graph_are_refused():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    with pytest.raises(InputError, match="closed or folded"):
        Surface(sphere.vertices, sphere.faces)
    with pytest.raises(InputError, match=r"52 %.*turned over.*up="):
        Surface(sphere.vertices, sphere.faces, up="z")
    points, triangles = wave(8)
    both = np.vstack([points, points + np.array([0.3, 0.2, 1.0])])
    with pytest.raises(InputError, match=r"lie over one another .*%"):
        Surface(both, np.vstack([triangles, triangles + len(points)]))
    with pytest.raises(InputError, match="lie over one another"):
        Surface(*annulus(2, 0.1))
    Surface(*annulus(1, 0.1))
    folded = points.copy()
    folded[:, 0] = np.abs(folded[:, 0] - 0.37)
    with pytest.raises(InputError, match="turned over"):
        Surface(folded, triangles, up="z")


def test_impossible_topology_is_refused():
    fan = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0.5, 0.5, 1.0]])
    with pytest.raises(InputError, match=r"1 edge.*more than two.*near \(0\.5, 0, 0\)"):
        Surface(fan, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    n = 12
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    across = np.stack(
        [np.cos(angle) * np.cos(angle / 2), np.sin(angle) * np.cos(angle / 2), np.sin(angle / 2)], 1
    )
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    points = np.vstack([ring + 0.3 * across, ring - 0.3 * across])
    k = np.arange(n - 1)
    faces = np.vstack([np.stack([k, k + 1, k + n], 1), np.stack([k + 1, k + n + 1, k + n], 1)])
    faces = np.vstack([faces, [[n - 1, n, 2 * n - 1], [n, 0, 2 * n - 1]]])
    with pytest.raises(InputError, match="one-sided"):
        Surface(points, faces)


@pytest.mark.parametrize(
    "points, triangles, up, says",
    [
        (np.zeros((3, 2)), [[0, 1, 2]], None, "(n, 3)"),
        (np.zeros((3, 3), complex), [[0, 1, 2]], None, "(n, 3)"),
        (np.zeros((3, 3)), [[0, 1, 2, 2]], None, "(m, 3)"),
        (np.zeros((3, 3)), [[0.0, 1.0, 2.0]], None, "(m, 3)"),
        (np.eye(3), np.zeros((0, 3), int), None, "no triangles"),
        (np.eye(3), [[0, 1, 3]], None, "3 points"),
        (np.eye(3), [[0, 1, -1]], None, "vertex -1"),
        (np.eye(3) + np.array([0, 0, np.nan]), [[0, 1, 2]], None, "not finite"),
        (np.zeros((3, 3)), [[0, 1, 2]], None, "with an area"),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], None, "no"),
        (np.eye(3), [[0, 1, 2]], (0, 0, 0), "up is no vector"),
        (np.eye(3), [[0, 1, 2]], "w", "up is no vector"),
        (np.eye(3), [[0, 1, 2]], (1, -1, 0), "no area in projection"),
    ],
)
def test_bad_input_is_told_in_one_sentence(points, triangles, up, says):
    with pytest.raises(InputError) as caught:
        Surface(points, triangles, up=up)
    assert says in str(caught.value)
    assert str(caught.value).endswith(".")
    assert ". " not in str(caught.value)


def divided(surface, corners, rng):
    """(k, 3) a closed chain with more nodes on its sides, wherever these lie on the surface."""
    chain = [corners[0]]
    for a, b in pairwise(corners):
        nodes = a + np.sort(rng.random(5))[:, None] * (b - a)
        nodes[:, 2] = surface.value(nodes[:, 0], nodes[:, 1])
        chain += [*nodes[np.isfinite(nodes[:, 2])], b]
    return np.array(chain)


def chain_distances(surface, outline, rng=None):
    """How far, in space, each border vertex lies from the nearest side of the outline.

    With ``rng`` the sides are divided by nodes on the surface.
    """
    height = {tuple(p[:2]): p[2] for p in surface.points.tolist()}
    sides = []
    for ring in shapely.get_rings(shapely.get_parts(outline)):
        corner = np.array([(x, y, height[x, y]) for x, y in shapely.get_coordinates(ring)])
        corner = corner if rng is None else divided(surface, corner, rng)
        sides.append(np.stack([corner[:-1], corner[1:]], axis=1))
    a, b = np.concatenate(sides).transpose(1, 0, 2)
    exact = shapely.get_coordinates(surface.outline(0.0))
    out = []
    for x, y in exact.tolist():
        p = np.array([x, y, height[x, y]])
        s = np.clip(((p - a) * (b - a)).sum(1) / np.maximum(((b - a) ** 2).sum(1), 1e-300), 0, 1)
        out.append(np.linalg.norm(p - a - s[:, None] * (b - a), axis=1).min())
    return np.array(out)


@few
@given(seeds, st.sampled_from([0.01, 0.1, 0.5, 3.0, 100.0]))
def test_outline_stays_within_tolerance_and_keeps_its_shape(seed, tol):
    points, triangles = ragged(seed, count=70, side=12, missing=0.2)
    surface = Surface(points * [1, 1, 0.05], triangles)
    exact, outline = surface.outline(0.0), surface.outline(tol)
    area = sum(double_area(points[t]) for t in triangles) / 2
    assert exact.is_valid
    assert exact.area == pytest.approx(area)
    assert outline.is_valid
    assert chain_distances(surface, outline).max() <= tol
    assert len(shapely.get_parts(outline)) == len(shapely.get_parts(exact))
    rings = [len(shapely.get_rings(shapely.get_parts(g))) for g in (outline, exact)]
    assert rings[0] == rings[1]


@few
@given(st.integers(0, 400), st.sampled_from([0.2, 0.5]))
def test_border_stays_within_tolerance_when_nodes_on_the_surface_divide_the_outline(seed, tol):
    points, triangles = ragged(seed, count=70, side=12, missing=0.2)
    surface = Surface(points * [0.2, 0.2, 0.2], triangles)
    rng = np.random.default_rng(seed)
    assert chain_distances(surface, surface.outline(tol), rng).max() <= tol


def test_smooth_border_gets_few_vertices():
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(3 * angle)], axis=1)
    k = np.arange(400)
    disc = Surface(
        np.vstack([rim, [[0, 0, 0]]]), np.stack([k, (k + 1) % 400, np.full(400, 400)], axis=1)
    )
    outline = disc.outline(0.01)
    assert len(outline.exterior.coords) - 1 <= 40
    assert chain_distances(disc, outline).max() <= 0.01
    assert len(disc.outline(0.0).exterior.coords) - 1 == 400


def test_span_takes_in_vertices_inside_and_the_border():
    points, triangles = wave(10)
    points[:, 2] = points[:, 0] + points[:, 1]
    surface = Surface(points, triangles)
    assert surface.span(surface.outline(0.0)) == pytest.approx((0.0, 2.0))
    assert surface.span(shapely.box(0.31, 0.32, 0.41, 0.52)) == pytest.approx((0.63, 0.93))
    with pytest.raises(InputError, match="does not meet"):
        surface.span(shapely.box(5, 5, 6, 6))


def test_range_scan_with_holes_and_ragged_border():
    wheel = find_spec("pymeshlab")
    if wheel is None or wheel.origin is None:
        pytest.skip("pymeshlab, which ships the scan, is not installed")
    scan = Path(wheel.origin).parent / "tests/sample_meshes/rangemaps/face000.ply"
    mesh = trimesh.load(scan, process=False)
    surface = Surface(mesh.vertices, mesh.faces)
    assert surface.size == "85,182 vertices, 166,259 triangles"
    assert surface.notes == ("left out 667 vertices of no triangle",)
    tol = 0.01 * np.ptp(surface.points[:, 2])
    outline = surface.outline(tol)
    assert outline.is_valid
    assert chain_distances(surface, outline).max() <= tol
    a, b, c = surface.points[surface.triangles].transpose(1, 0, 2)
    u, v = b - a, c - a
    area = 0.5 * np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert surface.outline(0.0).area == pytest.approx(area, rel=1e-12)
    assert outline.area == pytest.approx(area, rel=5e-3)
    assert not surface.smooth
    assert surface.errors(surface.points, surface.triangles)[0].max() < 1e-9
