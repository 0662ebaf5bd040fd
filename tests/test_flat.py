"""The paper's two strategies, section 4: counts, error levels and constants."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from equimesh import local
from equimesh.errors import InputError
from equimesh.flat import flat_mesh
from equimesh.lattice import VARIANTS, lattice_vectors
from equimesh.transform import FlatMap

SQUARE = (0.0, 0.0, 1.0, 1.0)
EXAMPLES = {
    1: "exp(5*x)*sin(5*y)",
    2: "((x-1/2)**2-(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**2",
    3: "(((x-1/2)**2+(y+1/5)**2)**2-8*(x-1/2)**2*(y+1/5)**2)/((x-1/2)**2+(y+1/5)**2)**4",
    4: "((x-1/2)**2-(sqrt(5)*y+1/5)**2)/((x-1/2)**2+(sqrt(5)*y+1/5)**2)**2",
}
CONVEX = "exp(2*x+y)+(x-2*y)**2"


def errors_of(mesh, n=24):
    """(m,) largest error of each triangle at a barycentric grid of n subdivisions."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    keep = i + j <= n
    weights = np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n
    at = np.einsum("wi,tik->twk", weights, mesh.points[mesh.triangles])
    exact = mesh.flat_map.source.value(at[..., 0].ravel(), at[..., 1].ravel())
    return np.abs(exact.reshape(at.shape[:2]) - at[..., 2]).max(axis=1)


