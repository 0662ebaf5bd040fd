"""Rasters: the error of a triangle against exact arithmetic, outlines, derivatives, bad input."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from equimesh.errors import InputError
from equimesh.fields import raster_kernels as kernels
from equimesh.fields.base import Field
from equimesh.fields.raster import Raster

few = settings(max_examples=60, deadline=None)

quarters = st.integers(-3, 19).map(lambda k: k / 4)
off_lines = st.integers(-500, 4500).map(lambda k: k / 1000 + 1 / 3000)
corner = st.tuples(quarters, quarters, st.integers(-9, 9).map(float))
corners = st.tuples(corner, corner, corner)
seeds = st.integers(0, 2**32 - 1)


def grid(seed, rows=5, columns=5, missing=0.2):
    """Small integer heights, some of them missing, with at least one valid cell."""
    rng = np.random.default_rng(seed)
    heights = rng.integers(-9, 10, (rows, columns)).astype(float)
    heights[rng.random((rows, columns)) < missing] = np.nan
    heights[:2, :2] = 1.0
    return heights


def plane_through(triangle):
    """The linear function with the triangle's heights, in exact arithmetic."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = triangle
    det = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    gx = ((bz - az) * (cy - ay) - (cz - az) * (by - ay)) / det
    gy = ((cz - az) * (bx - ax) - (bz - az) * (cx - ax)) / det
    return lambda x, y: az + gx * (x - ax) + gy * (y - ay)


def cut(polygon, inside):
    """The part of a convex polygon where the linear function ``inside`` is not negative."""
    out = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        fp, fq = inside(*p), inside(*q)
        if fp >= 0:
            out.append(p)
        if fp * fq < 0:
            s = fp / (fp - fq)
            out.append((p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])))
    return out


def exact_error(heights, triangle):
    """Largest |bilinear - linear| over closed triangle and closed valid cells, as a Fraction.

    On the part of the triangle in a cell it is attained on the border of that part, where it is
    quadratic along every side."""
    triangle = [tuple(Fraction(c) for c in p) for p in triangle]
    plane = plane_through(triangle)
    worst = Fraction(0)
    rows, columns = heights.shape
    for j in range(rows - 1):
        for i in range(columns - 1):
            h = heights[j : j + 2, i : i + 2]
            if not np.isfinite(h).all():
                continue
            h = [[Fraction(float(z)) for z in row] for row in h]

            def error(x, y, h=h, i=i, j=j):
                u, v = x - i, y - j
                low = h[0][0] + u * (h[0][1] - h[0][0])
                high = h[1][0] + u * (h[1][1] - h[1][0])
                return low + v * (high - low) - plane(x, y)

            part = [p[:2] for p in triangle]
            part = cut(part, lambda x, y, i=i: x - i)
            part = cut(part, lambda x, y, i=i: i + 1 - x)
            part = cut(part, lambda x, y, j=j: y - j)
            part = cut(part, lambda x, y, j=j: j + 1 - y)
            for p, q in zip(part, part[1:] + part[:1], strict=True):
                e0, e1 = error(*p), error(*q)
                middle = error((p[0] + q[0]) / 2, (p[1] + q[1]) / 2)
                bulge = 2 * (e0 + e1) - 4 * middle
                worst = max(worst, abs(e0), abs(e1))
                if abs(e1 - e0) < abs(bulge):
                    worst = max(worst, abs(middle - (e1 - e0) ** 2 / (4 * bulge)))
    return worst


def double_area(triangle):
    (ax, ay, _), (bx, by, _), (cx, cy, _) = triangle
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@few
@given(seeds, corners)
def test_error_of_a_triangle_equals_exact_arithmetic(seed, triangle):
    assume(double_area(triangle) != 0.0)
    heights = grid(seed)
    field = Raster(heights)
    errors, bounds = field.errors(np.array(triangle), np.array([[0, 1, 2]]))
    exact = exact_error(field.heights, triangle)
    assert errors[0] == pytest.approx(float(exact), rel=1e-11, abs=1e-11)
    assert Fraction(float(bounds[0])) >= exact


