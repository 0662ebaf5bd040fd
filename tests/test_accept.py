"""The instruments of the acceptance program: what they measure is known in closed form."""

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture
def program(monkeypatch):
    """The program's modules by name."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def grid(n):
    x, y = (t.ravel() for t in np.meshgrid(*2 * [np.linspace(0.0, 1.0, n + 1)]))
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    lower, upper = [i, i + 1, i + n + 2], [i, i + n + 2, i + n + 1]
    return np.stack([x, y, x * y], 1), np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])


@pytest.mark.parametrize("k", range(8))
def test_hessians_are_second_differences(program, k):
    case = program("functions").FUNCTIONS[k]
    xmin, ymin, xmax, ymax = case.box
    rng = np.random.default_rng(k)
    x, y = rng.uniform(xmin, xmax, 300), rng.uniform(ymin, ymax, 300)
    h = 1e-4
    f = {(i, j): case(x + i * h, y + j * h) for i in (-1, 0, 1) for j in (-1, 0, 1)}
    differences = (
        f[1, 0] - 2 * f[0, 0] + f[-1, 0],
        (f[1, 1] - f[1, -1] - f[-1, 1] + f[-1, -1]) / 4,
        f[0, 1] - 2 * f[0, 0] + f[0, -1],
    )
    exact = [np.broadcast_to(part, x.shape) for part in case.jet(x, y)[3:]]
    size = max(np.abs(part).max() for part in exact)
    for found, part in zip(differences, exact, strict=True):
        assert np.abs(found / h**2 - part).max() <= 1e-4 * size


def test_the_least_count_of_the_first_example_is_known(program):
    # sqrt|det(H/2)| = 12.5 exp(5x), whose integral over the square is 2.5 (e^5 - 1).
    exact = 2.5 * (np.exp(5.0) - 1.0) / (5**0.5 * 0.1379)
    assert program("functions").FUNCTIONS[0].least(0.1379, 400) == pytest.approx(exact, rel=1e-4)


def test_errors_of_a_product_are_a_quarter_of_the_diagonals(program):
    for n in (1, 4):
        error = program("independent").function_error(lambda x, y: x * y, *grid(n))
        assert error == pytest.approx(0.25 / n**2, rel=1e-12)


def test_a_cover_is_told_from_what_is_none(program):
    fault = program("independent").cover_fault
    points, triangles = grid(5)
    box = (0.0, 0.0, 1.0, 1.0)
    assert fault(points, triangles, box) == ""
    assert "counter-clockwise" in fault(
        points, np.vstack([triangles[1:], triangles[:1, ::-1]]), box
    )
    assert "areas" in fault(points, triangles[triangles.min(axis=1) != 14], box)
    assert "same side" in fault(points, np.vstack([triangles, triangles[:1]]), box)
    assert "twice" in fault(
        np.vstack([points, points[:1]]), np.vstack([triangles, [36, 1, 8]]), box
    )
    loose = np.vstack([points, [[2.0, 2.0, 0.0]]])
    assert "no triangle" in fault(loose, triangles, box)
    moved = points.copy()
    moved[2, 1], moved[3, 1] = 0.01, -0.01
    assert "sides" in fault(moved, triangles, box)


def test_heights_are_those_of_the_triangle_below(program):
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-0.5, 1.5, (2, 5000))
    z = program("independent").interpolated(SQUARE, HALVES, x, y)
    inside = (np.abs(x - 0.5) <= 0.5) & (np.abs(y - 0.5) <= 0.5)
    assert (np.isfinite(z) == inside).all()
    assert z[inside] == pytest.approx(np.minimum(x, y)[inside], abs=1e-12)


def test_every_sample_of_a_raster_is_found_on_a_mesh(program):
    independent = program("independent")
    points, triangles = grid(12)
    heights = np.add.outer(np.arange(13.0) ** 2, np.arange(13.0))
    x, y, z = independent.bilinear_samples(heights, 4)
    assert z.reshape(49, 49)[::4, ::4] == pytest.approx(heights)
    found = independent.interpolated(points * [12, 12, 1], triangles, x, y)
    assert found == pytest.approx(x * y / 144, abs=0.25 / 144 + 1e-12)


def test_distances_are_the_shortest_in_space(program):
    independent = program("independent")
    at = np.array([[0.25, 0.75, 3.0], [-3.0, 0.0, 4.0], [1.0, 0.0, 0.0]])
    flat = SQUARE * [1, 1, 0]
    assert independent.distance_to_triangles(at, flat, HALVES) == pytest.approx([3.0, 5.0, 0.0])
    rim = independent.boundary_edges(HALVES)
    assert len(rim) == 4
    found = independent.distance_to_segments(at, flat[rim[:, 0]], flat[rim[:, 1]])
    assert found == pytest.approx([np.hypot(0.25, 3.0), 5.0, 0.0])