def integral_of_root(mesh):
    """I = integral of sqrt|det(H / 2)| over the unit square."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t = 0.5 * (nodes + 1.0)
    x, y = (v.ravel() for v in np.meshgrid(t, t))
    form = local.quadratic_form(mesh.flat_map.source.hessian(x, y))
    return float(np.sqrt(np.abs(np.linalg.det(form))) @ np.outer(weights, weights).ravel() / 4)


@pytest.mark.parametrize(
    "example,tol,count,slack,spread",
    [
        (1, 0.1379, 1098, 0.03, 0.03),
        (1, 0.0539, 2933, 0.03, 0.03),
        (2, 0.0468, 436, 0.03, 0.03),
        (2, 0.02009, 1072, 0.03, 0.03),
        (3, 2.366, 300, 0.03, 0.5),
        (3, 1.16, 650, 0.03, 0.5),
        (4, 0.1246, 162, 0.03, 0.1),
        (4, 0.03169, 711, 0.06, 0.1),
    ],
)
def test_optimal_shapes_inside_the_square_number_as_in_the_paper(
    example, tol, count, slack, spread
):
    flat_map = FlatMap(EXAMPLES[example], SQUARE)
    offsets = [(a / 5, b / 5) for a in range(5) for b in range(5)]
    meshes = [flat_mesh(flat_map, None, tol, offset=offset) for offset in offsets]
    best = max(meshes, key=lambda mesh: len(mesh.triangles))
    errors = errors_of(best)
    assert len(best.triangles) == pytest.approx(count, rel=slack)
    assert np.median(errors) == pytest.approx(tol, rel=5e-3)
    assert errors.max() / errors.min() - 1.0 <= spread


@pytest.mark.parametrize("example,tol", [(1, 0.06644), (2, 0.02181), (3, 1.567), (4, 0.04237)])
def test_an_equilateral_cover_has_the_constant_sqrt3(example, tol):
    mesh = flat_mesh(EXAMPLES[example], SQUARE, tol, "equilateral", "full")
    areas = local.area(mesh.points[:, :2][mesh.triangles])
    assert areas.min() > 0.0
    assert areas.sum() == pytest.approx(1.0, rel=1e-12)
    median = float(np.median(errors_of(mesh)))
    constant = integral_of_root(mesh) / (len(mesh.triangles) * median)
    assert constant == pytest.approx(math.sqrt(3.0), rel=0.02)


def test_a_full_cover_by_optimal_shapes_holds_the_tolerance_everywhere():
    equilateral = flat_mesh(EXAMPLES[1], SQUARE, 0.2, "equilateral", "full")
    tol = float(errors_of(equilateral).max())
    mesh = flat_mesh(equilateral.flat_map, None, tol, "optimal", "full")
    areas = local.area(mesh.points[:, :2][mesh.triangles])
    assert areas.min() > 0.0
    assert areas.sum() == pytest.approx(1.0, rel=1e-9)
    assert errors_of(mesh).max() <= tol
    assert len(mesh.triangles) < len(equilateral.triangles)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("theta", [0.0, 0.3])
def test_all_six_shapes_have_level_errors(variant, theta):
    mesh = flat_mesh(EXAMPLES[1], SQUARE, 0.02, variant=variant, theta=theta)
    errors = errors_of(mesh)
    assert errors.min() == pytest.approx(0.02, rel=0.02)
    # The longest of the six have their base boosted against the apex: 4 and 5 at theta = 0.3.
    assert errors.max() == pytest.approx(0.02, rel=0.15)


def test_errors_become_level_at_the_rate_of_the_tolerance():
    # The lattice is exact for quadratics; the cubic part enters symmetric edges at second order.
    flat_map = FlatMap(EXAMPLES[1], SQUARE)
    tolerances = np.array([0.4, 0.1, 0.025])
    spread = [np.ptp(errors_of(flat_mesh(flat_map, None, t), 48)) / t for t in tolerances]
    slope = np.polyfit(np.log(tolerances), np.log(spread), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.35)


def test_a_convex_function_gets_equilateral_triangles_and_their_constant():
    tol = 2e-3
    mesh = flat_mesh(CONVEX, SQUARE, tol)
    errors = errors_of(mesh)
    assert errors == pytest.approx(tol, rel=0.05)
    areas = local.area(mesh.points[:, :2][mesh.triangles])
    middle = mesh.points[:, :2][mesh.triangles].mean(axis=1)
    form = local.quadratic_form(mesh.flat_map.source.hessian(*middle.T))
    constant = np.sqrt(np.linalg.det(form)) * areas / errors
    assert np.median(constant) == pytest.approx(3 * math.sqrt(3) / 4, rel=5e-3)


@pytest.mark.parametrize("cover,shape", [("interior", "optimal"), ("full", "equilateral")])
def test_holes_and_notches_are_respected(cover, shape):
    domain = shapely.Polygon(
        [(0, 0), (1, 0), (1, 0.4), (0.5, 0.4), (0.5, 1), (0, 1)],
        [[(0.1, 0.1), (0.3, 0.1), (0.3, 0.3), (0.1, 0.25)]],
    )
    mesh = flat_mesh(EXAMPLES[2], domain, 0.01, shape, cover)
    triangles = shapely.polygons(mesh.points[:, :2][mesh.triangles])
    assert (shapely.area(shapely.difference(triangles, domain)) <= 1e-12).all()
    total = shapely.area(triangles).sum()
    assert total == pytest.approx(shapely.union_all(triangles).area, rel=1e-9)
    if cover == "full":
        assert total == pytest.approx(domain.area, rel=1e-12)
    else:
        assert errors_of(mesh) == pytest.approx(0.01, rel=0.03)


def test_heights_lie_on_the_surface_and_images_on_the_lattice():
    mesh = flat_mesh(EXAMPLES[1], SQUARE, 0.1379, offset=(0.3, 0.7))
    x, y, z = mesh.points.T
    assert z == pytest.approx(np.exp(5 * x) * np.sin(5 * y), rel=1e-12, abs=1e-12)
    form = local.quadratic_form(np.diag([1.0, -1.0]))
    assert local.largest_error(mesh.image[mesh.triangles], form) == pytest.approx(0.1379, rel=1e-8)
    steps = (mesh.image / math.sqrt(0.1379)) @ np.linalg.inv(lattice_vectors(-1)) - [0.3, 0.7]
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


def test_what_has_no_flat_mesh_is_refused_in_one_sentence():
    ring = shapely.Point(0, 0).buffer(1.0).difference(shapely.Point(0, 0).buffer(0.3))
    with pytest.raises(InputError, match="use remesh"):
        flat_mesh("x**4+y**4+x**2*y**2+x**2+y**2", SQUARE, 0.1)
    with pytest.raises(InputError, match="several values"):
        flat_mesh("log(x**2+y**2)", ring, 0.1)
    with pytest.raises(InputError, match="positive"):
        flat_mesh("x*y", SQUARE, 0.0)
    with pytest.raises(InputError, match="strategy"):
        flat_mesh("x*y", SQUARE, 0.1, "hexagonal")  # type: ignore[arg-type]


def test_a_tolerance_too_coarse_for_any_lattice_triangle_leaves_nothing():
    mesh = flat_mesh("x*y", SQUARE, 100.0)
    assert mesh.triangles.shape == (0, 3)
    assert mesh.points.shape == (0, 3)