@few
@given(seeds, st.lists(off_lines, min_size=6, max_size=6))
def test_error_equals_exact_arithmetic_away_from_grid_lines(seed, xy):
    triangle = [(xy[0], xy[1], 3.0), (xy[2], xy[3], -2.0), (xy[4], xy[5], 0.0)]
    assume(abs(double_area(triangle)) > 1e-3)
    field = Raster(grid(seed, missing=0.1))
    errors, bounds = field.errors(np.array(triangle), np.array([[2, 1, 0]]))
    exact = exact_error(field.heights, triangle)
    assert errors[0] == pytest.approx(float(exact), rel=1e-9, abs=1e-9)
    assert Fraction(float(bounds[0])) >= exact


@few
@given(seeds, corners)
def test_edge_error_is_attained_and_never_below_dense_samples(seed, triangle):
    (ax, ay, az), (bx, by, bz), _ = triangle
    F = Raster(grid(seed)).kernel()
    e, s = kernels.edge_error(F, ax, ay, az, bx, by, bz, np.inf)
    sample = np.linspace(0.0, 1.0, 401)
    surface = np.array([kernels.value(F, ax + t * (bx - ax), ay + t * (by - ay)) for t in sample])
    seen = np.abs(surface - (az + sample * (bz - az)))
    assert np.nanmax(np.append(seen, 0.0)) <= abs(e) + 1e-10
    if e != 0.0:
        there = kernels.value(F, ax + s * (bx - ax), ay + s * (by - ay))
        assert there - (az + s * (bz - az)) == pytest.approx(e, abs=1e-10)
    stop = 0.5 * abs(e)
    early, _ = kernels.edge_error(F, ax, ay, az, bx, by, bz, stop)
    assert e == 0.0 or abs(early) > stop


@few
@given(seeds, corners)
def test_inner_error_is_the_largest_at_samples_inside(seed, triangle):
    assume(double_area(triangle) > 0.0)
    heights = Raster(grid(seed)).heights
    F = Raster(heights).kernel()
    e, x, y = kernels.inner_error(F, *np.ravel(triangle), np.inf)
    plane = plane_through(triangle)
    shape = shapely.Polygon(np.array(triangle)[:, :2])
    inside = [
        abs(heights[j, i] - plane(i, j))
        for j, i in np.argwhere(np.isfinite(heights))
        if shape.contains(shapely.Point(i, j))
    ]
    assert max(inside, default=0.0) <= abs(e) + 1e-10
    if e != 0.0:
        assert shape.buffer(1e-9).contains(shapely.Point(x, y))
        assert kernels.value(F, x, y) - plane(x, y) == pytest.approx(e, abs=1e-10)


@few
@given(seeds, corners)
def test_bilinear_surface_is_the_bilinear_polynomial_whatever_the_grid(seed, triangle):
    # sampled on 2 x 2 or on 17 x 17 nodes, a + b x + c y + d x y is one and the same surface
    assume(double_area(triangle) != 0.0)
    a, b, c, d = np.random.default_rng(seed).integers(-8, 9, 4)
    x, y = np.meshgrid(np.linspace(0, 4, 17), np.linspace(0, 4, 17))
    fine = Raster(a + b * x + c * y + d * x * y, (0.25, 0, 0, 0, 0.25, 0))
    coarse = Raster(fine.heights[::16, ::16], (4, 0, 0, 0, 4, 0))
    point = np.array(triangle)
    for one, other in zip(
        fine.errors(point, np.array([[0, 1, 2]])),
        coarse.errors(point, np.array([[0, 1, 2]])),
        strict=True,
    ):
        assert one == pytest.approx(other, rel=1e-11, abs=1e-11)


