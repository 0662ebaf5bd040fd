"""Profiles against brute force in exact rational arithmetic: 1,000 random triangles each."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial import Delaunay
from typer.testing import CliRunner

import equimesh
from equimesh.cli import app
from equimesh.fields.raster import Raster
from equimesh.fields.surface import Surface


def fractions_of(rows):
    return [tuple(Fraction(float(c)) for c in row) for row in rows]


def cross(a, b, p):
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def plane_through(triangle):
    a, b, c = triangle
    whole = cross(a, b, c)
    gx = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / whole
    gy = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / whole
    return lambda x, y: a[2] + gx * (x - a[0]) + gy * (y - a[1])


def cut(polygon, a, b):
    """The part of a convex polygon on the left of a-b."""
    out = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        fp, fq = cross(a, b, p), cross(a, b, q)
        if fp >= 0:
            out.append(p)
        if fp * fq < 0:
            s = fp / (fp - fq)
            out.append((p[0] + s * (q[0] - p[0]), p[1] + s * (q[1] - p[1])))
    return out


def inside(triangle, x, y):
    a, b, c = triangle
    sides = [cross(p, q, (x, y)) for p, q in ((a, b), (b, c), (c, a))]
    return min(sides) >= 0 or max(sides) <= 0


def box_of(triangle, rows, columns):
    x, y = [float(p[0]) for p in triangle], [float(p[1]) for p in triangle]
    i = range(max(int(np.floor(min(x))) - 1, 0), min(int(np.ceil(max(x))), columns - 1) + 1)
    j = range(max(int(np.floor(min(y))) - 1, 0), min(int(np.ceil(max(y))), rows - 1) + 1)
    return i, j


def exact_at_samples(heights, triangle):
    triangle = fractions_of(triangle)
    plane = plane_through(triangle)
    i_range, j_range = box_of(triangle, *heights.shape)
    errors = [
        abs(Fraction(float(heights[j, i])) - plane(i, j))
        for j in j_range
        for i in i_range
        if np.isfinite(heights[j, i]) and inside(triangle, i, j)
    ]
    return float(max(errors, default=0))


def exact_on_surface(heights, triangle):
    """On the part of the triangle in a cell the largest error is on the border of that part, where
    it is quadratic along every side."""
    triangle = fractions_of(triangle)
    if cross(*triangle) < 0:
        triangle = triangle[::-1]
    plane = plane_through(triangle)
    worst = Fraction(0)
    rows, columns = heights.shape
    i_range, j_range = box_of(triangle, rows, columns)
    for j in j_range[: rows - 1 - j_range.start]:
        for i in i_range[: columns - 1 - i_range.start]:
            h = heights[j : j + 2, i : i + 2]
            if not np.isfinite(h).all():
                continue
            h = [[Fraction(float(z)) for z in row] for row in h]

            def error(x, y, h=h, i=i, j=j):
                low = h[0][0] + (x - i) * (h[0][1] - h[0][0])
                high = h[1][0] + (x - i) * (h[1][1] - h[1][0])
                return low + (y - j) * (high - low) - plane(x, y)

            part = [p[:2] for p in triangle]
            square = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            for p, q in zip(square, square[1:] + square[:1], strict=True):
                part = cut(part, p, q) if part else part
            for p, q in zip(part, part[1:] + part[:1], strict=True):
                e0, e1 = error(*p), error(*q)
                middle = error((p[0] + q[0]) / 2, (p[1] + q[1]) / 2)
                bulge = 2 * (e0 + e1) - 4 * middle
                worst = max(worst, abs(e0), abs(e1))
                if abs(e1 - e0) < abs(bulge):
                    worst = max(worst, abs(middle - (e1 - e0) ** 2 / (4 * bulge)))
    return float(worst)


def exact_over_triangles(points, faces, triangle):
    """Two piecewise linear functions: the corners of the overlay decide."""
    triangle = fractions_of(triangle)
    if cross(*triangle) < 0:
        triangle = triangle[::-1]
    plane = plane_through(triangle)
    worst = Fraction(0)
    low = np.array(triangle, float)[:, :2].min(axis=0)
    high = np.array(triangle, float)[:, :2].max(axis=0)
    corners = points[faces][:, :, :2]
    near = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    for face in faces[near]:
        face = fractions_of(points[face])
        height = plane_through(face)
        part = [p[:2] for p in triangle]
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            part = cut(part, a, b) if part else part
        worst = max([worst, *(abs(height(x, y) - plane(x, y)) for x, y in part)])
    return float(worst)


def some_triangles(rng, count, width, height, most):
    """(count, 3, 3) small and large, corners on samples, on grid lines or anywhere."""
    centre = rng.uniform([0, 0], [width, height], (count, 1, 2))
    corners = centre + rng.uniform(-1, 1, (count, 3, 2)) * rng.uniform(0.3, most, (count, 1, 1))
    kind = rng.integers(0, 4, (count, 3))
    corners = np.where((kind == 0)[..., None], np.round(corners), corners)
    corners[..., 0] = np.where(kind == 1, np.round(corners[..., 0]), corners[..., 0])
    z = rng.normal(0, 5, (count, 3, 1))
    triangles = np.concatenate([corners, z], axis=2)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return triangles[np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) > 1e-3]


def as_mesh(triangles):
    return triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def close(found, exact, size):
    """To 1e-12 of the heights that errors are differences of."""
    return np.abs(found - exact) <= 1e-12 * size


@pytest.mark.parametrize("missing", [0.0, 0.1])
def test_profile_over_a_raster_equals_exact_arithmetic_everywhere_and_at_samples(missing):
    rng = np.random.default_rng(7)
    heights = rng.normal(0, 5, (23, 29))
    heights[rng.random(heights.shape) < missing] = np.nan
    field = Raster(heights)
    triangles = some_triangles(rng, 520, 28, 22, 3.0)[:500]
    assert len(triangles) == 500
    mesh = as_mesh(triangles)
    size = np.abs(triangles[:, :, 2]).max() + np.nanmax(np.abs(heights))
    everywhere = equimesh.profile(*mesh, field)
    exact = np.array([exact_on_surface(field.heights, t) for t in triangles])
    assert close(everywhere.errors, exact, size).all()
    assert (everywhere.bounds >= exact).all()
    at_samples = equimesh.profile(*mesh, field, "samples")
    exact = np.array([exact_at_samples(field.heights, t) for t in triangles])
    assert close(at_samples.errors, exact, size).all()
    assert (at_samples.bounds >= exact).all()
    assert (at_samples.errors <= everywhere.bounds).all()
    assert (at_samples.over, everywhere.over) == ("samples", "surface")


def test_profile_over_a_surface_equals_exact_arithmetic():
    rng = np.random.default_rng(8)
    xy = rng.uniform(0, 10, (260, 2))
    faces = Delaunay(xy).simplices
    points = np.column_stack([xy, rng.normal(0, 5, len(xy))])
    surface = Surface(points, faces[rng.random(len(faces)) > 0.05])
    triangles = some_triangles(rng, 1200, 10, 10, 1.2)[:1000]
    assert len(triangles) == 1000
    size = np.abs(triangles[:, :, 2]).max() + np.abs(points[:, 2]).max()
    found = equimesh.profile(*as_mesh(triangles), surface)
    exact = [exact_over_triangles(surface.points, surface.triangles, t) for t in triangles]
    assert close(found.errors, np.array(exact), size).all()
    assert (found.bounds >= exact).all()


def test_samples_on_an_edge_belong_to_its_triangles_however_it_runs():
    heights = np.zeros((9, 9))
    heights[4, 4] = 3.0
    square = np.array([[0, 0, 0], [8, 0, 0], [8, 8, 0], [0, 8, 0.0]])
    for faces in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]):
        errors = equimesh.profile(square, faces, heights, "samples").errors
        assert (errors == 3.0).all()
    # and through any map, where rounding moves the edge to either side of the sample
    for angle in np.linspace(0.1, 6.0, 17):
        a, b = 0.3 * np.cos(angle), 0.3 * np.sin(angle)
        field = Raster(heights, (a, -b, 5e6, b, a, 4e6), bound="samples")
        corners = np.column_stack([square[:, :2] @ [[a, b], [-b, a]] + [5e6, 4e6], square[:, 2]])
        errors = equimesh.profile(corners, [[0, 1, 2], [0, 2, 3]], field).errors
        assert errors == pytest.approx([3.0, 3.0])


def test_smallest_angles_are_in_degrees():
    points = [[0, 0, 5], [1, 0, 0], [0, 1, 0], [0, 0.5, 0], [0.5, 3**0.5 / 2, 7]]
    faces = [[0, 1, 2], [0, 1, 3], [0, 1, 4]]
    angles = equimesh.profile(points, faces, "x").angles
    assert angles == pytest.approx([45.0, np.degrees(np.arctan(0.5)), 60.0])


def test_command_profiles_the_mesh_of_another_tool_at_samples_and_between(tmp_path, monkeypatch):
    pydelatin = pytest.importorskip("pydelatin")
    meshio = pytest.importorskip("meshio")
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:60, :70]
    heights = 20 * np.sin(x / 9) * np.cos(y / 7) + rng.normal(0, 1, x.shape)
    np.save("dem.npy", heights)
    tin = pydelatin.Delatin(heights.astype(np.float32), max_error=2.0)
    points = np.array(tin.vertices, float)
    points[:, 1] = 59 - points[:, 1]  # pydelatin counts rows from below
    cells = np.asarray(tin.triangles, np.int64)
    reports = []
    for name in ("tin.ply", "tin.obj", "tin.vtu"):
        meshio.write_points_cells(name, points, [("triangle", cells)])
        words = ["profile", name, "--against", "dem.npy", "--report", "r.json"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        assert "largest error at samples" in done.output
        assert "smallest angles" in done.output
        reports.append(json.loads((tmp_path / "r.json").read_text()))
    np.savez("tin.npz", points=points, triangles=cells)
    CliRunner().invoke(app, ["profile", "tin.npz", "--against", "dem.npy", "--report", "r.json"])
    reports.append(json.loads((tmp_path / "r.json").read_text()))
    measured = equimesh.profile(points, cells, heights)
    for report in reports:
        assert report["bound"] == "surface"
        assert report["max_error_at_samples"] <= 2.0 + 1e-5 < report["max_error"]
        assert report["max_error"] == pytest.approx(measured.max, rel=1e-6)
        assert report["smallest_angles"]["0"] == pytest.approx(measured.angles.min(), rel=1e-6)
    words = [
        "profile",
        "tin.npz",
        "--against",
        "dem.npy",
        "--bound",
        "samples",
        "--report",
        "s.json",
    ]
    done = CliRunner().invoke(app, words)
    report = json.loads((tmp_path / "s.json").read_text())
    assert report["bound"] == "samples"
    assert report["max_error"] == reports[0]["max_error_at_samples"]
