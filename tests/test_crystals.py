"""What lies between the crystals of wide lattices is annealed, and they stay as they were laid."""

import numpy as np
import pytest

import equimesh
from equimesh import drafts
from equimesh.optimise import crystals, driver
from equimesh.optimise.energy import evaluate_all
from equimesh.optimise.mesh import FREE, triangles_in
from equimesh.optimise.sweep import lift_all, violations

WAVE = ("exp(5*x)*sin(5*y)", (0, 0, 1, 1))
LINES = ("sin(6*x)+cos(5*y)", (0, 0, 1, 1))  # with lines where det H vanishes


def tolerance_for(text, domain, least):
    """The tolerance for which N* is about ``least``."""
    tol = 1e-2
    for _ in range(2):
        run = equimesh.remesh(text, tol, domain, effort="fast")
        tol *= run.lower_bound / least
    return tol


@pytest.fixture
def annealed(monkeypatch):
    """Of each mesh: its crystals and their places before and after, and its triangles."""
    seen = []

    def watched(field, mesh, *arguments):
        before = triangles_in(mesh)
        held = crystals._crystals(mesh)
        places = np.stack([mesh.x[held], mesh.y[held]])
        mesh = inner(field, mesh, *arguments)
        assert (mesh.kind[held] == FREE).all()
        seen.append((places, np.stack([mesh.x[held], mesh.y[held]]), before, triangles_in(mesh)))
        return mesh

    inner = driver.anneal_between
    monkeypatch.setattr(driver, "anneal_between", watched)
    return seen


@pytest.mark.parametrize("case", [WAVE, LINES], ids=["wave", "lines"])
def test_crystals_stay_and_what_lies_between_them_takes_fewer_triangles(annealed, case):
    tol = tolerance_for(*case, 16_000)
    result = equimesh.remesh(case[0], tol, case[1])
    ((places, after, triangles, left),) = annealed
    assert result.status.ok
    assert places.shape[1] > 1_500
    np.testing.assert_array_equal(places, after)
    assert left < triangles
    assert len(result.triangles) < triangles


@pytest.mark.parametrize(
    "text, domain",
    [("x^2/2 + y^3/6", (0, -1, 4, 1)), ("x^4 + y^4", (-1, -1, 1, 1)), WAVE, LINES],
)
def test_what_lines_and_borders_cost_falls_with_the_root_of_the_number(text, domain):
    for least in (5_000, 20_000):
        result = equimesh.remesh(text, tolerance_for(text, domain, least), domain)
        bound = result.lower_bound
        assert result.status.ok
        assert bound == pytest.approx(least, rel=1e-2)
        assert len(result.triangles) <= (1 + 4 / bound**0.5) * bound


def test_a_mesh_that_gets_no_better_is_left_as_it_was(monkeypatch):
    tol = tolerance_for(*WAVE, 16_000)
    monkeypatch.setattr(driver, "anneal_between", spoilt)
    with_trial = equimesh.remesh(WAVE[0], tol, WAVE[1])
    monkeypatch.setattr(drafts, "between_crystals", lambda field, mesh, *_: mesh)
    without = equimesh.remesh(WAVE[0], tol, WAVE[1])
    assert with_trial.status.ok
    np.testing.assert_array_equal(with_trial.points, without.points)
    np.testing.assert_array_equal(with_trial.triangles, without.triangles)


def spoilt(field, mesh, tol, *_):
    """The mesh with many vertices far from where they should be."""
    triangles = mesh.tv[mesh.tv[:, 0] >= 0]
    for corners in triangles[::10]:
        v = corners[0]
        if mesh.kind[v] == FREE:
            mesh.x[v] += 0.2 * (mesh.x[corners].mean() - mesh.x[v])
    lift_all(field, mesh)
    evaluate_all(field, mesh, tol)
    assert violations(mesh, 1.0)[0] > 0
    return mesh