@few
@given(seeds, st.floats(0.0, 6.3), st.floats(0.01, 100.0), st.floats(0.3, 3.0), corners)
def test_error_does_not_see_affine_maps(seed, angle, scale, aspect, triangle):
    assume(abs(double_area(triangle)) > 0.0)
    # generic corners: on the rim of a gap, rounding decides what is over it
    point = np.array(triangle) + np.random.default_rng(seed).uniform(0.01, 0.1, (3, 3))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix = scale * turn @ np.diag([1.0, -aspect])
    origin = np.array([5e5, -4e6])
    (a, b), (d, e) = matrix
    moved = point.copy()
    moved[:, :2] = origin + point[:, :2] @ matrix.T
    heights = grid(seed, missing=0.0)
    plain, _ = Raster(heights).errors(point, np.array([[0, 1, 2]]))
    field = Raster(heights, (a, b, origin[0], d, e, origin[1]))
    there, bound = field.errors(moved, np.array([[0, 1, 2]]))
    assert there == pytest.approx(plain, abs=1e-4 / scale)
    assert bound >= plain


def test_error_scales_with_heights_and_keeps_shape_under_tilts():
    rng = np.random.default_rng(4)
    heights = rng.normal(size=(9, 11))
    points = np.column_stack([rng.uniform(0, 8, (30, 2)), rng.normal(size=30)])
    triangles = rng.permuted(np.tile(np.arange(30), (40, 1)), axis=1)[:, :3]
    errors, _ = Raster(heights).errors(points, triangles)
    scaled, _ = Raster(8.0 * heights).errors(points * [1, 1, 8.0], triangles)
    assert (scaled == 8.0 * errors).all()
    x, y = np.meshgrid(np.arange(11), np.arange(9))
    tilted = points + np.outer(points @ [3.0, -2.0, 0.0], [0, 0, 1])
    same, _ = Raster(heights + 3.0 * x - 2.0 * y).errors(tilted, triangles)
    assert same == pytest.approx(errors, abs=1e-12)


def test_mesh_of_a_plane_has_no_error():
    x, y = np.meshgrid(np.arange(9), np.arange(8))
    field = Raster(2 * x - 3 * y + 1)
    points = np.array([[0, 0, 1.0], [8, 0, 17], [8, 7, -4], [0, 7, -20]])
    errors, bounds = field.errors(points, np.array([[0, 1, 2], [0, 2, 3]]))
    assert (errors < 1e-13).all()
    assert (bounds < 1e-11).all()
    assert field.smooth


def test_error_is_the_same_whatever_the_number_of_threads(monkeypatch):
    rng = np.random.default_rng(0)
    field = Raster(rng.normal(size=(40, 40)))
    points = rng.uniform(0, 39, (900, 3))
    triangles = rng.integers(0, 900, (6000, 3))
    one = field.errors(points, triangles)[0]
    monkeypatch.setattr("numba.config.NUMBA_NUM_THREADS", 1)
    assert (field.errors(points, triangles)[0] == one).all()


def test_edge_along_a_gap_belongs_to_the_valid_side():
    heights = np.zeros((4, 4))
    heights[:, 3] = np.nan
    heights[1, 2] = 5.0
    F = Raster(heights).kernel()
    for x in (2.0, 2.0 + 1e-15, 2.0 - 1e-15):
        up = kernels.edge_error(F, x, 0.0, 0.0, x, 3.0, 0.0, np.inf)
        down = kernels.edge_error(F, x, 3.0, 0.0, x, 0.0, 0.0, np.inf)
        assert up == pytest.approx((5.0, 1 / 3))
        assert down == pytest.approx((5.0, 2 / 3))
    assert kernels.edge_error(F, 2.5, 0.0, 9.0, 2.5, 3.0, 9.0, np.inf) == (0.0, 0.5)
    assert kernels.edge_error(F, 2.0, 1.0, 1.0, 2.0, 1.0, 1.0, np.inf)[0] == 4.0


