"""Every triangle into four: what red refinement keeps, and the large meshes that are made by it."""

import numpy as np
import pytest
import shapely
from surfaces import FRANKE

import equimesh
from equimesh import drafts
from equimesh.constraints import with_constraints
from equimesh.domain import domain_geometry, sides_of
from equimesh.fields import as_field
from equimesh.first_mesh import first_mesh
from equimesh.optimise import driver, mending, regions, tighten
from equimesh.optimise.energy import evaluate_all, worst_errors
from equimesh.optimise.mesh import FREE, SLIDES, copied, triangles_in
from equimesh.optimise.relax import make_queue
from equimesh.optimise.sweep import violations
from equimesh.outcome import border_of, user_mesh, walls_of
from equimesh.profile import profile_again, profile_of
from equimesh.refinement import refined

UNIT = (0, 0, 1, 1)
L_SHAPE = shapely.Polygon([(0, 0), (1, 0), (1, 0.5), (0.5, 0.5), (0.5, 1), (0, 1)])
HOLE = shapely.Polygon(
    [(0, 0), (2, 0), (2, 1), (0, 1)], [[(0.5, 0.3), (0.8, 0.3), (0.8, 0.7), (0.5, 0.7)]]
)
LINE = np.array([[0.1, 0.2], [0.3, 0.4], [0.45, 0.1]])


def started(text, domain, tol, constraints=(), two_sided=False):
    """A first mesh, and what it was made for."""
    covered = domain_geometry(domain)
    surface = as_field(text, covered, None)
    kernel, frame = surface.kernel(covered, tol), surface.frame(covered)
    if two_sided:
        kernel = kernel.two_sided()
    sides = with_constraints(sides_of(covered), constraints, covered, frame)
    start = first_mesh(surface, kernel, sides, frame, tol, two_sided=two_sided)
    return start, surface, kernel, frame


def live(mesh):
    return mesh.tv[mesh.tv[:, 0] >= 0]