def test_sliver_error_keeps_full_accuracy():
    # across one diagonal of z = x y the error is s (1 - s), on a triangle 1e-9 wide
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    field = Raster(x * y)
    points = np.array([[0, 0, 0], [8, 8, 64], [4, 4 + 1e-9, 4 * (4 + 1e-9)]])
    errors, _ = field.errors(points, np.array([[0, 1, 2]]))
    assert errors[0] == pytest.approx(16.0, rel=1e-12)


@few
@given(seeds)
def test_outline_covers_exactly_the_valid_cells(seed):
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((9, 8)) < 0.15, np.nan, 0.0)
    heights[:2, :2] = 0.0
    field = Raster(heights, (2, 0, 10, 0, -3, 20))
    outline = field.outline(0.0)
    assert outline.is_valid
    filled = np.isfinite(field.heights)
    cells = filled[:-1, :-1] & filled[1:, :-1] & filled[:-1, 1:] & filled[1:, 1:]
    assert outline.area == 6.0 * np.count_nonzero(cells)
    row, column = np.indices(cells.shape)
    x, y = 10 + 2 * (column + 0.5), 20 - 3 * (row + 0.5)
    assert (shapely.contains_xy(outline, x, y) == cells).all()
    assert (np.isfinite(field.value(x.ravel(), y.ravel())) == cells.ravel()).all()
    for ring in shapely.get_rings(shapely.get_parts(outline)):
        steps = np.diff(shapely.get_coordinates(ring), axis=0)
        steps = np.vstack([steps, steps[:1]])
        assert all(np.linalg.det([p, q]) != 0.0 for p, q in pairwise(steps))


def test_outline_of_a_full_raster_is_its_rectangle():
    outline = Raster(np.zeros((344, 403), np.int16)).outline(0.0)
    assert outline.equals(shapely.box(0, 0, 402, 343))
    assert len(outline.exterior.coords) == 5


def test_span_takes_in_samples_inside_and_the_border():
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    field = Raster(x * y)
    assert field.span(shapely.box(0, 0, 5, 5)) == (0.0, 25.0)
    low, high = field.span(shapely.Polygon([(1.5, 1.5), (2.5, 1.5), (2.5, 2.5), (1.5, 2.5)]))
    assert (low, high) == pytest.approx((2.25, 6.25))
    with pytest.raises(InputError, match="meets no valid cell"):
        field.span(shapely.box(90, 90, 91, 91))


def test_derivatives_reproduce_cubics_through_any_transform():
    rng = np.random.default_rng(1)
    transform = (0.3, 0.1, 7.0, -0.2, 0.4, -3.0)
    column, row = np.meshgrid(np.arange(12), np.arange(15))
    x = 0.3 * column + 0.1 * row + 7.0
    y = -0.2 * column + 0.4 * row - 3.0
    field = Raster(x**3 - 2 * x * x * y + x * y * y + 4 * y**3 - x, transform)
    at = rng.uniform([2, 2], [9, 12], (20, 2))
    x, y = 0.3 * at[:, 0] + 0.1 * at[:, 1] + 7.0, -0.2 * at[:, 0] + 0.4 * at[:, 1] - 3.0
    gradient = np.stack([3 * x * x - 4 * x * y + y * y - 1, -2 * x * x + 2 * x * y + 12 * y * y], 1)
    assert field.gradient(x, y) == pytest.approx(gradient, rel=1e-9, abs=1e-8)
    hessian = np.stack([6 * x - 4 * y, -4 * x + 2 * y, -4 * x + 2 * y, 2 * x + 24 * y], 1)
    assert field.hessian(x, y).reshape(-1, 4) == pytest.approx(hessian, rel=1e-7, abs=1e-6)


def test_hessian_converges_with_the_second_order():
    at = np.random.default_rng(2).uniform(0.3, 0.7, (50, 2)).T
    truth = -np.sin(5 * at[0]) * np.exp(at[1])
    miss = []
    for n in (17, 33, 65):
        x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
        field = Raster(np.sin(5 * x) * np.exp(y), (1 / (n - 1), 0, 0, 0, 1 / (n - 1), 0))
        miss.append(np.abs(field.hessian(*at)[:, 0, 0] - 25 * truth).max())
    rates = np.log2(np.array(miss[:-1]) / miss[1:])
    assert (rates > 1.7).all()


def test_derivatives_of_two_by_two_samples_are_those_of_the_bilinear_surface():
    field = Raster([[0.0, 1.0], [2.0, 7.0]])
    x, y = np.array([0.25]), np.array([0.5])
    assert field.gradient(x, y)[0] == pytest.approx([3.0, 3.0])
    assert field.hessian(x, y)[0] == pytest.approx(np.array([[0.0, 4.0], [4.0, 0.0]]), abs=1e-12)


def test_smooth_tells_functions_from_noise_and_kinks():
    x, y = np.meshgrid(np.linspace(0, 1, 128), np.linspace(0, 1, 128))
    f = np.sin(6 * x) * np.exp(y)
    assert Raster(f).smooth
    assert Raster(f.astype(np.float32)).smooth
    assert not Raster(f + np.random.default_rng(0).normal(0, 1e-2, f.shape)).smooth
    assert not Raster(np.abs(f - 1.0)).smooth


def test_real_terrain_is_not_smooth():
    matplotlib = pytest.importorskip("matplotlib.cbook")
    dem = matplotlib.get_sample_data("jacksboro_fault_dem.npz")
    assert not Raster(dem["elevation"]).smooth


def test_samples_of_no_valid_cell_are_left_out():
    heights = np.zeros((5, 5))
    heights[2, :] = np.nan
    heights[3:, 1:4] = np.nan
    heights[:2, 4] = np.nan
    field = Raster(heights)
    assert np.isfinite(field.heights).sum() == 8
    assert field.size == "5 x 5 samples"
    assert isinstance(field, Field)


def test_integers_masks_and_nodata_mean_the_same():
    heights = np.arange(12, dtype=np.int16).reshape(3, 4)
    heights[1, 3] = -999
    plain = np.where(heights == -999, np.nan, heights.astype(float))
    for field in (
        Raster(heights, nodata=-999),
        Raster(np.ma.masked_equal(heights, -999)),
        Raster(plain),
        Raster(np.where(np.isnan(plain), -np.inf, plain), nodata=-np.inf),
    ):
        assert np.array_equal(field.heights, Raster(plain).heights, equal_nan=True)
        assert field.heights.flags.c_contiguous


@pytest.mark.parametrize(
    "heights, transform, says",
    [
        (np.zeros(5), None, "2-D"),
        (np.zeros((2, 2, 2)), None, "2-D"),
        (np.zeros((1, 5)), None, "2 x 2"),
        (np.zeros((0, 0)), None, "2 x 2"),
        (np.full((3, 3), np.nan), None, "no valid cell"),
        ([[0, np.nan], [1, 2.0]], None, "no valid cell"),
        ([[0, np.inf], [1, 2.0]], None, "infinite"),
        (np.array([["a", "b"], ["c", "d"]]), None, "integers or real numbers"),
        (np.array([[None, 1], [2, 3]], dtype=object), None, "integers or real numbers"),
        (np.zeros((3, 3), complex), None, "integers or real numbers"),
        (np.zeros((3, 3)), (1, 2, 3), "six numbers"),
        (np.zeros((3, 3)), "abcdef", "six numbers"),
        (np.zeros((3, 3)), (1, 2, 0, 1, 2, 0), "parallel"),
        (np.zeros((3, 3)), (1, 0, np.nan, 0, 1, 0), "not finite"),
    ],
)
def test_bad_input_is_told_in_one_sentence(heights, transform, says):
    with pytest.raises(InputError, match=says) as caught:
        Raster(heights, transform)
    assert str(caught.value).endswith(".")
    assert ". " not in str(caught.value)