def area_of(mesh):
    x, y = mesh.x[live(mesh)], mesh.y[live(mesh)]
    return 0.5 * (
        (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (y[:, 1] - y[:, 0]) * (x[:, 2] - x[:, 0])
    )


@pytest.mark.parametrize("domain", [UNIT, L_SHAPE, HOLE], ids=["square", "L", "hole"])
def test_four_times_the_triangles_cover_the_same_domain(domain):
    start, surface, _, frame = started("exp(x)*sin(3*y)", domain, 1e-3)
    fine = refined(start, surface, frame, 2.5e-4)
    before, after = area_of(start.mesh), area_of(fine.mesh)
    assert len(after) == 4 * len(before)
    np.testing.assert_allclose(np.sort(after), np.sort(np.repeat(before / 4, 4)), rtol=1e-9)
    # Euler: a refined mesh has an inner vertex for every edge ...
    points, _, boundary, _ = user_mesh(fine.mesh, fine, frame, surface)
    old_points, old_triangles, old_boundary, _ = user_mesh(start.mesh, start, frame, surface)
    edges = np.vstack([np.roll(old_triangles, k, 1)[:, :2] for k in range(3)])
    assert len(points) == len(old_points) + len(np.unique(np.sort(edges, 1), axis=0))
    # ... and its border two edges for one, on the same sides from corner to corner.
    assert len(boundary.edges) == 2 * len(old_boundary.edges)
    lengths = [
        np.bincount(b.tags, np.hypot(*(p[b.edges[:, 1], :2] - p[b.edges[:, 0], :2]).T))
        for p, b in ((points, boundary), (old_points, old_boundary))
    ]
    np.testing.assert_allclose(*lengths)
    assert {tuple(corner) for corner in start.sides.corners} <= {tuple(p) for p in points[:, :2]}


def test_a_quadratic_has_a_quarter_of_the_error_everywhere():
    start, surface, kernel, frame = started("x**2+x*y+2*y**2", UNIT, 1e-3)
    fine = refined(start, surface, frame, 2.5e-4)
    for mesh in (start.mesh, fine.mesh):
        evaluate_all(kernel, mesh, 1.0)
    before = worst_errors(start.mesh)[start.mesh.tv[:, 0] >= 0]
    after = worst_errors(fine.mesh)[fine.mesh.tv[:, 0] >= 0]
    np.testing.assert_allclose(np.sort(after), np.sort(np.repeat(before / 4, 4)), rtol=1e-4)


def test_constraints_stay_and_new_vertices_slide_on_them():
    start, surface, _, frame = started("exp(x)*sin(3*y)", UNIT, 1e-3, {"ridge": LINE})
    fine = refined(start, surface, frame, 2.5e-4)
    (old, _), (walls, row) = walls_of(start.mesh, start), walls_of(fine.mesh, fine)
    assert len(walls) == 2 * len(old)
    ends = frame.to_user(np.stack([fine.mesh.x[walls], fine.mesh.y[walls]], -1).reshape(-1, 2))
    line = shapely.LineString(LINE)
    assert shapely.distance(shapely.points(ends), line).max() < 1e-12
    pieces = ends.reshape(-1, 2, 2)
    assert np.hypot(*(pieces[:, 1] - pieces[:, 0]).T).sum() == pytest.approx(line.length)
    assert set(row) == {0, 1}
    border = border_of(fine.mesh, fine)[0]
    on_lines = np.union1d(walls, border)
    slides = np.flatnonzero(fine.mesh.kind == SLIDES)
    assert np.isin(slides, on_lines).all()
    free = np.flatnonzero(fine.mesh.kind == FREE)
    assert not np.isin(free, on_lines).any()


def test_heights_above_the_surface_fall_as_the_tolerance_does():
    start, surface, _, frame = started("exp(x+y)", UNIT, 1e-3, two_sided=True)
    fine = refined(start, surface, frame, 2.5e-4)
    used = np.unique(live(fine.mesh))
    assert np.abs(start.mesh.w).max() > 0.0
    assert np.abs(fine.mesh.w).max() == pytest.approx(np.abs(start.mesh.w).max() / 4)
    user = frame.to_user(np.stack([fine.mesh.x[used], fine.mesh.y[used]], 1))
    np.testing.assert_allclose(
        fine.mesh.z[used] - fine.mesh.w[used], surface.value(user[:, 0], user[:, 1]), rtol=1e-9
    )


@pytest.fixture
def coarse(monkeypatch):
    """The meshes that were refined."""
    made = []

    def watched(start, *arguments):
        made.append(start)
        return refined(start, *arguments)

    monkeypatch.setattr(drafts, "refined", watched)
    return made


@pytest.mark.parametrize(
    "effort, least, most", [("fast", 45_000, 1.18), ("balanced", 160_000, 1.06)]
)
def test_large_curved_meshes_are_refined_and_near_the_lower_bound(coarse, effort, least, most):
    result = equimesh.remesh(FRANKE, 3.913e-4 * 5000 / least, UNIT, effort=effort)
    assert coarse
    assert result.status.ok
    assert result.lower_bound == pytest.approx(least, rel=1e-3)
    assert len(result.triangles) <= most * result.lower_bound


def test_tightening_takes_fewer_triangles_than_mending_and_leaves_few_violations(monkeypatch):
    seen = []

    def watched(field, mesh, tol, queue, goal, report):
        seen.append((regions.expected(mesh), int(violations(mesh, 1.0)[0])))
        mesh, queue = inner(field, mesh, tol, queue, goal, report)
        seen.append((regions.expected(mesh), int(violations(mesh, 1.0)[0])))
        assert (mesh.share == 1.0).all()
        return mesh, queue

    inner = driver.tighten
    monkeypatch.setattr(driver, "tighten", watched)
    result = equimesh.remesh(FRANKE, 3.913e-4 * 5000 / 20_000, UNIT)
    assert result.status.ok
    (promised, over), (after, left) = seen
    assert after < promised
    assert left < 0.1 * over
    assert len(result.triangles) <= 1.002 * after
    bound = result.lower_bound
    assert len(result.triangles) <= (1 + 2.5 / bound**0.5) * bound


def test_violations_that_are_mended_closely_take_a_vertex_each_at_most(monkeypatch):
    seen = []

    def watched(field, mesh, tol, queue):
        size, over = triangles_in(mesh), int(violations(mesh, 1.0)[0])
        trial = copied(mesh)
        simply = mending.lower_errors(field, trial, tol, make_queue(len(trial.x)), closely=False)
        mesh = tighten.close(field, mesh, tol, queue)
        assert int(violations(mesh, 1.0)[0]) == int(violations(simply, 1.0)[0]) == 0
        seen.append((over, triangles_in(simply) - size, triangles_in(mesh) - size))
        return mesh

    monkeypatch.setattr(driver, "close", watched)
    assert equimesh.remesh(FRANKE, 3.913e-4 * 5000 / 20_000, UNIT).status.ok
    ((over, simply, closely),) = seen
    assert over > 0
    assert closely <= 2 * over  # a vertex makes two triangles
    assert closely < 0.8 * simply


def test_flat_metrics_need_no_refinement(monkeypatch):
    monkeypatch.setattr(drafts, "refined", None)
    result = equimesh.remesh("exp(5*x)*sin(5*y)", 2e-3, UNIT, effort="fast")
    assert result.status.ok
    assert 60_000 < len(result.triangles) < 1.02 * result.lower_bound


def test_fit_best_and_constraints_go_through_refinement(coarse):
    result = equimesh.remesh(FRANKE, 2e-5, UNIT, effort="fast", fit="best", constraints={"a": LINE})
    assert coarse
    assert result.status.ok
    assert len(result.triangles) < result.lower_bound
    edges = result.points[result.constraints.edges][..., :2]
    length = np.hypot(*(edges[:, 1] - edges[:, 0]).T).sum()
    assert length == pytest.approx(shapely.LineString(LINE).length)


def test_a_profile_measures_again_only_what_moved(monkeypatch):
    surface = as_field("exp(x)*sin(3*y)", shapely.box(*UNIT), None)
    result = equimesh.remesh("exp(x)*sin(3*y)", 1e-3, UNIT, effort="fast")
    points, triangles = result.points.copy(), result.triangles
    before = profile_of(surface, result.points, triangles, 1e-3)
    v = triangles[len(triangles) // 2, 0]
    points[v, 2] += 1e-4
    row = np.arange(len(triangles))
    row[7] = -1  # unknown before
    measured = []
    errors = type(surface).errors

    def counted(self, points, triangles, limit):
        measured.append(len(triangles))
        return errors(self, points, triangles, limit)

    monkeypatch.setattr(type(surface), "errors", counted)
    again = profile_again(surface, points, triangles, 1e-3, before, row)
    assert measured == [((triangles == v).any(1) | (row < 0)).sum()]
    monkeypatch.undo()
    whole = profile_of(surface, points, triangles, 1e-3)
    np.testing.assert_allclose(again.errors, whole.errors, rtol=5e-3)
    assert (again.bounds >= whole.errors * (1 - 1e-9)).all()


@pytest.mark.parametrize("effort", ["fast", "balanced", "best"])
def test_more_triangles_than_memory_holds_are_refused_at_once(effort):
    with pytest.raises(equimesh.InputError, match="asks for about"):
        equimesh.remesh(FRANKE, 1e-9, UNIT, effort=effort)


def test_only_meshes_that_are_small_beside_what_they_show_are_refined():
    # Ten waves each way: a quarter of these triangles does not tell where the saddles end.
    result = equimesh.remesh("sin(15*x)*cos(15*y)", 0.002, (-1, -1, 1, 1), effort="fast")
    assert result.status.ok
    assert len(result.triangles) > 60_000
    assert len(result.triangles) <= 1.05 * result.lower_bound
